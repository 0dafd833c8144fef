//! The subject of a run: an environment and the policy in it.

mod built_in;
mod environment;
mod recorded;
#[cfg(feature = "mujoco")]
mod scene;
mod spaces;
mod warned;

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
#[cfg(feature = "mujoco")]
use robogate_campaign::{BatchWorker, single_workers};
use robogate_campaign::{EpisodeObserver, Worker, WorkerFactory};
#[cfg(feature = "mujoco")]
use robogate_core::SinglePolicies;
use robogate_core::latency::{Execution, LATENCY_PARAMETER, Latency, with_declarations, with_latency};
use robogate_core::stress::{Stress, with_stress};
use robogate_core::{
    Environment, Fault, FaultKind, Foresight, InfeasibleShare, ParameterSpace, Policy, SpaceFeasibility, Suite,
    TaskSpec,
};
use robogate_dictionary::{
    CellPlace, ComparedServers, Controls, Place, Platform, Provenance, SCHEMA_VERSION, Tool, World, check_columns,
    provenance,
};
use robogate_policy::{RangeCounts, RangeMeasures, Recorder, with_range_measures};
use robogate_remote::RemoteEnvironment;
use serde_json::Value;

use crate::cell::{Cell, nominal};
use crate::checkpoint_statistics::CheckpointStatistics;
use crate::environment_choice::EnvironmentChoice;
use crate::failure::{Failure, OrFailure};
use crate::first_episodes::FirstEpisodes;
use crate::latency::LatencyChoice;
use crate::notice::{note, warning};
use crate::origin;
use crate::policy_source::{PolicyChoice, PolicyLocation, PolicySource};
use crate::registry::CELL_TASK;
#[cfg(feature = "mujoco")]
use crate::registry::ManyWorlds;
use crate::signals::{self, SIGNALS, SignalLog};
use crate::stress::is_stress;
use crate::warner::SimulatedWarner;
use robogate_stats::format::percent;

pub use built_in::BuiltIn;
pub(crate) use built_in::hello_of;
pub use environment::EnvironmentSource;
pub(crate) use environment::RemoteSource;
pub use recorded::{programs, recorded_robot, starts_processes};
#[cfg(feature = "mujoco")]
pub use scene::WrittenScene;
pub(crate) use spaces::assignment;
pub use spaces::{check_declared, named_space, named_suite};
pub(crate) use spaces::{remaining, without};

/// The subject of a run: a policy in an environment.
pub struct Subject {
    environment: EnvironmentSource,
    /// `None` for the environment's scripted controller.
    policy: Option<PolicySource>,
    task: Arc<TaskSpec>,
    /// The latency of the policy. `None` if the world waits for it.
    execution: Option<Execution>,
    /// What else varies between environment and policy.
    stress: Option<Stress>,
    /// The warner beside the policy.
    warner: Option<SimulatedWarner>,
    /// The controls of the gate, as its runs record them.
    controls: Option<Controls>,
    /// The folder of the robot as the run records it, if the user named another one with the same files.
    recorded_robot: Option<String>,
    /// Requests of the episodes, for a fingerprint of the policy.
    recorder: Recorder,
    /// The first episodes of a gate. `None` if they do not run again.
    first_episodes: Option<FirstEpisodes>,
    /// Whether runs record the signals of their episodes.
    records_signals: bool,
    signals: SignalLog,
    /// How many episodes are in progress by default, once it was measured.
    pub(crate) in_flight: OnceLock<Option<NonZeroUsize>>,
}

