//! The subject of a run: an environment and the policy in it.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use clap::Args;
use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::latency::{Execution, LATENCY_PARAMETER, Latency, with_latency, with_parameter};
use robogate_core::{
    Assignment, Environment, Fault, FaultKind, Foresight, InfeasibleShare, ParameterSpace, Policy, SpaceFeasibility,
    Suite, TaskSpec,
};
use robogate_dictionary::{Platform, Provenance, SCHEMA_VERSION, Tool, provenance, read_text};
use robogate_gate::Controls;
use robogate_physics::{RobotFile, SuctionLaw, is_folder};
use robogate_policy::{Arm, BoundMap, Profile, TaskMap};
use robogate_remote::message::{self, Hello, HostedPolicy};
use robogate_remote::{Pool, RemoteEnvironment};
use robogate_tasks::SelfContained;
use robogate_tasks::pick_place::{Rules, ToolExpert, built_in_space, built_in_spaces};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::arm_cell::{ArmCell, ArmSettings};
use crate::cell::{self, Cell, CellSettings};
use crate::environments::Servers;
use crate::exit::{Exit, OrExit};
use crate::latency::{LatencyArguments, without_latency};
use crate::policy_source::{DeclaredPolicy, PolicyLocation, PolicySource, without_profile};
use crate::registry::{self, CELL_TASK, ENGINES, EngineEntry};
use crate::remote::{self, Simulators};
use crate::renderer::RendererName;
use crate::terminal::{foreign, note, percent};

/// The arguments that select the environment.
#[derive(Debug, Args)]
pub(crate) struct EnvironmentArguments {
    /// Choose the built-in task (see `robogate list`)
    #[arg(long, value_name = "TASK", default_value = CELL_TASK, conflicts_with = "addresses")]
    task: String,
    /// Run in this environment: FAMILY:NAME of a bundled one (see `robogate env list`), gymnasium:ID, or your own as
    /// FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE
    #[arg(long, value_name = "NAME", conflicts_with_all = ["task", "addresses", "engine", "time_step", "robot", "grip_force", "suction", "time_limit", "jam_force", "jam_duration", "orientation_tolerance"])]
    env: Option<String>,
    /// Choose the robot: a built-in one (see `robogate robots`), or the folder of your own
    #[arg(long, value_name = "ROBOT", default_value = "franka")]
    robot: String,
    /// Choose the physics engine: mujoco or rapier
    #[arg(long, value_name = "ENGINE", default_value = ENGINES[0].name, conflicts_with = "addresses")]
    engine: String,
    /// Set the engine's time step, in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS", conflicts_with = "addresses")]
    time_step: Option<f64>,
    /// Set the normal force of each gripper pad, in newtons; default: the robot's own
    #[arg(long, value_name = "NEWTONS")]
    grip_force: Option<f64>,
    /// Choose how a suction cup holds an object: surface (a joint that never breaks, as in the paper) or vacuum
    /// (limited by pressure and friction); default: surface with the paper preset, vacuum otherwise
    #[arg(long, value_name = "LAW")]
    suction: Option<SuctionLaw>,
    /// Set the time limit of an episode of pick_place, in seconds; a multiple of 0.05 [default: 15]
    #[arg(long, value_name = "SECONDS")]
    time_limit: Option<f64>,
    /// Set the contact force above which the robot presses, in newtons; see the failure mode `jam` [default: 100]
    #[arg(long, value_name = "NEWTONS")]
    jam_force: Option<f64>,
    /// Set the duration of pressing that is a jam, in seconds [default: 0.05]
    #[arg(long, value_name = "SECONDS")]
    jam_duration: Option<f64>,
    /// Require the part to be at rest within this angle of its orientation at the target, in degrees; default: any
    /// orientation
    #[arg(long, value_name = "DEGREES")]
    orientation_tolerance: Option<f64>,
    /// Choose the renderer of the camera images: the embedded ray caster, or MuJoCo's renderer through EGL
    /// (docs/cameras.md)
    #[arg(long, value_name = "RENDERER", default_value = "embedded")]
    renderer: RendererName,
    #[command(flatten)]
    pub(crate) simulators: Simulators,
}

