//! `robogate study`: compares boundary-focused and uniform sampling by experiment.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::study::{LearnerFigures, Measure, Repeat, Score, Study as Outcome, Verdict};
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{
    Bins, BoundaryReport, BoundaryStage, Completion, Event, Executor, Plan, PooledWeights, Preset, UniformStage,
};
use robogate_core::{ParameterSpace, Seed};
use robogate_dictionary::{Dictionary, Provenance};
use robogate_physics::SuctionLaw;
use robogate_report::{study_answer, study_json, study_markdown};
use serde::{Deserialize, Serialize};

use crate::commands::run::{How, exit};
use crate::exit::{DONE, Exit, INTERRUPTED, INVALID, OrExit};
use crate::place;
use crate::progress::Progress;
use crate::subject::{EnvironmentArguments, Subject};
use crate::terminal::{bold, dim, grouped, line, note, percent, warning, wrapped};

/// The settings of the study. The file is written first and never changed.
const SETTINGS: &str = "study.json";
/// The result as JSON.
const RESULT: &str = "result.json";
/// The result as a page.
const PAGE: &str = "boundary-focusing.md";

/// Compare boundary-focused and uniform sampling by experiment: uniform, two-stage and pure-boundary designs with equal
/// budgets, evaluated on an independent uniform test set. The same command resumes an interrupted study.
#[derive(Debug, Args)]
pub(crate) struct Study {
    /// Set the number of episodes of each of the three designs, in each repeat
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u64).range(2..=10_000_000))]
    budget: u64,
    /// Set the number of repeats of the three designs, each with fresh seeds
    #[arg(long, value_name = "K", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    repeats: u64,
    /// Set the number of episodes of the test set, which no model is fitted to
    #[arg(long, value_name = "N", default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    test: u64,
    /// Set the seed of the study; the seeds of its campaigns follow from it
    #[arg(long, value_name = "S", default_value_t = 2026)]
    seed: u64,
    /// Test the boundary stage of this plan instead of the paper's (TOML); its budgets and seed are not used
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
    /// Choose the parameter space: a built-in one (see `robogate list`) or a TOML file; default: the environment's own
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    how: How,
    /// Write the study to this folder
    #[arg(short, long, value_name = "DIR", value_parser = place::local())]
    out: PathBuf,
}

/// The content of `study.json`: everything that the result depends on.
#[derive(Debug, Serialize, Deserialize)]
struct Settings {
    version: u32,
    budget: u64,
    repeats: u64,
    test: u64,
    seed: u64,
    /// The plan whose sampler and boundary stage are used.
    plan: Plan,
    provenance: Provenance,
}

/// A campaign of the study.
struct Campaign {
    /// Its folder, relative to that of the study.
    folder: String,
    /// Its title in the terminal.
    title: String,
    plan: Plan,
    space: ParameterSpace,
}

/// The rows of a finished campaign, and the boundary report if it had a second stage.
type Finished = (Dictionary, Option<Box<BoundaryReport>>);

/// The campaigns of one repeat.
struct Arms {
    uniform: Campaign,
    two_stage: Campaign,
    pure_boundary: Campaign,
}