impl Subject {
    /// Combines this policy, or the environment's scripted controller, with this environment. Returns an error if the
    /// policy cannot drive the task.
    pub fn new(environment: EnvironmentSource, policy: Option<PolicySource>) -> Result<Self, Failure> {
        let rendered_px = policy.as_ref().and_then(|policy| policy.profile()?.rendered_px);
        let environment = rendered_px.into_iter().fold(environment, EnvironmentSource::with_pictures_of);
        let task = environment.task().or_broken()?;
        check_columns(&task).or_request()?;
        let policy = environment.declared_policy(policy).or_request()?;
        let task = match policy.as_ref().and_then(PolicySource::profile) {
            Some(profile) => with_range_measures(&task, profile),
            None => task,
        };
        let mut subject = Self {
            environment,
            policy,
            task,
            execution: None,
            stress: None,
            warner: None,
            controls: None,
            recorded_robot: None,
            recorder: Recorder::default(),
            first_episodes: None,
            records_signals: false,
            signals: SignalLog::default(),
            in_flight: OnceLock::new(),
        };
        let ready = match &subject.policy {
            // The environment declares it for its own task.
            Some(PolicySource::Declared(_)) => return Ok(subject),
            Some(source) => source.policy(None, None).map_err(anyhow::Error::from).or_broken()?,
            None => subject.environment.controller().or_request()?,
        };
        ready
            .check(&subject.task)
            .map_err(|why| {
                anyhow!("the policy {} cannot drive this environment: {why}{}", subject.policy_name(), subject.hint())
            })
            .or_request()?;
        subject.missing_instruction().into_iter().for_each(warning);
        // A server may have room for one client.
        drop(ready);
        subject.check_first_requests()?;
        Ok(subject)
    }

    /// A sentence about a model that understands language and is told the name of the task, because the environment has no
    /// instruction.
    pub(crate) fn missing_instruction(&self) -> Option<String> {
        let profile = self.policy.as_ref().and_then(PolicySource::profile);
        let told = self.task.instruction.trim();
        let listens = profile.is_some_and(|profile| profile.dialect.uses_language() && profile.instruction.is_none());
        (listens && (told.is_empty() || told == self.task.name.as_str())).then(|| {
            format!(
                "the environment has no instruction, so the policy is told `{told}`. Set `instruction` in a copy of the profile, or \
                 in the Task of the environment"
            )
        })
    }

    /// The subject of these choices.
    ///
    /// # Errors
    /// A request that does not fit, or an environment or policy that does not start.
    pub fn of(environment: &EnvironmentChoice, policy: &PolicyChoice) -> Result<Self, Failure> {
        let location = PolicyLocation::default();
        Self::new(environment.clone().with_policy(policy)?.environment()?, policy.source_at(&location)?)?
            .with_statistics(&policy.statistics)
    }

    /// A suite of `scenarios` scenarios that are sampled with `seed` from the environment's own space.
    ///
    /// # Errors
    /// An environment without a space.
    pub fn sampled_suite(&self, scenarios: usize, seed: u64) -> Result<Suite, Failure> {
        let space = self.space(None).or_request()?;
        Suite::sampled(&Arc::new(space), scenarios, seed).map_err(anyhow::Error::from).or_request()
    }

