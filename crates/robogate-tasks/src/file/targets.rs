//! Reads parameters: what each one sets, and its range.

use std::collections::BTreeSet;

use robogate_physics::Motion;

use super::document::{ChoiceTable, Document, ParameterTable, Text};
use super::model::{ChoiceModel, ParameterModel, Reading, SettingModel};
use super::names::{Names, RESERVED};
use super::numbers::{Frame, Numbers, PartTarget, Target, YAW};
use super::units::{Dimension, quantities};

/// The coordinates of a body in paths of parameters.
const PLACED: [&str; 4] = ["at.x", "at.y", "at.z", "yaw"];

/// The largest number of words of a choice: every word has conditions and skills of its own.
const MOST_WORDS: usize = 24;

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
            parameter.target.set(nominal, parameter.nominal);
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
                let target = self.names.target(&path.text, nominal);
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
        let range = self.range(&table.range, dimension)?;
        if range[0] < target.least() {
            let why = format!(
                "`{}`: the smallest possible value is {} {}",
                table.range.text,
                target.least(),
                dimension.unit()
            );
            self.problems.of(&table.range, why.trim_end().to_owned());
        }
        let nominal = match (&table.nominal, target.get(nominal)) {
            (Some(text), _) => self.number(text, dimension, range)?,
            (None, Some(value)) if (range[0]..=range[1]).contains(&value) => value,
            (None, Some(value)) => {
                let unit = dimension.unit();
                let why = format!("the value in the file, {value} {unit}, is outside of the range. Add `nominal`");
                self.problems.of(&table.range, why);
                return None;
            }
            (None, None) => {
                self.problems.of(&table.name, format!("`{name}` sets nothing, so it needs `nominal`"));
                return None;
            }
        };
        self.check_unit(&table.name, dimension);
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

    fn check_unit(&mut self, name: &Text, dimension: Dimension) {
        if let Some(problem) = super::units::other_unit(&name.text, dimension) {
            self.problems.of(name, problem);
        }
    }

    /// The numbers that a user can set, whose values follow those of the parameters.
    pub(super) fn settings(&mut self, document: &Document, nominal: &mut Numbers) -> Vec<SettingModel> {
        let mut settings: Vec<SettingModel> = Vec::new();
        for table in &document.setting {
            let Some(name) = self.word(&table.name) else { continue };
            let taken = self.names.parameters.iter().any(|(known, _)| known == name.as_str());
            if taken || crate::arm::rows::<super::FileTask>([]).iter().any(|known| known.name == name.as_str()) {
                self.problems.of(&table.name, format!("a second parameter or setting `{name}`"));
            }
            // The unit of the range says what it is.
            let last = table.range.text.rsplit(',').next().unwrap_or_default();
            let Some(found) = self.problems.take(&table.range, super::units::quantity(last)) else { continue };
            let Some(range) = self.range(&table.range, found.dimension) else { continue };
            let Some(default) = self.number(&table.default, found.dimension, range) else { continue };
            self.check_unit(&table.name, found.dimension);
            nominal.values.push(default);
            self.names.parameters.push((name.to_string(), found.dimension));
            self.names.nominal.push(default);
            settings.push(SettingModel { name, range, default });
        }
        settings
    }

    fn range(&mut self, text: &Text, dimension: Dimension) -> Option<[f64; 2]> {
        let range: [f64; 2] = self.problems.take(text, quantities(&text.text, dimension))?;
        if range[0] >= range[1] {
            self.problems.of(text, format!("`{}`: expected the smaller value first", text.text));
        }
        Some(range)
    }

    /// The parameter that says which parts have which roles.
    pub(super) fn choice(&mut self, table: &ChoiceTable) -> Option<ChoiceModel> {
        let name = self.word(&table.name)?;
        if self.names.parameters.iter().any(|(known, _)| known == name.as_str()) {
            self.problems.of(&table.name, format!("a second parameter `{name}`"));
        }
        let roles: Vec<String> = table.roles.text.split(',').map(|role| role.trim().to_owned()).collect();
        for (index, role) in roles.iter().enumerate() {
            if role.is_empty() {
                self.problems.of(&table.roles, "an empty role. Expected names with commas between them".to_owned());
            }
            if self.names.frame_named(0, role).is_ok() || RESERVED.contains(&&**role) || roles[..index].contains(role) {
                self.problems.of(&table.roles, format!("a second body or role `{role}`. Expected different names"));
            }
        }
        if !(1..=MOST_WORDS).contains(&table.words.len()) {
            self.problems.of(&table.name, format!("found {} words. Expected 1 to {MOST_WORDS}", table.words.len()));
        }
        let mut words = Vec::new();
        for (word, parts) in table.words.iter().take(MOST_WORDS) {
            let found: Result<Vec<usize>, _> = parts
                .text
                .split(',')
                .map(|part| self.names.part_named(0, part.trim()).map_err(|(_, why)| why))
                .collect();
            let Some(found) = self.problems.take(parts, found) else { continue };
            if found.len() != roles.len() {
                let (count, all) = (found.len(), roles.len());
                self.problems.of(parts, format!("`{}` has {count} parts for {all} roles", parts.text));
            }
            if found.iter().collect::<BTreeSet<_>>().len() != found.len() {
                self.problems.of(parts, format!("`{}` gives one part two roles", parts.text));
            }
            words.push((word.clone(), found));
        }
        let nominal = words.iter().position(|(word, _)| *word == table.nominal.text);
        if nominal.is_none() {
            self.problems.of(&table.nominal, format!("`{}` is not one of the words", table.nominal.text));
        }
        let family = table.family.as_ref().and_then(|family| self.word(family));
        Some(ChoiceModel { name, roles, words, nominal: nominal?, meaning: table.meaning.clone(), family })
    }
}

