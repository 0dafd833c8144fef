//! Fingerprints of policies that run in the process of their environment: what they do at the start of some episodes.
//!
//! Such a policy gets no requests that could be stored: its environment gives it any object. It is asked by its episodes instead: a
//! request is a scenario with its first observation, and the answer are the actions of the first control periods. The same
//! policy acts the same in the same environment, so a deployed one is asked by the same scenarios.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::anyhow;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{Observation, Scenario};
use robogate_dictionary::Dictionary;
use robogate_policy::{Array, Asked, Chunk, Dtype, Fingerprint, PolicyError, Profile, Query};
use serde_json::{Value, json};

use crate::failure::{Failure, OrFailure};
use crate::first_requests::{Stopped, begin_episode};
use crate::policy_source::{PolicyChoice, PolicyLocation, PolicySource};
use crate::reopening::Reopening;
use crate::subject::Subject;

/// Scenarios of such a fingerprint, and the control periods of each.
const SCENARIOS: usize = 8;
const PERIODS: usize = 8;
/// The largest difference between the first observation of a scenario and the recorded one.
const SAME_START: f64 = 1e-4;

/// What such a policy reports about itself.
fn declared() -> Value {
    json!({ "runs_in": "the process of its environment" })
}

/// Whether a fingerprint is that of a policy in the process of its environment.
pub fn is_rehearsed(fingerprint: &Fingerprint) -> bool {
    fingerprint.declared == declared()
}

/// A policy that is asked by the first control periods of episodes.
pub struct Rehearsal {
    worker: Worker,
    scenarios: BTreeMap<u64, Scenario>,
    declared: Value,
}

impl Rehearsal {
    /// The policy of this subject, asked by these scenarios.
    fn new(subject: &Subject, scenarios: Vec<Scenario>) -> Result<Self, Failure> {
        subject.start_servers(std::num::NonZeroUsize::MIN)?;
        let worker = subject.worker().or_broken()?;
        let scenarios = scenarios.into_iter().map(|scenario| (scenario.index, scenario)).collect();
        Ok(Self { worker, scenarios, declared: declared() })
    }

    /// The deployed policy in the environment of the gate in this folder. It starts only what `opening` permits, and the policy that the
    /// user names.
    ///
    /// # Errors
    /// An environment or a policy that does not start, and rows without a scenario of the fingerprint.
    pub fn deployed(folder: &Path, judged: &Fingerprint, policy: &str, opening: &Reopening) -> Result<Self, Failure> {
        let rows = folder.join(DICTIONARY);
        if !rows.is_file() {
            return Err(anyhow!(
                "{}: a policy that runs in the process of its environment is compared by episodes, which need the folder of the gate or of \
                 its evidence",
                folder.display()
            ))
            .or_request();
        }
        let dictionary = Dictionary::open(&rows).or_request()?;
        if policy.contains("://") || policy.ends_with(".onnx") {
            return Err(anyhow!(
                "--policy {policy}: the judged policy runs in the process of its environment\nHint: name the model of the cell (sb3:PATH, \
                 lerobot:PATH) or a policy of the environment"
            ))
            .or_request();
        }
        let choice = PolicyChoice::of(policy, None);
        let mut opening = opening.clone();
        opening.simulators.loads = choice.loaded()?;
        let source = choice.source_at(&PolicyLocation { at: None, access: opening.access.clone() })?;
        let subject =
            Subject::recorded_environment(dictionary.provenance(), Some(folder), &opening)?.with_policy(source)?;
        let wanted: Vec<u64> = judged.probes.iter().map(|probe| probe.query.step).collect();
        let scenarios = scenarios(&dictionary, |index| wanted.contains(&index))?;
        if scenarios.len() < wanted.len() {
            return Err(anyhow!("{}: it lacks scenarios of the fingerprint", rows.display())).or_request();
        }
        Self::new(&subject, scenarios)
    }