    /// The hint for a policy that does not fit an environment in another process.
    fn hint(&self) -> &'static str {
        match (&self.environment, &self.policy) {
            (EnvironmentSource::Remote(_), Some(source)) if source.profile().is_some() => {
                "\nHint: --map FILE maps the environment to the profile; `robogate policy check` with the same options shows both \
                 sides"
            }
            _ => "",
        }
    }

    /// The same subject with the ranges of its checkpoint, so that states outside of them are counted.
    pub fn with_statistics(mut self, statistics: &CheckpointStatistics) -> Result<Self, Failure> {
        if !statistics.is_given() {
            return Ok(self);
        }
        let Some(PolicySource::External(source)) = &mut self.policy else {
            return Err(anyhow!("--statistics applies to a policy server or an ONNX file\nHint: leave it out"))
                .or_request();
        };
        let mut environment =
            self.environment.environment_for(source.profile(), source.map().map(|map| &**map)).or_broken()?;
        let start = environment.reset(&nominal()).map_err(anyhow::Error::from).or_broken()?;
        source.add_ranges(statistics, environment.task(), &start.observation)?;
        self.task = with_range_measures(&self.task, source.profile());
        Ok(self)
    }

    /// The same subject with the latency of these arguments. A latency that is to be measured is measured now.
    pub fn with_latency(self, arguments: &LatencyChoice) -> Result<Self, Failure> {
        let execution = arguments.execution(|| self.worker()).or_request()?;
        self.executed(execution)?.stressed(arguments.stress.stress().or_request()?)
    }

    fn stressed(mut self, stress: Option<Stress>) -> Result<Self, Failure> {
        if let (Some(_), Some(PolicySource::Declared(policy))) = (&stress, &self.policy) {
            return Err(anyhow!(
                "--stress: the environment runs the policy {} itself, so nothing can be changed between the two\nHint: vary the \
                 parameters image_noise, image_blur_px, ... of the environment in a space (`robogate env inspect`), or serve the policy",
                policy.environment
            ))
            .or_request();
        }
        let profile = self.policy.as_ref().and_then(PolicySource::profile);
        let words = stress.iter().flat_map(Stress::of_language).next();
        if let (Some(name), Some(_)) = (words, profile.and_then(|profile| profile.instruction.as_ref())) {
            return Err(anyhow!(
                "--stress: `{name}` has no effect, because the profile has its own `instruction`\nHint: remove it from a copy of the \
                 profile, or choose --stress images,state,actions"
            ))
            .or_request();
        }
        if let (Some(stress), Some(profile)) = (&stress, profile) {
            let unseen: Vec<&str> = if profile.cameras.is_empty() { stress.of_images().collect() } else { Vec::new() };
            if !unseen.is_empty() && unseen.len() == stress.parameters.len() {
                return Err(anyhow!(
                    "--stress: the profile {} has no camera, so images that are changed do not reach the policy\nHint: choose --stress \
                     state,actions",
                    profile.name
                ))
                .or_request();
            }
            if !unseen.is_empty() {
                note(format_args!("without effect, because the profile has no camera: {}", unseen.join(", ")));
            }
        }
        if let Some(stress) = &stress {
            self.task = stress.declared_in(&self.task);
        }
        self.stress = stress;
        Ok(self)
    }

    /// Notes that this user starts a run of this subject in `folder`.
    pub fn register(&self, folder: &Path, provenance: &Provenance) {
        let python = match &self.environment {
            EnvironmentSource::Remote(RemoteSource { launched: Some(launched), .. }) => launched.servers.named_python(),
            _ => None,
        };
        origin::register(folder, provenance, python);
    }

    /// Copies the files of the environment and the policy into the folder of a run, so that later edits do not end its replays.
    pub fn keep_files(&self, run: &Path) {
        if let EnvironmentSource::Remote(RemoteSource { launched: Some(launched), .. }) = &self.environment {
            launched.servers.imported().keep(run);
        }
        if let Some(policy) = &self.policy {
            policy.keep(run);
        }
    }

    /// The same subject, whose runs record the signals of their episodes.
    #[must_use]
    pub fn recording_signals(self) -> Self {
        Self { records_signals: true, ..self }
    }

    /// The documents that a run of this subject has beside its plan: names and contents.
    ///
    /// # Errors
    /// None that is known.
    pub fn documents(&self) -> Result<Vec<(&'static str, Vec<u8>)>, Failure> {
        if self.records_signals { Ok(vec![(SIGNALS, signals::empty(&self.task)?)]) } else { Ok(Vec::new()) }
    }

    /// Makes recorded signals safe on disk.
    pub(crate) fn sync_signals(&self) {
        self.signals.sync();
    }

    /// Begins to record signals in the folder of a run, if they are wanted or if it has some already.
    pub(crate) fn begin_signals(&self, run: &Path, wanted: bool) -> Result<(), Failure> {
        if wanted || self.records_signals || run.join(SIGNALS).is_file() {
            signals::begin(&self.signals, run, &self.task)?;
        }
        Ok(())
    }

    /// Ends the recording of signals.
    pub(crate) fn end_signals(&self, run: &Path) -> Result<(), Failure> {
        signals::end(&self.signals, run)
    }

    fn executed(mut self, execution: Option<Execution>) -> Result<Self, Failure> {
        if let (Some(_), Some(PolicySource::Declared(policy))) = (&execution, &self.policy) {
            return Err(anyhow!(
                "--latency: the environment runs the policy {} itself, so its actions cannot be delayed\nHint: leave out \
                 --latency and --execution",
                policy.environment
            ))
            .or_request();
        }
        if let Some(execution) = &execution {
            self.task = with_declarations(&self.task, &execution.latency);
        }
        self.execution = execution;
        Ok(self)
    }

    /// The same subject with another policy.
    pub(crate) fn with_policy(self, policy: Option<PolicySource>) -> Result<Self, Failure> {
        let Self { environment, execution, stress, warner, controls, recorded_robot, .. } = self;
        let warner = warner.map(|warner| warner.record().clone());
        let subject = Self::new(environment, policy)?.executed(execution)?.stressed(stress)?.warned(warner)?;
        Ok(Self { controls, recorded_robot, ..subject })
    }

    /// Whether this process starts the processes of its environment.
    pub(crate) fn is_launched(&self) -> bool {
        matches!(&self.environment, EnvironmentSource::Remote(RemoteSource { launched: Some(_), .. }))
    }

    /// The same subject with the controls of its gate.
    pub fn with_controls(self, controls: &Controls) -> Self {
        let first_episodes = controls.repeats.map(|_| FirstEpisodes::default());
        Self { controls: Some(controls.clone()), first_episodes, ..self }
    }

    /// The environment.
    pub fn environment_source(&self) -> &EnvironmentSource {
        &self.environment
    }

    /// The same subject with camera images of this width and height in pixels, if the cell renders them.
    pub fn with_pictures_of(mut self, picture_px: usize) -> Self {
        self.environment = self.environment.with_pictures_of(picture_px);
        self
    }

    /// The task.
    pub fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    /// What the task knows about episodes before they run. `None` if it knows nothing.
    pub fn foresight(&self) -> Result<Option<Arc<dyn Foresight>>, Failure> {
        // Parameter and draws of a latency belong to an adapter, which needs a policy. So do those of stress.
        if self.execution.is_some() || self.stress.is_some() {
            return Ok(self.worker().or_broken()?.environment.foresight());
        }
        Ok(self.environment.environment().or_broken()?.foresight())
    }

    /// The name of the environment's own suite, if it has one.
    pub fn own_suite(&self) -> Option<&'static str> {
        self.cell()?.task().suite()
    }

    /// The name of the parameter space of the paper, if the environment is a task of the paper.
    pub fn published_space(&self) -> Option<&'static str> {
        self.cell()?.published_space()
    }

    /// The distribution of the units of the robot, if it is known.
    pub fn own_unit_space(&self) -> Option<&'static str> {
        Some(self.cell()?.unit_space())
    }

    /// The engine, if its campaigns run in many worlds at once.
    pub fn many_worlds_engine(&self) -> Option<&str> {
        let cell = self.cell()?;
        cell.many_worlds().map(|_| &*cell.settings().engine)
    }

    /// The hash of the robot's files. `None` for an environment without a robot of its own.
    ///
    /// # Errors
    /// Files that cannot be read.
    pub fn robot_sha256(&self) -> anyhow::Result<Option<String>> {
        self.cell().map(Cell::robot_sha256).transpose()
    }

    /// The cell, if the environment is a built-in task for an arm.
    fn cell(&self) -> Option<&Cell> {
        match &self.environment {
            EnvironmentSource::BuiltIn(built_in) => built_in.cell(),
            EnvironmentSource::Remote(_) => None,
        }
    }

    /// Prints the share of a space that no policy can complete, by reason.
    ///
    /// # Errors
    /// If that is all of the space, and the arm has too few joints for every pose of its tool.
    pub fn note_feasibility(&self, space: &ParameterSpace) -> Result<(), Failure> {
        /// Joints of an arm whose tool can have any pose.
        const FREE_JOINTS: usize = 6;
        // Servers check nothing before an episode, and an environment that cannot be created is reported by the run.
        if let EnvironmentSource::Remote(_) = self.environment {
            return Ok(());
        }
        let Ok(environment) = self.environment.environment() else { return Ok(()) };
        let Ok(check) = SpaceFeasibility::of(&*environment, space) else { return Ok(()) };
        if let (Some(cell), Some(InfeasibleShare { reason, .. })) = (self.cell(), check.infeasible.first())
            && check.feasible <= 0.0
            && cell.robot().settings.arm.joints.len() < FREE_JOINTS
        {
            return Err(anyhow!(
                "{} with {} joints cannot do {}: {} ({}) in every episode\nHint: choose a larger arm, or a space or suite near the base, such as \
                 --suite tabletop-40 for pick_place",
                cell.robot_name(),
                cell.robot().settings.arm.joints.len(),
                cell.task().name(),
                reason.condition,
                reason.limit
            ))
            .or_request();
        }
        for InfeasibleShare { reason, share } in &check.infeasible {
            note(format_args!(
                "{} of this space is infeasible for every policy: {} ({})",
                percent(*share),
                reason.condition,
                reason.limit
            ));
        }
        Ok(())
    }

    /// A short name for folders: that of the robot, or of the task.
    pub fn label(&self) -> String {
        match self.cell() {
            Some(cell) if cell.task().name() == CELL_TASK => {
                let name = Path::new(&cell.settings().robot).file_name();
                name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
            }
            _ => self.task.name.as_str().to_owned(),
        }
    }

    /// The policy's name in records.
    pub fn policy_name(&self) -> &str {
        self.policy.as_ref().map_or("scripted", PolicySource::name)
    }

    /// Whether the environment repeats an episode with the same actions.
    pub fn is_deterministic(&self) -> bool {
        self.environment.is_deterministic()
    }

    /// The source of the policy, unless it is the environment's own controller.
    pub fn policy_source(&self) -> Option<&PolicySource> {
        self.policy.as_ref()
    }

    /// Sets what this subject records about the comparison of the servers of its policy.
    pub(crate) fn record_compared(&mut self, compared: Option<ComparedServers>) {
        if let Some(PolicySource::External(source)) = &mut self.policy {
            source.compared = compared;
        }
    }

    pub(crate) fn first_episodes(&self) -> Option<&FirstEpisodes> {
        self.first_episodes.as_ref()
    }

    /// The same environment, whose first episodes are kept if they run again.
    fn keeping(&self, environment: Box<dyn Environment>) -> Box<dyn Environment> {
        match &self.first_episodes {
            Some(first) => first.of(environment),
            None => environment,
        }
    }

    pub(crate) fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// How many episodes the policy can drive at once, if that is limited.
    pub fn at_most(&self) -> Option<NonZeroUsize> {
        self.policy.as_ref()?.profile()?.dialect.one_at_a_time().then_some(NonZeroUsize::MIN)
    }

    /// How many servers the environment runs in, if it is remote. As many episodes run at once.
    pub fn servers(&self) -> Option<NonZeroUsize> {
        match &self.environment {
            EnvironmentSource::BuiltIn(built_in) => built_in.cell()?.servers(),
            // This process starts as many as it needs.
            EnvironmentSource::Remote(RemoteSource { launched: Some(_), .. }) => None,
            EnvironmentSource::Remote(source) => NonZeroUsize::new(source.pool.len()),
        }
    }

    /// Whether the workers wait for the answers of policy servers.
    pub(crate) fn waits_for_servers(&self) -> bool {
        self.policy.as_ref().and_then(PolicySource::profile).is_some_and(|profile| !profile.dialect.is_file())
    }

    /// How long the first process of the environment took to start, and its number, if this process started it.
    pub(crate) fn process_of_environment(&self) -> Option<(Duration, u32)> {
        match &self.environment {
            EnvironmentSource::Remote(RemoteSource { launched: Some(launched), .. }) => launched.servers.first(),
            _ => None,
        }
    }

    /// Starts servers for this many workers, if this process starts them.
    pub fn start_servers(&self, workers: NonZeroUsize) -> Result<(), Failure> {
        match &self.environment {
            EnvironmentSource::Remote(RemoteSource { pool, launched: Some(launched), .. }) => {
                launched.servers.grow(pool, workers)
            }
            _ => Ok(()),
        }
    }

    /// Finds a parameter space by its name or file. `None` gives that of the environment.
    pub fn space(&self, wanted: Option<&str>) -> anyhow::Result<ParameterSpace> {
        let latency_s = self.execution.as_ref().is_some_and(|execution| execution.latency == Latency::Parameter);
        let space = self.environment.space(wanted, latency_s, self.stress.is_some())?;
        let own = |parameter: &&robogate_core::Parameter| is_stress(&parameter.name);
        if let Some(other) =
            space.parameters().iter().filter(own).find(|parameter| self.task.parameter(&parameter.name).is_none())
        {
            bail!(
                "space {}: the parameter `{}` is not one of --stress\nHint: add it there, or use --stress all",
                space.name(),
                other.name
            );
        }
        check_declared(&self.task, &space).with_context(|| format!("space {}", space.name()))?;
        Ok(space)
    }

    /// Rejects a suite with a parameter that the environment does not have.
    pub fn check_suite(&self, suite: &Suite) -> anyhow::Result<()> {
        let of_adapter =
            |name: &str| (name == LATENCY_PARAMETER || is_stress(name)) && self.task.parameter(name).is_some();
        match &self.environment {
            // A built-in task does not know latency and stress.
            EnvironmentSource::BuiltIn(built_in)
                if suite.space().parameters().iter().any(|parameter| of_adapter(&parameter.name)) =>
            {
                remaining(suite.space(), of_adapter)?.map_or(Ok(()), |space| built_in.check_space(&space))
            }
            EnvironmentSource::BuiltIn(built_in) => built_in.check_suite(suite),
            EnvironmentSource::Remote(_) => {
                check_declared(&self.task, suite.space()).with_context(|| format!("suite {}", suite.name()))
            }
        }
    }

    /// The provenance: what the results of a run depend on, in addition to its plan.
    pub fn provenance(&self, space: ParameterSpace) -> Result<Provenance, Failure> {
        let (engine, robot) = self.environment.provenance().or_broken()?;
        let mut place = self.environment.place();
        if let (Place::Cell(CellPlace { robot, .. }) | Place::Servers { robot }, Some(recorded)) =
            (&mut place, &self.recorded_robot)
        {
            robot.clone_from(recorded);
        }
        let policy = self.policy.as_ref().map(PolicySource::record).transpose().or_broken()?;
        let (execution, stress, controls) = (self.execution.clone(), self.stress.clone(), self.controls.clone());
        let warner = self.warner.as_ref().map(|warner| warner.record().clone());
        let world = Some(World { policy, execution, stress, warner, controls, ..World::new(place) });
        let runs_network = self.policy.as_ref().is_some_and(PolicySource::is_network);
        let platform = if runs_network { Platform::here().with_networks() } else { Platform::here() };
        Ok(Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: Some(provenance::Build { source_sha256: crate::SOURCE_SHA256.to_owned() }),
            engine,
            task: Arc::clone(&self.task),
            robot,
            policy: self.policy_name().to_owned(),
            world,
            space,
            plan: Value::Null,
            seed: 0,
            question_sha256: None,
            platform: Some(platform),
            source: None,
        })
    }

    /// `ranges` count what the policy sees.
    fn policy(&self, ranges: Option<&RangeCounts>) -> Result<Box<dyn Policy>, Fault> {
        let broken = |why: anyhow::Error| Fault::new(FaultKind::Unavailable, format!("{why:#}"));
        match &self.policy {
            Some(source) => source.policy(ranges, Some(&self.recorder)),
            None => self.environment.controller().map_err(broken),
        }
    }
}

