//! Campaign plans.
//!
//! A [`Plan`] is read from TOML. The embedded presets contain the defaults and document every setting. Errors within
//! the plan are found on reading; conflicts with a parameter space are found by [`Plan::check`].

mod check;
mod error;
mod preset;

use std::path::Path;

use robogate_core::budget::Budget;
use robogate_core::{Sampler, Suite, samplers};
use robogate_dictionary::read_text;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{ActiveStage, SuiteStage};
use robogate_core::hint;

pub use error::PlanError;
pub use preset::Preset;

/// A campaign plan: seed, sampler, and stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The seed of all randomness in the campaign. The stages use separate streams of it.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// The sampler of the points: `latin_hypercube`, `sobol` or `uniform`.
    #[serde(default = "default_sampler")]
    pub sampler: String,
    /// The first stage, over the operating space.
    pub uniform: UniformStage,
    /// The second stage, around the boundary between success and failure.
    #[serde(default)]
    pub boundary: BoundaryStage,
    /// The active stage, which replaces the second stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<ActiveStage>,
    /// The suite that replaces all stages: its scenarios run in rounds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<SuiteStage>,
    /// Whether the nominal twins of the episodes run after the campaign: those of the first stage, or of the suite.
    #[serde(default, skip_serializing_if = "is_false")]
    pub twins: bool,
    /// The number of episodes with nothing varied that run after the campaign.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub nominal_episodes: u64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(value: &u64) -> bool {
    *value == 0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_false(value: &bool) -> bool {
    !*value
}

/// The first stage: every parameter is uniform in its scale.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UniformStage {
    /// The number of episodes.
    pub episodes: u64,
}

/// The second stage: it samples around the boundary that the first stage found (paper, section 5.2 and appendix F).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundaryStage {
    /// The number of episodes. With 0 there is no second stage.
    #[serde(default)]
    pub episodes: u64,
    /// The number of bins of equal width per continuous parameter, in the parameter's unit.
    #[serde(default = "default_bins")]
    pub bins: usize,
    /// Success rates, both ends included, between which a bin belongs to the boundary.
    #[serde(default = "default_band")]
    pub band: [f64; 2],
    /// A region that gets an additional share of the episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emphasis: Option<Emphasis>,
    /// Ranges for continuous parameters without a bin in the band. They replace the whole range.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fallback: Vec<Range>,
    /// Integer parameters that are restricted to a part of their range, both ends included.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restrict: Vec<Range>,
}

impl Default for BoundaryStage {
    fn default() -> Self {
        Self {
            episodes: 0,
            bins: default_bins(),
            band: default_band(),
            emphasis: None,
            fallback: Vec::new(),
            restrict: Vec::new(),
        }
    }
}

/// A region that gets a fixed share of the second stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Emphasis {
    /// The share of the stage's episodes, from 0 to 1.
    pub share: f64,
    /// The conditions of the region. All must hold.
    #[serde(rename = "where")]
    pub conditions: Vec<Range>,
}

/// A range of one parameter, in its unit. A missing end is the end of the parameter space.
///
/// For a continuous parameter the upper end is excluded. For an integer parameter both ends are included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// The parameter's name.
    pub parameter: String,
    /// The lower end, included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The upper end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

/// The seed of a campaign if the user does not choose one.
pub const DEFAULT_SEED: u64 = 2026;

fn default_seed() -> u64 {
    DEFAULT_SEED
}

fn default_sampler() -> String {
    "latin_hypercube".to_owned()
}

fn default_bins() -> usize {
    10
}

fn default_band() -> [f64; 2] {
    [0.30, 0.70]
}

impl Plan {
    /// Reads a plan from TOML. Errors name line and key.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        let plan: Self = Budget::FILE.toml(text).map_err(|e| PlanError::Syntax(e.to_string()))?;
        plan.check_alone()?;
        Ok(plan)
    }

    /// Reads a plan from a TOML file. Errors also name the file.
    pub fn load(path: &Path) -> Result<Self, PlanError> {
        let text = read_text(path).map_err(|source| PlanError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text).map_err(|error| PlanError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// Sets the total number of episodes and keeps the design. With an active stage, a quarter, rounded up, is in the first
    /// stage; with a boundary stage, two thirds, rounded up.
    #[must_use]
    pub fn with_total(mut self, total: u64) -> Self {
        if let Some(active) = &mut self.active {
            self.uniform.episodes = total.div_ceil(4);
            active.episodes = total - self.uniform.episodes;
        } else if self.boundary.episodes > 0 {
            self.boundary.episodes = total / 3;
            self.uniform.episodes = total - total / 3;
        } else {
            self.uniform.episodes = total;
        }
        self
    }

    /// The number of episodes of both stages.
    fn staged(&self) -> u64 {
        self.uniform.episodes + self.boundary.episodes + self.active_episodes()
    }

    /// Replaces the second stage by the active stage. A quarter of all episodes, rounded up, is uniform.
    #[must_use]
    pub fn with_active(mut self) -> Self {
        let total = self.staged();
        self.active.get_or_insert_with(|| ActiveStage::new(0));
        self.boundary.episodes = 0;
        self.with_total(total)
    }

    /// Replaces the active stage by the boundary stage, with a third of all episodes. A plan with a boundary stage does not
    /// change.
    #[must_use]
    pub fn with_two_stages(mut self) -> Self {
        let total = self.staged();
        self.active = None;
        if self.boundary.episodes == 0 {
            self.boundary.episodes = total / 3;
            self.uniform.episodes = total - total / 3;
        }
        self
    }

    /// Replaces all other stages by the uniform one.
    #[must_use]
    pub fn with_uniform_only(mut self) -> Self {
        self.uniform.episodes = self.staged();
        self.boundary.episodes = 0;
        self.active = None;
        self
    }

    /// The number of episodes of the active stage.
    pub(crate) fn active_episodes(&self) -> u64 {
        self.active.as_ref().map_or(0, |stage| stage.episodes)
    }

    /// Creates a plan that runs a suite in at most `rounds` rounds.
    pub fn of_suite(suite: Suite, rounds: u64, seed: u64) -> Self {
        Self {
            seed,
            // Ranges within a scenario are always sampled independently and uniformly.
            sampler: "uniform".to_owned(),
            uniform: UniformStage { episodes: 0 },
            boundary: BoundaryStage::default(),
            active: None,
            twins: suite.has_twins(),
            nominal_episodes: 0,
            suite: Some(SuiteStage::new(suite, rounds)),
        }
    }

    /// The number of episodes of all stages.
    pub fn episodes(&self) -> u64 {
        self.staged() + self.suite.as_ref().map_or(0, SuiteStage::episodes)
    }

    /// The sampler of the plan.
    pub fn sampler(&self) -> Result<Box<dyn Sampler>, PlanError> {
        samplers::by_name(&self.sampler).ok_or_else(|| PlanError::UnknownSampler {
            name: self.sampler.clone(),
            hint: hint(&self.sampler, samplers::NAMES.into_iter()),
        })
    }
}
