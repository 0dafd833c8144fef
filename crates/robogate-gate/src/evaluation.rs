//! What the evidence says about each demand, and what follows.
//!
//! **Pass** claims that every demand is met. It is given only where each is shown at error α, so the claim as a whole is
//! wrong with probability α at most, without any adjustment: an intersection-union test (Berger 1982). **Fail** claims that
//! some demand is violated. That is a union of tests, so its error α is shared among them by Holm's procedure. Neither error
//! is a matter of which question was asked first: both are held at once.
//!
//! Where each "met" shall be quotable by itself, [`Family::Holm`] adjusts these too.

use robogate_core::TaskSpec;
use robogate_dictionary::{Label, TaskIdentity};
use robogate_stats::multiplicity::holm;
use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::{Against, Comparison};
use crate::figure::{Extremes, figure};
use crate::requirement_test::{How, test};
use crate::rounds::Rounds;
use crate::scope::{Scope, expand};
use crate::{
    Baseline, Bound, ConfidenceScore, Ending, Family, GateError, Mode, Population, Record, Requirement, Requirements,
    Trial, Verdict,
};

/// How the number of episodes came about: it decides which test is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// It was fixed before the first episode: exact tests, once.
    Fixed,
    /// Somebody looked and decided whether to go on: anytime-valid tests, at the end of each round.
    Sequential,
}

/// What the evidence says about one demand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// It holds.
    Met,
    /// It does not.
    Violated,
    /// Neither is shown.
    Undecided,
    /// There is no evidence about it.
    NoEvidence,
}

impl Status {
    /// The status in data and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::Violated => "violated",
            Self::Undecided => "undecided",
            Self::NoEvidence => "no evidence",
        }
    }
}

/// How many episodes there are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Counts {
    /// All that were judged.
    pub episodes: u64,
    /// Those that say something about the policy.
    pub valid: u64,
    /// Those that say nothing.
    pub invalid: u64,
    /// Whole rounds of the suite among them; absent without a suite.
    pub rounds: Option<u64>,
    /// Episodes after the last whole round, which are not judged.
    pub left_over: u64,
    /// Episodes drawn where success turns into failure, which are not judged.
    pub focused: u64,
}

/// One demand and what the evidence says about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RequirementResult {
    /// Its name in reports: metric and scope.
    pub id: String,
    /// The demand.
    pub requirement: Requirement,
    /// The unit of its metric; empty for rates and counts.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The requirement with its limit as a number.
    pub bound: Bound,
    /// Episodes in its scope that say something about the metric.
    pub valid: u64,
    /// Episodes in its scope that say nothing about it: invalid ones, and failures in a way that was not recorded.
    pub invalid: u64,
    /// The figure.
    pub figure: Extremes,
    /// The true figure lies above the lower and below the upper end, each at the requirements' confidence, whatever the
    /// invalid episodes could have been; absent in point mode and for quantiles.
    pub interval: Option<[f64; 2]>,
    /// p-value against "it is not met", for the worst that invalid episodes could have been; absent in point mode.
    pub p_met: Option<f64>,
    /// p-value against "it is met", for the best that they could have been; absent in point mode.
    pub p_violated: Option<f64>,
    /// What follows.
    pub status: Status,
    /// Episodes of the whole run at which it would be decided if all went as so far; absent where it is decided, or where
    /// no sensible number would do.
    pub decided_at_episodes: Option<u64>,
}

/// Success by scenario group, for reading; it decides nothing by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupResult {
    /// The category; empty where the episodes have none.
    pub category: String,
    /// The group; empty where the episodes have none.
    pub group: String,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes.
    pub invalid: u64,
    /// Successes.
    pub successes: u64,
    /// Exact (Clopper-Pearson) 95 % interval for the success rate, as if the number of episodes had been fixed.
    pub interval_95: [f64; 2],
    /// How the others ended, the commonest first.
    pub endings: Vec<EndingCount>,
}

/// How often episodes ended in one way.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EndingCount {
    /// A failure mode, `failure` where it is not known, or `invalid`.
    pub ending: String,
    /// Episodes.
    pub episodes: u64,
}

