//! A fleet: units of a robot, each with its own constant deviations, and the share of them that meet the requirements.
//!
//! ```text
//! DIR/fleet.json           the plan; written first, never changed
//! DIR/unit-001/            the gate of one unit
//! ```

mod plan;
mod units;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_core::{ParameterSpace, Suite, SuiteError};
use robogate_gate::{Baseline, Record, Requirements};

use crate::compared::built_in_baseline;
use crate::failure::{Failure, OrFailure};
use crate::gate::{SAMPLED_SCENARIOS, rounds_and_sampling};
use crate::latency::LatencyChoice;
use crate::notice::note;
use crate::subject::{Subject, named_space, without};
use plan::{PLAN, VERSION};

pub use plan::FleetPlan;
pub use units::{FleetEnd, OnUnit};

/// What is asked about a fleet.
#[derive(Debug, Clone)]
pub struct FleetRequest {
    /// The number of units.
    pub units: u32,
    /// The scenarios of each unit. `None` to sample them from a parameter space.
    pub suite: Option<Suite>,
    /// The space of sampled scenarios: a built-in one or a file. `None` for the environment's own.
    pub space: Option<String>,
    /// What varies between environment and policy, of which sampled scenarios have the parameters.
    pub latency: LatencyChoice,
    /// The requirements on each unit: the name of built-in ones, or a file.
    pub requirements: String,
    /// The baseline of relative requirements. `None` for the built-in one of suite and robot.
    pub baseline: Option<PathBuf>,
    /// The share of units that must meet the requirements, 0 to 1.
    pub share: Option<f64>,
    /// The largest number of rounds of each unit. `None` for that of the suite or of the requirements.
    pub rounds: Option<u32>,
    /// Whether all rounds of a unit run, and the test is done once.
    pub fixed: bool,
    /// The seed of units and episodes.
    pub seed: u64,
}

impl FleetRequest {
    /// The plan of the fleet. All units are checked.
    ///
    /// # Errors
    /// A request that the task or the scenarios cannot meet.
    pub fn plan(&self, subject: &Subject, unit_space: ParameterSpace) -> Result<FleetPlan, Failure> {
        if let Some(share) = self.share.filter(|share| !(0.0..=1.0).contains(share)) {
            return Err(anyhow!("--share {share}: expected a fraction from 0 to 1")).or_request();
        }
        let requirements = Requirements::open(&self.requirements, subject.task())?;
        if requirements.check_real(None).is_err() {
            return Err(anyhow!(
                "--requirements {}: no unit can meet a requirement on `real:success`, because a fleet has no trials of the real \
                 robot\nHint: leave this requirement out, and judge it with `robogate gate --real FILE`",
                self.requirements
            ))
            .or_request();
        }
        let latency = self.latency.beside(&unit_space);
        let suite = match &self.suite {
            Some(suite) => {
                latency.check_suite(suite.space()).or_request()?;
                suite.clone()
            }
            None => {
                let space = scenario_space(subject, self.space.as_deref(), &unit_space)
                    .and_then(|space| latency.added_to(space, subject.task()))
                    .or_request()?;
                let suite = Suite::sampled(&Arc::new(space), SAMPLED_SCENARIOS, self.seed);
                suite.map_err(anyhow::Error::from).or_request()?
            }
        };
        let (rounds, sampling) = rounds_and_sampling(&suite, &requirements, self.rounds, self.fixed);
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
        for unit in plan.all_units() {
            let unit = unit.or_request()?;
            let suite = &unit.suite(&plan).map_err(|error| misfit(&plan.unit_space, &error)).or_request()?;
            subject.check_suite(suite).with_context(|| format!("unit {}", unit.number)).or_request()?;
        }
        Ok(plan)
    }

    fn baseline(&self, record: &Record, requirements: &Requirements) -> Result<Option<Baseline>, Failure> {
        match &self.baseline {
            Some(path) => Ok(Some(Baseline::open(path)?)),
            None => Ok(built_in_baseline(record).filter(|_| requirements.needs_baseline())),
        }
    }
}

/// The distribution of the units: `wanted`, a built-in space or a file, or that of the robot without the parameters that `suite`
/// varies.
///
/// # Errors
/// A space that does not exist, or an environment without such a distribution.
pub fn unit_space(subject: &Subject, wanted: Option<&str>, suite: Option<&Suite>) -> Result<ParameterSpace, Failure> {
    match (wanted, subject.own_unit_space()) {
        (Some(name), _) => named_space(name).or_request(),
        (None, Some(own)) => {
            // The robot may have fewer joints and no camera.
            let lacks = |name: &str| subject.task().parameter(name).is_none();
            let space = without(&named_space(own).or_request()?, lacks).or_request()?;
            match suite {
                Some(suite) => without_varied(&space, suite).or_request(),
                None => Ok(space),
            }
        }
        (None, None) => Err(anyhow!(
            "this environment has no distribution of units\nHint: write one as a parameter space and give it with \
             --unit-space FILE (docs/guides/fleet.md)"
        ))
        .or_request(),
    }
}

/// Whether `dir` contains a fleet.
pub fn is_fleet(dir: &Path) -> bool {
    dir.join(PLAN).is_file()
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

/// The error for units whose parameters do not suit the scenarios.
fn misfit(units: &ParameterSpace, error: &SuiteError) -> anyhow::Error {
    anyhow!(
        "{}: {error}\nHint: leave these parameters out of the file of --unit-space, or choose a suite that does not vary them",
        units.name()
    )
}
