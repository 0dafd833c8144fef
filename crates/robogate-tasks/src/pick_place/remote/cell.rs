//! A resolved cell as plain data: the cell of `bridges/PROTOCOL.md`.

use nalgebra::Matrix3;
use robogate_core::Pose;
use robogate_physics::{Chain, Fixture, FixtureKind, Motion, Part, Primitive, Robot, Scene, Visual, contact, pose};
use serde::{Deserialize, Serialize};

use crate::arm::CONTROL_PERIOD_S;

/// The whole cell of an episode after every random draw. Units are metres, radians and newtons, in the robot's base
/// frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Time between two commands, in seconds.
    pub control_period_s: f64,
    /// Gravity, downwards, in m/s^2.
    pub gravity_m_s2: f64,
    /// Coulomb friction coefficient of every contact of the object.
    pub friction: f64,
    /// Coulomb friction coefficient between the object and the table.
    pub table_friction: f64,
    /// Constants of contacts.
    pub contact: CellContact,
    /// The object.
    pub object: CellObject,
    /// The table first, then all other fixtures.
    pub fixtures: Vec<CellFixture>,
    /// The robot's drives.
    pub robot: CellRobot,
    /// Appearance of the scene.
    pub visual: CellVisual,
}

/// Constants of contacts, as in [`robogate_physics::contact`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CellContact {
    /// Radius of a soft contact patch: torsional friction is 2/3 of friction times this.
    pub patch_radius_m: f64,
    /// Rolling friction of a ball.
    pub rolling_m: f64,
    /// Time constant of the object's contacts and of joint end stops, at critical damping.
    pub time_constant_s: f64,
    /// MuJoCo's constraint impedance of the object's contacts.
    pub impedance: [f64; 3],
    /// MuJoCo's constraint impedance of joint end stops.
    pub limit_impedance: [f64; 3],
    /// Mass of a moving fixture.
    pub driven_mass_kg: f64,
}

/// The object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellObject {
    /// The parts in its own frame.
    pub parts: Vec<CellPart>,
    /// The pose at the start.
    pub pose: Pose,
    /// The mass in kilograms.
    pub mass_kg: f64,
    /// The centre of mass in its own frame.
    pub centre_of_mass: [f64; 3],
    /// The inertia about the centre of mass along its own axes, row by row.
    pub inertia_kg_m2: [[f64; 3]; 3],
}

/// A part of the object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellPart {
    /// The shape.
    pub primitive: Primitive,
    /// The pose in the object's frame.
    pub pose: Pose,
}

/// A body that stands still or follows a prescribed motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellFixture {
    /// The name.
    pub name: String,
    /// The role.
    pub kind: FixtureKind,
    /// The shape.
    pub primitive: Primitive,
    /// The pose at the start.
    pub pose: Pose,
    /// The motion, if it moves.
    pub motion: Option<CellMotion>,
}

/// A straight path at constant speed within a time window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CellMotion {
    /// Velocity.
    pub velocity_m_s: [f64; 3],
    /// Start, in seconds.
    pub starts_s: f64,
    /// End, in seconds.
    pub ends_s: f64,
}

impl From<&Motion> for CellMotion {
    fn from(motion: &Motion) -> Self {
        Self { velocity_m_s: motion.velocity.into(), starts_s: motion.starts_s, ends_s: motion.ends_s }
    }
}

impl From<CellMotion> for Motion {
    fn from(motion: CellMotion) -> Self {
        Self { velocity: motion.velocity_m_s.into(), starts_s: motion.starts_s, ends_s: motion.ends_s }
    }
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
}

/// The gripper's drives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum CellGripper {
    /// Two fingers that slide against each other.
    ParallelJaw {
        /// Names of the fingers' joints.
        finger_joints: [String; 2],
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
    },
}

/// Appearance of a cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellVisual {
    /// Illuminance on the table.
    pub lighting_lux: f64,
    /// Rotation of each camera about its line of sight.
    pub camera_roll_rad: f64,
    /// Upward tilt of each camera.
    pub camera_pitch_rad: f64,
    /// Material of the table's top.
    pub table_material: String,
    /// Colour of the background, `#rrggbb`.
    pub background_color: String,
    /// Colour of the object, `#rrggbb`.
    pub object_color: String,
    /// Fraction of the light that passes through the object.
    pub object_transparency: f64,
}

