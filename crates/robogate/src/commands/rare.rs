//! `robogate rare`: the probability of a rare event, by subset simulation over parameters and draws.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::sync::Arc;

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::{DEFAULT_SEED, Executor};
use robogate_core::{
    Assignment, Better, Episode, FailureMode, Foresight, Outcome, ParameterSpace, Scenario, Seed, Value,
};
use robogate_session::Subject;
use robogate_stats::format::{count, counted, number, significant};
use robogate_stats::rare::{EVENT, Plan, Point, Rare, points_per_level, subset};
use robogate_stats::{Confidence, Trials, clopper_pearson};
use serde::Serialize;

use crate::arguments::{EnvironmentArguments, LatencyArguments, LocationArguments, PolicyArguments};
use crate::commands::run::{How, introduce};
use crate::exit::{DONE, Exit, INCONCLUSIVE, INTERRUPTED, OrExit};
use crate::terminal::{bold, line, note, warning, wrapped};

/// Distinct margins among the first episodes below which the event counts as a bare yes or no.
const FEWEST_MARGINS: usize = 20;
/// Share of invalid episodes above which the answer names them.
const INVALID: f64 = 0.01;
/// Episodes with the event that are listed.
const LISTED: usize = 3;

/// Estimate the probability of a rare event over a parameter space and the draws of the seeds.
///
/// Subset simulation needs a margin: a measure of the task, or a feature that it computes before an episode, which says how near an episode
/// came to the event, such as the smallest clearance for a collision. Each level keeps the tenth of the episodes that came nearest and varies
/// them. A probability of 1e-6 needs a few thousand episodes in place of many millions.
///
/// Exit codes: 0 the event was reached, 3 it was not (the answer then depends on the margin), or plain episodes contradict the estimate.
#[derive(Debug, Args)]
pub(crate) struct RareEvent {
    /// Choose the event: a failure mode of the task, or failure for any
    #[arg(long, value_name = "MODE")]
    event: String,
    /// Choose the measure or the feature that grades how near an episode came to the event
    #[arg(long, value_name = "NAME")]
    margin: Option<String>,
    /// Choose the parameter space: a built-in one or a TOML file; default: the environment's own
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    /// Set the largest number of episodes
    #[arg(long, value_name = "N", default_value_t = 3_000, value_parser = clap::value_parser!(u64).range(200..=10_000_000))]
    episodes: u64,
    /// Set the probability for which the number of episodes of a level is chosen
    #[arg(long, value_name = "P", default_value_t = 1e-4)]
    target: f64,
    /// Compare with this number of plain episodes, at the level whose probability they can show; 0 skips it
    #[arg(long, value_name = "N", default_value_t = 0)]
    check: u64,
    /// Set the seed
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SEED)]
    seed: u64,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    location: LocationArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    how: How,
}

/// The answer as one versioned document.
#[derive(Debug, Serialize)]
struct Answer {
    format: u32,
    event: String,
    margin: String,
    space: String,
    policy: String,
    seed: u64,
    /// If the event was not reached, an upper estimate.
    probability: f64,
    reached: bool,
    coefficient_of_variation: Option<f64>,
    /// Log-normal, from the coefficient of variation.
    interval_95: Option<[f64; 2]>,
    episodes: u64,
    invalid: u64,
    levels: Vec<AnswerLevel>,
    /// The event among the episodes that no margin chose: those of the first level, and of `--check`.
    plain: Plain,
    check: Option<Check>,
    examples: Vec<Assignment>,
}

#[derive(Debug, Serialize)]
struct AnswerLevel {
    /// In the unit of the margin. Absent for the event.
    margin: Option<f64>,
    probability: f64,
}

/// The event among plain episodes. Their interval does not depend on the margin.
#[derive(Debug, Serialize)]
struct Plain {
    episodes: u64,
    happened: u64,
    interval_95: [f64; 2],
    /// Whether they have the event more often than the estimate allows: no chain found the way to it.
    contradicts: bool,
}

impl Plain {
    fn of(margins: &[f64], most: f64) -> Self {
        let events = Trials::count(margins.iter().filter(|m| !m.is_nan()).map(|m| *m <= EVENT));
        let interval = clopper_pearson(events, Confidence::P95);
        Self {
            episodes: events.n(),
            happened: events.successes(),
            interval_95: [interval.low, interval.high],
            contradicts: interval.low > most,
        }
    }
}

