//! `robogate bridge`: servers held to the bridge protocol.

use std::sync::Arc;

use anyhow::Context;
use clap::{Args, Subcommand};
use robogate_bridge::simulator::contract::{Report, examine};
use robogate_bridge::simulator::{AskError, Link, NoWorld};
use robogate_bridge::zmtp::Address;
use robogate_core::{Assignment, Sampler, Scenario, Seed, samplers::LatinHypercube};
use robogate_physics::SuctionLaw;
use robogate_tasks::pick_place::remote::is_local;
use serde_json::json;

use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::far::OurWorld;
use crate::terminal::{bold, line, note};
use crate::world::WorldArguments;

/// Simulators that speak the bridge protocol.
#[derive(Debug, Args)]
pub(crate) struct Bridge {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Hold a server to the protocol by experiment: handshake, parameters, determinism, limits, errors, speed
    Check(BridgeCheck),
}

/// Hold a server to the protocol by experiment (bridges/PROTOCOL.md).
///
/// Exit codes: 0 it keeps the protocol, 1 it does not, 5 nobody answers.
#[derive(Debug, Args)]
struct BridgeCheck {
    /// Where the server listens: tcp://HOST:PORT
    address: Address,
    /// The parameter space from which scenarios are drawn, as far as the server knows its parameters; default: the
    /// robot's own
    #[arg(long, value_name = "NAME|FILE")]
    space: Option<String>,
    #[command(flatten)]
    world: WorldArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Scenarios that are tried.
const SCENARIOS: usize = 4;

impl Bridge {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let What::Check(check) = &self.what;
        check.execute()
    }
}

impl BridgeCheck {
    fn execute(&self) -> Result<u8, Exit> {
        let patience = self.world.simulators.patience();
        let asked = |why: AskError| anyhow::Error::new(why).context(self.address.to_string());
        let hello = Link::connect(self.address.clone(), patience).map_err(asked).or_broken()?.hello().clone();
        let cell = self.world.cell(SuctionLaw::Vacuum)?;
        let space = Arc::new(cell.space(self.space.as_deref()).or_usage()?);
        let seed = Seed::campaign(1);
        let design = LatinHypercube::default()
            .design(&space, SCENARIOS, seed.stream("bridge check"))
            .context("no scenarios can be drawn")
            .or_usage()?;
        let known = |name: &str| hello.parameters.iter().any(|p| p == name) || (!hello.judges && is_local(name));
        let scenarios: Vec<Scenario> = (0..SCENARIOS)
            .filter_map(|i| {
                let drawn = design.assignment(i)?;
                let requested: Assignment = drawn
                    .iter()
                    .filter(|(name, _)| known(name))
                    .map(|(name, value)| (name.into(), value.clone()))
                    .collect();
                Some(Scenario { index: i as u64, seed: seed.episode(i as u64), requested })
            })
            .collect();
        note(format_args!("asking {} ...", self.address));
        let report = if hello.judges {
            examine::<NoWorld>(&self.address, patience, &scenarios, None)
        } else {
            let mut world = cell.our_world().or_usage()?;
            examine::<OurWorld>(&self.address, patience, &scenarios, Some(&mut world))
        };
        let report = report.map_err(asked).or_broken()?;
        let tried: Vec<&str> = scenarios.first().into_iter().flat_map(|s| s.requested.iter().map(|p| p.0)).collect();
        if self.json {
            self.print_json(&report, &tried)
        } else {
            print(&report, &tried)
        }
        Ok(if report.holds() { DONE } else { FAIL })
    }

    fn print_json(&self, report: &Report, tried: &[&str]) {
        let clauses: Vec<_> = report
            .clauses
            .iter()
            .map(|c| json!({"name": c.name, "demand": c.demand, "holds": c.broken.is_none(), "broken": c.broken}))
            .collect();
        let speeds: Vec<_> = report
            .speeds
            .iter()
            .map(
                |s| json!({"op": s.op, "median_us": s.median.as_secs_f64() * 1e6, "p99_us": s.p99.as_secs_f64() * 1e6}),
            )
            .collect();
        line(json!({
            "version": 1,
            "address": self.address.to_string(),
            "hello": report.hello,
            "parameters_tried": tried,
            "holds": report.holds(),
            "clauses": clauses,
            "speeds": speeds,
        }));
    }
}

fn print(report: &Report, tried: &[&str]) {
    let hello = &report.hello;
    let solver = hello.engine.solver.as_deref().map_or_else(String::new, |solver| format!(", {solver}"));
    line(format_args!(
        "{} {}: {} {}{solver}",
        hello.server.name, hello.server.version, hello.engine.name, hello.engine.version
    ));
    line(format_args!(
        "  robot {}, {} joints, time step {} ms, {}",
        hello.robot.name,
        hello.joints.len(),
        1e3 * hello.time_step_s,
        if hello.judges { "judges its own world" } else { "physics for our world" }
    ));
    line(format_args!("  tried with {}", if tried.is_empty() { "no parameter".to_owned() } else { tried.join(", ") }));
    for clause in &report.clauses {
        match &clause.broken {
            None => line(format_args!("{} {}", bold("holds"), clause.demand)),
            Some(broken) => {
                line(format_args!("{} {}", bold("FAILS"), clause.demand));
                line(format_args!("      {broken}"));
            }
        }
    }
    if !hello.deterministic {
        line("      (the server does not promise to be deterministic: replays may differ)");
    }
    for speed in &report.speeds {
        let us = |time: std::time::Duration| 1e6 * time.as_secs_f64();
        line(format_args!(
            "{:<7} {:>9.0} us median, {:>9.0} us for 99 of 100",
            speed.op,
            us(speed.median),
            us(speed.p99)
        ));
    }
}
