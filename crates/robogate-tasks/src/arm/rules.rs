//! What a task adds to the cell: its rules, and a referee for each episode.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_core::{
    Assignment, CameraSpec, FailureMode, Fault, Foresight, Infeasibility, Measures, Scenario, TaskInstance, TaskSpec,
};
use robogate_physics::{Chain, Collision, GripperCommand, Readback, Robot, Scene, Side, StepView, Visual, Wrench};

use super::{ArmDeclaration, OnArm};

/// The rules of a task. With [`super::HasSettings`] they make it an [`super::ArmTask`].
pub(crate) trait Rules: OnArm + ArmDeclaration {
    /// The task specification for this robot with these cameras, without parameters and settings.
    fn spec(&self, robot: &Robot, cameras: Vec<CameraSpec>) -> TaskSpec;

    /// Whether a contact with too much force is a failure.
    fn limits_forces(&self) -> bool {
        true
    }

    /// Resolves a scenario for this robot, whose gripper holds with `grip_force_n` newtons. All random draws are done.
    ///
    /// # Errors
    /// A setup fault if the scenario cannot be set up.
    fn resolve(&self, scenario: &Scenario, robot: &Robot, grip_force_n: f64) -> Result<Resolved, Fault>;

    /// Why only an engine of this process can simulate the task. `None` if worlds of a simulator and engines in other processes
    /// can do so too.
    fn only_here(&self) -> Option<&'static str> {
        None
    }

    /// The draws and features of episodes on this robot, whose gripper holds with `grip_force_n` newtons. `None` without
    /// draws and features.
    fn foresight(&self, robot: &Robot, chain: &Chain, grip_force_n: f64) -> Option<Arc<dyn Foresight>>;

    /// The reason why no policy can complete a scenario with this robot, whose gripper holds with `grip_force_n`
    /// newtons. A scenario that cannot be decoded has no reason here: its reset reports the problem.
    fn infeasibility(&self, requested: &Assignment, robot: &Robot, grip_force_n: f64) -> Option<Infeasibility>;
}

/// Everything about an episode that is fixed before it starts.
pub(crate) struct Resolved {
    /// The scene that the engine loads.
    pub(crate) scene: Scene,
    /// Distance to the part within which a suction cup takes hold, in metres.
    pub(crate) grip_threshold_m: f64,
    /// Bias of each joint's encoder: measured minus true position, in radians.
    pub(crate) bias: Vec<f64>,
    /// The information that the policy receives.
    pub(crate) instance: TaskInstance,
    /// The referee.
    pub(crate) trial: Box<dyn Trial>,
}

/// The state from which applied values are read.
pub(crate) struct Found<'a> {
    /// State of the engine.
    pub(crate) engine: &'a Readback,
    /// State of the cameras.
    pub(crate) visual: &'a Visual,
    /// Threshold of the suction cup, in metres; `None` without a cup.
    pub(crate) grip_threshold_m: Option<f64>,
    /// Grip force as a multiple of that of the settings.
    pub(crate) grip_force_scale: Option<f64>,
}

/// The referee of one episode. The first decisive event ends it.
pub(crate) trait Trial {
    /// The applied values of the requested parameters, from the acting state and the biases of the encoders (rad).
    fn applied(&self, requested: &Assignment, found: &Found<'_>, bias: &[f64]) -> Assignment;

    /// The free body that the gripper acts on in the next control period, with the tool at `tcp`. `None` keeps it.
    fn select(&mut self, _command: GripperCommand, _tcp: &Isometry3<f64>, _bodies: &dyn Bodies) -> Option<usize> {
        None
    }

    /// Observes one time step.
    fn observe(&mut self, sight: &Sight<'_>);

    /// The measures so far.
    fn measures(&self) -> Measures;

    /// What it has decided and reported so far.
    fn record(&mut self) -> &mut Record;

    /// The failure mode if the time limit passes in the present state.
    fn mode_at_limit(&self) -> FailureMode {
        FailureMode::TIMEOUT
    }

    /// Whether no later event can happen if gripper and arm do not move any more.
    fn at_rest(&self) -> bool;

    /// The clearance (m) at or above which no measure changes. `None` if the task does not measure it.
    fn clearance_bound(&self) -> Option<f64> {
        None
    }

    /// Records the distance (m) between the robot and the fixtures.
    fn note_clearance(&mut self, _clearance_m: f64) {}
}

/// The state of the physics beyond the view of a time step.
pub(crate) trait Bodies {
    /// Pose of a free body.
    fn pose(&self, body: usize) -> Isometry3<f64>;

    /// Linear (m/s) and angular (rad/s) velocity of a free body.
    fn velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>);

    /// Force of the fixtures and the other free bodies on the selected body, in newtons, along the axes of the base frame.
    fn support(&self) -> Vector3<f64>;

    /// Wrench on hand and fingers about the tool centre point and along its axes. `None` where only the engines of this process report it.
    fn hand_wrench(&self) -> Option<Wrench> {
        None
    }

    /// Value (m or rad) and speed of the joint of a body. `None` for a body that moves freely, and for the bodies of tasks that
    /// engines in other processes can simulate.
    fn joint(&self, _body: usize) -> Option<[f64; 2]> {
        None
    }

    /// Sum of the normal forces between two sides, in newtons. `None` if they do not touch, and where only the engines of this
    /// process report it ([`Rules::only_here`]).
    fn force_between(&self, _one: Side, _other: Side) -> Option<f64> {
        None
    }
}

/// The state that a referee gets after one time step.
pub(crate) struct Sight<'a> {
    /// Simulated time after the step, in seconds.
    pub(crate) time: f64,
    /// The gripper command.
    pub(crate) command: GripperCommand,
    /// Gripper, contacts, tool and the selected body.
    pub(crate) view: &'a StepView<'a>,
    /// All free bodies.
    pub(crate) bodies: &'a dyn Bodies,
}

/// The decisive event of an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ruling {
    /// The failure mode; `None` for success.
    pub(crate) failure: Option<FailureMode>,
    /// Simulated time, in seconds.
    pub(crate) time_s: f64,
    /// The contact that decided it, if it was a collision.
    pub(crate) collision: Option<Collision>,
}

/// What a referee has decided and reported so far.
#[derive(Debug, Clone, Default)]
pub(crate) struct Record {
    ruling: Option<Ruling>,
    events: Vec<String>,
}

impl Record {
    /// Reports an event.
    pub(crate) fn note(&mut self, event: impl Into<String>) {
        self.events.push(event.into());
    }

    /// Ends the episode, unless an earlier event has ended it. `failure` is `None` for success.
    pub(crate) fn end(&mut self, failure: Option<FailureMode>, time_s: f64, collision: Option<Collision>) {
        self.ruling.get_or_insert(Ruling { failure, time_s, collision });
    }

    /// Raises the force of the decisive contact, if it is stronger at a later step of the same control period.
    pub(crate) fn strengthen(&mut self, now: Option<Collision>) {
        if let (Some(Ruling { collision: Some(first), .. }), Some(now)) = (&mut self.ruling, now)
            && (first.robot_body, first.hit) == (now.robot_body, now.hit)
        {
            first.force = first.force.max(now.force);
        }
    }

    /// Whether the decisive event has happened.
    pub(crate) fn is_over(&self) -> bool {
        self.ruling.is_some()
    }

    /// The decisive event.
    pub(crate) fn ruling(&self) -> Option<Ruling> {
        self.ruling
    }

    /// Takes the events since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<String> {
        std::mem::take(&mut self.events)
    }
}
