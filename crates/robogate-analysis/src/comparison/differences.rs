//! Differences of success rates between pairs of datasets: paired if both ran the same scenarios.

use robogate_stats::compare::{mcnemar_exact, newcombe, newcombe_paired, z_test};
use robogate_stats::multiplicity::holm;
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::comparison::dataset::Dataset;
use crate::comparison::paired;
use crate::rate::ends;

/// The difference of two success rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RateDifference {
    /// Name of the first dataset.
    pub first: String,
    /// Name of the second dataset.
    pub second: String,
    /// First rate minus second. A paired difference uses the scenarios that are valid in both.
    pub difference: f64,
    /// Newcombe's 95 % interval of the difference, paired or for independent runs.
    pub interval_95: [f64; 2],
    /// Scenarios that are valid in both, if the difference is paired; absent for independent runs.
    #[serde(default)]
    pub valid_pairs: Option<u64>,
    /// Pooled z statistic. `None` if both always or never succeeded, and for a paired difference.
    pub z: Option<f64>,
    /// ln of the two-sided p-value: of McNemar's exact test for a paired difference, otherwise of the z-test. `None`
    /// without a test.
    pub ln_p: Option<f64>,
    /// The p-value, adjusted by Holm over all pairs; 1 without a test.
    pub holm_p: f64,
}

impl RateDifference {
    /// The name of the test.
    pub fn test(&self) -> &'static str {
        if self.valid_pairs.is_some() { "McNemar" } else { "z" }
    }
}

pub(crate) fn differences(datasets: &[&Dataset<'_>]) -> Result<Vec<RateDifference>, AnalysisError> {
    let mut found = Vec::new();
    for (i, first) in datasets.iter().enumerate() {
        for second in &datasets[i + 1..] {
            found.push(between(first, second)?);
        }
    }
    let p: Vec<f64> = found.iter().map(|of| of.ln_p.map_or(1.0, f64::exp)).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    found.iter_mut().zip(adjusted).for_each(|(of, p)| of.holm_p = p);
    Ok(found)
}

fn between(first: &Dataset<'_>, second: &Dataset<'_>) -> Result<RateDifference, AnalysisError> {
    let pairs = paired::same_scenarios(first, second)?.filter(|pairs| pairs.n() > 0);
    let (difference, z, ln_p) = if let Some(pairs) = pairs {
        (newcombe_paired(pairs, Confidence::P95), None, Some(mcnemar_exact(pairs)))
    } else {
        let [one, two] = [first, second].map(|of| Trials::count(of.base.success.iter().copied()));
        let test = z_test(one, two);
        (newcombe(one, two, Confidence::P95), test.map(|test| test.z), test.map(|test| test.ln_p))
    };
    Ok(RateDifference {
        first: first.name.clone(),
        second: second.name.clone(),
        // Only datasets with valid episodes are compared, so the estimate exists.
        difference: difference.estimate.unwrap_or_default(),
        interval_95: ends(difference.interval),
        valid_pairs: pairs.map(|pairs| pairs.n()),
        z,
        ln_p: ln_p.map(|ln_p| ln_p.max(f64::MIN)),
        holm_p: 1.0,
    })
}
