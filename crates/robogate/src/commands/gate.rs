//! `robogate gate`: decides whether a policy may run.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::transfer::Transfer;
use robogate_analysis::{Finding, Source};
use robogate_campaign::{Completion, DEFAULT_SEED, Event, Plan, Round, Settings};
use robogate_core::budget::Budget;
use robogate_core::{Suite, TaskSpec};
use robogate_dictionary::{Label, Provenance, read_text};
use robogate_gate::{
    Against, Asked, AskedAgainst, Baseline, Evaluation, GateError, GatePlan, Mode, PairPlan, Planned, Question,
    RealEvidence, RealStratum, Record, Requirements, Sampling, Trial, Verdict,
};
use robogate_physics::SuctionLaw;
use robogate_report::{Watch, evaluation_markdown_with, junit, reqif};
use robogate_stats::format::counted;

use crate::answer;
use crate::benchmark;
use crate::commands::register::{Registered, Registrar, free};
use crate::commands::rival::Rival;
use crate::commands::run::{How, free_folder, interrupted, introduce, write_report_with};
use crate::commands::{controls, shard, suites};
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INVALID, OrExit, USAGE};
use crate::latency::LatencyArguments;
use crate::policy_source::{PolicyAccess, PolicyArguments, PolicyLocation};
use crate::remote::Simulators;
use crate::source::open_source;
use crate::subject::{EnvironmentArguments, Subject};
use crate::summary::influential;
use crate::terminal::{grouped, line, note, warning};
use crate::twins::{self, Arm, NominalArguments};
use crate::watch::Frames;

/// Decide whether the policy may run: run a suite until the verdict is certain, or judge a finished run.
///
/// Exit codes: 0 pass, 1 fail, 3 inconclusive, 4 nothing was evaluated.
#[derive(Debug, Args)]
pub(crate) struct Gate {
    /// Judge this run's folder or dictionary instead of running episodes
    #[arg(long, value_name = "RUN", conflicts_with_all = ["suite", "rounds", "fixed", "seed", "plan"])]
    run: Option<PathBuf>,
    /// Run this suite: a built-in one or a TOML file; default: industrial-68 in the built-in cell, otherwise 64
    /// scenarios sampled from the environment's parameter space with the seed of the rounds
    #[arg(long, value_name = "NAME|FILE")]
    suite: Option<String>,
    /// Sample the suite from this parameter space; default: the environment's own
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "suite")]
    space: Option<String>,
    /// Choose the requirements: default, paper or a TOML file
    #[arg(long, value_name = "NAME|FILE")]
    requirements: Option<String>,
    /// Compare relative requirements with this baseline file or run; with a run, also test whether this policy may
    /// replace that one
    #[arg(long, value_name = "FILE|RUN")]
    baseline: Option<PathBuf>,
    /// Judge requirements on `real:success` with these trials of the real robot: the file of `robogate transfer --out`;
    /// default: that of the run's gate
    #[arg(long, value_name = "FILE")]
    real: Option<PathBuf>,
    /// Set the non-inferiority margin: how far the success rate may lie below that of the baseline run or of the policy
    /// of --against; default: 0.05, with --run the margin of its gate
    #[arg(long, value_name = "SHARE")]
    margin: Option<f64>,
    /// Also test whether this policy may replace another one, which runs the same scenarios round by round: `random`,
    /// `scripted`, the address of a policy server, or an ONNX file
    #[arg(long, value_name = "URL|FILE|random|scripted", conflicts_with_all = ["run", "baseline"])]
    against: Option<String>,
    /// Choose the observation and action mapping of the policy of --against
    #[arg(long, value_name = "NAME|FILE", requires = "against")]
    against_profile: Option<String>,
    /// Set the maximum number of rounds of the suite; default: the budget of the requirements, or 1 for a published
    /// benchmark
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Run all rounds and test once, instead of stopping as soon as the verdict is certain
    #[arg(long)]
    fixed: bool,
    /// Print how often the gate passes and fails at given true rates, and run nothing
    #[arg(long)]
    plan: bool,
    /// Also run the nominal twin of each scenario: the same seed with the task's nominal values. The gate then states the
    /// effect of each group of perturbations and what fails without them. The verdict does not depend on it
    #[arg(long, conflicts_with = "run")]
    twins: bool,
    #[command(flatten)]
    nominal: NominalArguments,
    /// Set the number of episodes of each control of an external policy: the environment's expert, the expert through
    /// the profile, and random actions of the model. 0 skips the controls, and the result says so
    #[arg(long, value_name = "N", default_value_t = controls::EPISODES)]
    controls: u32,
    /// Set the seed of the rounds
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    access: PolicyAccess,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    how: How,
    /// Write the plan of the gate in N shards to --out, and run nothing: `robogate plan DIR --next` prints the commands
    /// that run the next round, and `robogate merge DIR` returns the verdict (docs/cluster.md)
    #[arg(long, value_name = "N", requires = "out", conflicts_with_all = ["run", "plan"])]
    divide: Option<u32>,
    /// Register the run before its first episode: sign its plan, seed, question and policy with this private key, and
    /// number the registration in PRIVATE.registrations (docs/signatures.md)
    #[arg(long, value_name = "PRIVATE", conflicts_with_all = ["run", "plan"])]
    register: Option<PathBuf>,
    /// Write the run to this folder (default: a new one under runs/); with --run, write only the verdict's files
    /// (default: none)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// The default non-inferiority margin, as a fraction.