impl From<&Visual> for CellVisual {
    fn from(visual: &Visual) -> Self {
        Self {
            lighting_lux: visual.lighting_lux,
            camera_roll_rad: visual.camera_roll_rad,
            camera_pitch_rad: visual.camera_pitch_rad,
            table_material: visual.table_material.as_str().to_owned(),
            background_color: visual.background_color.to_string(),
            object_color: visual.object_color.to_string(),
            object_transparency: visual.object_transparency,
        }
    }
}

impl Cell {
    /// The cell of this episode for this robot.
    ///
    /// # Errors
    /// If the gripper is not a parallel jaw of two slides.
    pub(super) fn new(
        scene: &Scene,
        robot: &Robot,
        chain: &Chain,
        grip_force_n: f64,
        sha256: Option<String>,
    ) -> Result<Self, String> {
        let arm = &robot.settings.arm;
        let jaw = robot.settings.gripper.jaw().ok_or_else(|| {
            let (name, gripper) = (robot.name(), robot.settings.gripper.description());
            format!("{name} has {gripper}. Expected a parallel jaw for an engine of another process")
        })?;
        let finger_joints = jaw.finger_joints.clone().ok_or_else(|| {
            format!(
                "the fingers of {} have drives. Expected finger_joints for an engine of another process",
                robot.name()
            )
        })?;
        let mass = &scene.object.mass;
        let m: &Matrix3<f64> = &mass.inertia;
        Ok(Self {
            control_period_s: CONTROL_PERIOD_S,
            gravity_m_s2: scene.gravity,
            friction: scene.friction,
            table_friction: scene.table_friction.unwrap_or(scene.friction),
            contact: CellContact {
                patch_radius_m: contact::PATCH_RADIUS_M,
                rolling_m: contact::ROLLING_M,
                time_constant_s: contact::TIME_CONSTANT_S,
                impedance: contact::IMPEDANCE,
                limit_impedance: contact::LIMIT_IMPEDANCE,
                driven_mass_kg: contact::DRIVEN_MASS_KG,
            },
            object: CellObject {
                parts: scene.object.parts.iter().map(CellPart::from).collect(),
                pose: pose(&scene.object_pose),
                mass_kg: mass.mass_kg,
                centre_of_mass: mass.centre.into(),
                inertia_kg_m2: [0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]]),
            },
            fixtures: scene.fixtures.iter().map(CellFixture::from).collect(),
            robot: CellRobot {
                name: robot.name().to_owned(),
                sha256,
                joints: arm.joints.clone(),
                home_rad: arm.home_rad.clone(),
                position_limit_rad: chain.joints.iter().map(|joint| joint.range).collect(),
                velocity_limit_rad_s: arm.velocity_limit_rad_s.clone(),
                acceleration_limit_rad_s2: arm.acceleration_limit_rad_s2.clone(),
                torque_limit_nm: arm.torque_limit_nm.clone(),
                stiffness_nm_rad: arm.stiffness_nm_rad.clone(),
                damping_nms_rad: arm.damping_nms_rad.clone(),
                tcp_site: arm.tcp_site.clone(),
                gripper: CellGripper::ParallelJaw {
                    finger_joints,
                    finger_bodies: jaw.finger_bodies.clone(),
                    opening_m: jaw.opening_m,
                    finger_speed_m_s: jaw.finger_speed_m_s,
                    force_n: grip_force_n,
                    stiffness_n_m: jaw.stiffness_n_m,
                    damping_ns_m: jaw.damping_ns_m,
                },
            },
            visual: CellVisual::from(&scene.visual),
        })
    }
}

impl From<&Part> for CellPart {
    fn from(part: &Part) -> Self {
        Self { primitive: part.primitive, pose: pose(&part.pose) }
    }
}

impl From<&Fixture> for CellFixture {
    fn from(fixture: &Fixture) -> Self {
        Self {
            name: fixture.name.clone(),
            kind: fixture.kind,
            primitive: fixture.part.primitive,
            pose: pose(&fixture.part.pose),
            motion: fixture.motion.as_ref().map(CellMotion::from),
        }
    }
}