impl EnvironmentArguments {
    /// The environment that the arguments select. `suction` is used for a suction cup if they do not choose a law.
    pub(crate) fn environment(&self, suction: SuctionLaw) -> Result<EnvironmentSource, Exit> {
        if let Some(name) = &self.env {
            return EnvironmentSource::launched(&from_any_folder(name), &self.simulators);
        }
        let pool = self.simulators.connect()?;
        let scores_itself = pool.as_ref().is_some_and(|pool| pool.hello().scores_itself);
        if let (Some(option), true) = (self.rules_given().first(), scores_itself || self.task != CELL_TASK) {
            return Err(anyhow!("{option} applies to pick_place in the built-in cell only\n  hint: leave it out"))
                .or_usage();
        }
        if let Some(pool) = pool.as_ref().filter(|pool| pool.hello().scores_itself) {
            return Ok(EnvironmentSource::Remote(RemoteSource {
                pool: Arc::clone(pool),
                robot: self.robot.clone(),
                launched: None,
            }));
        }
        if pool.is_none() && registry::arm_task(&self.task).is_some() {
            if self.renderer.record().is_some() {
                return Err(anyhow!("--renderer egl cannot be used with --task {}", self.task)).or_usage();
            }
            return ArmCell::new(self.arm_settings(), suction)
                .map(|cell| EnvironmentSource::Arm(Box::new(cell)))
                .or_usage();
        }
        if pool.is_none() && self.task != CELL_TASK {
            return registry::task(&self.task).map(EnvironmentSource::SelfContained).or_usage();
        }
        Cell::new(self.settings(), suction, pool).map(|cell| EnvironmentSource::Cell(Box::new(cell))).or_setup()
    }

    /// The environment that the arguments select for a suite: if they select none, that of the suite.
    pub(crate) fn environment_of(&self, suite: Option<&Suite>, suction: SuctionLaw) -> Result<EnvironmentSource, Exit> {
        match suite.and_then(Suite::environment) {
            Some(name) if self.env.is_none() && self.simulators.addresses.is_empty() => {
                EnvironmentSource::launched(name, &self.simulators)
            }
            _ => self.environment(suction),
        }
    }

    /// The built-in cell that the arguments select, for verbs that support pick_place only.
    pub(crate) fn cell(&self) -> Result<Cell, Exit> {
        match self.environment(SuctionLaw::Vacuum)? {
            EnvironmentSource::Cell(cell) => Ok(*cell),
            EnvironmentSource::Arm(_) | EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => {
                Err(anyhow!(
                    "this command works with the built-in cell only\n  hint: leave out --task, --env and --simulator"
                ))
                .or_usage()
            }
        }
    }

    fn arm_settings(&self) -> ArmSettings {
        let CellSettings { robot, engine, time_step_s, grip_force_n, suction, .. } = self.settings();
        ArmSettings { task: self.task.clone(), robot, engine, time_step_s, grip_force_n, suction }
    }

    fn settings(&self) -> CellSettings {
        let engine = ENGINES.iter().find(|engine| engine.name == self.engine);
        CellSettings {
            robot: absolute(&self.robot),
            engine: self.engine.clone(),
            time_step_s: self.time_step.unwrap_or(engine.map_or(0.0, |engine: &EngineEntry| engine.time_step_s)),
            grip_force_n: self.grip_force,
            suction: self.suction,
            renderer: self.renderer.record(),
            rules: self.rules(),
            simulator: None,
        }
    }

    fn rules(&self) -> Rules {
        let default = Rules::default();
        Rules {
            time_limit_s: self.time_limit.unwrap_or(default.time_limit_s),
            jam_force_n: self.jam_force.unwrap_or(default.jam_force_n),
            jam_duration_s: self.jam_duration.unwrap_or(default.jam_duration_s),
            orientation_tolerance_rad: self.orientation_tolerance.map(f64::to_radians),
            ..default
        }
    }

    /// The options that set a rule of the built-in cell.
    fn rules_given(&self) -> Vec<&'static str> {
        let given = [
            ("--time-limit", self.time_limit),
            ("--jam-force", self.jam_force),
            ("--jam-duration", self.jam_duration),
            ("--orientation-tolerance", self.orientation_tolerance),
        ];
        given.into_iter().filter_map(|(name, value)| value.map(|_| name)).collect()
    }
}

