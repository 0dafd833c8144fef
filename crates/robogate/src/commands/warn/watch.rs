//! `robogate warn watch`: warns in episodes that run now.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::SignalKind;
use robogate_monitor::warn::{Detector, KnownParameter, Tally, WarnFile, Warner};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{foreign, line, note};

/// The longest line, and the most robots.
const LONGEST_LINE: u64 = 1 << 20;
const MOST_ROBOTS: usize = 256;
/// Rejected lines that are shown.
const SHOWN: u64 = 10;

/// Warn in episodes that run now: read their control periods as JSON Lines, and write warnings as JSON Lines.
///
/// A line is one control period, before its action is executed: {"robot": "cell-1", "time_s": 0.05, "observation": {NAME: [...]},
/// "command": {KIND: [...]}, "gripper": 1.0}. {"robot": "cell-1", "start": {PARAMETER: VALUE}} starts an episode, and "end" with success, the
/// failure mode, or stopped ends it. docs/guides/warn.md has the names and units.
///
/// Warnings are suspended when the successes so far contradict the promise. Exit codes: 0, or 2 if a line was rejected.
#[derive(Debug, Args)]
pub(super) struct Watch {
    /// Detector of `robogate warn train`
    file: PathBuf,
    /// File or pipe to read; default: stdin
    input: Option<PathBuf>,
}

/// A line of the input.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    #[serde(default)]
    robot: String,
    start: Option<BTreeMap<String, Value>>,
    time_s: Option<f64>,
    #[serde(default)]
    observation: BTreeMap<String, Vec<f64>>,
    #[serde(default)]
    command: BTreeMap<String, Vec<f64>>,
    gripper: Option<f64>,
    end: Option<String>,
}

/// A robot.
struct Robot<'a> {
    warner: Warner<'a>,
    /// Time of the last control period of this episode. `None` before the first.
    last_s: Option<f64>,
}

impl Robot<'_> {
    /// Starts an episode with these parameters.
    fn start(&mut self, parameters: &[f64]) {
        self.warner.start(parameters);
        self.last_s = None;
    }
}

impl Watch {
    pub(super) fn execute(&self) -> Result<u8, Exit> {
        let file = super::read(&self.file)?;
        let detector = file.detector().or_usage()?;
        let mut input: Box<dyn BufRead> = match &self.input {
            Some(path) => {
                let opened = File::open(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
                Box::new(BufReader::new(opened))
            }
            None => Box::new(std::io::stdin().lock()),
        };
        let mut feed = Feed {
            file: &file,
            detector: &detector,
            robots: BTreeMap::new(),
            tally: Tally::new(file.calibration.promised),
            row: vec![f32::NAN; file.features.signals.width()],
        };
        let (mut number, mut rejected) = (0_u64, 0_u64);
        let mut text = Vec::new();
        loop {
            text.clear();
            let read = input.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut text).or_broken()?;
            if read == 0 {
                break;
            }
            number += 1;
            if text.trim_ascii().is_empty() {
                continue;
            }
            let heard = serde_json::from_slice(&text).map_err(anyhow::Error::from).and_then(|given| feed.hear(given));
            if let Err(why) = heard {
                rejected += 1;
                if rejected <= SHOWN {
                    note(format_args!("line {number} is rejected: {}", foreign(format!("{why:#}"))));
                }
            }
        }
        line(json!({ "episodes": feed.tally, "rejected_lines": rejected }));
        if rejected > 0 {
            note("Hint: docs/guides/warn.md describes the lines");
        }
        Ok(if rejected > 0 { USAGE } else { DONE })
    }
}

/// The robots and what became of their episodes.
struct Feed<'a> {
    file: &'a WarnFile,
    detector: &'a Detector,
    robots: BTreeMap<String, Robot<'a>>,
    tally: Tally,
    row: Vec<f32>,
}

impl Feed<'_> {
    fn hear(&mut self, given: Given) -> anyhow::Result<()> {
        let Given { robot: name, start, time_s, observation, command, gripper, end } = given;
        if !self.robots.contains_key(&name) {
            if self.robots.len() >= MOST_ROBOTS {
                return Err(anyhow!("more than {MOST_ROBOTS} robots"));
            }
            let warner = Warner::new(self.detector, self.file.calibration.threshold);
            self.robots.insert(name.clone(), Robot { warner, last_s: None });
        }
        let Some(robot) = self.robots.get_mut(&name) else { return Ok(()) };
        if let Some(parameters) = start {
            let values: Vec<f64> = self.file.known.iter().map(|of| value(of, &parameters)).collect();
            robot.start(&values);
        }
        if let Some(time_s) = time_s {
            if let Some(last_s) = robot.last_s.filter(|last_s| time_s <= *last_s) {
                return Err(anyhow!(
                    "time_s is {time_s} after {last_s}: the time of an episode grows, and `start` begins another"
                ));
            }
            for (at, group) in self.file.features.signals.places() {
                let values = match group.kind {
                    SignalKind::Observation => observation.get(&group.name).map(Vec::as_slice),
                    SignalKind::Command => command.get(&group.name).map(Vec::as_slice),
                    SignalKind::Gripper => gripper.as_ref().map(std::slice::from_ref),
                };
                let to = &mut self.row[at..at + group.length];
                match values {
                    Some(values) if values.len() == group.length => {
                        to.iter_mut().zip(values).for_each(|(to, x)| *to = *x as f32);
                    }
                    Some(values) => {
                        return Err(anyhow!("{}: {} numbers. Expected {}", group.name, values.len(), group.length));
                    }
                    // A task may accept several kinds of command, of which a policy uses one.
                    None if group.kind == SignalKind::Command && !command.is_empty() => to.fill(f32::NAN),
                    None => return Err(anyhow!("{} is missing", group.name)),
                }
            }
            robot.last_s = Some(time_s);
            let before = robot.warner.warned_s();
            let score = robot.warner.observe(time_s as f32, &self.row);
            if before != robot.warner.warned_s() && !self.tally.suspended {
                line(json!({ "robot": name, "warning": { "time_s": time_s, "score": score } }));
            }
        }
        if let Some(end) = end {
            let Some(last_s) = robot.last_s else {
                return Err(anyhow!("`end` without a control period of the episode: it is not counted"));
            };
            let warned = robot.warner.warned_s();
            let lead_s = warned.map(|at_s| last_s - f64::from(at_s));
            let begins = match end.as_str() {
                "stopped" => {
                    self.tally.stopped += 1;
                    false
                }
                outcome => self.tally.ended(outcome == "success", warned.is_some()),
            };
            line(json!({ "robot": name, "end": end, "warned": warned.is_some(), "lead_s": lead_s }));
            if begins {
                line(json!({
                    "suspended": "more successes are warned than promised: engine, policy or population differ from the calibration",
                    "episodes": self.tally,
                }));
            }
            robot.start(&[]);
        }
        Ok(())
    }
}

/// A parameter of the episode as a number, NaN if it is not given.
fn value(of: &KnownParameter, given: &BTreeMap<String, Value>) -> f64 {
    match given.get(&of.name) {
        Some(Value::String(word)) => of.number_of(word),
        Some(value) => value.as_f64().unwrap_or(f64::NAN),
        None => f64::NAN,
    }
}
