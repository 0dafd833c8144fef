//! Success rates, the populations that they estimate, and findings that may be absent.

use robogate_stats::clusters::RateByCluster;
use robogate_stats::{Confidence, Interval, Trials, clopper_pearson, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::table::{Sample, rounded};

/// The population that a figure estimates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Population {
    /// The operating space, each parameter sampled as the space declares.
    OperatingSpace,
    /// The unknown distribution of imported rows, which is assumed to be the operating one.
    AsImported,
    /// The scenarios of a suite, which were selected and not sampled.
    Suite,
    /// A focused design without weights. It does not estimate the operating space.
    FocusedDesign,
    /// The part of the operating space inside the focused region, with stored weights.
    FocusedRegion,
}

impl Population {
    /// The population as the object of "apply to".
    pub fn describe(self) -> &'static str {
        match self {
            Self::OperatingSpace => {
                "the operating space, each parameter sampled uniformly over its range on its own scale"
            }
            Self::AsImported => "the distribution of the imported rows",
            Self::Suite => {
                "the scenarios of the suite, which were selected: this is not the rate of the operating space"
            }
            Self::FocusedDesign => {
                "the focused design only, which samples near the failure boundary: this is not the rate of the operating space"
            }
            Self::FocusedRegion => "the part of the operating space inside the focused region, by stored weights",
        }
    }

    /// The population in a few words, for a caption.
    pub fn brief(self) -> &'static str {
        match self {
            Self::OperatingSpace => "operating space",
            Self::AsImported => "as imported",
            Self::Suite => "scenarios of the suite, not the operating space",
            Self::FocusedDesign => "focused design only, not the operating space",
            Self::FocusedRegion => "operating space inside the focused region, reweighted",
        }
    }
}

/// An estimate, or the reason why there is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Finding<T> {
    /// It could be estimated.
    Estimated(T),
    /// It could not be estimated.
    CannotBeEstimated {
        /// The reason, as the end of a sentence that begins with "cannot be estimated because".
        because: String,
    },
}

impl<T> Finding<T> {
    pub(crate) fn not(because: impl Into<String>) -> Self {
        Self::CannotBeEstimated { because: because.into() }
    }

    /// The estimate, if there is one.
    pub fn estimated(&self) -> Option<&T> {
        match self {
            Self::Estimated(found) => Some(found),
            Self::CannotBeEstimated { .. } => None,
        }
    }

    /// The reason why there is none.
    pub fn because(&self) -> Option<&str> {
        match self {
            Self::Estimated(_) => None,
            Self::CannotBeEstimated { because } => Some(because),
        }
    }
}

impl<T, E: std::fmt::Display> From<Result<T, E>> for Finding<T> {
    fn from(result: Result<T, E>) -> Self {
        match result {
            Ok(found) => Self::Estimated(found),
            Err(error) => Self::not(error.to_string()),
        }
    }
}

/// Successes among valid episodes, with two intervals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rate {
    /// Valid episodes.
    pub n: u64,
    /// Successes among them.
    pub successes: u64,
    /// Their share. `None` without a valid episode.
    pub rate: Option<f64>,
    /// Wilson's 95 % interval. If the rows come in clusters, the interval of the rate over new clusters (Korn and Graubard).
    /// [0, 1] without a valid episode.
    pub wilson_95: [f64; 2],
    /// The exact (Clopper-Pearson) 95 % interval. If the rows come in clusters, that of Korn and Graubard. [0, 1] without a
    /// valid episode.
    pub clopper_pearson_95: [f64; 2],
    /// The clusters that the intervals count. Absent if the episodes are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clusters: Option<RateClusters>,
    /// The number of independent episodes with the same variance, if episodes count by their sampling weights. The rate is
    /// then not the share of successes among them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weighted_as: Option<f64>,
}

/// The clusters behind a rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RateClusters {
    /// Their number.
    pub clusters: u64,
    /// The number of independent episodes with the same variance of the rate.
    pub effective_episodes: f64,
}

impl Rate {
    pub(crate) fn of(trials: Trials) -> Self {
        Self {
            n: trials.n(),
            successes: trials.successes(),
            rate: trials.rate(),
            wilson_95: ends(wilson(trials, Confidence::P95)),
            clopper_pearson_95: ends(clopper_pearson(trials, Confidence::P95)),
            clusters: None,
            weighted_as: None,
        }
    }

    /// The rate of the rows of a sample for which `used` is true.
    pub(crate) fn of_rows(base: &Sample, used: impl Fn(usize) -> bool + Copy) -> Self {
        let count = || Trials::count((0..base.len()).filter(|row| used(*row)).map(|row| base.success[row]));
        if let Some(found) = base.weighted_rate(used).filter(|_| base.dependence.is_none()) {
            let interval = ends(found.interval);
            return Self {
                rate: found.rate,
                wilson_95: interval,
                clopper_pearson_95: ends(clopper_pearson(
                    rounded(found.rate.unwrap_or(0.0), found.independent),
                    Confidence::P95,
                )),
                weighted_as: Some(found.independent),
                ..Self::of(count())
            };
        }
        let Some(dependence) = base.dependence.as_ref().filter(|of| of.new_clusters) else {
            return Self::of(count());
        };
        Self::by_cluster(&dependence.rate(base, used))
    }

    /// The rate over new clusters.
    pub(crate) fn by_cluster(found: &RateByCluster) -> Self {
        let interval = ends(found.interval(Confidence::P95));
        let clusters = RateClusters { clusters: found.clusters as u64, effective_episodes: found.effective };
        Self { wilson_95: interval, clopper_pearson_95: interval, clusters: Some(clusters), ..Self::of(found.trials) }
    }

    /// The counts of independent episodes with the same rate and variance: the counts themselves without clusters, and none
    /// with too few clusters for a claim.
    pub fn effective_trials(&self) -> Trials {
        if let Some(independent) = self.weighted_as {
            return rounded(self.rate.unwrap_or(0.0), independent);
        }
        let Some(clusters) = self.clusters else { return self.trials() };
        if clusters.clusters < robogate_stats::clusters::FEWEST as u64 {
            return Trials::NONE;
        }
        rounded(self.rate.unwrap_or(0.0), clusters.effective_episodes)
    }

    /// The number of independent episodes with the same variance.
    pub(crate) fn independent(&self) -> f64 {
        self.weighted_as.or(self.clusters.map(|of| of.effective_episodes)).unwrap_or(self.n as f64)
    }

    /// The counts.
    pub fn trials(&self) -> Trials {
        Trials::new(self.successes, self.n).unwrap_or(Trials::NONE)
    }
}

/// The ends of an interval.
pub(crate) fn ends(interval: Interval) -> [f64; 2] {
    [interval.low, interval.high]
}
