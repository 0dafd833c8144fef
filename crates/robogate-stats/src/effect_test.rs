//! Does success depend on a parameter? One permutation test for trends, bends and effects of any shape.
//!
//! Units are rows, or clusters of rows. Unit i has nᵢ trials with fᵢ failures, of which eᵢ were expected from everything but
//! the parameter: the overall failure rate, or a model of the other parameters. Rows of unequal sampling probability enter with
//! their weights. The statistic is the largest of
//!
//! - the log-likelihood ratio of "inside and outside a run of neighbouring cells, the failure rates differ from the expected
//!   ones by different factors", less a constant, over all runs (levels: over all divisions by their excess of failures);
//! - z²/2 for the trend Σ sᵢ (fᵢ - eᵢ) over the ranks s less their mean (within blocks: that of the block);
//! - z²/2 for the bend, the part of s² that is not linear in s, less a constant.
//!
//! The constants compensate for the number of runs. They were chosen on normal residuals in fifty cells: at equal error, lines, curves and
//! steps, bands and single bad ends of the range are found with at least 0.9 of the power of the best of the three alone, and a
//! symmetric valley with 0.7 of that of the bend.
//!
//! The units are permuted over the values of the parameter, and the p-value is the share of permutations with at least the
//! observed statistic. If the values are sampled independently of all other parameters, the test is exact for any number of
//! units, any rate and any expectation, because an expectation does not depend on the parameter. Units of one block are permuted
//! among each other only, so that differences between blocks do not matter.
//!
//! Sources: Kulldorff (1997), Communications in Statistics 26(6), for scans with expectations; Candes et al. (2018), JRSS B
//! 80(3), for tests that resample one parameter conditional on all other data.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::resample::shuffle;
use crate::scan::{NARROWEST, Scan, sequential};

/// What the statistic of a run is reduced by. There are about fifty runs that overlap little.
const OF_RUNS: f64 = 5.0;
/// What the statistic of the bend is reduced by.
const OF_BEND: f64 = 1.2;

/// A row, or a cluster of rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Trials, or the weight of one.
    pub n: f64,
    /// Failures among them, with the same weight.
    pub failures: f64,
    /// Failures that were expected without knowledge of the parameter.
    pub expected: f64,
}

/// The values of a parameter, one for each unit.
#[derive(Debug, Clone, Copy)]
pub enum Values<'a> {
    /// Numbers: the cell of each, and its rank. Units with equal numbers have equal ranks.
    Ordered {
        /// The cell of each unit.
        cell_of: &'a [usize],
        /// The ranks on any scale.
        ranks: &'a [f64],
    },
    /// The level of each unit.
    Levels(&'a [usize]),
}

impl Values<'_> {
    fn cell_of(&self) -> &[usize] {
        match self {
            Self::Ordered { cell_of, .. } => cell_of,
            Self::Levels(cell_of) => cell_of,
        }
    }
}

/// Tests whether success depends on the parameter. Every cell is below `cells`. Units with equal `blocks` are permuted among each
/// other; without blocks, all are. The smallest p-value is 1 / (`replicates` + 1).
///
/// `None` for lists of different lengths, for a cell that does not exist, for fewer than two cells with trials, and if no unit
/// differs from its expectation.
pub fn effect_test(
    units: &[Unit],
    values: Values<'_>,
    cells: usize,
    blocks: Option<&[usize]>,
    replicates: usize,
    seed: u64,
) -> Option<Scan> {
    let cell_of = values.cell_of();
    let lengths = cell_of.len() == units.len() && blocks.is_none_or(|blocks| blocks.len() == units.len());
    let ranked = !matches!(values, Values::Ordered { ranks, .. } if ranks.len() != units.len());
    if !lengths || !ranked || cell_of.iter().any(|cell| *cell >= cells) {
        return None;
    }
    // Units block by block, so that a block is a slice.
    let mut order: Vec<usize> = (0..units.len()).collect();
    let mut ends = vec![units.len()];
    if let Some(blocks) = blocks {
        order.sort_by_key(|unit| blocks[*unit]);
        ends = order
            .chunk_by(|a, b| blocks[*a] == blocks[*b])
            .scan(0, |at, of| {
                *at += of.len();
                Some(*at)
            })
            .collect();
    }
    let mut units: Vec<Unit> = order.iter().map(|unit| units[*unit]).collect();
    let mut tested = Tested::new(&units, values, &order, &ends, cells)?;
    let (log_ratio, low) = tested.observed(&units)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let p = sequential(log_ratio, replicates, || {
        let mut from = 0;
        for to in &ends {
            shuffle(&mut rng, &mut units[from..*to]);
            from = *to;
        }
        tested.statistic(&units)
    });
    Some(Scan { log_ratio, low, p })
}

