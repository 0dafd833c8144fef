//! Reports of an engine in another process as plain data.

use nalgebra::{Isometry3, Vector3};
use robogate_core::{Fault, FaultKind, Observation, Pose, RegionForces};
use robogate_physics::{
    Collision, Engine, FixtureRead, FreeBodyRead, GripperState, Hit, Plant, Readback, StepView, Touches,
    exact_isometry, pose,
};
use serde::{Deserialize, Serialize};

use crate::arm::{Bodies, scale};

/// The cell as read from the engine's state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteReadback {
    /// Friction coefficient of the objects against everything but the table, the receptacles and the pads.
    pub friction: f64,
    /// Friction coefficient of the objects against the table and the receptacles.
    pub table_friction: f64,
    /// Friction coefficient of the objects against the pads. `None` without pads.
    pub pad_friction: Option<f64>,
    /// Gravity, downwards.
    pub gravity_m_s2: f64,
    /// Stiffness of the servo of each joint of the arm.
    pub stiffness_nm_rad: Vec<f64>,
    /// Force of each pad, or of the cup along its axis.
    pub grip_force_n: f64,
    /// Distance to an object within which the suction cup takes hold. `None` without a cup.
    pub grip_threshold_m: Option<f64>,
    /// The objects, in the order of the cell.
    pub objects: Vec<FreeBodyRead>,
    /// The fixtures.
    pub fixtures: Vec<FixtureRead>,
}

/// Report of one time step. Forces are normal forces in newtons. "The object" is the one that the gripper acts on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteSight {
    /// Index of the object that the gripper acts on.
    pub object: usize,
    /// Force of each finger on the object.
    pub fingers: [Option<f64>; 2],
    /// Whether any other part of the robot touches the object.
    pub body_on_object: bool,
    /// Whether the object touches a fixture or another object.
    pub object_on_fixture: bool,
    /// Total force of the fixtures and the other objects on the object, along the axes of the base frame.
    pub support_n: [f64; 3],
    /// The strongest contact of the robot with a fixture or with itself.
    pub collision: Option<RemoteCollision>,
    /// The largest contact force on any body of the robot.
    pub peak_force_n: Option<f64>,
    /// The largest contact force of each region of the robot (arm, hand, fingers) on parts and on anything else.
    #[serde(default)]
    pub region_forces_n: RegionForces,
    /// Every object of the cell.
    pub objects: Vec<RemoteState>,
    /// Pose of the tool centre point.
    pub tool_pose: Pose,
    /// Opening between the pads, in metres. `None` without fingers.
    pub opening_m: Option<f64>,
    /// The suction cup. `None` without one.
    pub cup: Option<RemoteCup>,
}

/// A contact of the robot with a fixture or with itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RemoteCollision {
    /// Name of the robot's body.
    pub robot_body: String,
    /// The fixture's index in the cell's list. `None` if the robot touches itself.
    pub fixture: Option<usize>,
    /// Name of the other body of the robot, if the robot touches itself.
    pub other_body: Option<String>,
    /// Normal force in newtons.
    pub force_n: f64,
}

/// The state of an object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RemoteState {
    /// Pose of its frame.
    pub pose: Pose,
    /// Velocity of the origin of its frame.
    pub linear_m_s: [f64; 3],
    /// Angular velocity.
    pub angular_rad_s: [f64; 3],
}

/// The state of a suction cup.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RemoteCup {
    /// Whether it holds the object.
    pub holding: bool,
    /// How far the lip is pressed back against its spring, in metres.
    pub travel_m: f64,
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

/// Linear (m/s) and angular (rad/s) velocity.
type Velocity = (Vector3<f64>, Vector3<f64>);

/// The state of the physics after a time step, from a checked report.
pub(super) struct Seen {
    fraction: f64,
    gripper: GripperState,
    object: usize,
    pub(super) touches: Touches,
    support_n: Vector3<f64>,
    pub(super) objects: Vec<(Isometry3<f64>, Velocity)>,
    pub(super) tcp: Isometry3<f64>,
    pub(super) cup_travel_m: f64,
}

