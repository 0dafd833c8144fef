//! The stages of a campaign and their points.

use std::fmt;
use std::sync::Arc;

use robogate_core::{Assignment, Design, ParameterSpace, Sampler, Scenario, Seed};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::boundary::Weights;
use crate::{BoundaryReport, Plan, RunError};

/// A stage of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The first: the operating space.
    Uniform,
    /// The second: where the first found the boundary.
    Boundary,
}

impl Stage {
    /// Its word in the dictionary and reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Boundary => "boundary",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// The points of one stage, their indices in the campaign and their weights.
///
/// Every design is drawn from a stream of its own, so that neither its points nor those of another
/// change with how many the other has.
#[derive(Debug)]
pub struct Points {
    stage: Stage,
    seed: Seed,
    sampler: &'static str,
    first_index: u64,
    /// One after the other: of the second stage the emphasis, then the volume.
    designs: Vec<Design>,
    weights: Option<Weights>,
}

impl Points {
    /// The points of the first stage.
    pub fn uniform(plan: &Plan, space: &Arc<ParameterSpace>) -> Result<Self, RunError> {
        let sampler = plan.sampler()?;
        let seed = Seed::campaign(plan.seed);
        let designs = vec![draw(&*sampler, space, plan.uniform.episodes, seed, "design-uniform")?];
        Ok(Self { stage: Stage::Uniform, seed, sampler: sampler.name(), first_index: 0, designs, weights: None })
    }

    /// The points of the second stage, given what the first one found. `space` is the operating space.
    pub fn boundary(plan: &Plan, space: &Arc<ParameterSpace>, report: &BoundaryReport) -> Result<Self, RunError> {
        let sampler = plan.sampler()?;
        let seed = Seed::campaign(plan.seed);
        let focus = report.focus(space)?;
        let emphasised = report.emphasis.as_ref().map_or(0, |found| found.region.episodes);
        let mut designs = Vec::new();
        if let (Some(emphasis), 1..) = (&focus.emphasis, emphasised) {
            designs.push(draw(&*sampler, &Arc::new(emphasis.clone()), emphasised, seed, "design-emphasis")?);
        }
        if report.volume.episodes > 0 {
            let volume = Arc::new(focus.volume.clone());
            designs.push(draw(&*sampler, &volume, report.volume.episodes, seed, "design-boundary")?);
        }
        Ok(Self {
            stage: Stage::Boundary,
            seed,
            sampler: sampler.name(),
            first_index: plan.uniform.episodes,
            designs,
            weights: Some(Weights::new(report, focus)),
        })
    }

    /// The stage.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The name of the sampler that drew them.
    pub fn sampler(&self) -> &'static str {
        self.sampler
    }

    /// How many there are.
    pub fn len(&self) -> u64 {
        self.designs.iter().map(|design| design.len() as u64).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The indices in the campaign, rising.
    pub fn indices(&self) -> std::ops::Range<u64> {
        self.first_index..self.first_index + self.len()
    }

    /// What episode `index` of the campaign shall be, if it is of this stage.
    pub fn scenario(&self, index: u64) -> Option<Scenario> {
        let (design, i) = self.locate(index)?;
        Some(Scenario { index, seed: self.seed.episode(index), requested: design.assignment(i)? })
    }

    /// What is asked for in episode `index` of the campaign, if it is of this stage.
    pub fn requested(&self, index: u64) -> Option<Assignment> {
        let (design, i) = self.locate(index)?;
        design.assignment(i)
    }

    /// The weight p(x)/q(x) of episode `index`: 1 in the first stage, whose density is the operating one.
    pub fn weight(&self, index: u64) -> Option<f64> {
        let (design, i) = self.locate(index)?;
        let coded = design.coded(i)?;
        Some(self.weights.as_ref().map_or(1.0, |weights| weights.of(coded)))
    }

    fn locate(&self, index: u64) -> Option<(&Design, usize)> {
        let mut i = usize::try_from(index.checked_sub(self.first_index)?).ok()?;
        for design in &self.designs {
            if i < design.len() {
                return Some((design, i));
            }
            i -= design.len();
        }
        None
    }
}

fn draw(
    sampler: &dyn Sampler,
    space: &Arc<ParameterSpace>,
    n: u64,
    seed: Seed,
    purpose: &str,
) -> Result<Design, RunError> {
    // A plan's limit lies far below the range of usize.
    Ok(sampler.design(space, n as usize, seed.stream(purpose))?)
}
