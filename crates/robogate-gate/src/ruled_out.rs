//! Whether the invalid episodes of a gate, or its trials of the real robot, rule out a pass.
//!
//! A pass must hold for the worst outcome of each invalid episode, so enough of them make it impossible. Trials of the real robot
//! that do not show their requirement to be met make it impossible too, because no simulated episode changes them. Then the
//! remaining rounds cannot give a pass, and a gate stops unless they are expected to show a violation:
//!
//! - A requirement is ruled out if it is not shown to be met although all other episodes, those of the past included, are as good
//!   as possible and all planned rounds run.
//! - A violation is expected if some requirement is violated once the rounds so far are repeated until all planned rounds have run.
//!
//! Both are evaluated with the exact and with the sequential test, so that the answer does not depend on how the number of
//! episodes was chosen. A gate without a valid episode after its first rounds stops in any case.

use robogate_core::{Fault, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::evaluation::Question;
use crate::figure::STAGE_SHARE;
use crate::requirement_test::How;
use crate::rounds::Rounds;
use crate::{
    Bound, Comparison, Counts, Ending, GateError, Metric, Mode, Population, Production, Record, Requirement,
    RequirementResult, Sampling, Sense, Status, Trial,
};

/// Number of episodes without a valid one that stop a gate.
const ALL_INVALID: u64 = 10;

/// Why no further episode can give a pass: invalid episodes, or the trials of the real robot. Trials have no fault.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RuledOut {
    /// Number of episodes in the plan.
    pub planned: u64,
    /// The first requirement that cannot be met any more. `None` if no episode is valid.
    pub requirement: Option<String>,
    /// What makes the episodes invalid. `None` if the trials of the real robot rule out a pass.
    #[serde(flatten)]
    pub fault: Option<FrequentFault>,
}

/// The most frequent kind of fault.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FrequentFault {
    /// The most frequent fault, as its first episode reports it. The episodes of a policy that may be replaced count as well.
    pub fault: String,
    /// Number of invalid episodes with a fault of this kind.
    pub with_fault: u64,
    /// The index of the first of them.
    pub first: u64,
}

impl RuledOut {
    /// The reason for the verdict, in one sentence.
    pub(crate) fn because(&self, counts: Counts, comparison: Option<&Comparison>) -> String {
        let Counts { episodes, mut invalid, .. } = counts;
        let rest = self.planned.saturating_sub(episodes);
        let Some(id) = &self.requirement else {
            return format!("all {episodes} episodes are invalid; the other {rest} planned episodes did not run");
        };
        if self.fault.is_none() {
            return format!(
                "the trials of the real robot do not show `{id}`: no result of the other {rest} planned episodes could change that"
            );
        }
        let mut what = "episodes";
        if let Some(comparison) = comparison.filter(|_| id == Comparison::ID) {
            (invalid, what) = (comparison.invalid, "pairs of episodes");
        }
        let are = if invalid == 1 { "is" } else { "are" };
        format!(
            "{invalid} of {episodes} {what} {are} invalid: no result of the other {rest} planned {what} could meet `{id}`"
        )
    }
}

