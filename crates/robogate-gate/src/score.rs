//! The confidence score, 0 to 100 (the paper's section 3.4 and appendix E).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Metric;

/// One term of the score, as data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreTerm {
    /// What it is called in reports.
    pub name: String,
    /// Of which metric.
    pub metric: Metric,
    /// Only scenarios of this category count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// Its weight; the weights sum to 1.
    pub weight: f64,
    /// How the metric becomes a number from 0 to 1.
    pub scoring: Scoring,
}

/// How a metric x becomes a number from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "form", deny_unknown_fields)]
pub enum Scoring {
    /// min(1, x / full_at).
    Linear {
        /// Where the term is full.
        full_at: f64,
    },
    /// 1 - |x - b| / b, cut off at 0, with the baseline's figure b.
    BaselineDeviation,
    /// 1 at x = 0, else 0.
    Zero,
    /// 1 + x - b, cut off at 0 and at 1, with the baseline's figure b.
    BaselineDelta,
}

/// One term with its figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScoredTerm {
    /// The term.
    pub term: ScoreTerm,
    /// The metric's figure; absent where there is none.
    pub value: Option<f64>,
    /// The baseline's, where the term asks for it.
    pub baseline: Option<f64>,
    /// From 0 to 1; absent where there is no figure.
    pub scored: Option<f64>,
    /// 100 times weight times that.
    pub points: Option<f64>,
}

/// The score and what it is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConfidenceScore {
    /// 0 to 100 over the valid episodes; absent where a term has no figure.
    pub points: Option<f64>,
    /// What it could be at the least and at the most, whatever the invalid episodes could have been.
    pub bounds: [f64; 2],
    /// Its terms.
    pub terms: Vec<ScoredTerm>,
}
