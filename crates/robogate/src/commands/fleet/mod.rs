//! `robogate fleet`: judges units of a robot, each with its own constant deviations.
//!
//! ```text
//! DIR/fleet.json           the plan; written first, never changed
//! DIR/unit-001/            the gate of one unit, as `robogate gate` writes it
//! DIR/fleet-result.json    the share of units that meet the requirements, and what distinguishes the others
//! DIR/fleet.md, fleet.html the same for people
//! ```

mod plan;
mod result;
mod units;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_campaign::DEFAULT_SEED;
use robogate_core::{ParameterSpace, Suite, SuiteError};
use robogate_gate::{Baseline, Mode, Record, Requirements, Sampling};

use crate::arguments::{AccessArguments, EnvironmentArguments, LatencyArguments, PolicyArguments};
use crate::commands::gate::{built_in_baseline, open_requirements, refused};
use crate::commands::run::{How, free_folder, introduce};
use crate::commands::suites;
use crate::exit::{Exit, OrExit};
use crate::place;
use crate::terminal::{grouped, note};
use plan::{FleetPlan, VERSION};
use robogate_session::{PolicyLocation, Reopening, Subject, named_space};

/// The number of scenarios that are sampled from a space.
const SAMPLED_SCENARIOS: usize = 64;

/// Estimate the share of a robot's units that meet the requirements, and find what distinguishes the others.
///
/// Each unit has its own constant deviations (encoder biases, grip force, friction of the pads, pose of the camera, delay), and
/// the gate judges it on episodes of its own. The same command, or `robogate resume DIR`, continues an interrupted fleet.
///
/// Exit codes: 0 done, or at least --share of the units meet the requirements; with --share also 1 fewer, 3 not shown. 4
/// nothing was evaluated.
#[derive(Debug, Args)]
pub(crate) struct FleetOf {
    /// Set the number of units, 1 to 10000
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    units: u32,
    /// Draw the parameters of each unit from this space: a built-in one (franka-units, ur-units) or a TOML file; default:
    /// that of the robot's gripper
    #[arg(long, value_name = "NAME|FILE")]
    unit_space: Option<String>,
    /// Judge each unit on this suite: a built-in one or a TOML file; default: that of the task, otherwise 64 scenarios
    /// sampled from the environment's parameter space
    #[arg(long, value_name = "NAME|FILE")]
    suite: Option<String>,
    /// Sample the scenarios from this parameter space, without the parameters of the units
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "suite")]
    space: Option<String>,
    /// Choose the requirements on each unit: default, paper or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "default")]
    requirements: String,
    /// Compare relative requirements with this baseline file; default: the built-in one of suite and robot
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Require at least this share of units to meet the requirements, 0 to 1: the exit code is then a verdict
    #[arg(long, value_name = "SHARE")]
    share: Option<f64>,
    /// Set the maximum number of rounds of the scenarios for each unit; default: the budget of the requirements
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,
    /// Run all rounds of each unit and test once, instead of stopping as soon as the unit's verdict is certain
    #[arg(long)]
    fixed: bool,
    /// Set the seed of units and episodes
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SEED)]
    seed: u64,
    #[command(flatten)]
    environment: EnvironmentArguments,
    #[command(flatten)]
    policy: PolicyArguments,
    #[command(flatten)]
    access: AccessArguments,
    #[command(flatten)]
    latency: LatencyArguments,
    #[command(flatten)]
    how: How,
    /// Write the fleet to this folder; default: a new one under runs/
    #[arg(long, value_name = "DIR", value_parser = place::local())]
    out: Option<PathBuf>,
}

