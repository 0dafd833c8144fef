//! Success rates of independent runs, every two of them.

use robogate_stats::compare::{newcombe, z_test};
use robogate_stats::multiplicity::holm;
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::entrant::Entrant;
use crate::words::ends;

/// The difference of two success rates of independent runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RateDifference {
    /// Name of the first.
    pub first: String,
    /// Name of the second.
    pub second: String,
    /// First rate less second.
    pub difference: f64,
    /// Newcombe's 95 % interval for it.
    pub interval_95: [f64; 2],
    /// Pooled z statistic; absent where both always or never succeeded.
    pub z: Option<f64>,
    /// ln of its two-sided p-value; absent likewise.
    pub ln_p: Option<f64>,
    /// The p-value adjusted by Holm over all pairs; 1 where there is no test.
    pub holm_p: f64,
}

pub(crate) fn differences(entrants: &[&Entrant<'_>]) -> Vec<RateDifference> {
    let trials: Vec<Trials> =
        entrants.iter().map(|entrant| Trials::count(entrant.base.success.iter().copied())).collect();
    let mut found = Vec::new();
    for (i, first) in entrants.iter().enumerate() {
        for (j, second) in entrants.iter().enumerate().skip(i + 1) {
            let difference = newcombe(trials[i], trials[j], Confidence::P95);
            let test = z_test(trials[i], trials[j]);
            found.push(RateDifference {
                first: first.name.clone(),
                second: second.name.clone(),
                // Both were tried: what was not is not compared.
                difference: difference.estimate.unwrap_or_default(),
                interval_95: ends(difference.interval),
                z: test.map(|test| test.z),
                ln_p: test.map(|test| test.ln_p.max(f64::MIN)),
                holm_p: 1.0,
            });
        }
    }
    let p: Vec<f64> = found.iter().map(|of| of.ln_p.map_or(1.0, f64::exp)).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    found.iter_mut().zip(adjusted).for_each(|(of, p)| of.holm_p = p);
    found
}