const MARGIN: f64 = 0.05;

/// The number of scenarios of a suite that is sampled from a space.
const SAMPLED_SCENARIOS: usize = 64;

/// The files of the evaluation in a run's folder.
const ANSWER: [&str; 4] = ["gate.json", "gate.md", "gate.junit.xml", "gate.reqif"];

/// The folder of images to which the Markdown file refers, in a run's folder.
const FRAMES: &str = "frames";

/// The built-in baselines.
const BASELINES: [&str; 1] = [include_str!("../../../../assets/baselines/franka-industrial-68.json")];

/// Finds the built-in baseline for these scenarios and this robot.
pub(crate) fn built_in_baseline(record: &Record) -> Option<Baseline> {
    BASELINES
        .iter()
        .filter_map(|text| Baseline::from_json(text).ok())
        .find(|baseline| baseline.population.is_that_of(&record.population) && baseline.robot == record.robot)
}

impl Gate {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.run {
            Some(run) => self.judge(run),
            None => self.run_suite(),
        }
    }

    /// How this process reaches the policy.
    fn location(&self) -> PolicyLocation {
        PolicyLocation::with_access(&self.access)
    }

    /// Judges a finished run.
    fn judge(&self, run: &Path) -> Result<u8, Exit> {
        let source = open_source(run)?;
        let mut record = Record::of(source.dictionary()).map_err(refused)?;
        let asked = source.folder().map_or(Ok(None), Asked::of).map_err(refused)?;
        // A run that was tested after each round stays a sequential test, also if it is judged again.
        let sampling = asked.as_ref().map_or(Sampling::Fixed, |asked| asked.sampling);
        let requirements = match (&self.requirements, &asked) {
            (None, Some(asked)) => asked.requirements.clone(),
            (name, _) => open_requirements(name.as_deref().unwrap_or("default"), &record.task)?,
        };
        let other = match &asked {
            Some(asked) if self.baseline.is_none() => {
                Other { baseline: asked.baseline.clone(), record: compared_with(asked)? }
            }
            _ => self.other(&record)?,
        };
        let asked_margin = asked.as_ref().and_then(|asked| Some(asked.against.as_ref()?.margin));
        let margin = self.margin.or(asked_margin).unwrap_or(MARGIN);
        if let Some(asked) = &asked {
            self.note_changes(asked, &requirements, asked_margin);
        }
        record.real = match &self.real {
            Some(file) => Some(real_evidence(file)?),
            None => asked.as_ref().and_then(|asked| asked.real.clone()),
        };
        let question = Question {
            requirements: &requirements,
            baseline: other.baseline.as_ref(),
            against: other.against(margin),
            sampling,
        };
        let mut evaluation = question.evaluate(&record).map_err(refused)?;
        evaluation.twins = self.nominal.twins(&source, sampling)?;
        if let Some(out) = &self.out {
            fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display())).or_broken()?;
            write_answer(out, &evaluation, None)?;
        }
        show(self.out.as_deref(), &evaluation, source.dictionary().provenance(), self.how.json)
    }

    /// Prints one line for each part of the question that differs from the question of the run's gate.
    fn note_changes(&self, asked: &Asked, requirements: &Requirements, margin: Option<f64>) {
        if *requirements != asked.requirements {
            let (was, is) = (&asked.requirements.name, &requirements.name);
            note(format_args!(
                "note: the run's gate used the requirements `{was}`; this evaluation uses `{is}` as given now"
            ));
        }
        if let Some(path) = &self.baseline {
            let was = match (&asked.against, &asked.baseline) {
                (Some(against), _) => format!("the run {}", against.path),
                (None, Some(_)) => "another baseline".to_owned(),
                (None, None) => "no baseline".to_owned(),
            };
            note(format_args!(
                "note: the run's gate compared with {was}; this evaluation compares with {}",
                path.display()
            ));
        }
        if let (Some(was), Some(is)) = (margin, self.margin)
            && (was - is).abs() > 0.0
        {
            note(format_args!("note: the run's gate used the margin {was}; this evaluation uses {is}"));
        }
    }

    /// Runs a suite until the verdict is certain.
    fn run_suite(&self) -> Result<u8, Exit> {
        self.nominal.unused()?;
        let suite = self.suite.as_deref().map(suites::find).transpose()?;
        let environment = self.environment.environment_of(suite.as_ref(), SuctionLaw::Vacuum)?;
        let subject = Subject::new(environment, self.policy.source_at(&self.location())?)?;
        let subject = subject.with_latency(&self.latency)?;
        let wanted = self.requirements.as_deref().unwrap_or("default");
        let requirements = open_requirements(wanted, subject.task())?;
        let suite = self.suite(&subject)?;
        if self.suite.is_some() {
            self.latency.check_suite(suite.space()).or_usage()?;
        }
        subject.check_suite(&suite).or_usage()?;
        // The protocol of a published benchmark fixes the number of episodes.
        let protocol = !suite.published().is_empty();
        let rounds = self.rounds.unwrap_or(if protocol { 1 } else { requirements.budget.rounds });
        let fixed = self.fixed || requirements.mode == Mode::Point;
        let sampling = if fixed { Sampling::Fixed } else { Sampling::Sequential };
        let labels: Vec<Label> = suite
            .cases()
            .iter()
            .map(|case| Label {
                case: Some(case.id.clone()),
                category: Some(case.category.clone()),
                group: Some(case.group.clone()),
            })
            .collect();
        // A comparison with another run uses its seed, because only identical scenarios can be paired.
        let seed = match (self.seed, self.other_seed()?) {
            (Some(seed), _) | (None, Some(seed)) => seed,
            (None, None) => DEFAULT_SEED,
        };
        let controls = if self.plan { None } else { controls::run(&subject, &suite, self.controls, seed)? };
        let subject = match &controls {
            Some(controls) => subject.with_controls(controls),
            None => subject,
        };
        let mut plan = Plan::of_suite(suite, u64::from(rounds), seed);
        plan.twins |= self.twins;
        let space = plan.suite.as_ref().map(|stage| stage.suite.space().clone());
        let space = space.ok_or_else(|| anyhow!("the plan has no suite")).or_broken()?;
        let provenance = subject.provenance(space)?;
        plan.check(&provenance.space).or_usage()?;
        let planned =
            Provenance { plan: serde_json::to_value(&plan).or_broken()?, seed: plan.seed, ..provenance.clone() };
        let mut record = Record::begun(&planned).map_err(refused)?;
        record.real = self.real.as_deref().map(real_evidence).transpose()?;
        let other = self.other(&record)?;
        // Questions that cannot be decided are reported before anything runs.
        let gate_plan = GatePlan::of(&requirements, other.baseline.as_ref(), &labels, sampling, u64::from(rounds))
            .map_err(refused)?;
        let margin = self.margin.unwrap_or(MARGIN);
        if let Some((_, a)) = &other.record {
            let planned = Planned { seed: plan.seed, rounds: u64::from(rounds), sampling, alpha: requirements.alpha() };
            robogate_gate::check_pairing(a, &record, planned, margin).map_err(refused)?;
        }
        if self.plan {
            let pairs = match self.against {
                Some(_) => {
                    let (alpha, per_round) = (requirements.alpha(), labels.len() as u64);
                    Some(PairPlan::of(margin, alpha, per_round, u64::from(rounds)).map_err(refused)?)
                }
                None => None,
            };
            if self.how.json {
                let mut document = serde_json::to_value(&gate_plan).or_broken()?;
                if let (Some(document), Some(pairs)) = (document.as_object_mut(), &pairs) {
                    document.insert("against".to_owned(), serde_json::to_value(pairs).or_broken()?);
                }
                line(serde_json::to_string_pretty(&document).or_broken()?);
            } else {
                answer::print_plan(&gate_plan);
                pairs.iter().for_each(answer::print_pair_plan);
            }
            return Ok(DONE);
        }
        let mut rival = match &self.against {
            None => None,
            Some(policy) => {
                let source = PolicyArguments::of(policy, self.against_profile.as_deref())
                    .with_map_of(&self.policy)
                    .source_at(&self.location())?;
                let environment = self.environment.environment(SuctionLaw::Vacuum)?;
                Some(Rival::new(Subject::new(environment, source)?, &planned, self.how.threads_for_rival())?)
            }
        };
        let against = other.record.as_ref().map(|(path, record)| AskedAgainst {
            path: path.canonicalize().unwrap_or_else(|_| path.clone()).to_string_lossy().into_owned(),
            dataset_sha256: record.dataset_sha256.clone(),
            margin,
        });
        let mut asked = Asked {
            format: Asked::FORMAT,
            requirements,
            baseline: other.baseline,
            against,
            sampling,
            real: record.real.clone(),
        };
        if rival.is_some() && self.divide.is_none() {
            // Its rows do not exist yet. The file is written again once they do.
            asked.against = Some(AskedAgainst { path: String::new(), dataset_sha256: String::new(), margin });
        }
        let provenance = Provenance { question_sha256: Some(asked.sha256()), ..provenance };
        // Read before anything is written, so that an unusable key is reported early.
        let registrar = self.register.as_deref().map(Registrar::new).transpose()?;
        if let (Some(shards), Some(dir)) = (self.divide, &self.out) {
            let question = asked.to_json();
            let registration = registrar.map(|registrar| registrar.register(&plan, &provenance)).transpose()?;
            let files = registration.as_ref().map(Registered::files).into_iter().flatten();
            let documents: Vec<(&str, &[u8])> =
                std::iter::once((Asked::FILE, question.as_bytes())).chain(files).collect();
            return shard::divide(dir, shards, &plan, provenance, &documents, self.how.json);
        }
        let dir = match &self.out {
            Some(dir) => dir.clone(),
            None => free_folder(&format!("gate-{}-{}", subject.label(), plan.seed)),
        };
        if controls.as_ref().is_some_and(|controls| controls.failure().is_some()) {
            // The episodes of the policy would say nothing about it.
            let question = Question {
                requirements: &asked.requirements,
                baseline: asked.baseline.as_ref(),
                against: None,
                sampling,
            };
            let evaluation = question.evaluate(&record).map_err(refused)?;
            fs::create_dir_all(&dir).with_context(|| format!("cannot create {}", dir.display())).or_broken()?;
            write_answer(&dir, &evaluation, None)?;
            return show(Some(&dir), &evaluation, &planned, self.how.json);
        }
        introduce(&provenance, plan.seed);
        note(format_args!(
            "{}: {} scenarios, {} {}, requirements `{}`, into {}",
            record.population,
            labels.len(),
            if fixed { "exactly" } else { "at most" },
            counted(u64::from(rounds), "round"),
            asked.requirements.name,
            dir.display()
        ));
        if self.seed.is_none() {
            note(format_args!(
                "seed {}: the default of every gate. A policy that was tuned on these scenarios must be judged with another --seed",
                plan.seed
            ));
        }
        if let Some(rival) = &rival {
            asked.against = Some(AskedAgainst { path: rival.file(&dir), dataset_sha256: String::new(), margin });
            note(format_args!("against {}: the same scenarios, round by round", rival.name()));
        }
        let registration = match registrar {
            Some(registrar) => {
                free(&dir)?;
                Some(registrar.register(&plan, &provenance)?)
            }
            None => None,
        };
        let arm = Arm::of(&dir, &plan, &provenance.space, &subject)?;
        let mut other = other.record.map(|(_, record)| record);
        let mut trouble = None;
        let mut broken = None;
        let completion = {
            let mut after = |round: &Round<'_>| {
                if let Some(rival) = &mut rival
                    && let Err(error) = rival.run(&dir, round)
                {
                    broken = Some(error);
                    return ControlFlow::Break(());
                }
                let other = rival.as_ref().map(Rival::record).or(other.as_ref());
                Look { asked: &asked, other, record: &mut record, trouble: &mut trouble }.after(round)
            };
            self.how.carry(&subject, |executor, events| {
                let mut with_question = |event: &Event| {
                    // The folder exists and contains the plan; no episode has run yet.
                    if let Event::Started { .. } = event {
                        write_question(&dir, &asked);
                        registration.iter().for_each(|registration| registration.write(&dir));
                    }
                    events(event);
                };
                let completion = robogate_campaign::start_in_rounds(
                    &dir,
                    &plan,
                    provenance,
                    executor,
                    &mut with_question,
                    &mut after,
                )?;
                arm.map_or(Ok(completion.clone()), |arm| arm.after(completion, executor, events))
            })
        }?;
        if let Some(error) = broken {
            return Err(error);
        }
        if let (Some(rival), Completion::Finished { .. }) = (rival, &completion) {
            other = Some(finish_rival(rival, &dir, &mut asked, margin)?);
        }
        finish(&dir, &asked, other.as_ref(), trouble, completion, self.how.json)
    }

    /// The suite of the arguments, or that of the task, or one sampled from the environment's space.
    fn suite(&self, subject: &Subject) -> Result<Suite, Exit> {
        match (&self.suite, &self.space, subject.own_suite()) {
            (Some(name), _, _) => suites::find(name),
            (None, None, Some(own)) => suites::find(own),
            (None, space, _) => {
                let space =
                    subject.space(space.as_deref()).and_then(|space| self.latency.added_to(space)).or_usage()?;
                let seed = self.seed.unwrap_or(DEFAULT_SEED);
                Suite::sampled(&Arc::new(space), SAMPLED_SCENARIOS, seed).map_err(anyhow::Error::from).or_usage()
            }
        }
    }

    /// The baseline's path, if it is a run. Its episodes can be compared one by one.
    fn against_run(&self) -> Option<&Path> {
        let path = self.baseline.as_deref()?;
        (path.is_dir() || path.extension().is_some_and(|ending| ending == "parquet")).then_some(path)
    }

    fn other_seed(&self) -> Result<Option<u64>, Exit> {
        let Some(path) = self.against_run() else { return Ok(None) };
        Ok(Some(open_source(path)?.dictionary().provenance().seed))
    }

    /// The baseline of the comparison.
    fn other(&self, record: &Record) -> Result<Other, Exit> {
        let Some(path) = &self.baseline else {
            return Ok(Other { baseline: built_in_baseline(record), record: None });
        };
        if self.against_run().is_none() {
            let baseline = Baseline::open(path).map_err(refused)?;
            return Ok(Other { baseline: Some(baseline), record: None });
        }
        let source = open_source(path)?;
        let a = Record::of(source.dictionary()).map_err(refused)?;
        let baseline = Baseline::of(&a).map_err(refused)?;
        Ok(Other { baseline: Some(baseline), record: Some((path.clone(), a)) })
    }
}

