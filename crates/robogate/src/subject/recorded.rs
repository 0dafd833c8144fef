//! What a run records about its environment and its policy, and the subject of a recorded run.

use anyhow::{Context, anyhow};
use robogate_core::latency::Execution;
use robogate_dictionary::Provenance;
use robogate_gate::Controls;
use robogate_physics::{RobotFile, SuctionLaw};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cell::{self, Cell, CellSettings};
use crate::exit::{Exit, OrExit};
use crate::policy_source::{PolicyLocation, PolicySource};
use crate::registry::{self};
use crate::remote::{self, Simulators};

use super::Subject;
use super::environment::{EnvironmentSource, RemoteSource};

/// What a run records about its environment, in addition to task, engine and robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum Recorded {
    /// A built-in task that brings its own world.
    SelfContained(RecordedTask),
    /// An environment that runs in Python.
    Launched(RecordedEnvironment),
    /// Servers that declare their own task.
    Remote(RecordedServers),
    /// A built-in task for an arm.
    Cell(CellSettings),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedTask {
    task: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedEnvironment {
    environment: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedServers {
    simulator: ScoresItself,
    #[serde(default = "franka")]
    robot: String,
}

/// Whether a run was made in an environment whose Python processes this command starts.
pub(crate) fn starts_processes(provenance: &Provenance) -> bool {
    provenance.world.get("environment").is_some()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ScoresItself {
    #[serde(alias = "judging")]
    ScoresItself,
}

/// The robot of runs that record none.
pub(super) fn franka() -> String {
    "franka".to_owned()
}

/// The files of the robot of a recorded run, if they have not changed since.
pub(crate) fn recorded_robot(provenance: &Provenance) -> Option<Vec<RobotFile>> {
    let mut world = provenance.world.clone();
    let object = world.as_object_mut()?;
    object.remove("policy");
    object.remove("execution");
    object.remove(Controls::KEY);
    let robot = match serde_json::from_value(world).ok()? {
        Recorded::Cell(settings) => settings.robot,
        Recorded::SelfContained(_) | Recorded::Launched(_) | Recorded::Remote(_) => return None,
    };
    cell::robot_files(&robot, provenance.robot.sha256.as_ref())
}

impl Subject {
    /// The subject of a recorded run. A remote environment needs the address of its servers. A policy server is queried
    /// for its identity again.
    pub(crate) fn recorded(provenance: &Provenance, simulators: &Simulators) -> Result<Self, Exit> {
        Self::recorded_at(provenance, simulators, &PolicyLocation::default())
    }

    /// The subject of a recorded run, like [`Self::recorded`], with an external policy that is reached at `location`.
    pub(crate) fn recorded_at(
        provenance: &Provenance,
        simulators: &Simulators,
        location: &PolicyLocation,
    ) -> Result<Self, Exit> {
        let mut world = provenance.world.clone();
        let mut taken = |key: &str| world.as_object_mut().and_then(|world| world.remove(key));
        let (policy, execution, controls) = (taken("policy"), taken("execution"), taken(Controls::KEY));
        let execution: Option<Execution> = execution
            .map(serde_json::from_value)
            .transpose()
            .context("plan.json: provenance.world.execution cannot be read")
            .or_usage()?;
        if let Some(Execution { latency, .. }) = &execution {
            latency.check().context("plan.json: provenance.world.execution is not valid").or_usage()?;
        }
        let policy: Option<PolicySource> = policy
            .map(serde_json::from_value)
            .transpose()
            .context("plan.json: provenance.world.policy cannot be read")
            .or_usage()?;
        let recorded: Recorded =
            serde_json::from_value(world).context("plan.json: provenance.world cannot be read").or_usage()?;
        let (pool, launched) = match &recorded {
            Recorded::Launched(RecordedEnvironment { environment }) if simulators.addresses.is_empty() => {
                let (pool, servers) = simulators.launch(environment)?;
                (Some(pool), Some((environment.clone(), servers)))
            }
            _ => (simulators.connect()?, None),
        };
        let engine = &provenance.engine;
        let remote = match &recorded {
            Recorded::SelfContained(_) => false,
            Recorded::Remote(_) | Recorded::Launched(_) => true,
            Recorded::Cell(settings) => settings.simulator.is_some(),
        };
        match &pool {
            None if remote => Err(anyhow!(
                "the run was made in the remote simulator {}\n  hint: give its address with --simulator ADDRESS",
                engine.name
            )),
            Some(_) if !remote => {
                Err(anyhow!("the run was made in the built-in engine {}, without --simulator", engine.name))
            }
            Some(pool) if !remote::is_engine(pool.hello(), engine) => {
                let (now, version) = (remote::engine(pool.hello()), engine.version.as_deref().unwrap_or_default());
                let other = now.version.as_deref().unwrap_or_default();
                Err(anyhow!("the run was made in {} {version}; this simulator is {} {other}", engine.name, now.name))
            }
            _ => Ok(()),
        }
        .or_usage()?;
        let environment = match (recorded, pool) {
            (Recorded::SelfContained(RecordedTask { task }), _) => {
                EnvironmentSource::SelfContained(registry::task(&task).or_usage()?)
            }
            (Recorded::Remote(RecordedServers { robot, .. }), Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot, launched: None })
            }
            (Recorded::Launched(_), Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot: franka(), launched })
            }
            (Recorded::Cell(settings), pool) => {
                // Every run of a robot with a cup records its suction law.
                EnvironmentSource::Cell(Box::new(Cell::new(settings, SuctionLaw::Vacuum, pool).or_setup()?))
            }
            (Recorded::Remote(_) | Recorded::Launched(_), None) => {
                return Err(anyhow!("--simulator ADDRESS is missing")).or_usage();
            }
        };
        let policy = match policy {
            Some(policy) => Some(policy.asked_again(location)?),
            None => location.unused().map(|()| None)?,
        };
        let subject = Self::new(environment, policy)?.executed(execution)?;
        Ok(Self { controls, ..subject })
    }
}

impl EnvironmentSource {
    /// What a run records about this environment.
    pub(super) fn recorded(&self) -> serde_json::Result<Value> {
        serde_json::to_value(match self {
            Self::Cell(cell) => Recorded::Cell(cell.settings().clone()),
            Self::SelfContained(task) => Recorded::SelfContained(RecordedTask { task: task.name().to_owned() }),
            Self::Remote(RemoteSource { launched: Some((name, _)), .. }) => {
                Recorded::Launched(RecordedEnvironment { environment: name.clone() })
            }
            Self::Remote(source) => {
                Recorded::Remote(RecordedServers { simulator: ScoresItself::ScoresItself, robot: source.robot.clone() })
            }
        })
    }
}
