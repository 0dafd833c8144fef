//! Counts of outcomes, in total and in bins of each continuous parameter.
//!
//! The size of a tally does not depend on the number of episodes, and their order has no effect. Intervals are Wilson's
//! at 95 %. They treat episodes as independent draws, which is conservative for a Latin hypercube if the outcome varies
//! smoothly. Invalid episodes are counted separately and enter no rate.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{Assignment, Domain, FailureMode, Outcome, ParameterSpace, Scale, TaskSpec};
use robogate_stats::binning::Edges;
use robogate_stats::{Confidence, Trials, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Plan, PlanError};

/// Counts of episodes by outcome.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OutcomeCounts {
    /// Successful episodes.
    pub success: u64,
    /// Failures by mode, for modes that occurred.
    #[serde(flatten)]
    pub failures: BTreeMap<FailureMode, u64>,
    /// Invalid episodes.
    pub invalid: u64,
}

impl OutcomeCounts {
    /// Counts one more outcome.
    pub fn add(&mut self, outcome: &Outcome) {
        *match outcome {
            Outcome::Success => &mut self.success,
            Outcome::Failure(mode) => self.failures.entry(*mode).or_default(),
            Outcome::Invalid(_) => &mut self.invalid,
        } += 1;
    }

    /// The number of failures with this mode.
    pub fn failures(&self, mode: FailureMode) -> u64 {
        self.failures.get(&mode).copied().unwrap_or_default()
    }

    /// The declared modes of `task` in order, then the undeclared ones, each with its count.
    pub fn modes<'a>(&'a self, task: &'a TaskSpec) -> impl Iterator<Item = (FailureMode, u64)> + 'a {
        let undeclared = self.failures.keys().copied().filter(|mode| !task.declares(*mode));
        task.modes().chain(undeclared).map(|mode| (mode, self.failures(mode)))
    }

    /// The number of valid episodes.
    pub fn valid(&self) -> u64 {
        self.success + self.failures.values().sum::<u64>()
    }

    /// The number of all episodes.
    pub fn total(&self) -> u64 {
        self.valid() + self.invalid
    }

    /// The share of successes among the valid episodes. `None` if none is valid.
    pub fn success_rate(&self) -> Option<f64> {
        rate(self.success, self.valid())
    }

    /// Wilson's 95 % interval of the success rate. [0, 1] if no episode is valid.
    pub fn interval_95(&self) -> [f64; 2] {
        interval_95(self.success, self.valid())
    }
}

fn rate(successes: u64, valid: u64) -> Option<f64> {
    (valid > 0).then(|| successes as f64 / valid as f64)
}

fn interval_95(successes: u64, valid: u64) -> [f64; 2] {
    // Successes never exceed valid episodes, so this cannot fail. The fallback is the interval without evidence.
    let trials = Trials::new(successes, valid).unwrap_or(Trials::NONE);
    let interval = wilson(trials, Confidence::P95);
    [interval.low, interval.high]
}

/// Successes in bins of equal width along each continuous parameter.
#[derive(Debug, Clone)]
pub struct Bins(Vec<Marginal>);

#[derive(Debug, Clone)]
struct Marginal {
    parameter: Arc<str>,
    scale: Scale,
    edges: Edges,
    /// For each bin, the numbers of valid episodes and of successes.
    counts: Vec<(u64, u64)>,
}

impl Bins {
    /// Creates `bins` empty bins over the range of each continuous parameter that varies, in its unit. As in the paper, the bins of
    /// a log-scaled parameter have equal width in the number, not in its logarithm.
    pub fn new(space: &ParameterSpace, bins: usize) -> Result<Self, PlanError> {
        let varying = space.parameters().iter().filter(|parameter| !parameter.domain.is_constant());
        let along = varying.filter_map(|parameter| match parameter.domain {
            Domain::Continuous { low, high, scale } => Some((parameter, low, high, scale)),
            _ => None,
        });
        along
            .map(|(parameter, low, high, scale)| {
                let edge = |i| if i == bins { high } else { low + (high - low) * (i as f64 / bins as f64) };
                let edges = Edges::new((0..=bins).map(edge).collect())
                    .map_err(|_| PlanError::TooNarrow { parameter: parameter.name.to_string(), bins })?;
                Ok(Marginal { parameter: Arc::clone(&parameter.name), scale, edges, counts: vec![(0, 0); bins] })
            })
            .collect::<Result<_, _>>()
            .map(Self)
    }

    /// The bins of a plan's uniform stage. None for a suite, whose points were chosen.
    pub(crate) fn of(plan: &Plan, space: &ParameterSpace) -> Result<Self, PlanError> {
        if plan.suite.is_some() { Ok(Self(Vec::new())) } else { Self::new(space, plan.boundary.bins) }
    }

    /// Counts one more episode in one bin of each parameter. Invalid episodes are not counted.
    pub fn add(&mut self, requested: &Assignment, outcome: &Outcome) {
        let success = match outcome {
            Outcome::Success => true,
            Outcome::Failure(_) => false,
            Outcome::Invalid(_) => return,
        };
        for along in &mut self.0 {
            let bin = requested.number(&along.parameter).and_then(|value| along.edges.bin(value));
            if let Some((valid, successes)) = bin.and_then(|bin| along.counts.get_mut(bin)) {
                *valid += 1;
                *successes += u64::from(success);
            }
        }
    }

    /// The counts with rates and intervals, in the order of the space.
    pub fn marginal_effects(&self) -> Vec<MarginalEffect> {
        self.0
            .iter()
            .map(|along| MarginalEffect {
                parameter: along.parameter.to_string(),
                scale: along.scale,
                bins: along
                    .edges
                    .as_slice()
                    .windows(2)
                    .zip(&along.counts)
                    .map(|(ends, &(valid, successes))| Bin {
                        low: ends[0],
                        high: ends[1],
                        valid,
                        successes,
                        success_rate: rate(successes, valid),
                        interval_95: interval_95(successes, valid),
                    })
                    .collect(),
            })
            .collect()
    }
}

/// The success rate in bins of one continuous parameter, averaged over the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MarginalEffect {
    /// The parameter's name.
    pub parameter: String,
    /// The scale in which the parameter was sampled. The bins are linear in any case.
    pub scale: Scale,
    /// The bins, in increasing order.
    pub bins: Vec<Bin>,
}

/// One bin: from `low` up to `high`. Only the last bin includes `high`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bin {
    /// Lower end, in the parameter's unit.
    pub low: f64,
    /// Upper end, in the parameter's unit.
    pub high: f64,
    /// Valid episodes in the bin.
    pub valid: u64,
    /// The number of successes among them.
    pub successes: u64,
    /// The share of successes. Absent if no episode is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval of the success rate.
    pub interval_95: [f64; 2],
}
