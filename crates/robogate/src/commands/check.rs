//! `robogate check`: claims held to experiment.

use std::sync::Arc;

use clap::{Args, Subcommand};
use robogate_core::ParameterSpace;
use robogate_sim::FRANKA_SPACE;
use robogate_sim::claims::{self, Finding};
use serde_json::json;

use crate::exit::{DONE, Exit, FAIL, OrExit};
use crate::terminal::{bold, line, note};
use crate::world::{Cell, WorldArguments};

/// Check claims by experiment.
#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The physics: friction, opening, easy region, time step, repeatability, joint limits
    Physics(Physics),
}

/// The physics claims at full length: three minutes.
#[derive(Debug, Args)]
struct Physics {
    /// Only these claims
    #[arg(value_name = "CLAIM", value_parser = CLAIMS)]
    claims: Vec<String>,
    #[command(flatten)]
    world: WorldArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// The claims by name, in the order in which they are checked.
const CLAIMS: [&str; 6] = ["coulomb", "opening", "easy_region", "time_step", "repeatable", "joint_limits"];

/// A claim's experiment.
type Experiment<'a> = &'a dyn Fn() -> Result<Finding, String>;

impl Check {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let What::Physics(physics) = &self.what;
        physics.execute()
    }
}

impl Physics {
    fn execute(&self) -> Result<u8, Exit> {
        let cell = Cell::new(self.world.world()).or_usage()?;
        let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).or_broken()?);
        let experiments: [Experiment<'_>; CLAIMS.len()] = [
            &|| claims::coulomb(&cell),
            &|| claims::opening(&cell, 140),
            &|| claims::easy_region(&cell, 700),
            &|| claims::time_step(&cell, &space, 500),
            &|| claims::repeatable(&cell, &space, 200),
            &|| claims::joint_limits(&cell, 70),
        ];
        let mut found = Vec::new();
        for (name, experiment) in CLAIMS.into_iter().zip(experiments) {
            if !self.claims.is_empty() && !self.claims.iter().any(|claim| claim == name) {
                continue;
            }
            note(format_args!("running {name} ..."));
            let finding = experiment().map_err(anyhow::Error::msg).or_broken()?;
            if !self.json {
                let verdict = if finding.holds { "holds" } else { "FAILS" };
                line(format_args!("{} {}", bold(verdict), finding.claim));
                finding.figures.iter().for_each(|figure| line(format_args!("      {figure}")));
            }
            found.push((name, finding));
        }
        if self.json {
            let claims: Vec<_> = found
                .iter()
                .map(|(name, f)| json!({"name": name, "claim": f.claim, "holds": f.holds, "figures": f.figures}))
                .collect();
            line(json!({"version": 1, "claims": claims}));
        }
        Ok(if found.iter().all(|(_, finding)| finding.holds) { DONE } else { FAIL })
    }
}
