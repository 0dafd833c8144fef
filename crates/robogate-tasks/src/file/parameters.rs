//! The parameters of a task from a file: its own ones, then those of every task.

use robogate_core::{
    Allowed, Assignment, Domain, Fault, FaultKind, Parameter, ParameterSpace, ParameterSpec, Scale, Value, is_applied,
};
use robogate_physics::{FreeBodyRead, Gripper, Motion, Readback, Robot};

use super::model::{ChoiceModel, Model, ParameterModel};
use super::numbers::{Draws, Numbers, PartTarget, Placed, Target, YAW, edge_m, speed};
use crate::arm::{Acting, Parameters, Row, Table, within_reach};

/// The rows that a file does not have to declare.
static COMMON: Table<Numbers> = Table(&[Row::encoder_bias("encoder_bias_rad", 0.1)]);

impl ParameterModel {
    /// The declaration of a parameter from which numbers of bodies follow, or none.
    fn spec(&self, acts: bool) -> ParameterSpec {
        let [low, high] = self.range;
        ParameterSpec {
            name: self.name.as_str().into(),
            unit: self.dimension.unit(),
            meaning: self.meaning.clone(),
            allowed: Allowed::Continuous { low, high },
            nominal: Some(Value::Number(self.nominal)),
            read_from: match self.target {
                Target::Value(_) if !acts => "the referee",
                _ => "the scene in the engine",
            }
            .to_owned(),
            family: self.family,
        }
    }
}

impl ChoiceModel {
    fn spec(&self) -> ParameterSpec {
        let word = |(word, _): &(String, Vec<usize>)| word.as_str().into();
        ParameterSpec {
            name: self.name.as_str().into(),
            unit: String::new(),
            meaning: self.meaning.clone(),
            allowed: Allowed::Categorical { choices: self.words.iter().map(word).collect(), open: false },
            nominal: self.words.get(self.nominal).map(|of| Value::Category(word(of))),
            read_from: "the scene in the engine".to_owned(),
            family: self.family,
        }
    }
}

impl Model {
    /// The declarations of the parameters of the file.
    fn own_specs(&self) -> impl Iterator<Item = ParameterSpec> {
        let own = (0..self.parameters.len()).map(|index| self.parameter_spec(index));
        self.choice.iter().map(ChoiceModel::spec).chain(own)
    }

    fn parameter_spec(&self, index: usize) -> ParameterSpec {
        let acts = self.cases[0].sets.iter().any(|(_, value)| value.depends_on(index));
        self.parameters[index].spec(acts)
    }

    fn own_spec(&self, name: &str) -> Option<ParameterSpec> {
        let choice = self.choice.as_ref().filter(|choice| choice.name.as_str() == name).map(ChoiceModel::spec);
        choice.or_else(|| self.parameter(name).map(|index| self.parameter_spec(index)))
    }

