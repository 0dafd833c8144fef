//! The physics of an episode: the motion of all bodies, contacts and the solver, once for each control period.

use std::collections::BTreeMap;

use robogate_core::{ContactBetween, Trajectory};
use serde::Deserialize;

/// Numbers of a pose: x, y, z in metres, then the quaternion w, x, y, z.
const POSE: usize = 7;
/// The longest header, and the largest file.
const MOST_HEADER: usize = 4 << 20;
const MOST_BYTES: usize = 1 << 30;
/// What one radian of rotation counts as, in metres: the size of a small object.
const RADIAN_M: f64 = 0.1;
/// The first numbers of a frame: the count of contacts, and the depth of the deepest one in metres.
pub(super) const PENETRATION: &str = "penetration_m";
/// Iterations of the constraint solver.
pub(super) const ITERATIONS: &str = "solver_iterations";
/// Norm of the gradient of the constraint solver at its end.
pub(super) const RESIDUAL: &str = "solver_residual";
/// Warnings of the engine so far.
pub(super) const WARNINGS: &str = "warnings";

/// A body that moves.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Whether it belongs to the robot.
    pub robot: bool,
}

/// The physics of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// The names of the numbers before the poses.
    pub signals: Vec<String>,
    /// The bodies that can move.
    pub bodies: Vec<Part>,
    /// The pairs of things that touch in some frame.
    pub pairs: Vec<String>,
    /// The pose after the reset of everything that does not belong to the robot.
    pub start: BTreeMap<String, [f64; POSE]>,
    rows: Vec<f64>,
}

#[derive(Deserialize)]
struct Header {
    signals: Vec<String>,
    bodies: Vec<Part>,
    pairs: Vec<String>,
    frames: usize,
    start: BTreeMap<String, [f64; POSE]>,
}

impl Trace {
    /// Reads the file that the Python process of an environment writes: a line of JSON, then 64-bit floats.
    ///
    /// # Errors
    /// The reason why it is not such a file.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let end = bytes.iter().take(MOST_HEADER).position(|byte| *byte == b'\n').ok_or("no header")?;
        let (header, numbers) = bytes.split_at(end);
        let Header { signals, bodies, pairs, frames, start } =
            serde_json::from_slice(header).map_err(|why| why.to_string())?;
        let (chunks, rest) = numbers.get(1..).unwrap_or_default().as_chunks::<8>();
        let width = signals.len() + POSE * bodies.len() + pairs.len();
        if !rest.is_empty() || frames.checked_mul(width) != Some(chunks.len()) || bytes.len() > MOST_BYTES {
            return Err(format!("{} numbers. Expected {frames} rows of {width}", chunks.len()));
        }
        Ok(Self {
            signals,
            bodies,
            pairs,
            start,
            rows: chunks.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
        })
    }

    /// The trace of a recorded motion, whose last body is the object.
    pub fn of_motion(motion: &Trajectory) -> Self {
        let kinds = [
            (ContactBetween::RobotAndObject, "object and robot"),
            (ContactBetween::RobotAndSurroundings, "robot and surroundings"),
            (ContactBetween::ObjectAndSurroundings, "object and surroundings"),
        ];
        let bodies: Vec<Part> = motion
            .bodies
            .iter()
            .enumerate()
            .map(|(at, name)| Part { name: name.clone(), robot: at + 1 < motion.bodies.len() })
            .collect();
        let pose = |pose: &robogate_core::Pose| pose.to_array();
        let first = motion.frames.first().map_or(&[][..], |frame| &frame.poses);
        let others = bodies.iter().zip(first).filter(|(part, _)| !part.robot);
        let start = others.map(|(part, at)| (part.name.clone(), pose(at))).collect();
        let mut rows = Vec::new();
        for frame in &motion.frames {
            rows.push(frame.contacts.len() as f64);
            frame.poses.iter().for_each(|of| rows.extend(pose(of)));
            rows.extend(kinds.map(|(kind, _)| f64::from(frame.contacts.iter().any(|contact| contact.between == kind))));
        }
        let pairs = kinds.map(|(_, name)| name.to_owned()).to_vec();
        Self { signals: vec!["contacts".to_owned()], bodies, pairs, start, rows }
    }

    fn width(&self) -> usize {
        self.signals.len() + POSE * self.bodies.len() + self.pairs.len()
    }

    /// The frames, the first of which is the start.
    pub fn frames(&self) -> usize {
        self.rows.len() / self.width().max(1)
    }

    fn row(&self, frame: usize) -> &[f64] {
        let width = self.width();
        self.rows.get(frame * width..(frame + 1) * width).unwrap_or_default()
    }

    /// The finite values of a signal.
    pub(super) fn signal(&self, name: &str) -> Option<Vec<f64>> {
        let at = self.signals.iter().position(|signal| signal == name)?;
        let values = (0..self.frames()).filter_map(|frame| self.row(frame).get(at).copied());
        Some(values.filter(|value| value.is_finite()).collect::<Vec<f64>>()).filter(|values| !values.is_empty())
    }

    /// The pose of a body in a frame.
    pub(super) fn pose(&self, frame: usize, body: usize) -> [f64; POSE] {
        let from = self.signals.len() + POSE * body;
        self.row(frame).get(from..from + POSE).and_then(|pose| pose.try_into().ok()).unwrap_or([0.0; POSE])
    }

    /// Whether a pair touches in a frame.
    pub(super) fn touches(&self, frame: usize, pair: usize) -> bool {
        self.row(frame).get(self.signals.len() + POSE * self.bodies.len() + pair).is_some_and(|touches| *touches > 0.0)
    }

    /// The first frame in which a pair touches of which this holds.
    pub(super) fn first_touch(&self, of: impl Fn(&str) -> bool) -> Option<usize> {
        let pairs: Vec<usize> = (0..self.pairs.len()).filter(|at| of(&self.pairs[*at])).collect();
        (0..self.frames()).find(|frame| pairs.iter().any(|pair| self.touches(*frame, *pair)))
    }

    /// The largest distance of a body from its start before this frame, in metres. Rotations count with the size of a small object.
    pub(super) fn travel(&self, body: usize, before: usize) -> f64 {
        let start = self.pose(0, body);
        (0..before.min(self.frames())).map(|frame| distance(&start, &self.pose(frame, body))).fold(0.0, f64::max)
    }
}

