//! Warnings within episodes: control periods that robots report while they work.
//!
//! A warning is an alarm of the metric `warning`, which is cleared at the end of its episode. It is suspended while the robot's
//! recipe has an alarm of a detector: the promise holds for robots that work as in the calibration.

use serde::Serialize;

use super::batch::{LISTED, MOST_LINES, TooManyLines, lines};
use super::intake::Refused;
use super::store::{Store, StoreError};
use crate::warn::{Feed, FeedEvent, Period, Tally, WarnError, WarnFile, Warning};
use crate::{Alarm, Happening, Level, Monitor};

/// The metric of these alarms.
const METRIC: &str = "warning";

/// Control periods, parsed before they reach the engine's thread.
#[derive(Debug, Clone, Default)]
pub struct Periods {
    pub(super) lines: Vec<(u64, Result<Period, String>)>,
    /// When they arrived, in seconds since 1970.
    pub(super) now_s: f64,
}

impl Periods {
    /// Parses one control period per line. Blank lines are ignored. `now_s` is the time of arrival, in seconds since 1970.
    ///
    /// # Errors
    /// If there are too many lines.
    pub fn parse(text: &[u8], now_s: f64) -> Result<Self, TooManyLines> {
        let mut all = Vec::new();
        for (line, text) in lines(text) {
            if all.len() == MOST_LINES {
                return Err(TooManyLines);
            }
            all.push((line, serde_json::from_slice(text).map_err(|error| error.to_string())));
        }
        Ok(Self { lines: all, now_s })
    }

    /// Periods that were not sent as lines, or the problem with each. They are numbered from 1.
    pub fn of(periods: Vec<Result<Period, String>>, now_s: f64) -> Self {
        Self { lines: (1..).zip(periods).collect(), now_s }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }
}

/// A warning in a reply.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SentWarning {
    /// The robot.
    pub robot: String,
    /// The warning.
    #[serde(flatten)]
    pub warning: Warning,
}

/// What became of control periods.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct HeardPeriods {
    /// The number of periods, starts and ends that were processed.
    pub accepted: u64,
    /// The number of rejected lines.
    pub rejected: u64,
    /// The first hundred of them.
    pub rejections: Vec<Refused>,
    /// The warnings, for a robot that waits for the reply.
    pub warnings: Vec<SentWarning>,
    /// Warnings that were not sent, because the recipe has an alarm.
    pub suppressed: u64,
}

/// The state of the warnings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WarningStatus {
    /// SHA-256 (hex) of the file of the detector.
    pub detector_sha256: String,
    /// The task of the calibration.
    pub task: String,
    /// The share of warned successes that is promised at most.
    pub promised: f64,
    /// Robots in an episode.
    pub running: usize,
    /// The counts of the episodes of this detector.
    pub episodes: Tally,
    /// Warnings since the start that were not sent, because the recipe had an alarm.
    pub suppressed: u64,
    /// Recipes with an alarm, for which warnings are suspended now.
    pub shifted: Vec<String>,
}

/// The detector at work.
#[derive(Debug)]
pub(super) struct Warnings {
    feed: Feed,
    sha256: String,
    suppressed: u64,
    /// The alarm of each robot in a warned episode.
    active: Vec<Alarm>,
}

impl Warnings {
    /// A detector with the counts of earlier episodes.
    pub(super) fn open(file: WarnFile, sha256: String, store: &Store) -> Result<Result<Self, WarnError>, StoreError> {
        let feed = match Feed::new(file) {
            Ok(feed) => feed,
            Err(error) => return Ok(Err(error)),
        };
        let tally = store.tally(&sha256, *feed.tally())?;
        Ok(Ok(Self { feed: feed.with_tally(tally), sha256, suppressed: 0, active: Vec::new() }))
    }

    /// Writes the counts of the episodes.
    pub(super) fn keep(&self, store: &Store) -> Result<(), StoreError> {
        store.keep_tally(&self.sha256, self.feed.tally())
    }

    /// The counts of the episodes, and suppressed warnings.
    pub(super) fn counts(&self) -> (&Tally, u64) {
        (self.feed.tally(), self.suppressed)
    }

    /// The state.
    pub(super) fn status(&self, monitor: &Monitor) -> WarningStatus {
        let shifted = monitor.recipes().filter(|(_, recipe)| recipe.level().is_some());
        WarningStatus {
            detector_sha256: self.sha256.clone(),
            task: self.feed.file().conditions.task.clone(),
            promised: self.feed.file().calibration.promised,
            running: self.feed.robots().0,
            episodes: *self.feed.tally(),
            suppressed: self.suppressed,
            shifted: shifted.map(|(name, _)| name.to_owned()).collect(),
        }
    }