/// A direction: the coefficient of each unit's residual, and the standard deviation of the sum over permutations.
struct Direction {
    of: Vec<f64>,
    deviation: f64,
    reduced_by: f64,
}

/// Everything that does not change with the order of the units.
struct Tested {
    cell_of: Vec<usize>,
    ordered: bool,
    directions: Vec<Direction>,
    /// The variance of independent trials over that of the units: about 1 for rows, less for weighted rows and for clusters.
    scale: f64,
    totals: [f64; 3],
    sums: Vec<[f64; 3]>,
    before: Vec<[f64; 3]>,
    levels: Vec<usize>,
}

impl Tested {
    fn new(units: &[Unit], values: Values<'_>, order: &[usize], ends: &[usize], cells: usize) -> Option<Self> {
        let cell_of: Vec<usize> = order.iter().map(|unit| values.cell_of()[*unit]).collect();
        let residuals: Vec<f64> = units.iter().map(|unit| unit.failures - unit.expected).collect();
        let expected_square: f64 = units.iter().map(|unit| unit.expected * (1.0 - unit.expected / unit.n)).sum();
        let square: f64 = residuals.iter().map(|r| r * r).sum();
        let totals = units.iter().fold([0.0; 3], add);
        if totals[1] <= 0.0 || totals[1] >= totals[0] || totals[2] <= 0.0 || totals[2] >= totals[0] {
            return None;
        }
        let mut directions = Vec::new();
        if let Values::Ordered { ranks, .. } = values {
            let ranks: Vec<f64> = order.iter().map(|unit| ranks[*unit]).collect();
            let line = centred_within(&ranks, ends);
            let square = centred_within(&line.iter().map(|s| s * s).collect::<Vec<_>>(), ends);
            let (both, own) = line.iter().zip(&square).fold((0.0, 0.0), |(b, o), (s, q)| (b + s * q, o + s * s));
            let slope = if own > 0.0 { both / own } else { 0.0 };
            let bend: Vec<f64> = line.iter().zip(&square).map(|(s, q)| q - slope * s).collect();
            for (of, reduced_by) in [(line, 0.0), (bend, OF_BEND)] {
                let deviation = permutation_deviation(&of, &residuals, ends);
                if deviation > 0.0 {
                    directions.push(Direction { of, deviation, reduced_by });
                }
            }
        }
        Some(Self {
            cell_of,
            ordered: matches!(values, Values::Ordered { .. }),
            directions,
            scale: if square > 0.0 { expected_square / square } else { 1.0 },
            totals,
            sums: vec![[0.0; 3]; cells],
            before: Vec::new(),
            levels: Vec::new(),
        })
    }

    /// The statistic, and whether each cell belongs to the group with more failures than expected.
    fn observed(&mut self, units: &[Unit]) -> Option<(f64, Vec<bool>)> {
        let mut best = (f64::NEG_INFINITY, [0; 2]);
        self.visit(units, |ratio, run| {
            if ratio > best.0 {
                best = (ratio, run);
            }
        });
        let (ratio, [from, to]) = best;
        let mut low = vec![false; self.sums.len()];
        match self.ordered {
            true => low.get_mut(from..to)?.fill(true),
            false => self.levels.get(from..to)?.iter().for_each(|level| low[*level] = true),
        }
        let excess = |wanted: bool| {
            let inside = self.sums.iter().zip(&low).filter(|(_, low)| **low == wanted);
            let [_, f, e] = inside.fold([0.0; 3], |sum, (cell, _)| plus(sum, *cell));
            f / e.max(f64::MIN_POSITIVE)
        };
        if excess(true) < excess(false) {
            low.iter_mut().for_each(|low| *low = !*low);
        }
        ratio.is_finite().then(|| (self.largest(ratio, units), low))
    }

    fn statistic(&mut self, units: &[Unit]) -> f64 {
        let mut best = f64::NEG_INFINITY;
        self.visit(units, |ratio, _| best = best.max(ratio));
        self.largest(best, units)
    }

    /// The largest of the ratio of runs and those of the directions.
    fn largest(&self, ratio: f64, units: &[Unit]) -> f64 {
        let of_runs = if self.ordered { ratio - OF_RUNS } else { ratio };
        self.directions.iter().fold(of_runs, |best, direction| {
            let sum: f64 = direction.of.iter().zip(units).map(|(c, unit)| c * (unit.failures - unit.expected)).sum();
            best.max(0.5 * (sum / direction.deviation).powi(2) - direction.reduced_by)
        })
    }