impl Question<'_> {
    /// Whether invalid episodes or the trials of the real robot rule out a pass in the planned rounds of a suite, and no
    /// violation is expected. `results` are those of the requirements on the rounds so far.
    pub(crate) fn ruled_out(
        &self,
        record: &Record,
        rounds: &Rounds<'_>,
        results: &[RequirementResult],
        how: How,
    ) -> Result<Option<RuledOut>, GateError> {
        let (Population::Suite { cases, .. }, Some(planned)) = (&record.population, record.planned) else {
            return Ok(None);
        };
        let episodes = rounds.trials().count() as u64;
        let others = self.against.iter().flat_map(|against| &against.record.trials);
        let fault = most_frequent_fault(rounds.trials().chain(others));
        let unmet = results.iter().find(|result| self.is_unmet_by_trials(result, how)).map(|result| result.id.clone());
        if (fault.is_none() && unmet.is_none()) || episodes == 0 || episodes >= planned || rounds.left_over > 0 {
            return Ok(None);
        }
        if episodes >= ALL_INVALID && rounds.trials().all(|trial| !trial.ending.is_valid()) {
            return Ok(fault.map(|fault| RuledOut { planned, requirement: None, fault: Some(fault) }));
        }
        let suite = Whole { question: self, task: &record.task, rounds, planned: planned / (*cases).max(1), how };
        let pairs = match &self.against {
            Some(against) => against.extremes(record)?,
            None => None,
        };
        let ruled_out = match (unmet, fault) {
            (Some(id), _) => Some(RuledOut { planned, requirement: Some(id), fault: None }),
            (None, Some(fault)) => {
                let lost = suite.first_lost(results, pairs.as_ref(), episodes)?;
                lost.map(|id| RuledOut { planned, requirement: Some(id), fault: Some(fault) })
            }
            (None, None) => None,
        };
        if ruled_out.is_none() || pairs.is_some_and(|[_, same]| same.p_violated <= how.alpha) {
            return Ok(None);
        }
        for result in results {
            if suite.is_violated_soon(&result.requirement)? {
                return Ok(None);
            }
        }
        Ok(ruled_out)
    }

    /// Whether the trials of the real robot leave a requirement undecided or violate it. The number of simulated episodes has
    /// no effect on that. Without trials there is no evidence, which is stated as such.
    fn is_unmet_by_trials(&self, result: &RequirementResult, how: How) -> bool {
        let met = match self.requirements.mode {
            Mode::Point => result.status == Status::Met,
            // With Holm's procedure, the status of one requirement also depends on the others.
            Mode::Confidence => result.p_met.is_some_and(|p| p <= how.alpha),
        };
        result.requirement.metric == Metric::RealSuccess && result.status != Status::NoEvidence && !met
    }
}

/// The rounds so far as part of all planned ones.
struct Whole<'a> {
    question: &'a Question<'a>,
    task: &'a TaskSpec,
    rounds: &'a Rounds<'a>,
    /// Number of planned rounds.
    planned: u64,
    how: How,
}

impl Whole<'_> {
    /// The first requirement or comparison that the invalid episodes rule out.
    fn first_lost(
        &self,
        results: &[RequirementResult],
        pairs: Option<&[Comparison; 2]>,
        episodes: u64,
    ) -> Result<Option<String>, GateError> {
        for result in results {
            if !self.can_be_met(&result.requirement)? {
                return Ok(Some(result.id.clone()));
            }
        }
        let Some([best, same]) = pairs else { return Ok(None) };
        let none = episodes >= ALL_INVALID && same.status == Status::NoEvidence;
        Ok((none || best.p_met > self.how.alpha).then(|| Comparison::ID.to_owned()))
    }

    /// Whether the requirement is met if all episodes that are not invalid are as good as possible.
    fn can_be_met(&self, requirement: &Requirement) -> Result<bool, GateError> {
        let bound = requirement.bound(self.question.requirements.mode, self.question.baseline)?;
        let Some(good) = Good::of(requirement, bound) else { return Ok(true) };
        let trials: Vec<Vec<Trial>> = self.all(|trial, happened| good.instead_of(trial, happened));
        Ok(self.results(requirement, &trials)?.iter().any(|result| match self.question.requirements.mode {
            Mode::Point => result.status == Status::Met,
            Mode::Confidence => result.p_met.is_some_and(|p| p <= self.how.alpha),
        }))
    }

    /// Whether the requirement is violated if the rounds so far repeat themselves.
    fn is_violated_soon(&self, requirement: &Requirement) -> Result<bool, GateError> {
        // Episodes do not decide it.
        if requirement.metric == Metric::RealSuccess {
            return Ok(false);
        }
        let trials = self.all(|trial, _| trial.clone());
        Ok(self.results(requirement, &trials)?.iter().any(|result| match self.question.requirements.mode {
            Mode::Point => result.status == Status::Violated,
            Mode::Confidence => result.p_violated.is_some_and(|p| p <= self.how.alpha),
        }))
    }

    /// All planned rounds: those so far in turns, changed by `with`, which also gets whether the episode happened.
    fn all(&self, with: impl Fn(&Trial, bool) -> Trial) -> Vec<Vec<Trial>> {
        let so_far = &self.rounds.rounds;
        let planned = usize::try_from(self.planned).unwrap_or(usize::MAX);
        let rounds = so_far.iter().cycle().take(planned).enumerate();
        rounds.map(|(at, round)| round.iter().map(|trial| with(trial, at < so_far.len())).collect()).collect()
    }

    /// The results of both tests of the requirement on these rounds.
    fn results(&self, requirement: &Requirement, trials: &[Vec<Trial>]) -> Result<Vec<RequirementResult>, GateError> {
        let rounds: Vec<Vec<&Trial>> = trials.iter().map(|round| round.iter().collect()).collect();
        let episodes = rounds.iter().map(Vec::len).sum::<usize>() as u64;
        let rounds = Rounds { rounds, left_over: 0, suite: true };
        let counts = Counts { episodes, ..Counts::default() };
        [Sampling::Fixed, Sampling::Sequential]
            .into_iter()
            .map(|sampling| {
                let how = How { sampling, ..self.how };
                self.question.result(requirement.clone(), self.task, &rounds, counts, how)
            })
            .collect()
    }
}