impl Study {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        // As in a user's plan, a suction cup uses the physical vacuum law.
        let subject = Subject::new(self.environment.environment(SuctionLaw::Vacuum)?, None)?;
        let space = subject.space(self.space.as_deref()).or_usage()?;
        let plan = match &self.plan {
            Some(file) => Plan::load(file).or_usage()?,
            None => {
                let (plan, _) = Preset::Paper.plan().or_broken()?.fitted_to(&space);
                plan
            }
        };
        plan.check(&space).or_usage()?;
        let region = prior_region(&plan, &space)?;
        let provenance = subject.provenance(space.clone())?;
        let Self { budget, repeats, test, seed, .. } = *self;
        let settings = Settings { version: 1, budget, repeats, test, seed, plan: plan.clone(), provenance };
        begin(&self.out, &settings)?;
        let campaigns = self.campaigns(&plan, &space, &region);
        let episodes = grouped(test + 3 * budget * repeats);
        note(format_args!(
            "RoboGate {}: comparing sampling designs on {} in {}, {episodes} episodes in all, into {}",
            env!("CARGO_PKG_VERSION"),
            settings.provenance.robot.name,
            settings.provenance.engine.name,
            self.out.display()
        ));
        if repeats == 1 {
            warning("one repeat gives no confidence intervals and no verdict");
        }
        self.how.with_pool(&subject, |pool| match self.conduct(pool, &settings, &campaigns)? {
            Some(study) => self.tell(&study),
            None => {
                note("the finished episodes are recorded; the same command continues");
                Ok(INTERRUPTED)
            }
        })
    }

    fn campaigns(&self, plan: &Plan, space: &ParameterSpace, region: &ParameterSpace) -> (Campaign, Vec<Arms>) {
        // Seeds below 2^53 can be read by programs without 64-bit integers.
        let seed = |purpose: String| Seed::campaign(self.seed).stream(&purpose).bits() >> 11;
        let single = |seed, episodes, sampler: &str| Plan {
            seed,
            sampler: sampler.to_owned(),
            uniform: UniformStage { episodes },
            boundary: BoundaryStage::default(),
            active: None,
            suite: None,
            twins: false,
        };
        let repeat = |r: u64| {
            let campaign = |word: &str, name: &str, plan: &dyn Fn(u64) -> Plan, space: &ParameterSpace| Campaign {
                folder: format!("repeat-{r}/{word}"),
                title: format!("repeat {r} of {}: {name}, {} episodes", self.repeats, grouped(self.budget)),
                plan: plan(seed(format!("study-{word}-{r}"))),
                space: space.clone(),
            };
            let even = |seed| single(seed, self.budget, &plan.sampler);
            let two_stages = |seed| Plan {
                uniform: UniformStage { episodes: self.budget - self.budget / 2 },
                boundary: BoundaryStage { episodes: self.budget / 2, ..plan.boundary.clone() },
                ..single(seed, 0, &plan.sampler)
            };
            Arms {
                uniform: campaign("uniform", "uniform", &even, space),
                two_stage: campaign("two-stage", "two-stage", &two_stages, space),
                pure_boundary: campaign("pure-boundary", "pure boundary", &even, region),
            }
        };
        let test = Campaign {
            folder: "test".to_owned(),
            title: format!("test set, {} episodes", grouped(self.test)),
            // Independent draws, as the intervals over the test episodes assume.
            plan: single(seed("study-test".to_owned()), self.test, "uniform"),
            space: space.clone(),
        };
        (test, (1..=self.repeats).map(repeat).collect())
    }

    /// Runs the missing campaigns and evaluates the study. Returns `None` if it was interrupted.
    fn conduct(
        &self,
        executor: &dyn Executor,
        settings: &Settings,
        (test, repeats): &(Campaign, Vec<Arms>),
    ) -> Result<Option<Outcome>, Exit> {
        let run = |campaign: &Campaign| self.run(executor, settings, campaign);
        let Some((judge, _)) = run(test)? else { return Ok(None) };
        let mut data = Vec::new();
        for arms in repeats {
            let Some((uniform, _)) = run(&arms.uniform)? else { return Ok(None) };
            let Some((two_stage, boundary)) = run(&arms.two_stage)? else { return Ok(None) };
            let Some((pure, _)) = run(&arms.pure_boundary)? else { return Ok(None) };
            let boundary =
                boundary.with_context(|| format!("{}: no boundary report", arms.two_stage.folder)).or_usage()?;
            let pooled = PooledWeights::new(&arms.two_stage.plan, &arms.two_stage.space, &boundary).or_usage()?;
            let weights = weights(&two_stage, &pooled)?;
            data.push((uniform, two_stage, weights, pure));
        }
        note("fitting and evaluating ...");
        let repeats: Vec<Repeat<'_>> = data
            .iter()
            .map(|(uniform, two_stage, weights, pure_boundary)| Repeat {
                uniform,
                two_stage,
                two_stage_weights: weights.clone(),
                pure_boundary,
            })
            .collect();
        Outcome::of(&judge, &repeats).or_usage().map(Some)
    }

    /// Runs a campaign, or the rest of it. Returns `None` if it was interrupted.
    fn run(&self, executor: &dyn Executor, settings: &Settings, campaign: &Campaign) -> Result<Option<Finished>, Exit> {
        let dir = self.out.join(&campaign.folder);
        let provenance = Provenance { space: campaign.space.clone(), ..settings.provenance.clone() };
        let mut progress = Progress::new();
        let mut hear = |event: &Event| {
            if let Event::Started { .. } = event {
                note(&campaign.title);
            }
            progress.hear(event);
        };
        let completion = if dir.join(robogate_campaign::folder::PLAN).exists() {
            let recorded = robogate_campaign::settings(&dir).map_err(exit)?;
            if recorded.plan != campaign.plan || recorded.provenance.space != campaign.space {
                return Err(anyhow!("{}: contains a campaign that does not belong to this study", dir.display()))
                    .or_usage();
            }
            robogate_campaign::resume(&dir, &provenance, executor, &mut hear)
        } else {
            robogate_campaign::start(&dir, &campaign.plan, provenance, executor, &mut hear)
        };
        match completion.map_err(exit)? {
            Completion::Finished { boundary, .. } => {
                Ok(Some((Dictionary::open(&dir.join(DICTIONARY)).or_usage()?, boundary)))
            }
            Completion::Interrupted { .. } => Ok(None),
        }
    }

    fn tell(&self, study: &Outcome) -> Result<u8, Exit> {
        write(&self.out.join(RESULT), &(study_json(study) + "\n"))?;
        write(&self.out.join(PAGE), &study_markdown(study))?;
        if self.how.json {
            line(study_json(study));
        } else {
            print(study);
            line("");
            line(format_args!("{} {}", bold("Page"), self.out.join(PAGE).display()));
            line(format_args!("{} {}", bold("JSON"), self.out.join(RESULT).display()));
        }
        let found = study.learners.iter().flat_map(|l| &l.arms).any(|arm| arm.figures.estimated().is_some());
        Ok(if found { DONE } else { INVALID })
    }
}

