//! A built-in engine as a physics server: it sets up cells, runs them and reports, but does not score.

use robogate_core::{Fault, FaultKind, Observation};
use robogate_physics::{Engine, GripperCommand, GripperState, Plant, StepView, SuctionLaw, pose};

use super::{Cell, CellGripper, RemotePeriod, RemoteReadback, RemoteSight};
use crate::arm::{CLEARANCE_LIMIT_M, CONTROL_PERIOD_S, observation};

/// A built-in engine as a physics server: the reference implementation for other servers. It knows no task.
pub struct PhysicsHost<E> {
    plant: Plant<E>,
    objects: usize,
    ticks: u64,
}

impl<E: Engine> PhysicsHost<E> {
    /// Creates a host for this engine.
    ///
    /// # Errors
    /// If the control period is not an integer multiple of the engine's time step.
    pub fn new(engine: E) -> Result<Self, String> {
        Ok(Self { plant: Plant::new(engine, CONTROL_PERIOD_S, None)?, objects: 0, ticks: 0 })
    }

    /// The engine.
    pub fn engine(&self) -> &E {
        &self.plant.engine
    }

    /// Sets a cell up.
    ///
    /// # Errors
    /// A setup fault if the cell is not valid, or the engine cannot set it up.
    pub fn reset(&mut self, cell: &Cell) -> Result<(RemoteReadback, RemoteSight, Observation), Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let robot = self.plant.engine.robot();
        let scene = cell.scene(robot).map_err(|why| setup(format!("this cell cannot be set up: {why}")))?;
        let has_cup = robot.settings.gripper.cup().is_some();
        let (force_n, law, threshold_m) = match &cell.robot.gripper {
            CellGripper::ParallelJaw { force_n, .. } if !has_cup => (Some(*force_n), SuctionLaw::Vacuum, 0.0),
            CellGripper::Suction { law, threshold_m, .. } if has_cup => (None, *law, *threshold_m),
            _ => return Err(setup(format!("the gripper of this server is {}", robot.settings.gripper.description()))),
        };
        self.plant.set_gripper(force_n, law).map_err(setup)?;
        self.plant.load(&scene, threshold_m)?;
        (self.objects, self.ticks) = (1 + scene.others.len(), 0);
        let engine = &self.plant.engine;
        let view = StepView {
            fraction: 0.0,
            gripper: engine.opening().map_or(GripperState::Cup(false), GripperState::Fingers),
            touches: engine.touches(),
            object: engine.object(),
            velocity: engine.object_velocity(),
            tcp: engine.tcp(),
        };
        let sight = RemoteSight::of(engine, &view, 0, self.objects);
        Ok((RemoteReadback::of(&self.plant)?, sight, self.observation()))
    }

    /// Chooses the object that the gripper acts on from the next control period on. An object that a cup holds stays
    /// chosen, and an index that the cell does not have changes nothing.
    pub fn select(&mut self, object: usize) {
        self.plant.select(object);
    }

    /// Runs one control period towards these joint positions (rad).
    ///
    /// # Errors
    /// As [`Plant::run`].
    pub fn step(&mut self, joints: &[f64], gripper: GripperCommand) -> Result<RemotePeriod, Fault> {
        let (object, objects) = (self.plant.selected(), self.objects);
        let mut sights = Vec::with_capacity(self.plant.steps_per_period());
        self.plant.run(joints, gripper, &mut |engine, view| {
            sights.push(RemoteSight::of(engine, view, object, objects));
        })?;
        self.ticks += 1;
        let clearance_m = self.plant.engine.clearance_below(CLEARANCE_LIMIT_M);
        Ok(RemotePeriod { observation: self.observation(), state_hash: self.plant.state_hash(), sights, clearance_m })
    }

    fn observation(&self) -> Observation {
        let time_s = self.ticks as f64 * CONTROL_PERIOD_S;
        observation(time_s, self.plant.arm_state(), pose(&self.plant.engine.tcp()))
    }
}