/// Plain episodes beside the estimate of one level.
#[derive(Debug, Serialize)]
struct Check {
    episodes: u64,
    margin: Option<f64>,
    happened: u64,
    interval_95: [f64; 2],
    estimate: f64,
    /// Log-normal, from the levels down to this one.
    estimate_95: [f64; 2],
    /// Whether the two intervals overlap.
    agrees: bool,
}

/// How the margin is read.
#[derive(Clone, Copy)]
enum Grade {
    Measure(f64),
    Feature(usize, f64),
}

/// The event and its margin.
struct Question {
    mode: Option<FailureMode>,
    name: String,
    grade: Grade,
    foresight: Option<Arc<dyn Foresight>>,
}

impl Question {
    fn new(subject: &Subject, event: &str, margin: Option<&str>) -> Result<Self, Exit> {
        let task = subject.task();
        let mode = match event {
            "failure" => None,
            name => Some(FailureMode::new(name).ok().filter(|mode| task.declares(*mode)).ok_or_else(|| {
                let modes: Vec<&str> = task.modes().map(FailureMode::as_str).collect();
                anyhow!(
                    "--event {event}: the task {} has no such failure mode\nHint: its failure modes are {}, or use failure for any",
                    task.name,
                    modes.join(", ")
                )
            }).or_usage()?),
        };
        let foresight = subject.foresight()?;
        let specs = foresight.as_ref().map_or(&[][..], |foresight| foresight.feature_specs());
        let measures = task.measures.iter().map(|of| (of.name.as_str(), of.better));
        let graded: Vec<(&str, Better)> = measures.chain(specs.iter().map(|of| (of.name, of.better))).collect();
        let usable: Vec<&str> = graded.iter().filter(|(_, better)| *better != Better::Neither).map(|of| of.0).collect();
        let Some(name) = margin else {
            return Err(anyhow!(
                "--event {event} is a bare yes or no: subset simulation needs a margin that says how near an episode came to it\nHint: \
                 add --margin with one of {}; without a margin, `robogate run --seek {event}` estimates probabilities down to 1e-3",
                if usable.is_empty() { "the task's measures, of which it has none".to_owned() } else { usable.join(", ") }
            ))
            .or_usage();
        };
        let sign = match graded.iter().find(|of| of.0 == name).map(|of| of.1) {
            Some(Better::Higher) => 1.0,
            Some(Better::Lower) => -1.0,
            Some(Better::Neither) | None => {
                return Err(anyhow!(
                    "--margin {name} is not a measure or a feature of the task {} with a better side\nHint: use one of {}",
                    task.name,
                    usable.join(", ")
                ))
                .or_usage();
            }
        };
        let grade = match specs.iter().position(|of| of.name == name) {
            Some(at) if task.measure(name).is_none() => Grade::Feature(at, sign),
            _ => Grade::Measure(sign),
        };
        Ok(Self { mode, name: name.to_owned(), grade, foresight })
    }

    /// The margin of an episode: negative infinity for the event, and NaN for an invalid episode.
    fn of(&self, episode: &Episode) -> f64 {
        match &episode.outcome {
            Outcome::Invalid(_) => return f64::NAN,
            Outcome::Failure(found) if self.mode.is_none_or(|mode| mode == *found) => return EVENT,
            Outcome::Failure(_) | Outcome::Success => {}
        }
        match (self.grade, &self.foresight) {
            (Grade::Measure(sign), _) => episode.measures.get(&self.name).map_or(f64::NAN, |x| sign * x),
            (Grade::Feature(at, sign), Some(foresight)) => foresight
                .features(&episode.scenario)
                .ok()
                .and_then(|features| features.get(at).copied())
                .map_or(f64::NAN, |x| sign * x),
            (Grade::Feature(..), None) => f64::NAN,
        }
    }

    /// A margin in the unit of its measure.
    fn shown(&self, margin: f64) -> Option<f64> {
        let (Grade::Measure(sign) | Grade::Feature(_, sign)) = self.grade;
        Some(sign * margin).filter(|x| x.is_finite())
    }
}

/// Why no estimate came about.
enum Stopped {
    Interrupted,
    Failed(Exit),
}

