//! Where environments come from: the built-in cell and tasks, or servers.

use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use robogate_campaign::Worker;
use robogate_core::latency::LATENCY_PARAMETER;
use robogate_core::{Assignment, Environment, ParameterSpace, Policy, TaskSpec};
use robogate_dictionary::provenance;
use robogate_policy::{Arm, BoundMap, Profile, TaskMap};
use robogate_remote::message::{Hello, HostedPolicy};
use robogate_remote::{Pool, RemoteEnvironment};

use crate::cell::{self, Cell, FRANKA, default_place};
use crate::environments::Servers;
use crate::failure::{Failure, OrFailure};
use crate::policy_source::{DeclaredPolicy, PolicySource, without_profile};
use crate::remote::{self, Simulators};
use crate::stress::is_stress;

use super::built_in::BuiltIn;
use super::spaces::{check_declared, named_space, remaining};
use crate::environment_choice::{absolute, file_sha256};

/// The source of environments.
pub enum EnvironmentSource {
    /// A built-in task.
    BuiltIn(Box<dyn BuiltIn>),
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

impl RemoteSource {
    /// An environment and its policy of this name, whose actions may be changed on their way.
    pub(crate) fn in_step(&self, policy: &str) -> anyhow::Result<Worker> {
        let (environment, policy) = RemoteEnvironment::with_policy(Arc::clone(&self.pool), policy)?;
        Ok(Worker { environment: Box::new(environment.in_step()), policy: Box::new(policy) })
    }
}

impl EnvironmentSource {
    /// The same environment with the settings of the paper, if it is a task of the paper.
    pub fn like_the_paper(mut self) -> anyhow::Result<Self> {
        if let Self::BuiltIn(built_in) = &mut self
            && let Some(cell) = built_in.cell_mut()
        {
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
        Ok(Self::Remote(RemoteSource { pool, robot: FRANKA.to_owned(), launched: Some(launched) }))
    }

    /// The policies that the environment declares.
    fn policies(&self) -> &[HostedPolicy] {
        match self {
            Self::Remote(source) => &source.pool.hello().policies,
            Self::BuiltIn(_) => &[],
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

    /// What an environment in another process declares. `None` for a built-in one.
    pub fn declared(&self) -> Option<&Hello> {
        match self {
            Self::Remote(source) => Some(source.pool.hello()),
            Self::BuiltIn(_) => None,
        }
    }

    /// The task.
    pub fn task(&self) -> anyhow::Result<Arc<TaskSpec>> {
        Ok(match self {
            Self::BuiltIn(built_in) => built_in.task()?,
            Self::Remote(source) => Arc::new(source.pool.hello().task.clone()),
        })
    }

    /// Whether the same scenario and actions give the same episode.
    pub fn is_deterministic(&self) -> bool {
        match self {
            Self::BuiltIn(_) => true,
            Self::Remote(source) => source.pool.hello().deterministic,
        }
    }

    /// Creates an environment.
    pub fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        Ok(match self {
            Self::BuiltIn(built_in) => built_in.environment()?,
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
    pub fn with_pictures_of(mut self, picture_px: usize) -> Self {
        if let Self::BuiltIn(built_in) = &mut self
            && let Some(cell) = built_in.cell_mut()
        {
            cell.set_picture_px(picture_px);
        }
        self
    }

    /// An environment and an expert that drives it with the commands of this arm mode. `None` without an expert.
    pub fn expert(&self, arm: Arm) -> anyhow::Result<Option<Worker>> {
        Ok(match self {
            Self::BuiltIn(built_in) => match built_in.expert(arm)? {
                Some(policy) => Some(Worker { environment: built_in.environment()?, policy }),
                None => None,
            },
            Self::Remote(source) => match source.pool.hello().policies.first() {
                Some(declared) => Some(source.in_step(&declared.name)?),
                None => None,
            },
        })
    }

    /// The information that a server of this environment declares.
    pub fn hello(&self) -> anyhow::Result<Hello> {
        match self {
            Self::BuiltIn(built_in) => built_in.hello(),
            Self::Remote(_) => {
                bail!("`robogate serve` serves built-in environments only\nHint: leave out --env and --simulator")
            }
        }
    }

    /// Finds a parameter space by its name or file. `None` gives that of the environment. If the latency `varies`, the space
    /// may contain it; with `stress`, parameters of stress too.
    pub fn space(&self, wanted: Option<&str>, varies: bool, stress: bool) -> anyhow::Result<ParameterSpace> {
        let space = match (wanted, self) {
            (Some(wanted), _) => named_space(wanted)?,
            (None, Self::BuiltIn(built_in)) => built_in.space()?,
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
        if let Some(unused) = space.parameters().iter().find(|parameter| !stress && is_stress(&parameter.name)) {
            bail!("space {}: the parameter `{}` needs the option --stress", space.name(), unused.name);
        }
        let own = remaining(&space, |name| (varies && name == LATENCY_PARAMETER) || is_stress(name))?;
        match (self, own) {
            (_, None) => {}
            (Self::BuiltIn(built_in), Some(own)) => built_in.check_space(&own)?,
            (Self::Remote(_), Some(own)) => {
                check_declared(&*self.task()?, &own).with_context(|| format!("space {}", space.name()))?;
            }
        }
        Ok(space)
    }

    /// The scripted controller, if the environment has one.
    pub(crate) fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        match self {
            Self::BuiltIn(built_in) => built_in.controller(),
            // A remote environment may be a built-in cell. Its scripted controller runs in this process.
            Self::Remote(source) if cell::is_cell(&source.pool.hello().task) => {
                let hello = source.pool.hello();
                let place = default_place(&absolute(&source.robot));
                let cell = Cell::new(&*cell::recorded_task(&hello.task)?, place, Assignment::default(), None)?;
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
        Ok(match self {
            Self::BuiltIn(built_in) => built_in.provenance()?,
            Self::Remote(source) => {
                let hello = source.pool.hello();
                let known = hello.robot.clone();
                let unnamed = || (hello.task.name.to_string(), None);
                let (name, sha256) = known.map_or_else(unnamed, |robot| (robot.name, robot.sha256));
                (remote::engine(hello), provenance::Robot { name, sha256, dimensions: None })
            }
        })
    }
}