/// Replaces a robot's folder by its absolute path, so that a run can be resumed from any folder. A name stays as it is.
fn absolute(robot: &str) -> String {
    let path = Path::new(robot);
    let full = if is_folder(robot) { path.canonicalize().ok() } else { None };
    full.map_or_else(|| robot.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// Makes the file in the name of an environment absolute, so that a run can be resumed from any folder.
fn from_any_folder(name: &str) -> String {
    let (file, attribute) = match name.find(".py").map(|at| name.split_at(at + 3)) {
        Some((file, attribute)) if attribute.is_empty() || attribute.starts_with(':') => (file, attribute),
        _ => return name.to_owned(),
    };
    match Path::new(file).canonicalize() {
        Ok(full) => format!("{}{attribute}", full.display()),
        Err(_) => name.to_owned(),
    }
}

/// The source of environments.
pub(crate) enum EnvironmentSource {
    /// The built-in cell.
    Cell(Box<Cell>),
    /// A built-in task for an arm.
    Arm(Box<ArmCell>),
    /// A built-in task that brings its own world.
    SelfContained(&'static dyn SelfContained),
    /// Servers that declare their own task.
    Remote(RemoteSource),
}

/// Servers that declare their own task.
pub(crate) struct RemoteSource {
    pool: Arc<Pool>,
    /// The robot of the scripted controller, if the task is that of the built-in cell.
    robot: String,
    /// The environment and its servers, if this process started them.
    launched: Option<(String, Arc<Servers>)>,
}

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
    Arm(ArmSettings),
    /// The built-in cell.
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

fn franka() -> String {
    "franka".to_owned()
}

/// The subject of a run: a policy in an environment.
pub(crate) struct Subject {
    environment: EnvironmentSource,
    /// `None` for the environment's scripted controller.
    policy: Option<PolicySource>,
    task: Arc<TaskSpec>,
    /// The latency of the policy. `None` if the world waits for it.
    execution: Option<Execution>,
    /// The controls of the gate, as its runs record them.
    controls: Option<Value>,
}

impl Subject {
    /// Combines this policy, or the environment's scripted controller, with this environment. Returns an error if the
    /// policy cannot drive the task.
    pub(crate) fn new(environment: EnvironmentSource, policy: Option<PolicySource>) -> Result<Self, Exit> {
        let rendered_px = policy.as_ref().and_then(|policy| policy.profile()?.rendered_px);
        let environment = rendered_px.into_iter().fold(environment, EnvironmentSource::with_pictures_of);
        let task = environment.task().or_broken()?;
        let policy = environment.declared_policy(policy).or_usage()?;
        let subject = Self { environment, policy, task, execution: None, controls: None };
        let ready = match &subject.policy {
            // The environment declares it for its own task.
            Some(PolicySource::Declared(_)) => return Ok(subject),
            Some(source) => source.policy().map_err(anyhow::Error::from).or_broken()?,
            None => subject.environment.controller().or_usage()?,
        };
        ready
            .check(&subject.task)
            .map_err(|why| {
                anyhow!("the policy {} cannot drive this environment: {why}{}", subject.policy_name(), subject.hint())
            })
            .or_usage()?;
        Ok(subject)
    }

    /// The hint for a policy that does not fit an environment in another process.
    fn hint(&self) -> &'static str {
        match (&self.environment, &self.policy) {
            (EnvironmentSource::Remote(_), Some(source)) if source.profile().is_some() => {
                "\n  hint: --map FILE maps the environment to the profile; `robogate policy check` with the same options shows both \
                 sides"
            }
            _ => "",
        }
    }

    /// The same subject with the latency of these arguments. A latency that is to be measured is measured now.
    pub(crate) fn with_latency(self, arguments: &LatencyArguments) -> Result<Self, Exit> {
        let execution = arguments.execution(|| self.worker()).or_usage()?;
        self.executed(execution)
    }

    fn executed(mut self, execution: Option<Execution>) -> Result<Self, Exit> {
        if let (Some(_), Some(PolicySource::Declared(policy))) = (&execution, &self.policy) {
            return Err(anyhow!(
                "--latency: the environment runs the policy {} itself, so its actions cannot be delayed\n  hint: leave out \
                 --latency and --execution",
                policy.environment
            ))
            .or_usage();
        }
        if execution.as_ref().is_some_and(|execution| execution.latency == Latency::Parameter) {
            self.task = with_parameter(&self.task);
        }
        self.execution = execution;
        Ok(self)
    }

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
            Recorded::SelfContained(_) | Recorded::Arm(_) => false,
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
            (Recorded::Arm(settings), _) => {
                EnvironmentSource::Arm(Box::new(ArmCell::new(settings, SuctionLaw::Vacuum).or_usage()?))
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

    /// The same subject with the controls of its gate.
    pub(crate) fn with_controls(self, controls: &Controls) -> Self {
        Self { controls: Some(json!(controls)), ..self }
    }

    /// The environment.
    pub(crate) fn environment_source(&self) -> &EnvironmentSource {
        &self.environment
    }

    /// The same subject with camera images of this width and height in pixels, if the cell renders them.
    pub(crate) fn with_pictures_of(mut self, picture_px: usize) -> Self {
        self.environment = self.environment.with_pictures_of(picture_px);
        self
    }

    /// The task.
    pub(crate) fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    /// What the task knows about episodes before they run. `None` if it knows nothing.
    pub(crate) fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, Exit> {
        // The parameter of a latency belongs to an adapter, which needs a policy.
        if self.execution.is_some() {
            return Ok(self.worker().or_broken()?.environment.foresight());
        }
        Ok(self.environment.environment().or_broken()?.foresight())
    }

    /// The name of the environment's own suite, if it has one.
    pub(crate) fn own_suite(&self) -> Option<&'static str> {
        match &self.environment {
            EnvironmentSource::Cell(_) => Some("industrial-68"),
            EnvironmentSource::Arm(cell) => Some(cell.suite()),
            EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => None,
        }
    }

    /// The distribution of the units of the robot, if it is known.
    pub(crate) fn own_unit_space(&self) -> Option<&'static str> {
        match &self.environment {
            EnvironmentSource::Cell(cell) => Some(cell.unit_space()),
            EnvironmentSource::Arm(_) | EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => None,
        }
    }

    /// Prints the share of a space that no policy can complete, by reason.
    pub(crate) fn note_feasibility(&self, space: &ParameterSpace) {
        // Servers check nothing before an episode, and an environment that cannot be created is reported by the run.
        if let EnvironmentSource::Remote(_) = self.environment {
            return;
        }
        let Ok(environment) = self.environment.environment() else { return };
        let Ok(check) = SpaceFeasibility::of(&*environment, space) else { return };
        for InfeasibleShare { reason, share } in &check.infeasible {
            note(format_args!(
                "{} of this space is infeasible for every policy: {} ({})",
                percent(*share),
                reason.condition,
                reason.limit
            ));
        }
    }

    /// A short name for folders: that of the robot, or of the task.
    pub(crate) fn label(&self) -> String {
        match &self.environment {
            EnvironmentSource::Cell(cell) => {
                let name = Path::new(&cell.settings().robot).file_name();
                name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
            }
            EnvironmentSource::Arm(_) | EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => {
                self.task.name.as_str().to_owned()
            }
        }
    }

    /// The policy's name in records.
    pub(crate) fn policy_name(&self) -> &str {
        self.policy.as_ref().map_or("scripted", PolicySource::name)
    }

    /// The source of the policy, unless it is the environment's own controller.
    pub(crate) fn policy_source(&self) -> Option<&PolicySource> {
        self.policy.as_ref()
    }

    /// How many episodes the policy can drive at once, if that is limited.
    pub(crate) fn at_most(&self) -> Option<NonZeroUsize> {
        self.policy.as_ref()?.profile()?.dialect.one_at_a_time().then_some(NonZeroUsize::MIN)
    }

    /// How many servers the environment runs in, if it is remote. As many episodes run at once.
    pub(crate) fn servers(&self) -> Option<NonZeroUsize> {
        match &self.environment {
            EnvironmentSource::Cell(cell) => cell.servers(),
            EnvironmentSource::Arm(_) | EnvironmentSource::SelfContained(_) => None,
            // This process starts as many as it needs.
            EnvironmentSource::Remote(RemoteSource { launched: Some(_), .. }) => None,
            EnvironmentSource::Remote(source) => NonZeroUsize::new(source.pool.len()),
        }
    }

    /// How many episodes run at once by default on this many cores. A worker waits while a policy server computes, so
    /// others must simulate and render in the meantime, and the server must always find a request.
    pub(crate) fn threads_on(&self, cores: NonZeroUsize) -> NonZeroUsize {
        /// Threads per core while a server computes the actions.
        const PER_CORE: usize = 4;
        let waits = self.policy.as_ref().and_then(PolicySource::profile).is_some_and(|p| !p.dialect.is_file());
        // Each worker of a launched environment is a process of its own.
        let launched = matches!(&self.environment, EnvironmentSource::Remote(RemoteSource { launched: Some(_), .. }));
        match waits && !launched {
            true => NonZeroUsize::new((PER_CORE * cores.get()).clamp(8, 32)).unwrap_or(cores),
            false => cores,
        }
    }

    /// Starts servers for this many workers, if this process starts them.
    pub(crate) fn start_servers(&self, workers: NonZeroUsize) -> Result<(), Exit> {
        match &self.environment {
            EnvironmentSource::Remote(RemoteSource { pool, launched: Some((_, servers)), .. }) => {
                servers.grow(pool, workers)
            }
            _ => Ok(()),
        }
    }

    /// Finds a parameter space by its name or file. `None` gives that of the environment.
    pub(crate) fn space(&self, wanted: Option<&str>) -> anyhow::Result<ParameterSpace> {
        let latency_s = self.execution.as_ref().is_some_and(|execution| execution.latency == Latency::Parameter);
        self.environment.space(wanted, latency_s)
    }

    /// Rejects a suite with a parameter that the environment does not have.
    pub(crate) fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        let varies = suite.space().position(LATENCY_PARAMETER).is_some();
        match &self.environment {
            // The cell does not know the latency.
            EnvironmentSource::Cell(cell) if varies && self.task.parameter(LATENCY_PARAMETER).is_some() => {
                without_latency(suite.space())?.map_or(Ok(()), |space| cell.check_space(&space))
            }
            EnvironmentSource::Cell(cell) => cell.check_suite(suite),
            EnvironmentSource::Arm(_) | EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => {
                check_declared(&self.task, suite.space()).with_context(|| format!("suite {}", suite.name()))
            }
        }
    }

    /// The provenance: what the results of a run depend on, in addition to its plan.
    pub(crate) fn provenance(&self, space: ParameterSpace) -> Result<Provenance, Exit> {
        let (engine, robot) = self.environment.provenance().or_broken()?;
        let mut world = serde_json::to_value(self.environment.recorded()).or_broken()?;
        if let (Value::Object(world), Some(policy)) = (&mut world, &self.policy) {
            world.insert("policy".to_owned(), json!(policy));
        }
        if let (Value::Object(world), Some(execution)) = (&mut world, &self.execution) {
            world.insert("execution".to_owned(), json!(execution));
        }
        if let (Value::Object(world), Some(controls)) = (&mut world, &self.controls) {
            world.insert(Controls::KEY.to_owned(), controls.clone());
        }
        Ok(Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: Some(provenance::Build { source_sha256: env!("ROBOGATE_SOURCE_SHA256").to_owned() }),
            engine,
            task: Arc::clone(&self.task),
            robot,
            policy: self.policy_name().to_owned(),
            world,
            space,
            plan: Value::Null,
            seed: 0,
            question_sha256: None,
            platform: Some(Platform::here()),
            source: None,
        })
    }

    fn policy(&self) -> Result<Box<dyn Policy>, Fault> {
        let broken = |why: anyhow::Error| Fault::new(FaultKind::Unavailable, format!("{why:#}"));
        match &self.policy {
            Some(source) => source.policy(),
            None => self.environment.controller().map_err(broken),
        }
    }
}