/// Everything that the gate found: one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Version of this form.
    pub format: u32,
    /// The answer.
    pub verdict: Verdict,
    /// Why, in a sentence.
    pub because: String,
    /// The task.
    pub task: TaskIdentity,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// Identity of the rows (SHA-256, hex).
    pub dataset_sha256: String,
    /// What the figures speak of.
    pub population: Population,
    /// What a figure is, in a sentence.
    pub estimand: String,
    /// How the number of episodes came about.
    pub sampling: Sampling,
    /// How many there are.
    pub counts: Counts,
    /// What was demanded.
    pub requirements: Requirements,
    /// What relative demands referred to.
    pub baseline: Option<Baseline>,
    /// What the evidence says about each demand.
    #[serde(alias = "findings")]
    pub results: Vec<RequirementResult>,
    /// Whether it may replace another policy, where that was asked.
    pub comparison: Option<Comparison>,
    /// Success by scenario group.
    pub groups: Vec<GroupResult>,
    /// The confidence score; absent where the requirements have none.
    pub score: Option<ConfidenceScore>,
    /// Episodes in all at which the gate would answer if all went as so far; absent where it has answered, or where no
    /// sensible number would do.
    pub decided_at_episodes: Option<u64>,
}

/// What is asked of a record.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// What is demanded.
    pub requirements: &'a Requirements,
    /// What relative demands refer to.
    pub baseline: Option<&'a Baseline>,
    /// The policy that may be replaced.
    pub against: Option<Against<'a>>,
    /// How the number of episodes came about, as far as the record does not say otherwise ([`Record::sampling`]).
    pub sampling: Sampling,
}

impl Evaluation {
    /// The version of the form.
    pub const FORMAT: u32 = 2;

