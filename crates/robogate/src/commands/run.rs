//! `robogate run`: runs a campaign, or one of its shards, and prints the result.

use std::io::{self, IsTerminal};
use std::num::{NonZeroU64, NonZeroUsize};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use clap::Args;
use robogate_analysis::Analysis;
use robogate_campaign::folder::{DICTIONARY, PLAN};
use robogate_campaign::shards::ShardSet;
use robogate_campaign::{ActiveStage, Completion, DEFAULT_SEED, Event, Executor, Plan, Preset, RunError, Settings};
use robogate_core::stress::STRESS_PREFIX;
use robogate_core::{FailureMode, ParameterSpace, TaskSpec};
use robogate_dictionary::{Dictionary, OnWarning, Provenance};
use robogate_gate::{ForceLimits, Sampling};
use robogate_report::Watch;
use robogate_stats::format::counted;

use crate::arguments::{
    EnvironmentArguments, LatencyArguments, LocationArguments, PolicyArguments, TrustArguments, WarnerArguments,
};
use crate::commands::shard;
use crate::exit::{DONE, Exit, INTERRUPTED, INVALID, OrExit};
use crate::force_limits;
use crate::given::Given;
use crate::number::{self, at_least_one};
use crate::place;
use crate::progress::Progress;
use crate::summary;
use crate::terminal::{Screen, grouped, note, percent, warning};
use crate::twins::{self, NominalEpisodes, nominal_plan};
use crate::watch::Frames;
use robogate_session::text::quoted;
use robogate_session::{
    Arms, Outage, PolicySource, Reaction, Reopening, Subject, Watched, Workers, describe, families, guarded,
    named_suite, nominal_rate_of, warner_effect_of, with_plan,
};

