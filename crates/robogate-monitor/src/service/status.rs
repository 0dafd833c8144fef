//! The status document, which the page displays.

use std::borrow::Cow;

use robogate_stats::{Confidence, Trials, wilson};
use serde::Serialize;
use serde_json::Value;

use super::charts::Charts;
use super::intake::{Intake, IntakeError, Taken};
use super::nearest::{Episodes, NearestEpisode};
use super::warnings::WarningStatus;
use crate::cycle::Cycle;
use crate::domain::Validated;
use crate::{Level, OutsideTally, Recipe, Settings};

/// Maximum number of recipes, the most severe and busiest first.
const RECIPES: usize = 200;
/// Number of recipes with charts.
const CHARTS: usize = 24;
/// Maximum numbers of alarms and cycles.
const ALARMS: u32 = 100;
const CYCLES: u32 = 200;
/// Number of cycles before an alarm.
const AROUND: u32 = 30;

/// The last cycles of a recipe up to one of them, and the simulated episodes that resemble it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Around {
    /// The version of the format.
    pub version: u32,
    /// The cycles, newest first.
    pub cycles: Vec<Value>,
    /// The cycle that the episodes resemble: the last failed one with parameters. `None` without such a cycle.
    pub like: Option<String>,
    /// The nearest simulated episode.
    pub nearest: Option<NearestEpisode>,
    /// The failure mode of that cycle, if it reports one.
    pub failure_mode: Option<String>,
    /// The nearest simulated failure: one with that failure mode, or with any if the run has none with it.
    pub nearest_failure: Option<NearestEpisode>,
}

impl Around {
    pub(super) fn of(intake: &Intake, recipe: &str, until: &str) -> Result<Self, IntakeError> {
        let bodies = intake.store().cycles_until(recipe, until, AROUND)?;
        let cycles: Vec<Cycle> = bodies.iter().filter_map(|body| serde_json::from_str(body).ok()).collect();
        let like = cycles.iter().find(|cycle| !cycle.success && !cycle.parameters.is_empty());
        let failure_mode = like.and_then(|cycle| cycle.failure_mode.clone());
        let (episodes, parameters) = (intake.episodes(recipe), like.map(|cycle| &cycle.parameters));
        let near = episodes.zip(parameters);
        Ok(Self {
            version: 1,
            nearest: near.and_then(|(episodes, parameters)| episodes.nearest(parameters, |_| true)),
            nearest_failure: near
                .and_then(|(episodes, parameters)| episodes.nearest_failure(parameters, failure_mode.as_deref())),
            failure_mode,
            like: like.map(|cycle| cycle.id.clone()),
            cycles: bodies.into_iter().map(|body| serde_json::from_str(&body).unwrap_or(Value::Null)).collect(),
        })
    }
}

/// The status of the monitor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Status {
    /// The version of the format.
    pub version: u32,
    /// Lower bounds of the mean number of cycles to a false warning and to a false critical alarm.
    pub promised_cycles: [f64; 2],
    /// The number of recipes.
    pub recipes_known: usize,
    /// The recipes, the most severe first, then the busiest.
    pub recipes: Vec<RecipeStatus>,
    /// The last alarms, newest first.
    pub alarms: Vec<Value>,
    /// The last cycles, newest first.
    pub cycles: Vec<Value>,
    /// The sum of all results since the start of this process.
    pub intake: Taken,
    /// Warnings within episodes. `None` without a detector.
    pub warnings: Option<WarningStatus>,
}

/// A rate with its 95 % Wilson interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RateStatus {
    /// Number of successes.
    pub successes: u64,
    /// Number of cycles.
    pub cycles: u64,
    /// Observed rate. `None` without cycles.
    pub rate: Option<f64>,
    /// The interval.
    pub interval_95: [f64; 2],
}

impl RateStatus {
    pub(super) fn of(trials: Trials) -> Self {
        let interval = wilson(trials, Confidence::P95);
        let interval_95 = [interval.low, interval.high];
        Self { successes: trials.successes(), cycles: trials.n(), rate: trials.rate(), interval_95 }
    }
}