/// Runs the episodes of points.
struct Runner<'a> {
    pool: &'a dyn Executor,
    space: &'a ParameterSpace,
    question: &'a Question,
    done: u64,
    invalid: u64,
    first_fault: Option<String>,
}

impl Runner<'_> {
    /// All have the index 0, because the seed of an episode follows from its index, and points with equal draws have equal seeds.
    fn scenario(&self, point: &Point) -> Scenario {
        let values = self.space.parameters().iter().zip(point.unit()).map(|(parameter, unit)| {
            (Arc::clone(&parameter.name), parameter.domain.decode(parameter.domain.from_unit(unit)))
        });
        Scenario { index: 0, seed: Seed::campaign(point.draw).episode(0), requested: values.collect() }
    }

    fn margins(&mut self, points: &[Point]) -> Result<Vec<f64>, Stopped> {
        let scenarios: Vec<Scenario> = points.iter().map(|point| self.scenario(point)).collect();
        let key = |scenario: &Scenario| format!("{} {:?}", scenario.seed.campaign_number(), scenario.requested);
        let mut found: BTreeMap<String, f64> = BTreeMap::new();
        let mut receive = |episode: Episode| {
            self.done += 1;
            if let Outcome::Invalid(fault) = &episode.outcome {
                self.invalid += 1;
                self.first_fault.get_or_insert_with(|| fault.to_string());
            }
            found.insert(key(&episode.scenario), self.question.of(&episode));
            ControlFlow::Continue(())
        };
        let run = self.pool.execute(&|at| scenarios.get(at).cloned(), &mut receive);
        run.or_broken().map_err(Stopped::Failed)?;
        let margins = scenarios.iter().map(|scenario| found.get(&key(scenario)).copied());
        margins.collect::<Option<Vec<f64>>>().ok_or(Stopped::Interrupted)
    }
}

impl Runner<'_> {
    /// Most of the first episodes must be valid.
    fn check_valid(&self) -> Result<(), Exit> {
        match &self.first_fault {
            Some(fault) if 2 * self.invalid > self.done => Err(anyhow!(
                "{} of the first {} are invalid, one of them because of {fault}\nHint: `robogate run -n 20` with the same options shows them",
                count(self.invalid),
                counted(self.done, "episode")
            ))
            .or_broken(),
            _ => Ok(()),
        }
    }
}

