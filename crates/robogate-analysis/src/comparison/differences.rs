//! Differences of success rates between pairs of datasets: paired if both ran the same scenarios.

use robogate_stats::compare::Pairs;
use robogate_stats::difference::{ScoreDifference, independent, paired};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::comparison::dataset::Dataset;
use crate::comparison::paired::same_scenarios;
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
    /// Interval of the difference at 95 % for all pairs of datasets together (Bonferroni). It excludes 0 if and only if
    /// `adjusted_p` is at most 0.05, because both come from one score test.
    pub interval_95: [f64; 2],
    /// Scenarios that are valid in both, if the difference is paired; absent for independent runs.
    #[serde(default)]
    pub valid_pairs: Option<u64>,
    /// ln of the two-sided p-value of equal rates, for this pair alone.
    pub ln_p: f64,
    /// The p-value, adjusted by Bonferroni over all pairs of datasets.
    pub adjusted_p: f64,
}

impl RateDifference {
    /// The name of the test.
    pub fn test(&self) -> &'static str {
        if self.valid_pairs.is_some() { "paired" } else { "independent" }
    }

    /// Whether the rates differ significantly.
    pub fn is_significant(&self) -> bool {
        self.adjusted_p <= ERROR
    }

    /// Whether both succeeded equally often.
    pub fn is_tie(&self) -> bool {
        self.difference.abs() <= 0.0
    }
}

/// Joint error of all differences.
pub(crate) const ERROR: f64 = 0.05;

/// The adjusted p-value of one of `family` differences.
pub(crate) fn adjusted(ln_p: f64, family: usize) -> f64 {
    (ln_p.exp() * family.max(1) as f64).min(1.0)
}

/// The level of one of `family` intervals that hold together at 95 %.
pub(crate) fn level(family: usize) -> Confidence {
    Confidence::new(1.0 - ERROR / family.max(1) as f64).unwrap_or(Confidence::P95)
}

pub(crate) fn differences(datasets: &[&Dataset<'_>]) -> Result<Vec<RateDifference>, AnalysisError> {
    let family = datasets.len() * datasets.len().saturating_sub(1) / 2;
    let mut found = Vec::new();
    for (i, first) in datasets.iter().enumerate() {
        for second in &datasets[i + 1..] {
            found.push(between(first, second, family)?);
        }
    }
    Ok(found)
}

fn between(first: &Dataset<'_>, second: &Dataset<'_>, family: usize) -> Result<RateDifference, AnalysisError> {
    let pairs: Option<Pairs> = same_scenarios(first, second)?.filter(|pairs| pairs.n() > 0);
    let difference: ScoreDifference = if let Some(pairs) = pairs {
        paired(pairs, level(family))
    } else {
        let [one, two] = [first, second].map(|of| Trials::count(of.base.success.iter().copied()));
        independent(one, two, level(family))
    };
    Ok(RateDifference {
        first: first.name.clone(),
        second: second.name.clone(),
        // Only datasets with valid episodes are compared, so the estimate exists.
        difference: difference.estimate.unwrap_or_default(),
        interval_95: ends(difference.interval),
        valid_pairs: pairs.map(|pairs| pairs.n()),
        ln_p: difference.ln_p.max(f64::MIN),
        adjusted_p: adjusted(difference.ln_p, family),
    })
}
