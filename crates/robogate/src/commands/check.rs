//! `robogate check`: checks physics claims by experiment, simulator servers, and files of suites.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, Subcommand};
use robogate_tasks::pick_place::claims::{self, ClaimResult, Workbench};
use serde_json::json;

use crate::arguments::EnvironmentArguments;
use crate::commands::bridge::BridgeCheck;
use crate::commands::suites;
use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{bold, line, note};
use robogate_session::{CELL_TASK, named_space};

/// Check the physics of the cell, a simulator server, or the file of a suite.
#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check the physics: limits of the gripper, easy region, time step, repeatability, joint limits
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

/// Run the full physics experiments, which take about three minutes. The robot's gripper determines which claims apply.
#[derive(Debug, Args)]
struct Physics {
    /// Check only these claims; default: all that apply
    #[arg(value_name = "CLAIM", value_parser = CLAIMS)]
    claims: Vec<String>,
    #[command(flatten)]
    environment: EnvironmentArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// The names of the claims.
const CLAIMS: [&str; 12] = [
    "coulomb",
    "opening",
    "no_creep",
    "vacuum_limit",
    "cup_area",
    "gravity",
    "surface_keeps",
    "position_jitter",
    "easy_region",
    "time_step",
    "repeatable",
    "joint_limits",
];

/// The name and the experiment of a claim.
type Experiment<'a> = (&'static str, &'a dyn Fn() -> Result<ClaimResult, String>);

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
        let space = Arc::new(named_space(cell.default_space()).or_usage()?);
        let fingers: &[Experiment<'_>] = &[
            ("coulomb", &|| claims::coulomb(cell, &[2.0, 4.0, 7.0])),
            ("opening", &|| claims::opening(cell, 140)),
            ("no_creep", &|| claims::no_creep(cell, 140)),
        ];
        let suction: &[Experiment<'_>] = &[
            ("vacuum_limit", &|| claims::vacuum_limit(cell)),
            ("cup_area", &|| claims::cup_area(cell)),
            ("gravity", &|| claims::gravity(cell)),
            ("surface_keeps", &|| claims::surface_keeps(cell, &space, 300)),
        ];
        let parts: &[Experiment<'_>] = &[
            ("position_jitter", &|| claims::position_jitter(cell, 140)),
            ("easy_region", &|| claims::easy_region(cell, 700)),
            ("joint_limits", &|| claims::joint_limits(cell, 70)),
        ];
        let any: &[Experiment<'_>] = &[
            ("time_step", &|| claims::time_step(cell, &space, 500)),
            ("repeatable", &|| claims::repeatable(cell, &space, 200)),
        ];
        let (task, gripper) = (cell.task().name(), &cell.setup().robot.settings.gripper);
        // The other claims set the parameters of pick_place.
        let own: [&[Experiment<'_>]; 2] = match gripper.cup() {
            _ if task != CELL_TASK => [&[]; 2],
            Some(_) => [suction, parts],
            None => [fingers, parts],
        };
        let experiments = || own.into_iter().flatten().chain(any);
        if let Some(claim) = self.claims.iter().find(|claim| experiments().all(|(name, _)| name != claim)) {
            let gripper = gripper.description();
            return Err(anyhow::anyhow!("the claim {claim} does not apply to {task} with {gripper}")).or_usage();
        }
        let mut found = Vec::new();
        for (name, experiment) in experiments() {
            if !self.claims.is_empty() && !self.claims.iter().any(|claim| claim == name) {
                continue;
            }
            note(format_args!("running {name} ..."));
            let result = experiment().map_err(anyhow::Error::msg).or_broken()?;
            if !self.json {
                let verdict = if result.holds { "holds" } else { "FAILS" };
                line(format_args!("{} {}", bold(verdict), result.claim));
                result.figures.iter().for_each(|figure| line(format_args!("      {figure}")));
            }
            found.push((name, result));
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
