//! `robogate check`: checks physics claims by experiment, simulator servers, and files of suites.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, Subcommand};
use robogate_tasks::claims::Claim;
use serde_json::json;

use crate::arguments::EnvironmentArguments;
use crate::commands::bridge::BridgeCheck;
use crate::commands::suites;
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{bold, line, note};

/// Check the physics of the cell, a simulator server, or the file of a suite.
#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check the physics of a task: limits of gripper and parts, easy region, time step, repeatability, joint limits
    Physics(Physics),
    /// Check a simulator server: handshake, parameters, determinism, limits, errors, latency
    Bridge(BridgeCheck),
    /// Check the file of a suite and report every problem; exit code 2 if there are any
    Suite {
        /// Suite file (TOML)
        file: PathBuf,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
}

/// Run the full physics experiments of a task, which take minutes. The robot's gripper determines which claims apply.
#[derive(Debug, Args)]
struct Physics {
    /// Check only these claims; default: all of the task for this gripper
    #[arg(value_name = "CLAIM")]
    claims: Vec<String>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Check {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Physics(physics) => physics.execute(),
            What::Bridge(bridge) => bridge.execute(),
            What::Suite { file, json } => suites::check(file, *json),
        }
    }
}

impl Physics {
    fn execute(&self) -> Result<u8, Exit> {
        let cell = &self.environment.choice().cell()?;
        let space = Arc::new(cell.own_space().or_usage()?);
        let gripper = &cell.robot().settings.gripper;
        let claims = cell.task().claims(gripper);
        if let Some(unknown) = self.claims.iter().find(|name| claims.iter().all(|claim| claim.name != **name)) {
            let known: Vec<&str> = claims.iter().map(|claim| claim.name).collect();
            let (task, gripper) = (cell.task().name(), gripper.description());
            return Err(anyhow::anyhow!(
                "{task} has no claim `{unknown}` for {gripper}. Expected one of: {}",
                known.join(", ")
            ))
            .or_usage();
        }
        let chosen = |claim: &Claim| self.claims.is_empty() || self.claims.iter().any(|name| name == claim.name);
        let mut found = Vec::new();
        for claim in claims.into_iter().filter(chosen) {
            note(format_args!("running {} ...", claim.name));
            let result = claim.check(cell, &space, claim.episodes).map_err(anyhow::Error::msg).or_broken()?;
            if !self.json {
                let verdict = if result.holds { "holds" } else { "FAILS" };
                line(format_args!("{} {}", bold(verdict), result.claim));
                result.figures.iter().for_each(|figure| line(format_args!("      {figure}")));
            }
            found.push((claim.name, result));
        }
        if self.json {
            let claims: Vec<_> = found
                .iter()
                .map(|(name, f)| json!({"name": name, "claim": f.claim, "holds": f.holds, "figures": f.figures}))
                .collect();
            line(json!({"version": 1, "claims": claims}));
        }
        Ok(if found.iter().all(|(_, result)| result.holds) { DONE } else { FAIL })
    }
}
