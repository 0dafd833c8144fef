//! Control periods of several robots, as they are reported: warnings, and what became of the episodes.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::SignalKind;
use serde::{Deserialize, Serialize};

use super::detector::{Detector, Warner};
use super::file::{KnownParameter, WarnFile};
use super::tally::Tally;
use super::train::WarnError;
use crate::{LONGEST_NAME, ParameterValue};

/// The most robots.
pub const MOST_ROBOTS: usize = 256;
/// The end of an episode that a warning stopped.
const STOPPED: &str = "stopped";

/// One control period of a robot, before its action is executed, or the start or end of an episode: one JSON object.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Period {
    /// The robot.
    #[serde(default)]
    pub robot: String,
    /// The work of the robot, as in a [`crate::Cycle`]. It holds until another one is named.
    #[serde(default)]
    pub recipe: Option<String>,
    /// Starts an episode: the parameters that are known before it.
    pub start: Option<BTreeMap<String, ParameterValue>>,
    /// The start of the episode, in seconds since 1970-01-01 UTC.
    #[serde(default)]
    pub started_s: Option<f64>,
    /// Time of the observation since the start of the episode, in seconds.
    pub time_s: Option<f64>,
    /// The observed vectors, by name.
    #[serde(default)]
    pub observation: BTreeMap<String, Vec<f64>>,
    /// The command, by its kind.
    #[serde(default)]
    pub command: BTreeMap<String, Vec<f64>>,
    /// The command of the gripper.
    pub gripper: Option<f64>,
    /// Ends the episode: `success`, the failure mode, or `stopped` if a warning stopped it.
    pub end: Option<String>,
}

/// Something that a feed says.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum FeedEvent {
    /// A warning.
    Warning {
        /// The robot.
        robot: String,
        /// The warning.
        warning: Warning,
    },
    /// The end of an episode.
    Ended {
        /// The robot.
        robot: String,
        /// As in [`Period::end`].
        end: String,
        /// Whether it was warned.
        warned: bool,
        /// Time from the warning to the last control period, in seconds.
        lead_s: Option<f64>,
    },
    /// Warnings are suspended from now on.
    Suspended {
        /// The reason.
        suspended: &'static str,
        /// The counts.
        episodes: Tally,
    },
}

/// A warning within an episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Warning {
    /// Time since the start of the episode, in seconds.
    pub time_s: f64,
    /// The score.
    pub score: Option<f64>,
}

/// A control period that does not fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FeedError {
    /// Too many robots.
    #[error("more than {MOST_ROBOTS} robots")]
    Robots,
    /// A name that is too long.
    #[error("`robot`, `recipe` and `end` must have at most {LONGEST_NAME} bytes and no control characters")]
    Name,
    /// A time before that of the last control period.
    #[error("time_s is {time_s} after {last_s}: the time of an episode grows, and `start` begins another")]
    Time {
        /// The time.
        time_s: f64,
        /// That of the last control period.
        last_s: f64,
    },
    /// A vector with another number of numbers.
    #[error("{name}: {found} numbers. Expected {expected}")]
    Length {
        /// The vector.
        name: String,
        /// The numbers that it has.
        found: usize,
        /// The numbers of the task.
        expected: usize,
    },
    /// A vector that is not given.
    #[error("{0} is missing")]
    Missing(String),
    /// An end without a control period before it.
    #[error("`end` without a control period of the episode: it is not counted")]
    Unstarted,
}

#[derive(Debug)]
struct Robot {
    warner: Warner<Arc<Detector>>,
    recipe: Option<String>,
    /// The start of this episode, in seconds since 1970, if it was given.
    started_s: Option<f64>,
    /// Time of the last control period of this episode. `None` before the first.
    last_s: Option<f64>,
}

impl Robot {
    fn start(&mut self, parameters: &[f64]) {
        self.warner.start(parameters);
        (self.last_s, self.started_s) = (None, None);
    }
}

/// The robots and what became of their episodes.
#[derive(Debug)]
pub struct Feed {
    file: WarnFile,
    detector: Arc<Detector>,
    robots: BTreeMap<String, Robot>,
    tally: Tally,
    row: Vec<f32>,
}

impl Feed {
    /// A feed without robots.
    ///
    /// # Errors
    /// A damaged detector.
    pub fn new(file: WarnFile) -> Result<Self, WarnError> {
        let detector = Arc::new(file.detector()?);
        let row = vec![f32::NAN; file.features.signals.width()];
        Ok(Self { detector, robots: BTreeMap::new(), tally: Tally::new(file.calibration.promised), row, file })
    }

    /// The counts of the episodes.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// The same feed with the counts of earlier episodes.
    #[must_use]
    pub fn with_tally(self, tally: Tally) -> Self {
        Self { tally, ..self }
    }

    /// The file of the detector.
    pub fn file(&self) -> &WarnFile {
        &self.file
    }

