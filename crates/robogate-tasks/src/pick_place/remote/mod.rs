//! Our world in an engine that is somewhere else: what it is told, what it reports, and the judging here.
//!
//! [`Offsite`] tells a far engine the whole [`Cell`] and judges by what it reports, with the very pieces that judge an
//! engine in this process. [`Host`] is the other end: an engine of ours that is told and reports.

mod cell;
mod host;
mod report;

pub use cell::{Cell, CellFixture, CellGripper, CellMotion, CellObject, CellPart, CellRobot, CellVisual};
pub use host::Host;
pub use report::{FarCollision, FarFixture, FarPeriod, FarReadback, FarSight, FarVelocity};

use std::sync::Arc;

use nalgebra::Isometry3;
use robogate_camera::{Cameras, Posture};
use robogate_core::{Action, Fault, FaultKind, Image, Observation, Scenario, Start, Step, TaskSpec};
use robogate_physics::{ArmState, Chain, Fixture, Gripper, Robot, grip_force, isometry};

use crate::pick_place::cell::ResolvedCell;
use crate::pick_place::judge::{Acting, Judge};
use crate::pick_place::parameters;
use crate::pick_place::simulator::{camera_specs, render, show};
use crate::pick_place::spec::spec;

/// From where a far engine has the tool to where the arm's joints put it, at the start: more than this is another
/// robot, in metres ...
const TOOL_OFF_M: f64 = 2e-3;
/// ... and in radians.
const TOOL_OFF_RAD: f64 = 0.02;

/// The task around an engine that is somewhere else.
pub struct Offsite {
    task: Arc<TaskSpec>,
    judge: Judge,
    sha256: Option<String>,
    grip_force_n: f64,
    cell: Option<(Scenario, ResolvedCell)>,
    /// The cell's fixtures.
    fixtures: Vec<Fixture>,
    /// The robot's bodies by name, as far as they were met.
    bodies: Vec<String>,
    /// Or why there are none.
    cameras: Result<Cameras, String>,
    /// Where everything was last seen to be.
    seen: Option<Posture>,
}

impl Offsite {
    /// The task on this robot, whose files have this hash; `grip_force_n` replaces the robot's own setting.
    ///
    /// Fails for a suction cup, whose hold must be looked at in every time step.
    pub fn new(robot: Robot, chain: Chain, sha256: Option<String>, grip_force_n: Option<f64>) -> Result<Self, String> {
        if let Gripper::Suction(_) = robot.settings.gripper {
            return Err(format!("{} holds by suction, which works in the engines inside alone", robot.name()));
        }
        let grip_force_n = grip_force(&robot.settings.gripper, grip_force_n)?;
        let judge = Judge::new(robot, chain, grip_force_n);
        let cameras = Cameras::new(judge.robot());
        Ok(Self {
            task: Arc::new(spec(judge.robot(), camera_specs(&cameras))),
            judge,
            sha256,
            grip_force_n,
            cell: None,
            fixtures: Vec::new(),
            bodies: Vec::new(),
            cameras,
            seen: None,
        })
    }

    /// The same task, the cameras' pictures of this size in pixels.
    #[must_use]
    pub fn with_picture_size(mut self, width: usize, height: usize) -> Self {
        self.cameras = self.cameras.map(|cameras| cameras.with_size(width, height));
        self.task = Arc::new(spec(self.judge.robot(), camera_specs(&self.cameras)));
        self
    }

    /// The task.
    pub fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        self.judge.robot()
    }

    /// The cell that the engine has to set up for this scenario.
    pub fn brief(&mut self, scenario: &Scenario) -> Result<Cell, Fault> {
        self.seen = None;
        let resolved = self.judge.resolve(scenario)?;
        let (robot, chain) = (self.judge.robot(), self.judge.chain());
        let cell = Cell::new(&resolved, robot, chain, self.grip_force_n, self.sha256.clone())
            .map_err(|why| Fault::new(FaultKind::Setup, why))?;
        self.fixtures.clone_from(&resolved.scene.fixtures);
        self.cell = Some((scenario.clone(), resolved));
        Ok(cell)
    }

    /// Begins the episode with what the engine made of the cell. `observation` is of the arm as it is.
    pub fn start(&mut self, held: FarReadback, sight: &FarSight, observation: &Observation) -> Result<Start, Fault> {
        let Some((scenario, cell)) = self.cell.take() else {
            return Err(Fault::new(FaultKind::Setup, "no cell was set up"));
        };
        let tool = observation
            .tool_pose()
            .ok_or_else(|| Fault::new(FaultKind::Setup, "the observation of the arm has no tool_pose"))?;
        let there = isometry(&tool.position, &tool.orientation);
        let off = self.judge.chain().tcp_at(observation.joint_positions()).inverse() * there;
        let (way, turn) = (off.translation.vector.norm(), off.rotation.angle());
        if way > TOOL_OFF_M || turn > TOOL_OFF_RAD {
            let detail = format!(
                "the far engine has the tool {:.1} mm and {turn:.3} rad off where these joint positions put it: \
                 it is another robot",
                1e3 * way
            );
            return Err(Fault::new(FaultKind::Setup, detail));
        }
        self.bodies.clear();
        let (touches, seen) = sight.read(self.fixtures.len(), &mut self.bodies, 0.0)?;
        let visual = show(&mut self.cameras, &cell);
        self.seen = Some(self.posture(observation, seen.object));
        let engine = held.into();
        // A suction cup works in an engine of this process only.
        let acting = Acting { engine: &engine, visual: &visual, grip_threshold_m: None };
        self.judge.start(&scenario, cell, acting, &touches, arm_state(observation))
    }

    /// Where the engine has to drive the arm's joints (rad) in the next control period.
    pub fn command(&mut self, action: &Action) -> Result<Vec<f64>, Fault> {
        self.judge.command(action)
    }

    /// Judges a control period by what the engine reports of each of its time steps.
    pub fn finish(
        &mut self,
        sights: &[FarSight],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault> {
        for (k, sight) in sights.iter().enumerate() {
            let share = (k + 1) as f64 / sights.len() as f64;
            let (touches, seen) = sight.read(self.fixtures.len(), &mut self.bodies, share)?;
            self.judge.observe(&seen.with(&touches));
            if k + 1 == sights.len() {
                self.seen = Some(self.posture(observation, seen.object));
            }
        }
        let bound = self.judge.clearance_bound();
        let bodies = &self.bodies;
        let name = |body: usize| bodies.get(body).cloned().unwrap_or_default();
        let clearance = clearance_m.filter(|clearance| *clearance < bound);
        self.judge.finish(arm_state(observation), clearance, state_hash, name)
    }

    /// What our cameras show of what the engine last reported.
    pub fn render(&self) -> Result<Vec<Image>, Fault> {
        let Some(seen) = &self.seen else {
            return Err(Fault::new(FaultKind::Setup, "no episode is under way"));
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
            object,
            fixtures: self.fixtures.iter().map(fixture).collect(),
        }
    }
}

/// Whether a parameter acts in this process, on encoders, policy or cameras, so that the engine need not apply it.
pub fn is_local(parameter: &str) -> bool {
    parameters().iter().any(|row| row.name == parameter && row.acts_on.is_local())
}

fn arm_state(observation: &Observation) -> ArmState {
    ArmState {
        joint_positions: observation.joint_positions().to_vec(),
        joint_velocities: observation.joint_velocities().to_vec(),
        opening_m: observation.gripper_opening_m(),
    }
}
