//! One row of the record.

use robogate_core::{Episode, Seed};

use crate::DictionaryError;

/// One episode and how its scenario was sampled.
///
/// Its index and its campaign's seed are those of its scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The stage of the campaign that ran it (`uniform`, `boundary`, ...).
    pub stage: String,
    /// What sampled its point (`latin_hypercube`, `sobol`, ...).
    pub design: String,
    /// Importance weight p(x)/q(x): operating density over the density that the point was sampled from. With it a
    /// boundary-focused row estimates rates of the operating distribution. Finite, not negative.
    pub weight: f64,
    /// Which scenario of a suite it is; empty where the point was sampled from a space.
    pub label: Label,
    /// The request and the result.
    pub episode: Episode,
}

/// Which scenario of a suite an episode belongs to. A word that was not given is absent.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Label {
    /// The scenario's id in its suite.
    pub case: Option<String>,
    /// Its category (`nominal`, `edge_cases`, ...).
    pub category: Option<String>,
    /// Its group within the category (`small_objects`, ...).
    pub group: Option<String>,
}

impl Label {
    /// Whether it has no words.
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

    /// Refuses what no record can hold: an invalid weight, or a seed of another index. The record keeps the campaign's
    /// number and the index.
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
