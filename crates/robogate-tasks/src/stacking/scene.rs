//! Resolves a scenario: the parts on the table, the order and the offset of the stack.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{CameraSpec, Fault, Policy, Pose, Scenario, TaskSpec};
use robogate_physics::{
    Chain, Color, Fixture, FreeBody, GRAVITY, GripperUnit, MassProperties, Object, Part, Primitive, Robot, Scene,
    Visual,
};

use super::Stacking;
use super::controller::Scripted;
use super::parameters::{PARTS, ROWS, Settings};
use super::referee::Referee;
use super::spec::{self, Briefing, TOLERANCE_M};
use crate::arm::{Resolved, Rules, decode, disc_point, encoder_bias, within_reach};

/// Nominal positions (x, y) of the parts, in metres. A hand that grasps one of them has room beside the others.
const PLACES: [[f64; 2]; 3] = [[0.42, -0.16], [0.56, 0.0], [0.42, 0.16]];

/// Colours of the parts.
const COLORS: [Color; 3] = [Color([200, 60, 40]), Color([58, 110, 165]), Color([222, 170, 60])];

impl Rules for Stacking {
    type Trial = Referee;

    const NAME: &'static str = "stacking";
    const SUMMARY: &'static str =
        "stack two parts on a third one with a robot arm, in a given order and with a given offset";
    const SPACE: &'static str = include_str!("space.toml");
    const SUITE: &'static str = "stacking-40";

    fn scripted(robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        spec::spec(robot, cameras)
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved<Referee>, Fault> {
        let settings = Settings {
            places: within_reach(robot, PLACES),
            ..drawn(decode(&ROWS, &scenario.requested)?, scenario, robot)
        };
        let briefing = Briefing {
            size_m: settings.size_m,
            parts: settings.places.map(|[x, y]| Pose::upright([x, y, 0.5 * settings.size_m], 0.0)),
            order: settings.order,
            offset_m: [settings.overhang * settings.size_m, 0.0],
            tolerance_m: TOLERANCE_M,
        };
        Ok(Resolved {
            scene: scene(&settings),
            bias: encoder_bias(scenario, robot, settings.around.encoder_bias_rad),
            instance: briefing.instance(),
            trial: Referee::new(settings, grip_force_n),
        })
    }
}

/// The settings with the episode's random draws.
fn drawn(mut settings: Settings, scenario: &Scenario, robot: &Robot) -> Settings {
    let mut stream = scenario.seed.stream("part-jitter");
    for part in 0..PARTS.len() {
        settings.shift[part] = disc_point(&mut stream);
        settings.turn[part] = stream.between(-1.0, 1.0);
    }
    settings.around.encoders = encoder_bias(scenario, robot, 1.0);
    settings
}

/// The scene of these settings.
pub(super) fn scene(settings: &Settings) -> Scene {
    let half = 0.5 * settings.size_m;
    let parts = vec![Part { primitive: Primitive::Box { half: [half; 3] }, pose: Isometry3::identity() }];
    let body = |part: usize| {
        let level = settings.order.iter().position(|at| *at == part).unwrap_or_default();
        let mass_kg = settings.mass_kg * settings.mass_step.powi(level as i32);
        let ([x, y], [dx, dy]) = (settings.places[part], settings.shift[part]);
        let jitter = settings.position_jitter_m;
        let yaw = settings.turn[part] * settings.yaw_jitter_rad;
        FreeBody {
            name: format!("part_{}", PARTS[part]),
            object: Object { mass: MassProperties::homogeneous(&parts, mass_kg), parts: parts.clone() },
            pose: Isometry3::from_parts(
                Translation3::new(x + jitter * dx, y + jitter * dy, half),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
            ),
            color: COLORS[part],
        }
    };
    let FreeBody { object, pose, color, .. } = body(0);
    Scene {
        object,
        object_pose: pose,
        others: vec![body(1), body(2)],
        friction: settings.friction,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY * settings.gravity_scale,
        marker: None,
        visual: Visual { lighting_lux: settings.around.lighting_lux, object_color: color, ..Visual::default() },
    }
}
