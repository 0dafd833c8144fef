//! What a detector computes from the rows of an episode.
//!
//! For each number of a row: its value and its change over 0.3 s and 1 s. For each vector: its speed (the norm of the change per
//! second), the mean of the speed over 1 s and the distance moved within 1 s. For each command: its bend (the largest second
//! difference of a number), with the mean and the largest bend of the last 0.8 s. For joint commands: the largest following
//! error (command minus measured joint position) and its mean over 0.5 s. Then the clock: time since the start, the phase
//! (number of switches of the gripper's command so far) and the time since it began. The time is never divided by the duration
//! of the episode, which is unknown while it runs.

use robogate_core::{SignalKind, Signals, vectors};
use serde::{Deserialize, Serialize};

/// The time between two evaluations, in seconds, for tasks with shorter control periods.
const PERIOD_S: f64 = 0.05;
/// The time over which short and long changes are taken, in seconds.
const SHORT_S: f64 = 0.3;
const LONG_S: f64 = 1.0;
/// The time over which bends and following errors are averaged, in seconds.
const BENDS_S: f64 = 0.8;
const FOLLOWING_S: f64 = 0.5;
/// The longest history, in evaluations.
const LONGEST: usize = 64;
/// The largest number of numbers of a row whose changes are used. Larger rows have their values and their vectors only.
const MOST_CHANGES: usize = 96;
/// The largest number of numbers in a row.
pub const MOST_SIGNALS: usize = 256;
/// The last phase; later switches of the gripper belong to it.
pub const LAST_PHASE: usize = 4;

/// The columns of a detector: which numbers it computes from the rows of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// The order of the numbers of a row.
    pub signals: Signals,
    /// Parameters of the scenario that are known before the episode. Their values follow the computed numbers.
    #[serde(default)]
    pub parameters: Vec<String>,
}

/// Where the series of a vector begins among all series.
#[derive(Debug, Clone, Copy)]
struct Group {
    at: usize,
    /// The number of numbers that move together: of a pose, the position.
    moving: usize,
    length: usize,
    command: bool,
}

/// The history of one episode, and the numbers of its last evaluation.
#[derive(Debug, Clone)]
pub struct Window {
    groups: Vec<Group>,
    /// The command of the joints and their measured positions: places and length.
    follows: Option<[usize; 3]>,
    gripper: Option<(usize, f32)>,
    width: usize,
    changes: bool,
    stride: u32,
    period_s: f32,
    lags: [usize; 2],
    bends: usize,
    following: usize,
    size: usize,
    /// The last rows, `size` of them.
    rows: Vec<f32>,
    /// The last values of each series (speeds, bends, following error), `size` of each.
    series: Vec<f32>,
    /// Rows that were given, and evaluations.
    given: u32,
    done: usize,
    phase: usize,
    since_s: f32,
    closes: Option<bool>,
    out: Vec<f64>,
    parameters: usize,
}

/// The clock of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Time since the start, in seconds.
    pub time_s: f32,
    /// Number of switches of the gripper so far, at most [`LAST_PHASE`]; one more if it was closed at the start.
    pub phase: usize,
    /// Time since the last switch, in seconds.
    pub in_phase_s: f32,
}

impl Features {
    /// How many rows one evaluation takes.
    pub fn stride(&self) -> u32 {
        (PERIOD_S / self.signals.period_s.max(1e-4)).round().clamp(1.0, 1e3) as u32
    }

    /// The names of the columns, in order.
    pub fn names(&self) -> Vec<String> {
        let (mut names, window) = (Vec::new(), Window::new(self));
        for (_, group) in self.signals.places() {
            let number = |i: usize| if group.length == 1 { group.name.clone() } else { format!("{}[{i}]", group.name) };
            for i in 0..group.length {
                names.push(number(i));
                if window.changes {
                    names.push(format!("change of {} in {SHORT_S} s", number(i)));
                    names.push(format!("change of {} in {LONG_S} s", number(i)));
                }
            }
            if group.kind == SignalKind::Gripper {
                continue;
            }
            let of = &group.name;
            names.extend([
                format!("speed of {of}"),
                format!("mean speed of {of}"),
                format!("way of {of} in {LONG_S} s"),
            ]);
            if group.kind == SignalKind::Command {
                names.extend(["bend", "mean bend", "largest bend"].map(|what| format!("{what} of {of}")));
            }
        }
        if window.follows.is_some() {
            names.extend(["following error", "mean following error"].map(str::to_owned));
        }
        names.extend(["gripper closes", "phase", "time in phase", "time"].map(str::to_owned));
        names.extend(self.parameters.iter().cloned());
        names
    }