impl RareEvent {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if !(1e-12..=0.5).contains(&self.target) {
            return Err(anyhow!("--target {}: expected a probability from 1e-12 to 0.5", self.target)).or_usage();
        }
        let environment = self.environment.choice().with_policy(&self.policy.choice())?.environment_of(None)?;
        let policy = self.policy.choice().source_at(&self.location.choice())?;
        let subject = Subject::new(environment, policy)?.with_latency(&self.latency.choice())?;
        let space = subject.space(self.space.as_deref()).or_usage()?;
        if !space.correlations().is_empty() {
            return Err(anyhow!(
                "space {}: its parameters are correlated, and subset simulation varies them independently\nHint: use a space without \
                 `correlations`",
                space.name()
            ))
            .or_usage();
        }
        let question = Question::new(&subject, &self.event, self.margin.as_deref())?;
        introduce(&subject.provenance(space.clone())?, self.seed);
        let points = points_per_level(usize::try_from(self.episodes).unwrap_or(usize::MAX), self.target);
        if points < 50 {
            return Err(anyhow!(
                "--episodes {}: a probability of {} needs at least {} for levels of 50 episodes\nHint: raise --episodes or --target",
                self.episodes,
                self.target,
                (50.0 * (1.0 + 0.9 * ((-self.target.log10()).ceil() - 1.0))).ceil()
            ))
            .or_usage();
        }
        note(format_args!(
            "event {} with the margin {}, {} episodes a level, at most {}",
            self.event,
            question.name,
            points,
            count(self.episodes)
        ));
        let plan = Plan {
            dimensions: space.len(),
            draws: true,
            points,
            budget: usize::try_from(self.episodes).unwrap_or(usize::MAX),
            seed: self.seed,
        };
        let answer = self.how.with_workers(|workers| {
            workers.with_pool(&subject, |pool| {
                let mut runner =
                    Runner { pool, space: &space, question: &question, done: 0, invalid: 0, first_fault: None };
                self.answer(&subject, &mut runner, plan)
            })
        })?;
        let Some(answer) = answer else {
            note("stopped: nothing is recorded");
            return Ok(INTERRUPTED);
        };
        if self.how.json {
            line(serde_json::to_string_pretty(&answer).or_broken()?);
        } else {
            print(&answer);
        }
        Ok(if answer.reached && !answer.plain.contradicts { DONE } else { INCONCLUSIVE })
    }

    /// `None` if the user stopped it.
    fn answer(&self, subject: &Subject, runner: &mut Runner<'_>, plan: Plan) -> Result<Option<Answer>, Exit> {
        let mut plain: Vec<f64> = Vec::new();
        let run = subset(plan, |points| {
            let margins = runner.margins(points)?;
            if plain.is_empty() {
                runner.check_valid().map_err(Stopped::Failed)?;
                self.check_grades(runner.question, &margins).map_err(Stopped::Failed)?;
                plain.clone_from(&margins);
            }
            Ok(margins)
        });
        let run = match run {
            Ok(run) => run,
            Err(Stopped::Interrupted) => return Ok(None),
            Err(Stopped::Failed(exit)) => return Err(exit),
        };
        let (episodes, invalid) = (runner.done, runner.invalid);
        let mut so_far = 1.0;
        let levels: Vec<(f64, f64)> = run
            .levels
            .iter()
            .map(|level| {
                so_far *= level.share;
                (level.margin, so_far)
            })
            .collect();
        let check = match self.check {
            0 => None,
            n => match self.plain(runner, plan, n, &levels, &run) {
                Ok((check, margins)) => {
                    plain.extend(margins);
                    Some(check)
                }
                Err(Stopped::Interrupted) => return Ok(None),
                Err(Stopped::Failed(exit)) => return Err(exit),
            },
        };
        let deviation = run.variation.map(|variation| (1.0 + variation * variation).ln().sqrt());
        let interval = deviation.map(|deviation| {
            [-1.0, 1.0].map(|side| (run.probability * (side * Confidence::P95.z() * deviation).exp()).min(1.0))
        });
        let most = interval.filter(|_| run.reached).map_or(run.probability, |[_, high]| high);
        Ok(Some(Answer {
            format: 1,
            event: self.event.clone(),
            margin: runner.question.name.clone(),
            space: runner.space.name().to_owned(),
            policy: subject.policy_name().to_owned(),
            seed: self.seed,
            probability: run.probability,
            reached: run.reached,
            coefficient_of_variation: run.variation,
            interval_95: interval,
            episodes,
            invalid,
            levels: levels
                .iter()
                .map(|(margin, probability)| AnswerLevel {
                    margin: runner.question.shown(*margin),
                    probability: *probability,
                })
                .collect(),
            plain: Plain::of(&plain, most),
            check,
            examples: run.events.iter().take(LISTED).map(|point| runner.scenario(point).requested).collect(),
        }))
    }

    /// Rejects a margin that has few values.
    fn check_grades(&self, question: &Question, margins: &[f64]) -> Result<(), Exit> {
        let finite = margins.iter().filter(|m| m.is_finite());
        let distinct: BTreeSet<u64> = finite.clone().map(|m| m.to_bits()).collect();
        let events = margins.iter().filter(|m| **m == EVENT).count();
        if distinct.len() < FEWEST_MARGINS && 10 * events < margins.len() {
            return Err(anyhow!(
                "--margin {}: {} of {} episodes without the event have {}, so it does not say how near they came to it\nHint: use a \
                 measure with many values",
                question.name,
                finite.count(),
                margins.len() - events,
                counted(distinct.len() as u64, "distinct value")
            ))
            .or_usage();
        }
        Ok(())
    }

    /// Plain episodes, and the deepest level that about ten of them reach.
    fn plain(
        &self,
        runner: &mut Runner<'_>,
        plan: Plan,
        n: u64,
        levels: &[(f64, f64)],
        run: &Rare,
    ) -> Result<(Check, Vec<f64>), Stopped> {
        let own = Plan { points: n as usize, budget: 0, seed: plan.seed.wrapping_add(1), ..plan };
        let mut margins = Vec::new();
        // A run without a budget for further levels consists of plain episodes.
        subset(own, |points| {
            margins = runner.margins(points)?;
            Ok(margins.clone())
        })?;
        let shown = levels.iter().rposition(|(_, probability)| probability * n as f64 >= 10.0).unwrap_or(0);
        let (margin, estimate) = levels.get(shown).copied().unwrap_or((EVENT, run.probability));
        let hits = Trials::count(margins.iter().map(|m| *m <= margin));
        let interval = clopper_pearson(hits, Confidence::P95);
        // The shares of the levels vary independently (Au and Beck 2001).
        let squares: f64 = run.levels.iter().take(shown + 1).map(|level| level.variation.powi(2)).sum();
        let spread = (Confidence::P95.z() * (1.0 + squares).ln().sqrt()).exp();
        let check = Check {
            episodes: hits.n(),
            margin: runner.question.shown(margin),
            happened: hits.successes(),
            interval_95: [interval.low, interval.high],
            estimate,
            estimate_95: [estimate / spread, (estimate * spread).min(1.0)],
            agrees: interval.low <= estimate * spread && estimate / spread <= interval.high,
        };
        Ok((check, margins))
    }
}