/// The status of a recipe.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecipeStatus {
    /// The recipe.
    pub recipe: String,
    /// The most severe active level of the detectors. `None` without an alarm.
    pub level: Option<Level>,
    /// The level of the paper's rule, which has no guarantee.
    pub paper: Option<Level>,
    /// Success rate in the paper's window.
    pub window: RateStatus,
    /// Success rate of all its cycles.
    pub all: RateStatus,
    /// The success rate of the baseline. `None` while it is being learnt.
    pub baseline: Option<f64>,
    /// What the detectors do not watch, and why the promise on false alarms is approximate, one sentence each.
    pub dependence: Vec<String>,
    /// Its detectors.
    pub detectors: Vec<DetectorStatus>,
    /// Cycles outside the validated region, by parameter, since the detectors started.
    pub outside: Vec<OutsideStatus>,
    /// The course of the metrics and of the evidence since the first cycle. `None` for all but the first recipes.
    pub charts: Option<Charts>,
    /// Whether its alarms link to simulated episodes that this monitor can replay.
    pub replays: bool,
}

/// The status of a detector.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectorStatus {
    /// The metric.
    pub metric: Cow<'static, str>,
    /// The label of the metric.
    pub label: Cow<'static, str>,
    /// Evidence and limit for a warning and a critical alarm. `None` if the detector does not run.
    pub levels: Option<[[f64; 2]; 2]>,
    /// The reason why the detector does not run.
    pub because: Option<&'static str>,
    /// The most severe active alarm.
    pub standing: Option<Level>,
}

/// Cycles in which a parameter lay outside the validated region.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OutsideStatus {
    /// The parameter. `None` for combinations outside the validated region.
    pub parameter: Option<String>,
    /// The validated values.
    pub validated: Option<Validated>,
    /// The cycles outside.
    #[serde(flatten)]
    pub seen: OutsideTally,
}

impl Status {
    pub(super) fn of(intake: &Intake) -> Result<Self, IntakeError> {
        let monitor = intake.monitor();
        let settings = monitor.settings();
        let mut order: Vec<(&str, &Recipe)> = monitor.recipes().collect();
        order.sort_by_key(|(_, recipe)| std::cmp::Reverse((recipe.level(), recipe.trials().n())));
        let value = |text: String| serde_json::from_str(&text).unwrap_or(Value::Null);
        Ok(Self {
            version: 1,
            promised_cycles: [settings.warning_cycles, settings.critical_cycles],
            recipes_known: order.len(),
            recipes: order
                .iter()
                .take(RECIPES)
                .enumerate()
                .map(|(at, (name, recipe))| RecipeStatus {
                    replays: intake.episodes(name).is_some_and(Episodes::can_replay),
                    ..recipe_status(name, recipe, settings, at < CHARTS)
                })
                .collect(),
            alarms: intake.store().last_alarms(ALARMS)?.into_iter().map(value).collect(),
            cycles: intake.store().last_cycles(CYCLES)?.into_iter().map(value).collect(),
            intake: intake.totals().clone(),
            warnings: intake.warnings().map(|warnings| warnings.status(monitor)),
        })
    }
}

fn recipe_status(name: &str, recipe: &Recipe, settings: &Settings, charts: bool) -> RecipeStatus {
    let detector = |view: crate::DetectorView| DetectorStatus {
        metric: view.name,
        label: view.label,
        levels: view.levels.ok().map(|levels| levels.map(|(evidence, limit)| [evidence, limit])),
        because: view.levels.err(),
        standing: Level::ALL.into_iter().rev().find(|level| view.standing[*level as usize].is_some()),
    };
    let outside = recipe.outside().filter(|(_, tally)| tally.cycles > 0).map(|(parameter, tally)| OutsideStatus {
        parameter: parameter.map(|(name, _)| name.to_owned()),
        validated: parameter.map(|(_, validated)| validated.clone()),
        seen: tally.clone(),
    });
    RecipeStatus {
        recipe: name.to_owned(),
        level: recipe.level(),
        paper: recipe.paper_level(),
        window: RateStatus::of(recipe.window()),
        all: RateStatus::of(recipe.trials()),
        baseline: recipe.baseline().success_rate(),
        dependence: recipe.doubts(settings),
        detectors: recipe.detectors(settings).into_iter().map(detector).collect(),
        outside: outside.collect(),
        charts: charts.then(|| Charts::of(recipe, settings)),
        replays: false,
    }
}
