//! The controls of a gate: an expert and random actions, through the profile of the policy.

use std::sync::Arc;

use anyhow::anyhow;
use robogate_campaign::Worker;
use robogate_core::{Assignment, Outcome, ParameterSpace, Policy, Scenario, Seed, Suite, rollout};
use robogate_dictionary::{ControlProblem, ControlResult, Controls, Repeats};
use robogate_policy::{Profile, RandomModel, TaskMap, ThroughProfile, Unmapped, compare_mappings};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::pictures::picture_problems;
use crate::policy_source::mapped;
use crate::repetition::repeats;
use crate::subject::{EnvironmentSource, Subject};

/// The default number of episodes of each control.
pub const CONTROL_EPISODES: u32 = 5;

/// The largest number of episodes of the gate that run twice before it, in other processes.
const REPEATED: u64 = 12;

/// Repeats a few episodes of an environment in another process, and runs the controls of an external policy, one episode after the
/// other. `None` for a built-in environment and a policy without a profile.
///
/// In the built-in cell the episodes are nominal scenarios. In other environments they are scenarios of the suite, evenly
/// spaced. Their seeds are not those of the gate.
///
/// # Errors
/// A profile that does not fit, pictures that show nothing, or an environment that does not start.
pub fn run_controls(subject: &Subject, suite: &Suite, episodes: u32, seed: u64) -> Result<Option<Controls>, Failure> {
    let repeated = if episodes == 0 { None } else { repeats(subject, &sample(suite, seed))? };
    let controls = of_profile(subject, suite, episodes, seed)?;
    Ok(match repeated {
        None => controls,
        repeats => Some(Controls { repeats, ..controls.unwrap_or_default() }),
    })
}

impl Subject {
    /// The same subject with what repeats of a few episodes of this space.
    ///
    /// # Errors
    /// An environment that does not start.
    pub fn with_repeats(self, space: &ParameterSpace, seed: u64) -> Result<Self, Failure> {
        let Ok(suite) = Suite::fresh(space, REPEATED as usize) else { return Ok(self) };
        let repeats = repeats(&self, &sample(&suite, seed))?;
        repeats.iter().filter_map(Repeats::line).for_each(|line| note(format_args!("{line}")));
        Ok(self.with_controls(&Controls { repeats, ..Controls::default() }))
    }
}

/// Episodes of the gate, some of which run twice.
fn sample(suite: &Suite, seed: u64) -> Vec<Scenario> {
    let (campaign, cases) = (Seed::campaign(seed), suite.cases().len() as u64);
    // A suite with fewer cases begins again, with other seeds.
    (0..REPEATED).map(|at| suite.scenario(campaign, at * (cases / REPEATED).max(1))).collect()
}

/// Runs the controls of a policy with a profile.
fn of_profile(subject: &Subject, suite: &Suite, episodes: u32, seed: u64) -> Result<Option<Controls>, Failure> {
    let Some(profile) = subject.policy_source().and_then(|source| source.profile()) else { return Ok(None) };
    let map = subject.policy_source().and_then(|source| source.map());
    let reference = profile.published().or_request()?;
    let mut controls = Controls { reference: reference.name.clone(), ..Controls::default() };
    if episodes == 0 {
        "They were skipped with --controls 0.".clone_into(&mut controls.without);
        return Ok(Some(controls));
    }
    controls.problems = compare_mappings(profile, &reference)
        .into_iter()
        .map(|problem| ControlProblem { step: problem.step.as_str().to_owned(), detail: problem.detail })
        .collect();
    if !controls.problems.is_empty() {
        return Ok(Some(controls));
    }
    let source = subject.environment_source();
    let scenarios = scenarios(source, suite, episodes, seed);
    if let (EnvironmentSource::Remote(_), Some(scenario), false) =
        (source, scenarios.first(), profile.cameras.is_empty())
    {
        let mut environment = source.environment_for(profile, map.map(|map| &**map)).or_request()?;
        let problems = picture_problems(&mut *environment, scenario).or_broken()?;
        if let Some(problem) = problems.first() {
            return Err(anyhow!(
                "{problem}\nHint: `robogate policy check` with the same options shows what the policy receives"
            ))
            .or_request();
        }
    }
    note(format_args!("controls of the profile {}: {episodes} episodes each", profile.name));
    let expert = || source.expert(profile.action.arm).or_broken();
    let Some(worker) = expert()? else {
        "The environment has no expert for the actions of this profile.".clone_into(&mut controls.without);
        return Ok(Some(controls));
    };
    let task = worker.environment.task().clone();
    if let Err(why) = worker.policy.check(&task) {
        controls.without = format!("The expert cannot drive the task: {why}.");
        return Ok(Some(controls));
    }
    let known = measure(worker, &scenarios);
    if 2 * known.successes < known.episodes || known.episodes == 0 {
        controls.without = format!("The expert itself succeeds in {} of {} episodes.", known.successes, known.episodes);
        return Ok(Some(controls));
    }
    controls.expert = Some(known);
    if let Some(worker) = expert()? {
        controls.positive = Some(measure(through(worker, profile, &reference, map).or_request()?, &scenarios));
    }
    controls.negative = expert()?.map(|worker| {
        let policy = mapped(Box::new(RandomModel::new(profile)), &Arc::new(profile.clone()), map);
        measure(Worker { policy, ..worker }, &scenarios)
    });
    Ok(Some(controls))
}

/// The expert, whose actions take the path of the model's: through the profile, and through the map if there is one.
fn through(
    worker: Worker,
    profile: &Profile,
    reference: &Profile,
    map: Option<&Arc<TaskMap>>,
) -> anyhow::Result<Worker> {
    let Worker { environment, policy } = worker;
    let expert: Box<dyn Policy> = match map {
        Some(map) => {
            let unmapped = Unmapped::new(policy, profile, map, environment.task());
            Box::new(unmapped.map_err(|why| anyhow!("the map does not fit: {why}"))?)
        }
        None => policy,
    };
    let through = Box::new(ThroughProfile::new(expert, profile, reference));
    Ok(Worker { environment, policy: mapped(through, &Arc::new(profile.clone()), map) })
}

fn scenarios(source: &EnvironmentSource, suite: &Suite, episodes: u32, seed: u64) -> Vec<Scenario> {
    // Not the seed of the gate: its scenarios must stay unseen.
    let campaign = Seed::campaign(seed ^ 0x636f_6e74_726f_6c73);
    let cases = suite.cases().len().max(1) as u64;
    (0..u64::from(episodes))
        .map(|number| match source {
            EnvironmentSource::BuiltIn(built_in) if built_in.cell().is_some() => {
                Scenario { index: number, seed: campaign.episode(number), requested: Assignment::default() }
            }
            _ => suite.scenario(campaign, number * cases / u64::from(episodes)),
        })
        .collect()
}

fn measure(worker: Worker, scenarios: &[Scenario]) -> ControlResult {
    let Worker { mut environment, mut policy } = worker;
    let mut result = ControlResult::default();
    for scenario in scenarios {
        let episode = rollout(&mut *environment, &mut *policy, scenario);
        match episode.outcome {
            Outcome::Success => result.successes += 1,
            Outcome::Invalid(fault) => {
                result.invalid += 1;
                note(format_args!("an episode of a control is invalid: {fault}"));
                continue;
            }
            Outcome::Failure(_) => {}
        }
        result.episodes += 1;
    }
    result
}
