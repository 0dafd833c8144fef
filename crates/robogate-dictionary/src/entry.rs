//! Entries: one row of the dictionary per episode.

use crate::DictionaryError;
use robogate_core::{Episode, Seed};

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
    /// The request and the result.
    pub episode: Episode,
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

    /// Whether its point was chosen: by a boundary stage, or by the model of an active stage. Such points are not a sample from the
    /// operating space.
    pub fn is_chosen(&self) -> bool {
        self.stage == "boundary" || (self.stage == "active" && self.design != "uniform")
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