    /// Calls `visit` with the log-likelihood ratio of each division and the group of one side.
    fn visit(&mut self, units: &[Unit], mut visit: impl FnMut(f64, [usize; 2])) {
        self.sums.fill([0.0; 3]);
        for (unit, cell) in units.iter().zip(&self.cell_of) {
            self.sums[*cell] = add(self.sums[*cell], unit);
        }
        self.levels.clear();
        self.levels.extend((0..self.sums.len()).filter(|cell| self.ordered || self.sums[*cell][0] > 0.0));
        if !self.ordered {
            let excess = |cell: usize| (self.sums[cell][1] - self.sums[cell][2]) / self.sums[cell][0];
            self.levels.sort_by(|a, b| excess(*a).total_cmp(&excess(*b)));
        }
        self.before.clear();
        self.before.push([0.0; 3]);
        for level in &self.levels {
            let last = self.before.last().copied().unwrap_or_default();
            self.before.push(plus(last, self.sums[*level]));
        }
        let cells = self.levels.len();
        let (narrowest, starts) = if self.ordered { ((cells / NARROWEST).max(1), cells) } else { (1, 1) };
        let all = self.totals;
        let one = against(all);
        for (from, start) in self.before.iter().enumerate().take(starts) {
            for (to, end) in self.before.iter().enumerate().skip(from + narrowest) {
                let inside = minus(*end, *start);
                // A run up to the last cell is the complement of one from the first.
                if to - from + narrowest <= cells && inside[0] > 0.0 && all[0] - inside[0] > 1e-9 * all[0] {
                    visit(self.scale * (against(inside) + against(minus(all, inside)) - one), [from, to]);
                }
            }
        }
    }
}

/// The log-likelihood of the best common factor on the odds, in place of the expectation: f ln(f/e) + s ln(s/(n - e)).
fn against([n, f, e]: [f64; 3]) -> f64 {
    let term = |x: f64, of: f64| if x > 1e-12 && of > 0.0 { x * (x / of).ln() } else { 0.0 };
    term(f, e) + term(n - f, n - e)
}

fn add(sum: [f64; 3], unit: &Unit) -> [f64; 3] {
    plus(sum, [unit.n, unit.failures, unit.expected])
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn centred(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|value| value - mean).collect()
}

/// Values less the mean of their block.
fn centred_within(values: &[f64], ends: &[usize]) -> Vec<f64> {
    let starts = std::iter::once(0).chain(ends.iter().copied());
    starts.zip(ends).flat_map(|(from, to)| centred(&values[from..*to])).collect()
}

