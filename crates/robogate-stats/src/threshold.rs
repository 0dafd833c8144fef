//! Thresholds: where the success rate crosses a level along one parameter.
//!
//! The rows are divided into bins. Isotonic regression makes the binned rates monotone, rising or falling, whichever
//! has the smaller weighted squared error. The threshold is where the line between the mean positions of neighbouring
//! bins crosses the level. Its uncertainty comes from a bootstrap of rows, computed on the cell counts
//! ([`crate::resample`]): percentile interval and standard error, with direction and positions as observed. A replicate
//! that does not cross counts as "beyond the range" on its side, so an interval can be open.
//!
//! "More than once" is a significant result: bins whose Wilson interval, at a level shared over all bins (Bonferroni),
//! is entirely on one side of the level must change sides twice.
//!
//! Weights enter as sums per bin. The bootstrap samples counts of up to 16 weight classes per cell. With at most 16
//! distinct weights this equals the bootstrap of rows; otherwise the spread within a class is ignored.
//!
//! Limit: the threshold is marginal over the other parameters and applies to their design. Within a bin
//! the rate is interpolated linearly. Where a jump explains the rows at least as well as a logistic curve, the interval also contains
//! that of the jump (`jump.rs`); where it explains them clearly better, it is that of the jump. A Latin hypercube makes the interval conservative.
//!
//! Sources: robogate paper, table of critical thresholds; Barlow et
//! al. (1972) for isotonic regression; Efron and Tibshirani (1993), chapter 13.

use std::collections::{BTreeMap, BTreeSet};

use crate::binning::{BinningError, Edges};
use crate::clusters::{Clusters, RateByCluster};
use crate::interval::{Confidence, Interval, wilson_real};
use crate::jump::jump;
use crate::resample::{multinomial, percentile_ends, standard_error, uniform};
use crate::weighted::is_weight;
use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

/// Maximum number of weight classes per cell.
const CLASSES: usize = 16;

/// Options of the threshold search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThresholdOptions {
    /// Success rate of the crossing, strictly between 0 and 1.
    pub level: f64,
    /// Number of bootstrap replicates. The paper uses 1,000.
    pub replicates: usize,
    /// Confidence level of the interval.
    pub confidence: Confidence,
    /// Seed of the bootstrap.
    pub seed: u64,
}

impl Default for ThresholdOptions {
    fn default() -> Self {
        Self { level: 0.5, replicates: 1_000, confidence: Confidence::P95, seed: 0 }
    }
}

/// Whether the success rate increases or decreases along the parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// The rate increases.
    Rising,
    /// The rate decreases.
    Falling,
}

/// The side of the level on which the rate stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StaysAt {
    /// At or above the level everywhere.
    Above,
    /// Below the level everywhere.
    Below,
}

/// The result along the parameter.
#[derive(Debug, Clone, PartialEq)]
pub enum Threshold {
    /// The rate crosses the level once.
    Crosses {
        /// Value of the parameter at the crossing.
        at: f64,
        /// Whether the success rate increases or decreases.
        direction: Direction,
        /// Lower end of the percentile interval. `None` if it is outside the observed range.
        low: Option<f64>,
        /// Upper end of the percentile interval. `None` if it is outside the observed range.
        high: Option<f64>,
        /// Bootstrap standard error. `None` if some replicates do not cross.
        se: Option<f64>,
        /// Fraction of replicates that cross within the range.
        crossing_share: f64,
    },
    /// The rate crosses the level more than once: no single threshold exists.
    CrossesMoreThanOnce {
        /// The ranges of the parameter that contain one crossing each, in order.
        between: Vec<Interval>,
    },
    /// The rate stays on one side.
    DoesNotCross {
        /// The side.
        stays: StaysAt,
        /// Fraction of replicates that cross: the uncertainty of this result.
        crossing_share: f64,
    },
}

/// The rates along the parameter and the resulting threshold.
#[derive(Debug, Clone, PartialEq)]
pub struct ThresholdResult {
    /// The threshold.
    pub threshold: Threshold,
    /// Non-empty bins: mean position, observed rate, monotone rate.
    pub bins: Vec<ThresholdBin>,
}

/// One bin along the parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThresholdBin {
    /// Mean of the parameter over the bin's rows.
    pub position: f64,
    /// Observed (weighted) success rate.
    pub rate: f64,
    /// Rate after isotonic regression.
    pub monotone_rate: f64,
    /// Wilson interval at the level shared over all bins. With weights it uses Kish's effective count.
    pub interval: Interval,
    /// Rows with positive weight.
    pub rows: usize,
}