/// Rejects a space with a parameter that the task does not declare, or with values that it does not accept.
pub(crate) fn check_declared(task: &TaskSpec, space: &ParameterSpace) -> anyhow::Result<()> {
    for parameter in space.parameters() {
        let Some(spec) = task.parameter(&parameter.name) else {
            let known: Vec<&str> = task.parameters.iter().map(|spec| &*spec.name).collect();
            bail!(
                "the task {} has no parameter `{}`. Expected one of: {}",
                task.name,
                parameter.name,
                known.join(", ")
            );
        };
        parameter.domain.extremes().iter().try_for_each(|value| spec.accepts(value)).map_err(|why| anyhow!(why))?;
    }
    Ok(())
}

impl EnvironmentSource {
    /// The declarations of all built-in tasks except that of the built-in cell.
    pub(crate) fn declared_tasks() -> Result<Vec<Arc<TaskSpec>>, Exit> {
        let arms = registry::ARM_TASKS.iter().map(|task| {
            let settings = ArmSettings {
                task: task.name().to_owned(),
                robot: franka(),
                engine: ENGINES[0].name.to_owned(),
                time_step_s: ENGINES[0].time_step_s,
                grip_force_n: None,
                suction: None,
            };
            ArmCell::new(settings, SuctionLaw::Vacuum).map(|cell| Self::Arm(Box::new(cell)))
        });
        let others = registry::TASKS.iter().map(|task| Ok(Self::SelfContained(*task)));
        arms.chain(others).map(|source| source.and_then(|source| source.task())).collect::<Result<_, _>>().or_setup()
    }