fn print(answer: &Answer) {
    let p = |x: f64| significant(x, 2);
    line("");
    if let (true, Some([low, high]), Some(variation)) =
        (answer.reached, answer.interval_95, answer.coefficient_of_variation)
    {
        line(bold(format_args!("P({}) = {} ({} to {}, 95 %)", answer.event, p(answer.probability), p(low), p(high))));
        line(format_args!(
            "  coefficient of variation {}, {}",
            significant(variation, 2),
            counted(answer.episodes, "episode")
        ));
    } else {
        line(bold(format_args!("{} was not reached", answer.event)));
        wrapped(&format!(
            "If a smaller distance by the margin leads to it, its probability is at most about {}. The episodes ended before the event: raise \
             --episodes, or lower --target.",
            p(answer.probability)
        ));
    }
    line(bold("Levels"));
    for (at, level) in answer.levels.iter().enumerate() {
        let margin = level.margin.map_or_else(|| answer.event.clone(), |m| format!("{} {}", answer.margin, number(m)));
        let most = if !answer.reached && at + 1 == answer.levels.len() { "\u{2264} " } else { "" };
        line(format_args!("  {:<10} {margin}", format!("{most}{}", p(level.probability))));
    }
    if let Some(check) = &answer.check {
        line(bold("Check with plain episodes"));
        let at = check.margin.map_or_else(|| answer.event.clone(), |m| format!("{} {}", answer.margin, number(m)));
        line(format_args!(
            "  {at}: {} of {} episodes ({} to {}, 95 %), the estimate is {} ({} to {}): {}",
            count(check.happened),
            count(check.episodes),
            p(check.interval_95[0]),
            p(check.interval_95[1]),
            p(check.estimate),
            p(check.estimate_95[0]),
            p(check.estimate_95[1]),
            if check.agrees { "they agree" } else { "they DISAGREE" }
        ));
    }
    let Plain { episodes, happened, interval_95: [low, high], contradicts } = &answer.plain;
    line(bold("Without the margin"));
    wrapped(&format!(
        "{} of {} plain episodes had the event: between {} and {} (95 %).",
        count(*happened),
        count(*episodes),
        p(*low),
        p(*high)
    ));
    if *contradicts {
        warning(format_args!(
            "the event happens more often than the estimate says: no chain found the way to it, so the estimate is wrong. Hint: choose a \
             margin that becomes worse towards the event"
        ));
    }
    if let (true, Some(example)) = (answer.reached, answer.examples.first()) {
        line(bold("An episode with the event"));
        let shown = |value: &Value| match value {
            Value::Number(x) => number(*x),
            other => other.to_string(),
        };
        let values: Vec<String> = example.iter().map(|(name, value)| format!("{name} {}", shown(value))).collect();
        wrapped(&values.join(", "));
    }
    line("");
    wrapped(
        "The estimate applies to this space and this policy. It comes from one run, whose coefficient of variation does not see ways to the event \
         that no chain found: modes may be missed. Repeat it with another --seed.",
    );
    let share = answer.invalid as f64 / answer.episodes.max(1) as f64;
    if share > INVALID {
        warning(format_args!(
            "{} of {} episodes are invalid and count as far from the event: the probability is too low by up to that share",
            count(answer.invalid),
            count(answer.episodes)
        ));
    }
}
