//! One episode of a page.

use base64ct::{Base64, Encoding};
use robogate_core::{ContactBetween, Frame, Pose, Trajectory};
use serde::Serialize;

use crate::pack::{Packer, quantised};
use crate::{Clock, Mark, Recording, Signal};

/// The unit of positions, in metres.
const LENGTH_UNIT: f64 = 1e-4;
/// The unit of the numbers of a quaternion.
const QUATERNION_UNIT: f64 = 1.0 / 8192.0;
/// The unit of forces, in newtons.
const FORCE_UNIT: f64 = 0.1;
/// The unit of times, in seconds.
const TIME_UNIT: f64 = 1e-3;
/// The number of steps between the smallest and the largest value of a signal.
const SIGNAL_STEPS: f64 = 4000.0;
/// The largest number of contact points of a frame.
const MAX_CONTACTS: usize = 8;

/// An episode with its labels on a page.
#[derive(Debug, Clone)]
pub struct Clip {
    /// The name of the episode.
    pub title: String,
    /// The outcome as text.
    pub outcome: String,
    /// Whether the episode succeeded.
    pub success: bool,
    /// The parameters as names and values with units.
    pub parameters: Vec<(String, String)>,
    /// The command that replays the episode.
    pub command: String,
    /// The recorded episode.
    pub recording: Recording,
    /// Images, in order of time, of an episode without the motion of its bodies.
    pub film: Vec<FilmFrame>,
}

/// An image of an episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilmFrame {
    /// Simulated time, in milliseconds.
    pub time_ms: u32,
    /// The image as JPEG.
    pub jpeg: Vec<u8>,
}

/// A clip in the document of a reel.
#[derive(Debug, Serialize)]
pub(crate) struct ClipDocument<'a> {
    title: &'a str,
    outcome: &'a str,
    success: bool,
    time_s: f64,
    /// The bodies that decided the outcome by their contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    contact: Option<String>,
    parameters: &'a [(String, String)],
    command: &'a str,
    phases: Vec<MarkDocument<'a>>,
    events: Vec<MarkDocument<'a>>,
    signals: Vec<SignalDocument<'a>>,
    /// Images as times and base64.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    film: Vec<(f64, String)>,
    /// Indices of the solids in the reel.
    pub(crate) solids: Vec<usize>,
    bodies: usize,
    frames: usize,
    ticks: usize,
    /// Units of lengths (m), quaternions, forces (N) and times (s) in the stream.
    units: [f64; 4],
    /// The packed stream: frame times, poses, contacts, tick times, signals.
    data: String,
}

#[derive(Debug, Serialize)]
struct MarkDocument<'a> {
    t: f64,
    what: &'a str,
}

#[derive(Debug, Serialize)]
struct SignalDocument<'a> {
    name: &'a str,
    unit: &'a str,
    /// Whether the values belong to frames instead of control periods.
    frames: bool,
    low: f64,
    high: f64,
}

impl Clip {
    pub(crate) fn document(&self) -> ClipDocument<'_> {
        let recording = &self.recording;
        let empty = Trajectory::default();
        let trajectory = recording.trajectory.as_ref().unwrap_or(&empty);
        let mut packer = Packer::default();
        motion(&mut packer, trajectory);
        packer.steps(recording.tick_s.iter().map(|time| quantised(*time, TIME_UNIT)));
        recording.signals.iter().for_each(|signal| signal_values(&mut packer, signal));
        let contact = recording.episode.contact.as_ref();
        ClipDocument {
            title: &self.title,
            outcome: &self.outcome,
            success: self.success,
            time_s: rounded(recording.episode.time_s),
            contact: contact.map(|c| format!("{} touched {} with {:.1} N", c.robot_body, c.other_body, c.force_n)),
            parameters: &self.parameters,
            command: &self.command,
            phases: recording.phases.iter().map(mark).collect(),
            events: recording.events.iter().map(mark).collect(),
            signals: recording.signals.iter().map(signal_document).collect(),
            film: self
                .film
                .iter()
                .map(|frame| (f64::from(frame.time_ms) / 1e3, Base64::encode_string(&frame.jpeg)))
                .collect(),
            solids: Vec::new(),
            bodies: trajectory.bodies.len(),
            frames: trajectory.frames.len(),
            ticks: recording.tick_s.len(),
            units: [LENGTH_UNIT, QUATERNION_UNIT, FORCE_UNIT, TIME_UNIT],
            data: packer.finish(),
        }
    }
}

fn mark(mark: &Mark) -> MarkDocument<'_> {
    MarkDocument { t: rounded(mark.time_s), what: &mark.what }
}

/// A time without the digits that carry no information.
fn rounded(time_s: f64) -> f64 {
    (time_s * 1e3).round() / 1e3
}

fn motion(packer: &mut Packer, trajectory: &Trajectory) {
    let frames = &trajectory.frames;
    packer.steps(frames.iter().map(|frame| quantised(frame.time_s, TIME_UNIT)));
    for body in 0..trajectory.bodies.len() {
        let mut series: [Vec<i64>; 7] = Default::default();
        let mut last = [1.0, 0.0, 0.0, 0.0];
        for frame in frames {
            let Pose { position, mut orientation } = frame.poses.get(body).copied().unwrap_or(Pose::IDENTITY);
            // A quaternion and its negative are the same rotation; the one nearer to the last frame is smooth.
            if orientation.iter().zip(&last).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
                orientation = orientation.map(|x| -x);
            }
            last = orientation;
            for (to, x) in series.iter_mut().zip(position) {
                to.push(quantised(x, LENGTH_UNIT));
            }
            for (to, x) in series[3..].iter_mut().zip(orientation) {
                to.push(quantised(x, QUATERNION_UNIT));
            }
        }
        series.into_iter().for_each(|values| packer.smooth(values));
    }
    frames.iter().for_each(|frame| contacts(packer, frame));
}

fn contacts(packer: &mut Packer, frame: &Frame) {
    let mut points: Vec<_> = frame.contacts.iter().collect();
    let square = |force: [f64; 3]| force.iter().map(|x| x * x).sum::<f64>();
    points.sort_by(|a, b| square(b.force_n).total_cmp(&square(a.force_n)));
    points.truncate(MAX_CONTACTS);
    packer.integer(points.len() as i64);
    for point in points {
        packer.integer(match point.between {
            ContactBetween::RobotAndObject => 0,
            ContactBetween::RobotAndSurroundings => 1,
            ContactBetween::ObjectAndSurroundings => 2,
        });
        point.position.into_iter().for_each(|x| packer.integer(quantised(x, LENGTH_UNIT)));
        point.force_n.into_iter().for_each(|x| packer.integer(quantised(x, FORCE_UNIT)));
    }
}

/// The smallest and the largest value.
fn limits(signal: &Signal) -> [f64; 2] {
    let known = signal.values.iter().flatten();
    let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
    if low <= high { [low, high] } else { [0.0, 0.0] }
}

fn signal_document(signal: &Signal) -> SignalDocument<'_> {
    let [low, high] = limits(signal);
    SignalDocument { name: &signal.name, unit: &signal.unit, frames: signal.clock == Clock::Frames, low, high }
}

/// Adds the values of a signal: 0 for a missing value, otherwise 1 plus the step between the limits.
fn signal_values(packer: &mut Packer, signal: &Signal) {
    let [low, high] = limits(signal);
    let unit = if high > low { (high - low) / SIGNAL_STEPS } else { 1.0 };
    packer.steps(signal.values.iter().map(|value| value.map_or(0, |x| 1 + quantised(x - low, unit))));
}
