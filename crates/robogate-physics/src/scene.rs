//! The scene that an engine loads, as plain data without a task.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Pose;
#[cfg(any(feature = "mujoco", feature = "rapier"))]
use robogate_core::{Fault, FaultKind};
use serde::{Deserialize, Serialize};

#[cfg(any(feature = "mujoco", feature = "rapier"))]
use crate::friction::Against;
use crate::{Color, Joint, MassProperties, Motion, Part, Primitive, Visual, plain};

/// Standard gravity on Earth, in m/s^2.
pub const GRAVITY: f64 = 9.81;

/// Centre of the workspace on the table, in metres in front of the base.
pub const WORKSPACE_CENTRE: [f64; 2] = [0.5, 0.0];

/// Centre of the table, in metres (x, y).
pub const TABLE_CENTRE: [f64; 2] = [0.55, 0.0];

/// Half extents of the table, in metres (x, y).
pub const TABLE_HALF: [f64; 2] = [0.4, 0.7];

/// The world of a scenario, before an engine simulates it.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The object: a body that moves freely.
    pub object: Object,
    /// Pose of the object at the start.
    pub object_pose: Isometry3<f64>,
    /// Further bodies that move freely.
    pub others: Vec<FreeBody>,
    /// Coulomb friction coefficient of the bodies that state none, against everything.
    pub friction: f64,
    /// Coulomb friction coefficient of the object against the table and receptacles, if different.
    pub table_friction: Option<f64>,
    /// Stiffness of the arm's servos as a multiple of the robot's setting. Their damping ratio does not change.
    pub arm_stiffness: f64,
    /// Deviations of this robot's gripper from its settings.
    pub gripper: GripperUnit,
    /// The table first, then all other bodies that the robot must not touch.
    pub fixtures: Vec<Fixture>,
    /// Gravity, in m/s^2.
    pub gravity: f64,
    /// Centre (x, y) in metres of a ring painted on the table. It has no effect on physics.
    pub marker: Option<[f64; 2]>,
    /// Appearance of the scene.
    pub visual: Visual,
}

impl Scene {
    /// All bodies that move freely: the object, then the others.
    pub fn free_bodies(&self) -> impl Iterator<Item = (&Object, &Isometry3<f64>)> {
        std::iter::once((&self.object, &self.object_pose))
            .chain(self.others.iter().map(|body| (&body.object, &body.pose)))
    }

    /// The friction coefficient of a free body.
    pub fn friction_of(&self, object: &Object) -> f64 {
        object.friction.unwrap_or(self.friction)
    }

    /// The friction coefficient of the pads, if it is not that of the bodies.
    ///
    /// # Errors
    /// If bodies have different coefficients, because a pad has one.
    #[cfg(any(feature = "mujoco", feature = "rapier"))]
    pub(crate) fn pad_friction(&self) -> Result<Option<f64>, Fault> {
        let pads = self.gripper.pad_friction(self.friction);
        if pads.is_some() && self.free_bodies().any(|(object, _)| object.friction.is_some()) {
            let why = "pad_friction_scale needs parts with one friction coefficient. Leave out `friction` of the parts";
            return Err(Fault::new(FaultKind::Setup, why));
        }
        Ok(pads)
    }

    /// A free body: 0 is the object, then come the others.
    pub fn free_body(&self, body: usize) -> &Object {
        body.checked_sub(1).and_then(|other| self.others.get(other)).map_or(&self.object, |other| &other.object)
    }
}

/// Deviations of one unit's gripper from the settings of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperUnit {
    /// Force of the pads, or vacuum of the cup, as a multiple of the robot's setting.
    pub force_scale: f64,
    /// Friction coefficient of an object against the pads as a multiple of the object's. A suction cup has no pads.
    pub pad_friction_scale: f64,
}

impl Default for GripperUnit {
    fn default() -> Self {
        Self { force_scale: 1.0, pad_friction_scale: 1.0 }
    }
}

