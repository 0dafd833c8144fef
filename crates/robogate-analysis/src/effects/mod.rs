//! Which parameters have an effect on success, in which shape, and which pairs interact.
//!
//! Headlines name a parameter only if it passes the test of this module. Under the hypothesis that success depends on
//! nothing, the probability that anything is named is at most 2.5 %: 2.1 % for single parameters (scan tests, Holm), 0.4 %
//! for interactions of two (score tests, Holm). Adjusted p-values are scaled so that 0.025 is the limit of both.

mod interaction;
mod shape;

use robogate_stats::Trials;
use robogate_stats::binning::{Edges, per_bin, per_category};
use robogate_stats::clusters::{Clusters, FEWEST};
use robogate_stats::multiplicity::holm;
use robogate_stats::scan::{Order, Scan, rank_units, scan, scan_units, scan_within};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use interaction::Interaction;
pub use shape::{EffectShape, RateStep, ShapeKind};

use crate::Finding;
use crate::marginal::integer_edges;
use crate::table::{ParameterColumn, ParameterKind, Sample};

/// The error probability of everything that is named. It is below the usual 5 %, so that the share of false reports in a
/// few hundred simulated ones is below 5 % too.
pub const LEVEL: f64 = 0.025;
/// The part of it for single parameters. The rest is for interactions.
const SINGLE: f64 = 0.84;
/// Cells of a numeric parameter in the test. A run of them starts and ends within half a cell of an effect: with 20 cells, an
/// effect in a tenth of the range could lose half of its statistic, because it covers one of them and two halves.
const TEST_CELLS: usize = 100;
/// Cells of a numeric parameter in the estimate of its influence.
const INFLUENCE_CELLS: usize = 20;
/// Share of a parameter's variance between clusters from which these are permuted. Below it, rows within clusters are.
const BETWEEN: f64 = 0.5;
/// Replicates of the tests that count clusters.
const REPLICATES: usize = 2_000;
/// Clusters from which a scan has enough units. With fewer, ranks are compared.
const SCANNED: usize = 30;
/// Most rows that are permuted within clusters.
const WITHIN_ROWS: usize = 50_000;
/// Rows that determine the edges of the cells. All rows are counted.
const EDGE_ROWS: usize = 20_000;

/// The effects of all parameters.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Effects {
    /// Parameters that were tested.
    pub tested: u64,
    /// Pairs that were tested for an interaction.
    pub pairs_tested: u64,
    /// Whether the tests count clusters, because episodes depend on each other.
    pub by_scenario: bool,
    /// The parameters, the most influential first: significant ones before the others.
    pub ranked: Vec<ParameterEffect>,
    /// Significant interactions, the smallest p-value first.
    pub interactions: Vec<Interaction>,
}

/// The effect of one parameter on success.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterEffect {
    /// The parameter.
    pub parameter: String,
    /// Estimated share of the variance of the outcome that the parameter explains alone (first-order Sobol index), from
    /// 0 to 1.
    pub influence: f64,
    /// Permutation p-value of "success does not depend on the parameter", for any shape of the dependence.
    pub p: f64,
    /// The same, adjusted for all parameters and for the tests of interactions.
    pub adjusted_p: f64,
    /// Whether the adjusted p-value is at most 0.025. Only then may a sentence name the parameter.
    pub significant: bool,
    /// Where success is high and low. Absent without a significant effect.
    pub shape: Finding<EffectShape>,
}

impl Effects {
    /// The significant effects, the most influential first.
    pub fn significant(&self) -> impl Iterator<Item = &ParameterEffect> {
        self.ranked.iter().filter(|effect| effect.significant)
    }

    /// Whether a parameter has a significant effect, alone or in an interaction.
    pub fn may_name(&self, parameter: &str) -> bool {
        self.significant().any(|effect| effect.parameter == parameter)
            || self.interactions.iter().any(|pair| pair.parameters.iter().any(|name| name == parameter))
    }