impl Seen {
    pub(super) fn view(&self) -> StepView<'_> {
        let Self { fraction, gripper, object, touches, tcp, .. } = self;
        let (pose, velocity) = self.objects[*object];
        StepView { fraction: *fraction, gripper: *gripper, touches, object: pose, velocity, tcp: *tcp }
    }
}

impl Bodies for Seen {
    fn pose(&self, body: usize) -> Isometry3<f64> {
        self.objects[body].0
    }

    fn velocity(&self, body: usize) -> Velocity {
        self.objects[body].1
    }

    fn support(&self) -> Vector3<f64> {
        self.support_n
    }
}

/// What a report must agree with, and the names of the robot's bodies that were reported so far.
#[derive(Debug, Default)]
pub(super) struct Expected {
    pub(super) objects: usize,
    pub(super) fixtures: usize,
    pub(super) has_cup: bool,
    pub(super) bodies: Vec<String>,
}

impl Expected {
    /// Index of a body of the robot. A new name is added.
    fn body(&mut self, name: &String) -> usize {
        self.bodies.iter().position(|body| body == name).unwrap_or_else(|| {
            self.bodies.push(name.clone());
            self.bodies.len() - 1
        })
    }
}

impl RemoteSight {
    /// The state that is reported at this fraction of the control period.
    ///
    /// # Errors
    /// A fault if the report does not fit the cell.
    pub(super) fn read(&self, expected: &mut Expected, fraction: f64) -> Result<Seen, Fault> {
        let wrong = |what: String| Fault::new(FaultKind::Unavailable, format!("the engine reports {what}"));
        let (objects, fixtures) = (expected.objects, expected.fixtures);
        if self.objects.len() != objects || self.object >= objects {
            let (found, object) = (self.objects.len(), self.object);
            return Err(wrong(format!(
                "{found} objects, and that the gripper acts on object {object}; the cell has {objects}"
            )));
        }
        let collision = match &self.collision {
            None => None,
            Some(RemoteCollision { fixture: Some(fixture), .. }) if *fixture >= fixtures => {
                return Err(wrong(format!("a collision with fixture {fixture} of {fixtures}")));
            }
            Some(RemoteCollision { robot_body, fixture, other_body, force_n }) => {
                let hit = match (fixture, other_body) {
                    (Some(fixture), _) => Hit::Fixture(*fixture),
                    (None, Some(other)) => Hit::Itself(expected.body(other)),
                    (None, None) => return Err(wrong("a collision with nothing".to_owned())),
                };
                Some(Collision { robot_body: expected.body(robot_body), hit, force: *force_n })
            }
        };
        let gripper = match (self.opening_m, &self.cup) {
            (_, Some(cup)) if expected.has_cup => GripperState::Cup(cup.holding),
            (Some(opening), _) if !expected.has_cup => GripperState::Fingers(opening),
            _ if expected.has_cup => return Err(wrong("no state of the suction cup".to_owned())),
            _ => return Err(wrong("no opening of the gripper".to_owned())),
        };
        let state = |state: &RemoteState| {
            let pose = exact_isometry(&state.pose).map_err(wrong)?;
            Ok((pose, (state.linear_m_s.into(), state.angular_rad_s.into())))
        };
        Ok(Seen {
            fraction,
            gripper,
            object: self.object,
            touches: Touches {
                fingers: self.fingers,
                body_on_object: self.body_on_object,
                object_on_fixture: self.object_on_fixture,
                collision,
                peak_force: self.peak_force_n,
                regions: self.region_forces_n,
                squeeze: None,
            },
            support_n: self.support_n.into(),
            objects: self.objects.iter().map(state).collect::<Result<_, Fault>>()?,
            tcp: exact_isometry(&self.tool_pose).map_err(wrong)?,
            cup_travel_m: self.cup.map_or(0.0, |cup| cup.travel_m),
        })
    }

