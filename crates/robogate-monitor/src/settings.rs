//! The settings of the monitor.

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::alarm::Level;
use crate::baseline::{Baseline, BaselineError};
use crate::cycle::{LONGEST_NAME, is_name};
use crate::domain::{Domain, DomainError};
use crate::events::{EventSettings, MOST_EVENTS, default_events};
use crate::metric::Metric;
use crate::paper::PaperRule;

/// Number of bounds of a baseline without events: failures, location and spread of the cycle time, failure modes.
const BOUNDS: usize = 4;

/// The settings of the monitor. Missing settings have their default values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The paper's moving window.
    pub paper: PaperRule,
    /// Lower bound of the mean number of cycles until a false warning, over all metrics and recipes together.
    pub warning_cycles: f64,
    /// The same for a false critical alarm.
    pub critical_cycles: f64,
    /// The share of each metric in the false alarms.
    pub shares: Shares,
    /// The monitored events, by name. By default those that the first cycle records had: `drop` and `collision`.
    pub events: BTreeMap<String, EventSettings>,
    /// Joint confidence of all bounds of one recipe's baseline.
    pub baseline_confidence: f64,
    /// Number of cycles from which a recipe learns the missing parts of its baseline.
    pub learn_cycles: u32,
    /// Number of failures from which a recipe learns the mix of failure modes.
    pub learn_failures: u32,
    /// Number of cycles without further evidence after which an active alarm is cleared.
    pub clear_after_cycles: u64,
    /// Number of stored cycles per recipe, from which the start of a change is estimated.
    pub history_cycles: u32,
    /// Maximum number of recipes. Cycles of further recipes are refused.
    pub most_recipes: u32,
    /// Maximum number of robots per recipe that are monitored separately.
    pub most_robots: u32,
    /// The baseline of recipes without their own.
    pub baseline: Baseline,
    /// Baselines by recipe.
    pub recipes: BTreeMap<String, Baseline>,
    /// Accepted share of cycles outside the validated region.
    pub outside_share: f64,
    /// The validated region of recipes without their own. It comes from a reference file, not from the settings file.
    #[serde(skip)]
    pub domain: Option<Arc<Domain>>,
    /// Validated regions by recipe.
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
            events: default_events(),
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

/// The share of each metric in the false alarms. Events have theirs in [`EventSettings`].
///
/// A metric with the share v raises an alarm when its statistic M reaches A / v. Without a change, the mean of each M
/// grows by at most one per cycle, and only with the cycles of its own recipe. The mean of Σ v M over all metrics and
/// recipes is therefore at most the number of cycles, and the mean number of cycles until the first false alarm of any
/// metric in any recipe is at least A. More recipes or robots do not weaken this bound, because each then has fewer
/// cycles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Shares {
    /// Share of the failure rate.
    pub success: f64,
    /// Share of the location of the cycle time.
    pub cycle_time: f64,
    /// Share of the spread of the cycle time.
    pub cycle_time_spread: f64,
    /// Share of the mix of failure modes.
    pub failure_modes: f64,
    /// Share of the cycles outside the validated region.
    pub outside: f64,
    /// Share of the failure rate that the risk model predicts.
    pub risk: f64,
    /// Share of the failure rates of single robots, all robots together.
    pub robot: f64,
}

impl Default for Shares {
    fn default() -> Self {
        Self {
            success: 0.4,
            cycle_time: 0.1,
            cycle_time_spread: 0.05,
            failure_modes: 0.075,
            outside: 0.075,
            risk: 0.075,
            robot: 0.075,
        }
    }
}

/// An error in the settings.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A number outside its range.
    #[error("`{setting}` is {value}, but must be {range}")]
    Range {
        /// The setting.
        setting: &'static str,
        /// The given value.
        value: f64,
        /// The expected range.
        range: &'static str,
    },
    /// Shares that do not sum to at most one.
    #[error(
        "`shares` and the shares of the events sum to {0}. Expected at most 1: the bound on false alarms holds for all metrics together"
    )]
    Shares(f64),
    /// Too many events.
    #[error("`events` has {0} events. Expected at most {MOST_EVENTS}")]
    Events(usize),
    /// An event with an invalid name.
    #[error("`events`: a name must have 1 to {LONGEST_NAME} bytes and no control characters")]
    EventName,
    /// An invalid baseline.
    #[error("recipe `{recipe}`: {error}")]
    Baseline {
        /// The recipe, or `*` for the common baseline.
        recipe: String,
        /// The problem.
        error: BaselineError,
    },
    /// An invalid validated region.
    #[error("recipe `{recipe}`: {error}")]
    Domain {
        /// The recipe, or `*` for the common region.
        recipe: String,
        /// The problem.
        error: DomainError,
    },
}

impl Settings {
    /// Checks all settings.
    ///
    /// # Errors
    /// The first problem.
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
        if self.events.len() > MOST_EVENTS {
            return Err(SettingsError::Events(self.events.len()));
        }
        if !self.events.keys().all(|name| is_name(name)) {
            return Err(SettingsError::EventName);
        }
        for metric in Metric::all(self) {
            let setting = if matches!(metric, Metric::Event(_)) { "events.*.share" } else { "shares" };
            within(setting, self.share(metric), 0.0, 1.0, "from 0 to 1")?;
        }
        let sum: f64 = Metric::all(self).map(|metric| self.share(metric)).sum();
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

    /// Lower bound of the mean number of cycles until a false alarm of this level.
    pub fn promise(&self, level: Level) -> f64 {
        match level {
            Level::Warning => self.warning_cycles,
            Level::Critical => self.critical_cycles,
        }
    }

    /// The limit at which a metric's statistic raises an alarm. Infinite for a metric without a share.
    pub fn limit(&self, metric: Metric, level: Level) -> f64 {
        self.promise(level) / self.share(metric)
    }

    /// The share of a metric in the false alarms.
    pub fn share(&self, metric: Metric) -> f64 {
        let shares = &self.shares;
        match metric {
            Metric::Success => shares.success,
            Metric::Event(event) => self.events.values().nth(usize::from(event)).map_or(0.0, |settings| settings.share),
            Metric::CycleTime => shares.cycle_time,
            Metric::CycleTimeSpread => shares.cycle_time_spread,
            Metric::FailureModes => shares.failure_modes,
            Metric::Outside => shares.outside,
            Metric::Risk => shares.risk,
            Metric::Robot => shares.robot,
        }
    }

    /// The name of an event's metric. `None` for other metrics.
    pub fn event(&self, metric: Metric) -> Option<&str> {
        let Metric::Event(event) = metric else { return None };
        self.events.keys().nth(usize::from(event)).map(String::as_str)
    }

    /// The error probability of one bound of a baseline, with Bonferroni's correction for all bounds.
    pub fn alpha(&self) -> f64 {
        (1.0 - self.baseline_confidence) / (BOUNDS + self.events.len()) as f64
    }

    /// The validated region of a recipe.
    pub fn domain_of(&self, recipe: &str) -> Option<&Arc<Domain>> {
        self.domains.get(recipe).or(self.domain.as_ref())
    }

    /// The baseline of a recipe.
    pub fn baseline_of(&self, recipe: &str) -> &Baseline {
        self.recipes.get(recipe).unwrap_or(&self.baseline)
    }
}
