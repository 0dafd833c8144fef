//! Environments of this process: the built-in tasks.

use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_core::{Environment, ParameterSpace, Policy, Suite, TaskSpec};
use robogate_dictionary::{Place, provenance};
use robogate_policy::Arm;
use robogate_remote::message::{self, Hello};
use robogate_tasks::SelfContained;

use super::spaces::check_declared;
use crate::cell::{self, Cell};

/// A built-in task that is ready to run.
pub trait BuiltIn: Send + Sync {
    /// The task.
    fn task(&self) -> anyhow::Result<Arc<TaskSpec>>;

    /// Creates an environment.
    fn environment(&self) -> anyhow::Result<Box<dyn Environment>>;

    /// Creates the scripted controller.
    fn controller(&self) -> anyhow::Result<Box<dyn Policy>>;

    /// An expert that acts with the commands of this arm mode. `None` without one.
    fn expert(&self, arm: Arm) -> anyhow::Result<Option<Box<dyn Policy>>>;

    /// The parameter space of the task.
    fn space(&self) -> anyhow::Result<ParameterSpace>;

    /// Rejects a space with a parameter that the task does not have.
    fn check_space(&self, space: &ParameterSpace) -> anyhow::Result<()>;

    /// Rejects a suite with a parameter that the task does not have.
    fn check_suite(&self, suite: &Suite) -> anyhow::Result<()>;

    /// What a run records about where its episodes took place.
    fn place(&self) -> Place;

    /// The engine and the robot, as a run records them.
    fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)>;

    /// The information that a server of this environment declares.
    fn hello(&self) -> anyhow::Result<Hello>;

    /// The cell, for a task with an arm.
    fn cell(&self) -> Option<&Cell> {
        None
    }

    /// The cell, for changes.
    fn cell_mut(&mut self) -> Option<&mut Cell> {
        None
    }

    /// The cell, for a task with an arm.
    fn into_cell(self: Box<Self>) -> Option<Cell> {
        None
    }
}

impl BuiltIn for Cell {
    fn task(&self) -> anyhow::Result<Arc<TaskSpec>> {
        Ok(Arc::clone(self.environment()?.task()))
    }

    fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        self.environment()
    }

    fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        self.controller()
    }

    fn expert(&self, arm: Arm) -> anyhow::Result<Option<Box<dyn Policy>>> {
        match arm {
            Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
                Ok(self.task().tool_expert(self.robot().clone(), self.kinematics()?))
            }
            Arm::JointPositions | Arm::JointDeltas => self.controller().map(Some),
            Arm::Vector => Ok(None),
        }
    }

    fn space(&self) -> anyhow::Result<ParameterSpace> {
        self.own_space()
    }

    fn check_space(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        self.check_space(space)
    }

    fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        self.check_suite(suite)
    }

    fn place(&self) -> Place {
        Place::Cell(self.settings().clone())
    }

    fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        self.provenance()
    }

    fn hello(&self) -> anyhow::Result<Hello> {
        self.hello()
    }

    fn cell(&self) -> Option<&Cell> {
        Some(self)
    }

    fn cell_mut(&mut self) -> Option<&mut Cell> {
        Some(self)
    }

    fn into_cell(self: Box<Self>) -> Option<Cell> {
        Some(*self)
    }
}

impl BuiltIn for Arc<dyn SelfContained> {
    fn task(&self) -> anyhow::Result<Arc<TaskSpec>> {
        Ok((**self).task())
    }

    fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        Ok((**self).environment()?)
    }

    fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        Ok((**self).controller())
    }

    fn expert(&self, _: Arm) -> anyhow::Result<Option<Box<dyn Policy>>> {
        Ok(Some((**self).controller()))
    }

    fn space(&self) -> anyhow::Result<ParameterSpace> {
        Ok(ParameterSpace::from_toml((**self).space())?)
    }

    fn check_space(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        check_declared(&(**self).task(), space).with_context(|| format!("space {}", space.name()))
    }

    fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        check_declared(&(**self).task(), suite.space()).with_context(|| format!("suite {}", suite.name()))
    }

    fn place(&self) -> Place {
        Place::SelfContained
    }

    fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let engine = cell::engine(self.engine().map_err(|fault| anyhow!(fault))?);
        Ok((engine, provenance::Robot { name: self.name().to_owned(), sha256: None, dimensions: None }))
    }

    fn hello(&self) -> anyhow::Result<Hello> {
        let (engine, _) = self.provenance()?;
        let task = (*(**self).task()).clone();
        Ok(Hello { space: Some(BuiltIn::space(self)?), ..hello_of(task, engine) })
    }
}

/// The hello of a server of this program.
pub(crate) fn hello_of(task: TaskSpec, engine: provenance::Engine) -> Hello {
    let program = message::Program { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() };
    let version = engine.version.unwrap_or_default();
    let engine = message::Engine { name: engine.name, version, solver: None, sha256: engine.build_sha256 };
    Hello::new(task, program, engine)
}
