//! Reads parameters: what each one sets, and its range.

use robogate_physics::Motion;

use super::document::{Document, ParameterTable};
use super::model::{ParameterModel, Reading};
use super::numbers::{Frame, Numbers, PartTarget, Target, YAW};
use super::units::{Dimension, quantities};
use crate::settings::unit_of;

/// The coordinates of a body in paths of parameters.
const PLACED: [&str; 4] = ["at.x", "at.y", "at.z", "yaw"];

impl Reading<'_, '_> {
    pub(super) fn parameters(&mut self, document: &Document, nominal: &mut Numbers) -> Vec<ParameterModel> {
        let mut parameters: Vec<ParameterModel> = Vec::new();
        for table in &document.parameter {
            let Some(parameter) = self.parameter(table, nominal) else { continue };
            if parameters.iter().any(|known| known.name == parameter.name) {
                self.problems.of(&table.name, format!("a second parameter `{}`", parameter.name));
            }
            let sets = |target: Target| !matches!(target, Target::Value(_)) && target == parameter.target;
            if let Some(other) = parameters.iter().find(|known| sets(known.target)) {
                self.problems.of(&table.name, format!("`{}` and `{}` set the same", other.name, parameter.name));
            }
            if let Some(number) = parameter.target.number(nominal) {
                *number = parameter.nominal;
            }
            nominal.values.push(parameter.nominal);
            self.names.parameters.push((parameter.name.to_string(), parameter.dimension));
            self.names.nominal.push(parameter.nominal);
            parameters.push(parameter);
        }
        parameters
    }

    fn parameter(&mut self, table: &ParameterTable, nominal: &mut Numbers) -> Option<ParameterModel> {
        let name = self.word(&table.name)?;
        let (target, dimension) = match &table.sets {
            Some(path) => {
                let target = self.target(&path.text, nominal);
                self.problems.take(path, target)?
            }
            None => {
                // The unit of the range says what it is.
                let last = table.range.text.rsplit(',').next().unwrap_or_default();
                let found = super::units::quantity(last);
                let dimension = self.problems.take(&table.range, found)?.dimension;
                (Target::Value(dimension), dimension)
            }
        };
        let range: [f64; 2] = self.problems.take(&table.range, quantities(&table.range.text, dimension))?;
        if range[0] >= range[1] {
            let shown = &table.range.text;
            self.problems.of(&table.range, format!("`{shown}`: expected the smaller value first"));
        }
        let nominal = match (&table.nominal, target.number(nominal)) {
            (Some(text), _) => self.number(text, dimension, range)?,
            (None, Some(value)) if (range[0]..=range[1]).contains(value) => *value,
            (None, Some(value)) => {
                let (value, unit) = (*value, dimension.unit());
                let why = format!("the value in the file, {value} {unit}, is outside of the range. Add `nominal`");
                self.problems.of(&table.range, why);
                return None;
            }
            (None, None) => {
                self.problems.of(&table.name, format!("`{name}` sets nothing, so it needs `nominal`"));
                return None;
            }
        };
        let unit = unit_of(name.as_str());
        if !unit.is_empty() && unit != dimension.unit() {
            let is =
                if dimension == Dimension::NONE { "has no unit".into() } else { format!("is in {}", dimension.unit()) };
            self.problems.of(&table.name, format!("`{name}` ends with the unit {unit}, but its value {is}"));
        }
        Some(ParameterModel {
            name,
            target,
            dimension,
            range,
            nominal,
            meaning: table.meaning.clone(),
            family: table.family.as_ref().and_then(|family| self.word(family)),
            told: table.told.unwrap_or(table.sets.is_none()),
        })
    }

    /// What a path sets, and the dimension of its values.
    fn target(&self, path: &str, nominal: &Numbers) -> Result<(Target, Dimension), String> {
        let (owner, rest) = path.split_once('.').unwrap_or((path, ""));
        let unknown =
            |known: &[&str]| format!("`{owner}` has no `{rest}`: {}", robogate_core::hint(rest, known.iter().copied()));
        let placed = PLACED.iter().position(|name| *name == rest);
        let length = |which: usize| if which == YAW { Dimension::ANGLE } else { Dimension::LENGTH };
        if owner == "scene" {
            return match rest {
                "friction" => Ok((Target::Friction, Dimension::NONE)),
                "gravity" => Ok((Target::Gravity, Dimension::ACCELERATION)),
                _ => Err(unknown(&["friction", "gravity"])),
            };
        }
        match (self.names.frame_named(0, owner).map_err(|(_, why)| why)?, placed) {
            (Frame::Fixture(of), Some(which)) => Ok((Target::Fixture(of, which), length(which))),
            (Frame::Fixture(of), None) => match (rest, nominal.motions[of]) {
                ("speed", Some(Motion::Turn { .. })) => Ok((Target::Speed(of), Dimension::TURNING)),
                ("speed", Some(_)) => Ok((Target::Speed(of), Dimension::SPEED)),
                ("distance", Some(Motion::Shuttle { .. })) => Ok((Target::Distance(of), Dimension::LENGTH)),
                (_, None) => Err(unknown(&PLACED)),
                _ => Err(unknown(&[&PLACED[..], &["speed", "distance"]].concat())),
            },
            (Frame::Part(of), Some(which)) => Ok((Target::Part(of, PartTarget::Placed(which)), length(which))),
            (Frame::Part(of), None) => {
                let joint = self.names.parts[of].1;
                let force = if joint == Some(Dimension::ANGLE) { Dimension::TORQUE } else { Dimension::FORCE };
                let of_joint = |which: PartTarget, dimension: &dyn Fn(Dimension) -> Dimension| {
                    let joint = joint.ok_or_else(|| format!("part `{owner}` has no joint"))?;
                    Ok((Target::Part(of, which), dimension(joint)))
                };
                match rest {
                    "mass" => Ok((Target::Part(of, PartTarget::Mass), Dimension::MASS)),
                    "spread" => Ok((Target::Part(of, PartTarget::Spread), Dimension::LENGTH)),
                    "spin" => Ok((Target::Part(of, PartTarget::Spin), Dimension::ANGLE)),
                    "joint.damping" => of_joint(PartTarget::Damping, &|joint| force.times(Dimension::TIME).over(joint)),
                    "joint.friction" => of_joint(PartTarget::DryFriction, &|_| force),
                    "joint.stiffness" => of_joint(PartTarget::Stiffness, &|joint| force.over(joint)),
                    "joint.start" => of_joint(PartTarget::Start, &|joint| joint),
                    "joint.rest" => of_joint(PartTarget::Rest, &|joint| joint),
                    _ => {
                        let joint = ["joint.damping", "joint.friction", "joint.stiffness", "joint.start", "joint.rest"];
                        Err(unknown(&[&PLACED[..], &["mass", "spread", "spin"], &joint].concat()))
                    }
                }
            }
            _ => Err(unknown(&PLACED)),
        }
    }
}
