//! Where environments come from: the built-in cell and tasks, or servers.

use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use robogate_campaign::Worker;
use robogate_core::latency::LATENCY_PARAMETER;
use robogate_core::{Assignment, Environment, ParameterSpace, Policy, TaskSpec};
use robogate_dictionary::provenance;
use robogate_policy::{Arm, BoundMap, Profile, TaskMap};
use robogate_remote::message::{self, Hello, HostedPolicy};
use robogate_remote::{Pool, RemoteEnvironment};
use robogate_tasks::SelfContained;

use crate::cell::{self, Cell, CellSettings};
use crate::environments::Servers;
use crate::failure::{Failure, OrFailure};
use crate::latency::without_latency;
use crate::policy_source::{DeclaredPolicy, PolicySource, without_profile};
use crate::registry::{self, CELL_TASK};
use crate::remote::{self, Simulators};

use super::recorded::franka;
use super::spaces::{check_declared, named_space};
use crate::environment_choice::{absolute, file_sha256};

/// The source of environments.
pub enum EnvironmentSource {
    /// A built-in task for an arm.
    Cell(Box<Cell>),
    /// A built-in task that brings its own world.
    SelfContained(Arc<dyn SelfContained>),
    /// Servers that declare their own task.
    Remote(RemoteSource),
}

/// Servers that declare their own task.
pub struct RemoteSource {
    pub(crate) pool: Arc<Pool>,
    /// The robot of the scripted controller, if the task is that of the built-in cell.
    pub(crate) robot: String,
    /// The environment and its servers, if this process started them.
    pub(crate) launched: Option<Launched>,
}

/// An environment whose servers this process started.
pub(crate) struct Launched {
    /// Its name in records.
    pub(crate) name: String,
    /// The SHA-256 of the file in its name, if there is one.
    pub(crate) sha256: Option<String>,
    pub(crate) servers: Arc<Servers>,
}

impl EnvironmentSource {
    /// The declarations of all built-in tasks except the default one.
    pub fn declared_tasks() -> Result<Vec<Arc<TaskSpec>>, Failure> {
        let arms = registry::ARM_TASKS.iter().filter(|task| task.name() != CELL_TASK).map(|task| {
            let settings = CellSettings::of(task.name(), &franka());
            Cell::new(settings, Assignment::default(), None).map(|cell| Self::Cell(Box::new(cell)))
        });
        let arms = arms.map(|source| source.and_then(|source: Self| source.task()));
        arms.chain(registry::TASKS.iter().map(|task| Ok(task.task()))).collect::<Result<_, _>>().or_setup()
    }

    /// The same environment with the settings of the paper, if it is a task of the paper.
    pub fn like_the_paper(mut self) -> anyhow::Result<Self> {
        if let Self::Cell(cell) = &mut self {
            cell.set_like_the_paper()?;
        }
        Ok(self)
    }

    /// An environment whose servers this process starts.
    pub(crate) fn launched(name: &str, simulators: &Simulators) -> Result<Self, Failure> {
        // Read before the start: a later edit of the file is another environment, and a wrong name is told before a package that
        // Python lacks.
        let sha256 = file_sha256(name).or_request()?;
        let (pool, servers) = simulators.launch(name)?;
        let launched = Launched { name: name.to_owned(), sha256, servers };
        Ok(Self::Remote(RemoteSource { pool, robot: franka(), launched: Some(launched) }))
    }

    /// The policies that the environment declares.
    fn policies(&self) -> &[HostedPolicy] {
        match self {
            Self::Remote(source) => &source.pool.hello().policies,
            Self::Cell(_) | Self::SelfContained(_) => &[],
        }
    }