impl GripperUnit {
    /// The friction coefficient of the pads, if it is not that of the object.
    pub(crate) fn pad_friction(&self, object: f64) -> Option<f64> {
        ((self.pad_friction_scale - 1.0).abs() > 0.0).then_some(self.pad_friction_scale * object)
    }
}

/// A further body that moves freely.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FreeBody {
    /// The name in recordings.
    pub name: String,
    /// Its parts and mass.
    #[serde(flatten)]
    pub object: Object,
    /// The pose at the start.
    #[serde(with = "plain")]
    pub pose: Isometry3<f64>,
    /// The colour in camera images.
    #[serde(with = "plain")]
    pub color: Color,
}

/// A rigid body that moves freely or on a joint: its parts about its own origin, and its mass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Object {
    /// The parts.
    pub parts: Vec<Part>,
    /// Mass, centre of mass and inertia.
    #[serde(flatten)]
    pub mass: MassProperties,
    /// The joint that holds it. Such a body touches the robot and bodies that move freely, and nothing else. `None` if it
    /// moves freely.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<Joint>,
    /// Its Coulomb friction coefficient, if it is not that of the scene. A contact has the larger one of its two sides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
}

/// A body that stands still or follows a prescribed motion. Contact of the robot with it is a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fixture {
    /// The name in contact reports.
    pub name: String,
    /// The role in the scene.
    pub kind: FixtureKind,
    /// The shape, and its pose in the base frame at the start.
    #[serde(flatten)]
    pub part: Part,
    /// The motion, if it moves. An engine drives it, and it pushes the object.
    pub motion: Option<Motion>,
    /// Its Coulomb friction coefficient. Without one, a contact has that of the other body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// The colour in camera images, if it is not that of its kind.
    #[serde(skip)]
    pub color: Option<Color>,
}

/// The role of a fixture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FixtureKind {
    /// The table.
    Table,
    /// An obstacle on the table.
    Obstacle,
    /// A part of a workpiece that receives the object.
    Receptacle,
    /// A panel in the front camera's view.
    Occluder,
    /// A body that crosses the workspace.
    Disturbance,
}

impl FixtureKind {
    /// Whether the object has the table's friction coefficient against such a fixture.
    pub(crate) fn has_table_friction(self) -> bool {
        matches!(self, Self::Table | Self::Receptacle)
    }

    /// The kind of contact of an object with such a fixture.
    #[cfg(any(feature = "mujoco", feature = "rapier"))]
    pub(crate) fn against(self) -> Against {
        if self.has_table_friction() { Against::Table } else { Against::Other }
    }
}

impl Fixture {
    /// The table in front of the robot's base. Its top is the plane z = 0.
    pub fn table() -> Self {
        let primitive = Primitive::Box { half: [TABLE_HALF[0], TABLE_HALF[1], 0.02] };
        let pose = Isometry3::translation(TABLE_CENTRE[0], TABLE_CENTRE[1], -0.02);
        let part = Part { primitive, pose };
        Self { name: "table".to_owned(), kind: FixtureKind::Table, part, motion: None, friction: None, color: None }
    }

    /// A lower bound of the distance from a ball (centre and radius in metres) to the fixture at `pose`, in metres.
    /// Negative if they overlap.
    pub fn distance_bound_at(&self, pose: &Isometry3<f64>, centre: [f64; 3], radius: f64) -> f64 {
        let local = pose.inverse_transform_point(&Point3::from(centre));
        let beyond = local.coords.abs() - Vector3::from(self.part.primitive.half_extent());
        beyond.sup(&Vector3::zeros()).norm() - radius
    }
}

/// A position (m) and a unit quaternion (w, x, y, z) as an isometry.
pub fn isometry(position: &[f64; 3], orientation: &[f64; 4]) -> Isometry3<f64> {
    let [w, x, y, z] = *orientation;
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(Vector3::from(*position)), rotation)
}

/// An isometry as plain numbers.
pub fn pose(isometry: &Isometry3<f64>) -> Pose {
    let rotation = &isometry.rotation;
    Pose { position: isometry.translation.vector.into(), orientation: [rotation.w, rotation.i, rotation.j, rotation.k] }
}
