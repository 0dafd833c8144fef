//! Resolves a scenario: the parts on the table, the order and the offset of the stack.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{
    Assignment, CameraSpec, Fault, Foresight, Infeasibility, Policy, Pose, Scenario, TaskInstance, TaskSpec,
};
use robogate_physics::{
    Chain, Color, Fixture, FreeBody, GRAVITY, Gripper, MassProperties, Object, Part, Primitive, Robot, Scene, Visual,
};

use super::claims::CLAIMS;
use super::controller::{self, Scripted};
use super::foresight::StackingForesight;
use super::parameters::{PARTS, Settings, TABLE};
use super::referee::Referee;
use super::spec::{self, Briefing};
use super::{NAME, Stacking};
use crate::arm::claims::Claim;
use crate::arm::{
    ArmDeclaration, GRIP_THRESHOLD_M, Load, Parameters, Resolved, Rules, ToolExpert, cannot_carry, disc_point,
    encoder_bias, out_of_reach, within_reach,
};

/// Nominal positions (x, y) of the parts, in metres. A hand that grasps one of them has room beside the others.
const PLACES: [[f64; 2]; 3] = [[0.42, -0.16], [0.56, 0.0], [0.42, 0.16]];

/// Colours of the parts.
const COLORS: [Color; 3] = [Color([200, 60, 40]), Color([58, 110, 165]), Color([222, 170, 60])];

impl ArmDeclaration for Stacking {
    fn name(&self) -> &'static str {
        NAME
    }

    fn summary(&self) -> &str {
        "stack two parts on a third one with a robot arm, in a given order and with a given offset"
    }

    fn suite(&self) -> Option<&'static str> {
        Some("stacking-40")
    }

    fn parameters(&self) -> &dyn Parameters {
        &TABLE
    }

    fn first_part(&self, instance: &TaskInstance) -> Result<[f64; 4], Fault> {
        let briefing = Briefing::of(instance)?;
        let [x, y, z] = briefing.parts[briefing.order[1]].position;
        Ok([x, y, z, briefing.size_m])
    }

    fn own_claims(&self, _: &Gripper) -> Vec<Claim> {
        CLAIMS.to_vec()
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }

    fn tool_expert(&self, robot: Robot) -> Option<Box<dyn Policy>> {
        Some(Box::new(ToolExpert::new(NAME, controller::way, robot)))
    }
}

impl Rules for Stacking {
    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Option<Arc<dyn Foresight>> {
        Some(Arc::new(StackingForesight::new(robot, chain, grip_force_n, self.tolerance_m)))
    }

    fn infeasibility(&self, requested: &Assignment, robot: &Robot, grip_force_n: f64) -> Option<Infeasibility> {
        let settings: Settings = TABLE.decode(requested, &robot.settings.gripper).ok()?;
        // The first part of the order stays where it is.
        let heaviest = settings.mass(1).max(settings.mass(2));
        let pads = settings.friction * settings.around.gripper.pad_friction_scale;
        let load = Load {
            width_m: (pads < 1.0).then_some(settings.size_m),
            friction: (pads < 1.0).then_some(pads),
            weight_n: heaviest * GRAVITY * settings.gravity_scale,
            force_scale: settings.around.gripper.force_scale,
        };
        let far = |at: [f64; 2]| out_of_reach(robot, "part", at, settings.position_jitter_m);
        within_reach(robot, PLACES)
            .into_iter()
            .find_map(far)
            .or_else(|| cannot_carry(robot, &load, grip_force_n, self.arm.suction))
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        spec::spec(robot, cameras)
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved, Fault> {
        let settings = settings(scenario, robot)?;
        Ok(Resolved {
            scene: scene(&settings),
            grip_threshold_m: GRIP_THRESHOLD_M,
            bias: settings.around.bias(scenario, robot)?,
            instance: briefing(&settings, self.tolerance_m).instance(),
            trial: Box::new(Referee::new(settings, *self, grip_force_n)),
        })
    }
}

/// The briefing of an episode with these settings, and this tolerance of each place in metres.
pub(super) fn briefing(settings: &Settings, tolerance_m: f64) -> Briefing {
    Briefing {
        size_m: settings.size_m,
        parts: settings.places.map(|[x, y]| Pose::upright([x, y, 0.5 * settings.size_m], 0.0)),
        order: settings.order,
        offset_m: [settings.overhang * settings.size_m, 0.0],
        tolerance_m,
    }
}

/// The settings of a scenario with all random draws.
///
/// # Errors
/// A setup fault if the scenario cannot be set up.
pub(super) fn settings(scenario: &Scenario, robot: &Robot) -> Result<Settings, Fault> {
    let mut settings: Settings = TABLE.decode(&scenario.requested, &robot.settings.gripper)?;
    settings.places = within_reach(robot, PLACES);
    let mut stream = scenario.seed.stream("part-jitter");
    for part in 0..PARTS.len() {
        settings.shift[part] = disc_point(&mut stream);
        settings.turn[part] = stream.between(-1.0, 1.0);
    }
    settings.around.encoders = encoder_bias(scenario, robot, 1.0);
    Ok(settings)
}

impl Settings {
    /// Mass of the part at a level of the stack, in kilograms.
    pub(super) fn mass(&self, level: usize) -> f64 {
        self.mass_kg * self.mass_step.powi(level as i32)
    }

    /// The pose of a part at the start.
    pub(super) fn pose(&self, part: usize) -> Isometry3<f64> {
        let ([x, y], [dx, dy]) = (self.places[part], self.shift[part]);
        let jitter = self.position_jitter_m;
        let yaw = self.turn[part] * self.yaw_jitter_rad;
        Isometry3::from_parts(
            Translation3::new(x + jitter * dx, y + jitter * dy, 0.5 * self.size_m),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        )
    }
}

/// The scene of these settings.
pub(super) fn scene(settings: &Settings) -> Scene {
    let half = 0.5 * settings.size_m;
    let parts = vec![Part { primitive: Primitive::Box { half: [half; 3] }, pose: Isometry3::identity() }];
    let body = |part: usize| {
        let level = settings.order.iter().position(|at| *at == part).unwrap_or_default();
        FreeBody {
            name: format!("part_{}", PARTS[part]),
            object: Object {
                mass: MassProperties::homogeneous(&parts, settings.mass(level)),
                parts: parts.clone(),
                joint: None,
            },
            pose: settings.pose(part),
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
        gripper: settings.around.gripper,
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY * settings.gravity_scale,
        marker: None,
        visual: Visual { object_color: color, ..settings.around.visual() },
    }
}
