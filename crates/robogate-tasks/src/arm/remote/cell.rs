//! A resolved cell as plain data: the cell of `bridges/PROTOCOL.md`.

use std::collections::BTreeSet;

use robogate_physics::{
    Bellows, Chain, Fixture, FreeBody, Gripper, GripperUnit, Motion, Part, Robot, Scene, SuctionLaw, Visual, contact,
};
use serde::{Deserialize, Serialize};

use crate::arm::CONTROL_PERIOD_S;

/// Largest number of objects, and of fixtures of a cell and parts of an object.
const MOST_OBJECTS: usize = 32;
const MOST_PARTS: usize = 256;

/// The whole cell of an episode after every random draw. Units are metres, radians and newtons, in the robot's base
/// frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Time between two commands, in seconds.
    pub control_period_s: f64,
    /// Gravity, downwards, in m/s^2.
    pub gravity_m_s2: f64,
    /// Coulomb friction coefficient of the objects against everything.
    pub friction: f64,
    /// Coulomb friction coefficient of the objects against the table and receptacles, if different.
    pub table_friction: Option<f64>,
    /// Constants of contacts.
    pub contact: CellContact,
    /// The bodies that move freely.
    pub objects: Vec<FreeBody>,
    /// The table first, then all other fixtures.
    pub fixtures: Vec<Fixture>,
    /// The robot's drives.
    pub robot: CellRobot,
    /// Appearance of the scene.
    pub visual: Visual,
}

/// Constants of contacts, as in [`robogate_physics::contact`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CellContact {
    /// Radius of a soft contact patch: torsional friction is 2/3 of friction times this.
    pub patch_radius_m: f64,
    /// Rolling friction of a ball.
    pub rolling_m: f64,
    /// Time constant of the objects' contacts and of joint end stops, at critical damping.
    pub time_constant_s: f64,
    /// MuJoCo's constraint impedance of the objects' contacts.
    pub impedance: [f64; 3],
    /// MuJoCo's constraint impedance of joint end stops.
    pub limit_impedance: [f64; 3],
    /// Mass of a moving fixture.
    pub driven_mass_kg: f64,
}

/// The robot's drives. Arrays have one entry per arm joint, from base to tip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellRobot {
    /// The name.
    pub name: String,
    /// Hash of its files.
    pub sha256: Option<String>,
    /// Names of the arm's joints.
    pub joints: Vec<String>,
    /// Joint positions at the start.
    pub home_rad: Vec<f64>,
    /// Smallest and largest positions.
    pub position_limit_rad: Vec<[f64; 2]>,
    /// Largest speeds.
    pub velocity_limit_rad_s: Vec<f64>,
    /// Largest accelerations.
    pub acceleration_limit_rad_s2: Vec<f64>,
    /// Largest torques.
    pub torque_limit_nm: Vec<f64>,
    /// Stiffness of the joint servo.
    pub stiffness_nm_rad: Vec<f64>,
    /// Damping of the joint servo.
    pub damping_nms_rad: Vec<f64>,
    /// The site at the tool centre point.
    pub tcp_site: String,
    /// The gripper.
    pub gripper: CellGripper,
    /// Multiples of the robot's own values, which the values above contain already.
    pub scales: CellScales,
}

/// Values of this episode as multiples of the robot's own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CellScales {
    /// Stiffness of the arm's servos. Their damping has the square root of it, so that the damping ratio is constant.
    pub stiffness: f64,
    /// Force of the pads, or vacuum of the cup.
    pub grip_force: f64,
    /// Friction coefficient of the objects against the pads, as a multiple of that of the cell.
    pub pad_friction: f64,
}