/// Find where the policy fails: a campaign over the operating space, then where the outcome is uncertain.
#[derive(Debug, Args)]
pub(crate) struct Run {
    /// First, because reading the other arguments removes them.
    #[command(flatten)]
    given: Given,
    /// Choose the plan: quick (3,000 episodes, active design) or paper (10,000 + 10,000, two stages)
    #[arg(long, value_name = "PRESET", default_value = "quick", value_parser = ["quick", "paper"])]
    preset: String,
    /// Use this plan instead of a preset (TOML; the format is that of assets/presets)
    #[arg(long, value_name = "FILE", conflicts_with = "preset")]
    plan: Option<PathBuf>,
    /// Choose the parameter space: a built-in one (see `robogate list`) or a TOML file; default: the environment's own
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    /// Run this suite instead of both stages: a built-in one or a TOML file
    #[arg(long, value_name = "SUITE", conflicts_with_all = ["preset", "plan", "space", "n"])]
    suite: Option<String>,
    /// Set the number of rounds of the suite; each round has fresh seeds
    #[arg(long, value_name = "N", default_value_t = 1, requires = "suite")]
    rounds: u64,
    /// Set the total number of episodes. A quarter of them is uniform before the first round of the active design; with two
    /// stages, two thirds
    #[arg(short, long, value_name = "N", value_parser = at_least_one::<NonZeroU64>)]
    n: Option<NonZeroU64>,
    /// Choose the design: active (rounds, half of each where a risk model of all earlier episodes is least certain),
    /// two-stage (then a region around the failure boundary) or uniform; default: that of the preset or plan
    #[arg(long, value_name = "DESIGN", value_parser = ["active", "two-stage", "uniform"], conflicts_with = "suite")]
    design: Option<String>,
    /// Estimate the rate of this failure mode: the active design samples where the mode is likely
    #[arg(long, value_name = "MODE", conflicts_with_all = ["suite", "until_rms"])]
    seek: Option<String>,
    /// Stop the active design when the root mean square error of its risk model is at most this (0 to 0.5), with 95 %
    /// confidence
    #[arg(long, value_name = "ERROR", conflicts_with = "suite")]
    until_rms: Option<f64>,
    /// Set the campaign seed
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Also run the nominal twin of each episode of the first stage, of the active design, or of the suite: the same seed with
    /// the task's nominal values. The report then states the effect of the perturbations and what fails without them. If the
    /// task declares families of perturbations, each episode of the first stage also runs with one family only
    #[arg(long)]
    twins: bool,
    /// Vary one family of parameters at a time and run nominal twins, so that the report states the effect of each family:
    /// NAME=PARAMETER,PARAMETER (`*` at the end stands for any ending), `each` for every parameter alone, or `declared` for the
    /// families of the task. Repeat it for each family
    #[arg(long, value_name = "FAMILY", conflicts_with_all = ["suite", "plan", "design", "seek", "until_rms"])]
    family: Vec<String>,
    /// Vary nothing: run the environment as its author made it, 100 episodes by default
    #[arg(long, conflicts_with_all = ["preset", "plan", "space", "suite", "design", "seek", "until_rms", "twins", "family"])]
    nominal: bool,
    #[command(flatten)]
    nominal_episodes: NominalEpisodes,
    /// Report the contacts that exceed these limits of contact forces (TOML, docs/guides/forces.md)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["shard", "divide"])]
    force_limits: Option<PathBuf>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    location: LocationArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    warner: WarnerArguments,
    #[command(flatten)]
    how: How,
    /// Record what the policy sees and does in each control period, for `robogate warn` (docs/guides/warn.md)
    #[arg(long, conflicts_with_all = ["shard", "divide"])]
    record_signals: bool,
    /// Write the run to this folder; default: a new one under runs/
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Run only shard K of N, counted from 0, of the open round of the campaign in --out (docs/guides/cluster.md), or several, one
    /// after the other, such as 0-3,7/16. If that folder has a plan, its options need not be repeated
    #[arg(long, value_name = "K/N", requires = "out")]
    shard: Option<ShardSet>,
    #[command(flatten)]
    trust: TrustArguments,
    /// Write the plan of a campaign in N shards to --out, and run nothing: `robogate plan DIR --next` prints the commands
    /// that run the shards
    #[arg(long, value_name = "N", requires = "out", conflicts_with = "shard")]
    divide: Option<u32>,
}

/// The arguments of `run` that do not affect the results of a campaign. clap reports the arguments of the whole command as
/// well.
const WITHOUT_EFFECT: [&str; 22] = [
    "out",
    "record_signals",
    "force_limits",
    "in_flight",
    "shard",
    "divide",
    "threads",
    "json",
    "goes_on",
    "quiet",
    "sandbox",
    "sandbox_read",
    "sandbox_write",
    "verbose",
    "addresses",
    "timeout_s",
    "python",
    "given",
    "at",
    "wait",
    "policy_key",
    "policy_ca",
];

/// Whether an argument affects the results.
fn describe_a_plan(given: &Given) -> bool {
    given.names().any(|name| !WITHOUT_EFFECT.contains(&name))
}

/// How a campaign is run and shown.
#[derive(Debug, Args)]
pub(crate) struct How {
    /// Set the number of threads; default: one for each core, or for each server of --simulator. With a policy server: one for each
    /// episode in progress. --env starts a server for each thread
    #[arg(long, value_name = "T", value_parser = number::threads)]
    pub(crate) threads: Option<NonZeroUsize>,
    /// Set the number of episodes in progress at once, in all threads together, rounded up to the same number in each thread;
    /// default: one in each thread. With a policy server: as many as keep the cores busy while it computes, from its first requests, at
    /// most 64 and half of the memory. --engine warp: 2048 on a GPU
    #[arg(long, value_name = "N", value_parser = number::in_flight)]
    pub(crate) in_flight: Option<NonZeroUsize>,
    /// Print the result as one JSON document
    #[arg(long)]
    pub(crate) json: bool,
    /// Go on although the first 20 episodes all fail in the same way, or with actions outside of their range. Without it such a run
    /// stops on a terminal; elsewhere it goes on with a warning
    #[arg(long = "continue")]
    pub(crate) goes_on: bool,
}