/// Opens the run that the gate compares with. Returns an error if it has changed since.
pub(crate) fn compared_with(asked: &Asked) -> Result<Option<(PathBuf, Record)>, Exit> {
    let Some(against) = &asked.against else { return Ok(None) };
    let path = PathBuf::from(&against.path);
    let source = open_source(&path)?;
    let record = Record::of(source.dictionary()).map_err(refused)?;
    if record.dataset_sha256 != against.dataset_sha256 {
        return Err(anyhow!(
            "{} has changed since this gate started. Expected the dataset that it was compared with",
            against.path
        ))
        .or_usage();
    }
    Ok(Some((path, record)))
}

/// Reads the trials of the real robot from the file of `robogate transfer --out`.
pub(crate) fn real_evidence(path: &Path) -> Result<RealEvidence, Exit> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_usage()?;
    let transfer: Transfer = Budget::FILE
        .json(text.as_bytes())
        .with_context(|| {
            format!(
                "{}: not a transfer\nhint: create it with `robogate transfer --sim RUN --real FILE --out FILE`",
                path.display()
            )
        })
        .or_usage()?;
    let exact = match &transfer.exact {
        Finding::Estimated(exact) => exact,
        Finding::CannotBeEstimated { because } => {
            return Err(anyhow!("{}: it has no exact rate because {because}", path.display())).or_usage();
        }
    };
    let strata = exact.strata.map(|s| RealStratum { share: s.share, trials: s.trials, successes: s.successes });
    Ok(RealEvidence {
        format: RealEvidence::FORMAT,
        task: transfer.task.name.clone(),
        robot: transfer.simulation.robot.clone(),
        policy: transfer.simulation.policy.clone(),
        population: transfer.population.clone(),
        trials_sha256: transfer.real.sha256.clone(),
        simulation_sha256: transfer.simulation.dataset_hash.clone(),
        strata,
    })
}