    /// As a file holds it: the same evaluation gives the same bytes.
    pub fn to_json(&self) -> String {
        // Every number in it is finite: nothing here can fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

impl Question<'_> {
    /// The answer: the same record gives the same evaluation, to the bit.
    ///
    /// # Errors
    /// Where the question cannot be asked of this record: a baseline of another suite, a scope that no episode has, a
    /// demand that can't be met at any number of episodes.
    pub fn evaluate(&self, record: &Record) -> Result<Evaluation, GateError> {
        let requirements = self.requirements;
        requirements.check()?;
        let record = &*requirements.fit(record)?;
        if let Some(baseline) = self.baseline {
            baseline.check(&record.population)?;
        }
        let sampling = record.sampling(self.sampling);
        let rounds = Rounds::of(&record.trials, &record.population)?;
        let valid = rounds.trials().filter(|trial| trial.ending.is_valid()).count() as u64;
        let episodes = rounds.trials().count() as u64;
        let counts = Counts {
            episodes,
            valid,
            invalid: episodes - valid,
            rounds: rounds.suite.then_some(rounds.rounds.len() as u64),
            left_over: rounds.left_over,
            focused: record.focused,
        };
        let comparison = self.against.as_ref().map(|against| against.compare(record, sampling)).transpose()?;
        let mut results = Vec::new();
        for requirement in &requirements.requirement {
            for one in expand(requirement, rounds.trials().map(|trial| &trial.label))? {
                results.push(one);
            }
        }
        let alpha = requirements.alpha();
        // A comparison is one demand more.
        let family = results.len() + usize::from(comparison.is_some());
        let how = How {
            sampling,
            alpha,
            beta: alpha / family.max(1) as f64,
            suite: rounds.suite,
            steps: counts.rounds.unwrap_or(episodes),
        };
        let mut results = results
            .into_iter()
            .map(|requirement| self.result(requirement, &record.task, &rounds, counts, how))
            .collect::<Result<Vec<RequirementResult>, GateError>>()?;
        let mut comparison = comparison;
        self.decide(&mut results, comparison.as_mut(), alpha);
        let (verdict, because) = conclude(counts, &results, comparison.as_ref());
        let decided_at_episodes = when(verdict, &results);
        Ok(Evaluation {
            format: Evaluation::FORMAT,
            verdict,
            because,
            task: TaskIdentity::of(&record.task),
            robot: record.robot.clone(),
            policy: record.policy.clone(),
            dataset_sha256: record.dataset_sha256.clone(),
            population: record.population.clone(),
            estimand: record.population.estimand(),
            sampling,
            counts,
            requirements: requirements.clone(),
            baseline: self.baseline.cloned(),
            results,
            comparison,
            groups: groups(rounds.trials()),
            score: ConfidenceScore::of(&requirements.score, self.baseline, rounds.rounds.iter().flatten().copied()),
            decided_at_episodes,
        })
    }

    fn result(
        &self,
        requirement: Requirement,
        task: &TaskSpec,
        rounds: &Rounds<'_>,
        counts: Counts,
        how: How,
    ) -> Result<RequirementResult, GateError> {
        let mode = self.requirements.mode;
        let id = requirement.id();
        let bound = requirement.bound(mode, self.baseline)?;
        let scope = Scope::of(&requirement);
        let scoped: Vec<Vec<&Trial>> = rounds
            .rounds
            .iter()
            .map(|round| round.iter().copied().filter(|trial| scope.holds(trial)).collect())
            .collect();
        let all = scoped.iter().flatten().copied();
        if counts.episodes > 0 && all.clone().next().is_none() {
            return Err(GateError::NoSuchScope { id, scope: scope.to_string(), known: known(rounds.trials()) });
        }
        let (valid, invalid, figure) = figure(requirement.metric, all, requirement.range());
        let mut result = RequirementResult {
            id,
            unit: requirement.metric.unit(task),
            requirement,
            bound,
            valid,
            invalid,
            figure,
            interval: None,
            p_met: None,
            p_violated: None,
            status: if valid == 0 { Status::NoEvidence } else { Status::Undecided },
            decided_at_episodes: None,
        };
        if valid == 0 {
            return Ok(result);
        }
        match mode {
            Mode::Point => {
                let ends = [figure.least.unwrap_or(f64::NEG_INFINITY), figure.most.unwrap_or(f64::INFINITY)]
                    .map(|end| bound.holds(end));
                result.status = match ends {
                    [true, true] => Status::Met,
                    [false, false] => Status::Violated,
                    _ => Status::Undecided,
                };
            }
            Mode::Confidence => {
                let tested = test(&result.requirement, bound, &scoped, how)?;
                result.interval = tested.interval;
                result.p_met = Some(tested.p_met);
                result.p_violated = Some(tested.p_violated);
                let per_step = counts.episodes as f64 / how.steps.max(1) as f64;
                result.decided_at_episodes =
                    tested.decided_at_steps.map(|steps| (steps as f64 * per_step).round() as u64);
            }
        }
        Ok(result)
    }

    /// From p-values to answers, over the whole family.
    fn decide(&self, results: &mut [RequirementResult], comparison: Option<&mut Comparison>, alpha: f64) {
        let other = comparison.as_ref().map(|c| (c.p_met, c.p_violated));
        let point = self.requirements.mode == Mode::Point;
        let met: Vec<f64> = results.iter().map(|f| f.p_met.unwrap_or(1.0)).chain(other.map(|o| o.0)).collect();
        let violated: Vec<f64> =
            results.iter().map(|f| f.p_violated.unwrap_or(1.0)).chain(other.map(|o| o.1)).collect();
        // These are p-values by construction; were one not, nothing would be rejected.
        let adjusted = |p: &[f64]| holm(p).unwrap_or_else(|_| vec![1.0; p.len()]);
        let met = if self.requirements.family == Family::Holm { adjusted(&met) } else { met };
        let violated = adjusted(&violated);
        let status = |i: usize| {
            let below = |p: &[f64]| p.get(i).is_some_and(|p| *p <= alpha);
            // Where both are rejected a premise does not hold; the careful answer is taken.
            if below(&violated) {
                Status::Violated
            } else if below(&met) {
                Status::Met
            } else {
                Status::Undecided
            }
        };
        let last = results.len();
        for (i, result) in results.iter_mut().enumerate() {
            if !point && result.status != Status::NoEvidence {
                result.status = status(i);
            }
            if result.status != Status::Undecided {
                result.decided_at_episodes = None;
            }
        }
        if let Some(comparison) = comparison
            && comparison.status != Status::NoEvidence
        {
            comparison.status = status(last);
        }
    }
}

fn conclude(counts: Counts, results: &[RequirementResult], comparison: Option<&Comparison>) -> (Verdict, String) {
    if counts.episodes == 0 {
        let because = if counts.left_over > 0 {
            format!("{} episodes are no whole round of the suite", counts.left_over)
        } else {
            "nothing was evaluated".to_owned()
        };
        return (Verdict::Invalid, because);
    }
    if counts.valid == 0 {
        return (Verdict::Invalid, format!("all {} episodes are invalid", counts.invalid));
    }
    let all: Vec<(&str, Status)> = results
        .iter()
        .map(|f| (f.id.as_str(), f.status))
        .chain(comparison.map(|c| (Comparison::ID, c.status)))
        .collect();
    let of =
        |status: Status| -> Vec<&str> { all.iter().filter(|(_, found)| *found == status).map(|(id, _)| *id).collect() };
    let (violated, open, none) = (of(Status::Violated), of(Status::Undecided), of(Status::NoEvidence));
    if !violated.is_empty() {
        (Verdict::Fail, format!("violated: {}", violated.join(", ")))
    } else if !none.is_empty() {
        (Verdict::Inconclusive, format!("no evidence about {}", none.join(", ")))
    } else if open.is_empty() && !all.is_empty() {
        (Verdict::Pass, format!("all {} requirements are met", all.len()))
    } else {
        (Verdict::Inconclusive, format!("undecided: {}", open.join(", ")))
    }
}

/// When the gate would answer: at the first violation in sight, or once the last demand is met.
fn when(verdict: Verdict, results: &[RequirementResult]) -> Option<u64> {
    if verdict != Verdict::Inconclusive {
        return None;
    }
    let towards_fail =
        |f: &&RequirementResult| f.status == Status::Undecided && f.figure.observed.is_some_and(|x| !f.bound.holds(x));
    let failing = results.iter().filter(towards_fail).filter_map(|f| f.decided_at_episodes).min();
    let open: Vec<&RequirementResult> = results.iter().filter(|f| f.status != Status::Met).collect();
    failing.or_else(|| {
        let all: Option<Vec<u64>> = open.iter().map(|f| f.decided_at_episodes).collect();
        all?.into_iter().max()
    })
}

/// The categories and groups there are.
pub(crate) fn known<'a>(trials: impl Iterator<Item = &'a Trial>) -> String {
    let mut words: Vec<String> = Vec::new();
    for Label { category, group, .. } in trials.map(|trial| &trial.label) {
        let parts: Vec<&str> = [category, group].into_iter().flatten().map(String::as_str).collect();
        let word = parts.join("/");
        if !word.is_empty() && !words.contains(&word) {
            words.push(word);
        }
    }
    if words.is_empty() {
        "no categories or groups: these are not episodes of a suite".to_owned()
    } else {
        words.join(", ")
    }
}