/// The region of the boundary stage without any results: the plan's prior knowledge.
fn prior_region(plan: &Plan, space: &ParameterSpace) -> Result<ParameterSpace, Exit> {
    let nothing = Bins::new(space, plan.boundary.bins).or_usage()?;
    let region = BoundaryReport::find(&plan.boundary, space, &nothing).and_then(|r| r.focus(space)).or_usage()?.volume;
    if region.parameters() == space.parameters() {
        let why = "the plan's boundary stage has no `fallback` or `restrict` range that narrows this space, so there is no \
                   region for the pure-boundary design\nhint: use a --plan with a range in `[[boundary.fallback]]`";
        return Err(anyhow!(why)).or_usage();
    }
    Ok(region)
}

/// Starts a study in an empty folder, or checks that the folder contains this study.
fn begin(out: &Path, settings: &Settings) -> Result<(), Exit> {
    let path = out.join(SETTINGS);
    let text = serde_json::to_string_pretty(settings).or_broken()? + "\n";
    match fs::read_to_string(&path) {
        Ok(there) if there == text => Ok(()),
        Ok(there) => {
            let what = differs(&there, &text);
            Err(anyhow!(
                "{}: contains a study with another {what}\nhint: use the arguments that it was started with, or choose another \
                 folder",
                out.display()
            ))
            .or_usage()
        }
        Err(_) => {
            fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display())).or_broken()?;
            let listed = fs::read_dir(out).with_context(|| format!("cannot list {}", out.display())).or_broken()?;
            let names: Vec<String> =
                listed.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned())).collect();
            if let Some(name) = names.iter().filter(|name| !name.starts_with('.')).min() {
                return Err(anyhow!(
                    "{}: not empty (it contains `{name}`) and not a study\nhint: choose an empty or new folder",
                    out.display()
                ))
                .or_usage();
            }
            write(&path, &text)
        }
    }
}

