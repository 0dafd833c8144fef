//! The stages of a campaign and their points.

use std::fmt;
use std::sync::Arc;

use robogate_core::{Assignment, Design, Episode, ParameterSpace, Scenario, Seed};
use robogate_dictionary::{Entry, Label};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::active::Chosen;
use crate::boundary::Weights;
use crate::{BoundaryReport, Plan, RunError, SuiteStage};

/// A stage of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The first stage, over the operating space.
    Uniform,
    /// The second stage, around the boundary found by the first one.
    Boundary,
    /// The active stage, which replaces the second one: rounds that sample where the outcome is least certain.
    Active,
    /// The scenarios of a suite, which replace all stages.
    Suite,
}

impl Stage {
    /// The name in the dictionary and in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Boundary => "boundary",
            Self::Active => "active",
            Self::Suite => "suite",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A design that a stage needs.
#[derive(Debug)]
pub(crate) struct Wanted<'a> {
    /// Its name, which is that of its random stream.
    pub(crate) name: &'a str,
    /// The space of its points.
    pub(crate) space: &'a Arc<ParameterSpace>,
    /// The number of its points.
    pub(crate) points: u64,
}

impl Wanted<'_> {
    /// Draws the design with the sampler and the seed of a plan.
    pub(crate) fn draw(&self, plan: &Plan) -> Result<Design, RunError> {
        // The limits of a plan are far below the range of usize.
        let (points, stream) = (self.points as usize, Seed::campaign(plan.seed).stream(self.name));
        Ok(plan.sampler()?.design(self.space, points, stream)?)
    }
}

