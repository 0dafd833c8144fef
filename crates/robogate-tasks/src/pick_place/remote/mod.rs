//! The task on an engine in another process, which only simulates the physics.
//!
//! [`RemotePickPlace`] sends the whole [`Cell`] to the engine and scores the episode from the engine's reports, with
//! the same code as for an engine in this process. [`PhysicsHost`] is the other side: a built-in engine that sets up a
//! cell and reports.

mod cell;
mod host;
mod report;

pub use cell::{Cell, CellContact, CellFixture, CellGripper, CellMotion, CellObject, CellPart, CellRobot, CellVisual};
pub use host::PhysicsHost;
pub use report::{RemoteCollision, RemoteFixture, RemotePeriod, RemoteReadback, RemoteSight, RemoteVelocity};

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use robogate_camera::{Cameras, Posture};
use robogate_core::{
    Action, Assignment, Ending, Fault, FaultKind, Foresight, Image, Infeasibility, Observation, Scenario, Start, Step,
    TaskSpec,
};
use robogate_physics::{ArmState, Chain, Fixture, Gripper, Robot, StepView, Wrench, grip_force, isometry};

use crate::arm::{Bodies, Found, Judge, Resolved, camera_specs, cameras, render, show};
use crate::pick_place::{ActsOn, PickPlace, parameters};

/// Largest distance between the reported tool pose and the tool pose computed from the reported joint positions at the
/// start, in metres. Beyond this the engine has a different robot ...
const TOOL_OFF_M: f64 = 2e-3;
/// ... and the largest angle, in radians.
const TOOL_OFF_RAD: f64 = 0.02;

/// The task on an engine of another process.
pub struct RemotePickPlace {
    judge: Judge,
    sha256: Option<String>,
    grip_force_n: f64,
    cell: Option<(Scenario, Resolved)>,
    /// The cell's fixtures.
    fixtures: Vec<Fixture>,
    /// Names of the robot's bodies that were reported so far.
    bodies: Vec<String>,
    /// The cameras, or the reason why the robot cannot be rendered.
    cameras: Result<Cameras, String>,
    /// The last reported positions.
    seen: Option<Posture>,
}

impl RemotePickPlace {
    /// The task with these settings on this robot with the file hash `sha256`, with images of this width and height in
    /// pixels.
    ///
    /// # Errors
    /// If the gripper is a suction cup, because its hold must be decided in every time step.
    pub fn new(
        task: PickPlace,
        robot: Robot,
        chain: Chain,
        sha256: Option<String>,
        picture_px: [usize; 2],
    ) -> Result<Self, String> {
        if let Gripper::Suction(_) = robot.settings.gripper {
            return Err(format!("{} has a suction cup, which is supported by the built-in engines only", robot.name()));
        }
        let grip_force_n = grip_force(&robot.settings.gripper, task.arm.grip_force_n)?;
        let cameras = cameras(&robot, picture_px);
        let specs = camera_specs(&cameras);
        Ok(Self {
            judge: Judge::new(&task, (robot, chain), grip_force_n, specs),
            sha256,
            grip_force_n,
            cell: None,
            fixtures: Vec::new(),
            bodies: Vec::new(),
            cameras,
            seen: None,
        })
    }

    /// The knowledge about episodes before they run.
    pub fn foresight(&self) -> Arc<dyn Foresight> {
        self.judge.foresight()
    }

    /// The task.
    pub fn task(&self) -> &Arc<TaskSpec> {
        self.judge.task()
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        self.judge.robot()
    }

    /// The cell that the engine must set up for this scenario.
    pub fn resolve(&mut self, scenario: &Scenario) -> Result<Cell, Fault> {
        self.seen = None;
        let resolved = self.judge.resolve(scenario)?;
        let (robot, chain) = (self.judge.robot(), self.judge.chain());
        let cell = Cell::new(&resolved.scene, robot, chain, self.grip_force_n, self.sha256.clone())
            .map_err(|why| Fault::new(FaultKind::Setup, why))?;
        self.fixtures.clone_from(&resolved.scene.fixtures);
        self.cell = Some((scenario.clone(), resolved));
        Ok(cell)
    }