/// The reason why the search for a threshold is impossible.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ThresholdError {
    /// Lengths or values do not match.
    #[error(transparent)]
    Binning(#[from] BinningError),
    /// A weight is negative, NaN, or so large or small that its square over- or underflows.
    #[error("the weight of row {row} is {value}. Expected 0 or a number from 1e-150 to 1e150")]
    BadWeight {
        /// Index of the row.
        row: usize,
        /// Value found.
        value: f64,
    },
    /// The level is not strictly between 0 and 1.
    #[error("the level {level} is out of range. Expected a number in (0, 1)")]
    BadLevel {
        /// Value found.
        level: f64,
    },
    /// Fewer than two bins contain rows.
    #[error("{filled} bins contain rows. A crossing needs at least 2")]
    TooFewBins {
        /// Bins with rows of positive weight.
        filled: usize,
    },
}

/// Counts of one outcome in one weight class of one bin.
#[derive(Clone, Copy, Default)]
struct Cell {
    count: u64,
    weight: f64,
}

/// Searches for a crossing of `options.level` along `values`, binned at `edges`. Rows outside the edges are ignored. If rows
/// come in `clusters`, which exclude weights, the bootstrap samples whole clusters.
///
/// # Errors
/// Inputs that do not match, or fewer than two bins with rows.
pub fn threshold(
    values: &[f64],
    outcomes: &[bool],
    weights: Option<&[f64]>,
    clusters: Option<&Clusters>,
    edges: &Edges,
    options: ThresholdOptions,
) -> Result<ThresholdResult, ThresholdError> {
    let level = options.level;
    if !(level > 0.0 && level < 1.0) {
        return Err(ThresholdError::BadLevel { level });
    }
    for found in
        [Some(values.len()), weights.map(<[f64]>::len), clusters.map(|of| of.of_row().len())].into_iter().flatten()
    {
        if found != outcomes.len() {
            let expected = outcomes.len();
            return Err(BinningError::Length { expected, found }.into());
        }
    }
    if let Some((row, value)) = weights.and_then(|w| w.iter().copied().enumerate().find(|(_, w)| !is_weight(*w))) {
        return Err(ThresholdError::BadWeight { row, value });
    }
    let mut table = Table::new(values, outcomes, weights, edges);
    let blocks = clusters.map(|clusters| table.by_cluster(values, outcomes, clusters, edges)).unwrap_or_default();
    let filled = table.positions.len();
    if filled < 2 {
        return Err(ThresholdError::TooFewBins { filled });
    }
    let observed: Vec<u64> = table.cells.iter().map(|c| c.count).collect();
    let (mut rates, mut sizes) = (vec![0.0; filled], vec![0.0; filled]);
    table.rates(&observed, &mut rates, &mut sizes);

    let rising = isotonic(&rates, &sizes, Direction::Rising);
    let falling = isotonic(&rates, &sizes, Direction::Falling);
    let squares =
        |fit: &[f64]| -> f64 { fit.iter().zip(&rates).zip(&sizes).map(|((f, r), s)| s * (f - r).powi(2)).sum() };
    let (direction, monotone) =
        if squares(&rising) <= squares(&falling) { (Direction::Rising, rising) } else { (Direction::Falling, falling) };

    let z = options.confidence.shared_by(filled).z();
    let bins: Vec<ThresholdBin> = (0..filled)
        .map(|b| ThresholdBin {
            position: table.positions[b],
            rate: rates[b],
            monotone_rate: monotone[b],
            interval: wilson_real(rates[b] * table.effective[b], table.effective[b], z),
            rows: table.rows[b],
        })
        .collect();
    let between = sure_changes(&bins, level);
    if between.len() > 1 {
        return Ok(ThresholdResult { threshold: Threshold::CrossesMoreThanOnce { between }, bins });
    }

    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut drawn = vec![0; observed.len()];
    let mut replicates = Vec::with_capacity(options.replicates);
    for _ in 0..options.replicates {
        if blocks.is_empty() {
            multinomial(&mut rng, &observed, &mut drawn);
        } else {
            drawn.fill(0);
            for _ in 0..blocks.len() {
                let block = &blocks[(uniform(&mut rng) * blocks.len() as f64) as usize];
                block.iter().for_each(|(cell, count)| drawn[*cell] += count);
            }
        }
        table.rates(&drawn, &mut rates, &mut sizes);
        let fitted = isotonic(&rates, &sizes, direction);
        replicates.push(crossing(&table.positions, &fitted, &sizes, level, direction));
    }
    let crossing_count = replicates.iter().filter(|r| r.is_finite()).count();
    let crossing_share = crossing_count as f64 / options.replicates.max(1) as f64;

    let observed_sizes = vec![1.0; filled];
    let at = crossing(&table.positions, &monotone, &observed_sizes, level, direction);
    let found = if at.is_finite() {
        let se = standard_error(&replicates);
        let mut ends = percentile_ends(&mut replicates, options.confidence);
        let share = match clusters {
            Some(clusters) => {
                let of = RateByCluster::of(&[clusters], outcomes, |_| true);
                of.effective / (of.trials.n() as f64).max(1.0)
            }
            None => 1.0,
        };
        // The bins cannot locate a jump within a bin.
        let mut at = at;
        if let (Some(ends), Some((jump, clear))) =
            (&mut ends, jump(values, outcomes, weights, share, (direction, level), options.confidence))
        {
            let hull = (ends.0.min(jump.low), ends.1.max(jump.high));
            *ends = if clear { (jump.low, jump.high) } else { hull };
            at = at.clamp(jump.low.min(ends.0), jump.high.max(ends.1));
        }
        Threshold::Crosses {
            at,
            direction,
            low: ends.map(|e| e.0).filter(|e| e.is_finite()),
            high: ends.map(|e| e.1).filter(|e| e.is_finite()),
            se,
            crossing_share,
        }
    } else {
        let above = (at > 0.0) == (direction == Direction::Falling);
        Threshold::DoesNotCross { stays: if above { StaysAt::Above } else { StaysAt::Below }, crossing_share }
    };
    Ok(ThresholdResult { threshold: found, bins })
}

