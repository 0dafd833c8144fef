//! Whether episodes repeat: a few run twice, in two processes of the environment and in opposite orders.

use std::num::NonZeroUsize;

use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{Assignment, Environment, Fault, Observation, Policy, Scenario};
use robogate_gate::Repeats;
use robogate_tasks::Random;

use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::subject::{EnvironmentSource, RemoteSource, Subject};

/// Number of processes in which the episodes run.
const PROCESSES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);
/// Number of control periods of an episode with random actions.
const RANDOM_PERIODS: usize = 100;

/// An episode as far as it must repeat. The parameters are those that were read back.
#[derive(PartialEq)]
struct Seen {
    start: (Observation, Assignment),
    states: Vec<u64>,
}

/// Runs these scenarios twice, the second time in the opposite order and, if this process starts the environment, in a process that
/// has run no episode. `None` for an environment that is built in, and if no episode could be compared.
///
/// A policy of the environment acts in full episodes. Any other policy is replaced by random actions, because only the environment
/// is to be tried.
///
/// # Errors
/// A process that does not start.
pub fn repeats(subject: &Subject, scenarios: &[Scenario]) -> Result<Option<Repeats>, Failure> {
    let EnvironmentSource::Remote(source) = subject.environment_source() else { return Ok(None) };
    note(format_args!("repeating {} episodes in another order", scenarios.len()));
    if source.launched.is_some() {
        subject.start_servers(PROCESSES)?;
    }
    let random = || -> Result<_, Failure> {
        Ok(Worker {
            environment: subject.environment_source().environment().or_broken()?,
            policy: Box::new(Random::new()),
        })
    };
    let declared = matches!(subject.policy_source(), Some(PolicySource::Declared(_)));
    let own = || subject.worker().or_broken();
    let found = if declared { both(source, scenarios, usize::MAX, own)? } else { None };
    let Some(first) = found else { return both(source, scenarios, RANDOM_PERIODS, random) };
    if first.unpaired().is_none() {
        return Ok(Some(first));
    }
    // The policy may be what does not repeat.
    Ok(match both(source, scenarios, RANDOM_PERIODS, random)? {
        Some(alone) if first.other_start == 0 && alone.unpaired().is_none() => {
            Some(Repeats { other_trajectory: 0, other_actions: first.other_trajectory, ..first })
        }
        _ => Some(first),
    })
}

/// Runs the scenarios in both orders and compares the episodes. `None` if no episode was valid in both.
fn both(
    source: &RemoteSource,
    scenarios: &[Scenario],
    periods: usize,
    worker: impl Fn() -> Result<Worker, Failure>,
) -> Result<Option<Repeats>, Failure> {
    let mut first = worker()?;
    let Worker { environment, policy } = &mut first;
    if policy.check(environment.task()).is_err() {
        return Ok(None);
    }
    let once: Vec<_> =
        scenarios.iter().map(|scenario| run(&mut **environment, &mut **policy, scenario, periods)).collect();
    let fresh_process = source.pool.len() > 1;
    if let (true, Some(scenario)) = (fresh_process, scenarios.first()) {
        // It keeps its server while an episode runs, so the second worker has another one.
        let _ = environment.reset(scenario);
    }
    // A worker whose episode was cut short keeps its server too. The only one must be free for the second worker.
    let _kept = fresh_process.then_some(first);
    let Worker { environment: mut other, policy: mut again } = worker()?;
    let mut twice: Vec<_> =
        scenarios.iter().rev().map(|scenario| run(&mut *other, &mut *again, scenario, periods)).collect();
    twice.reverse();
    let mut found = Repeats { fresh_process, ..Repeats::default() };
    for (one, two) in once.iter().zip(&twice) {
        let (Ok(one), Ok(two)) = (one, two) else { continue };
        found.episodes += 1;
        found.other_start += u64::from(one.start != two.start);
        found.other_trajectory += u64::from(one.start == two.start && one != two);
    }
    Ok((found.episodes > 0).then_some(found))
}

/// Runs at most `periods` control periods of an episode.
fn run(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    periods: usize,
) -> Result<Seen, Fault> {
    let start = environment.reset(scenario)?;
    let task = environment.task().clone();
    policy.reset(&task, &start.instance, scenario.seed)?;
    let limit = task.limit_ticks().map_or(periods, |limit| periods.min(limit as usize));
    let (mut observation, mut states) = (start.observation.clone(), Vec::new());
    while states.len() < limit {
        let step = environment.step(&policy.act(&observation)?)?;
        observation = step.observation;
        states.push(step.state_hash);
        if step.ending.is_some() {
            break;
        }
    }
    Ok(Seen { start: (start.observation, start.applied), states })
}
