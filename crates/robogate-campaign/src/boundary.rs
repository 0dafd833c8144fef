//! Finds the boundary between success and failure, and the region of the second stage.
//!
//! The range of each continuous parameter is cut into bins of equal width. Bins whose success rate in the first stage
//! is within the band belong to the boundary. The second stage samples the span from the first to the last of them. The
//! intersection over all parameters is the *volume* of the second stage. A share of its points is sampled in the part
//! of the volume where the emphasis conditions hold (paper, section 5.2 and appendix F).
//!
//! Limits. A bin averages over all other parameters. A boundary that is oblique, or hidden by a second cause of
//! failure, appears blurred, and the volume can miss parts of it. The rate of a bin is an estimate; its interval is
//! reported but does not affect the decision. A bin without valid episodes is never in the band. No point is sampled
//! outside the volume, and no weight can extend estimates of the second stage beyond it.

use robogate_core::{Domain, Parameter, ParameterSpace};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Bin, Bins, BoundaryStage, Emphasis, MarginalEffect, PlanError, Range};

/// The boundary found by the first stage and the resulting region of the second stage.
///
/// With the parameter space, the plan and the seed, it determines the points of the second stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BoundaryReport {
    /// The version of the file format.
    pub version: u32,
    /// Success rates, ends included, between which a bin belongs to the boundary.
    pub band: [f64; 2],
    /// The continuous parameters.
    pub parameters: Vec<ParameterBoundary>,
    /// The integer parameters that are restricted to a part of their range.
    pub restricted: Vec<Restricted>,
    /// The region of the second stage.
    pub volume: Region,
    /// The part of the volume with a fixed share of the points, if the plan requests one.
    pub emphasis: Option<EmphasisFound>,
}

/// The boundary of one continuous parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterBoundary {
    /// The bins with their counts.
    #[serde(flatten)]
    pub effect: MarginalEffect,
    /// The bins within the band, counted from 0.
    pub in_band: Vec<usize>,
    /// From the lower end of the first bin in the band to the upper end of the last one, if there is any.
    pub span: Option<[f64; 2]>,
    /// The sampled range, in the parameter's unit.
    pub drawn: [f64; 2],
    /// The reason for this range.
    pub drawn_from: DrawnFrom,
}

/// The reason for a sampled range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DrawnFrom {
    /// The span of the bins in the band.
    Bins,
    /// No bin is in the band: the plan's fallback, clipped to the operating space.
    Fallback,
    /// No bin is in the band and the plan has no fallback: the whole range.
    WholeRange,
}

/// An integer parameter that is restricted to a part of its range.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Restricted {
    /// The parameter's name.
    pub parameter: String,
    /// Smallest value.
    pub low: i64,
    /// Largest value.
    pub high: i64,
}

/// A part of the operating space and the number of points sampled in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Region {
    /// The number of points sampled in the region.
    pub episodes: u64,
    /// The probability of the region under the operating distribution, from 0 to 1.
    pub share_of_operating_space: f64,
}

/// The region of the emphasis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EmphasisFound {
    /// The emphasis of the plan.
    pub asked: Emphasis,
    /// The parameters for which no part of the volume meets the condition. There the emphasis uses the operating space
    /// outside the volume.
    pub beyond: Vec<String>,
    /// The sampled region. Its points come first in the stage.
    pub region: Region,
}

impl BoundaryReport {
    /// The version of the file format that is written.
    pub const VERSION: u32 = 1;

    /// Finds the boundary from the counts of the first stage.
    pub fn find(stage: &BoundaryStage, space: &ParameterSpace, bins: &Bins) -> Result<Self, PlanError> {
        let parameters: Vec<ParameterBoundary> =
            bins.marginal_effects().into_iter().map(|effect| parameter_boundary(stage, space, effect)).collect();
        let restricted = stage
            .restrict
            .iter()
            .filter_map(|range| match range.within(domain(space, &range.parameter)?)? {
                Domain::Integer { low, high } => Some(Restricted { parameter: range.parameter.clone(), low, high }),
                _ => None,
            })
            .collect();
        let nothing = Region { episodes: 0, share_of_operating_space: 0.0 };
        let mut report = Self {
            version: Self::VERSION,
            band: stage.band,
            parameters,
            restricted,
            volume: nothing,
            emphasis: stage.emphasis.clone().map(|asked| EmphasisFound { asked, beyond: Vec::new(), region: nothing }),
        };
        let focus = report.focus(space)?;
        let mut left = stage.episodes;
        if let (Some(found), Some(emphasis)) = (&mut report.emphasis, &focus.emphasis) {
            // A share of at most 1 of a count far below 2^53.
            let episodes = (found.asked.share * stage.episodes as f64).round() as u64;
            found.region = Region { episodes, share_of_operating_space: share(space, emphasis) };
            found.beyond = beyond(&found.asked, &focus.volume);
            left -= episodes.min(left);
        }
        report.volume = Region { episodes: left, share_of_operating_space: share(space, &focus.volume) };
        Ok(report)
    }

