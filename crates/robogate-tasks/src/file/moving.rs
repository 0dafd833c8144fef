//! Reads how bodies move: the joints of parts and the motions of fixtures.

use nalgebra::Vector3;
use robogate_physics::{Joint, JointKind, Motion, Thread};

use super::document::{Document, FixtureTable, JointTable, JointWord, Text};
use super::model::Reading;
use super::numbers::{Frame, Numbers};
use super::units::{Dimension, quantities};

/// The farthest stop of a screw, in radians: 30 turns.
const MOST_SCREW_RAD: f64 = 60.0 * std::f64::consts::PI;
/// How much the axis of a part may lean where a thread takes it up, if the file does not say it: 5 degrees.
const LEAN_RAD: f64 = std::f64::consts::PI / 36.0;

impl Reading<'_, '_> {
    fn axis(&mut self, text: &Text, word: &str) -> Vector3<f64> {
        match word {
            "x" => Vector3::x(),
            "y" => Vector3::y(),
            "z" => Vector3::z(),
            "-x" => -Vector3::x(),
            "-y" => -Vector3::y(),
            "-z" => -Vector3::z(),
            other => match quantities::<3>(other, Dimension::NONE).map(Vector3::from) {
                Ok(direction) if direction.norm() > 1e-6 => direction.normalize(),
                _ => {
                    let expected = "Expected x, y, z, -x, -y, -z, or three numbers such as `0, 0.6, 0.8`";
                    self.problems.of(text, format!("unknown axis `{other}`. {expected}"));
                    Vector3::z()
                }
            },
        }
    }

    /// How a fixture moves, in its frame.
    pub(super) fn motion(&mut self, table: &FixtureTable) -> Option<Motion> {
        let stated = [&table.belt, &table.shuttle, &table.turn].into_iter().flatten().collect::<Vec<_>>();
        if let [_, second, ..] = stated[..] {
            self.problems.of(second, "a second motion. Expected one of `belt`, `shuttle` and `turn`");
        }
        let text = *stated.first()?;
        let words: Vec<&str> = text.text.split(',').map(str::trim).collect();
        let direction = self.axis(text, words[0]);
        let mut take = |word: &str, dimension: Dimension, range: [f64; 2]| {
            let [value] = self.problems.take(text, quantities::<1>(word, dimension))?;
            if !(range[0]..=range[1]).contains(&value) {
                let (unit, [low, high]) = (dimension.unit(), range);
                self.problems.of(text, format!("`{word}` is out of range. Expected {low} to {high} {unit}"));
            }
            Some(value)
        };
        match (&table.belt, &table.shuttle, &words[1..]) {
            (Some(_), _, [speed]) => {
                Some(Motion::Belt { direction, speed_m_s: take(speed, Dimension::SPEED, [-2.0, 2.0])? })
            }
            (None, Some(_), [distance, speed]) => Some(Motion::Shuttle {
                direction,
                distance_m: take(distance, Dimension::LENGTH, [1e-3, 2.0])?,
                largest_speed_m_s: take(speed, Dimension::SPEED, [0.0, 2.0])?,
            }),
            (None, None, [speed]) => Some(Motion::Turn {
                axis: direction,
                anchor: Vector3::zeros(),
                speed_rad_s: take(speed, Dimension::TURNING, [-6.3, 6.3])?,
            }),
            (Some(_), ..) => self.wrong_motion(text, "x, 10 cm/s"),
            (None, Some(_), _) => self.wrong_motion(text, "y, 20 cm, 5 cm/s"),
            (None, None, _) => self.wrong_motion(text, "z, 20 deg/s"),
        }
    }

    fn wrong_motion(&mut self, text: &Text, example: &str) -> Option<Motion> {
        self.problems.of(text, format!("`{}` does not fit. Expected a text such as `{example}`", text.text));
        None
    }

    pub(super) fn joint(&mut self, table: &JointTable) -> (Joint, Dimension) {
        let (kind, dimension, force) = match table.kind {
            JointWord::Hinge => (JointKind::Hinge, Dimension::ANGLE, Dimension::TORQUE),
            JointWord::Slide => (JointKind::Slide, Dimension::LENGTH, Dimension::FORCE),
            JointWord::Screw => (JointKind::Screw, Dimension::ANGLE, Dimension::TORQUE),
        };
        let most = if kind == JointKind::Screw { MOST_SCREW_RAD } else { 10.0 };
        let axis = self.axis(&table.axis, &table.axis.text);
        let range: [f64; 2] =
            self.problems.take(&table.range, quantities(&table.range.text, dimension)).unwrap_or([-1.0, 1.0]);
        if !(range[0] < range[1] && range.iter().all(|end| end.abs() <= most)) {
            let shown = &table.range.text;
            self.problems.of(&table.range, format!("`{shown}`: expected the lower stop first, both within {most}"));
        }
        let per_speed = force.times(Dimension::TIME).over(dimension);
        let joint = Joint {
            kind,
            axis,
            anchor: self.triple(table.anchor.as_ref(), Dimension::LENGTH).into(),
            range,
            start: self.optional(table.start.as_ref(), dimension, range, 0.0),
            damping: self.optional(table.damping.as_ref(), per_speed, [0.0, 1e4], 0.0),
            friction: self.optional(table.friction.as_ref(), force, [0.0, 1e3], 0.0),
            stiffness: self.optional(table.stiffness.as_ref(), force.over(dimension), [0.0, 1e5], 0.0),
            rest: self.optional(table.rest.as_ref(), dimension, [-10.0, 10.0], 0.0),
            pitch_m: self.pitch(table),
            thread: None,
        };
        (joint, dimension)
    }

    fn pitch(&mut self, table: &JointTable) -> f64 {
        let screws = matches!(table.kind, JointWord::Screw);
        match (&table.pitch, screws) {
            (Some(text), true) => self.number(text, Dimension::LENGTH, [1e-5, 0.1]).unwrap_or_default(),
            (None, true) => {
                self.problems.of(&table.range, "a screw needs `pitch`, such as `1.5 mm`");
                0.0
            }
            (_, false) => {
                for text in [&table.pitch, &table.takes, &table.within, &table.lean].into_iter().flatten() {
                    self.problems.of(text, "`pitch`, `takes`, `within` and `lean` are keys of a joint of kind `screw`");
                }
                0.0
            }
        }
    }

    /// The threads of screws, when the names of all parts are known.
    pub(super) fn threads(&mut self, document: &Document, nominal: &mut Numbers) {
        for (screw, table) in document.part.iter().enumerate() {
            let Some(joint) = &table.joint else { continue };
            let Some(text) = &joint.takes else {
                for text in [&joint.within, &joint.lean].into_iter().flatten() {
                    self.problems.of(text, "`within` and `lean` need `takes`");
                }
                continue;
            };
            let Some(place) = self.problems.take(text, self.names.place_named(0, &text.text).map_err(|(_, why)| why))
            else {
                continue;
            };
            let within_m = self.optional(joint.within.as_ref(), Dimension::LENGTH, [1e-5, 0.1], 1e-3);
            let lean_rad = self.optional(joint.lean.as_ref(), Dimension::ANGLE, [1e-3, 0.8], LEAN_RAD);
            match place.on {
                Frame::Part(body) if nominal.parts[body].joint.is_none() => {
                    if let Some(joint) = &mut nominal.parts[screw].joint {
                        joint.thread = Some(Thread { body, point: place.point, within_m, lean_rad });
                    }
                }
                _ => self
                    .problems
                    .of(text, format!("`{}`: expected a part without a joint, or a point of one", text.text)),
            }
        }
    }
}
