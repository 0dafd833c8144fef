//! `robogate init`: from something of the user's to a project file, a first episode and the next command.

mod ask;
mod drafts;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::Source;
use robogate_campaign::{Completion, DEFAULT_SEED, Plan};
use robogate_core::{Outcome, Seed};
use robogate_gate::evidence::{MANIFEST, Manifest};
use robogate_session::init::{Thing, Wanted, collision_mode, diagnosis, nominal_suite};
use robogate_session::text::quoted;
use robogate_session::{EnvironmentChoice, PolicyChoice, PolicyLocation, Simulators, Subject, duration};
use robogate_stats::format::number;

use crate::commands::run::{How, free_folder, interrupted, write_report};
use crate::exit::{DONE, Exit, FAIL, OrExit, USAGE};
use crate::interface;
use crate::number;
use crate::terminal::{bold, foreign, line, note};
use drafts::Drafts;

/// Start with what you have: draft a project file and what is missing, run one episode, and print the next command.
///
/// Say what you have: an environment (FILE.py, FAMILY:NAME, gymnasium:ID), a policy (FILE.onnx, the folder of a LeRobot checkpoint,
/// sb3:FILE.zip, the address of a server), both, a robot (URDF or MJCF), a results file, a run, or a folder of evidence. The command
/// says what it found, drafts the files that are missing, and writes `robogate.toml`, which the other verbs read. It then runs one
/// episode with nominal values and writes its page. If that episode fails, it says why, as far as its actions show it. Exit code 1
/// then.
///
/// An environment and a policy that you name here run with your rights, as with `robogate run`. Nothing else is started.
#[derive(Debug, Args)]
pub(crate) struct Init {
    /// What you have. Without it: what this folder has
    #[arg(value_name = "THING")]
    things: Vec<String>,
    /// Require this success rate: 90%, or 0.9 [default: 90%]
    #[arg(long, value_name = "SHARE", value_parser = ask::share)]
    success: Option<f64>,
    /// Allow at most this number of collisions in a thousand cycles; default: no requirement
    #[arg(long, value_name = "N", value_parser = number::positive)]
    collisions_per_thousand: Option<f64>,
    /// Require that a successful cycle takes at most this time on average, such as 20s; default: no requirement
    #[arg(long, value_name = "TIME", value_parser = duration::parse)]
    cycle_time: Option<Duration>,
    /// Use this observation and action mapping of the policy (see `robogate list profiles`), and draft none
    #[arg(long, value_name = "NAME|FILE")]
    profile: Option<String>,
    /// Let the robot carry parts of up to this mass, in kg; default: that of the built-in cell
    #[arg(long, value_name = "KG", value_parser = number::positive)]
    payload: Option<f64>,
    /// Start the environment with this Python interpreter; default: that of `robogate env setup`, otherwise the active python3
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Write the files, and run no episode
    #[arg(long)]
    no_episode: bool,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// What the user has, as options.
#[derive(Debug, Default)]
struct Parts {
    env: Option<String>,
    policy: Option<String>,
    network: Option<PathBuf>,
    robot: Option<String>,
}

impl Init {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let things = match &self.things[..] {
            [] => ask::what(Path::new(".")).or_usage()?,
            named => named.to_vec(),
        };
        let mut parts = Parts::default();
        let drafts = Drafts::new(self.force);
        let found = things.iter().map(|thing| Thing::of(thing)).collect::<Result<Vec<_>, _>>().or_usage()?;
        self.refuse_unused(&found)?;
        for thing in found {
            match thing {
                Thing::Evidence(folder) => return evidence(&folder),
                Thing::Run(folder) => return run(&folder),
                Thing::Results(file) => return self.results(&file),
                Thing::Environment(name) => parts.env = Some(name),
                Thing::Policy(name) => parts.policy = Some(name),
                Thing::Network(file) => parts.network = Some(file),
                Thing::Robot(name) if self.payload.is_some() => {
                    let why = anyhow!(
                        "--payload applies to a robot that is drafted now\nHint: set payload_kg in {name}/robot.toml"
                    );
                    return Err(why).or_usage();
                }
                Thing::Robot(name) => parts.robot = Some(name),
                Thing::Model(model) => {
                    drafts.refuse_existing()?;
                    parts.robot = Some(self.robot(&model)?);
                }
            }
        }
        drafts.refuse_existing()?;
        self.project(parts, drafts)
    }