    /// Whether no bin of any parameter has a valid episode.
    pub fn is_without_evidence(&self) -> bool {
        self.parameters.iter().flat_map(|parameter| &parameter.effect.bins).all(|bin| bin.valid == 0)
    }

    /// The parameter spaces that the second stage samples. `space` is the operating space.
    pub fn focus(&self, space: &ParameterSpace) -> Result<Focus, PlanError> {
        let narrow = |parameter: &Parameter| match &parameter.domain {
            Domain::Continuous { scale, .. } => {
                let found = self.parameters.iter().find(|p| *p.effect.parameter == *parameter.name);
                found.map(|p| Domain::Continuous { low: p.drawn[0], high: p.drawn[1], scale: *scale })
            }
            Domain::Integer { .. } => {
                let held = self.restricted.iter().find(|r| *r.parameter == *parameter.name);
                held.map(|r| Domain::Integer { low: r.low, high: r.high })
            }
            Domain::Categorical { .. } => None,
        };
        let domains = space.parameters().iter().map(|p| narrow(p).unwrap_or_else(|| p.domain.clone()));
        let volume = with_domains(space, "boundary", domains.collect())?;
        let emphasis = match &self.emphasis {
            Some(found) => {
                // If the volume does not meet a condition, the operating space does. `Plan::check` has ensured this.
                let narrow = |(narrowed, whole): (&Parameter, &Parameter)| {
                    let condition = found.asked.conditions.iter().find(|c| *c.parameter == *narrowed.name);
                    condition
                        .and_then(|c| c.within(&narrowed.domain).or_else(|| c.within(&whole.domain)))
                        .unwrap_or_else(|| narrowed.domain.clone())
                };
                let domains = volume.parameters().iter().zip(space.parameters()).map(narrow).collect();
                Some(with_domains(space, "emphasis", domains)?)
            }
            None => None,
        };
        Ok(Focus { volume, emphasis })
    }
}

/// The parameter spaces that the second stage samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Focus {
    /// The intersection of the spans.
    pub volume: ParameterSpace,
    /// The part of the volume that meets the emphasis conditions. It lies outside the volume along parameters whose
    /// span does not meet them. `None` if the plan requests no emphasis.
    pub emphasis: Option<ParameterSpace>,
}

/// The parameters for which no part of the volume meets the emphasis.
fn beyond(emphasis: &Emphasis, volume: &ParameterSpace) -> Vec<String> {
    let misses = |c: &&Range| domain(volume, &c.parameter).is_some_and(|domain| c.within(domain).is_none());
    emphasis.conditions.iter().filter(misses).map(|c| c.parameter.clone()).collect()
}

fn parameter_boundary(stage: &BoundaryStage, space: &ParameterSpace, effect: MarginalEffect) -> ParameterBoundary {
    let [low, high] = stage.band;
    // A bin without valid episodes has no rate and is not in the band.
    let is_boundary = |bin: &Bin| bin.success_rate.is_some_and(|rate| low <= rate && rate <= high);
    let in_band: Vec<usize> = (0..effect.bins.len()).filter(|i| is_boundary(&effect.bins[*i])).collect();
    let span = match (in_band.first(), in_band.last()) {
        (Some(first), Some(last)) => Some([effect.bins[*first].low, effect.bins[*last].high]),
        _ => None,
    };
    let fallback = || {
        let range: &Range = stage.fallback.iter().find(|range| range.parameter == effect.parameter)?;
        match range.within(domain(space, &range.parameter)?)? {
            Domain::Continuous { low, high, .. } => Some([low, high]),
            _ => None,
        }
    };
    let (drawn, drawn_from) = match span {
        Some(span) => (span, DrawnFrom::Bins),
        None => match fallback() {
            Some(range) => (range, DrawnFrom::Fallback),
            None => {
                let ends = [effect.bins.first().map_or(0.0, |b| b.low), effect.bins.last().map_or(0.0, |b| b.high)];
                (ends, DrawnFrom::WholeRange)
            }
        },
    };
    ParameterBoundary { effect, in_band, span, drawn, drawn_from }
}