    pub(crate) fn of(base: &Sample) -> Self {
        let (mut names, mut found) = (Vec::new(), Vec::new());
        // Enough replicates for the smallest p-value that Holm's first step can need.
        let replicates = (base.parameters.len() * 500).clamp(4_000, 20_000);
        for (at, parameter) in base.parameters.iter().enumerate() {
            let Some(cells) = TestCells::of(base, parameter) else { continue };
            let seed = at as u64;
            let tested = match &base.dependence {
                Some(dependence) => {
                    let (clusters, between) = dependence.grouping_of(parameter);
                    if between > BETWEEN {
                        cells.between(base, parameter, clusters, seed)
                    } else {
                        cells.within(base, parameter, dependence.main(), seed)
                    }
                }
                None => scan(&cells.trials, cells.order, replicates, seed),
            };
            if let Some(tested) = tested {
                names.push(parameter);
                found.push((cells, tested));
            }
        }
        let p: Vec<f64> = found.iter().map(|(_, scan)| scan.p.clamp(0.0, 1.0)).collect();
        let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
        let mut ranked: Vec<ParameterEffect> = names
            .iter()
            .zip(found)
            .zip(&adjusted)
            .map(|((parameter, (cells, scan)), adjusted)| effect(base, parameter, &cells, &scan, adjusted / SINGLE))
            .collect();
        ranked.sort_by(|a, b| {
            b.significant.cmp(&a.significant).then(b.influence.total_cmp(&a.influence)).then(a.p.total_cmp(&b.p))
        });
        let (interactions, pairs_tested) = if base.dependence.is_some() {
            (Vec::new(), 0)
        } else {
            interaction::interactions(base, &ranked, 1.0 - SINGLE)
        };
        Self { tested: p.len() as u64, pairs_tested, by_scenario: base.dependence.is_some(), ranked, interactions }
    }
}

fn effect(
    base: &Sample,
    parameter: &ParameterColumn,
    cells: &TestCells,
    scan: &Scan,
    adjusted: f64,
) -> ParameterEffect {
    let adjusted_p = adjusted.min(1.0);
    let significant = adjusted_p <= LEVEL;
    ParameterEffect {
        parameter: parameter.name.clone(),
        influence: influence(&cells.merged(), base.dependence.as_ref().map_or(1.0, |of| of.share(base))),
        p: scan.p,
        adjusted_p,
        significant,
        shape: match significant {
            true => shape::shape(base, parameter, &cells.trials, &scan.low)
                .map_or_else(|| Finding::not("the rows do not determine where the rate changes"), Finding::Estimated),
            false => Finding::not("the effect is not significant"),
        },
    }
}

/// The first-order Sobol index from the rates of cells: their variance without the part that sampling explains, divided
/// by the variance of the outcome. `share` is the number of independent rows for which one row counts.
fn influence(cells: &[Trials], share: f64) -> f64 {
    let n: f64 = cells.iter().map(|c| c.n() as f64).sum();
    let rate = cells.iter().map(|c| c.successes() as f64).sum::<f64>() / n.max(1.0);
    let total = rate * (1.0 - rate);
    let between: f64 = cells
        .iter()
        .filter(|cell| cell.n() as f64 * share > 1.0)
        .filter_map(|cell| Some((cell.n() as f64, cell.rate()?)))
        .map(|(m, p)| m / n * ((p - rate).powi(2) - p * (1.0 - p) / (m * share - 1.0)))
        .sum();
    if total > 0.0 { (between / total).clamp(0.0, 1.0) } else { 0.0 }
}

/// The cells of a parameter in the test.
struct TestCells {
    trials: Vec<Trials>,
    order: Order,
    /// The edges of a numeric parameter.
    edges: Option<Edges>,
}

impl TestCells {
    fn of(base: &Sample, parameter: &ParameterColumn) -> Option<Self> {
        match &parameter.kind {
            ParameterKind::Categorical { levels } => {
                let trials = per_category(&parameter.codes(), &base.success, levels.len()).ok()?;
                Some(Self { trials, order: Order::Unordered, edges: None })
            }
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => {
                let edges = edges(parameter, TEST_CELLS)?;
                let trials = per_bin(&parameter.values, &base.success, &edges).ok()?.cells;
                Some(Self { trials, order: Order::Ordered, edges: Some(edges) })
            }
        }
    }