    /// Rejects things of which only one would be used.
    fn refuse_unused(&self, found: &[Thing]) -> Result<(), Exit> {
        let kind = |thing: &Thing| match thing {
            Thing::Evidence(_) | Thing::Run(_) | Thing::Results(_) => "finished results",
            Thing::Environment(_) => "an environment",
            Thing::Policy(_) | Thing::Network(_) => "a policy",
            Thing::Robot(_) | Thing::Model(_) => "a robot",
        };
        let kinds: Vec<&str> = found.iter().map(kind).collect();
        let results = kinds.contains(&"finished results");
        let twice = (1..kinds.len()).find(|at| kinds[..*at].contains(&kinds[*at]));
        match (twice, results && kinds.len() > 1) {
            (Some(at), _) => Err(anyhow!("{} is named twice\nHint: name one", kinds[at])).or_usage(),
            (None, true) => {
                Err(anyhow!("finished results need nothing else\nHint: name them alone, or leave them out")).or_usage()
            }
            (None, false) => Ok(()),
        }
    }

    /// Drafts the robot of a model, and checks it. Returns its folder.
    fn robot(&self, model: &Path) -> Result<String, Exit> {
        let folder = model.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        line(format_args!("found     {}: the model of a robot", foreign(model.display())));
        let mut draft = vec!["robots", "init"];
        let path = model.display().to_string();
        draft.push(&path);
        if self.force {
            draft.push("--force");
        }
        step(&draft)?;
        drafts::set_payload(&folder.join("robot.toml"), self.payload)?;
        Ok(folder.display().to_string())
    }

    /// Imports results, and says how to judge them.
    fn results(&self, file: &Path) -> Result<u8, Exit> {
        line(format_args!("found     {}: results, one row for each episode", foreign(file.display())));
        let out = Path::new(file.file_stem().unwrap_or_default()).with_extension("dictionary.parquet");
        for earlier in dictionaries(&out).into_iter().filter(|_| self.force) {
            let failed = || format!("cannot replace {}", earlier.display());
            std::fs::remove_file(&earlier).with_context(failed).or_broken()?;
        }
        step(&["import", &file.display().to_string(), &out.display().to_string()])?;
        let mut drafts = Drafts::new(self.force);
        let policies = dictionaries(&out);
        let first = policies.first().unwrap_or(&out);
        let source = Source::open(first).or_broken()?;
        drafts.requirements(
            &self.wanted(&source.dictionary().provenance().task)?,
            &source.dictionary().provenance().task,
        )?;
        drafts.write()?;
        next(&format!("robogate gate --run {} --requirements {}", quoted(first), drafts::REQUIREMENTS));
        if policies.len() > 1 {
            let all: Vec<String> = policies.iter().map(|policy| quoted(policy)).collect();
            line(format_args!("and       robogate rank {}   compares the policies", all.join(" ")));
        }
        line(format_args!("and       robogate audit {}   finds rows that make a rate wrong", quoted(file)));
        Ok(DONE)
    }

    /// The three figures, from the options or from questions on a terminal.
    fn wanted(&self, task: &robogate_core::TaskSpec) -> Result<Wanted, Exit> {
        let given = Wanted {
            success: self.success.unwrap_or(ask::SUCCESS),
            collisions: self.collisions_per_thousand,
            cycle_time_s: self.cycle_time.map(|time| time.as_secs_f64()),
        };
        let asks = self.success.is_none() && given.collisions.is_none() && given.cycle_time_s.is_none();
        if asks && ask::can() { ask::wanted(collision_mode(task).is_some()).or_usage() } else { Ok(given) }
    }