    /// Starts the episode from the engine's report of the cell. `observation` has no encoder bias.
    pub fn start(
        &mut self,
        held: RemoteReadback,
        sight: &RemoteSight,
        observation: &Observation,
    ) -> Result<Start, Fault> {
        let Some((scenario, resolved)) = self.cell.take() else {
            return Err(Fault::new(FaultKind::Setup, "no cell is set up"));
        };
        let tool = observation
            .tool_pose()
            .ok_or_else(|| Fault::new(FaultKind::Setup, "the observation of the arm has no tool_pose"))?;
        let there = isometry(&tool.position, &tool.orientation);
        let off = self.judge.chain().tcp_at(observation.joint_positions()).inverse() * there;
        let (distance, angle) = (off.translation.vector.norm(), off.rotation.angle());
        if distance > TOOL_OFF_M || angle > TOOL_OFF_RAD {
            let detail = format!(
                "the engine reports a tool pose that is {:.1} mm and {angle:.3} rad off that of its joint positions: \
                 it has a different robot",
                1e3 * distance
            );
            return Err(Fault::new(FaultKind::Setup, detail));
        }
        self.bodies.clear();
        let (touches, seen) = sight.read(self.fixtures.len(), &mut self.bodies, 0.0)?;
        let visual = show(&mut self.cameras, &resolved.scene);
        self.seen = Some(self.posture(observation, seen.object));
        let engine = held.into();
        // Suction cups and deviations of the gripper are supported only by an engine in this process.
        let found = Found { engine: &engine, visual: &visual, grip_threshold_m: None, grip_force_scale: None };
        self.judge.start(&scenario, resolved, &found, &touches, arm_state(observation))
    }

    /// Joint positions (rad) to which the engine must drive the arm in the next control period.
    pub fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        self.judge.command(action)
    }

    /// Scores a control period from the reports of its time steps.
    pub fn finish(
        &mut self,
        sights: &[RemoteSight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        for (k, sight) in sights.iter().enumerate() {
            let share = (k + 1) as f64 / sights.len() as f64;
            let (touches, seen) = sight.read(self.fixtures.len(), &mut self.bodies, share)?;
            let view = seen.with(&touches);
            self.judge.observe(&view, &OneObject(&view));
            if k + 1 == sights.len() {
                self.seen = Some(self.posture(observation, seen.object));
            }
        }
        let bodies = &self.bodies;
        let name = |body: usize| bodies.get(body).cloned().unwrap_or_default();
        let clearance =
            clearance_m.filter(|clearance| self.judge.clearance_bound().is_some_and(|bound| *clearance < bound));
        self.judge.finish(arm_state(observation), clearance, state_hash, name)
    }

    /// The ending at the time limit, if it is already certain for a policy that repeats its last action.
    pub fn foregone_ending(&self) -> Option<Ending> {
        self.judge.foregone_ending()
    }

    /// The reason why no policy can complete a scenario, if it is known.
    pub fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.judge.infeasibility(requested)
    }

    /// Renders the last reported positions.
    pub fn render(&self) -> Result<Vec<Image>, Fault> {
        let Some(seen) = &self.seen else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running"));
        };
        render(&self.cameras, |_| seen.clone())
    }

    fn posture(&self, observation: &Observation, object: Isometry3<f64>) -> Posture {
        let fixture = |fixture: &Fixture| {
            let mut pose = fixture.part.pose;
            if let Some(motion) = &fixture.motion {
                pose.translation.vector += motion.offset(observation.time_s);
            }
            pose
        };
        Posture {
            joints: observation.joint_positions().to_vec(),
            opening_m: observation.gripper_opening_m(),
            cup_travel_m: 0.0,
            object,
            others: Vec::new(),
            fixtures: self.fixtures.iter().map(fixture).collect(),
        }
    }
}

/// The only free body of the protocol. Engines of other processes report no support.
struct OneObject<'a>(&'a StepView<'a>);

impl Bodies for OneObject<'_> {
    fn pose(&self, _: usize) -> Isometry3<f64> {
        self.0.object
    }

    fn velocity(&self, _: usize) -> (Vector3<f64>, Vector3<f64>) {
        self.0.velocity
    }

    fn support(&self) -> Wrench {
        Wrench::ZERO
    }
}

/// Whether a parameter acts in this process (on encoders, policy or cameras), so the engine need not apply it.
pub fn is_local(parameter: &str) -> bool {
    parameters().iter().any(|row| row.name == parameter && row.acts_on.is_local())
}

/// Whether an engine in another process may have a parameter.
pub fn is_for_engines(parameter: &str) -> bool {
    parameters().iter().any(|row| row.name == parameter && row.acts_on == ActsOn::Engine)
}

fn arm_state(observation: &Observation) -> ArmState {
    ArmState {
        joint_positions: observation.joint_positions().to_vec(),
        joint_velocities: observation.joint_velocities().to_vec(),
        opening_m: observation.gripper_opening_m(),
    }
}
