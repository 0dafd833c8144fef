//! Which parameters have an effect on success, in which shape, and which pairs interact.
//!
//! Headlines name a parameter only if it passes the test of this module. Under the hypothesis that success depends on
//! nothing, the probability that anything is named is at most 2.5 %: 2.1 % for single parameters (permutation tests of trends, bends
//! and any shape, [`robogate_stats::effect_test`]; Holm), 0.4 % for interactions of two (score tests, Holm). Adjusted p-values are
//! scaled so that 0.025 is the limit of both.
//!
//! All rows are tested, with their sampling weights. The failures that a test expects in a row come from a model of all other
//! parameters ([`expected`]), which removes their part of the variance.

mod expected;
mod interaction;
mod shape;

use robogate_stats::Trials;
use robogate_stats::binning::Edges;
use robogate_stats::clusters::{Clusters, FEWEST};
use robogate_stats::correlation::midranks;
use robogate_stats::effect_test::{Unit, Values, effect_test};
use robogate_stats::multiplicity::holm;
use robogate_stats::scan::{Order, Scan, rank_units, scan};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use interaction::Interaction;
pub use shape::{EffectShape, RateStep, ShapeKind};

use crate::Finding;
use crate::marginal::integer_edges;
use crate::table::{ParameterColumn, ParameterKind, Sample, rounded};

