//! The figures that relative demands refer to.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Metric;

/// What a set of episodes speaks of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Population {
    /// The scenarios of a suite, each as often as the others.
    Suite {
        /// Its name.
        name: String,
        /// SHA-256 (hex) over its scenarios: ids, categories, groups and parameters.
        sha256: String,
        /// How many scenarios.
        cases: u64,
    },
    /// Whatever distribution the rows were drawn from.
    Drawn {
        /// The parameter space's name.
        space: String,
        /// SHA-256 (hex) over the space.
        sha256: String,
    },
}

/// The figures of a policy that others are held against, stored as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Baseline {
    /// Version of this form.
    pub format: u32,
    /// What the figures speak of: a baseline of another population is no baseline.
    pub population: Population,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// Identity of the rows that the figures were computed from.
    pub dataset_sha256: String,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes, which entered no figure.
    pub invalid: u64,
    /// The figures by metric; a metric without evidence is not there.
    pub figures: BTreeMap<Metric, f64>,
}