/// The standard deviation of Σ cᵢ rᵢ if the residuals are permuted within blocks, which end at `ends`.
fn permutation_deviation(coefficients: &[f64], residuals: &[f64], ends: &[usize]) -> f64 {
    let spread = |values: &[f64]| centred(values).iter().map(|v| v * v).sum::<f64>();
    let mut from = 0;
    let mut variance = 0.0;
    for to in ends {
        let size = to - from;
        if size > 1 {
            variance += spread(&coefficients[from..*to]) * spread(&residuals[from..*to]) / (size - 1) as f64;
        }
        from = *to;
    }
    variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    const CELLS: usize = 50;

    /// Rows with a uniform parameter, its cells and their p-value.
    fn p_of(seed: u64, n: usize, weighted: bool, rate: impl Fn(f64) -> f64) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let x: Vec<f64> = (0..n).map(|_| uniform(&mut rng)).collect();
        let failed: Vec<bool> = x.iter().map(|x| uniform(&mut rng) < rate(*x)).collect();
        let weight: Vec<f64> = (0..n).map(|_| if weighted { 0.2 + 1.8 * uniform(&mut rng) } else { 1.0 }).collect();
        let all: f64 = weight.iter().sum();
        let mean = weight.iter().zip(&failed).map(|(w, f)| if *f { *w } else { 0.0 }).sum::<f64>() / all;
        let unit = |(w, f): (&f64, &bool)| Unit { n: *w, failures: if *f { *w } else { 0.0 }, expected: w * mean };
        let units: Vec<Unit> = weight.iter().zip(&failed).map(unit).collect();
        let cell_of: Vec<usize> = x.iter().map(|x| (x * CELLS as f64) as usize).collect();
        let values = Values::Ordered { cell_of: &cell_of, ranks: &x };
        effect_test(&units, values, CELLS, None, 499, seed).map_or(1.0, |found| found.p)
    }

    #[test]
    fn noise_is_rejected_at_the_level() {
        for (weighted, rate, n) in [(false, 0.02, 150), (false, 0.5, 100), (true, 0.2, 200)] {
            let rejected = (0..400).filter(|seed| p_of(*seed, n, weighted, |_| rate) <= 0.05).count();
            // 5 % of 400 is 20, with a standard deviation of 4.4.
            assert!(rejected <= 33, "{rejected} of 400 at {rate}, {n} rows");
        }
    }

    #[test]
    fn trends_are_found_as_often_as_by_their_own_test() {
        // A trend test at 5 % has a power of about 80 % if the rate rises from 0.1 to 0.5 in 120 rows: 160 of 200.
        let found = (0..200).filter(|seed| p_of(*seed, 120, false, |x| 0.1 + 0.4 * x) <= 0.05).count();
        assert!(found >= 134, "{found} of 200");
        // A band of a tenth of the range.
        let band = |x: f64| if (0.4..0.5).contains(&x) { 0.6 } else { 0.1 };
        let found = (0..60).filter(|seed| p_of(*seed, 400, false, band) <= 0.05).count();
        assert!(found >= 56, "{found} of 60");
        // A valley, whose trend is zero.
        let valley = |x: f64| 0.05 + 1.2 * (x - 0.5).powi(2);
        let found = (0..60).filter(|seed| p_of(*seed, 300, false, valley) <= 0.05).count();
        assert!(found >= 40, "{found} of 60");
    }

    #[test]
    fn one_bad_level_is_found_within_blocks() {
        // Blocks differ, levels vary within them.
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let block: Vec<usize> = (0..240).map(|row| row / 40).collect();
        let level: Vec<usize> = (0..240).map(|row| row % 4).collect();
        let rate = |row: usize| 0.1 + 0.08 * block[row] as f64 + if level[row] == 2 { 0.35 } else { 0.0 };
        let failed: Vec<bool> = (0..240).map(|row| uniform(&mut rng) < rate(row)).collect();
        let mean = failed.iter().filter(|f| **f).count() as f64 / 240.0;
        let unit = |f: &bool| Unit { n: 1.0, failures: f64::from(u8::from(*f)), expected: mean };
        let units: Vec<Unit> = failed.iter().map(unit).collect();
        let found = effect_test(&units, Values::Levels(&level), 4, Some(&block), 999, 1).unwrap();
        assert!(found.p <= 0.01, "{}", found.p);
        assert_eq!(found.low, [false, false, true, false]);
        assert!(effect_test(&units, Values::Levels(&[0; 240]), 4, None, 99, 1).is_none());
        assert!(effect_test(&units[..9], Values::Levels(&level), 4, None, 99, 1).is_none());
    }

    #[test]
    fn repeated_scenarios_are_one_unit_each() {
        // Twenty scenarios of fifty repeats that always or never succeed: rows are many, units are few.
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let cell_of: Vec<usize> = (0..20).map(|unit| unit / 5).collect();
        let ranks: Vec<f64> = (0..20).map(f64::from).collect();
        let mut rejected = 0;
        for set in 0..200 {
            let failed: Vec<f64> = (0..20).map(|_| if uniform(&mut rng) < 0.5 { 50.0 } else { 0.0 }).collect();
            let mean = failed.iter().sum::<f64>() / 20.0;
            let units: Vec<Unit> =
                failed.iter().map(|failures| Unit { n: 50.0, failures: *failures, expected: mean }).collect();
            let values = Values::Ordered { cell_of: &cell_of, ranks: &ranks };
            rejected += u32::from(effect_test(&units, values, 4, None, 199, set).is_some_and(|found| found.p <= 0.05));
        }
        assert!(rejected <= 20, "{rejected} of 200");
    }

    #[test]
    fn blocks_with_own_rates_are_not_effects() {
        let mut rejected = 0;
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let rates: Vec<f64> = (0..8).map(|_| uniform(&mut rng)).collect();
            let block: Vec<usize> = (0..480).map(|row| row / 60).collect();
            // The value is confounded with the block in half of the rows.
            let cell_of: Vec<usize> = block
                .iter()
                .map(|of| if uniform(&mut rng) < 0.5 { *of } else { (8.0 * uniform(&mut rng)) as usize })
                .collect();
            let ranks: Vec<f64> = cell_of.iter().map(|cell| *cell as f64).collect();
            let failed: Vec<bool> = block.iter().map(|of| uniform(&mut rng) < rates[*of]).collect();
            let mean = failed.iter().filter(|f| **f).count() as f64 / 480.0;
            let unit = |f: &bool| Unit { n: 1.0, failures: f64::from(u8::from(*f)), expected: mean };
            let units: Vec<Unit> = failed.iter().map(unit).collect();
            let values = Values::Ordered { cell_of: &cell_of, ranks: &ranks };
            rejected +=
                u32::from(effect_test(&units, values, 8, Some(&block), 400, seed).is_some_and(|found| found.p <= 0.05));
        }
        assert!(rejected <= 20, "{rejected} of 200");
    }
}
