//! What a run records about its environment and its policy, and the subject of a recorded run.

use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_core::latency::Execution;
use robogate_dictionary::Provenance;
use robogate_gate::Controls;
use robogate_physics::{RobotFile, is_folder};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cell::{self, Cell, CellSettings};
use crate::failure::{Failure, OrFailure};
use crate::origin;
use crate::policy_source::PolicySource;
use crate::registry;
use crate::remote;
use crate::reopening::{Permit, Program, Reopening};
use crate::text::foreign;

use super::Subject;
use super::environment::{EnvironmentSource, Launched, RemoteSource};
use crate::environment_choice::{absolute, file_sha256};

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
    /// The SHA-256 of the file in that name, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedServers {
    simulator: ScoresItself,
    #[serde(default = "franka")]
    robot: String,
}

/// Whether a run was made in an environment whose Python processes this command starts.
pub fn starts_processes(provenance: &Provenance) -> bool {
    provenance.world.get("environment").is_some()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ScoresItself {
    #[serde(alias = "judging")]
    ScoresItself,
}

/// The robot of runs that record none.
pub(crate) fn franka() -> String {
    "franka".to_owned()
}

/// What a record contains about environment and policy.
struct Parts {
    recorded: Recorded,
    policy: Option<PolicySource>,
    execution: Option<Execution>,
    controls: Option<Value>,
}

impl Parts {
    fn of(provenance: &Provenance) -> Result<Self, Failure> {
        let mut world = provenance.world.clone();
        let mut taken = |key: &str| world.as_object_mut().and_then(|world| world.remove(key));
        let (policy, execution, controls) = (taken("policy"), taken("execution"), taken(Controls::KEY));
        let execution: Option<Execution> = execution
            .map(serde_json::from_value)
            .transpose()
            .context("plan.json: provenance.world.execution cannot be read")
            .or_request()?;
        if let Some(Execution { latency, .. }) = &execution {
            latency.check().context("plan.json: provenance.world.execution is not valid").or_request()?;
        }
        let policy: Option<PolicySource> = policy
            .map(serde_json::from_value)
            .transpose()
            .context("plan.json: provenance.world.policy cannot be read")
            .or_request()?;
        let recorded: Recorded =
            serde_json::from_value(world).context("plan.json: provenance.world cannot be read").or_request()?;
        Ok(Self { recorded, policy, execution, controls })
    }

    /// The programs that the record names.
    fn programs(&self) -> Vec<Program> {
        let environment = match &self.recorded {
            Recorded::Launched(RecordedEnvironment { environment, .. }) => {
                Some(Program::Environment(environment.clone()))
            }
            Recorded::Cell(CellSettings { robot, .. }) | Recorded::Remote(RecordedServers { robot, .. }) => {
                is_folder(robot).then(|| Program::Robot(robot.clone()))
            }
            Recorded::SelfContained(_) => None,
        };
        let policy = self.policy.as_ref().and_then(PolicySource::program);
        environment.into_iter().chain(policy.map(|named| Program::Policy(named.to_owned()))).collect()
    }
}

/// The programs that a record names.
pub fn programs(provenance: &Provenance) -> Result<Vec<Program>, Failure> {
    if provenance.source.is_some() {
        return Ok(Vec::new());
    }
    Parts::of(provenance).map(|parts| parts.programs())
}

/// The files of the robot of a run in `folder`, if they have not changed since. A folder that the record of another user
/// names is not read.
pub fn recorded_robot(provenance: &Provenance, folder: Option<&Path>) -> Option<Vec<RobotFile>> {
    let robot = match Parts::of(provenance).ok()?.recorded {
        Recorded::Cell(settings) => settings.robot,
        Recorded::SelfContained(_) | Recorded::Launched(_) | Recorded::Remote(_) => return None,
    };
    if is_folder(&robot) {
        origin::of(folder?, provenance)?;
    }
    cell::robot_files(&robot, provenance.robot.sha256.as_ref())
}

/// Rejects an environment or a robot whose files are not those of the run, before anything reads them.
fn same_files(what: &str, named: &str, recorded: Option<&String>, now: Option<&String>) -> Result<(), Failure> {
    if recorded == now {
        return Ok(());
    }
    let text = |sha256: Option<&String>| sha256.map_or("unknown", String::as_str).to_owned();
    Err(anyhow!(
        "the {what} {} is not the one of the run: its files have the SHA-256 {}, but the run recorded {}\nHint: restore the files \
         of the run, or start a new run",
        foreign(named),
        text(now),
        text(recorded)
    ))
    .or_request()
}

impl Subject {
    /// The subject of a recorded run in `folder`, or of rows without one. Starts only what `opening` permits. A remote
    /// environment needs the address of its servers. A policy server is queried for its identity again.
    pub fn recorded(provenance: &Provenance, folder: Option<&Path>, opening: &Reopening) -> Result<Self, Failure> {
        Self::from_parts(Parts::of(provenance)?, provenance, folder, opening)
    }

    /// Like [`Self::recorded`], with the scripted controller in place of the policy, whose server may be gone: for what only the
    /// environment knows.
    pub fn recorded_environment(
        provenance: &Provenance,
        folder: Option<&Path>,
        opening: &Reopening,
    ) -> Result<Self, Failure> {
        let parts = Parts { policy: None, ..Parts::of(provenance)? };
        Self::from_parts(parts, provenance, folder, opening)
    }

    fn from_parts(
        parts: Parts,
        provenance: &Provenance,
        folder: Option<&Path>,
        opening: &Reopening,
    ) -> Result<Self, Failure> {
        let Permit { environment: permitted, robot: permitted_robot, location, mut simulators } =
            opening.permit(folder, provenance, &parts.programs())?;
        simulators.loads = parts.policy.as_ref().map_or(Ok(None), |policy| policy.loaded(&location)).or_request()?;
        let Parts { mut recorded, policy, execution, controls } = parts;
        let mut recorded_robot = None;
        if let Some(own) = permitted_robot {
            let now = cell::identity(&cell::robot(&own).or_request()?.files().or_request()?);
            // A simulator that has the robot need not declare its files.
            if provenance.robot.sha256.is_some() {
                same_files("robot", &own, provenance.robot.sha256.as_ref(), Some(&now))?;
            }
            match &mut recorded {
                Recorded::Cell(CellSettings { robot, .. }) | Recorded::Remote(RecordedServers { robot, .. }) => {
                    let own = absolute(&own);
                    if own != *robot {
                        recorded_robot = Some(std::mem::replace(robot, own));
                    }
                }
                Recorded::SelfContained(_) | Recorded::Launched(_) => {}
            }
        }
        let (pool, launched) = match &recorded {
            Recorded::Launched(RecordedEnvironment { environment, sha256 }) if simulators.addresses.is_empty() => {
                let own = permitted.as_ref().unwrap_or(environment);
                let now = file_sha256(own).or_request()?;
                same_files("environment", own, sha256.as_ref(), now.as_ref())?;
                let (pool, servers) = simulators.launch(own)?;
                (Some(pool), Some(Launched { name: environment.clone(), sha256: now, servers }))
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
                "the run was made in the remote simulator {}\nHint: give its address with --simulator ADDRESS",
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
        .or_request()?;
        let chosen = provenance.task.setting_values();
        let environment = match (recorded, pool) {
            (Recorded::SelfContained(RecordedTask { task }), _) => {
                let task = registry::task(&task).or_request()?.with(&chosen);
                EnvironmentSource::SelfContained(task.map_err(|why| anyhow!("plan.json: {why}")).or_request()?)
            }
            (Recorded::Remote(RecordedServers { robot, .. }), Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot, launched: None })
            }
            (Recorded::Launched(_), Some(pool)) => {
                EnvironmentSource::Remote(RemoteSource { pool, robot: franka(), launched })
            }
            (Recorded::Cell(settings), pool) => {
                EnvironmentSource::Cell(Box::new(Cell::new(settings, chosen, pool).or_setup()?))
            }
            (Recorded::Remote(_) | Recorded::Launched(_), None) => {
                return Err(anyhow!("--simulator ADDRESS is missing")).or_request();
            }
        };
        let policy = match policy {
            Some(policy) => Some(policy.asked_again(&location)?),
            None => location.unused().map(|()| None)?,
        };
        let subject = Self::new(environment, policy)?.executed(execution)?;
        Ok(Self { controls, recorded_robot, ..subject })
    }
}

impl EnvironmentSource {
    /// What a run records about this environment.
    pub(crate) fn recorded(&self) -> serde_json::Result<Value> {
        serde_json::to_value(match self {
            Self::Cell(cell) => Recorded::Cell(cell.settings().clone()),
            Self::SelfContained(task) => Recorded::SelfContained(RecordedTask { task: task.name().to_owned() }),
            Self::Remote(RemoteSource { launched: Some(Launched { name, sha256, .. }), .. }) => {
                Recorded::Launched(RecordedEnvironment { environment: name.clone(), sha256: sha256.clone() })
            }
            Self::Remote(source) => {
                Recorded::Remote(RecordedServers { simulator: ScoresItself::ScoresItself, robot: source.robot.clone() })
            }
        })
    }
}