/// The evaluation of the gate that a run's folder belongs to. `None` for a run without a gate.
pub(crate) fn evaluation_of(folder: &Path, source: &Source) -> Result<Option<Evaluation>, Exit> {
    let Some(asked) = Asked::of(folder).map_err(refused)? else { return Ok(None) };
    let mut record = Record::of(source.dictionary()).map_err(refused)?;
    record.real.clone_from(&asked.real);
    let other = compared_with(&asked)?.map(|(_, record)| record);
    let mut evaluation = question(&asked, other.as_ref()).evaluate(&record).map_err(refused)?;
    evaluation.twins = twins::of_folder(folder, source, asked.sampling)?;
    Ok(Some(evaluation))
}

/// Resumes an interrupted gate.
pub(crate) fn resume(
    dir: &Path,
    mut asked: Asked,
    subject: &Subject,
    settings: Settings,
    simulators: &Simulators,
    location: &PolicyLocation,
    how: &How,
) -> Result<u8, Exit> {
    // The rows of a policy that runs beside this one do not exist before the end.
    let running = asked.against.as_ref().filter(|against| against.dataset_sha256.is_empty()).map(|a| a.margin);
    let mut rival = match running {
        Some(_) => Some(Rival::resume(dir, simulators, location, &settings.provenance, how.threads_for_rival())?),
        None => None,
    };
    let mut other = match rival {
        Some(_) => None,
        None => compared_with(&asked)?.map(|(_, record)| record),
    };
    let mut record = Record::begun(&settings.provenance).map_err(refused)?;
    record.real.clone_from(&asked.real);
    let arm = Arm::of(dir, &settings.plan, &settings.provenance.space, subject)?;
    let provenance = subject.provenance(settings.provenance.space)?;
    let mut trouble = None;
    let mut broken = None;
    let completion = {
        let mut after = |round: &Round<'_>| {
            if let Some(rival) = &mut rival
                && let Err(error) = rival.run(dir, round)
            {
                broken = Some(error);
                return ControlFlow::Break(());
            }
            let other = rival.as_ref().map(Rival::record).or(other.as_ref());
            Look { asked: &asked, other, record: &mut record, trouble: &mut trouble }.after(round)
        };
        how.carry(subject, |executor, events| {
            let completion = robogate_campaign::resume_in_rounds(dir, &provenance, executor, events, &mut after)?;
            arm.map_or(Ok(completion.clone()), |arm| arm.after(completion, executor, events))
        })
    };
    let completion = completion?;
    if let Some(error) = broken {
        return Err(error);
    }
    if let (Some(rival), Some(margin), Completion::Finished { .. }) = (rival, running, &completion) {
        other = Some(finish_rival(rival, dir, &mut asked, margin)?);
    }
    finish(dir, &asked, other.as_ref(), trouble, completion, how.json)
}