    /// Processes control periods. `emit` receives alarms. Returns also whether an episode ended.
    pub(super) fn hear(
        &mut self,
        periods: Periods,
        monitor: &Monitor,
        emit: &mut dyn FnMut(Alarm),
    ) -> (HeardPeriods, bool) {
        let (mut heard, mut ended) = (HeardPeriods::default(), false);
        for (line, period) in periods.lines {
            let mut events = Vec::new();
            if let Ok(Period { robot, start: Some(_), .. }) = &period {
                self.clear(robot, 0.0, format!("another episode of {robot} began without the end of this one"), emit);
            }
            let taken = period.and_then(|period| {
                self.feed.hear(&period, &mut |event| events.push(event)).map_err(|error| error.to_string())
            });
            match taken {
                Ok(()) => {
                    heard.accepted += 1;
                    for event in events {
                        ended |= !matches!(event, FeedEvent::Warning { .. });
                        self.follow(event, periods.now_s, monitor, &mut heard, emit);
                    }
                }
                Err(because) => {
                    heard.rejected += 1;
                    if heard.rejections.len() < LISTED {
                        heard.rejections.push(Refused::new(line, because));
                    }
                }
            }
        }
        (heard, ended)
    }

    /// Makes alarms of what the feed says.
    fn follow(
        &mut self,
        event: FeedEvent,
        now_s: f64,
        monitor: &Monitor,
        heard: &mut HeardPeriods,
        emit: &mut dyn FnMut(Alarm),
    ) {
        match event {
            FeedEvent::Warning { robot, warning } => {
                if is_shifted(monitor, &robot, self.feed.recipe_of(&robot)) {
                    heard.suppressed += 1;
                    self.suppressed += 1;
                    return;
                }
                let time_s = self.feed.started_s(&robot).map_or(now_s, |started_s| started_s + warning.time_s);
                let alarm = self.raised(&robot, warning.time_s, time_s);
                emit(alarm.clone());
                self.active.retain(|of| of.robot != robot);
                self.active.push(alarm);
                heard.warnings.push(SentWarning { robot, warning });
            }
            FeedEvent::Ended { robot, end, lead_s, .. } => {
                let lead = lead_s.map_or_else(String::new, |lead_s| format!(", {lead_s:.2} s after the warning"));
                let what = format!("the episode of {robot} ended with {end}{lead}");
                self.clear(&robot, lead_s.unwrap_or(0.0), what, emit);
            }
            FeedEvent::Suspended { suspended, .. } => {
                let raised = self.raised("*", 0.0, now_s);
                emit(Alarm {
                    id: format!("{METRIC}/suspended/{now_s}"),
                    what: format!("warnings within episodes are suspended: {suspended}"),
                    how_sure: "if the promise holds, this ever happens with a probability of at most 5 %".to_owned(),
                    look_at: vec!["calibrate again with `robogate warn check --out`".to_owned()],
                    ..raised
                });
            }
        }
    }

    /// Clears the alarm of a robot, if it has one.
    fn clear(&mut self, robot: &str, after_s: f64, what: String, emit: &mut dyn FnMut(Alarm)) {
        let Some(at) = self.active.iter().position(|of| of.robot == robot) else { return };
        let raised = self.active.swap_remove(at);
        emit(Alarm {
            id: format!("{}/cleared", raised.id),
            happening: Happening::Cleared,
            time_s: raised.time_s + after_s,
            what,
            look_at: Vec::new(),
            ..raised
        });
    }

    fn raised(&self, robot: &str, at_s: f64, time_s: f64) -> Alarm {
        let Tally { quiet_successes, warned_successes, warned_failures, missed_failures, stopped, .. } =
            *self.feed.tally();
        let episodes = quiet_successes + warned_successes + warned_failures + missed_failures + stopped;
        let promised = 100.0 * self.feed.file().calibration.promised;
        Alarm {
            id: format!("{METRIC}/{robot}/{episodes}/{time_s}"),
            happening: Happening::Raised,
            level: Level::Warning,
            recipe: self.feed.recipe_of(robot).unwrap_or("*").to_owned(),
            metric: METRIC.to_owned(),
            cycle: episodes + 1,
            cycle_id: String::new(),
            robot: robot.to_owned(),
            time_s,
            what: format!("the episode of {robot} may fail: warned {at_s:.2} s after its start"),
            how_sure: format!(
                "at most {promised} % of successful episodes are warned, with 95 % confidence over the calibration"
            ),
            since: None,
            look_at: Vec::new(),
        }
    }
}

/// Whether the recipe of a robot has an alarm. Without a recipe: one of the recipes that the robot reports cycles of.
fn is_shifted(monitor: &Monitor, robot: &str, recipe: Option<&str>) -> bool {
    monitor.recipes().filter(|(_, of)| of.level().is_some()).any(|(name, of)| match recipe {
        Some(recipe) => recipe == name,
        None => of.robots().any(|(known, _)| known == robot),
    })
}
