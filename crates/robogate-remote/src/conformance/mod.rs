//! Conformance tests: experiments that test whether a server conforms to the protocol.

mod checks;

use std::sync::Arc;
use std::time::Duration;

use robogate_core::samplers::LatinHypercube;
use robogate_core::{Assignment, ParameterSpace, Sampler, Scenario, Seed, TaskSpec};
use robogate_zmtp::Address;

use super::connection::{Connection, Timeouts};
use super::error::RequestError;
use super::message::Hello;
use super::session::Session;
use checks::Checker;

/// Result of one check.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckResult {
    /// Name of the check.
    pub name: &'static str,
    /// What the protocol requires.
    pub requirement: &'static str,
    /// The observed violation. `None` if the server meets the requirement.
    pub violation: Option<String>,
}

/// Latencies between request and reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latency {
    /// Operation of the request.
    pub op: &'static str,
    /// Median.
    pub median: Duration,
    /// 99th percentile.
    pub p99: Duration,
}

/// Results of all checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The server's reply to `hello`.
    pub hello: Hello,
    /// Results, one for each check.
    pub results: Vec<CheckResult>,
    /// Latencies. Empty if a check failed.
    pub latencies: Vec<Latency>,
}

impl Report {
    /// Whether the server meets all requirements.
    pub fn passed(&self) -> bool {
        self.results.iter().all(|result| result.violation.is_none())
    }
}

/// Scenarios for the conformance tests of a server with this task.
///
/// Each declared parameter has its value in `base`, or one sampled from `space`, or its nominal value. A parameter with
/// none of these is left out. `base` may only contain values that the task accepts.
pub fn scenarios(
    task: &TaskSpec,
    space: Option<&Arc<ParameterSpace>>,
    base: &Assignment,
    count: usize,
) -> Result<Vec<Scenario>, String> {
    for (name, value) in base.iter() {
        let known = || task.parameters.iter().map(|spec| &*spec.name).collect::<Vec<_>>().join(", ");
        let spec = task.parameter(name);
        let spec =
            spec.ok_or_else(|| format!("the task declares no parameter `{name}`. Expected one of: {}", known()))?;
        spec.accepts(value)?;
    }
    let seed = Seed::campaign(1);
    let design = match space {
        Some(space) => {
            let sampled = LatinHypercube::default().design(space, count, seed.stream("bridge check"));
            Some(sampled.map_err(|why| format!("cannot sample scenarios: {why}"))?)
        }
        None => None,
    };
    Ok((0..count)
        .map(|i| {
            let sampled = design.as_ref().and_then(|design| design.assignment(i)).unwrap_or_default();
            let value = |name: &str| base.get(name).or_else(|| sampled.get(name)).cloned();
            let requested = task.parameters.iter().filter_map(|spec| {
                let value = value(&spec.name).or_else(|| spec.nominal.clone())?;
                Some((Arc::clone(&spec.name), value))
            });
            Scenario { index: i as u64, seed: seed.episode(i as u64), requested: requested.collect() }
        })
        .collect())
}

/// Test whether the server at `address` conforms to the protocol.
///
/// `scenarios` (at least two) exercise its parameters. `session` is of the server's kind.
pub fn check(
    address: &Address,
    timeouts: Timeouts,
    scenarios: &[Scenario],
    session: &mut dyn Session,
) -> Result<Report, RequestError> {
    let connection = Connection::open_unchecked(address.clone(), timeouts)?;
    let hello = connection.hello().clone();
    let declaration =
        CheckResult { name: "task", requirement: "hello declares a valid task", violation: hello.check().err() };
    if declaration.violation.is_some() {
        // Nothing else can be tested without a task.
        return Ok(Report { hello, results: vec![declaration], latencies: Vec::new() });
    }
    let mut checker = Checker { connection, scenarios, session };
    let mut results = vec![declaration];
    results.extend(Checker::CHECKS.into_iter().map(|(name, requirement, experiment)| CheckResult {
        name,
        requirement,
        violation: experiment(&mut checker).err(),
    }));
    // Latencies of invalid replies are meaningless.
    let passed = results.iter().all(|result| result.violation.is_none());
    let latencies = if passed { checker.latencies() } else { Ok(Vec::new()) };
    let latencies = latencies.unwrap_or_else(|why| {
        results.push(CheckResult {
            name: "latency",
            requirement: "repeated requests are answered",
            violation: Some(why),
        });
        Vec::new()
    });
    Ok(Report { hello, results, latencies })
}
