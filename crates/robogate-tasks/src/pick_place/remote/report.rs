//! Reports of a remote engine as plain data.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Fault, FaultKind, Observation, Pose};
use robogate_physics::{
    Collision, FixtureRead, GripperState, Hit, Motion, Primitive, Readback, StepView, Touches, pose,
};
use serde::{Deserialize, Serialize};

use super::CellMotion;

/// The cell as read from the engine's state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteReadback {
    /// Friction coefficient of the object's contacts.
    pub friction: f64,
    /// Friction coefficient between object and table.
    pub table_friction: f64,
    /// Gravity, downwards.
    pub gravity_m_s2: f64,
    /// The object's mass in kilograms.
    pub mass_kg: f64,
    /// Centre of mass in the object's frame, in metres.
    pub centre_of_mass: [f64; 3],
    /// The object's parts.
    pub parts: Vec<Primitive>,
    /// Pose of the object.
    pub object_pose: Pose,
    /// The fixtures.
    pub fixtures: Vec<RemoteFixture>,
}

/// A fixture as read from an engine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteFixture {
    /// The index in the cell's list.
    pub fixture: usize,
    /// The shape.
    pub primitive: Option<Primitive>,
    /// The pose.
    pub pose: Pose,
    /// The motion, if it moves.
    pub motion: Option<CellMotion>,
}

/// Report of one time step. Forces are normal forces in newtons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteSight {
    /// Force of each finger on the object.
    pub fingers: [Option<f64>; 2],
    /// Whether any other part of the robot touches the object.
    pub body_on_object: bool,
    /// Whether the object touches a fixture.
    pub object_on_fixture: bool,
    /// The strongest contact of the robot with a fixture.
    pub collision: Option<RemoteCollision>,
    /// The largest contact force on any body of the robot.
    pub peak_force_n: Option<f64>,
    /// Pose of the object.
    pub object_pose: Pose,
    /// Velocity of the object's frame.
    pub object_velocity: RemoteVelocity,
    /// Pose of the tool centre point.
    pub tool_pose: Pose,
    /// Opening between the pads, in metres.
    pub opening_m: Option<f64>,
}

/// A contact of the robot with a fixture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteCollision {
    /// Name of the robot's body.
    pub robot_body: String,
    /// The fixture's index in the cell's list.
    pub fixture: usize,
    /// Normal force in newtons.
    pub force_n: f64,
}

/// Velocity of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RemoteVelocity {
    /// Velocity of its origin.
    pub linear_m_s: [f64; 3],
    /// Angular velocity.
    pub angular_rad_s: [f64; 3],
}

/// Report of one control period.
#[derive(Debug, Clone, PartialEq)]
pub struct RemotePeriod {
    /// Observation at its end, without encoder bias.
    pub observation: Observation,
    /// Hash of the engine's full state.
    pub state_hash: u64,
    /// One report per time step.
    pub sights: Vec<RemoteSight>,
    /// Smallest distance between robot and fixtures, in metres.
    pub clearance_m: Option<f64>,
}

/// A view of a time step without its contacts.
pub(super) struct BareView {
    fraction: f64,
    gripper: GripperState,
    pub(super) object: Isometry3<f64>,
    velocity: (Vector3<f64>, Vector3<f64>),
    tcp: Isometry3<f64>,
}

impl BareView {
    pub(super) fn with<'a>(&self, touches: &'a Touches) -> StepView<'a> {
        let Self { fraction, gripper, object, velocity, tcp } = *self;
        StepView { fraction, gripper, touches, object, velocity, tcp }
    }
}

