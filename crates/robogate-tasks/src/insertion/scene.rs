//! Resolves a scenario: a peg that stands on the table, and a block with a hole.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{
    Assignment, CameraSpec, Fault, Foresight, Infeasibility, Policy, Pose, Scenario, TaskInstance, TaskSpec,
};
use robogate_physics::{Chain, Fixture, GRAVITY, Gripper, Robot, Scene};

use super::claims::CLAIMS;
use super::controller::{self, Scripted};
use super::foresight::InsertionForesight;
use super::parameters::{Settings, TABLE};
use super::parts::{self, DEPTH_M, HEAD_HEIGHT_M, HEAD_M, SHAFT_M};
use super::referee::Referee;
use super::spec::{self, Briefing};
use super::{Insertion, NAME};
use crate::arm::claims::Claim;
use crate::arm::{
    ArmDeclaration, GRIP_THRESHOLD_M, Load, Parameters, Resolved, Rules, ToolExpert, cannot_carry, disc_point,
    encoder_bias, instance, out_of_reach, within_reach,
};

/// Nominal positions (x, y) of peg and hole, in metres.
const PLACES: [[f64; 2]; 2] = [[0.42, -0.14], [0.48, 0.14]];

/// Friction coefficient of the peg against the gripper: rubber pads or a rubber lip.
pub(super) const GRIP_FRICTION: f64 = 0.8;

impl ArmDeclaration for Insertion {
    fn name(&self) -> &'static str {
        NAME
    }

    fn summary(&self) -> &str {
        "insert a peg into a hole with a small clearance with a robot arm"
    }

    fn suite(&self) -> Option<&'static str> {
        Some("insertion-40")
    }

    fn parameters(&self) -> &dyn Parameters {
        &TABLE
    }

    fn first_part(&self, instance: &TaskInstance, _: &Robot) -> Result<[f64; 4], Fault> {
        let [x, y, z] = Briefing::of(instance)?.peg.position;
        Ok([x, y, z + SHAFT_M + 0.5 * HEAD_HEIGHT_M, HEAD_M])
    }

    fn own_claims(&self, _: &Gripper) -> Vec<Claim> {
        CLAIMS.to_vec()
    }

    fn controller(&self, robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }

    fn tool_expert(&self, robot: Robot, _: Chain) -> Option<Box<dyn Policy>> {
        Some(Box::new(ToolExpert::new(NAME, Arc::new(controller::way), robot)))
    }
}

impl Rules for Insertion {
    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Option<Arc<dyn Foresight>> {
        Some(Arc::new(InsertionForesight::new(robot, chain, grip_force_n)))
    }

    fn infeasibility(&self, requested: &Assignment, robot: &Robot, grip_force_n: f64) -> Option<Infeasibility> {
        let settings: Settings = TABLE.decode(requested, &robot.settings.gripper).ok()?;
        let load = Load {
            width_m: Some(settings.width_m),
            // The head may rest on the pads.
            friction: None,
            weight_n: settings.mass_kg * GRAVITY,
            force_scale: settings.around.gripper.force_scale,
        };
        let [peg, hole] = within_reach(robot, PLACES);
        out_of_reach(robot, "hole", hole, settings.hole_jitter_m)
            .or_else(|| out_of_reach(robot, "peg", peg, settings.peg_jitter_m))
            .or_else(|| cannot_carry(robot, &load, grip_force_n, self.arm.suction))
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        spec::spec(robot, cameras)
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved, Fault> {
        let settings = settings(scenario, robot)?;
        let [peg, hole] = nominal_poses(robot);
        let briefing = Briefing {
            peg,
            hole,
            clearance_m: settings.clearance_m,
            chamfer_m: settings.chamfer_m,
            arm_stiffness: settings.arm_stiffness,
        };
        Ok(Resolved {
            scene: settings.scene(),
            grip_threshold_m: GRIP_THRESHOLD_M,
            bias: settings.around.bias(scenario, robot)?,
            instance: instance("pick up the peg and insert it into the hole".to_owned(), &briefing),
            trial: Box::new(Referee::new(settings, *self, grip_force_n)),
        })
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
    for shift in &mut settings.shift {
        *shift = disc_point(&mut stream);
    }
    settings.tilt = [stream.between(0.0, std::f64::consts::TAU), stream.uniform()];
    settings.around.encoders = encoder_bias(scenario, robot, 1.0);
    Ok(settings)
}

/// Nominal poses of peg and hole for this robot.
pub(super) fn nominal_poses(robot: &Robot) -> [Pose; 2] {
    let [[px, py], [hx, hy]] = within_reach(robot, PLACES);
    [Pose::upright([px, py, 0.0], 0.0), Pose::upright([hx, hy, DEPTH_M], 0.0)]
}

impl Settings {
    /// The frame of the hole in the base frame.
    pub(super) fn mouth(&self) -> Isometry3<f64> {
        let ([x, y], [dx, dy]) = (self.places[1], self.shift[1]);
        Isometry3::from_parts(
            Translation3::new(x + self.hole_jitter_m * dx, y + self.hole_jitter_m * dy, DEPTH_M),
            UnitQuaternion::from_scaled_axis(self.hole_turn()),
        )
    }

    /// The tilt of the hole, as a rotation vector in radians.
    pub(super) fn hole_turn(&self) -> Vector3<f64> {
        let [heading, fraction] = self.tilt;
        Vector3::new(heading.cos(), heading.sin(), 0.0) * (fraction * self.hole_tilt_rad)
    }

    /// The pose of the peg at the start.
    pub(super) fn peg_pose(&self) -> Isometry3<f64> {
        let ([x, y], [dx, dy]) = (self.places[0], self.shift[0]);
        Isometry3::translation(x + self.peg_jitter_m * dx, y + self.peg_jitter_m * dy, 0.0)
    }

    /// The scene.
    pub(super) fn scene(&self) -> Scene {
        let mut fixtures = vec![Fixture::table()];
        fixtures.extend(parts::block(&self.mouth(), self.width_m + self.clearance_m, self.chamfer_m));
        Scene {
            object: parts::peg(self.width_m, self.mass_kg, 0.0),
            object_pose: self.peg_pose(),
            others: Vec::new(),
            friction: GRIP_FRICTION,
            table_friction: Some(self.friction),
            arm_stiffness: self.arm_stiffness,
            gripper: self.around.gripper,
            fixtures,
            gravity: GRAVITY,
            marker: None,
            visual: self.around.visual(),
        }
    }
}
