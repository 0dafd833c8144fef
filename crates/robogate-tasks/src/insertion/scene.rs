//! Resolves a scenario: a peg that stands on the table, and a block with a hole.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{CameraSpec, Fault, Foresight, Policy, Pose, Scenario, TaskSpec};
use robogate_physics::{Chain, Fixture, GRAVITY, GripperUnit, Robot, Scene, Visual};

use super::Insertion;
use super::controller::Scripted;
use super::foresight::InsertionForesight;
use super::parameters::{ROWS, Settings};
use super::parts::{self, DEPTH_M};
use super::referee::Referee;
use super::spec::{self, Briefing};
use crate::arm::{Resolved, Rules, decode, disc_point, encoder_bias, instance, within_reach};

/// Nominal positions (x, y) of peg and hole, in metres.
const PLACES: [[f64; 2]; 2] = [[0.42, -0.14], [0.48, 0.14]];

/// Friction coefficient of the peg against the gripper: rubber pads or a rubber lip.
pub(super) const GRIP_FRICTION: f64 = 0.8;

impl Rules for Insertion {
    type Trial = Referee;

    const NAME: &'static str = "insertion";
    const SUMMARY: &'static str = "insert a peg into a hole with a small clearance with a robot arm";
    const SPACE: &'static str = include_str!("space.toml");
    const SUITE: &'static str = "insertion-40";

    fn scripted(robot: Robot, chain: Chain) -> Box<dyn Policy> {
        Box::new(Scripted::new(robot, chain))
    }

    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Arc<dyn Foresight> {
        Arc::new(InsertionForesight::new(robot, chain, grip_force_n))
    }

    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec {
        spec::spec(robot, cameras)
    }

    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved<Referee>, Fault> {
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
            bias: encoder_bias(scenario, robot, settings.around.encoder_bias_rad),
            instance: instance("pick up the peg and insert it into the hole".to_owned(), &briefing),
            trial: Referee::new(settings, grip_force_n),
        })
    }
}

/// The settings of a scenario with all random draws.
///
/// # Errors
/// A setup fault if the scenario cannot be set up.
pub(super) fn settings(scenario: &Scenario, robot: &Robot) -> Result<Settings, Fault> {
    let mut settings: Settings = decode(&ROWS, &scenario.requested)?;
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
    fn scene(&self) -> Scene {
        let mut fixtures = vec![Fixture::table()];
        fixtures.extend(parts::block(&self.mouth(), self.width_m + self.clearance_m, self.chamfer_m));
        Scene {
            object: parts::peg(self.width_m, self.mass_kg, 0.0),
            object_pose: self.peg_pose(),
            others: Vec::new(),
            friction: GRIP_FRICTION,
            table_friction: Some(self.friction),
            arm_stiffness: self.arm_stiffness,
            gripper: GripperUnit::default(),
            fixtures,
            gravity: GRAVITY,
            marker: None,
            visual: Visual { lighting_lux: self.around.lighting_lux, ..Visual::default() },
        }
    }
}
