//! The parameters of a task from a file: its own ones, then those of every task.

use robogate_core::{
    Allowed, Assignment, Domain, Fault, FaultKind, Parameter, ParameterSpace, ParameterSpec, Scale, Value,
};
use robogate_physics::{FreeBodyRead, Gripper, Motion, Readback};

use super::model::{Model, ParameterModel};
use super::numbers::{Draws, Numbers, PartTarget, Placed, Target, YAW, speed};
use crate::arm::{Acting, Parameters, Row, Table};

/// The rows that a file does not have to declare.
static COMMON: Table<Numbers> = Table(&[Row::encoder_bias("encoder_bias_rad", 0.1)]);

impl ParameterModel {
    fn spec(&self) -> ParameterSpec {
        let [low, high] = self.range;
        ParameterSpec {
            name: self.name.as_str().into(),
            unit: self.dimension.unit(),
            meaning: self.meaning.clone(),
            allowed: Allowed::Continuous { low, high },
            nominal: Some(Value::Number(self.nominal)),
            read_from: match self.target {
                Target::Value(_) => "the referee",
                _ => "the scene in the engine",
            }
            .to_owned(),
            family: self.family,
        }
    }
}

impl Model {
    fn parameter(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.name.as_str() == name)
    }

    /// The numbers of the file with these values of parameters.
    ///
    /// # Errors
    /// A setup fault for an unknown parameter or a value that is not accepted.
    pub(super) fn numbers(&self, requested: &Assignment, gripper: &Gripper) -> Result<Numbers, Fault> {
        let (own, common): (Vec<_>, Vec<_>) = requested.iter().partition(|(name, _)| self.parameter(name).is_some());
        let common = common.into_iter().map(|(name, value)| (name.into(), value.clone())).collect();
        let around = COMMON.decode(&common, gripper)?.around;
        let mut numbers = Numbers { around, ..self.nominal.clone() };
        for (name, value) in own {
            self.accepts(name, value, Some(gripper)).map_err(|why| Fault::new(FaultKind::Setup, why))?;
            if let Some(index) = self.parameter(name) {
                self.set(&mut numbers, index, number(value));
            }
        }
        Ok(numbers)
    }

    /// Sets a parameter.
    pub(super) fn set(&self, numbers: &mut Numbers, index: usize, value: f64) {
        numbers.values[index] = value;
        if let Some(number) = self.parameters[index].target.number(numbers) {
            *number = value;
        }
    }

    /// The applied values of the requested parameters.
    pub(super) fn applied(&self, requested: &Assignment, acting: &Acting<'_, Numbers>, draws: &[Draws]) -> Assignment {
        let mut applied = COMMON.applied(requested, acting);
        for (name, value) in requested.iter() {
            let Some(index) = self.parameter(name) else { continue };
            let found = self.acting(index, acting, draws);
            // A value that follows from several others has fewer digits than the request.
            let close = (found - number(value)).abs() <= 1e-9 * number(value).abs().max(1e-3);
            applied.set(name, if close { value.clone() } else { Value::Number(found) });
        }
        applied
    }

    /// The value of a parameter in the engine.
    fn acting(&self, index: usize, acting: &Acting<'_, Numbers>, draws: &[Draws]) -> f64 {
        let engine = acting.found.engine;
        match self.parameters[index].target {
            Target::Value(_) => acting.settings.values[index],
            Target::Friction if engine.friction == engine.table_friction => engine.friction,
            Target::Friction => f64::NAN,
            Target::Gravity => engine.gravity,
            Target::Fixture(of, which) => coordinate(self.fixture_at(engine, of), &acting.settings.fixtures[of], which),
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
        let (mass_kg, pose) = match of.checked_sub(1).and_then(|other| engine.others.get(other)) {
            Some(FreeBodyRead { mass_kg, pose, .. }) => (*mass_kg, *pose),
            None => (engine.mass_kg, engine.object),
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
            PartTarget::Placed(which) => off(which) - drawn[which],
            PartTarget::Mass => mass_kg,
            PartTarget::Spread => {
                let moved = [off(0) - part.placed.at[0], off(1) - part.placed.at[1]];
                crate::arm::scale(&draws.shift, &moved)
            }
            PartTarget::Spin => crate::arm::scale(&[draws.turn], &[off(YAW) - part.placed.rotation[2]]),
            PartTarget::Damping => joint.map_or(f64::NAN, |joint| joint.damping),
            PartTarget::DryFriction => joint.map_or(f64::NAN, |joint| joint.friction),
            PartTarget::Stiffness => joint.map_or(f64::NAN, |joint| joint.stiffness),
            PartTarget::Start => joint.map_or(f64::NAN, |joint| joint.start),
            PartTarget::Rest => joint.map_or(f64::NAN, |joint| joint.rest),
        }
    }

    /// The parameter space: every parameter over its range.
    pub(super) fn space(&self) -> Option<ParameterSpace> {
        let parameter = |of: &ParameterModel| {
            let [low, high] = of.range;
            Parameter { name: of.name.as_str().into(), domain: Domain::Continuous { low, high, scale: Scale::Linear } }
        };
        ParameterSpace::new(self.name.as_str(), self.parameters.iter().map(parameter).collect()).ok()
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

fn number(value: &Value) -> f64 {
    match value {
        Value::Number(number) => *number,
        Value::Integer(number) => *number as f64,
        Value::Category(_) => f64::NAN,
    }
}

impl Parameters for Model {
    fn specs(&self, gripper: &Gripper) -> Vec<ParameterSpec> {
        self.parameters.iter().map(ParameterModel::spec).chain(COMMON.specs(gripper)).collect()
    }

    fn knows(&self, name: &str) -> bool {
        self.parameter(name).is_some() || COMMON.knows(name)
    }

    fn accepts(&self, name: &str, value: &Value, gripper: Option<&Gripper>) -> Result<(), String> {
        match self.parameter(name) {
            Some(index) => self.parameters[index].spec().accepts(value),
            None => COMMON.accepts(name, value, gripper),
        }
    }

    fn accepts_all(&self, name: &str, domain: &Domain, gripper: Option<&Gripper>) -> Result<(), String> {
        match self.parameter(name) {
            Some(_) => domain.extremes().iter().try_for_each(|value| self.accepts(name, value, gripper)),
            None => COMMON.accepts_all(name, domain, gripper),
        }
    }
}