    /// The policy that the user chose, with the version that the environment declares. Without a choice, the first
    /// policy that the environment declares, if there is one.
    pub(crate) fn declared_policy(&self, chosen: Option<PolicySource>) -> anyhow::Result<Option<PolicySource>> {
        let found = match &chosen {
            None => self.policies().first(),
            Some(PolicySource::Declared(wanted)) => {
                let found = self.policies().iter().find(|policy| policy.name == wanted.environment);
                if found.is_none() {
                    if let Some(from) = &wanted.from {
                        bail!(
                            "--policy {from}: only an environment in Python loads it\nHint: name the environment with --env"
                        );
                    }
                    let known: Vec<&str> = self.policies().iter().map(|policy| &*policy.name).collect();
                    if known.is_empty() {
                        return Err(without_profile(&wanted.environment));
                    }
                    let (name, known) = (&wanted.environment, known.join(", "));
                    bail!("--policy {name}: the environment declares no such policy. Expected one of: {known}, random");
                }
                found
            }
            Some(_) => None,
        };
        let from = match &chosen {
            Some(PolicySource::Declared(wanted)) => wanted.from.clone(),
            _ => None,
        };
        if let (Some(from), Some(PolicySource::Declared(wanted)), Some(found)) = (&from, &chosen, found)
            && !wanted.version.is_empty()
            && wanted.version != found.version
        {
            bail!(
                "the policy {from} is not the one of the run: its files have changed\nHint: name the recorded ones with --policy"
            );
        }
        let declared = |policy: &HostedPolicy| {
            let (environment, version) = (policy.name.clone(), policy.version.clone());
            PolicySource::Declared(DeclaredPolicy { environment, version, from: from.clone() })
        };
        Ok(found.map(declared).or(chosen))
    }

    /// The task.
    pub fn task(&self) -> anyhow::Result<Arc<TaskSpec>> {
        Ok(match self {
            Self::Cell(cell) => Arc::clone(cell.environment()?.task()),
            Self::SelfContained(task) => task.task(),
            Self::Remote(source) => Arc::new(source.pool.hello().task.clone()),
        })
    }

    /// Whether the same scenario and actions give the same episode.
    pub fn is_deterministic(&self) -> bool {
        match self {
            Self::Cell(_) | Self::SelfContained(_) => true,
            Self::Remote(source) => source.pool.hello().deterministic,
        }
    }

