//! A scenario's cell after every random draw, and what an engine made of it.

use nalgebra::Isometry3;
use robogate_core::{Assignment, Fault, FaultKind, Pose, Scenario, TaskSpec, Value};
use robogate_physics::{FixtureKind, FixtureRead, GRAVITY, Primitive, Readback, Robot, Scene, Visual, isometry};

use super::scene::{TARGET, scene};
use super::{Placement, SceneParameters};

/// Time between two actions, in seconds (paper, section 4.1).
pub const CONTROL_PERIOD_S: f64 = 0.05;
/// An episode's time limit, in seconds (paper, section 4.1).
pub const TIME_LIMIT_S: f64 = 15.0;
/// Success is within this distance of the target, in metres (paper, section 4.3).
pub(crate) const TOLERANCE_M: f64 = 0.03;

/// Everything about an episode that is settled before it starts.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedCell {
    pub(crate) parameters: SceneParameters,
    /// Where the policy is told that the object stands.
    placement: Placement,
    /// Where it really stands.
    standing: Placement,
    pub(crate) scene: Scene,
    /// Where the object's centre must come to rest, in metres.
    pub(crate) target: [f64; 3],
    /// What each joint's encoder reads too much, in radians.
    pub(crate) bias: Vec<f64>,
}

impl ResolvedCell {
    /// The cell of a scenario for this robot. It depends on nothing else.
    pub fn new(scenario: &Scenario, robot: &Robot) -> Result<Self, Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let gripper = &robot.settings.gripper;
        let parameters =
            SceneParameters::from_assignment(&scenario.requested, Some(gripper)).map_err(|e| setup(e.to_string()))?;
        let placement = Placement::from_name(&parameters.placement)
            .ok_or_else(|| setup(format!("there is no placement `{}`", parameters.placement)))?;
        let placement = placement.moved(parameters.offset_m);
        let mut jitter = scenario.seed.stream("position-jitter");
        let off = parameters.position_jitter_m * jitter.uniform().sqrt();
        let (sin, cos) = jitter.between(0.0, std::f64::consts::TAU).sin_cos();
        let standing = placement.moved([off * cos, off * sin]);
        let mut obstacles = scenario.seed.stream("obstacles");
        let scene = scene(&parameters, &standing, &mut obstacles).map_err(setup)?;
        let target = [TARGET[0], TARGET[1], 0.5 * parameters.size_m];
        let mut encoders = scenario.seed.stream("encoder-bias");
        let noise = parameters.ik_noise_rad;
        let bias = robot.settings.arm.joints.iter().map(|_| encoders.between(-noise, noise)).collect();
        Ok(Self { parameters, placement, standing, scene, target, bias })
    }

    /// What stands there.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What the policy is told.
    pub fn task(&self) -> TaskSpec {
        let size = self.parameters.size_m;
        let shape = self.parameters.shape.as_str();
        TaskSpec {
            instruction: format!("pick up the {shape} and place it at the target"),
            control_period_s: CONTROL_PERIOD_S,
            time_limit_s: TIME_LIMIT_S,
            shape: shape.to_owned(),
            object_extent_m: [size; 3],
            object_pose: self.placement.pose(size),
            target_pose: Pose::upright(self.target, 0.0),
            tolerance_m: TOLERANCE_M,
            approach_speed_m_s: self.parameters.approach_speed_m_s,
        }
    }

    /// The requested parameters as the engine holds them, how it looks as `visual` says.
    pub fn applied(&self, requested: &Assignment, engine: &Readback, visual: &Visual) -> Assignment {
        let Self { parameters: asked, standing, scene, .. } = self;
        let size = engine_size(asked, engine);
        let there = stands(standing, asked.size_m, &engine.object);
        let count = |kind| engine.fixtures.iter().filter(|read| is_there(read, scene, kind)).count() as i64;
        let mover = engine.fixtures.iter().find(|read| is_there(read, scene, FixtureKind::Disturbance));
        let disturbance = asked.disturbance.read(mover.and_then(|read| Some((&read.pose, read.motion.as_ref()?))));
        let offset =
            |axis: usize| asked.offset_m[axis] + engine.object.translation.vector[axis] - standing.position[axis];
        let mut applied = Assignment::default();
        for (name, value) in requested.iter() {
            // A whole number that was asked for as one comes back as one.
            let number = |x: f64| match value {
                Value::Integer(_) if (x - x.round()).abs() < 1e-6 => Value::Integer(x.round() as i64),
                _ => Value::Number(x),
            };
            let read = match name {
                "friction" => number(engine.friction),
                "mass_kg" => number(engine.mass_kg),
                "com_offset" => number(asked.shape.com_offset_of(size, &engine.centre_of_mass)),
                "size_m" => number(size),
                "obstacles" => number(count(FixtureKind::Obstacle) as f64),
                "occluders" => number(count(FixtureKind::Occluder) as f64),
                "offset_x_m" => number(offset(0)),
                "offset_y_m" => number(offset(1)),
                "table_friction" => number(engine.table_friction),
                "gravity_scale" => number(engine.gravity / GRAVITY),
                "position_jitter_m" => number(if there { asked.position_jitter_m } else { f64::NAN }),
                "placement" if there => value.clone(),
                "placement" => Value::Category(format!("{:.6?}", engine.object.translation.vector.as_slice()).into()),
                "shape" => Value::Category(engine_shape(asked, engine).into()),
                _ if disturbance.value(name).is_some() => number(disturbance.value(name).unwrap_or(f64::NAN)),
                _ if visual_value(visual, name).is_some() => match visual_value(visual, name) {
                    Some(Value::Number(x)) => number(x),
                    word => word.unwrap_or(Value::Number(f64::NAN)),
                },
                // What acts through the servo, the cup or the policy is applied by the simulator itself.
                _ => value.clone(),
            };
            applied.set(name, read);
        }
        applied
    }
}

