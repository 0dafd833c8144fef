//! Episodes in a server that computes physics for a task of this process.

use std::collections::BTreeMap;
use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Ending, Fault, Foresight, Image, Infeasibility, Observation, Scenario, Start, Step, TaskSpec,
};
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::connection::Connection;
use super::error::{RequestError, violation};
use super::message::{ActionKind, Hello, ParameterValue, ResetReply, ResetRequest};
use super::session::{Session, gripper_number, reset_request};

/// A task of this process whose physics is computed by a server.
///
/// The task resolves each scenario into a cell, which the server sets up, and scores what the server reports.
pub trait RemoteTask {
    /// Description of the cell that the server has to set up.
    type Cell: Serialize;
    /// Properties of the cell as read back from the engine.
    type Readback: DeserializeOwned;
    /// Physical state after one time step: contacts, poses, velocities.
    type Sample: DeserializeOwned;

    /// The task of all episodes.
    fn task(&self) -> &Arc<TaskSpec>;

    /// The knowledge of the task about an episode before it runs. `None` if it has none.
    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        None
    }

    /// Check whether a server can run this task.
    fn accepts(&self, hello: &Hello) -> Result<(), String>;

    /// Resolve a scenario into the cell of its episode. All parameters act through the cell.
    fn resolve(&mut self, scenario: &Scenario) -> Result<Self::Cell, Fault>;

    /// Begin the episode. `observation` contains the true joint positions, without encoder errors.
    fn start(
        &mut self,
        readback: Self::Readback,
        sample: &Self::Sample,
        observation: &Observation,
    ) -> Result<Start, Fault>;

    /// Joint positions (rad) that the server has to reach at the end of the next control period, and the object that the
    /// gripper acts on from now on. `None` keeps it.
    fn command(&mut self, action: &Action) -> Result<(Vec<f64>, Option<usize>), Fault>;

    /// Score a control period. `samples` has one entry for each time step.
    fn score(
        &mut self,
        samples: &[Self::Sample],
        observation: &Observation,
        clearance_m: Option<f64>,
        state_hash: u64,
    ) -> Result<Step, Fault>;

    /// The ending at the time limit, if it is certain for a policy that repeats its last action. See
    /// [`robogate_core::Environment::foregone_ending`].
    fn foregone_ending(&self) -> Option<Ending> {
        None
    }

    /// The reason why no policy can complete a scenario. See [`robogate_core::Environment::infeasibility`].
    fn infeasibility(&self, _requested: &Assignment) -> Option<Infeasibility> {
        None
    }

    /// Render the cameras of the task in the last reported state.
    fn render(&mut self) -> Result<Vec<Image>, Fault>;
}

/// A session with a server that computes physics for this task.
#[derive(Debug)]
pub struct PhysicsSession<T>(pub T);

impl<T: RemoteTask> Session for PhysicsSession<T> {
    fn accepts(&self, hello: &Hello) -> Result<(), String> {
        if hello.scores_itself {
            return Err("the server has its own task and scores itself".to_owned());
        }
        self.0.accepts(hello)
    }

    fn task(&self, _: &Hello) -> Arc<TaskSpec> {
        Arc::clone(self.0.task())
    }

    fn reset(&mut self, connection: &mut Connection, scenario: &Scenario) -> Result<Start, RequestError> {
        let Self(task) = self;
        let cell = task.resolve(scenario).map_err(RequestError::Local)?;
        let request = reset_request(scenario, &Assignment::default(), Some(cell))?;
        let reply: ResetReply<T::Readback, T::Sample> = connection.begin(request)?;
        let observation = reply.observation.checked(&connection.hello().task, 0.0).map_err(violation)?;
        let (Some(readback), Some(sample)) = (reply.readback, reply.sample) else {
            return Err(violation("the reply to reset has no `readback` or no `sight`"));
        };
        task.start(readback, &sample, &observation).map_err(RequestError::Local)
    }

    fn step(&mut self, connection: &mut Connection, action: &Action) -> Result<Step, RequestError> {
        let Self(task) = self;
        let (mut numbers, object) = task.command(action).map_err(RequestError::Local)?;
        numbers.extend(gripper_number(connection.hello().task.action.gripper, action.gripper));
        let expected = connection.hello().steps_per_period();
        let (period, observation) = connection.run::<T::Sample>(ActionKind::JointPosition, numbers, object)?;
        let samples = period.samples.unwrap_or_default();
        if samples.len() != expected {
            let got = samples.len();
            return Err(violation(format!("the step has {got} entries in `sights`; expected {expected}")));
        }
        task.score(&samples, &observation, period.clearance_m, period.state_hash).map_err(RequestError::Local)
    }

    fn send_reset(
        &mut self,
        connection: &mut Connection,
        scenario: &Scenario,
        parameters: BTreeMap<String, ParameterValue>,
    ) -> Result<(), RequestError> {
        let cell = self.0.resolve(scenario).map_err(RequestError::Local)?;
        let request = ResetRequest { index: 0, seed: 0, parameters, cell: Some(cell), policy: None, record_s: None };
        connection.begin::<IgnoredAny>(request).map(drop)
    }
}