/// Ranges between bins that lie significantly on different sides of the level.
fn sure_changes(bins: &[ThresholdBin], level: f64) -> Vec<Interval> {
    let mut changes = Vec::new();
    let mut last: Option<(f64, bool)> = None;
    for bin in bins {
        let side = if bin.interval.low > level {
            true
        } else if bin.interval.high < level {
            false
        } else {
            continue;
        };
        if let Some((position, before)) = last
            && before != side
        {
            changes.push(Interval { low: position, high: bin.position });
        }
        last = Some((bin.position, side));
    }
    changes
}

/// Binned data: for each non-empty bin, `2 * classes` cells, failures before successes.
struct Table {
    classes: usize,
    cells: Vec<Cell>,
    positions: Vec<f64>,
    effective: Vec<f64>,
    rows: Vec<usize>,
}

impl Table {
    fn new(values: &[f64], outcomes: &[bool], weights: Option<&[f64]>, edges: &Edges) -> Self {
        let cuts = weights.map_or_else(Vec::new, class_cuts);
        let classes = cuts.len() + 1;
        let wide = 2 * classes;
        let mut cells = vec![Cell::default(); edges.bins() * wide];
        // Per bin: Σ w, Σ w², Σ w x, rows.
        let mut sums = vec![(0.0, 0.0, 0.0, 0_usize); edges.bins()];
        for (row, value) in values.iter().enumerate() {
            let w = weights.map_or(1.0, |w| w[row]);
            let Some(bin) = edges.bin(*value) else { continue };
            if w <= 0.0 {
                continue;
            }
            let class = cuts.partition_point(|c| *c < w);
            let cell = &mut cells[bin * wide + usize::from(outcomes[row]) * classes + class];
            cell.count += 1;
            cell.weight += w;
            let s = &mut sums[bin];
            s.0 += w;
            s.1 += w * w;
            s.2 += w * value;
            s.3 += 1;
        }
        for cell in &mut cells {
            if cell.count > 0 {
                cell.weight /= cell.count as f64;
            }
        }
        let full: Vec<usize> = (0..edges.bins()).filter(|&b| sums[b].3 > 0).collect();
        Self {
            classes,
            cells: full.iter().flat_map(|&b| cells[b * wide..(b + 1) * wide].iter().copied()).collect(),
            positions: full.iter().map(|&b| sums[b].2 / sums[b].0).collect(),
            effective: full.iter().map(|&b| sums[b].0 * sums[b].0 / sums[b].1).collect(),
            rows: full.iter().map(|&b| sums[b].3).collect(),
        }
    }