/// The gripper's drives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum CellGripper {
    /// Two fingers that move against each other.
    ParallelJaw {
        /// Names of the sliding joints of the fingers. `None` if the model drives the fingers in another way.
        finger_joints: Option<[String; 2]>,
        /// Names of the bodies that carry the pads.
        finger_bodies: [String; 2],
        /// Opening between the pads when open.
        opening_m: f64,
        /// Speed of each finger.
        finger_speed_m_s: f64,
        /// Normal force of each pad.
        force_n: f64,
        /// Stiffness of a finger's servo.
        stiffness_n_m: f64,
        /// Damping of a finger's servo.
        damping_ns_m: f64,
        /// Coulomb friction coefficient of the objects against the pads.
        pad_friction: f64,
    },
    /// A suction cup.
    Suction {
        /// Name of the body that carries the cup.
        cup_body: String,
        /// Diameter of the lip.
        cup_diameter_m: f64,
        /// Pressure in the cup below the ambient pressure.
        vacuum_pa: f64,
        /// The spring of the cup along its axis.
        bellows: Option<Bellows>,
        /// How the cup holds an object.
        law: SuctionLaw,
        /// Distance to an object within which the cup takes hold.
        threshold_m: f64,
    },
}

/// The settings of a cell that a scene does not contain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grasping {
    /// Grip force of the robot under the settings of the task, in newtons.
    pub(crate) force_n: f64,
    /// How a suction cup holds an object.
    pub(crate) law: SuctionLaw,
    /// Distance to an object within which a suction cup takes hold, in metres.
    pub(crate) threshold_m: f64,
}

impl Cell {
    /// The cell of an episode with this scene, for this robot with the file hash `sha256`.
    pub(super) fn new(scene: &Scene, robot: &Robot, chain: &Chain, grasping: Grasping, sha256: Option<String>) -> Self {
        let arm = &robot.settings.arm;
        let unit = scene.gripper;
        let scaled = |values: &[f64], scale: f64| values.iter().map(|value| value * scale).collect();
        let gripper = match &robot.settings.gripper {
            Gripper::ParallelJaw(jaw) => CellGripper::ParallelJaw {
                finger_joints: jaw.finger_joints.clone(),
                finger_bodies: jaw.finger_bodies.clone(),
                opening_m: jaw.opening_m,
                finger_speed_m_s: jaw.finger_speed_m_s,
                force_n: grasping.force_n * unit.force_scale,
                stiffness_n_m: jaw.stiffness_n_m,
                damping_ns_m: jaw.damping_ns_m,
                pad_friction: unit.pad_friction_scale * scene.friction,
            },
            Gripper::Suction(cup) => CellGripper::Suction {
                cup_body: cup.cup_body.clone(),
                cup_diameter_m: cup.cup_diameter_m,
                vacuum_pa: cup.vacuum_pa * unit.force_scale,
                bellows: cup.bellows,
                law: grasping.law,
                threshold_m: grasping.threshold_m,
            },
        };
        Self {
            control_period_s: CONTROL_PERIOD_S,
            gravity_m_s2: scene.gravity,
            friction: scene.friction,
            table_friction: scene.table_friction,
            contact: CellContact {
                patch_radius_m: contact::PATCH_RADIUS_M,
                rolling_m: contact::ROLLING_M,
                time_constant_s: contact::TIME_CONSTANT_S,
                impedance: contact::IMPEDANCE,
                limit_impedance: contact::LIMIT_IMPEDANCE,
                driven_mass_kg: contact::DRIVEN_MASS_KG,
            },
            objects: objects(scene),
            fixtures: scene.fixtures.clone(),
            robot: CellRobot {
                name: robot.name().to_owned(),
                sha256,
                joints: arm.joints.clone(),
                home_rad: arm.home_rad.clone(),
                position_limit_rad: chain.joints.iter().map(|joint| joint.range).collect(),
                velocity_limit_rad_s: arm.velocity_limit_rad_s.clone(),
                acceleration_limit_rad_s2: arm.acceleration_limit_rad_s2.clone(),
                torque_limit_nm: arm.torque_limit_nm.clone(),
                stiffness_nm_rad: scaled(&arm.stiffness_nm_rad, scene.arm_stiffness),
                damping_nms_rad: scaled(&arm.damping_nms_rad, scene.arm_stiffness.sqrt()),
                tcp_site: arm.tcp_site.clone(),
                gripper,
                scales: CellScales {
                    stiffness: scene.arm_stiffness,
                    grip_force: unit.force_scale,
                    pad_friction: unit.pad_friction_scale,
                },
            },
            visual: scene.visual,
        }
    }

