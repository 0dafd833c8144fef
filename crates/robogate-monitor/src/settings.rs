//! The settings of the monitor.

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alarm::{Level, Metric};
use crate::baseline::{Baseline, BaselineError};
use crate::domain::{Domain, DomainError};
use crate::paper::PaperRule;

/// Bounds that a baseline gives: failures, drops, collisions, the cycle time's location and spread, the modes.
const BOUNDS: f64 = 6.0;

/// The settings of the monitor. What is absent has its default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The paper's moving window.
    pub paper: PaperRule,
    /// Mean number of cycles until a false warning, at least: of all metrics together, whatever the number of recipes.
    pub warning_cycles: f64,
    /// The same for a false critical alarm.
    pub critical_cycles: f64,
    /// How the false alarms are shared among the metrics.
    pub shares: Shares,
    /// Confidence with which all bounds of one recipe's baseline hold together.
    pub baseline_confidence: f64,
    /// Cycles from which a recipe learns what its baseline does not say.
    pub learn_cycles: u32,
    /// Failures from which it learns the mix of failure modes.
    pub learn_failures: u32,
    /// Cycles without further evidence after which a standing alarm is cleared.
    pub clear_after_cycles: u64,
    /// Cycles of each recipe kept to estimate when a change began.
    pub history_cycles: u32,
    /// Most recipes; a cycle of another one is refused.
    pub most_recipes: u32,
    /// Most robots of one recipe that are told apart.
    pub most_robots: u32,
    /// The baseline of recipes that have none of their own.
    pub baseline: Baseline,
    /// Baselines by recipe.
    pub recipes: BTreeMap<String, Baseline>,
    /// Share of cycles that may lie outside what was validated before that is a change.
    pub outside_share: f64,
    /// What was validated, for recipes that have no domain of their own. It comes from a reference, not from the settings file.
    #[serde(skip)]
    pub domain: Option<Arc<Domain>>,
    /// What was validated, by recipe.
    #[serde(skip)]
    pub domains: BTreeMap<String, Arc<Domain>>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            paper: PaperRule::default(),
            warning_cycles: 2_000.0,
            critical_cycles: 50_000.0,
            shares: Shares::default(),
            baseline_confidence: 0.95,
            learn_cycles: 500,
            learn_failures: 100,
            clear_after_cycles: 2_000,
            history_cycles: 2_048,
            most_recipes: 10_000,
            most_robots: 1_000,
            baseline: Baseline::default(),
            recipes: BTreeMap::new(),
            outside_share: 0.01,
            domain: None,
            domains: BTreeMap::new(),
        }
    }
}

/// How the false alarms are shared among the metrics.
///
/// A metric with the share v alarms when its statistic M reaches A / v. Each M grows by at most one for each cycle while nothing
/// changes, and only with the cycles of its own recipe; so Σ v M, over all metrics and recipes, is at most the number of cycles
/// heard, in the mean. The mean number of cycles until the first false alarm of any metric in any recipe is therefore
/// at least A. Recipes cost nothing: the more there are, the fewer cycles each has; nor do the robots of a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Shares {
    /// Of the failure rate.
    pub success: f64,
    /// Of the drop rate.
    pub drop: f64,
    /// Of the collision rate.
    pub collision: f64,
    /// Of the cycle time.
    pub cycle_time: f64,
    /// Of its spread.
    pub cycle_time_spread: f64,
    /// Of the mix of failure modes.
    pub failure_modes: f64,
    /// Of the cycles outside what was validated.
    pub outside: f64,
    /// Of the failure rate that the risk model expects.
    pub risk: f64,
    /// Of the failure rate of one robot, all robots together.
    pub robot: f64,
}

impl Default for Shares {
    fn default() -> Self {
        Self {
            success: 0.4,
            drop: 0.075,
            collision: 0.075,
            cycle_time: 0.1,
            cycle_time_spread: 0.05,
            failure_modes: 0.075,
            outside: 0.075,
            risk: 0.075,
            robot: 0.075,
        }
    }
}

impl Shares {
    /// The share of a metric.
    pub fn of(&self, metric: Metric) -> f64 {
        match metric {
            Metric::Success => self.success,
            Metric::Drop => self.drop,
            Metric::Collision => self.collision,
            Metric::CycleTime => self.cycle_time,
            Metric::CycleTimeSpread => self.cycle_time_spread,
            Metric::FailureModes => self.failure_modes,
            Metric::Outside => self.outside,
            Metric::Risk => self.risk,
            Metric::Robot => self.robot,
        }
    }
}