/// The name of the first setting that differs.
fn differs(there: &str, here: &str) -> String {
    let [Ok(there), Ok(here)] = [there, here].map(serde_json::from_str::<serde_json::Value>) else {
        return "format of study.json".to_owned();
    };
    let parts = ["version", "budget", "repeats", "test", "seed", "plan"];
    if let Some(part) = parts.iter().find(|part| there[**part] != here[**part]) {
        return match (&there[*part], &here[*part]) {
            (serde_json::Value::Number(was), serde_json::Value::Number(is)) => format!("{part} ({was}, not {is})"),
            _ => (*part).to_owned(),
        };
    }
    let parts = ["tool", "build", "engine", "robot", "policy", "world", "space", "platform"];
    let part = parts.iter().find(|part| there["provenance"][**part] != here["provenance"][**part]);
    part.map_or("provenance", |part| part).to_owned()
}

/// Writes a file atomically.
fn write(path: &Path, text: &str) -> Result<(), Exit> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let part = path.with_file_name(format!(".{name}.part"));
    fs::write(&part, text)
        .and_then(|()| fs::rename(&part, path))
        .with_context(|| format!("cannot write {}", path.display()))
        .or_broken()
}

fn weights(dictionary: &Dictionary, pooled: &PooledWeights) -> Result<Vec<f64>, Exit> {
    let of = |entry: Result<robogate_dictionary::Entry, _>| {
        let requested = entry.or_usage()?.episode.scenario.requested;
        pooled.of(&requested).context("a row lies outside its own parameter space").or_usage()
    };
    dictionary.entries().map(of).collect()
}

fn print(study: &Outcome) {
    line(bold("Is boundary focusing worth it?"));
    line("");
    study_answer(study).iter().for_each(|sentence| wrapped(sentence));
    line("");
    let test = &study.test;
    wrapped(&format!(
        "Evaluated on {} uniform test episodes with {} success; always predicting the more frequent outcome has an error of {}.",
        grouped(test.rate.n),
        test.rate.rate.map_or_else(|| "-".to_owned(), percent),
        percent(test.majority_error)
    ));
    for learner in &study.learners {
        table(learner);
    }
    line("");
    wrapped(
        "▲ significantly better, ▼ significantly worse than uniform, with 95 % confidence for all designs and learners together \
         (Bonferroni); no mark: no significant difference, or fewer than 3 repeats. The last column is the paper's comparison: the \
         AUC in sample, which must not be compared between designs because their rows differ.",
    );
}

fn table(learner: &LearnerFigures) {
    line("");
    line(bold(format_args!("Learner: {}", learner.name)));
    line(dim(format_args!(
        "  {:<20} {:>7}  {:<26} {:>8}  {:>8}  {:>8}  {:>9}",
        "design", "error", "minus uniform, in points", "log loss", "Brier", "AUC", "in sample"
    )));
    for arm in &learner.arms {
        let Some(figures) = arm.figures.estimated() else {
            wrapped(&format!(
                "{:<20} cannot be estimated because {}",
                arm.arm.name(),
                arm.figures.because().unwrap_or_default()
            ));
            continue;
        };
        let cell = |measure: Measure| {
            figures.score(measure).map_or_else(|| "-".to_owned(), |s| format!("{:.3} {}", s.value.mean, mark(s)))
        };
        let error = figures.score(Measure::BoundaryError);
        line(format_args!(
            "  {:<20} {:>7}  {:<26} {:>8}  {:>8}  {:>8}  {:>9.3}",
            arm.arm.name(),
            error.map_or_else(|| "-".to_owned(), |s| percent(s.value.mean)),
            error.map_or_else(String::new, difference),
            cell(Measure::LogLoss),
            cell(Measure::Brier),
            cell(Measure::Auc),
            figures.mean_auc_in_sample()
        ));
    }
}

fn mark(score: &Score) -> char {
    match score.verdict {
        Some(Verdict::Better) => '▲',
        Some(Verdict::Worse) => '▼',
        Some(Verdict::NotSignificant) | None => ' ',
    }
}

fn difference(score: &Score) -> String {
    let Some(difference) = &score.difference_to_uniform else { return String::new() };
    let interval = match difference.interval_95 {
        Some([low, high]) => format!("{:+.1} to {:+.1}", 100.0 * low, 100.0 * high),
        None => "no interval".to_owned(),
    };
    format!("{:+.1} ({interval}) {}", 100.0 * difference.mean, mark(score))
}