/// Writes the rows of the policy of --against, and names them in the question.
fn finish_rival(rival: Rival, dir: &Path, asked: &mut Asked, margin: f64) -> Result<Record, Exit> {
    let (path, record) = rival.write(dir)?;
    let dataset_sha256 = record.dataset_sha256.clone();
    asked.against = Some(AskedAgainst { path, dataset_sha256, margin });
    write_question(dir, asked);
    rival.clean(dir);
    Ok(record)
}

/// A baseline's figures, and the run that they came from if it can be compared episode by episode.
struct Other {
    baseline: Option<Baseline>,
    record: Option<(PathBuf, Record)>,
}

impl Other {
    fn against(&self, margin: f64) -> Option<Against<'_>> {
        self.record.as_ref().map(|(_, record)| Against { record, margin })
    }
}

/// Evaluates the question after each round.
pub(crate) struct Look<'a> {
    pub(crate) asked: &'a Asked,
    pub(crate) other: Option<&'a Record>,
    pub(crate) record: &'a mut Record,
    pub(crate) trouble: &'a mut Option<GateError>,
}

impl Look<'_> {
    /// Whether another round follows. Each pass over the rounds starts with round 0.
    pub(crate) fn after(&mut self, round: &Round<'_>) -> ControlFlow<()> {
        if round.number == 0 {
            self.record.trials.clear();
        }
        self.record.trials.extend(round.entries.iter().map(Trial::from));
        if self.asked.sampling == Sampling::Fixed {
            return ControlFlow::Continue(());
        }
        match question(self.asked, self.other).evaluate(self.record) {
            Ok(evaluation) if matches!(evaluation.verdict, Verdict::Pass | Verdict::Fail) => ControlFlow::Break(()),
            Ok(_) => ControlFlow::Continue(()),
            Err(error) => {
                *self.trouble = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

fn question<'a>(asked: &'a Asked, other: Option<&'a Record>) -> Question<'a> {
    Question {
        requirements: &asked.requirements,
        baseline: asked.baseline.as_ref(),
        against: other.zip(asked.against.as_ref()).map(|(record, a)| Against { record, margin: a.margin }),
        sampling: asked.sampling,
    }
}

/// Writes the question beside the plan. Without it `resume` would run all rounds; the verdict would be the same.
pub(crate) fn write_question(dir: &Path, asked: &Asked) {
    if let Err(error) = fs::write(dir.join(Asked::FILE), asked.to_json()) {
        warning(format_args!("cannot write {}: {error}", dir.join(Asked::FILE).display()));
    }
}

/// Evaluates a finished run, writes the verdict and the report, and prints the verdict.
pub(crate) fn finish(
    dir: &Path,
    asked: &Asked,
    other: Option<&Record>,
    trouble: Option<GateError>,
    completion: Completion,
    json: bool,
) -> Result<u8, Exit> {
    if let Completion::Interrupted { done, episodes } = completion {
        return Ok(interrupted(dir, done, episodes));
    }
    if let Some(error) = trouble {
        return Err(refused(error));
    }
    let frames = Frames { folder: dir.join(FRAMES), link: FRAMES.to_owned() };
    let (analysis, watch) = write_report_with(dir, Some(&frames)).unzip();
    // The evaluation uses the rows on disk, and not those that were seen during the run.
    let source = Source::open(dir).or_broken()?;
    let mut record = Record::of(source.dictionary()).map_err(refused)?;
    record.real.clone_from(&asked.real);
    let mut evaluation = question(asked, other).evaluate(&record).map_err(refused)?;
    evaluation.twins = twins::of_folder(dir, &source, asked.sampling)?;
    if let Some(twins) = &evaluation.twins {
        twins::write(dir, twins)?;
    }
    write_answer(dir, &evaluation, watch.flatten().as_ref())?;
    let code = show(Some(dir), &evaluation, source.dictionary().provenance(), json)?;
    if let Some(analysis) = analysis.filter(|_| !json) {
        influential(&analysis);
    }
    Ok(code)
}

pub(crate) fn write_answer(dir: &Path, evaluation: &Evaluation, watch: Option<&Watch>) -> Result<(), Exit> {
    let texts =
        [evaluation.to_json(), evaluation_markdown_with(evaluation, watch), junit(evaluation), reqif(evaluation)];
    for (name, text) in ANSWER.iter().zip(texts) {
        let path = dir.join(name);
        fs::write(&path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()?;
    }
    Ok(())
}

/// Prints the verdict. `provenance` is that of the judged run.
fn show(dir: Option<&Path>, evaluation: &Evaluation, provenance: &Provenance, json: bool) -> Result<u8, Exit> {
    if json {
        line(evaluation.to_json().trim_end());
    } else {
        answer::print(evaluation);
        benchmark::print(evaluation, provenance);
        if let Some(dir) = dir {
            let files: Vec<String> = ANSWER.iter().map(|name| dir.join(name).display().to_string()).collect();
            note(format_args!("files: {}", files.join(", ")));
        }
        if evaluation.verdict == Verdict::Fail || evaluation.counts.invalid > 0 {
            note(format_args!(
                "details: robogate report {}",
                dir.map_or_else(|| "RUN".to_owned(), |d| d.display().to_string())
            ));
        }
        if evaluation.counts.left_over > 0 {
            note(format_args!(
                "{} episodes after the last complete round are not judged",
                grouped(evaluation.counts.left_over)
            ));
        }
    }
    Ok(evaluation.verdict.exit_code())
}

/// Opens built-in requirements or a file. Prints a note for each name of version 0.1 in the file.
pub(crate) fn open_requirements(name_or_path: &str, task: &TaskSpec) -> Result<Requirements, Exit> {
    let requirements = Requirements::open(name_or_path, task).map_err(refused)?;
    if !Requirements::NAMES.contains(&name_or_path)
        && let Ok(text) = read_text(Path::new(name_or_path))
    {
        for (old, new) in Requirements::old_spellings(&text) {
            note(format_args!("note: {name_or_path}: `{old}` is the old name of `{new}`"));
        }
    }
    Ok(requirements)
}

/// Gives an error of the gate its exit code: usage if the user can correct it, invalid if there is no evidence.
pub(crate) fn refused(error: GateError) -> Exit {
    let code = match &error {
        GateError::EmptyBaseline
        | GateError::MixedLabels { .. }
        | GateError::PlannedSuite { .. }
        | GateError::Copies { .. } => INVALID,
        GateError::Dictionary(_) => INFRASTRUCTURE,
        _ => USAGE,
    };
    Exit { code, error: error.into() }
}
