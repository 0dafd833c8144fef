//! Reads how bodies move: the joints of parts and the motions of fixtures.

use nalgebra::Vector3;
use robogate_physics::{Joint, JointKind, Motion};

use super::document::{FixtureTable, JointTable, JointWord, Text};
use super::model::Reading;
use super::units::{Dimension, quantities};

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
        };
        let axis = self.axis(&table.axis, &table.axis.text);
        let range: [f64; 2] =
            self.problems.take(&table.range, quantities(&table.range.text, dimension)).unwrap_or([-1.0, 1.0]);
        if !(range[0] < range[1] && range.iter().all(|end| end.abs() <= 10.0)) {
            let shown = &table.range.text;
            self.problems.of(&table.range, format!("`{shown}`: expected the lower stop first, both within 10"));
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
        };
        (joint, dimension)
    }
}