    fn parameter(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.name.as_str() == name)
    }

    /// The numbers of the file with these values of parameters and settings.
    ///
    /// # Errors
    /// A setup fault for an unknown parameter or a value that is not accepted.
    pub(super) fn numbers(&self, requested: &Assignment, settings: &[f64], robot: &Robot) -> Result<Numbers, Fault> {
        let gripper = &robot.settings.gripper;
        let (own, common): (Vec<_>, Vec<_>) = requested.iter().partition(|(name, _)| self.own_spec(name).is_some());
        let common = common.into_iter().map(|(name, value)| (name.into(), value.clone())).collect();
        let around = COMMON.decode(&common, gripper)?.around;
        let mut numbers = Numbers { around, ..self.nominal.clone() };
        for (name, value) in own {
            self.accepts(name, value, Some(gripper)).map_err(|why| Fault::new(FaultKind::Setup, why))?;
            match (self.parameter(name), value) {
                (Some(index), _) => self.set(&mut numbers, index, number(value)),
                (None, Value::Category(word)) => self.choose(&mut numbers, word),
                (None, _) => {}
            }
        }
        self.complete(&mut numbers, settings, robot);
        Ok(numbers)
    }

    /// Sets a parameter.
    pub(super) fn set(&self, numbers: &mut Numbers, index: usize, value: f64) {
        numbers.values[index] = value;
        self.parameters[index].target.set(numbers, value);
    }

    /// Chooses a word. An unknown one changes nothing.
    pub(super) fn choose(&self, numbers: &mut Numbers, word: &str) {
        let words = self.choice.iter().flat_map(|choice| &choice.words);
        numbers.word = words.enumerate().find(|(_, (known, _))| known == word).map_or(numbers.word, |(index, _)| index);
    }

    /// Sets the settings, and what follows from parameters and from the reach of the arm.
    pub(super) fn complete(&self, numbers: &mut Numbers, settings: &[f64], robot: &Robot) {
        numbers.values.truncate(self.parameters.len());
        numbers.values.extend(settings);
        for (target, value) in &self.cases[numbers.word].sets {
            let value = value.constant(&numbers.values).unwrap_or(f64::NAN);
            target.set(numbers, value);
        }
        if self.document.scene.fit_reach {
            let fitted = |[x, y, z]: [f64; 3]| {
                let [[x, y]] = within_reach(robot, [[x, y]]);
                [x, y, z]
            };
            let [[scale, _]] = within_reach(robot, [[1.0, 1.0]]);
            numbers.scale = scale;
            numbers.fixtures.iter_mut().for_each(|fixture| fixture.at = fitted(fixture.at));
            let free = numbers.parts.iter_mut().zip(&self.parts).filter(|(_, model)| model.parent.is_none());
            free.for_each(|(part, _)| part.placed.at = fitted(part.placed.at));
        }
    }

    /// The applied values of the requested parameters.
    pub(super) fn applied(&self, requested: &Assignment, acting: &Acting<'_, Numbers>, draws: &[Draws]) -> Assignment {
        let mut applied = COMMON.applied(requested, acting);
        let sets = &self.cases[acting.settings.word].sets;
        for (name, value) in requested.iter() {
            // What follows from a parameter must act, too.
            let follows = |of: &super::conditions::Value| self.parameter(name).is_none_or(|index| of.depends_on(index));
            let wrong = sets.iter().filter(|(_, of)| follows(of)).find_map(|(target, of)| {
                let (wanted, found) =
                    (of.constant(&acting.settings.values)?, self.acting(*target, None, acting, draws));
                (!is_applied(wanted, found)).then_some(found)
            });
            let found = match (self.parameter(name), wrong) {
                (Some(index), None) => self.acting(self.parameters[index].target, Some(index), acting, draws),
                (Some(_), Some(_)) => f64::NAN,
                (None, wrong) if self.own_spec(name).is_some() => {
                    applied.set(name, wrong.map_or_else(|| value.clone(), |_| Value::Category("not set up".into())));
                    continue;
                }
                (None, _) => continue,
            };
            applied.set(name, if is_close(found, number(value)) { value.clone() } else { Value::Number(found) });
        }
        // In the order of the request, as records have them.
        requested.iter().filter_map(|(name, _)| Some((name.into(), applied.get(name)?.clone()))).collect()
    }

    /// The value of a number in the engine: of this parameter, if it is one.
    fn acting(&self, target: Target, parameter: Option<usize>, acting: &Acting<'_, Numbers>, draws: &[Draws]) -> f64 {
        let engine = acting.found.engine;
        match target {
            Target::Value(_) => parameter.map_or(f64::NAN, |index| acting.settings.values[index]),
            Target::Friction if engine.friction == engine.table_friction => engine.friction,
            Target::Friction => f64::NAN,
            Target::Gravity => engine.gravity,
            Target::Fixture(of, which) => {
                let found = coordinate(self.fixture_at(engine, of), &acting.settings.fixtures[of], which);
                if which < 2 { found / acting.settings.scale } else { found }
            }
            Target::FixtureFriction(of) => {
                let index = self.fixtures[of].range.start;
                let read = engine.fixtures.iter().find(|read| read.fixture == index);
                read.and_then(|read| read.friction).unwrap_or(f64::NAN)
            }
            Target::Speed(of) => self.motion(engine, of).as_mut().and_then(speed).map_or(f64::NAN, |speed| *speed),
            Target::Distance(of) => match self.motion(engine, of) {
                Some(Motion::Shuttle { distance_m, .. }) => distance_m,
                _ => f64::NAN,
            },
            Target::Part(of, which) => self.read_part(engine, acting.settings, of, which, draws[of]),
        }
    }

    /// The motion of a fixture in the engine.
    fn motion(&self, engine: &Readback, of: usize) -> Option<Motion> {
        let index = self.fixtures[of].range.start;
        engine.fixtures.iter().find(|read| read.fixture == index)?.motion
    }

    /// Where a fixture is in the engine, from its first shape.
    fn fixture_at(&self, engine: &Readback, of: usize) -> Option<nalgebra::Isometry3<f64>> {
        let FixtureShape { index, pose } = self.first_shape(of)?;
        let found = engine.fixtures.iter().find(|read| read.fixture == index)?;
        Some(found.pose * pose.inverse())
    }

    fn first_shape(&self, of: usize) -> Option<FixtureShape> {
        let fixture = &self.fixtures[of];
        Some(FixtureShape { index: fixture.range.start, pose: fixture.shapes.first()?.pose })
    }

    fn read_part(&self, engine: &Readback, numbers: &Numbers, of: usize, which: PartTarget, draws: Draws) -> f64 {
        let joint = engine.joints.iter().find(|(part, _)| *part == of).map(|(_, joint)| joint);
        let (mass_kg, pose, shapes) = match of.checked_sub(1).and_then(|other| engine.others.get(other)) {
            Some(FreeBodyRead { mass_kg, pose, parts, .. }) => (*mass_kg, *pose, parts),
            None => (engine.mass_kg, engine.object, &engine.parts),
        };
        let part = &numbers.parts[of];
        // The pose at the value 0 of its joint, in the frame of its fixture.
        let at_zero =
            pose * joint.map_or_else(nalgebra::Isometry3::identity, |joint| joint.motion(joint.start)).inverse();
        let placed = match self.parts[of].parent {
            Some(parent) => self.fixture_at(engine, parent).map(|frame| frame.inverse() * at_zero),
            None => Some(at_zero),
        };
        let mut wanted = part.placed;
        wanted.rotation[2] += part.spin_rad * draws.turn;
        let off = |which: usize| coordinate(placed, &wanted, which);
        let drawn = [part.spread_m * draws.shift[0], part.spread_m * draws.shift[1], 0.0, part.spin_rad * draws.turn];
        match which {
            // A part that starts in a region is where it was drawn.
            PartTarget::Placed(which @ (0 | 1)) if draws.place.is_some() => part.placed.at[which],
            PartTarget::Placed(which @ (0 | 1)) if self.parts[of].parent.is_none() => {
                (off(which) - drawn[which]) / numbers.scale
            }
            PartTarget::Placed(which) => off(which) - drawn[which],
            PartTarget::Mass => mass_kg,
            PartTarget::Friction => {
                engine.own_friction.iter().find(|(body, _)| *body == of).map_or(f64::NAN, |(_, friction)| *friction)
            }
            PartTarget::Size => edge_m(shapes.iter()).unwrap_or(f64::NAN),
            PartTarget::Spread => {
                let moved = [off(0) - part.placed.at[0], off(1) - part.placed.at[1]];
                drawn_with(part.spread_m, &draws.shift, &moved)
            }
            PartTarget::Spin => drawn_with(part.spin_rad, &[draws.turn], &[off(YAW) - part.placed.rotation[2]]),
            PartTarget::Damping => joint.map_or(f64::NAN, |joint| joint.damping),
            PartTarget::DryFriction => joint.map_or(f64::NAN, |joint| joint.friction),
            PartTarget::Stiffness => joint.map_or(f64::NAN, |joint| joint.stiffness),
            PartTarget::Start => joint.map_or(f64::NAN, |joint| joint.start),
            PartTarget::Rest => joint.map_or(f64::NAN, |joint| joint.rest),
        }
    }

    /// The parameter space: every parameter over its range. `None` if the file names a built-in one.
    pub(super) fn own_space(&self) -> Option<ParameterSpace> {
        if self.space.is_some() {
            return None;
        }
        let parameter = |of: ParameterSpec| {
            let domain = match of.allowed {
                Allowed::Continuous { low, high } => Domain::Continuous { low, high, scale: Scale::Linear },
                Allowed::Integer { low, high } => Domain::Integer { low, high },
                Allowed::Categorical { choices, .. } => Domain::Categorical { choices },
            };
            Parameter { name: of.name, domain }
        };
        ParameterSpace::new(self.name.as_str(), self.own_specs().map(parameter).collect()).ok()
    }
}