    /// Creates an environment.
    pub fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        Ok(match self {
            Self::Cell(cell) => cell.environment()?,
            Self::SelfContained(task) => task.environment()?,
            Self::Remote(source) => Box::new(RemoteEnvironment::new(Arc::clone(&source.pool))?),
        })
    }

    /// Creates an environment for a policy with this profile. A remote one renders only the cameras that the policy uses.
    pub fn environment_for(&self, profile: &Profile, map: Option<&TaskMap>) -> anyhow::Result<Box<dyn Environment>> {
        let Self::Remote(source) = self else { return self.environment() };
        let none = TaskMap::default();
        let bound = BoundMap::new(map.unwrap_or(&none), profile, &source.pool.hello().task);
        let cameras = bound.map_err(|why| anyhow!("the map does not fit: {why}"))?.cameras();
        Ok(Box::new(RemoteEnvironment::new(Arc::clone(&source.pool))?.with_cameras(cameras)))
    }

    /// The same environment with camera images of this width and height in pixels, if this process renders them.
    pub fn with_pictures_of(self, picture_px: usize) -> Self {
        match self {
            Self::Cell(cell) => Self::Cell(Box::new(cell.with_pictures_of(picture_px))),
            other => other,
        }
    }

    /// An environment and an expert that drives it with the commands of this arm mode. `None` without an expert.
    pub fn expert(&self, arm: Arm) -> anyhow::Result<Option<Worker>> {
        Ok(match self {
            Self::Cell(cell) => {
                let policy: Box<dyn Policy> = match arm {
                    Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => {
                        match cell.task().tool_expert(cell.robot().clone()) {
                            Some(expert) => expert,
                            None => return Ok(None),
                        }
                    }
                    Arm::JointPositions | Arm::JointDeltas => cell.controller()?,
                    Arm::Vector => return Ok(None),
                };
                Some(Worker { environment: cell.environment()?, policy })
            }
            Self::SelfContained(task) => Some(Worker { environment: task.environment()?, policy: task.controller() }),
            Self::Remote(source) => match source.pool.hello().policies.first() {
                Some(declared) => {
                    let (environment, policy) =
                        RemoteEnvironment::with_policy(Arc::clone(&source.pool), &declared.name)?;
                    // A control changes its actions.
                    Some(Worker { environment: Box::new(environment.in_step()), policy: Box::new(policy) })
                }
                None => None,
            },
        })
    }

    /// The information that a server of this environment declares.
    pub fn hello(&self) -> anyhow::Result<Hello> {
        match self {
            Self::Cell(cell) => cell.hello(),
            Self::SelfContained(task) => {
                let engine = cell::engine(task.engine().map_err(|fault| anyhow!(fault))?);
                let version = engine.version.unwrap_or_default();
                let sha256 = engine.build_sha256;
                let engine = message::Engine { name: engine.name, version, solver: None, sha256 };
                let program =
                    message::Program { name: "robogate".to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() };
                let space = Some(ParameterSpace::from_toml(task.space())?);
                Ok(Hello { space, ..Hello::new((*task.task()).clone(), program, engine) })
            }
            Self::Remote(_) => {
                bail!("`robogate serve` serves built-in environments only\nHint: leave out --env and --simulator")
            }
        }
    }

    /// Finds a parameter space by its name or file. `None` gives that of the environment. If the latency `varies`, the space
    /// may contain it.
    pub fn space(&self, wanted: Option<&str>, varies: bool) -> anyhow::Result<ParameterSpace> {
        let space = match (wanted, self) {
            (Some(wanted), _) => named_space(wanted)?,
            (None, Self::Cell(cell)) => named_space(cell.default_space())?,
            (None, Self::SelfContained(task)) => ParameterSpace::from_toml(task.space())?,
            (None, Self::Remote(source)) => {
                let hello = source.pool.hello();
                match &hello.space {
                    Some(space) => space.clone(),
                    None => hello.task.declared_space().with_context(|| {
                        format!(
                            "the task {} declares no parameter with a range\nHint: name a space with --space",
                            hello.task.name
                        )
                    })?,
                }
            }
        };
        if !varies && space.position(LATENCY_PARAMETER).is_some() && self.task()?.parameter(LATENCY_PARAMETER).is_none()
        {
            bail!("space {}: the parameter `{LATENCY_PARAMETER}` needs the option --latency varied", space.name());
        }
        let own = if varies { without_latency(&space)? } else { Some(space.clone()) };
        match (self, own) {
            (_, None) => {}
            (Self::Cell(cell), Some(own)) => cell.check_space(&own)?,
            (Self::SelfContained(_) | Self::Remote(_), Some(own)) => {
                check_declared(&*self.task()?, &own).with_context(|| format!("space {}", space.name()))?;
            }
        }
        Ok(space)
    }

    /// The scripted controller, if the environment has one.
    pub(crate) fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        match self {
            Self::Cell(cell) => cell.controller(),
            Self::SelfContained(task) => Ok(task.controller()),
            // A remote environment may be a built-in cell. Its scripted controller runs in this process.
            Self::Remote(source) if registry::arm_task(source.pool.hello().task.name.as_str()).is_some() => {
                let hello = source.pool.hello();
                let settings = CellSettings::of(hello.task.name.as_str(), &absolute(&source.robot));
                let cell = Cell::new(settings, Assignment::default(), None)?;
                remote::check_robot(hello, cell.robot(), &cell.robot_sha256()?)?;
                cell.controller()
            }
            Self::Remote(source) => bail!(
                "the task {} has no scripted controller here\nHint: name a policy with --policy",
                source.pool.hello().task.name
            ),
        }
    }

    pub(crate) fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let robot = |name: String, sha256| provenance::Robot { name, sha256, dimensions: None };
        Ok(match self {
            Self::Cell(cell) => cell.provenance()?,
            Self::SelfContained(task) => {
                (cell::engine(task.engine().map_err(|fault| anyhow!(fault))?), robot(task.name().to_owned(), None))
            }
            Self::Remote(source) => {
                let hello = source.pool.hello();
                let known = hello.robot.clone();
                let unnamed = || (hello.task.name.to_string(), None);
                let (name, sha256) = known.map_or_else(unnamed, |robot| (robot.name, robot.sha256));
                (remote::engine(hello), robot(name, sha256))
            }
        })
    }
}