fn domain<'a>(space: &'a ParameterSpace, parameter: &str) -> Option<&'a Domain> {
    space.position(parameter).map(|at| &space.parameters()[at].domain)
}

/// A copy of the space with other domains.
fn with_domains(space: &ParameterSpace, name: &str, domains: Vec<Domain>) -> Result<ParameterSpace, PlanError> {
    let named = |(parameter, domain): (&Parameter, Domain)| Parameter { name: parameter.name.clone(), domain };
    let parameters = space.parameters().iter().zip(domains).map(named).collect();
    Ok(ParameterSpace::new(format!("{}/{name}", space.name()), parameters)?)
}

/// The probability of `part` under the operating distribution. The parameters are independent, so it is the product of
/// the fractions of each parameter's scale.
fn share(space: &ParameterSpace, part: &ParameterSpace) -> f64 {
    let along = |(whole, part): (&Parameter, &Parameter)| match (&whole.domain, &part.domain) {
        (whole, _) if whole.is_constant() => 1.0,
        (whole @ Domain::Continuous { .. }, Domain::Continuous { low, high, .. }) => {
            whole.to_unit(*high) - whole.to_unit(*low)
        }
        (whole, part) => part.levels().unwrap_or(1) as f64 / whole.levels().unwrap_or(1) as f64,
    };
    space.parameters().iter().zip(part.parameters()).map(along).product()
}

/// The weights p(x)/q(x) of the second stage's points.
///
/// p is the operating density. q = s q_E + (1 - s) q_V is the density of the stage: uniform, in each parameter's scale,
/// on the emphasis E and on the volume V, with the share s of the points in E. With the probabilities P(E) and P(V) of
/// both regions under the operating distribution, p/q = 1 / (s [x in E] / P(E) + (1 - s) [x in V] / P(V)).
///
/// The mean weight is the probability of the union of V and E under the operating distribution. The weighted mean of a
/// quantity over the stage, divided by the mean weight, estimates the mean of that quantity over the operating
/// distribution *within* this union. Source: the balance heuristic, Veach and Guibas (1995), with numbers of draws
/// fixed in advance.
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    /// The sampled regions, each with its contribution to q/p for a point inside.
    parts: Vec<(ParameterSpace, f64)>,
}

impl Weights {
    pub(crate) fn new(report: &BoundaryReport, focus: Focus) -> Self {
        let found = report.emphasis.as_ref().map(|found| found.region);
        let total = (found.map_or(0, |region| region.episodes) + report.volume.episodes) as f64;
        let regions = [(focus.emphasis, found), (Some(focus.volume), Some(report.volume))];
        let parts = regions
            .into_iter()
            .filter_map(|(space, region)| space.zip(region.filter(|region| region.episodes > 0)))
            .map(|(space, region)| (space, region.episodes as f64 / total / region.share_of_operating_space))
            .collect();
        Self { parts }
    }

    /// The weight of a point of the stage, given as coded numbers.
    pub(crate) fn of(&self, coded: &[f64]) -> f64 {
        1.0 / self.density(coded)
    }

    /// q/p at a point of the space. 0 outside the sampled regions.
    fn density(&self, coded: &[f64]) -> f64 {
        self.parts.iter().filter(|(space, _)| contains(space, coded)).map(|(_, density)| density).sum()
    }
}

/// Whether the region contains a point. Both ends count: a sampled point may be rounded to either end, and any other
/// point is there with probability 0.
fn contains(space: &ParameterSpace, coded: &[f64]) -> bool {
    space.parameters().iter().zip(coded).all(|(parameter, x)| match parameter.domain {
        Domain::Continuous { low, high, .. } => low <= *x && *x <= high,
        Domain::Integer { low, high } => low as f64 <= *x && *x <= high as f64,
        Domain::Categorical { .. } => true,
    })
}