/// Many worlds of one simulator.
#[cfg(feature = "mujoco")]
impl Subject {
    fn many_worlds(&self) -> Option<(&Cell, ManyWorlds)> {
        let cell = self.cell()?;
        Some((cell, cell.many_worlds()?))
    }

    /// How many episodes are in progress by default in each of these threads, if they run in many worlds.
    ///
    /// # Errors
    /// A simulator that does not start, or a policy that cannot drive many worlds.
    pub(crate) fn slots(&self, threads: NonZeroUsize) -> Result<Option<NonZeroUsize>, Failure> {
        let Some((cell, many)) = self.many_worlds() else { return Ok(None) };
        let counted = self.policy.as_ref().and_then(PolicySource::profile).and_then(RangeCounts::of).is_some();
        let lacks = [
            (self.execution.is_some(), "--latency"),
            (self.stress.is_some(), "--stress"),
            (self.warner.is_some(), "--warner"),
            (counted, "a policy with ranges of its checkpoint"),
        ];
        let lacks = lacks.into_iter().find_map(|(has, what)| has.then_some(what));
        if let Some(what) = lacks {
            let engine = &cell.settings().engine;
            return Err(anyhow!("--engine {engine} cannot be used with {what}\nHint: use --engine mujoco"))
                .or_request();
        }
        let worlds = cell.worlds(many).or_broken()?;
        // A robot that they cannot simulate is refused before the first episode.
        let first = cell.batch(many, NonZeroUsize::MIN).or_broken()?.reset(&[(0, &nominal())]);
        first.into_iter().collect::<Result<Vec<_>, Fault>>().map_err(anyhow::Error::from).or_request()?;
        Ok(NonZeroUsize::new(worlds.in_flight(threads.get()).div_ceil(threads.get())))
    }
}