impl Run {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_required()?;
        if let (Some(shards), Some(dir)) = (&self.shard, &self.out)
            && !describe_a_plan(&self.given)
            && (place::is_remote(dir) || dir.join(PLAN).is_file())
        {
            let Settings { plan, provenance, .. } = if place::is_remote(dir) {
                shard::open(dir)?.shards().settings().clone()
            } else {
                robogate_campaign::settings(dir)?
            };
            let opening =
                Reopening::with(self.trust.choice(), &self.environment.choice().simulators, &self.location.choice());
            let subject = Subject::recorded(&provenance, Some(dir), &opening)?;
            let question_sha256 = provenance.question_sha256;
            let provenance = Provenance { question_sha256, ..subject.provenance(provenance.space)? };
            return shard::run(dir, shards, &subject, &plan, provenance, &self.how);
        }
        // The surface gripper, four failure modes and one workspace for all robots belong to the paper preset. All other
        // runs use the physical vacuum law and every mode.
        let papers = self.is_the_papers();
        let suite = self.suite.as_deref().map(named_suite).transpose()?;
        let environment =
            self.environment.choice().with_policy(&self.policy.choice())?.environment_of(suite.as_ref())?;
        let environment = if papers { environment.like_the_paper().or_broken()? } else { environment };
        let policy = self.policy.choice().source_at(&self.location.choice())?;
        self.location.choice().check_used(policy.as_ref())?;
        let subject = Subject::new(environment, policy)?;
        let subject =
            subject.with_statistics(&self.policy.choice().statistics)?.with_latency(&self.latency.choice())?;
        let subject = subject.with_warner(&self.warner.choice())?;
        let subject = if self.record_signals { subject.recording_signals() } else { subject };
        let (mut plan, space) = self.plan_and_space(&subject)?;
        let subject = if subject.is_deterministic() { subject } else { subject.with_repeats(&space, plan.seed)? };
        let stressed = space.parameters().iter().filter(|parameter| parameter.name.starts_with(STRESS_PREFIX)).count();
        if stressed > 2 && self.family.is_empty() {
            note(format_args!(
                "{stressed} kinds of stress act in each episode; `--family declared` varies one family at a time"
            ));
        }
        plan.twins |= self.twins;
        plan.nominal_episodes = self.nominal_episodes.of(&subject, &plan, &space)?;
        let limits = force_limits::opened(self.force_limits.as_deref(), subject.task())?;
        let provenance = subject.provenance(space)?;
        if let (Some(shards), Some(dir)) = (&self.shard, &self.out) {
            subject.register(dir, &provenance);
            return shard::run(dir, shards, &subject, &plan, provenance, &self.how);
        }
        if let (Some(shards), Some(dir)) = (self.divide, &self.out) {
            subject.register(dir, &provenance);
            return shard::divide(dir, shards, &plan, provenance, &[], self.how.json);
        }
        let dir = match &self.out {
            Some(dir) => {
                place::check_local(dir)?;
                dir.clone()
            }
            None => {
                let plan_name = match &plan.suite {
                    Some(stage) => Some(stage.suite.name().into()),
                    None => self.plan.as_deref().and_then(Path::file_stem).map(|s| s.to_string_lossy()),
                };
                free_folder(&format!(
                    "{}-{}-{}",
                    subject.label(),
                    plan_name.as_deref().unwrap_or(&self.preset),
                    plan.seed
                ))
            }
        };
        introduce(&provenance, plan.seed);
        subject.note_warner(&with_plan(&provenance, &plan)?);
        if plan.suite.is_none() {
            subject.note_feasibility(&provenance.space)?;
        }
        match (&plan.suite, &plan.active) {
            (Some(stage), _) => note(format_args!(
                "{} {}: {} scenarios, {} episodes, into {}",
                stage.suite.name(),
                stage.suite.version(),
                stage.suite.cases().len(),
                grouped(plan.episodes()),
                dir.display()
            )),
            (None, Some(active)) => note(format_args!(
                "{} over the operating space, then up to {} in rounds, {} of them {}, into {}",
                counted(plan.uniform.episodes, "episode"),
                grouped(active.episodes),
                percent(1.0 - active.uniform_share),
                match &active.seek {
                    Some(mode) => format!("where {mode} is likely"),
                    None => "where the risk model is least certain".to_owned(),
                },
                dir.display()
            )),
            (None, None) if plan.boundary.episodes == 0 => note(format_args!(
                "{} over the operating space, into {}",
                counted(plan.uniform.episodes, "episode"),
                dir.display()
            )),
            (None, None) => note(format_args!(
                "{} over the operating space, then {} near the failure boundary, into {}",
                counted(plan.uniform.episodes, "episode"),
                grouped(plan.boundary.episodes),
                dir.display()
            )),
        }
        let arms = Arms::of(&dir, &plan, &provenance.space, &subject)?;
        subject.register(&dir, &provenance);
        let mut documents = subject.documents()?;
        documents.extend(limits.map(|limits| (ForceLimits::FILE, limits.to_toml().into_bytes())));
        let documents: Vec<_> = documents.iter().map(|(name, content)| (*name, content.as_slice())).collect();
        self.how.conduct(&dir, &subject, |executor, events| {
            let completion =
                robogate_campaign::start_in_rounds(&dir, &plan, provenance, &documents, executor, events, &mut |_| {
                    ControlFlow::Continue(())
                })?;
            arms.after(completion, executor, events)
        })
    }

    /// Whether this is a campaign of the paper.
    fn is_the_papers(&self) -> bool {
        self.plan.is_none() && self.suite.is_none() && Preset::by_name(&self.preset) == Some(Preset::Paper)
    }

    /// Rejects arguments that need another one. clap does not require an argument that conflicts with a given one: it would
    /// accept and ignore the rounds in `--rounds 5 -n 100`.
    fn check_required(&self) -> Result<(), Exit> {
        let needs = [("rounds", "--rounds", self.suite.is_some(), "--suite")];
        match needs.into_iter().find(|(name, _, is_given, _)| self.given.has(name) && !is_given) {
            Some((_, option, _, needed)) => {
                Err(anyhow!("{option} needs {needed}\nHint: give {needed}, or leave out {option}")).or_usage()
            }
            None => Ok(()),
        }
    }

    /// The plan and its parameter space.
    fn plan_and_space(&self, subject: &Subject) -> Result<(Plan, ParameterSpace), Exit> {
        if let Some(name) = &self.suite {
            let suite = named_suite(name)?;
            subject.check_suite(&suite).or_usage()?;
            self.latency.choice().check_suite(suite.space()).or_usage()?;
            let space = suite.space().clone();
            let plan = Plan::of_suite(suite, self.rounds, self.seed.unwrap_or(DEFAULT_SEED));
            plan.check(&space).or_usage()?;
            return Ok((plan, space));
        }
        if self.nominal {
            return nominal_plan(subject, self.n, self.seed.unwrap_or(DEFAULT_SEED));
        }
        let papers = if self.is_the_papers() { subject.published_space() } else { None };
        let space = subject
            .space(self.space.as_deref().or(papers))
            .and_then(|space| self.latency.choice().added_to(space, subject.task()))
            .or_usage()?;
        let mut plan = match &self.plan {
            Some(file) => Plan::load(file).or_usage()?,
            None => {
                let preset = Preset::by_name(&self.preset).unwrap_or_default();
                // The presets have ranges for parameters that this space need not have.
                let (plan, _) = preset.plan().or_broken()?.fitted_to(&space);
                plan
            }
        };
        if let Some(n) = self.n {
            plan = plan.with_total(n.get());
        }
        if !self.family.is_empty() {
            let suite = families::suite(&self.family, &space, subject.task(), 1).or_usage()?;
            subject.check_suite(&suite).or_usage()?;
            let rounds = (plan.episodes() / suite.cases().len().max(1) as u64).max(1);
            let space = suite.space().clone();
            let plan = Plan::of_suite(suite, rounds, self.seed.unwrap_or(DEFAULT_SEED));
            plan.check(&space).or_usage()?;
            return Ok((plan, space));
        }
        match self.design.as_deref() {
            Some("active") => plan = plan.with_active(),
            Some("two-stage") => plan = plan.with_two_stages(),
            Some(_) => plan = plan.with_uniform_only(),
            None if self.seek.is_some() => plan = plan.with_active(),
            None => {}
        }
        if let Some(mode) = &self.seek {
            let stage = plan.active.take();
            let stage = stage
                .ok_or_else(|| anyhow!("--seek applies to the active design\nHint: leave out --design"))
                .or_usage()?;
            // A file states its own number of candidates and uniform share.
            let in_file = self.plan.is_some();
            plan.active =
                Some(if in_file { ActiveStage { seek: Some(mode.clone()), ..stage } } else { stage.seeking(mode) });
        }
        if let Some(mode) = plan.active.as_ref().and_then(|stage| stage.seek.as_deref()) {
            check_mode(mode, subject.task()).or_usage()?;
        }
        match (&mut plan.active, self.until_rms) {
            (Some(active), Some(_)) => active.until_rms = self.until_rms,
            (None, Some(_)) => {
                return Err(anyhow!("--until-rms applies to the active design\nHint: add --design active")).or_usage();
            }
            _ => {}
        }
        if let Some(seed) = self.seed {
            plan.seed = seed;
        }
        plan.check(&space).or_usage()?;
        Ok((plan, space))
    }
}

