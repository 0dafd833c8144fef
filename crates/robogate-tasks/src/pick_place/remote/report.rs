//! What a far engine reports, in plain numbers.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Fault, FaultKind, Observation, Pose};
use robogate_physics::{Collision, FixtureRead, GripperState, Motion, Primitive, Readback, StepView, Touches, pose};
use serde::{Deserialize, Serialize};

use super::CellMotion;

/// What an engine holds of the cell, read from its own state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarReadback {
    /// Of the object's contacts.
    pub friction: f64,
    /// Between object and table.
    pub table_friction: f64,
    /// Downwards.
    pub gravity_m_s2: f64,
    /// The object's mass in kilograms.
    pub mass_kg: f64,
    /// In the object's frame, in metres.
    pub centre_of_mass: [f64; 3],
    /// The object's parts.
    pub parts: Vec<Primitive>,
    /// Where the object is.
    pub object_pose: Pose,
    /// The fixtures.
    pub fixtures: Vec<FarFixture>,
}

/// A fixture as an engine holds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarFixture {
    /// Its position in the cell's list.
    pub fixture: usize,
    /// Its shape.
    pub primitive: Option<Primitive>,
    /// Where it stands.
    pub pose: Pose,
    /// How it will move.
    pub motion: Option<CellMotion>,
}

/// One time step. Forces are normal forces in newtons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarSight {
    /// Of each finger on the object.
    pub fingers: [Option<f64>; 2],
    /// Whether any other part of the robot touches the object.
    pub body_on_object: bool,
    /// Whether the object touches a fixture.
    pub object_on_fixture: bool,
    /// The strongest contact of the robot with a fixture.
    pub collision: Option<FarCollision>,
    /// The largest force between the robot and anything.
    pub peak_force_n: Option<f64>,
    /// The object.
    pub object_pose: Pose,
    /// How it moves.
    pub object_velocity: FarVelocity,
    /// The tool centre point.
    pub tool_pose: Pose,
    /// Between the pads, in metres.
    pub opening_m: Option<f64>,
}

/// A contact of the robot with a fixture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarCollision {
    /// The robot's body by its name.
    pub robot_body: String,
    /// The fixture's position in the cell's list.
    pub fixture: usize,
    /// Normal force.
    pub force_n: f64,
}

/// How a frame moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FarVelocity {
    /// Of its origin.
    pub linear_m_s: [f64; 3],
    /// Its turning.
    pub angular_rad_s: [f64; 3],
}

/// One control period of a far engine.
#[derive(Debug, Clone, PartialEq)]
pub struct FarPeriod {
    /// At its end, of the arm as it is.
    pub observation: Observation,
    /// Of the engine's full state.
    pub state_hash: u64,
    /// One for each time step.
    pub sights: Vec<FarSight>,
    /// Smallest distance between robot and fixtures, in metres.
    pub clearance_m: Option<f64>,
}

/// A sight without its touches, which are lent to it.
pub(super) struct Bare {
    fraction: f64,
    gripper: GripperState,
    pub(super) object: Isometry3<f64>,
    velocity: (Vector3<f64>, Vector3<f64>),
    tcp: Isometry3<f64>,
}

impl Bare {
    pub(super) fn with<'a>(&self, touches: &'a Touches) -> StepView<'a> {
        let Self { fraction, gripper, object, velocity, tcp } = *self;
        StepView { fraction, gripper, touches, object, velocity, tcp }
    }
}

impl FarSight {
    /// As the judge wants it, in a cell with so many fixtures. Bodies are numbered as they are met.
    pub(super) fn read(&self, fixtures: usize, bodies: &mut Vec<String>, share: f64) -> Result<(Touches, Bare), Fault> {
        let wrong = |what: String| Fault::new(FaultKind::Unavailable, format!("the far engine reports {what}"));
        let collision = match &self.collision {
            None => None,
            Some(FarCollision { fixture, .. }) if *fixture >= fixtures => {
                return Err(wrong(format!("a collision with fixture {fixture} of {fixtures}")));
            }
            Some(FarCollision { robot_body, fixture, force_n }) => {
                let known = bodies.iter().position(|body| body == robot_body);
                let robot_body = known.unwrap_or_else(|| {
                    bodies.push(robot_body.clone());
                    bodies.len() - 1
                });
                Some(Collision { robot_body, fixture: *fixture, force: *force_n })
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
        let bare = Bare {
            fraction: share,
            gripper: GripperState::Fingers(opening),
            object: unit(&self.object_pose).map_err(wrong)?,
            velocity: (self.object_velocity.linear_m_s.into(), self.object_velocity.angular_rad_s.into()),
            tcp: unit(&self.tool_pose).map_err(wrong)?,
        };
        Ok((touches, bare))
    }

    /// What an engine of ours saw.
    pub(super) fn of(sight: &StepView<'_>, body: impl Fn(usize) -> String) -> Self {
        let touches = sight.touches;
        Self {
            fingers: touches.fingers,
            body_on_object: touches.body_on_object,
            object_on_fixture: touches.object_on_fixture,
            collision: touches.collision.map(|Collision { robot_body, fixture, force }| FarCollision {
                robot_body: body(robot_body),
                fixture,
                force_n: force,
            }),
            peak_force_n: touches.peak_force,
            object_pose: pose(&sight.object),
            object_velocity: FarVelocity {
                linear_m_s: sight.velocity.0.into(),
                angular_rad_s: sight.velocity.1.into(),
            },
            tool_pose: pose(&sight.tcp),
            opening_m: match sight.gripper {
                GripperState::Fingers(opening) => Some(opening),
                GripperState::Cup(_) => None,
            },
        }
    }
}

/// A pose whose quaternion is one, bit for bit as it came: normalising would change what another engine computed.
fn unit(pose: &Pose) -> Result<Isometry3<f64>, String> {
    let [w, x, y, z] = pose.orientation;
    let quaternion = Quaternion::new(w, x, y, z);
    if (quaternion.norm_squared() - 1.0).abs() > 2e-6 {
        return Err(format!("the quaternion {:?}, which is of no rotation", pose.orientation));
    }
    let turn = UnitQuaternion::new_unchecked(quaternion);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(pose.position)), turn))
}

impl From<FarReadback> for Readback {
    fn from(held: FarReadback) -> Self {
        // What is no rotation stands nowhere that was asked for.
        let place = |pose: &Pose| unit(pose).unwrap_or_else(|_| Isometry3::translation(f64::NAN, f64::NAN, f64::NAN));
        Self {
            friction: held.friction,
            table_friction: held.table_friction,
            gravity: held.gravity_m_s2,
            mass_kg: held.mass_kg,
            centre_of_mass: held.centre_of_mass.into(),
            parts: held.parts,
            object: place(&held.object_pose),
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

impl From<&Readback> for FarReadback {
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
                .map(|read| FarFixture {
                    fixture: read.fixture,
                    primitive: read.primitive,
                    pose: pose(&read.pose),
                    motion: read.motion.as_ref().map(CellMotion::from),
                })
                .collect(),
        }
    }
}
