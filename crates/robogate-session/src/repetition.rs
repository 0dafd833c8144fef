//! Whether episodes repeat: a few run twice, in two processes of the environment and in two orders.

use std::num::NonZeroUsize;
use std::path::Path;

use anyhow::Context;
use robogate_campaign::Worker;
use robogate_core::{Action, Assignment, FailureMode, Fault, FaultKind, Observation, Scenario, Seed, Start, Step};
use robogate_dictionary::files;
use robogate_gate::{REPEATED, Repeats};
use robogate_tasks::Random;

use crate::failure::{Failure, OrFailure};
use crate::first_episodes::FirstEpisodes;
use crate::notice::{note, warning};
use crate::policy_source::PolicySource;
use crate::subject::{EnvironmentSource, RemoteSource, Subject};

/// Number of episodes that run twice. More do so until one of a policy succeeds: a cause that prevents successes shows only there.
const FEWEST: usize = 4;
/// Number of control periods of an episode with random actions.
const RANDOM_PERIODS: usize = 100;

/// An episode as far as it must repeat.
#[derive(Debug)]
pub(crate) struct Seen {
    /// The first observation, and the parameters that were read back.
    start: (Observation, Assignment),
    actions: Vec<Action>,
    states: Vec<u64>,
    /// The failure mode, `None` for a success. `None` if the episode was cut short.
    ending: Option<Option<FailureMode>>,
    /// Whether its policy wanted other actions than those that it was given.
    other_actions: bool,
}

type Episode = Result<Seen, Fault>;

impl Seen {
    /// An episode before its first action.
    pub(crate) fn start(start: &Start) -> Self {
        let start = (start.observation.clone(), start.applied.clone());
        Self { start, actions: Vec::new(), states: Vec::new(), ending: None, other_actions: false }
    }

    pub(crate) fn is_success(&self) -> bool {
        self.ending == Some(None)
    }

    /// Adds a control period.
    pub(crate) fn add(&mut self, action: &Action, step: &Step) {
        self.actions.push(action.clone());
        self.states.push(step.state_hash);
        self.ending = step.ending.as_ref().map(|ending| ending.failure);
    }

    fn is_like(&self, other: &Self) -> bool {
        self.start == other.start && self.states == other.states && self.ending == other.ending
    }

    /// Whether outcome or duration differ, by more than a tenth.
    fn ends_like(&self, other: &Self) -> bool {
        let (one, two) = (self.states.len(), other.states.len());
        self.ending == other.ending && one.abs_diff(two) <= 1 + one.max(two) / 10
    }
}

/// Whether both episodes are equal. One that could not run says nothing.
fn are_equal(one: &Episode, two: &Episode) -> bool {
    match (one, two) {
        (Ok(one), Ok(two)) => one.is_like(two),
        (Err(one), Err(two)) => one.kind == two.kind,
        (Ok(_), Err(fault)) | (Err(fault), Ok(_)) => fault.kind == FaultKind::Unavailable,
    }
}

/// How many of these episodes were different the second time.
fn differences(once: &[Episode], twice: &[Episode]) -> Repeats {
    let mut found = Repeats::default();
    for (one, two) in once.iter().zip(twice) {
        let different = !are_equal(one, two);
        match (one, two) {
            (Ok(one), Ok(two)) => {
                found.episodes += 1;
                let start = one.start != two.start;
                found.other_start += u64::from(start);
                found.other_trajectory += u64::from(different && !start);
                found.other_ending += u64::from(different && !start && !one.ends_like(two));
                found.other_actions += u64::from(!different && two.other_actions);
            }
            _ if different => {
                found.episodes += 1;
                found.other_trajectory += 1;
                found.other_ending += 1;
            }
            _ => {}
        }
    }
    found
}

/// Another order of this many episodes: neither all positions nor all distances of an episode are multiples of the same number, so
/// that a counter shows.
fn other_order(episodes: usize) -> Vec<usize> {
    let (odd, even): (Vec<usize>, Vec<usize>) = (0..episodes).partition(|at| at % 2 == 1);
    [odd, even].concat()
}

/// Whether these episodes are equal.
fn all_equal(again: &[Episode], before: &[Episode]) -> bool {
    again.iter().zip(before).all(|(a, b)| are_equal(a, b))
}