impl How {
    /// Runs `work` on workers that Ctrl-C stops.
    pub(crate) fn with_workers<T>(&self, work: impl FnOnce(Workers<'_>) -> Result<T, Exit>) -> Result<T, Exit> {
        let stop = stop_on_signal()?;
        work(Workers { threads: self.threads, in_flight: self.in_flight, stop: &stop })
    }

    /// Runs a campaign in `dir` with `work` and shows its progress.
    pub(crate) fn carry(
        &self,
        dir: &Path,
        subject: &Subject,
        work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<Completion, RunError>,
    ) -> Result<Completion, Exit> {
        let mut progress = Progress::new();
        let mut stopped = None;
        let completion = self.with_workers(|workers| {
            Ok(workers.carry(dir, subject, &mut |event| progress.hear(event), |executor, events| {
                let Some(reaction) = self.reaction(subject) else { return work(executor, events) };
                let watched = Watched::new(executor, reaction);
                let completion = work(&watched, events);
                stopped = watched.stopped();
                completion
            })?)
        })?;
        match stopped {
            None => Ok(completion),
            Some(why) => Err(anyhow!(
                "stopped: {why}\nHint: the episodes are recorded; `robogate resume {} --continue` goes on",
                quoted(dir)
            ))
            .or_broken(),
        }
    }

    /// What happens to a run that cannot succeed. `None` if the user wants it, or if the policy is the baseline of random actions.
    fn reaction(&self, subject: &Subject) -> Option<Reaction> {
        let random = matches!(subject.policy_source(), Some(PolicySource::BuiltIn(_)));
        let reaction = if io::stderr().is_terminal() { Reaction::Stop } else { Reaction::Warn };
        (!self.goes_on && !random).then_some(reaction)
    }

    /// Runs a campaign with `work`, and shows its progress and summary.
    pub(crate) fn conduct(
        &self,
        dir: &Path,
        subject: &Subject,
        work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<Completion, RunError>,
    ) -> Result<u8, Exit> {
        conclude(dir, &self.carry(dir, subject, work)?, Some(subject), self.json)
    }
}

/// Runs at most `episodes` episodes on `pool` with `work` and shows their progress. Episodes that an unavailable server lost run
/// again. Also returns the outage that has stopped the execution, if there was one.
pub(crate) fn shown<T>(
    pool: &dyn Executor,
    episodes: u64,
    work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<T, RunError>,
) -> Result<(T, Option<Outage>), Exit> {
    let mut progress = Progress::new();
    Ok(guarded(pool, episodes, &mut |event| progress.hear(event), work)?)
}

/// Rejects a sought failure mode that the task does not have. No episode would ever end in it.
fn check_mode(mode: &str, task: &TaskSpec) -> anyhow::Result<()> {
    if !task.modes().any(|declared: FailureMode| declared.as_str() == mode) {
        let modes: Vec<&str> = task.modes().map(FailureMode::as_str).collect();
        anyhow::bail!(
            "seek {mode}: the task {} has no such failure mode. Expected one of: {}",
            task.name,
            modes.join(", ")
        );
    }
    Ok(())
}

/// Writes the report of a finished campaign, and prints its summary.
pub(crate) fn conclude(dir: &Path, completion: &Completion, subject: Option<&Subject>, json: bool) -> Result<u8, Exit> {
    match completion {
        Completion::Finished { summary, boundary } => {
            let twins = twins::of_run(dir, Sampling::Fixed)?;
            let nominal = nominal_rate_of(dir)?;
            let dictionary = Dictionary::open(&dir.join(DICTIONARY)).or_broken()?;
            let warner = warner_effect_of(dir, &dictionary)?;
            if let Some(twins) = &twins {
                twins::write(dir, twins)?;
            }
            let analysis = write_report(dir, None, subject).map(|(analysis, _)| analysis);
            let arms = summary::Arms { twins: twins.as_ref(), nominal: nominal.as_ref(), warner: warner.as_ref() };
            if json {
                summary::json(dir, summary, boundary.as_deref(), arms, analysis.as_ref()).or_broken()?;
            } else {
                summary::print(dir, summary, boundary.as_deref(), analysis.as_ref(), &arms);
                twins.iter().for_each(twins::print);
                force_limits::print(&force_limits::of_run(Some(dir), &dictionary, None)?);
            }
            let evidence = summary.stages.iter().any(|stage| stage.valid > 0);
            Ok(if evidence { DONE } else { INVALID })
        }
        Completion::Interrupted { done, episodes } => Ok(interrupted(dir, *done, *episodes)),
    }
}

/// Handles SIGINT and SIGTERM: the first one sets the returned flag, the second one ends the process.
pub(crate) fn stop_on_signal() -> Result<Arc<AtomicBool>, Exit> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if asked.swap(true, Ordering::Relaxed) {
            stop_at_once();
        }
        note("stopping after the episodes in flight (once more: at once)");
    })
    .or_broken()?;
    Ok(stop)
}