    fn project(&self, parts: Parts, mut drafts: Drafts) -> Result<u8, Exit> {
        if let Some(robot) = &parts.robot {
            line(format_args!("found     {}: a robot", foreign(robot)));
            step(&["robots", "check", robot])?;
        }
        let environment = EnvironmentChoice {
            env: parts.env.clone(),
            robot: parts.robot.clone(),
            simulators: Simulators { python: self.python.clone(), ..Simulators::default() },
            ..EnvironmentChoice::default()
        };
        let mut policy = PolicyChoice { policy: parts.policy.clone(), ..PolicyChoice::default() };
        let longer = environment.clone();
        let source = environment.with_policy(&policy)?.environment()?;
        let task = source.task().or_broken()?;
        if let Some(env) = &parts.env {
            line(format_args!("found     {}: the environment {}", foreign(env), foreign(task.name)));
            source.declared().into_iter().for_each(|hello| drafts.space(hello));
        }
        line(format_args!("observes  {}", foreign(interface::observes(&task))));
        line(format_args!("takes     {}", foreign(interface::takes(&task))));
        policy.profile.clone_from(&self.profile);
        if let Some(network) = &parts.network {
            policy.policy = Some(network.display().to_string());
            match &self.profile {
                Some(_) => line(format_args!("found     {}: a network", foreign(network.display()))),
                None => drafts.network(network, &task, &mut policy)?,
            }
        } else if let (Some(server), None) = (parts.policy.as_deref().filter(|url| url.contains("://")), &self.profile)
        {
            policy.profile = Some(ask::profile_of(server).or_usage()?);
        }
        drafts.requirements(&self.wanted(&task)?, &task)?;
        drafts.project(&parts, &policy, self.python.as_deref());
        drafts.ci(parts.env.is_some() || policy.policy.is_some());
        drafts.write()?;
        if self.no_episode {
            next("robogate gate");
            return Ok(DONE);
        }
        let policy = policy.source_at(&PolicyLocation::default())?;
        // Only a built-in task has a setting for its time limit.
        let set = vec![format!("time_limit_s={}", LONGER * task.time_limit_s)];
        let longer = parts.env.is_none().then_some(EnvironmentChoice { set, ..longer });
        episode(&Subject::new(source, policy.clone())?, &|| {
            longer.as_ref().and_then(|longer| Subject::new(longer.environment().ok()?, policy.clone()).ok())
        })
    }
}

/// How much longer an episode may take to test whether its time limit is too short.
const LONGER: f64 = 3.0;

/// Runs one episode with nominal values, writes its page, and prints what follows. `longer` is the subject with more time.
fn episode(subject: &Subject, longer: &dyn Fn() -> Option<Subject>) -> Result<u8, Exit> {
    let space = subject.space(None).or_usage()?;
    let suite = nominal_suite(subject.task(), &space).map_err(anyhow::Error::from).or_usage()?;
    let space = suite.space().clone();
    let scenario = suite.scenario(Seed::campaign(DEFAULT_SEED), 0);
    let plan = Plan::of_suite(suite, 1, DEFAULT_SEED);
    let dir = free_folder("nominal");
    let how = How { threads: NonZeroUsize::new(1), in_flight: None, json: false, goes_on: true };
    let provenance = subject.provenance(space)?;
    subject.register(&dir, &provenance);
    note("one episode with nominal values");
    let completion = how
        .carry(&dir, subject, |executor, events| robogate_campaign::start(&dir, &plan, provenance, executor, events))?;
    if let Completion::Interrupted { done, episodes } = completion {
        return Ok(interrupted(&dir, done, episodes));
    }
    write_report(&dir, None, Some(subject));
    let source = Source::open(&dir).or_broken()?;
    let row = source.dictionary().entries().next().transpose().or_broken()?;
    let episode = row.ok_or_else(|| anyhow!("{}: no episode was recorded", dir.display())).or_broken()?.episode;
    let time = number(episode.time_s);
    let page = dir.join("report.html");
    let ended = match &episode.outcome {
        Outcome::Success => format!("success after {time} s"),
        Outcome::Failure(mode) => format!("{mode} after {time} s"),
        Outcome::Invalid(_) => "no result".to_owned(),
    };
    line(format_args!("episode   {}   {}", bold(ended), quoted(&page)));
    if episode.outcome == Outcome::Success {
        next("robogate gate");
        line(
            "          decides with a few hundred episodes or more whether the policy may run; `robogate run` maps where it fails",
        );
        return Ok(DONE);
    }
    for finding in diagnosis(subject, longer().as_ref(), &scenario).map_err(anyhow::Error::from).or_broken()? {
        line(format_args!("{} {}", bold("diagnosis"), foreign(finding)));
    }
    next(&format!("robogate replay {} 0", quoted(&dir)));
    line("          shows the timeline of the episode; repeat `robogate init ... --force` once the cause is fixed");
    Ok(FAIL)
}