    /// The robots in an episode, and all that were seen.
    pub fn robots(&self) -> (usize, usize) {
        (self.robots.values().filter(|robot| robot.last_s.is_some()).count(), self.robots.len())
    }

    /// The recipe that a robot named last.
    pub fn recipe_of(&self, robot: &str) -> Option<&str> {
        self.robots.get(robot)?.recipe.as_deref()
    }

    /// The start of the episode of a robot, in seconds since 1970. `None` if it was not given.
    pub fn started_s(&self, robot: &str) -> Option<f64> {
        self.robots.get(robot)?.started_s
    }

    /// Takes a control period, and calls `say` with what follows.
    ///
    /// # Errors
    /// A period that does not fit. The others of the robot are not affected.
    pub fn hear(&mut self, period: &Period, say: &mut dyn FnMut(FeedEvent)) -> Result<(), FeedError> {
        let names = [Some(&period.robot), period.recipe.as_ref(), period.end.as_ref()];
        let fits = |name: &&String| name.len() <= LONGEST_NAME && !name.chars().any(char::is_control);
        if !names.iter().flatten().all(fits) {
            return Err(FeedError::Name);
        }
        if !self.robots.contains_key(&period.robot) {
            if self.robots.len() >= MOST_ROBOTS {
                return Err(FeedError::Robots);
            }
            let warner = Warner::new(Arc::clone(&self.detector), self.file.calibration.threshold);
            self.robots.insert(period.robot.clone(), Robot { warner, recipe: None, started_s: None, last_s: None });
        }
        let Self { file, robots, tally, row, .. } = self;
        let Some(robot) = robots.get_mut(&period.robot) else { return Ok(()) };
        if let Some(recipe) = &period.recipe {
            robot.recipe = Some(recipe.clone());
        }
        if let Some(parameters) = &period.start {
            let values: Vec<f64> = file.known.iter().map(|of| number(of, parameters)).collect();
            robot.start(&values);
        }
        robot.started_s = period.started_s.or(robot.started_s);
        if let Some(time_s) = period.time_s {
            if let Some(last_s) = robot.last_s.filter(|last_s| time_s <= *last_s) {
                return Err(FeedError::Time { time_s, last_s });
            }
            write(file, period, row)?;
            robot.last_s = Some(time_s);
            let before = robot.warner.warned_s();
            let score = robot.warner.observe(time_s as f32, row);
            if before != robot.warner.warned_s() && !tally.suspended {
                say(FeedEvent::Warning { robot: period.robot.clone(), warning: Warning { time_s, score } });
            }
        }
        if let Some(end) = &period.end {
            let last_s = robot.last_s.ok_or(FeedError::Unstarted)?;
            let warned = robot.warner.warned_s();
            // Times of warnings are rounded to single precision.
            let lead_s = warned.map(|at_s| (last_s - f64::from(at_s)).max(0.0));
            let begins = match end.as_str() {
                STOPPED => {
                    tally.stopped += 1;
                    false
                }
                outcome => tally.ended(outcome == "success", warned.is_some()),
            };
            let warned = warned.is_some();
            say(FeedEvent::Ended { robot: period.robot.clone(), end: end.clone(), warned, lead_s });
            if begins {
                let suspended =
                    "more successes are warned than promised: engine, policy or population differ from the calibration";
                say(FeedEvent::Suspended { suspended, episodes: *tally });
            }
            robot.start(&[]);
        }
        Ok(())
    }
}

/// Writes the row of a control period.
fn write(file: &WarnFile, period: &Period, row: &mut [f32]) -> Result<(), FeedError> {
    for (at, group) in file.features.signals.places() {
        let values = match group.kind {
            SignalKind::Observation => period.observation.get(&group.name).map(Vec::as_slice),
            SignalKind::Command => period.command.get(&group.name).map(Vec::as_slice),
            SignalKind::Gripper => period.gripper.as_ref().map(std::slice::from_ref),
        };
        let to = &mut row[at..at + group.length];
        match values {
            Some(values) if values.len() == group.length => {
                to.iter_mut().zip(values).for_each(|(to, x)| *to = *x as f32);
            }
            Some(values) => {
                let (name, found, expected) = (group.name.clone(), values.len(), group.length);
                return Err(FeedError::Length { name, found, expected });
            }
            // A task may accept several kinds of command, of which a policy uses one.
            None if group.kind == SignalKind::Command && !period.command.is_empty() => to.fill(f32::NAN),
            None => return Err(FeedError::Missing(group.name.clone())),
        }
    }
    Ok(())
}

/// A parameter of the episode as a number, NaN if it is not given.
fn number(of: &KnownParameter, given: &BTreeMap<String, ParameterValue>) -> f64 {
    match given.get(&of.name) {
        Some(ParameterValue::Word(word)) => of.number_of(word),
        Some(ParameterValue::Number(x)) => *x,
        None => f64::NAN,
    }
}