/// Ends the process at once, if the user does not wait for a slow simulator or policy. Recorded episodes are kept,
/// because the journal can be cut at any byte.
#[expect(clippy::exit, reason = "worker threads cannot be interrupted")]
pub(crate) fn stop_at_once() -> ! {
    Screen::close();
    std::process::exit(i32::from(INTERRUPTED))
}

/// Prints the progress of an interrupted campaign and how to resume it.
pub(crate) fn interrupted(dir: &Path, done: u64, episodes: u64) -> u8 {
    note(format_args!("{} of {} episodes are recorded.", grouped(done), grouped(episodes)));
    note(format_args!("next: robogate resume {}", quoted(dir)));
    INTERRUPTED
}

/// Writes the page of a finished campaign, with `frames` also images of its episodes worth watching, and returns its
/// analysis. `subject` is that of the run, if it has just ended. An error is a warning, because the dictionary is complete
/// without the page.
pub(crate) fn write_report(
    dir: &Path,
    frames: Option<&Frames>,
    subject: Option<&Subject>,
) -> Option<(Analysis, Option<Watch>)> {
    match super::report::page(dir, frames, subject) {
        Ok(written) => Some(written),
        Err(exit) => {
            warning(format_args!("no report: {exit}"));
            None
        }
    }
}

