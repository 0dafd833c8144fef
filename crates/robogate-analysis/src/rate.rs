//! A success rate with what it speaks of, and findings that may not be there.

use robogate_stats::{Confidence, Interval, Trials, clopper_pearson, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a figure speaks of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Population {
    /// The operating space, every parameter drawn as its space says.
    OperatingSpace,
    /// Whatever distribution the imported rows were drawn from; it is taken to be the operating one.
    AsImported,
    /// The scenarios of a suite, which were chosen and not drawn.
    Suite,
    /// A focused design as it was drawn: not the operating space.
    FocusedDesign,
    /// The part of the operating space that the focused design was drawn in, by stored weights.
    FocusedRegion,
    /// The operating space, from all rows by their weights.
    Reweighted,
}

impl Population {
    /// The population in words, as the object of "speaks of".
    pub fn describe(self) -> &'static str {
        match self {
            Self::OperatingSpace => "the operating space, each parameter drawn evenly over its range in its own scale",
            Self::AsImported => {
                "the distribution that the imported rows were drawn from; how they were drawn is not known here"
            }
            Self::Suite => "the scenarios of the suite, which were chosen: no operating rate",
            Self::FocusedDesign => {
                "the focused design alone, crowded where success turns into failure: no operating rate"
            }
            Self::FocusedRegion => {
                "the part of the operating space inside the focused design's region, by stored weights"
            }
            Self::Reweighted => "the operating space, from all rows: focused rows enter by their stored weights",
        }
    }

    /// The population in a few words, as part of a caption.
    pub fn brief(self) -> &'static str {
        match self {
            Self::OperatingSpace => "operating space",
            Self::AsImported => "as imported",
            Self::Suite => "scenarios of the suite, not the operating space",
            Self::FocusedDesign => "focused design alone, not the operating space",
            Self::FocusedRegion => "operating space inside the focused region, reweighted",
            Self::Reweighted => "operating space, all rows reweighted",
        }
    }
}

/// A finding, or the reason why there is none. Never a number that means nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Finding<T> {
    /// It could be estimated.
    Estimated(T),
    /// It could not.
    CannotBeEstimated {
        /// Why, as the end of a sentence that begins with "cannot be estimated because".
        because: String,
    },
}

impl<T> Finding<T> {
    pub(crate) fn not(because: impl Into<String>) -> Self {
        Self::CannotBeEstimated { because: because.into() }
    }

    /// The finding, if there is one.
    pub fn estimated(&self) -> Option<&T> {
        match self {
            Self::Estimated(found) => Some(found),
            Self::CannotBeEstimated { .. } => None,
        }
    }

    /// Why there is none.
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

/// Successes among valid episodes, with both intervals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rate {
    /// Valid episodes.
    pub n: u64,
    /// Successes among them.
    pub successes: u64,
    /// Their share; absent where there is no valid episode.
    pub rate: Option<f64>,
    /// Wilson's 95 % interval; [0, 1] where there is no valid episode.
    pub wilson_95: [f64; 2],
    /// The exact (Clopper-Pearson) 95 % interval; [0, 1] where there is no valid episode.
    pub clopper_pearson_95: [f64; 2],
}

impl Rate {
    pub(crate) fn of(trials: Trials) -> Self {
        Self {
            n: trials.n(),
            successes: trials.successes(),
            rate: trials.rate(),
            wilson_95: ends(wilson(trials, Confidence::P95)),
            clopper_pearson_95: ends(clopper_pearson(trials, Confidence::P95)),
        }
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