/// Provides a design.
pub(crate) type Draw<'a, E> = &'a dyn Fn(&Wanted<'_>) -> Result<Design, E>;

/// The points of one stage, with their indices in the campaign and their weights.
///
/// The points of a suite are its scenarios, round after round. Each design uses a separate random stream. Its points do
/// not depend on the number of points in the other design.
#[derive(Debug)]
pub struct Points {
    stage: Stage,
    seed: Seed,
    sampler: &'static str,
    first_index: u64,
    source: Source,
}

/// The source of points.
#[derive(Debug)]
enum Source {
    /// Sampled from a space.
    Drawn {
        /// The designs in order. The second stage has the emphasis first, then the volume.
        designs: Vec<Design>,
        weights: Option<Weights>,
    },
    /// Chosen one by one: a round of the active stage.
    Listed(Vec<Chosen>),
    /// Scenarios of a suite.
    Suite(Box<SuiteStage>),
}

impl Points {
    /// Draws the points of the first stage.
    pub fn uniform(plan: &Plan, space: &Arc<ParameterSpace>) -> Result<Self, RunError> {
        Self::uniform_by(plan, space, &|wanted| wanted.draw(plan))
    }

    /// The points of the first stage. `design` draws its design.
    pub(crate) fn uniform_by<E: From<RunError>>(
        plan: &Plan,
        space: &Arc<ParameterSpace>,
        design: Draw<'_, E>,
    ) -> Result<Self, E> {
        let designs = vec![design(&Wanted { name: "design-uniform", space, points: plan.uniform.episodes })?];
        Ok(Self::drawn(plan, Stage::Uniform, 0, designs, None)?)
    }

    /// Draws the points of the second stage from the boundary report. `space` is the operating space.
    pub fn boundary(plan: &Plan, space: &Arc<ParameterSpace>, report: &BoundaryReport) -> Result<Self, RunError> {
        Self::boundary_by(plan, space, report, &|wanted| wanted.draw(plan))
    }

    /// The points of the second stage. `design` draws its designs.
    pub(crate) fn boundary_by<E: From<RunError>>(
        plan: &Plan,
        space: &Arc<ParameterSpace>,
        report: &BoundaryReport,
        design: Draw<'_, E>,
    ) -> Result<Self, E> {
        let focus = report.focus(space).map_err(RunError::from)?;
        let emphasised = report.emphasis.as_ref().map_or(0, |found| found.region.episodes);
        let mut designs = Vec::new();
        if let (Some(emphasis), 1..) = (&focus.emphasis, emphasised) {
            let space = &Arc::new(emphasis.clone());
            designs.push(design(&Wanted { name: "design-emphasis", space, points: emphasised })?);
        }
        if report.volume.episodes > 0 {
            let space = &Arc::new(focus.volume.clone());
            designs.push(design(&Wanted { name: "design-boundary", space, points: report.volume.episodes })?);
        }
        let weights = Weights::new(report, focus);
        Ok(Self::drawn(plan, Stage::Boundary, plan.uniform.episodes, designs, Some(weights))?)
    }

    fn drawn(
        plan: &Plan,
        stage: Stage,
        first_index: u64,
        designs: Vec<Design>,
        weights: Option<Weights>,
    ) -> Result<Self, RunError> {
        let (seed, sampler) = (Seed::campaign(plan.seed), plan.sampler()?.name());
        Ok(Self { stage, seed, sampler, first_index, source: Source::Drawn { designs, weights } })
    }

    /// The points of a round of the active stage, from this index on.
    pub(crate) fn active(plan: &Plan, first_index: u64, points: Vec<Chosen>) -> Self {
        let seed = Seed::campaign(plan.seed);
        let source = Source::Listed(points);
        Self { stage: Stage::Active, seed, sampler: "active", first_index, source }
    }

    /// The scenarios of a suite, in all its rounds.
    pub fn suite(stage: &SuiteStage, seed: u64) -> Self {
        let source = Source::Suite(Box::new(stage.clone()));
        Self { stage: Stage::Suite, seed: Seed::campaign(seed), sampler: "suite", first_index: 0, source }
    }

    /// The stage.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The name of the sampler.
    pub fn sampler(&self) -> &'static str {
        self.sampler
    }

    /// The number of points.
    pub fn len(&self) -> u64 {
        match &self.source {
            Source::Drawn { designs, .. } => designs.iter().map(|design| design.len() as u64).sum(),
            Source::Listed(points) => points.len() as u64,
            Source::Suite(stage) => stage.episodes(),
        }
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The indices in the campaign, in increasing order.
    pub fn indices(&self) -> std::ops::Range<u64> {
        self.first_index..self.first_index + self.len()
    }

    /// The scenario of episode `index` of the campaign, if it belongs to this stage.
    pub fn scenario(&self, index: u64) -> Option<Scenario> {
        match &self.source {
            Source::Drawn { designs, .. } => {
                let (design, i) = self.locate(designs, index)?;
                Some(Scenario { index, seed: self.seed.episode(index), requested: design.assignment(i)? })
            }
            Source::Listed(points) => {
                let requested = points.get(self.place(index)?)?.requested.clone();
                Some(Scenario { index, seed: self.seed.episode(index), requested })
            }
            Source::Suite(stage) => self.indices().contains(&index).then(|| stage.suite.scenario(self.seed, index)),
        }
    }

    /// The requested parameters of episode `index` of the campaign, if it belongs to this stage.
    pub fn requested(&self, index: u64) -> Option<Assignment> {
        self.scenario(index).map(|scenario| scenario.requested)
    }

    /// The suite scenario of episode `index`. Empty if points are sampled from a space.
    pub fn label(&self, index: u64) -> Label {
        match &self.source {
            Source::Drawn { .. } | Source::Listed(_) => Label::default(),
            Source::Suite(stage) => stage.label(index),
        }
    }

    /// The weight p(x)/q(x) of episode `index`. It is 1 in the first stage, which samples the operating density, and in
    /// a suite, which has no density.
    pub fn weight(&self, index: u64) -> Option<f64> {
        match &self.source {
            Source::Drawn { designs, weights } => {
                let (design, i) = self.locate(designs, index)?;
                let coded = design.coded(i)?;
                Some(weights.as_ref().map_or(1.0, |weights| weights.of(coded)))
            }
            Source::Listed(points) => Some(points.get(self.place(index)?)?.weight),
            Source::Suite(_) => self.indices().contains(&index).then_some(1.0),
        }
    }

    /// The name of the design of episode `index`.
    fn design(&self, index: u64) -> &'static str {
        match &self.source {
            Source::Listed(points) => {
                self.place(index).and_then(|at| points.get(at)).map_or(self.sampler, |point| point.choice.as_str())
            }
            Source::Drawn { .. } | Source::Suite(_) => self.sampler,
        }
    }

    /// The record of an episode of this stage. `None` if its index belongs to another stage.
    pub(crate) fn entry(&self, episode: Episode) -> Option<Entry> {
        let index = episode.scenario.index;
        let (weight, label) = (self.weight(index)?, self.label(index));
        let design = self.design(index).to_owned();
        let stage = self.stage.as_str().to_owned();
        Some(Entry { stage, design, weight, label, episode })
    }

    /// The position of an episode in the stage or round, if it does not come before it.
    fn place(&self, index: u64) -> Option<usize> {
        usize::try_from(index.checked_sub(self.first_index)?).ok()
    }

    fn locate<'a>(&self, designs: &'a [Design], index: u64) -> Option<(&'a Design, usize)> {
        let mut i = self.place(index)?;
        for design in designs {
            if i < design.len() {
                return Some((design, i));
            }
            i -= design.len();
        }
        None
    }
}