/// Prints the subject of the run.
pub(crate) fn introduce(provenance: &Provenance, seed: u64) {
    let (task, robot) = (provenance.task.name, &provenance.robot.name);
    // An environment without a robot of its own is named after its task.
    let robot = if task == *robot.as_str() { String::new() } else { format!(" on {robot}") };
    note(format_args!(
        "RoboGate {}: {}{robot} in {} {}, {} policy, seed {seed}",
        env!("CARGO_PKG_VERSION"),
        provenance.task.name,
        provenance.engine.name,
        provenance.engine.version.as_deref().unwrap_or_default(),
        provenance.policy,
    ));
    let changed = provenance.task.changed_settings();
    if !changed.is_empty() {
        note(format_args!("with {changed}"));
    }
    if let Some(execution) = provenance.execution() {
        note(describe(execution));
    }
    if let Some(stress) = provenance.world.as_ref().and_then(|world| world.stress.as_ref()) {
        let names = stress.parameters.iter().filter_map(|name| name.strip_prefix(STRESS_PREFIX));
        note(format_args!("stress in transit: {}", names.collect::<Vec<_>>().join(", ")));
    }
    if let Some(warner) = provenance.world.as_ref().and_then(|world| world.warner.as_ref()) {
        let what = match warner.on_warning {
            OnWarning::Record => "is recorded".to_owned(),
            OnWarning::Stop => "ends the episode".to_owned(),
            OnWarning::Slow(periods) => format!("slows the robot down: each action takes {periods} control periods"),
            OnWarning::Handover => "hands the episode over to a person".to_owned(),
        };
        note(format_args!("warner {}: a warning {what}", warner.sha256.get(..12).unwrap_or_default()));
    }
}