    /// The number of columns of the clock and of parameters, which are the last ones.
    pub(crate) fn clocks(&self) -> usize {
        4 + self.parameters.len()
    }
}

impl Window {
    /// An empty history. This is the only allocation.
    pub fn new(features: &Features) -> Self {
        let signals = &features.signals;
        let place = |kind: SignalKind, name: &str| {
            signals.places().find(|(_, of)| of.kind == kind && of.name == name).map(|(at, of)| (at, of.length))
        };
        let groups: Vec<Group> = signals
            .places()
            .filter(|(_, of)| of.kind != SignalKind::Gripper)
            .map(|(at, of)| {
                let pose = of.kind == SignalKind::Observation && of.name == vectors::TOOL_POSE.as_str();
                let moving = if pose { of.length.min(3) } else { of.length };
                Group { at, moving, length: of.length, command: of.kind == SignalKind::Command }
            })
            .collect();
        let command = place(SignalKind::Command, "joint_position");
        let measured = place(SignalKind::Observation, vectors::JOINT_POSITIONS.as_str());
        let follows = match (command, measured) {
            (Some((command, length)), Some((measured, same))) if length == same => Some([command, measured, length]),
            _ => None,
        };
        let gripper = signals.gripper().map(|(at, above)| (at, above as f32));
        let stride = features.stride();
        let period_s = signals.period_s * f64::from(stride);
        let steps = |seconds: f64| ((seconds / period_s.max(1e-4)).round() as usize).clamp(1, LONGEST);
        let (width, size) = (signals.width(), steps(LONG_S) + 1);
        let series = groups.len() + groups.iter().filter(|group| group.command).count() + 1;
        let mut window = Self {
            groups,
            follows,
            gripper,
            width,
            changes: width <= MOST_CHANGES,
            stride,
            period_s: period_s as f32,
            lags: [SHORT_S, LONG_S].map(steps),
            bends: steps(BENDS_S),
            following: steps(FOLLOWING_S),
            size,
            rows: vec![0.0; size * width],
            series: vec![0.0; size * series],
            given: 0,
            done: 0,
            phase: 0,
            since_s: 0.0,
            closes: None,
            out: Vec::new(),
            parameters: features.parameters.len(),
        };
        // The number of columns does not depend on the values.
        window.out = Vec::with_capacity(3 * width + 6 * window.groups.len() + 6 + window.parameters);
        window
    }

    /// Forgets the last episode and takes the parameters of the next one.
    pub fn start(&mut self, parameters: &[f64]) {
        (self.given, self.done, self.phase, self.since_s, self.closes) = (0, 0, 0, 0.0, None);
        // The parameters wait at the end of the columns.
        self.out.clear();
        self.out.extend(parameters.iter().take(self.parameters));
        self.out.resize(self.parameters, f64::NAN);
    }

    /// Takes the row of a control period. Returns the columns if this is one in which the detector is evaluated.
    pub fn push(&mut self, time_s: f32, row: &[f32]) -> Option<(Moment, &[f64])> {
        self.given += 1;
        // The last row of each stride: a detector waits for a whole one.
        if row.len() != self.width || !self.given.is_multiple_of(self.stride) {
            return None;
        }
        let now = self.done % self.size;
        self.rows[now * self.width..][..self.width].copy_from_slice(row);
        self.done += 1;
        let closes = self.gripper.map(|(at, above)| row[at] > above);
        if self.closes != closes && (self.closes.is_some() || closes == Some(true)) {
            self.phase = (self.phase + 1).min(LAST_PHASE);
            self.since_s = time_s;
        }
        self.closes = closes;
        let moment = Moment { time_s, phase: self.phase, in_phase_s: time_s - self.since_s };
        self.compute(moment);
        Some((moment, &self.out))
    }