    /// The same environment with the failure modes and the workspace of the paper, if it is the built-in cell.
    pub(crate) fn like_the_paper(mut self) -> Self {
        if let Self::Cell(cell) = &mut self {
            cell.set_like_the_paper();
        }
        self
    }

    /// An environment whose servers this process starts.
    fn launched(name: &str, simulators: &Simulators) -> Result<Self, Exit> {
        let (pool, servers) = simulators.launch(name)?;
        Ok(Self::Remote(RemoteSource { pool, robot: franka(), launched: Some((name.to_owned(), servers)) }))
    }

    /// The policies that the environment declares.
    fn policies(&self) -> &[HostedPolicy] {
        match self {
            Self::Remote(source) => &source.pool.hello().policies,
            Self::Cell(_) | Self::Arm(_) | Self::SelfContained(_) => &[],
        }
    }

    /// The policy that the user chose, with the version that the environment declares. Without a choice, the first
    /// policy that the environment declares, if there is one.
    fn declared_policy(&self, chosen: Option<PolicySource>) -> anyhow::Result<Option<PolicySource>> {
        let found = match &chosen {
            None => self.policies().first(),
            Some(PolicySource::Declared(wanted)) => {
                let found = self.policies().iter().find(|policy| policy.name == wanted.environment);
                if found.is_none() {
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
        let declared = |policy: &HostedPolicy| {
            PolicySource::Declared(DeclaredPolicy { environment: policy.name.clone(), version: policy.version.clone() })
        };
        Ok(found.map(declared).or(chosen))
    }

    /// The task.
    pub(crate) fn task(&self) -> anyhow::Result<Arc<TaskSpec>> {
        Ok(match self {
            Self::Cell(cell) => Arc::clone(cell.environment()?.task()),
            Self::Arm(cell) => Arc::clone(cell.environment()?.task()),
            Self::SelfContained(task) => task.task(),
            Self::Remote(source) => Arc::new(source.pool.hello().task.clone()),
        })
    }

    /// Creates an environment.
    pub(crate) fn environment(&self) -> anyhow::Result<Box<dyn Environment>> {
        Ok(match self {
            Self::Cell(cell) => cell.environment()?,
            Self::Arm(cell) => cell.environment()?,
            Self::SelfContained(task) => task.environment()?,
            Self::Remote(source) => Box::new(RemoteEnvironment::new(Arc::clone(&source.pool))?),
        })
    }

    /// Creates an environment for a policy with this profile. A remote one renders only the cameras that the policy uses.
    pub(crate) fn environment_for(
        &self,
        profile: &Profile,
        map: Option<&TaskMap>,
    ) -> anyhow::Result<Box<dyn Environment>> {
        let Self::Remote(source) = self else { return self.environment() };
        let none = TaskMap::default();
        let bound = BoundMap::new(map.unwrap_or(&none), profile, &source.pool.hello().task);
        let cameras = bound.map_err(|why| anyhow!("the map does not fit: {why}"))?.cameras();
        Ok(Box::new(RemoteEnvironment::new(Arc::clone(&source.pool))?.with_cameras(cameras)))
    }

    /// The same environment with camera images of this width and height in pixels, if this process renders them.
    pub(crate) fn with_pictures_of(self, picture_px: usize) -> Self {
        match self {
            Self::Cell(cell) => Self::Cell(Box::new(cell.with_pictures_of(picture_px))),
            Self::Arm(cell) => Self::Arm(Box::new(cell.with_pictures_of(picture_px))),
            other => other,
        }
    }

    /// An environment and an expert that drives it with the commands of this arm mode. `None` without an expert.
    pub(crate) fn expert(&self, arm: Arm) -> anyhow::Result<Option<Worker>> {
        Ok(match self {
            Self::Cell(cell) => {
                let policy: Box<dyn Policy> = match arm {
                    Arm::ToolDelta | Arm::OscPose | Arm::ToolPose => Box::new(ToolExpert::new(cell.robot().clone())),
                    Arm::JointPositions | Arm::JointDeltas => cell.controller()?,
                    Arm::Vector => return Ok(None),
                };
                Some(Worker { environment: cell.environment()?, policy })
            }
            Self::Arm(cell) => match arm {
                Arm::JointPositions | Arm::JointDeltas => {
                    Some(Worker { environment: cell.environment()?, policy: cell.controller()? })
                }
                Arm::ToolDelta | Arm::OscPose | Arm::ToolPose | Arm::Vector => None,
            },
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
    pub(crate) fn hello(&self) -> anyhow::Result<Hello> {
        match self {
            Self::Cell(cell) => cell.hello(),
            Self::Arm(cell) => cell.hello(),
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
                bail!("`robogate serve` serves built-in environments only\n  hint: leave out --env and --simulator")
            }
        }
    }

    /// Finds a parameter space by its name or file. `None` gives that of the environment. If the latency `varies`, the space
    /// may contain it.
    pub(crate) fn space(&self, wanted: Option<&str>, varies: bool) -> anyhow::Result<ParameterSpace> {
        let space = match (wanted, self) {
            (Some(wanted), _) => named_space(wanted)?,
            (None, Self::Cell(cell)) => named_space(cell.default_space())?,
            (None, Self::Arm(cell)) => cell.space()?,
            (None, Self::SelfContained(task)) => ParameterSpace::from_toml(task.space())?,
            (None, Self::Remote(source)) => {
                let hello = source.pool.hello();
                match &hello.space {
                    Some(space) => space.clone(),
                    None => hello.task.declared_space().with_context(|| {
                        format!(
                            "the task {} declares no parameter with a range\n  hint: name a space with --space",
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
            (Self::Arm(_) | Self::SelfContained(_) | Self::Remote(_), Some(own)) => {
                check_declared(&*self.task()?, &own).with_context(|| format!("space {}", space.name()))?;
            }
        }
        Ok(space)
    }

    /// The scripted controller, if the environment has one.
    fn controller(&self) -> anyhow::Result<Box<dyn Policy>> {
        match self {
            Self::Cell(cell) => cell.controller(),
            Self::Arm(cell) => cell.controller(),
            Self::SelfContained(task) => Ok(task.controller()),
            // A remote environment may be a built-in cell. Its scripted controller runs in this process.
            Self::Remote(source) if source.pool.hello().task.name == CELL_TASK => {
                let settings = CellSettings {
                    robot: absolute(&source.robot),
                    engine: ENGINES[0].name.to_owned(),
                    time_step_s: ENGINES[0].time_step_s,
                    grip_force_n: None,
                    suction: None,
                    renderer: None,
                    rules: Rules::default(),
                    simulator: None,
                };
                let cell = Cell::new(settings, SuctionLaw::Vacuum, None)?;
                let hello = source.pool.hello();
                remote::check_robot(hello, cell.robot(), &cell.robot_sha256()?)?;
                cell.controller()
            }
            Self::Remote(source) if registry::arm_task(source.pool.hello().task.name.as_str()).is_some() => {
                let hello = source.pool.hello();
                let settings = ArmSettings {
                    task: hello.task.name.as_str().to_owned(),
                    robot: absolute(&source.robot),
                    engine: ENGINES[0].name.to_owned(),
                    time_step_s: ENGINES[0].time_step_s,
                    grip_force_n: None,
                    suction: None,
                };
                let cell = ArmCell::new(settings, SuctionLaw::Vacuum)?;
                remote::check_robot(hello, cell.robot(), &cell.robot_sha256()?)?;
                cell.controller()
            }
            Self::Remote(source) => bail!(
                "the task {} has no scripted controller here\n  hint: name a policy with --policy",
                source.pool.hello().task.name
            ),
        }
    }

    fn recorded(&self) -> Recorded {
        match self {
            Self::Cell(cell) => Recorded::Cell(cell.settings().clone()),
            Self::Arm(cell) => Recorded::Arm(cell.settings().clone()),
            Self::SelfContained(task) => Recorded::SelfContained(RecordedTask { task: task.name().to_owned() }),
            Self::Remote(RemoteSource { launched: Some((name, _)), .. }) => {
                Recorded::Launched(RecordedEnvironment { environment: name.clone() })
            }
            Self::Remote(source) => {
                Recorded::Remote(RecordedServers { simulator: ScoresItself::ScoresItself, robot: source.robot.clone() })
            }
        }
    }

    fn provenance(&self) -> anyhow::Result<(provenance::Engine, provenance::Robot)> {
        let robot = |name: String, sha256| provenance::Robot { name, sha256, dimensions: None };
        Ok(match self {
            Self::Cell(cell) => cell.provenance()?,
            Self::Arm(cell) => cell.provenance()?,
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

/// Finds a parameter space by its name or file.
pub(crate) fn named_space(wanted: &str) -> anyhow::Result<ParameterSpace> {
    let own = registry::TASKS.iter().find(|task| task.name() == wanted).map(|task| task.space());
    // A task for an arm has the same parameters on every robot; its space is that of the default robot.
    let arm =
        registry::arm_task(wanted).map(|task| cell::robot(&franka()).map(|robot| task.space(&robot.settings.gripper)));
    match built_in_space(wanted).or(own).or(arm.transpose()?) {
        Some(text) => ParameterSpace::from_toml(text).with_context(|| wanted.to_owned()),
        None if !Path::new(wanted).exists() && !wanted.contains(['/', '.']) => {
            let known = built_in_spaces().collect::<Vec<_>>().join(", ");
            bail!("--space {wanted}: unknown parameter space. Expected a file, or one of: {known}")
        }
        None => read_text(Path::new(wanted))
            .with_context(|| format!("cannot read {wanted}"))
            .and_then(|text| ParameterSpace::from_toml(&text).with_context(|| wanted.to_owned())),
    }
}

/// Parses parameters given as NAME=VALUE.
pub(crate) fn assignment(pairs: &[String]) -> anyhow::Result<Assignment> {
    let mut assignment = Assignment::default();
    for pair in pairs {
        let Some((name, value)) = pair.split_once('=') else {
            bail!("--set {}: expected NAME=VALUE", foreign(pair));
        };
        let value = match (value.parse::<i64>(), value.parse::<f64>()) {
            (Ok(integer), _) => robogate_core::Value::Integer(integer),
            (_, Ok(number)) => robogate_core::Value::Number(number),
            _ => robogate_core::Value::Category(value.into()),
        };
        assignment.set(name, value);
    }
    Ok(assignment)
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
        Recorded::Arm(settings) => settings.robot,
        Recorded::SelfContained(_) | Recorded::Launched(_) | Recorded::Remote(_) => return None,
    };
    cell::robot_files(&robot, provenance.robot.sha256.as_ref())
}

impl WorkerFactory for Subject {
    fn worker(&self) -> Result<Worker, Fault> {
        if let (EnvironmentSource::Remote(source), Some(PolicySource::Declared(declared))) =
            (&self.environment, &self.policy)
        {
            let (environment, policy) = RemoteEnvironment::with_policy(Arc::clone(&source.pool), &declared.environment)
                .map_err(|why| Fault::new(FaultKind::Setup, why.to_string()))?;
            return Ok(Worker { environment: Box::new(environment), policy: Box::new(policy) });
        }
        let source = self.policy.as_ref();
        let environment = match source.and_then(PolicySource::profile) {
            Some(profile) => {
                self.environment.environment_for(profile, source.and_then(|source| source.map().map(|map| &**map)))
            }
            None => self.environment.environment(),
        };
        let environment = environment.map_err(|why| Fault::new(FaultKind::Unavailable, format!("{why:#}")))?;
        let policy = self.policy()?;
        Ok(match &self.execution {
            None => Worker { environment, policy },
            Some(execution) => {
                let (environment, policy) = with_latency(environment, policy, execution.clone());
                Worker { environment, policy }
            }
        })
    }
}