fn groups<'a>(trials: impl Iterator<Item = &'a Trial>) -> Vec<GroupResult> {
    let mut found: Vec<(&Label, Vec<&Trial>)> = Vec::new();
    for trial in trials {
        let label = &trial.label;
        if label.category.is_none() && label.group.is_none() {
            continue;
        }
        let same = |(known, _): &&mut (&Label, Vec<&Trial>)| {
            (&known.category, &known.group) == (&label.category, &label.group)
        };
        match found.iter_mut().find(same) {
            Some((_, trials)) => trials.push(trial),
            None => found.push((label, vec![trial])),
        }
    }
    found.into_iter().map(|(label, trials)| group(label, &trials)).collect()
}

fn group(label: &Label, trials: &[&Trial]) -> GroupResult {
    let valid = trials.iter().filter(|trial| trial.ending.is_valid()).count() as u64;
    let successes = trials.iter().filter(|trial| trial.ending == Ending::Success).count() as u64;
    let interval = clopper_pearson(Trials::new(successes, valid).unwrap_or(Trials::NONE), Confidence::P95);
    GroupResult {
        category: label.category.clone().unwrap_or_default(),
        group: label.group.clone().unwrap_or_default(),
        valid,
        invalid: trials.len() as u64 - valid,
        successes,
        interval_95: [interval.low, interval.high],
        endings: endings(trials),
    }
}

/// How trials ended that did not succeed, the commonest first.
pub(crate) fn endings(trials: &[&Trial]) -> Vec<EndingCount> {
    let mut endings: Vec<EndingCount> = Vec::new();
    for word in trials.iter().filter(|trial| trial.ending != Ending::Success).map(|trial| trial.ending.as_str()) {
        match endings.iter_mut().find(|known| known.ending == word) {
            Some(known) => known.episodes += 1,
            None => endings.push(EndingCount { ending: word.to_owned(), episodes: 1 }),
        }
    }
    endings.sort_by(|a, b| b.episodes.cmp(&a.episodes).then_with(|| a.ending.cmp(&b.ending)));
    endings
}
