//! `robogate check bridge`: conformance tests of the bridge protocol.

use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use robogate_remote::conformance::{Report, check, scenarios};
use robogate_remote::{Connection, PhysicsSession, RemoteTask, RequestError, ScoredSession, Session};
use robogate_zmtp::Address;
use serde_json::json;

use crate::arguments::EnvironmentArguments;
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{bold, line, note};
use robogate_session::named_space;

/// Check whether a server conforms to the bridge protocol (bridges/PROTOCOL.md).
///
/// Runs 13 experiments, then measures latencies. Exit codes: 0 all requirements met, 1 a requirement not met, 5 no
/// answer. --set also sets parameters, in every scenario.
#[derive(Debug, Args)]
pub(crate) struct BridgeCheck {
    /// Address of the server: tcp://HOST:PORT
    address: Address,
    /// Sample the scenarios from this parameter space, limited to the parameters that the server declares; default: the
    /// server's own space, otherwise the declared nominal values
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Number of scenarios in a check.
const SCENARIOS: usize = 4;

impl BridgeCheck {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let timeouts = self.environment.choice().simulators.timeouts();
        let failed = |why: RequestError| anyhow::Error::new(why).context(self.address.to_string());
        let hello = Connection::open(self.address.clone(), timeouts).map_err(failed).or_broken()?.hello().clone();
        let (mut session, task, declared, base): (Box<dyn Session>, _, _, _) = if hello.scores_itself {
            let parameters = self.environment.choice().parameters()?;
            (Box::new(ScoredSession::default()), hello.task, hello.space, parameters)
        } else {
            // A physics server knows no task. All parameters act through the cell.
            let (cell, parameters) = self.environment.choice().cell_and_parameters()?;
            let remote = cell.remote_task().or_usage()?;
            let (task, space) = ((**remote.task()).clone(), cell.own_space().or_usage()?);
            (Box::new(PhysicsSession(remote)), task, Some(space), parameters)
        };
        let space = match &self.space {
            Some(wanted) => Some(named_space(wanted).or_usage()?),
            None => declared,
        };
        let scenarios =
            scenarios(&task, space.map(Arc::new).as_ref(), &base, SCENARIOS).map_err(anyhow::Error::msg).or_usage()?;
        note(format_args!("checking {} ...", self.address));
        let report = check(&self.address, timeouts, &scenarios, &mut *session).map_err(failed).or_broken()?;
        let tried: Vec<&str> = scenarios.first().into_iter().flat_map(|s| s.requested.iter().map(|p| p.0)).collect();
        if self.json {
            self.print_json(&report, &tried)
        } else {
            print(&report, &tried)
        }
        Ok(if report.passed() { DONE } else { FAIL })
    }

    fn print_json(&self, report: &Report, tried: &[&str]) {
        let results: Vec<_> = report
            .results
            .iter()
            .map(|r| {
                let passed = r.violation.is_none();
                json!({"name": r.name, "requirement": r.requirement, "passed": passed, "violation": r.violation})
            })
            .collect();
        let latencies: Vec<_> = report
            .latencies
            .iter()
            .map(|l| json!({"op": l.op, "median_us": microseconds(l.median), "p99_us": microseconds(l.p99)}))
            .collect();
        line(json!({
            "version": 2,
            "address": self.address.to_string(),
            "hello": report.hello,
            "parameters_tried": tried,
            "passed": report.passed(),
            "checks": results,
            "latencies": latencies,
        }));
    }
}

fn microseconds(time: Duration) -> f64 {
    1e6 * time.as_secs_f64()
}

fn print(report: &Report, tried: &[&str]) {
    let hello = &report.hello;
    let solver = hello.engine.solver.as_deref().map_or_else(String::new, |solver| format!(", {solver}"));
    line(format_args!(
        "{} {}: {} {}{solver}",
        hello.server.name, hello.server.version, hello.engine.name, hello.engine.version
    ));
    let robot = hello.robot.as_ref().map_or_else(|| "no robot".to_owned(), |robot| format!("robot {}", robot.name));
    line(format_args!(
        "  task {}, {robot}, actions {}, control period {} ms, {}",
        hello.task.name,
        hello.task.action.kinds(),
        1e3 * hello.task.control_period_s,
        if hello.scores_itself { "scores itself" } else { "physics only, for RoboGate's task" }
    ));
    let tried = if tried.is_empty() { "none".to_owned() } else { tried.join(", ") };
    line(format_args!("  parameters tested: {tried}"));
    for result in &report.results {
        match &result.violation {
            None => line(format_args!("{} {}", bold("pass"), result.requirement)),
            Some(violation) => {
                line(format_args!("{} {}", bold("FAIL"), result.requirement));
                line(format_args!("     {violation}"));
            }
        }
    }
    if !hello.deterministic {
        line("     (the server does not declare itself deterministic: replays may differ)");
    }
    for latency in &report.latencies {
        line(format_args!(
            "{:<7} {:>9.0} us median, {:>9.0} us 99th percentile",
            latency.op,
            microseconds(latency.median),
            microseconds(latency.p99)
        ));
    }
}