    /// The scene of this cell, for an engine with this robot.
    ///
    /// # Errors
    /// If the cell is for another robot, or has a value that no engine can set up.
    pub(super) fn scene(&self, robot: &Robot) -> Result<Scene, String> {
        if self.robot.joints != robot.settings.arm.joints {
            return Err(format!("this server's robot is {}, the cell is for {}", robot.name(), self.robot.name));
        }
        let period = self.control_period_s;
        if (period - CONTROL_PERIOD_S).abs() > 1e-9 {
            return Err(format!("control_period_s is {period}. Expected {CONTROL_PERIOD_S}"));
        }
        counted("objects", self.objects.len(), MOST_OBJECTS)?;
        counted("fixtures", self.fixtures.len(), MOST_PARTS)?;
        let CellScales { stiffness, grip_force, pad_friction } = self.robot.scales;
        let positive = [("robot.scales.stiffness", stiffness), ("robot.scales.grip_force", grip_force)];
        positive.into_iter().try_for_each(|(what, value)| above_zero(what, value))?;
        let mut names = BTreeSet::new();
        let all = self.objects.iter().map(|object| &object.name);
        for name in all.chain(self.fixtures.iter().map(|fixture| &fixture.name)) {
            let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.".contains(&byte);
            if !(1..=64).contains(&name.len()) || !name.bytes().all(plain) || !names.insert(name) {
                let name: String = name.chars().take(64).collect();
                return Err(format!(
                    "the name `{name}` is not valid. Expected different names of 1 to 64 ASCII letters, digits, `_`, `-` and `.`"
                ));
            }
        }
        for FreeBody { name, object, .. } in &self.objects {
            counted(&format!("parts of {name}"), object.parts.len(), MOST_PARTS)?;
            above_zero(&format!("mass_kg of {name}"), object.mass.mass_kg)?;
            object.parts.iter().try_for_each(|part| sizes(name, part))?;
        }
        for Fixture { name, part, motion, .. } in &self.fixtures {
            sizes(name, part)?;
            let speed = match motion {
                None => 1.0,
                Some(Motion::Straight { velocity, .. }) => velocity.norm(),
                Some(_) => return Err(format!("the motion of {name} is not a straight path at constant speed")),
            };
            above_zero(&format!("the speed of {name}"), speed)?;
        }
        let FreeBody { object, pose, color, .. } = self.objects[0].clone();
        let force_scale = match self.robot.gripper {
            // The force of the pads contains it already.
            CellGripper::ParallelJaw { .. } => 1.0,
            CellGripper::Suction { .. } => grip_force,
        };
        Ok(Scene {
            object,
            object_pose: pose,
            others: self.objects[1..].to_vec(),
            friction: self.friction,
            table_friction: self.table_friction,
            arm_stiffness: stiffness,
            gripper: GripperUnit { force_scale, pad_friction_scale: pad_friction },
            fixtures: self.fixtures.clone(),
            gravity: self.gravity_m_s2,
            marker: None,
            visual: Visual { object_color: color, ..self.visual },
        })
    }
}

fn counted(what: &str, count: usize, most: usize) -> Result<(), String> {
    if (1..=most).contains(&count) { Ok(()) } else { Err(format!("{count} {what}. Expected 1 to {most}")) }
}

fn above_zero(what: &str, value: f64) -> Result<(), String> {
    if value > 0.0 { Ok(()) } else { Err(format!("{what} is {value}. Expected above 0")) }
}

fn sizes(name: &str, part: &Part) -> Result<(), String> {
    part.primitive.half_extent().into_iter().try_for_each(|size| above_zero(&format!("a size of {name}"), size))
}

fn objects(scene: &Scene) -> Vec<FreeBody> {
    let first = FreeBody {
        name: "object".to_owned(),
        object: scene.object.clone(),
        pose: scene.object_pose,
        color: scene.visual.object_color,
    };
    std::iter::once(first).chain(scene.others.iter().cloned()).collect()
}
