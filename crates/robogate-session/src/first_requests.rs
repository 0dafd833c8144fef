//! What a policy is asked before the first episode: a network must take the observations, and all servers of one policy must answer
//! alike.

use std::sync::Arc;
use std::thread;

use anyhow::anyhow;
use robogate_core::{Action, Environment, Fault, FaultKind, Observation, Policy, Scenario};
use robogate_dictionary::ComparedServers;
use robogate_policy::{Access, Fingerprint, Likeness, Profile, Query, Recorder, Servers};
use robogate_stats::format::counted;

use crate::cell::nominal;
use crate::failure::{Failure, OrFailure};
use crate::notice::{note, warning};
use crate::policy_source::{ExternalSource, PolicySource, connect, mapped, policy_error};
use crate::subject::Subject;
use crate::text::foreign;

/// Requests that all servers of a policy answer.
const REQUESTS: usize = 4;
/// Control periods after which no further request is awaited.
const PERIODS: usize = 100;

/// The answers of several servers to the same requests.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerComparison {
    /// What a run records.
    pub record: ComparedServers,
    /// The first difference, with the addresses of both servers. `None` if all servers answer alike.
    pub difference: Option<String>,
}

impl ServerComparison {
    /// Sends these requests to every server of a list and compares the answers with those of the first one.
    ///
    /// # Errors
    /// A server that does not answer.
    pub fn of(
        servers: &Servers,
        profile: &Arc<Profile>,
        access: &Access,
        queries: Vec<Query>,
        control_period_s: f64,
    ) -> Result<Self, Failure> {
        let [first, others @ ..] = servers.urls() else { return Err(anyhow!("no server is named")).or_request() };
        let requests = queries.len();
        let open = |url: &str| connect(url, Arc::clone(profile), access.clone());
        let judged = Fingerprint::answers(queries, &mut open(first)?, profile, control_period_s);
        let judged = judged.map_err(policy_error)?;
        let compare = |url: &String| judged.compare(&mut open(url)?).map_err(policy_error);
        let answers: Vec<Result<Likeness, Failure>> = thread::scope(|scope| {
            let running: Vec<_> = others.iter().map(|url| scope.spawn(move || compare(url))).collect();
            let ended = |thread: thread::ScopedJoinHandle<'_, _>| {
                thread.join().unwrap_or_else(|_| Err(anyhow!("the comparison of the servers panicked")).or_broken())
            };
            running.into_iter().map(ended).collect()
        });
        let answers = answers.into_iter().collect::<Result<Vec<_>, _>>()?;
        let difference = others.iter().zip(&answers).find_map(|(url, answer)| {
            let words = answer.difference.as_ref()?;
            Some(format!("{} answers differently from {}: {}", foreign(url), foreign(first), foreign(words)))
        });
        let record = ComparedServers {
            servers: servers.urls().len(),
            requests,
            largest: answers.iter().filter_map(|answer| answer.largest).reduce(f64::max),
            tolerance: judged.tolerance(),
            p_value: answers.iter().filter_map(|answer| answer.p_value).reduce(f64::min),
        };
        Ok(Self { record, difference })
    }

    /// The comparison in one sentence.
    pub fn line(&self) -> String {
        let ComparedServers { servers, requests, largest, tolerance, p_value } = &self.record;
        let measured = match (largest, p_value) {
            (Some(largest), _) => {
                format!("largest difference {largest:.2e} of the spread of a number, at most {tolerance:.1e}")
            }
            (None, Some(p_value)) => {
                format!("random answers, compared as distributions: smallest p-value {p_value:.3}")
            }
            (None, None) => "random answers".to_owned(),
        };
        let alike = if self.difference.is_none() { "answer alike" } else { "differ" };
        format!("{servers} servers {alike} in {} ({measured})", counted(*requests as u64, "request"))
    }
}