/// Whether a fixture of this kind stands where the scene has it, as it has it.
fn is_there(read: &FixtureRead, scene: &Scene, kind: FixtureKind) -> bool {
    scene.fixtures.get(read.fixture).is_some_and(|fixture| {
        let off = fixture.part.pose.inverse() * read.pose;
        fixture.kind == kind
            && read.primitive.is_some_and(|primitive| same_primitive(&fixture.part.primitive, &primitive))
            && off.translation.vector.norm() < 1e-6
            && off.rotation.angle() < 1e-6
    })
}

/// An engine may hold its shapes in single precision.
fn same_primitive(a: &Primitive, b: &Primitive) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
        && a.half_extent().iter().zip(b.half_extent()).all(|(a, b)| (a - b).abs() < 1e-7)
}

/// The size at which the shape asked for has the engine's first part.
fn engine_size(asked: &SceneParameters, engine: &Readback) -> f64 {
    let unit = asked.shape.object(1.0, 1.0, 0.0);
    let extent = |part: &Primitive| part.half_extent()[0];
    engine.parts.first().map_or(f64::NAN, extent) / extent(&unit.parts[0].primitive)
}

/// The shape whose parts the engine holds.
fn engine_shape(asked: &SceneParameters, engine: &Readback) -> &'static str {
    let parts = asked.shape.object(asked.size_m, 1.0, 0.0).parts;
    let same = parts.len() == engine.parts.len()
        && parts.iter().zip(&engine.parts).all(|(part, read)| same_primitive(&part.primitive, read));
    if same { asked.shape.as_str() } else { "another" }
}

/// Whether the object stands where it shall.
fn stands(standing: &Placement, size: f64, object: &Isometry3<f64>) -> bool {
    let pose = standing.pose(size);
    let off = isometry(&pose.position, &pose.orientation).inverse() * object;
    off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6
}

/// The value of a visual parameter as the cameras hold it.
fn visual_value(visual: &Visual, parameter: &str) -> Option<Value> {
    Some(match parameter {
        "lighting_lux" => Value::Number(visual.lighting_lux),
        "camera_roll_rad" => Value::Number(visual.camera_roll_rad),
        "camera_pitch_rad" => Value::Number(visual.camera_pitch_rad),
        "object_transparency" => Value::Number(visual.object_transparency),
        "table_material" => Value::Category(visual.table_material.as_str().into()),
        "background_color" => Value::Category(visual.background_color.to_string().into()),
        "object_color" => Value::Category(visual.object_color.to_string().into()),
        _ => return None,
    })
}