    /// The counts of each cluster, as pairs of cell and count. The effective numbers become those of clusters.
    fn by_cluster(
        &mut self,
        values: &[f64],
        outcomes: &[bool],
        clusters: &Clusters,
        edges: &Edges,
    ) -> Vec<Vec<(usize, u64)>> {
        let bin_of: Vec<Option<usize>> = values.iter().map(|value| edges.bin(*value)).collect();
        let filled: BTreeSet<usize> = bin_of.iter().copied().flatten().collect();
        let filled: Vec<usize> = filled.into_iter().collect();
        let mut blocks: Vec<BTreeMap<usize, u64>> = vec![BTreeMap::new(); clusters.count()];
        for ((bin, success), cluster) in bin_of.iter().zip(outcomes).zip(clusters.of_row()) {
            let Some(at) = bin.and_then(|bin| filled.binary_search(&bin).ok()) else { continue };
            *blocks[*cluster].entry((2 * at + usize::from(*success)) * self.classes).or_default() += 1;
        }
        for (effective, bin) in self.effective.iter_mut().zip(&filled) {
            *effective = RateByCluster::of(&[clusters], outcomes, |row| bin_of[row] == Some(*bin)).effective;
        }
        blocks.into_iter().map(|block| block.into_iter().collect()).collect()
    }

    /// Success rate and weight of every bin for the given cell counts. An empty bin has weight 0 and rate 0.
    fn rates(&self, counts: &[u64], rates: &mut [f64], sizes: &mut [f64]) {
        let wide = 2 * self.classes;
        for (b, (rate, size)) in rates.iter_mut().zip(sizes).enumerate() {
            let mut sums = [0.0; 2];
            for i in 0..wide {
                let at = b * wide + i;
                sums[i / self.classes] += counts[at] as f64 * self.cells[at].weight;
            }
            *size = sums[0] + sums[1];
            *rate = if *size > 0.0 { sums[1] / *size } else { 0.0 };
        }
    }
}

/// Upper ends of all weight classes except the last: the distinct weights, or quantiles if there are many.
fn class_cuts(weights: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = weights.iter().copied().filter(|w| *w > 0.0).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut distinct = sorted.clone();
    distinct.dedup();
    if distinct.len() <= CLASSES {
        distinct.pop();
        return distinct;
    }
    let mut cuts: Vec<f64> = (1..CLASSES).map(|i| sorted[i * sorted.len() / CLASSES]).collect();
    cuts.dedup();
    cuts
}

/// Isotonic regression by pooling adjacent violators. Bins of zero size take the value of their neighbours.
pub(crate) fn isotonic(rates: &[f64], sizes: &[f64], direction: Direction) -> Vec<f64> {
    let sign = match direction {
        Direction::Rising => 1.0,
        Direction::Falling => -1.0,
    };
    // Pools as (mean, size, bins).
    let mut pools: Vec<(f64, f64, usize)> = Vec::with_capacity(rates.len());
    for (rate, size) in rates.iter().zip(sizes) {
        let mut pool = (sign * rate, *size, 1);
        while let Some(&(mean, weight, bins)) = pools.last() {
            let violates = mean > pool.0 || pool.1 <= 0.0 || weight <= 0.0;
            if !violates {
                break;
            }
            pools.pop();
            let total = weight + pool.1;
            let mean = if total > 0.0 { (mean * weight + pool.0 * pool.1) / total } else { 0.0 };
            pool = (mean, total, bins + pool.2);
        }
        pools.push(pool);
    }
    let mut fitted = Vec::with_capacity(rates.len());
    for (mean, _, bins) in pools {
        fitted.extend(std::iter::repeat_n(sign * mean, bins));
    }
    fitted
}