    fn cell(&self, value: f64) -> usize {
        match &self.edges {
            Some(edges) => edges.bin(value).unwrap_or(0),
            None => value as usize,
        }
    }

    /// The test of a parameter that varies between clusters: clusters are permuted. `None` with too few clusters.
    fn between(&self, base: &Sample, parameter: &ParameterColumn, clusters: &Clusters, seed: u64) -> Option<Scan> {
        if clusters.count() < FEWEST {
            return None;
        }
        let units = clusters.trials(&base.success, |_| true);
        let mut first = vec![None; clusters.count()];
        let mut sums = vec![0.0; clusters.count()];
        for (cluster, value) in clusters.of_row().iter().zip(&parameter.values) {
            first[*cluster].get_or_insert(*value);
            sums[*cluster] += value;
        }
        let means: Vec<f64> = sums.iter().zip(&units).map(|(sum, unit)| sum / unit.n().max(1) as f64).collect();
        let cell_of: Vec<usize> = match self.order {
            Order::Ordered => means.iter().map(|mean| self.cell(*mean)).collect(),
            Order::Unordered => first.iter().map(|value| self.cell(value.unwrap_or(0.0))).collect(),
        };
        let found = scan_units(&units, &cell_of, self.trials.len(), self.order, REPLICATES, seed)?;
        if self.order == Order::Ordered && clusters.count() < SCANNED {
            let p = rank_units(&units, &means, REPLICATES, seed)?;
            return Some(Scan { p, ..found });
        }
        Some(found)
    }

    /// The test of a parameter that varies within clusters: outcomes are permuted within each.
    fn within(&self, base: &Sample, parameter: &ParameterColumn, clusters: &Clusters, seed: u64) -> Option<Scan> {
        let step = base.len().div_ceil(WITHIN_ROWS).max(1);
        let rows = || (0..base.len()).step_by(step);
        let success: Vec<bool> = rows().map(|row| base.success[row]).collect();
        let of_row: Vec<usize> = rows().map(|row| clusters.of_row()[row]).collect();
        let cell_of: Vec<usize> = rows().map(|row| self.cell(parameter.values[row])).collect();
        scan_within(&success, &of_row, &cell_of, self.trials.len(), self.order, REPLICATES, seed)
    }

    /// The cells for the estimate of the influence: neighbours together, because narrow cells only add noise to it.
    fn merged(&self) -> Vec<Trials> {
        let together = match self.order {
            Order::Ordered => self.trials.len().div_ceil(INFLUENCE_CELLS).max(1),
            Order::Unordered => 1,
        };
        let sum = |cells: &[Trials]| {
            let (k, n) = cells.iter().fold((0, 0), |(k, n), cell| (k + cell.successes(), n + cell.n()));
            Trials::new(k, n).unwrap_or(Trials::NONE)
        };
        self.trials.chunks(together).map(sum).collect()
    }
}

/// Edges of cells of about equal count that contain every row: the levels of an integer with few of them.
fn edges(parameter: &ParameterColumn, cells: usize) -> Option<Edges> {
    let low = parameter.values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = parameter.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let outside = |edges: &Edges| low < edges.as_slice()[0] || high > edges.as_slice()[edges.bins()];
    if let Some(edges) = integer_edges(parameter).filter(|edges| !outside(edges)) {
        return Some(edges);
    }
    let step = parameter.values.len().div_ceil(EDGE_ROWS).max(1);
    let some: Vec<f64> = parameter.values.iter().copied().step_by(step).collect();
    let found = Edges::equal_count(&some, cells).ok()?;
    let mut edges = found.as_slice().to_vec();
    let last = edges.len() - 1;
    edges[0] = low;
    edges[last] = high;
    Edges::new(edges).ok()
}