impl Subject {
    /// Runs the first episodes of a gate again, in a process that has run others since, and writes what was different into the folder
    /// of the run. A server that is not available any more is a note.
    pub(crate) fn repeat_first_episodes(&self, run: &Path) -> Result<(), Failure> {
        let first = self.first_episodes().map(FirstEpisodes::take).unwrap_or_default();
        let EnvironmentSource::Remote(source) = self.environment_source() else { return Ok(()) };
        if first.is_empty() {
            return Ok(());
        }
        note("repeating the first episodes after the last one");
        let (scenarios, once): (Vec<Scenario>, Vec<Episode>) =
            first.into_iter().map(|(scenario, seen)| (scenario, Ok(seen))).unzip();
        let policy = match self.policy_source() {
            Some(PolicySource::Declared(declared)) => Some(&*declared.environment),
            _ => None,
        };
        let repetition = Repetition { subject: self, source, scenarios: &scenarios, policy };
        let mut worker = repetition.any_worker()?;
        let order = other_order(once.len());
        let twice = repetition.episodes(&mut worker, &order, &once);
        if let Some(fault) = twice.iter().find_map(|episode| episode.as_ref().err())
            && fault.kind == FaultKind::Unavailable
        {
            note(format_args!("the first episodes could not be repeated: {fault}"));
            return Ok(());
        }
        let mut found = differences(&once, &twice);
        // Another policy gave the actions, or none.
        found.other_actions = 0;
        found.systematic =
            found.other_ending > 0 && all_equal(&repetition.episodes(&mut worker, &order, &once), &twice);
        found.failure().iter().for_each(warning);
        let text = serde_json::to_string_pretty(&found).or_broken()?;
        let about = || format!("cannot write {}", run.join(REPEATED).display());
        files::write(run.join(REPEATED), text).with_context(about).or_broken()
    }
}

/// Runs some of these scenarios twice, the second time in another order and, if this process starts the environment, in a process that
/// has run no episode. `None` for an environment that is built in, and if no episode could be compared.
///
/// A policy of the environment acts in full episodes: that of the subject, otherwise the first. Without one the actions are random. The
/// second time, the actions are those of the first time, so a policy that does not repeat itself makes no difference.
///
/// # Errors
/// A process that does not start.
pub fn repeats(subject: &Subject, scenarios: &[Scenario]) -> Result<Option<Repeats>, Failure> {
    let EnvironmentSource::Remote(source) = subject.environment_source() else { return Ok(None) };
    note("repeating a few episodes in another order");
    let policy = match subject.policy_source() {
        Some(PolicySource::Declared(declared)) => Some(&*declared.environment),
        _ => source.pool.hello().policies.first().map(|policy| &*policy.name),
    };
    let with_policy = Repetition { subject, source, scenarios, policy };
    let found = if policy.is_some() { with_policy.run()? } else { None };
    if found.is_some() { Ok(found) } else { Repetition { policy: None, ..with_policy }.run() }
}

/// The episodes that run twice.
#[derive(Clone, Copy)]
struct Repetition<'a> {
    subject: &'a Subject,
    source: &'a RemoteSource,
    scenarios: &'a [Scenario],
    /// The policy of the environment. `None`: random actions.
    policy: Option<&'a str>,
}