impl Names {
    /// What a path sets, and the dimension of its values.
    pub(super) fn target(&self, path: &str, nominal: &Numbers) -> Result<(Target, Dimension), String> {
        let (owner, rest) = path.split_once('.').unwrap_or((path, ""));
        let unknown =
            |known: &[&str]| format!("`{owner}` has no `{rest}`: {}", robogate_core::hint(rest, known.iter().copied()));
        let placed = PLACED.iter().position(|name| *name == rest);
        let length = |which: usize| if which == YAW { Dimension::ANGLE } else { Dimension::LENGTH };
        if owner == "scene" {
            return match rest {
                "friction" if nominal.parts.iter().all(|part| part.friction.is_some()) => {
                    Err("`scene.friction` has no effect: every part has its own `friction`".to_owned())
                }
                "friction" => Ok((Target::Friction, Dimension::NONE)),
                "gravity" => Ok((Target::Gravity, Dimension::ACCELERATION)),
                _ => Err(unknown(&["friction", "gravity"])),
            };
        }
        let frame = self.frame_named(0, owner).map_err(|(_, why)| why)?;
        if rest == "friction" {
            let (found, target) = match frame {
                Frame::Part(of) => (nominal.parts[of].friction, Target::Part(of, PartTarget::Friction)),
                Frame::Fixture(of) => (nominal.frictions[of], Target::FixtureFriction(of)),
                _ => return Err(unknown(&PLACED)),
            };
            let stated = found.map(|_| (target, Dimension::NONE));
            return stated.ok_or_else(|| {
                format!(
                    "`{owner}` has no `friction` of its own. State its nominal value in the table: `friction = 0.7`"
                )
            });
        }
        match (frame, placed) {
            (Frame::Fixture(of), Some(which)) => Ok((Target::Fixture(of, which), length(which))),
            (Frame::Fixture(of), None) => match (rest, nominal.motions[of]) {
                ("speed", Some(Motion::Turn { .. })) => Ok((Target::Speed(of), Dimension::TURNING)),
                ("speed", Some(_)) => Ok((Target::Speed(of), Dimension::SPEED)),
                ("distance", Some(Motion::Shuttle { .. })) => Ok((Target::Distance(of), Dimension::LENGTH)),
                (_, None) => Err(unknown(&[&PLACED[..], &["friction"]].concat())),
                _ => Err(unknown(&[&PLACED[..], &["friction", "speed", "distance"]].concat())),
            },
            (Frame::Part(of), Some(which)) => Ok((Target::Part(of, PartTarget::Placed(which)), length(which))),
            (Frame::Part(of), None) => {
                let joint = self.parts[of].1;
                let force = if joint == Some(Dimension::ANGLE) { Dimension::TORQUE } else { Dimension::FORCE };
                let of_joint = |which: PartTarget, dimension: &dyn Fn(Dimension) -> Dimension| {
                    let joint = joint.ok_or_else(|| format!("part `{owner}` has no joint"))?;
                    Ok((Target::Part(of, which), dimension(joint)))
                };
                match rest {
                    "mass" => Ok((Target::Part(of, PartTarget::Mass), Dimension::MASS)),
                    "size" if nominal.parts[of].size_m().is_none() => {
                        Err(format!("`{owner}` has no size. Expected a part of one cube or one ball"))
                    }
                    "size" if nominal.parts[of].bulk.is_some() => {
                        Err(format!("`{owner}` states its inertia, so its size cannot be set"))
                    }
                    "size" => Ok((Target::Part(of, PartTarget::Size), Dimension::LENGTH)),
                    "spread" => Ok((Target::Part(of, PartTarget::Spread), Dimension::LENGTH)),
                    "spin" => Ok((Target::Part(of, PartTarget::Spin), Dimension::ANGLE)),
                    "joint.damping" => of_joint(PartTarget::Damping, &|joint| force.times(Dimension::TIME).over(joint)),
                    "joint.friction" => of_joint(PartTarget::DryFriction, &|_| force),
                    "joint.stiffness" => of_joint(PartTarget::Stiffness, &|joint| force.over(joint)),
                    "joint.start" => of_joint(PartTarget::Start, &|joint| joint),
                    "joint.rest" => of_joint(PartTarget::Rest, &|joint| joint),
                    _ => {
                        let joint = ["joint.damping", "joint.friction", "joint.stiffness", "joint.start", "joint.rest"];
                        Err(unknown(&[&PLACED[..], &["mass", "friction", "size", "spread", "spin"], &joint].concat()))
                    }
                }
            }
            _ => Err(unknown(&PLACED)),
        }
    }
}
