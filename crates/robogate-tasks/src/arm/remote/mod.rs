//! Tasks for an arm on an engine in another process, which only simulates the physics.
//!
//! [`RemoteArm`] sends the whole [`Cell`] to the engine and scores the episode from the engine's reports, with the same
//! code as for an engine in this process. [`PhysicsHost`] is the other side: a built-in engine that sets up a cell and
//! reports.

mod cell;
mod host;
mod report;

pub(crate) use cell::Grasping;
pub use cell::{Cell, CellContact, CellGripper, CellRobot, CellScales};
pub use host::PhysicsHost;
pub use report::{RemoteCollision, RemoteCup, RemotePeriod, RemoteReadback, RemoteSight, RemoteState};

use std::sync::Arc;

use robogate_camera::{Cameras, Posture};
use robogate_core::{
    Action, Assignment, Ending, Fault, FaultKind, Foresight, Image, Infeasibility, Observation, Scenario, Start, Step,
    TaskSpec,
};
use robogate_physics::{ArmState, Chain, Fixture, Robot, SuctionLaw, grip_force, isometry};

use super::forces::no_wrist_sensor;
use super::{Found, HasSettings, Judge, Resolved, Rules, camera_specs, cameras, render, show};
use report::{Expected, Seen};

/// Largest distance between the reported tool pose and the tool pose computed from the reported joint positions at the
/// start, in metres. Beyond this the engine has a different robot ...
const TOOL_OFF_M: f64 = 2e-3;
/// ... and the largest angle, in radians.
const TOOL_OFF_RAD: f64 = 0.02;

/// A task for an arm on an engine of another process.
pub struct RemoteArm {
    judge: Judge,
    sha256: Option<String>,
    grip_force_n: f64,
    suction: SuctionLaw,
    resolved: Option<(Scenario, Resolved)>,
    /// The cell's fixtures.
    fixtures: Vec<Fixture>,
    expected: Expected,
    /// The cameras, or the reason why the robot cannot be rendered.
    cameras: Result<Cameras, String>,
    /// The last reported state, with the positions that cameras show.
    last: Option<(Seen, Posture)>,
}

impl RemoteArm {
    /// The task on this robot with the file hash `sha256`, with images of this width and height in pixels.
    ///
    /// # Errors
    /// If the gripper cannot apply the grip force of the settings.
    pub(crate) fn new<T: Rules + HasSettings + 'static>(
        task: &T,
        (robot, chain): (Robot, Chain),
        sha256: Option<String>,
        picture_px: [usize; 2],
    ) -> Result<Self, String> {
        let settings = task.arm();
        no_wrist_sensor(settings)?;
        let grip_force_n = grip_force(&robot.settings.gripper, settings.grip_force_n)?;
        let expected = Expected { has_cup: robot.settings.gripper.cup().is_some(), ..Expected::default() };
        let cameras = cameras(&robot, picture_px);
        let specs = camera_specs(&cameras);
        Ok(Self {
            judge: Judge::new(task, (robot, chain), grip_force_n, specs),
            sha256,
            grip_force_n,
            suction: settings.suction,
            resolved: None,
            fixtures: Vec::new(),
            expected,
            cameras,
            last: None,
        })
    }

    /// The knowledge about episodes before they run.
    pub fn foresight(&self) -> Option<Arc<dyn Foresight>> {
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
    ///
    /// # Errors
    /// A setup fault if the scenario cannot be set up.
    pub fn resolve(&mut self, scenario: &Scenario) -> Result<Cell, Fault> {
        self.last = None;
        let resolved = self.judge.resolve(scenario)?;
        let grasping =
            Grasping { force_n: self.grip_force_n, law: self.suction, threshold_m: resolved.grip_threshold_m };
        let (robot, chain) = (self.judge.robot(), self.judge.chain());
        let cell = Cell::new(&resolved.scene, robot, chain, grasping, self.sha256.clone());
        self.fixtures.clone_from(&resolved.scene.fixtures);
        (self.expected.objects, self.expected.fixtures) = (cell.objects.len(), cell.fixtures.len());
        self.resolved = Some((scenario.clone(), resolved));
        Ok(cell)
    }

    /// Starts the episode from the engine's report of the cell. `observation` has no encoder bias.
    ///
    /// # Errors
    /// A setup fault if the engine has another robot, or the robot starts in contact.
    pub fn start(
        &mut self,
        held: RemoteReadback,
        sight: &RemoteSight,
        observation: &Observation,
    ) -> Result<Start, Fault> {
        let Some((scenario, resolved)) = self.resolved.take() else {
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
        self.expected.bodies.clear();
        let seen = sight.read(&mut self.expected, 0.0)?;
        let visual = show(&mut self.cameras, &resolved.scene);
        let (grip_threshold_m, grip_force_scale) = (held.grip_threshold_m, Some(held.grip_force_n / self.grip_force_n));
        let own = &self.judge.robot().settings.arm.stiffness_nm_rad;
        let engine = held.read(own);
        let found = Found { engine: &engine, visual: &visual, grip_threshold_m, grip_force_scale };
        let start = self.judge.start(&scenario, resolved, &found, &seen.touches, arm_state(observation))?;
        self.see(seen, observation);
        Ok(start)
    }

    /// The command of the next control period for this action: joint positions (rad) to which the engine must drive the arm,
    /// and the object that the gripper acts on from now on. `None` keeps the present one.
    ///
    /// # Errors
    /// If no episode is running, or the action cannot be carried out.
    pub fn command(&mut self, action: &Action) -> Result<(Vec<f64>, Option<usize>), Fault> {
        let joints = self.judge.command(action)?;
        let object = self.last.as_ref().and_then(|(seen, _)| self.judge.select(&seen.tcp, seen));
        Ok((joints, object))
    }

    /// Scores a control period from the reports of its time steps.
    ///
    /// # Errors
    /// A fault if a report does not fit the cell.
    pub fn finish(
        &mut self,
        sights: &[RemoteSight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        for (k, sight) in sights.iter().enumerate() {
            let seen = sight.read(&mut self.expected, (k + 1) as f64 / sights.len() as f64)?;
            self.judge.observe(&seen.view(), &seen);
            if k + 1 == sights.len() {
                self.see(seen, observation);
            }
        }
        let bodies = &self.expected.bodies;
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
    ///
    /// # Errors
    /// If no episode is running, or the robot cannot be rendered.
    pub fn render(&self) -> Result<Vec<Image>, Fault> {
        let Some((_, posture)) = &self.last else {
            return Err(Fault::new(FaultKind::Setup, "no episode is running"));
        };
        render(&self.cameras, |_| posture.clone())
    }

    /// Keeps the last reported state.
    fn see(&mut self, seen: Seen, observation: &Observation) {
        let fixture = |fixture: &Fixture| {
            let pose = fixture.part.pose;
            fixture.motion.map_or(pose, |motion| motion.at(observation.time_s) * pose)
        };
        let mut poses = seen.objects.iter().map(|(pose, _)| *pose);
        let posture = Posture {
            joints: observation.joint_positions().to_vec(),
            opening_m: observation.gripper_opening_m(),
            cup_travel_m: seen.cup_travel_m,
            object: poses.next().unwrap_or_default(),
            others: poses.collect(),
            fixtures: self.fixtures.iter().map(fixture).collect(),
        };
        self.last = Some((seen, posture));
    }
}

fn arm_state(observation: &Observation) -> ArmState {
    ArmState {
        joint_positions: observation.joint_positions().to_vec(),
        joint_velocities: observation.joint_velocities().to_vec(),
        opening_m: observation.gripper_opening_m(),
    }
}