impl RemoteSight {
    /// The contacts and the view of the time step, in a cell with this number of fixtures. New body names are added to
    /// `bodies`.
    pub(super) fn read(
        &self,
        fixtures: usize,
        bodies: &mut Vec<String>,
        share: f64,
    ) -> Result<(Touches, BareView), Fault> {
        let wrong = |what: String| Fault::new(FaultKind::Unavailable, format!("the engine reports {what}"));
        let collision = match &self.collision {
            None => None,
            Some(RemoteCollision { fixture, .. }) if *fixture >= fixtures => {
                return Err(wrong(format!("a collision with fixture {fixture} of {fixtures}")));
            }
            Some(RemoteCollision { robot_body, fixture, force_n }) => {
                let known = bodies.iter().position(|body| body == robot_body);
                let robot_body = known.unwrap_or_else(|| {
                    bodies.push(robot_body.clone());
                    bodies.len() - 1
                });
                Some(Collision { robot_body, hit: Hit::Fixture(*fixture), force: *force_n })
            }
        };
        let touches = Touches {
            fingers: self.fingers,
            body_on_object: self.body_on_object,
            object_on_fixture: self.object_on_fixture,
            collision,
            peak_force: self.peak_force_n,
        };
        let opening = self.opening_m.ok_or_else(|| wrong("no opening of the gripper".to_owned()))?;
        let bare = BareView {
            fraction: share,
            gripper: GripperState::Fingers(opening),
            object: unit(&self.object_pose).map_err(wrong)?,
            velocity: (self.object_velocity.linear_m_s.into(), self.object_velocity.angular_rad_s.into()),
            tcp: unit(&self.tool_pose).map_err(wrong)?,
        };
        Ok((touches, bare))
    }

    /// Builds the report of a view. `body` returns the names of the robot's bodies.
    pub(super) fn of(view: &StepView<'_>, body: impl Fn(usize) -> String) -> Self {
        let touches = view.touches;
        Self {
            fingers: touches.fingers,
            body_on_object: touches.body_on_object,
            object_on_fixture: touches.object_on_fixture,
            // The protocol carries contacts with fixtures only.
            collision: touches.collision.and_then(|Collision { robot_body, hit, force }| match hit {
                Hit::Fixture(fixture) => {
                    Some(RemoteCollision { robot_body: body(robot_body), fixture, force_n: force })
                }
                Hit::Itself(_) => None,
            }),
            peak_force_n: touches.peak_force,
            object_pose: pose(&view.object),
            object_velocity: RemoteVelocity {
                linear_m_s: view.velocity.0.into(),
                angular_rad_s: view.velocity.1.into(),
            },
            tool_pose: pose(&view.tcp),
            opening_m: match view.gripper {
                GripperState::Fingers(opening) => Some(opening),
                GripperState::Cup(_) => None,
            },
        }
    }
}

/// Converts a pose without normalising its quaternion, which would change the engine's bits.
fn unit(pose: &Pose) -> Result<Isometry3<f64>, String> {
    let [w, x, y, z] = pose.orientation;
    let quaternion = Quaternion::new(w, x, y, z);
    if (quaternion.norm_squared() - 1.0).abs() > 2e-6 {
        return Err(format!("the quaternion {:?}, which is not a unit quaternion", pose.orientation));
    }
    let rotation = UnitQuaternion::new_unchecked(quaternion);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(pose.position)), rotation))
}

impl From<RemoteReadback> for Readback {
    fn from(held: RemoteReadback) -> Self {
        // An invalid rotation gives a pose that equals no requested one.
        let place = |pose: &Pose| unit(pose).unwrap_or_else(|_| Isometry3::translation(f64::NAN, f64::NAN, f64::NAN));
        Self {
            friction: held.friction,
            table_friction: held.table_friction,
            // Engines of other processes have no parameter for it.
            pad_friction: None,
            gravity: held.gravity_m_s2,
            arm_stiffness: None,
            mass_kg: held.mass_kg,
            centre_of_mass: held.centre_of_mass.into(),
            parts: held.parts,
            object: place(&held.object_pose),
            others: Vec::new(),
            fixtures: held
                .fixtures
                .into_iter()
                .map(|read| FixtureRead {
                    fixture: read.fixture,
                    primitive: read.primitive,
                    pose: place(&read.pose),
                    motion: read.motion.map(Motion::from),
                })
                .collect(),
        }
    }
}

impl From<&Readback> for RemoteReadback {
    fn from(held: &Readback) -> Self {
        Self {
            friction: held.friction,
            table_friction: held.table_friction,
            gravity_m_s2: held.gravity,
            mass_kg: held.mass_kg,
            centre_of_mass: held.centre_of_mass.into(),
            parts: held.parts.clone(),
            object_pose: pose(&held.object),
            fixtures: held
                .fixtures
                .iter()
                .map(|read| RemoteFixture {
                    fixture: read.fixture,
                    primitive: read.primitive,
                    pose: pose(&read.pose),
                    motion: read.motion.as_ref().map(CellMotion::from),
                })
                .collect(),
        }
    }
}