    /// The report of a time step of this engine, which has this number of objects.
    pub(super) fn of(engine: &impl Engine, view: &StepView<'_>, object: usize, objects: usize) -> Self {
        let touches = view.touches;
        let state = |body: usize| {
            let (linear, angular) = engine.free_body_velocity(body);
            let pose = pose(&engine.free_body(body));
            RemoteState { pose, linear_m_s: linear.into(), angular_rad_s: angular.into() }
        };
        let body = |body: usize| engine.robot_body(body);
        let (opening_m, cup) = match view.gripper {
            GripperState::Fingers(opening) => (Some(opening), None),
            GripperState::Cup(holding) => (None, Some(RemoteCup { holding, travel_m: engine.cup_travel() })),
        };
        // It is computed on request, and is zero without a contact.
        let support_n = if touches.object_on_fixture { engine.support().force.into() } else { [0.0; 3] };
        Self {
            object,
            fingers: touches.fingers,
            body_on_object: touches.body_on_object,
            object_on_fixture: touches.object_on_fixture,
            support_n,
            collision: touches.collision.map(|Collision { robot_body, hit, force }| {
                let (fixture, other_body) = match hit {
                    Hit::Fixture(fixture) => (Some(fixture), None),
                    Hit::Itself(other) => (None, Some(body(other))),
                };
                RemoteCollision { robot_body: body(robot_body), fixture, other_body, force_n: force }
            }),
            peak_force_n: touches.peak_force,
            region_forces_n: touches.regions,
            objects: (0..objects).map(state).collect(),
            tool_pose: pose(&view.tcp),
            opening_m,
            cup,
        }
    }
}

impl RemoteReadback {
    /// What the engine has, for an arm whose own servos have this stiffness.
    pub(super) fn read(self, own_nm_rad: &[f64]) -> Readback {
        // A multiple that is not the same for all joints is none.
        let arm_stiffness = scale(own_nm_rad, &self.stiffness_nm_rad);
        let mut objects = self.objects.into_iter();
        let first = objects.next();
        let (mass_kg, centre_of_mass, parts, object) = match first {
            Some(FreeBodyRead { mass_kg, centre_of_mass, parts, pose }) => (mass_kg, centre_of_mass, parts, pose),
            None => (f64::NAN, Vector3::zeros(), Vec::new(), Isometry3::identity()),
        };
        Readback {
            friction: self.friction,
            table_friction: self.table_friction,
            pad_friction: self.pad_friction,
            own_friction: Vec::new(),
            gravity: self.gravity_m_s2,
            arm_stiffness: Some(arm_stiffness),
            mass_kg,
            centre_of_mass,
            parts,
            object,
            others: objects.collect(),
            fixtures: self.fixtures,
            joints: Vec::new(),
        }
    }

    /// What this plant has.
    pub(super) fn of<E: Engine>(plant: &Plant<E>) -> Result<Self, Fault> {
        let held = plant.engine.read_back()?;
        let own = &plant.engine.robot().settings.arm.stiffness_nm_rad;
        let Readback { mass_kg, centre_of_mass, parts, object: pose, others, .. } = held;
        let first = FreeBodyRead { mass_kg, centre_of_mass, parts, pose };
        Ok(Self {
            friction: held.friction,
            table_friction: held.table_friction,
            pad_friction: held.pad_friction,
            gravity_m_s2: held.gravity,
            stiffness_nm_rad: own.iter().map(|own| own * held.arm_stiffness.unwrap_or(1.0)).collect(),
            grip_force_n: plant.acting_force_n(),
            grip_threshold_m: plant.grip_threshold_m(),
            objects: std::iter::once(first).chain(others).collect(),
            fixtures: held.fixtures,
        })
    }
}