impl Repetition<'_> {
    /// Compares the episodes in both orders. `None` if none ran in both.
    fn run(&self) -> Result<Option<Repeats>, Failure> {
        let mut first = self.worker(1)?;
        if first.policy.check(first.environment.task()).is_err() {
            return Ok(None);
        }
        let mut once: Vec<Episode> = Vec::new();
        for scenario in self.scenarios {
            let succeeded = |seen: &Episode| seen.as_ref().is_ok_and(Seen::is_success);
            if once.len() >= FEWEST && (self.policy.is_none() || once.iter().any(succeeded)) {
                break;
            }
            once.push(self.episode(&mut first, scenario, None));
        }
        let other_order = other_order(once.len());
        let _kept = self.kept(first);
        let mut second = self.worker(2)?;
        let twice = self.episodes(&mut second, &other_order, &once);
        let mut found = Repeats { fresh_process: self.source.pool.len() > 1, ..differences(&once, &twice) };
        if found.other_start == 0 && found.other_ending > 0 {
            found.systematic = self.comes_again(second, &other_order, &once, &twice)?;
        } else if let (None, Some(scenario), Some(Ok(seen))) = (found.unpaired(), self.scenarios.first(), once.first())
        {
            let seed = Seed::campaign(scenario.seed.campaign_number().wrapping_add(1)).episode(scenario.index);
            let other = Scenario { seed, ..scenario.clone() };
            let other = self.episode(&mut second, &other, Some(&seen.actions));
            found.seeds_without_effect = other.is_ok_and(|other| other.is_like(seen));
        }
        Ok((found.episodes > 0).then_some(found))
    }

    /// Whether the episodes are again those of the first time in the first order, or those of the second time in the same process.
    fn comes_again(
        &self,
        mut second: Worker,
        other_order: &[usize],
        once: &[Episode],
        twice: &[Episode],
    ) -> Result<bool, Failure> {
        if all_equal(&self.episodes(&mut second, other_order, once), twice) {
            return Ok(true);
        }
        if self.source.launched.is_none() {
            return Ok(false);
        }
        let _kept = self.kept(second);
        let order: Vec<usize> = (0..once.len()).collect();
        Ok(all_equal(&self.episodes(&mut self.worker(3)?, &order, once), once))
    }

    /// A worker whose environment is the process of this number, as long as those before are kept.
    fn worker(&self, number: usize) -> Result<Worker, Failure> {
        if let (true, Some(processes)) = (self.source.launched.is_some(), NonZeroUsize::new(number.max(2))) {
            self.subject.start_servers(processes)?;
        }
        self.any_worker()
    }

    /// A worker whose environment is any process that is free.
    fn any_worker(&self) -> Result<Worker, Failure> {
        if let Some(policy) = self.policy {
            return self.source.in_step(policy).or_broken();
        }
        let environment = self.subject.environment_source().environment().or_broken()?;
        Ok(Worker { environment, policy: Box::new(Random::new()) })
    }

    /// Keeps the process of a worker, so that the next worker has another one. `None` if there is only one process.
    fn kept(&self, mut worker: Worker) -> Option<Worker> {
        let scenario = self.scenarios.first().filter(|_| self.source.pool.len() > 1)?;
        // It keeps its server while an episode runs.
        let _ = worker.environment.reset(scenario);
        Some(worker)
    }

    /// Runs the scenarios in this order with the actions of these episodes. Returns the episodes in the order of the scenarios.
    fn episodes(&self, worker: &mut Worker, order: &[usize], given: &[Episode]) -> Vec<Episode> {
        let mut episodes: Vec<(usize, Episode)> = Vec::with_capacity(order.len());
        for &at in order {
            let Some(scenario) = self.scenarios.get(at) else { continue };
            let given = given.get(at).and_then(|seen| seen.as_ref().ok());
            episodes.push((at, self.episode(worker, scenario, given.map(|seen| &*seen.actions))));
        }
        episodes.sort_by_key(|(at, _)| *at);
        episodes.into_iter().map(|(_, episode)| episode).collect()
    }

    /// Runs an episode with these actions or those of the policy.
    fn episode(&self, worker: &mut Worker, scenario: &Scenario, given: Option<&[Action]>) -> Episode {
        let Worker { environment, policy } = worker;
        let start = environment.reset(scenario)?;
        let task = environment.task().clone();
        policy.reset(&task, &start.instance, scenario.seed)?;
        let periods = given.map_or(if self.policy.is_some() { usize::MAX } else { RANDOM_PERIODS }, <[Action]>::len);
        let limit = task.limit_ticks().map_or(periods, |limit| periods.min(limit as usize));
        let mut seen = Seen::start(&start);
        let mut observation = start.observation;
        while seen.states.len() < limit && seen.ending.is_none() {
            let own = policy.act(&observation);
            let action = match given.and_then(|given| given.get(seen.states.len())) {
                Some(given) => {
                    seen.other_actions |= own.is_ok_and(|own| own != *given);
                    given.clone()
                }
                None => own?,
            };
            let step = environment.step(&action)?;
            seen.add(&action, &step);
            observation = step.observation;
        }
        Ok(seen)
    }
}