/// Why settings cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number out of its range.
    #[error("`{setting}` is {value}, but must be {range}")]
    Range {
        /// The setting.
        setting: &'static str,
        /// As given.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// Shares that do not sum to at most one.
    #[error("`shares` sum to {0}, but the promise holds for at most 1 together")]
    Shares(f64),
    /// A baseline that cannot be one.
    #[error("recipe `{recipe}`: {error}")]
    Baseline {
        /// The recipe; `*` for the common baseline.
        recipe: String,
        /// What is wrong.
        error: BaselineError,
    },
    /// A domain that cannot be one.
    #[error("recipe `{recipe}`: {error}")]
    Domain {
        /// The recipe; `*` for the common domain.
        recipe: String,
        /// What is wrong.
        error: DomainError,
    },
}

impl Settings {
    /// Refuses settings that cannot be.
    ///
    /// # Errors
    /// The first setting that is wrong.
    pub fn check(&self) -> Result<(), SettingsError> {
        let within = |setting, value: f64, low: f64, high: f64, range| {
            if value >= low && value <= high { Ok(()) } else { Err(SettingsError::Range { setting, value, range }) }
        };
        within("warning_cycles", self.warning_cycles, 1.0, 1e12, "from 1 to 1e12")?;
        within("critical_cycles", self.critical_cycles, self.warning_cycles, 1e12, "from `warning_cycles` to 1e12")?;
        within("baseline_confidence", self.baseline_confidence, 0.5, 0.999_999, "from 0.5 to 0.999999")?;
        within("learn_cycles", self.learn_cycles.into(), 20.0, 1e5, "from 20 to 100000")?;
        within("learn_failures", self.learn_failures.into(), 1.0, 1e5, "from 1 to 100000")?;
        within("history_cycles", self.history_cycles.into(), 16.0, 65_536.0, "from 16 to 65536")?;
        within("paper.window", self.paper.window.into(), 1.0, 100_000.0, "from 1 to 100000")?;
        within("paper.warning", self.paper.warning, 0.0, 1.0, "from 0 to 1")?;
        within("paper.critical", self.paper.critical, self.paper.warning, 1.0, "from `paper.warning` to 1")?;
        let shares = Metric::ALL.map(|metric| self.shares.of(metric));
        for share in shares {
            within("shares", share, 0.0, 1.0, "from 0 to 1")?;
        }
        let sum: f64 = shares.iter().sum();
        if sum > 1.0 + 1e-9 {
            return Err(SettingsError::Shares(sum));
        }
        let named = self.recipes.iter().map(|(name, baseline)| (name.as_str(), baseline));
        for (recipe, baseline) in std::iter::once(("*", &self.baseline)).chain(named) {
            baseline.check().map_err(|error| SettingsError::Baseline { recipe: recipe.to_owned(), error })?;
        }
        within("most_robots", self.most_robots.into(), 1.0, 65_000.0, "from 1 to 65000")?;
        within("outside_share", self.outside_share, 0.0, 0.5, "from 0 to 0.5")?;
        let common = self.domain.iter().map(|domain| ("*", domain));
        for (recipe, domain) in common.chain(self.domains.iter().map(|(name, domain)| (name.as_str(), domain))) {
            domain.check().map_err(|error| SettingsError::Domain { recipe: recipe.to_owned(), error })?;
        }
        Ok(())
    }

    /// The promised mean number of cycles until a false alarm of this level.
    pub fn promise(&self, level: Level) -> f64 {
        match level {
            Level::Warning => self.warning_cycles,
            Level::Critical => self.critical_cycles,
        }
    }

    /// What a metric's statistic must reach for an alarm; infinite where the metric has no share.
    pub fn limit(&self, metric: Metric, level: Level) -> f64 {
        self.promise(level) / self.shares.of(metric)
    }

    /// The chance that one bound of a baseline is wrong, so that all of them hold together with the confidence set.
    pub fn alpha(&self) -> f64 {
        (1.0 - self.baseline_confidence) / BOUNDS
    }

    /// What was validated for a recipe.
    pub fn domain_of(&self, recipe: &str) -> Option<&Arc<Domain>> {
        self.domains.get(recipe).or(self.domain.as_ref())
    }

    /// The baseline of a recipe.
    pub fn baseline_of(&self, recipe: &str) -> &Baseline {
        self.recipes.get(recipe).unwrap_or(&self.baseline)
    }
}