/// A shape of a fixture: its index in the scene, and its pose in the frame of the fixture.
struct FixtureShape {
    index: usize,
    pose: nalgebra::Isometry3<f64>,
}

/// A coordinate of a pose that should be `wanted`: x, y, z or its yaw. A yaw is that of `wanted` and the turn about the vertical
/// that is left, because angles of a rotation are ambiguous.
fn coordinate(pose: Option<nalgebra::Isometry3<f64>>, wanted: &Placed, which: usize) -> f64 {
    match pose {
        Some(pose) if which == YAW => {
            let left = pose.rotation * wanted.pose().rotation.inverse();
            wanted.rotation[2] + left.euler_angles().2
        }
        Some(pose) => pose.translation.vector[which],
        None => f64::NAN,
    }
}

/// The factor of these draws that gives what was found: `wanted`, if poses in single precision explain the difference. A small draw
/// would enlarge it.
fn drawn_with(wanted: f64, draws: &[f64], found: &[f64]) -> f64 {
    const SINGLE: f64 = 1e-6;
    let same = draws.iter().zip(found).all(|(draw, found)| (wanted * draw - found).abs() <= SINGLE);
    if same { wanted } else { crate::arm::scale(draws, found) }
}

/// A value that follows from several others has fewer digits than the request.
fn is_close(found: f64, wanted: f64) -> bool {
    (found - wanted).abs() <= 1e-9 * wanted.abs().max(1e-3)
}

fn number(value: &Value) -> f64 {
    match value {
        Value::Number(number) => *number,
        Value::Integer(number) => *number as f64,
        Value::Category(_) => f64::NAN,
    }
}

impl Parameters for Model {
    fn specs(&self, gripper: &Gripper) -> Vec<ParameterSpec> {
        self.own_specs().chain(COMMON.specs(gripper)).collect()
    }

    fn knows(&self, name: &str) -> bool {
        self.own_spec(name).is_some() || COMMON.knows(name)
    }

    fn accepts(&self, name: &str, value: &Value, gripper: Option<&Gripper>) -> Result<(), String> {
        match self.own_spec(name) {
            Some(spec) => spec.accepts(value),
            None => COMMON.accepts(name, value, gripper),
        }
    }

    fn accepts_all(&self, name: &str, domain: &Domain, gripper: Option<&Gripper>) -> Result<(), String> {
        match self.own_spec(name) {
            Some(_) => domain.extremes().iter().try_for_each(|value| self.accepts(name, value, gripper)),
            None => COMMON.accepts_all(name, domain, gripper),
        }
    }
}