    /// The row some evaluations ago, or the first one.
    fn before(&self, lag: usize) -> &[f32] {
        let at = (self.done - 1 - lag.min(self.done - 1)) % self.size;
        &self.rows[at * self.width..][..self.width]
    }

    /// The mean and the largest value of a series over the last `steps` evaluations.
    fn mean_and_largest(&self, series: usize, steps: usize) -> (f64, f64) {
        let n = steps.min(self.done).min(self.size).max(1);
        let (mut sum, mut largest) = (0.0, f32::NEG_INFINITY);
        for lag in 0..n {
            let x = self.series[series * self.size + (self.done - 1 - lag) % self.size];
            sum += x;
            largest = largest.max(x);
        }
        (f64::from(sum) / n as f64, f64::from(largest))
    }

    fn keep(&mut self, series: usize, value: f32) {
        let at = series * self.size + (self.done - 1) % self.size;
        self.series[at] = value;
    }

    fn compute(&mut self, moment: Moment) {
        // The parameters are moved to the end of the new columns, within the capacity.
        let mut out = std::mem::take(&mut self.out);
        let known = out.len() - self.parameters;
        out.drain(..known);
        let mut series = 0;
        for g in 0..self.groups.len() {
            let Group { at, moving, length, command } = self.groups[g];
            self.numbers(at, length, &mut out);
            let [last, long] = [1, self.lags[1]].map(|lag| distance(self.before(0), self.before(lag), at, moving));
            let speed = if self.done > 1 { last / self.period_s } else { 0.0 };
            self.keep(series, speed);
            let (mean, _) = self.mean_and_largest(series, self.lags[1]);
            out.extend([f64::from(speed), mean, f64::from(long)]);
            series += 1;
            if command {
                let [a, b, c] = [0, 1, 2].map(|lag| &self.before(lag)[at..at + length]);
                let bends = (0..length).map(|i| (a[i] - 2.0 * b[i] + c[i]).abs());
                let bend = bends.filter(|x| x.is_finite()).fold(0.0, f32::max);
                self.keep(series, bend);
                let (mean, largest) = self.mean_and_largest(series, self.bends);
                out.extend([f64::from(bend), mean, largest]);
                series += 1;
            }
        }
        if let Some((at, _)) = self.gripper.filter(|(at, _)| self.groups.iter().all(|of| *at >= of.at + of.length)) {
            self.numbers(at, 1, &mut out);
        }
        if let Some([command, measured, length]) = self.follows {
            let row = self.before(0);
            let errors = (0..length).map(|i| (row[command + i] - row[measured + i]).abs());
            let error = errors.filter(|x| x.is_finite()).fold(0.0, f32::max);
            self.keep(series, error);
            out.extend([f64::from(error), self.mean_and_largest(series, self.following).0]);
        }
        let closes = self.closes.map_or(f64::NAN, |closes| f64::from(u8::from(closes)));
        out.extend([closes, moment.phase as f64, f64::from(moment.in_phase_s), f64::from(moment.time_s)]);
        out.rotate_left(self.parameters);
        self.out = out;
    }

    /// The numbers at a place with their changes.
    fn numbers(&self, at: usize, length: usize, out: &mut Vec<f64>) {
        let [now, short, long] = [0, self.lags[0], self.lags[1]].map(|lag| &self.before(lag)[at..at + length]);
        for i in 0..length {
            out.push(f64::from(now[i]));
            if self.changes {
                out.extend([f64::from(now[i] - short[i]), f64::from(now[i] - long[i])]);
            }
        }
    }

    /// Bytes of this history.
    pub fn bytes(&self) -> usize {
        4 * (self.rows.len() + self.series.len()) + 8 * self.out.capacity()
    }
}

/// The distance between two rows in these numbers, without those that are missing.
fn distance(a: &[f32], b: &[f32], at: usize, length: usize) -> f32 {
    let squares = a[at..at + length].iter().zip(&b[at..at + length]).map(|(a, b)| (a - b) * (a - b));
    squares.filter(|x| x.is_finite()).sum::<f32>().sqrt()
}