/// A folder under `runs/` that does not exist yet.
pub(crate) fn free_folder(name: &str) -> PathBuf {
    let runs = Path::new("runs");
    let plain = runs.join(name);
    if !plain.exists() {
        return plain;
    }
    (2_u32..).map(|i| runs.join(format!("{name}-{i}"))).find(|dir| !dir.exists()).unwrap_or(plain)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory;

    use super::*;

    /// The arguments of `run` that affect the results of a campaign.
    const WITH_EFFECT: &[&str] = &[
        "preset",
        "plan",
        "space",
        "suite",
        "rounds",
        "n",
        "design",
        "seek",
        "until_rms",
        "seed",
        "twins",
        "family",
        "nominal",
        "nominal_episodes",
        "task",
        "env",
        "robot",
        "engine",
        "time_step",
        "set",
        "renderer",
        "policy",
        "profile",
        "map",
        "statistics",
        "statistics_group",
        "latency",
        "execution",
        "stress",
        "wordings",
        "warner",
        "on_warning",
    ];

    #[test]
    fn every_argument_is_classified() {
        let command = crate::Arguments::command();
        let run = command.find_subcommand("run").unwrap();
        let known = command.get_arguments().chain(run.get_arguments()).map(|argument| argument.get_id().as_str());
        let known: BTreeSet<&str> = known.collect();
        let classified: BTreeSet<&str> = WITHOUT_EFFECT.iter().chain(WITH_EFFECT).copied().collect();
        assert_eq!(known, classified);
        assert_eq!(classified.len(), WITHOUT_EFFECT.len() + WITH_EFFECT.len(), "an argument is in both lists");
    }
}