/// Says what a folder of evidence is, and how to verify it.
fn evidence(folder: &Path) -> Result<u8, Exit> {
    let path = folder.join(MANIFEST);
    let text = robogate_dictionary::read_text(&path).with_context(|| format!("cannot read {}", path.display()));
    let manifest: Manifest = robogate_core::budget::Budget::FILE
        .json(text.or_usage()?.as_bytes())
        .map_err(|why| anyhow!("{}: not a manifest of evidence: {why}", path.display()))
        .or_usage()?;
    line(format_args!("found     {}: evidence of a gate", foreign(folder.display())));
    line(format_args!(
        "it says   {}: the policy {} on the robot {}, task {}, {} episodes",
        bold(manifest.verdict.as_str().to_uppercase()),
        foreign(&manifest.policy),
        foreign(&manifest.robot.name),
        foreign(manifest.task.name),
        manifest.counts.episodes
    ));
    line(format_args!("because   {}", foreign(&manifest.because)));
    line("checked   nothing yet: anybody can write these files");
    next(&format!("robogate verify {}", quoted(folder)));
    line(format_args!(
        "and       robogate verify {} --require-signed --key PUBLIC   if you have the public key of its author",
        quoted(folder)
    ));
    Ok(DONE)
}

/// Says what a run is, and how to judge it.
fn run(folder: &Path) -> Result<u8, Exit> {
    let source = Source::open(folder).or_usage()?;
    let provenance = source.dictionary().provenance();
    line(format_args!(
        "found     {}: a run of the policy {} in the task {}",
        foreign(folder.display()),
        foreign(&provenance.policy),
        foreign(provenance.task.name)
    ));
    next(&format!("robogate gate --run {}", quoted(folder)));
    line(format_args!("and       robogate view {}   explores its episodes in the browser", quoted(folder)));
    Ok(DONE)
}

/// The files that an import to `out` writes: this one, or one for each policy, `-` and its name before the extension.
fn dictionaries(out: &Path) -> Vec<PathBuf> {
    if out.exists() {
        return vec![out.to_owned()];
    }
    let start = format!("{}-", out.file_stem().unwrap_or_default().to_string_lossy());
    let of_policy = |name: &str| name.starts_with(&start) && name.ends_with(".parquet");
    let found = std::fs::read_dir(".").into_iter().flatten().flatten().map(|entry| PathBuf::from(entry.file_name()));
    let mut found: Vec<PathBuf> = found.filter(|path| path.to_str().is_some_and(of_policy)).collect();
    found.sort();
    found
}

/// Prints the next command.
fn next(command: &str) {
    line(format_args!("next      {}", bold(command)));
}

/// Runs another verb as the user would, and shows its command line. The verbs that read models of robots start themselves again.
fn step(arguments: &[&str]) -> Result<(), Exit> {
    let words: Vec<String> = arguments.iter().map(|word| quoted(Path::new(word))).collect();
    note(format_args!("$ robogate {}", words.join(" ")));
    let program = std::env::current_exe().context("cannot find this program").or_broken()?;
    let status = Command::new(program).arg("--quiet").args(arguments).status();
    let status = status.context("cannot start this program again").or_broken()?;
    if status.success() {
        return Ok(());
    }
    let code = status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(USAGE);
    Err(Exit {
        code,
        error: anyhow!("`robogate {}` found problems\nHint: correct them and repeat this command", words.join(" ")),
    })
}