/// The position where monotone rates cross the level. Infinite, with sign, if they cross outside the range.
fn crossing(positions: &[f64], fitted: &[f64], sizes: &[f64], level: f64, direction: Direction) -> f64 {
    if sizes.iter().all(|s| *s <= 0.0) {
        return f64::INFINITY;
    }
    // Before the crossing, a rising rate is below the level and a falling rate above it.
    let sign = match direction {
        Direction::Rising => 1.0,
        Direction::Falling => -1.0,
    };
    let before = |f: f64| sign * (f - level) < 0.0;
    let after = |f: f64| sign * (f - level) > 0.0;
    let last_before = fitted.iter().rposition(|f| before(*f));
    let first_after = fitted.iter().position(|f| after(*f));
    match (last_before, first_after) {
        (Some(i), Some(j)) if j == i + 1 => {
            let part = (level - fitted[i]) / (fitted[j] - fitted[i]);
            positions[i] + part * (positions[j] - positions[i])
        }
        // A plateau exactly at the level gives its middle.
        (Some(i), Some(j)) => 0.5 * (positions[i + 1] + positions[j - 1]),
        (Some(_), None) => f64::INFINITY,
        (None, _) => f64::NEG_INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2,000 rows over [0, 1]. A row succeeds if `law` exceeds its number from an even grid of probabilities.
    fn rows(law: impl Fn(f64) -> f64) -> (Vec<f64>, Vec<bool>) {
        let values: Vec<f64> = (0..2_000).map(|i| (f64::from(i) + 0.5) / 2_000.0).collect();
        let outcomes = values.iter().enumerate().map(|(i, v)| law(*v) > ((i * 787) % 2_000) as f64 / 2_000.0).collect();
        (values, outcomes)
    }

    fn look(law: impl Fn(f64) -> f64) -> Threshold {
        let (values, outcomes) = rows(law);
        let edges = Edges::equal_width(&values, 20).unwrap();
        threshold(&values, &outcomes, None, None, &edges, ThresholdOptions::default()).unwrap().threshold
    }

    #[test]
    fn rising_rate_crosses() {
        let Threshold::Crosses { at, direction, low, high, se, crossing_share } = look(|v| v) else {
            panic!("it crosses")
        };
        assert_eq!((direction, crossing_share), (Direction::Rising, 1.0));
        assert!((at - 0.5).abs() < 0.03 && low.unwrap() < 0.5 && high.unwrap() > 0.5);
        assert!((0.005..0.05).contains(&se.unwrap()));
    }

    #[test]
    fn falling_rate_crosses() {
        let Threshold::Crosses { at, direction, .. } = look(|v| 0.9 - v) else { panic!("it crosses") };
        assert_eq!(direction, Direction::Falling);
        assert!((at - 0.4).abs() < 0.03);
    }

    #[test]
    fn one_sided_rate_does_not_cross() {
        assert_eq!(look(|v| 0.1 + 0.1 * v), Threshold::DoesNotCross { stays: StaysAt::Below, crossing_share: 0.0 });
        assert_eq!(look(|v| 0.9 - 0.1 * v), Threshold::DoesNotCross { stays: StaysAt::Above, crossing_share: 0.0 });
    }

    #[test]
    fn island_has_no_threshold() {
        let found = look(|v| if (0.3..0.7).contains(&v) { 0.9 } else { 0.1 });
        let Threshold::CrossesMoreThanOnce { between } = found else { panic!("twice: {found:?}") };
        assert_eq!(between.len(), 2);
        assert!(between[0].contains(0.3) && between[1].contains(0.7));
    }

    #[test]
    fn uncertain_crossing_has_open_end() {
        // The rate ends at 51 %, so many replicates never reach the level.
        let Threshold::Crosses { high, low, se, crossing_share, .. } = look(|v| 0.2 + 0.34 * v) else {
            panic!("it crosses")
        };
        assert!(crossing_share < 1.0 && high.is_none() && low.is_some() && se.is_none());
    }

    #[test]
    fn seed_matters_equal_weights_do_not() {
        let (values, outcomes) = rows(|v| v);
        let edges = Edges::equal_width(&values, 10).unwrap();
        let run = |weights: Option<&[f64]>, seed| {
            let options = ThresholdOptions { seed, ..Default::default() };
            threshold(&values, &outcomes, weights, None, &edges, options).unwrap().threshold
        };
        assert_eq!(run(None, 1), run(None, 1));
        assert_ne!(run(None, 1), run(None, 2));
        assert_eq!(run(None, 1), run(Some(&vec![1.0; 2_000]), 1));
    }

    #[test]
    fn weights_shift_rates() {
        // Successes count double, so the crossing of rate v moves to 2v / (2v + 1 - v) = ½, v = ⅓.
        let (values, outcomes) = rows(|v| v);
        let weights: Vec<f64> = outcomes.iter().map(|o| if *o { 2.0 } else { 1.0 }).collect();
        let edges = Edges::equal_width(&values, 20).unwrap();
        let found = threshold(&values, &outcomes, Some(&weights), None, &edges, ThresholdOptions::default()).unwrap();
        let Threshold::Crosses { at, .. } = found.threshold else { panic!("it crosses") };
        assert!((at - 1.0 / 3.0).abs() < 0.03, "{at}");
    }

    #[test]
    fn invalid_input_is_handled() {
        let edges = Edges::new(vec![0.0, 1.0]).unwrap();
        let one_bin =
            threshold(&[0.1, 0.2, 0.3], &[true, false, true], None, None, &edges, ThresholdOptions::default());
        assert_eq!(one_bin, Err(ThresholdError::TooFewBins { filled: 1 }));
        let options = ThresholdOptions { level: 1.0, ..Default::default() };
        assert!(threshold(&[0.1], &[true], None, None, &edges, options).is_err());
    }
}
