//! An engine as a physics server: it sets up cells, runs them and reports, but does not score.

use robogate_core::{Fault, FaultKind, Observation, Scenario};
use robogate_physics::{Engine, GripperCommand, GripperState, Plant, StepView, pose};

use super::{RemotePeriod, RemoteReadback, RemoteSight};
use crate::arm::CONTROL_PERIOD_S;
use crate::pick_place::PickPlace;
use crate::pick_place::cell::ResolvedCell;
use crate::pick_place::spec::observation;

/// Largest clearance that is measured, in metres.
const CLEARANCE_LIMIT_M: f64 = 0.25;

/// An engine as a physics server: the reference implementation for other servers.
pub struct PhysicsHost<E> {
    plant: Plant<E>,
    task: PickPlace,
    ticks: u64,
}

impl<E: Engine> PhysicsHost<E> {
    /// Creates a host for this engine, which runs the physics of this task.
    pub fn new(engine: E, task: PickPlace) -> Result<Self, String> {
        Ok(Self { plant: Plant::new(engine, CONTROL_PERIOD_S, task.arm.grip_force_n)?, task, ticks: 0 })
    }

    /// The engine.
    pub fn engine(&self) -> &E {
        &self.plant.engine
    }

    /// Sets up the scenario's cell, which it resolves in the same way as the client.
    pub fn reset(&mut self, scenario: &Scenario) -> Result<(RemoteReadback, RemoteSight, Observation), Fault> {
        let cell = ResolvedCell::new(scenario, self.plant.engine.robot(), &self.task)?;
        self.plant.load(&cell.scene, cell.parameters.grip_threshold_m)?;
        self.ticks = 0;
        let engine = &self.plant.engine;
        let opening = engine.opening().ok_or_else(|| Fault::new(FaultKind::Setup, "the gripper has no fingers"))?;
        let sight = StepView {
            fraction: 0.0,
            gripper: GripperState::Fingers(opening),
            touches: engine.touches(),
            object: engine.object(),
            velocity: engine.object_velocity(),
            tcp: engine.tcp(),
        };
        let sight = RemoteSight::of(&sight, |body| engine.robot_body(body));
        Ok((RemoteReadback::from(&engine.read_back()?), sight, self.observation()))
    }

    /// Runs one control period towards these joint positions (rad).
    pub fn step(&mut self, joints: &[f64], gripper: GripperCommand) -> Result<RemotePeriod, Fault> {
        // The engine is borrowed while it reports a step, so bodies are identified by index until then.
        let mut sights = Vec::with_capacity(self.plant.steps_per_period());
        self.plant.run(joints, gripper, &mut |_, view| sights.push(RemoteSight::of(view, |body| body.to_string())))?;
        let engine = &self.plant.engine;
        for collision in sights.iter_mut().filter_map(|sight| sight.collision.as_mut()) {
            if let Ok(body) = collision.robot_body.parse() {
                collision.robot_body = engine.robot_body(body);
            }
        }
        self.ticks += 1;
        let clearance_m = self.plant.engine.clearance_below(CLEARANCE_LIMIT_M);
        Ok(RemotePeriod { observation: self.observation(), state_hash: self.plant.state_hash(), sights, clearance_m })
    }

    fn observation(&self) -> Observation {
        let time_s = self.ticks as f64 * CONTROL_PERIOD_S;
        observation(time_s, self.plant.arm_state(), pose(&self.plant.engine.tcp()))
    }
}
