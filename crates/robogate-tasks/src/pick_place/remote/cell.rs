//! A cell in plain numbers: what `bridges/PROTOCOL.md` calls so.

use nalgebra::Matrix3;
use robogate_core::Pose;
use robogate_physics::{Chain, Fixture, FixtureKind, Motion, Part, Primitive, Robot, Visual, pose};
use serde::{Deserialize, Serialize};

use crate::pick_place::cell::{CONTROL_PERIOD_S, ResolvedCell};

/// The whole cell of an episode, after every random draw. Metres, radians, newtons, the robot's base frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Time between two commands, in seconds.
    pub control_period_s: f64,
    /// Gravity, downwards.
    pub gravity_m_s2: f64,
    /// Coulomb coefficient of every contact of the object.
    pub friction: f64,
    /// The same between object and table.
    pub table_friction: f64,
    /// The object.
    pub object: CellObject,
    /// The table, then whatever else stands or moves there.
    pub fixtures: Vec<CellFixture>,
    /// The robot's drives.
    pub robot: CellRobot,
    /// How it all looks.
    pub visual: CellVisual,
}

/// The object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellObject {
    /// Its parts in its own frame.
    pub parts: Vec<CellPart>,
    /// Where it stands.
    pub pose: Pose,
    /// Its mass in kilograms.
    pub mass_kg: f64,
    /// Its centre of mass in its own frame.
    pub centre_of_mass: [f64; 3],
    /// Its inertia about the centre of mass along its own axes, row by row.
    pub inertia_kg_m2: [[f64; 3]; 3],
}

/// A part of the object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellPart {
    /// Its shape.
    pub primitive: Primitive,
    /// Where it is in the object's frame.
    pub pose: Pose,
}

/// A body that nothing moves from its place or its way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellFixture {
    /// Its name.
    pub name: String,
    /// What it is there for.
    pub kind: FixtureKind,
    /// Its shape.
    pub primitive: Primitive,
    /// Where it stands at the start.
    pub pose: Pose,
    /// How it moves, if it does.
    pub motion: Option<CellMotion>,
}

/// A straight way at constant speed in a window of time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CellMotion {
    /// Its velocity.
    pub velocity_m_s: [f64; 3],
    /// When it sets off, in seconds.
    pub starts_s: f64,
    /// When it comes to a halt.
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

/// The robot's drives. Arrays have one entry per arm joint, base to tip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellRobot {
    /// Its name.
    pub name: String,
    /// The hash of its files.
    pub sha256: Option<String>,
    /// The arm's joints.
    pub joints: Vec<String>,
    /// Where the arm starts.
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
        /// The fingers' joints.
        finger_joints: [String; 2],
        /// The bodies that carry the pads.
        finger_bodies: [String; 2],
        /// Between the pads when open.
        opening_m: f64,
        /// Of each finger.
        finger_speed_m_s: f64,
        /// Of each pad.
        force_n: f64,
        /// Of a finger's servo.
        stiffness_n_m: f64,
        /// Of a finger's servo.
        damping_ns_m: f64,
    },
}

/// How a cell looks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellVisual {
    /// Illuminance on the table.
    pub lighting_lux: f64,
    /// Turn of each camera about its line of sight.
    pub camera_roll_rad: f64,
    /// Tilt of each camera.
    pub camera_pitch_rad: f64,
    /// The table's top.
    pub table_material: String,
    /// Behind the table, `#rrggbb`.
    pub background_color: String,
    /// The object, `#rrggbb`.
    pub object_color: String,
    /// Share of the light that the object lets through.
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
    /// The cell of this episode for this robot; fails where the gripper is no parallel jaw.
    pub(super) fn new(
        resolved: &ResolvedCell,
        robot: &Robot,
        chain: &Chain,
        grip_force_n: f64,
        sha256: Option<String>,
    ) -> Result<Self, String> {
        let (scene, arm) = (&resolved.scene, &robot.settings.arm);
        let jaw = robot.settings.gripper.jaw().ok_or_else(|| {
            let (name, gripper) = (robot.name(), robot.settings.gripper.description());
            format!("{name} has {gripper}; a far engine takes a parallel jaw")
        })?;
        let mass = &scene.object.mass;
        let m: &Matrix3<f64> = &mass.inertia;
        Ok(Self {
            control_period_s: CONTROL_PERIOD_S,
            gravity_m_s2: scene.gravity,
            friction: scene.friction,
            table_friction: scene.table_friction.unwrap_or(scene.friction),
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
                    finger_joints: jaw.finger_joints.clone(),
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