    /// The first observation of a scenario, and the actions of its first control periods. An episode that ends earlier has zeros.
    fn episode(&mut self, index: u64) -> Result<(Observation, Chunk), PolicyError> {
        let scenario = self.scenarios.get(&index);
        let scenario = scenario.ok_or_else(|| PolicyError::Observation(format!("there is no scenario {index}")))?;
        let mut first = None;
        let mut rows: Vec<Vec<f64>> = Vec::new();
        let begun =
            begin_episode(&mut *self.worker.environment, &mut *self.worker.policy, scenario, |observation, action| {
                first.get_or_insert_with(|| observation.clone());
                rows.push(action.command.numbers().into_iter().chain(action.gripper).collect());
                rows.len() >= PERIODS
            });
        begun.map_err(|(Stopped::Environment(fault) | Stopped::Policy(fault))| {
            PolicyError::Observation(fault.to_string())
        })?;
        let first = first.ok_or_else(|| PolicyError::Observation(format!("scenario {index} has no control period")))?;
        let width = rows.first().map_or(0, Vec::len);
        rows.resize(PERIODS, vec![0.0; width]);
        Ok((first, Chunk::of_rows(rows)?))
    }
}

impl Asked for Rehearsal {
    fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
        let (first, answer) = self.episode(query.step)?;
        let now = states(&first);
        let differs = |(name, array): &(String, Array)| {
            let numbers = now.iter().find(|(known, _)| known == name).map(|(_, array)| array.numbers());
            let far = |(a, b): (&f64, &f64)| (a - b).abs() > SAME_START * (1.0 + a.abs());
            numbers.is_none_or(|now| now.len() != array.numbers().len() || array.numbers().iter().zip(&now).any(far))
        };
        match query.states.iter().find(|state| differs(state)) {
            None => Ok(answer),
            Some((name, _)) => Err(PolicyError::Observation(format!(
                "scenario {} does not begin as in the gate: `{name}` differs. Another version of the environment?",
                query.step
            ))),
        }
    }

    fn declared(&self) -> &Value {
        &self.declared
    }

    fn takes_changed_requests(&self) -> bool {
        false
    }
}

/// The scenarios of the valid episodes with these indices.
fn scenarios(dictionary: &Dictionary, wanted: impl Fn(u64) -> bool) -> Result<Vec<Scenario>, Failure> {
    let mut found = Vec::new();
    for entry in dictionary.entries() {
        let entry = entry.or_request()?;
        if wanted(entry.index()) && !matches!(entry.episode.outcome, robogate_core::Outcome::Invalid(_)) {
            found.push(entry.episode.scenario);
        }
    }
    Ok(found)
}

fn states(observation: &Observation) -> Vec<(String, Array)> {
    let vectors = observation.vectors.iter();
    vectors.map(|(name, values)| (name.to_string(), Array::vector(values, Dtype::F64))).collect()
}

/// A profile that says nothing but the size of an action: the environment has no other one for its policies.
fn profile(name: &str, size: usize) -> Result<Profile, Failure> {
    let text = json!({
        "name": name, "model": "a policy in the process of its environment", "dialect": { "name": "openpi" },
        "action": { "size": size, "arm": "vector" }, "chunk": { "execute": PERIODS },
    });
    serde_json::from_value(text).map_err(anyhow::Error::from).or_broken()
}

impl Subject {
    /// The fingerprint of a policy in the process of its environment: what it does at the start of some episodes of the run in this
    /// folder. `None` for another policy, and without episodes.
    pub(crate) fn rehearsed_fingerprint(&self, run: &Path) -> Result<Option<Fingerprint>, Failure> {
        let Some(PolicySource::Declared(policy)) = self.policy_source() else { return Ok(None) };
        let dictionary = Dictionary::open(&run.join(DICTIONARY)).or_broken()?;
        let all = scenarios(&dictionary, |_| true)?;
        let every = all.len().div_ceil(SCENARIOS).max(1);
        let chosen: Vec<Scenario> = all.into_iter().step_by(every).collect();
        let indices: Vec<u64> = chosen.iter().map(|scenario| scenario.index).collect();
        let mut rehearsal = Rehearsal::new(self, chosen)?;
        let mut queries = Vec::new();
        let mut size = 0;
        for index in indices {
            let (first, answer) = rehearsal.episode(index).map_err(anyhow::Error::from).or_broken()?;
            size = answer.rows()[0].len();
            queries.push(Query {
                images: Vec::new(),
                states: states(&first),
                instruction: self.task().instruction.clone(),
                step: index,
                time_s: 0.0,
            });
        }
        if queries.is_empty() || size == 0 {
            return Ok(None);
        }
        let profile = profile(&policy.environment, size)?;
        let period_s = self.task().control_period_s;
        Fingerprint::measure(queries, &mut rehearsal, &profile, period_s)
            .map(Some)
            .map_err(anyhow::Error::from)
            .or_broken()
    }
}