/// The error probability of everything that is named. It is below the usual 5 %, so that the share of false reports in a
/// few hundred simulated ones is below 5 % too.
pub const LEVEL: f64 = 0.025;
/// The part of it for single parameters. The rest is for interactions.
pub(crate) const SINGLE: f64 = 0.84;
/// Cells of a numeric parameter in the test, and where counts of more rows than [`MODELLED_ROWS`] are scanned. A run of cells starts
/// and ends within half a cell of an effect.
const TEST_CELLS: usize = 50;
const SCAN_CELLS: usize = 100;
/// Most rows without weights whose failures are compared with a model of the other parameters. With more, counts are scanned.
const MODELLED_ROWS: usize = 20_000;
/// Permuted rows of one test, at most, unless fewer than [`REPLICATES`] permutations would be left.
const PERMUTED: usize = 40_000_000;
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
        let modelled = base.weights.is_some() || base.strata.is_some() || base.len() <= MODELLED_ROWS;
        for (at, parameter) in base.parameters.iter().enumerate() {
            let counted = base.is_plain() && !modelled;
            let Some(cells) = TestCells::of(base, parameter, if counted { SCAN_CELLS } else { TEST_CELLS }) else {
                continue;
            };
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
                None if counted => scan(&cells.trials, cells.order, replicates, seed),
                None => {
                    let replicates = replicates.min((PERMUTED / base.len().max(1)).max(REPLICATES));
                    let blocks = base.strata.as_ref().map(Clusters::of_row);
                    cells.test(base, parameter, &expected::units(base, at), blocks, replicates, seed)
                }
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
        let (interactions, pairs_tested) = if base.dependence.is_some() || base.strata.is_some() {
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
    let part = base.comparable(&parameter.name);
    let own = part.as_ref().and_then(|part| {
        let column = part.parameter(&parameter.name)?;
        Some((part, column, TestCells::of(part, column, TEST_CELLS)?))
    });
    let (base, parameter, cells) =
        own.as_ref().map_or((base, parameter, cells), |(part, column, own)| (*part, *column, own));
    let adjusted_p = adjusted.min(1.0);
    let significant = adjusted_p <= LEVEL;
    ParameterEffect {
        parameter: parameter.name.clone(),
        influence: influence(&cells.merged(base)),
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
/// by the variance of the outcome. The counts are those of independent rows.
fn influence(cells: &[Trials]) -> f64 {
    let n: f64 = cells.iter().map(|c| c.n() as f64).sum();
    let rate = cells.iter().map(|c| c.successes() as f64).sum::<f64>() / n.max(1.0);
    let total = rate * (1.0 - rate);
    let between: f64 = cells
        .iter()
        .filter(|cell| cell.n() > 1)
        .filter_map(|cell| Some((cell.n() as f64, cell.rate()?)))
        .map(|(m, p)| m / n * ((p - rate).powi(2) - p * (1.0 - p) / (m - 1.0)))
        .sum();
    if total > 0.0 { (between / total).clamp(0.0, 1.0) } else { 0.0 }
}

/// The counts of cells, as many as independent rows would have with the same variance.
fn independent_cells(base: &Sample, cells: usize, cell_of: impl Fn(usize) -> Option<usize>) -> Vec<Trials> {
    let Some(dependence) = &base.dependence else { return base.effective_cells(cells, cell_of) };
    // Each row counts for less than an independent one. Few clusters are in one cell, so all rows tell how much less.
    let share = dependence.share(base);
    let mut counts = vec![(0_u64, 0_u64); cells];
    for (row, success) in base.success.iter().enumerate() {
        if let Some((k, n)) = cell_of(row).and_then(|cell| counts.get_mut(cell)) {
            *k += u64::from(*success);
            *n += 1;
        }
    }
    counts.into_iter().map(|(k, n)| rounded(k as f64 / n.max(1) as f64, n as f64 * share)).collect()
}

/// The cells of a parameter in the test.
struct TestCells {
    cell_of: Vec<usize>,
    trials: Vec<Trials>,
    order: Order,
    /// The edges of a numeric parameter.
    edges: Option<Edges>,
}

impl TestCells {
    fn of(base: &Sample, parameter: &ParameterColumn, most: usize) -> Option<Self> {
        let (edges, cells) = match &parameter.kind {
            ParameterKind::Categorical { levels } => (None, levels.len()),
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => {
                let edges = edges(parameter, most)?;
                let cells = edges.bins();
                (Some(edges), cells)
            }
        };
        let order = if edges.is_some() { Order::Ordered } else { Order::Unordered };
        let mut of = Self { cell_of: Vec::new(), trials: Vec::new(), order, edges };
        of.cell_of = parameter.values.iter().map(|value| of.cell(*value)).collect();
        let mut counts = vec![(0, 0); cells];
        for (cell, success) in of.cell_of.iter().zip(&base.success) {
            let (k, n) = counts.get_mut(*cell)?;
            *k += u64::from(*success);
            *n += 1;
        }
        of.trials = counts.into_iter().map(|(k, n)| Trials::new(k, n).unwrap_or(Trials::NONE)).collect();
        Some(of)
    }

    fn cell(&self, value: f64) -> usize {
        match &self.edges {
            Some(edges) => edges.bin(value).unwrap_or(0),
            None => value as usize,
        }
    }

    /// The permutation test of units that are the rows of `base`.
    fn test(
        &self,
        base: &Sample,
        parameter: &ParameterColumn,
        units: &[Unit],
        blocks: Option<&[usize]>,
        replicates: usize,
        seed: u64,
    ) -> Option<Scan> {
        let ranks = match self.order {
            Order::Ordered => midranks(&parameter.values),
            Order::Unordered => vec![0.0; base.len()],
        };
        self.test_of(units, &self.cell_of, &ranks, blocks, replicates, seed)
    }

    fn test_of(
        &self,
        units: &[Unit],
        cell_of: &[usize],
        ranks: &[f64],
        blocks: Option<&[usize]>,
        replicates: usize,
        seed: u64,
    ) -> Option<Scan> {
        let values = match self.order {
            Order::Ordered => Values::Ordered { cell_of, ranks },
            Order::Unordered => Values::Levels(cell_of),
        };
        effect_test(units, values, self.trials.len(), blocks, replicates, seed)
    }

    /// The test of a parameter that varies between clusters: clusters are permuted. `None` with too few clusters.
    fn between(&self, base: &Sample, parameter: &ParameterColumn, clusters: &Clusters, seed: u64) -> Option<Scan> {
        if clusters.count() < FEWEST {
            return None;
        }
        let trials = clusters.trials(&base.success, |_| true);
        let mut first = vec![None; clusters.count()];
        let mut sums = vec![0.0; clusters.count()];
        for (cluster, value) in clusters.of_row().iter().zip(&parameter.values) {
            first[*cluster].get_or_insert(*value);
            sums[*cluster] += value;
        }
        let means: Vec<f64> = sums.iter().zip(&trials).map(|(sum, unit)| sum / unit.n().max(1) as f64).collect();
        let cell_of: Vec<usize> = match self.order {
            Order::Ordered => means.iter().map(|mean| self.cell(*mean)).collect(),
            Order::Unordered => first.iter().map(|value| self.cell(value.unwrap_or(0.0))).collect(),
        };
        let failed = base.success.iter().filter(|s| !**s).count() as f64 / base.len().max(1) as f64;
        let unit =
            |of: &Trials| Unit { n: of.n() as f64, failures: of.failures() as f64, expected: failed * of.n() as f64 };
        let units: Vec<Unit> = trials.iter().map(unit).collect();
        let found = self.test_of(&units, &cell_of, &midranks(&means), None, REPLICATES, seed)?;
        if self.order == Order::Ordered && clusters.count() < SCANNED {
            let p = rank_units(&trials, &means, REPLICATES, seed)?;
            return Some(Scan { p, ..found });
        }
        Some(found)
    }

    /// The test of a parameter that varies within clusters: outcomes are permuted within each.
    fn within(&self, base: &Sample, parameter: &ParameterColumn, clusters: &Clusters, seed: u64) -> Option<Scan> {
        let step = base.len().div_ceil(WITHIN_ROWS).max(1);
        let kept: Vec<usize> = (0..base.len()).step_by(step).collect();
        let of_row: Vec<usize> = kept.iter().map(|row| clusters.of_row()[*row]).collect();
        let failed: Vec<f64> =
            clusters.trials(&base.success, |_| true).iter().map(|of| 1.0 - of.rate().unwrap_or(0.5)).collect();
        let unit = |row: &usize| Unit {
            n: 1.0,
            failures: f64::from(u8::from(!base.success[*row])),
            expected: failed[clusters.of_row()[*row]],
        };
        let units: Vec<Unit> = kept.iter().map(unit).collect();
        let cell_of: Vec<usize> = kept.iter().map(|row| self.cell_of[*row]).collect();
        let ranks = midranks(&kept.iter().map(|row| parameter.values[*row]).collect::<Vec<_>>());
        self.test_of(&units, &cell_of, &ranks, Some(&of_row), REPLICATES, seed)
    }

    /// The cells for the estimate of the influence: neighbours together, because narrow cells only add noise to it.
    fn merged(&self, base: &Sample) -> Vec<Trials> {
        let cells = self.trials.len();
        let together = match self.order {
            Order::Ordered => cells.div_ceil(INFLUENCE_CELLS).max(1),
            Order::Unordered => 1,
        };
        independent_cells(base, cells.div_ceil(together), |row| Some(self.cell_of[row] / together))
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