/// The distance of two poses in metres.
pub(super) fn distance(one: &[f64; POSE], two: &[f64; POSE]) -> f64 {
    let [x, y, z, ..] = *one;
    let [u, v, w, ..] = *two;
    (x - u).hypot(y - v).hypot(z - w) + RADIAN_M * angle(one, two)
}

/// The angle between two orientations, in radians.
pub(super) fn angle(one: &[f64; POSE], two: &[f64; POSE]) -> f64 {
    let cosine: f64 = one[3..].iter().zip(&two[3..]).map(|(a, b)| a * b).sum();
    2.0 * cosine.abs().min(1.0).acos()
}

/// The angle between the vertical axes of two orientations, in radians.
pub(super) fn tilt(one: &[f64; POSE], two: &[f64; POSE]) -> f64 {
    let up = |[_, _, _, w, x, y, z]: [f64; POSE]| {
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
    };
    up(*one).iter().zip(up(*two)).map(|(a, b)| a * b).sum::<f64>().clamp(-1.0, 1.0).acos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_checked() {
        let header = r#"{"signals":["contacts"],"bodies":[{"name":"cup","robot":false}],"pairs":["a and b"],"frames":1,"start":{}}"#;
        let mut bytes = format!("{header}\n").into_bytes();
        [2.0, 0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 1.0_f64].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        let trace = Trace::read(&bytes).unwrap();
        assert_eq!((trace.frames(), trace.pose(0, 0)[2], trace.touches(0, 0)), (1, 0.3, true));
        assert_eq!(trace.signal("contacts"), Some(vec![2.0]));
        assert!(Trace::read(&bytes[..bytes.len() - 1]).is_err() && Trace::read(b"{}").is_err());
    }

    #[test]
    fn rotations_about_the_vertical_do_not_tilt() {
        let half = 0.5_f64.sqrt();
        let (rest, turned, tipped) = (
            [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, half, 0.0, 0.0, half],
            [0.0, 0.0, 0.0, half, half, 0.0, 0.0],
        );
        assert!(tilt(&rest, &turned) < 1e-6 && (tilt(&rest, &tipped) - std::f64::consts::FRAC_PI_2).abs() < 1e-3);
        assert!((angle(&rest, &turned) - std::f64::consts::FRAC_PI_2).abs() < 1e-3);
    }
}
