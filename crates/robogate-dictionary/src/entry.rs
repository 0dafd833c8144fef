//! Entries: one row of the dictionary per episode.

use std::fmt;

use robogate_core::{Episode, Seed};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::DictionaryError;

/// One episode with the origin of its scenario.
///
/// The scenario contains its index and its campaign's seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The stage of the campaign that ran it (`uniform`, `boundary`, ...).
    pub stage: String,
    /// The sampler of its point (`latin_hypercube`, `sobol`, ...).
    pub design: String,
    /// Importance weight p(x)/q(x): operating density over the density that the point was sampled from. With it a
    /// boundary-focused row estimates rates of the operating distribution. Finite and not negative.
    pub weight: f64,
    /// The suite scenario of the episode. Empty if the point was sampled from a space.
    pub label: Label,
    /// The fidelity of the simulator that ran the episode.
    pub fidelity: Fidelity,
    /// The request and the result.
    pub episode: Episode,
}

/// The fidelity of the simulator that ran an episode.
///
/// A dictionary has episodes of one fidelity. Coarse episodes are cheaper, and estimate the rates of another simulator.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fidelity {
    /// The time step of the run.
    #[default]
    Fine,
    /// A larger time step than that of the run that the episodes belong to.
    Coarse,
}

impl Fidelity {
    /// The word in the dictionary.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Coarse => "coarse",
        }
    }

    /// The fidelity with this word.
    pub fn by_name(word: &str) -> Option<Self> {
        [Self::Fine, Self::Coarse].into_iter().find(|fidelity| fidelity.as_str() == word)
    }

    /// Whether this is the fine fidelity.
    pub fn is_fine(&self) -> bool {
        *self == Self::Fine
    }
}

impl fmt::Display for Fidelity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The suite scenario that an episode belongs to. A missing word is absent.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Label {
    /// The scenario's id in its suite.
    pub case: Option<String>,
    /// The category (`nominal`, `edge_cases`, ...).
    pub category: Option<String>,
    /// The group within the category (`small_objects`, ...).
    pub group: Option<String>,
}

impl Label {
    /// Whether the label has no words.
    pub fn is_empty(&self) -> bool {
        let Self { case, category, group } = self;
        [case, category, group].into_iter().all(Option::is_none)
    }
}

impl Entry {
    /// The episode's index in its campaign.
    pub fn index(&self) -> u64 {
        self.episode.scenario.index
    }

    /// Rejects entries that cannot be recorded: an invalid weight, or a seed that does not belong to the index. The
    /// record stores only the campaign's number and the index.
    pub(crate) fn check(&self) -> Result<(), DictionaryError> {
        let index = self.index();
        if !self.weight.is_finite() || self.weight < 0.0 {
            return Err(DictionaryError::Weight { index, weight: self.weight });
        }
        let seed = self.episode.scenario.seed;
        if seed != Seed::campaign(seed.campaign_number()).episode(index) {
            return Err(DictionaryError::ForeignSeed { index });
        }
        Ok(())
    }
}
