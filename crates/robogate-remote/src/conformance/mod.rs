//! Conformance tests: checks by experiment whether a server keeps the protocol.

mod checks;

use std::time::Duration;

use robogate_core::Scenario;
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
    /// What the server did instead; nothing if it meets the requirement.
    pub violation: Option<String>,
}

/// Time between a request and its reply.
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
    /// What the server reports about itself.
    pub hello: Hello,
    /// Results, one for each check.
    pub results: Vec<CheckResult>,
    /// Latencies; empty if a check failed.
    pub latencies: Vec<Latency>,
}

impl Report {
    /// Whether the server meets all requirements.
    pub fn passed(&self) -> bool {
        self.results.iter().all(|result| result.violation.is_none())
    }
}

/// Check the server at `address` against the protocol.
///
/// `scenarios` (at least two) are those with which its parameters are tried. `session` is of the server's kind.
pub fn check(
    address: &Address,
    timeouts: Timeouts,
    scenarios: &[Scenario],
    session: &mut dyn Session,
) -> Result<Report, RequestError> {
    let connection = Connection::open(address.clone(), timeouts)?;
    let hello = connection.hello().clone();
    let mut checker = Checker { connection, scenarios, session };
    let mut results: Vec<CheckResult> = Checker::CHECKS
        .into_iter()
        .map(|(name, requirement, experiment)| CheckResult {
            name,
            requirement,
            violation: experiment(&mut checker).err(),
        })
        .collect();
    // The latency of invalid replies means nothing.
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
