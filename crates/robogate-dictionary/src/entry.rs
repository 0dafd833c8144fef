//! One row of the record.

use robogate_core::{Episode, Seed};

use crate::DictionaryError;

/// One episode and how it came to be drawn.
///
/// Its index and its campaign's seed are those of its scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The stage of the campaign that ran it (`uniform`, `boundary`, ...).
    pub stage: String,
    /// What drew its point (`latin_hypercube`, `sobol`, ...).
    pub design: String,
    /// Importance weight p(x)/q(x) of the operating density over the density it was drawn from:
    /// what makes a boundary-focused row speak of the operating distribution. Finite, not negative.
    pub weight: f64,
    /// Which scenario of a suite it is; empty where the point was drawn from a space.
    pub label: Label,
    /// What was asked for and what happened.
    pub episode: Episode,
}

/// Which scenario of a suite an episode is of. Each word is absent where nobody gave one.
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
    /// Whether there is no word in it.
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

    /// Refuses what no record can hold: a weight that is none, or a seed that is not that of the
    /// episode's own index (the record keeps the campaign's number and the index, nothing else).
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