#[cfg(not(feature = "mujoco"))]
impl Subject {
    pub(crate) fn slots(&self, _: NonZeroUsize) -> Result<Option<NonZeroUsize>, Failure> {
        Ok(None)
    }
}

impl WorkerFactory for Subject {
    fn observer(&self) -> Option<Box<dyn EpisodeObserver>> {
        self.signals.observer(&self.task)
    }

    #[cfg(feature = "mujoco")]
    fn batch_worker(&self, slots: NonZeroUsize) -> Result<BatchWorker, Fault> {
        let Some((cell, many)) = self.many_worlds() else { return single_workers(self, slots) };
        let environment = cell.batch(many, slots);
        let environment = environment.map_err(|why| Fault::new(FaultKind::Unavailable, format!("{why:#}")))?;
        let policies = (0..slots.get()).map(|_| self.policy(None)).collect::<Result<_, _>>()?;
        Ok(BatchWorker { environment, policy: Box::new(SinglePolicies::new(policies)) })
    }

    fn worker(&self) -> Result<Worker, Fault> {
        if let (EnvironmentSource::Remote(source), Some(PolicySource::Declared(declared))) =
            (&self.environment, &self.policy)
        {
            let (environment, policy) = RemoteEnvironment::with_policy(Arc::clone(&source.pool), &declared.environment)
                .map_err(|why| Fault::new(FaultKind::Setup, why.to_string()))?;
            return self.beside(self.keeping(Box::new(environment)), Box::new(policy));
        }
        let source = self.policy.as_ref();
        let environment = match source.and_then(PolicySource::profile) {
            Some(profile) => {
                self.environment.environment_for(profile, source.and_then(|source| source.map().map(|map| &**map)))
            }
            None => self.environment.environment(),
        };
        let environment = environment.map_err(|why| Fault::new(FaultKind::Unavailable, format!("{why:#}")))?;
        let environment = self.keeping(environment);
        let profile = source.and_then(PolicySource::profile);
        let ranges = profile.and_then(|profile| Some((profile, RangeCounts::of(profile)?)));
        let policy = self.policy(ranges.as_ref().map(|(_, counts)| counts))?;
        let environment: Box<dyn Environment> = match ranges {
            Some((profile, counts)) => Box::new(RangeMeasures::new(environment, profile, counts)),
            None => environment,
        };
        let (environment, policy) = match &self.execution {
            None => (environment, policy),
            Some(execution) => with_latency(environment, policy, execution.clone()),
        };
        let (environment, policy) = match &self.stress {
            None => (environment, policy),
            Some(stress) => with_stress(environment, policy, stress),
        };
        self.beside(environment, policy)
    }
}