impl Subject {
    /// Asks a network, or all servers of a policy, what the start of a nominal episode asks them.
    ///
    /// # Errors
    /// A network that does not take the observations, or servers that answer differently.
    pub(crate) fn check_first_requests(&mut self) -> Result<(), Failure> {
        let Some(PolicySource::External(source)) = self.policy_source() else { return Ok(()) };
        let several = source.servers.urls().len() > 1;
        if !several && !source.profile().dialect.is_file() {
            return Ok(());
        }
        let queries = match self.first_requests(source, if several { REQUESTS } else { 1 })? {
            Ok(queries) => queries,
            Err(why) if several => {
                warning(format_args!("the servers of the policy were not compared: {}", foreign(why)));
                return Ok(());
            }
            // The run reports an environment that does not start.
            Err(_) => return Ok(()),
        };
        if !several {
            return Ok(());
        }
        note(format_args!("comparing the answers of {} servers of the policy", source.servers.urls().len()));
        let profile = Arc::clone(&source.profile);
        let compared =
            ServerComparison::of(&source.servers, &profile, &source.access, queries, self.task().control_period_s)?;
        if let Some(difference) = &compared.difference {
            return Err(anyhow!(
                "{difference}\nHint: serve one checkpoint with the same settings on all servers, or name one server"
            ))
            .or_request();
        }
        note(format_args!("policy: {}", compared.line()));
        self.record_compared(Some(compared.record));
        Ok(())
    }

    /// The first requests of a nominal episode, or why the environment does not start.
    fn first_requests(&self, source: &ExternalSource, wanted: usize) -> Result<Result<Vec<Query>, Fault>, Failure> {
        let map = source.map().map(|map| &**map);
        let mut environment = match self.environment_source().environment_for(source.profile(), map) {
            Ok(environment) => environment,
            Err(why) => return Ok(Err(Fault::new(FaultKind::Setup, format!("{why:#}")))),
        };
        let recorder = Recorder::default();
        let url = source.servers.urls().first().map_or("", String::as_str);
        let asked = connect(url, Arc::clone(&source.profile), source.access.clone())?.recording(Some(recorder.clone()));
        let mut policy = mapped(Box::new(asked), &source.profile, source.map());
        let ended = begin_episode(&mut *environment, &mut *policy, &nominal(), |_, _| recorder.kept() >= wanted);
        match (ended, recorder.take()) {
            (Err(Stopped::Environment(fault)), queries) if queries.is_empty() => Ok(Err(fault)),
            (Err(Stopped::Policy(fault)), _) => {
                let (name, why) = (self.policy_name(), foreign(&fault.detail));
                let why = anyhow!("the policy {name} cannot drive this environment: {why}");
                Err(Failure::broken_if(fault.kind == FaultKind::Unavailable, why))
            }
            (_, queries) => Ok(Ok(queries)),
        }
    }
}

/// Runs the beginning of an episode until there is enough, or for some control periods. `enough` gets each action with the observation
/// before it.
pub(crate) fn begin_episode(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    mut enough: impl FnMut(&Observation, &Action) -> bool,
) -> Result<(), Stopped> {
    let start = environment.reset(scenario).map_err(Stopped::Environment)?;
    let task = Arc::clone(environment.task());
    policy.note_applied(&start.applied);
    policy.reset(&task, &start.instance, scenario.seed).map_err(Stopped::Policy)?;
    let mut observation = start.observation;
    for _ in 0..PERIODS {
        if policy.wants_images() {
            observation.images = environment.render().map_err(Stopped::Environment)?;
        }
        let action = policy.act(&observation).map_err(Stopped::Policy)?;
        if enough(&observation, &action) {
            break;
        }
        let step = environment.step(&action).map_err(Stopped::Environment)?;
        if step.ending.is_some() {
            break;
        }
        observation = step.observation;
    }
    Ok(())
}

/// Why an episode was not begun.
pub(crate) enum Stopped {
    Environment(Fault),
    Policy(Fault),
}