impl FleetOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if let Some(share) = self.share.filter(|share| !(0.0..=1.0).contains(share)) {
            return Err(anyhow!("--share {share}: expected a fraction from 0 to 1")).or_usage();
        }
        let suite = self.suite.as_deref().map(suites::find).transpose()?;
        let environment = self.environment.choice().environment_of(suite.as_ref())?;
        let location = PolicyLocation { at: None, access: self.access.choice() };
        let policy = self.policy.choice().source_at(&location)?;
        location.check_used(policy.as_ref())?;
        let subject = Subject::new(environment, policy)?;
        let subject = subject.with_statistics(&self.policy.choice().statistics)?;
        let suite = match (suite, subject.own_suite()) {
            (None, Some(own)) if self.space.is_none() => Some(suites::find(own)?),
            (suite, _) => suite,
        };
        let unit_space = self.unit_space(&subject, suite.as_ref())?;
        let subject = subject.with_latency(&self.latency.choice().varied_by(&unit_space))?;
        let plan = self.plan(&subject, suite, unit_space)?;
        let dir = match &self.out {
            Some(dir) => dir.clone(),
            None => free_folder(&format!("fleet-{}-{}", subject.label(), self.seed)),
        };
        subject.register(&dir, &plan.provenance);
        plan.begin(&dir)?;
        units::judge(&dir, &plan, &subject, &self.how)
    }

    fn unit_space(&self, subject: &Subject, suite: Option<&Suite>) -> Result<ParameterSpace, Exit> {
        match (&self.unit_space, subject.own_unit_space()) {
            (Some(name), _) => named_space(name).or_usage(),
            (None, Some(own)) => {
                let space = named_space(own).or_usage()?;
                match suite {
                    Some(suite) => without_varied(&space, suite).or_usage(),
                    None => Ok(space),
                }
            }
            (None, None) => Err(anyhow!(
                "this environment has no distribution of units\nHint: write one as a parameter space and give it with \
                 --unit-space FILE (docs/guides/fleet.md)"
            ))
            .or_usage(),
        }
    }

    fn plan(&self, subject: &Subject, suite: Option<Suite>, unit_space: ParameterSpace) -> Result<FleetPlan, Exit> {
        let requirements = open_requirements(&self.requirements, subject.task())?;
        if requirements.check_real(None).is_err() {
            return Err(anyhow!(
                "--requirements {}: no unit can meet a requirement on `real:success`, because a fleet has no trials of the real \
                 robot\nHint: leave this requirement out, and judge it with `robogate gate --real FILE`",
                self.requirements
            ))
            .or_usage();
        }
        let suite = match suite {
            Some(suite) => suite,
            None => {
                let space = scenario_space(subject, self.space.as_deref(), &unit_space).or_usage()?;
                Suite::sampled(&Arc::new(space), SAMPLED_SCENARIOS, self.seed)
                    .map_err(anyhow::Error::from)
                    .or_usage()?
            }
        };
        let rounds = self.rounds.unwrap_or(requirements.budget.rounds);
        let fixed = self.fixed || requirements.mode == Mode::Point;
        let sampling = if fixed { Sampling::Fixed } else { Sampling::Sequential };
        let provenance = subject.provenance(suite.space().clone())?;
        let plan = FleetPlan {
            version: VERSION,
            units: self.units,
            seed: self.seed,
            rounds,
            sampling,
            required_share: self.share,
            unit_space,
            suite,
            requirements,
            baseline: None,
            provenance,
        };
        let baseline = self.baseline(&plan.nominal_record()?, &plan.requirements)?;
        let plan = FleetPlan { baseline, ..plan };
        // All units are checked before anything runs.
        for unit in plan.all_units() {
            let unit = unit.or_usage()?;
            let suite = &unit.suite(&plan).map_err(|error| misfit(&plan.unit_space, &error)).or_usage()?;
            subject.check_suite(suite).with_context(|| format!("unit {}", unit.number)).or_usage()?;
        }
        introduce(&plan.provenance, plan.seed);
        note(format_args!(
            "{} units from {}, each judged on at most {} rounds of {} scenarios ({}) by the requirements `{}`",
            grouped(u64::from(plan.units)),
            plan.unit_space.name(),
            plan.rounds,
            plan.suite.cases().len(),
            plan.suite.name(),
            plan.requirements.name
        ));
        Ok(plan)
    }

    fn baseline(&self, record: &Record, requirements: &Requirements) -> Result<Option<Baseline>, Exit> {
        match &self.baseline {
            Some(path) => Baseline::open(path).map(Some).map_err(refused),
            None => Ok(built_in_baseline(record).filter(|_| requirements.needs_baseline())),
        }
    }
}

/// The space of the scenarios: that of the environment or `wanted`, without the parameters of the units.
fn scenario_space(subject: &Subject, wanted: Option<&str>, units: &ParameterSpace) -> anyhow::Result<ParameterSpace> {
    without(&subject.space(wanted)?, |name| units.position(name).is_some())
        .context("the parameters of the units are left out of the scenarios")
}

/// A built-in space of units without the parameters that the suite varies: they belong to its scenarios. The user did not choose
/// the space, so this is a note and not an error.
fn without_varied(space: &ParameterSpace, suite: &Suite) -> anyhow::Result<ParameterSpace> {
    let names = space.parameters().iter().map(|parameter| &*parameter.name);
    let varied: Vec<&str> = names.filter(|name| suite.varies(name)).collect();
    if varied.is_empty() {
        return Ok(space.clone());
    }
    note(format_args!(
        "left out of the units, because the scenarios of {} vary them: {} (--unit-space chooses other parameters)",
        suite.name(),
        varied.join(", ")
    ));
    without(space, |name| varied.contains(&name)).context("the suite varies parameters of the units")
}

/// A space without some of its parameters and their correlations.
fn without(space: &ParameterSpace, left_out: impl Fn(&str) -> bool) -> anyhow::Result<ParameterSpace> {
    let kept: Vec<_> = space.parameters().iter().filter(|parameter| !left_out(&parameter.name)).cloned().collect();
    let correlations =
        space.correlations().iter().filter(|c| !c.parameters.iter().any(|name| left_out(name))).cloned().collect();
    ParameterSpace::new(space.name(), kept)
        .with_context(|| format!("space {}", space.name()))?
        .with_correlations(correlations)
        .map_err(Into::into)
}

/// The error for units whose parameters do not suit the scenarios.
fn misfit(units: &ParameterSpace, error: &SuiteError) -> anyhow::Error {
    anyhow!(
        "{}: {error}\nHint: leave these parameters out of the file of --unit-space, or choose a suite that does not vary them",
        units.name()
    )
}

/// Whether `dir` contains a fleet.
pub(crate) fn is_fleet(dir: &Path) -> bool {
    dir.join(plan::PLAN).is_file()
}

/// Continues an interrupted fleet.
pub(crate) fn resume(dir: &Path, opening: &Reopening, how: &How) -> Result<u8, Exit> {
    let plan = FleetPlan::open(dir)?;
    let subject = Subject::recorded(&plan.provenance, Some(dir), opening)?;
    units::judge(dir, &plan, &subject, how)
}