/// An episode that is as good as possible for a requirement.
struct Good {
    metric: Metric,
    ending: Ending,
    value: Option<f64>,
}

impl Good {
    /// `None` if the best value is unknown, or if episodes do not decide the requirement.
    fn of(requirement: &Requirement, bound: Bound) -> Option<Self> {
        let metric = requirement.metric;
        let least = bound.sense == Sense::AtLeast;
        let ending = match metric {
            Metric::RealSuccess => return None,
            Metric::Success if !least => Ending::Failure(None),
            Metric::Failure(mode) | Metric::FailureCount(mode) if least => Ending::Failure(Some(mode)),
            _ => Ending::Success,
        };
        let value = match metric {
            Metric::Stage => Some(if least { 1.0 } else { 0.0 }),
            Metric::CycleTime(_) | Metric::Measure(..) if metric.is_mean() => {
                let [floor, ceiling] = requirement.range();
                Some(if least { ceiling? } else { floor? })
            }
            // The limit of a quantile itself satisfies it.
            Metric::CycleTime(_) | Metric::Measure(..) | Metric::TimeToSuccess(_) => Some(bound.limit),
            Metric::Production(Production::TimeBetweenAssists) => requirement.ceiling,
            Metric::Production(_) => Some(0.0),
            _ => None,
        };
        Some(Self { metric, ending, value })
    }

    /// The good episode in place of this one. An invalid episode that happened stays invalid.
    fn instead_of(&self, trial: &Trial, happened: bool) -> Trial {
        let mut good = trial.clone();
        if happened && !trial.ending.is_valid() {
            return good;
        }
        good.ending.clone_from(&self.ending);
        good.unseen.clear();
        good.forces.iter_mut().for_each(|(_, exceeded)| *exceeded = Some(false));
        match (self.metric, self.value) {
            (Metric::CycleTime(_) | Metric::TimeToSuccess(_) | Metric::Production(_), value) => good.time_s = value,
            (Metric::Measure(name, _), value) => good.measures.set(name, value),
            (Metric::Stage, value) => good.measures.set(STAGE_SHARE, value),
            _ => {}
        }
        good
    }
}

fn most_frequent_fault<'a>(trials: impl Iterator<Item = &'a Trial>) -> Option<FrequentFault> {
    let mut kinds: Vec<(&Fault, u64, u64)> = Vec::new();
    for trial in trials {
        let Ending::Invalid(fault) = &trial.ending else { continue };
        match kinds.iter_mut().find(|(known, ..)| known.kind == fault.kind) {
            Some((_, episodes, _)) => *episodes += 1,
            None => kinds.push((fault, 1, trial.index)),
        }
    }
    // The first of several equally frequent ones.
    let (fault, with_fault, first) = kinds.into_iter().rev().max_by_key(|(_, episodes, _)| *episodes)?;
    Some(FrequentFault { fault: fault.to_string(), with_fault, first })
}
