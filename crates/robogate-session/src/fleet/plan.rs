//! The plan of a fleet: its units, their scenarios and the question.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_campaign::Plan;
use robogate_core::samplers::Uniform;
use robogate_core::{Assignment, ParameterSpace, Sampler, Seed, Suite, SuiteError};
use robogate_dictionary::{Provenance, files};
use robogate_gate::{Asked, Baseline, Record, Requirements, Sampling};
use serde::{Deserialize, Serialize};

use crate::failure::{Failure, OrFailure};
use crate::gate::with_plan;

/// The plan in the folder of a fleet.
pub(super) const PLAN: &str = "fleet.json";
/// The version of its format.
pub(super) const VERSION: u32 = 1;

/// Everything that the results of a fleet depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetPlan {
    /// The version of the format.
    pub version: u32,
    /// The number of units.
    pub units: u32,
    /// The seed of units and episodes.
    pub seed: u64,
    /// The maximum number of rounds of each unit.
    pub rounds: u32,
    /// Whether a unit stops as soon as its verdict is certain.
    pub sampling: Sampling,
    /// The share of units that must meet the requirements, 0 to 1.
    pub required_share: Option<f64>,
    /// The distribution of the unit parameters.
    pub unit_space: ParameterSpace,
    /// The scenarios, without the parameters of the units.
    pub suite: Suite,
    /// The requirements on each unit.
    pub requirements: Requirements,
    /// The baseline of relative requirements: the nominal robot on the same scenarios.
    pub baseline: Option<Baseline>,
    /// Environment and policy.
    pub provenance: Provenance,
}

/// One unit: its parameters, and the seed of its episodes. They depend only on the seed of the fleet and the number.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unit {
    /// The number, from 1.
    pub(super) number: u32,
    pub(super) seed: u64,
    pub(super) parameters: Assignment,
}

/// The campaign of a unit and its question.
pub(super) struct UnitCampaign {
    pub(super) plan: Plan,
    pub(super) asked: Asked,
    /// The provenance, with the hash of the question.
    pub(super) provenance: Provenance,
    /// The record before the first episode.
    pub(super) record: Record,
}

impl FleetPlan {
    /// Draws a unit.
    pub(super) fn unit(&self, number: u32) -> anyhow::Result<Unit> {
        let campaign = Seed::campaign(self.seed);
        let design =
            Uniform.design(&Arc::new(self.unit_space.clone()), 1, campaign.stream(&format!("fleet-unit-{number}")))?;
        let parameters = design.assignment(0).context("the unit space is empty")?;
        // 53 bits: every reader of JSON keeps them.
        let seed = campaign.stream(&format!("fleet-unit-{number}-seed")).bits() >> 11;
        Ok(Unit { number, seed, parameters })
    }

    /// All units in order.
    pub(super) fn all_units(&self) -> impl Iterator<Item = anyhow::Result<Unit>> {
        (1..=self.units).map(|number| self.unit(number))
    }

    /// The record of the scenarios without the parameters of a unit.
    ///
    /// # Errors
    /// A suite that cannot be judged.
    pub fn nominal_record(&self) -> Result<Record, Failure> {
        let plan = Plan::of_suite(self.suite.clone(), u64::from(self.rounds), self.seed);
        begun(&plan, &self.provenance)
    }

    /// The campaign of a unit.
    pub(super) fn campaign(&self, unit: &Unit) -> Result<UnitCampaign, Failure> {
        let suite = unit.suite(self).map_err(|error| anyhow!("unit {}: {error}", unit.number)).or_request()?;
        let space = suite.space().clone();
        let plan = Plan::of_suite(suite, u64::from(self.rounds), unit.seed);
        let provenance = Provenance { space, ..self.provenance.clone() };
        let record = begun(&plan, &provenance)?;
        // The scenarios of a unit are those of the baseline, on another unit of the same robot.
        let baseline =
            self.baseline.clone().map(|baseline| Baseline { population: record.population.clone(), ..baseline });
        let asked = Asked {
            format: Asked::FORMAT,
            requirements: self.requirements.clone(),
            baseline,
            against: None,
            sampling: self.sampling,
            real: None,
        };
        let provenance = Provenance { question_sha256: Some(asked.sha256()), ..provenance };
        Ok(UnitCampaign { plan, asked, provenance, record })
    }

    /// Writes the plan to a new folder, or checks that it is that of the folder.
    ///
    /// # Errors
    /// A folder with something else, or that cannot be written.
    pub fn begin(&self, dir: &Path) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(self).or_broken()? + "\n";
        let path = dir.join(PLAN);
        if path.is_file() {
            let there =
                fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display())).or_broken()?;
            if there == text {
                return Ok(());
            }
            return Err(anyhow!(
                "{} contains another fleet\nHint: choose another folder with --out, or continue that fleet with `robogate \
                 resume {}`",
                dir.display(),
                dir.display()
            ))
            .or_request();
        }
        if let Some(name) = fs::read_dir(dir).ok().and_then(|mut entries| entries.next()?.ok()) {
            return Err(anyhow!(
                "{} is not empty (it contains `{}`) and is not a fleet\nHint: choose an empty or new folder",
                dir.display(),
                name.file_name().display()
            ))
            .or_request();
        }
        files::create_folders(dir).with_context(|| format!("cannot create {}", dir.display())).or_broken()?;
        files::write(&path, text).with_context(|| format!("cannot write {}", path.display())).or_broken()
    }

    /// Reads the plan of a fleet.
    ///
    /// # Errors
    /// A file that cannot be read or that is not such a plan.
    pub fn open(dir: &Path) -> Result<Self, Failure> {
        let path = dir.join(PLAN);
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display())).or_request()?;
        let plan: Self = serde_json::from_str(&text)
            .with_context(|| format!("{}: not the plan of a fleet", path.display()))
            .or_request()?;
        if plan.version != VERSION {
            return Err(anyhow!("{} has version {}, expected {VERSION}", path.display(), plan.version)).or_request();
        }
        Ok(plan)
    }
}

impl Unit {
    /// The scenarios with the parameters of the unit.
    pub(super) fn suite(&self, plan: &FleetPlan) -> Result<Suite, SuiteError> {
        plan.suite.with_constants(&format!("{}-{}", plan.suite.name(), self.folder()), &self.parameters)
    }

    /// The folder below that of the fleet.
    pub(super) fn folder(&self) -> String {
        format!("unit-{:03}", self.number)
    }
}

fn begun(plan: &Plan, provenance: &Provenance) -> Result<Record, Failure> {
    Ok(Record::begun(&with_plan(provenance, plan)?)?)
}
