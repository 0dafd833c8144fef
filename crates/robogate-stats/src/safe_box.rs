//! The largest box of parameters in which the success rate reaches a target.
//!
//! Rows are divided at random into two halves. The first half chooses a chain of nested boxes: starting from the whole
//! space, the slab of one parameter (or the level) that is most significantly worse than the rest of the box is removed,
//! again and again, with at most [`MAX_COLUMNS`] of the parameters that pass a scan test in this half. The second half tests the boxes of the chain, from the
//! smallest to the largest, until the exact lower bound of one is below the target; the box before it is reported.
//!
//! This is a fixed sequence of tests on rows that did not choose it: the probability that the reported box has a rate below
//! the target is at most the one-sided error of one bound, for any law of outcomes.
//!
//! Sources: Friedman and Fisher (1999), Statistics and Computing 9, for peeling; Maurer, Hothorn and Lehmacher (1995) for
//! fixed sequences.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::clusters::{Clusters, FEWEST as FEWEST_CLUSTERS, RateByCluster};
use crate::interval::{Confidence, Trials, clopper_pearson, wilson};
use crate::multiplicity::holm;
use crate::resample::shuffle;
use crate::scan::{Order, Scan, scan};
use crate::weighted::hajek;

/// Maximum number of limited parameters.
pub const MAX_COLUMNS: usize = 3;
/// Maximum number of rows that choose.
const CHOOSING: usize = 20_000;
/// Cells of a numeric column among the choosing rows.
const CELLS: usize = 40;
/// Columns among which all triples are tried: those with the strongest effects.
const TRIED: usize = 6;
/// Level of the scan tests that choose the columns, after Holm's adjustment.
const LEVEL: f64 = 0.05;
/// Replicates of a scan test.
const REPLICATES: usize = 2_000;
/// Fewest choosing rows in a box.
const FEWEST: f64 = 25.0;

/// A column with its values. Codes of levels are the integers from 0.
#[derive(Debug, Clone, Copy)]
pub struct Column<'a> {
    /// One value per row.
    pub values: &'a [f64],
    /// The number of levels, if the values are codes.
    pub levels: Option<usize>,
}

/// The values of one column inside a box.
#[derive(Debug, Clone, PartialEq)]
pub enum Inside {
    /// Values from `low` to `high`. `None` where the box is not limited.
    Range {
        /// Smallest value.
        low: Option<f64>,
        /// Largest value.
        high: Option<f64>,
    },
    /// Whether each level is inside.
    Levels(Vec<bool>),
}

impl Inside {
    fn contains(&self, value: f64) -> bool {
        match self {
            Self::Range { low, high } => low.is_none_or(|l| value >= l) && high.is_none_or(|h| value <= h),
            Self::Levels(inside) => inside.get(value as usize).copied().unwrap_or(false),
        }
    }
}

/// A box: the limited columns with their values inside.
pub type Limits = Vec<(usize, Inside)>;

/// The result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The box: the verified one, otherwise the most promising one.
    pub limits: Limits,
    /// Held-out rows inside.
    pub held_out: Trials,
    /// The held-out rows.
    pub held_out_rows: u64,
    /// Exact lower confidence bound of the rate inside, from held-out rows.
    pub lower_bound: f64,
    /// Whether the bound reaches the target.
    pub verified: bool,
    /// Rows of both halves inside. Their rate is biased upwards, because one half chose the box.
    pub all: Trials,
}

/// Whether a row lies in a box.
pub fn contains(limits: &Limits, columns: &[Column<'_>], row: usize) -> bool {
    limits.iter().all(|(column, inside)| columns.get(*column).is_some_and(|c| inside.contains(c.values[row])))
}

/// Searches the largest box with a success rate of at least `target`. `confidence` is the two-sided level whose lower end
/// is the bound. If rows come in `clusters`, each is in one half, and the bound counts clusters. Rows with sampling `weights` count as
/// that many independent ones as have the same variance. `None` with fewer than 100 rows or without columns.
pub fn search(
    columns: &[Column<'_>],
    success: &[bool],
    weights: Option<&[f64]>,
    clusters: Option<&Clusters>,
    target: f64,
    confidence: Confidence,
    seed: u64,
) -> Option<Found> {
    let n = success.len();
    let lengths = columns.iter().all(|c| c.values.len() == n) && weights.is_none_or(|weights| weights.len() == n);
    if n < 100 || columns.is_empty() || !lengths {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut half = (n / 2).min(CHOOSING);
    match clusters {
        None => shuffle(&mut rng, &mut order),
        Some(clusters) => {
            let mut rank: Vec<usize> = (0..clusters.count()).collect();
            shuffle(&mut rng, &mut rank);
            order.sort_by_key(|row| rank[clusters.of_row()[*row as usize]]);
            // A cluster is in one half.
            let cluster = |at: usize| clusters.of_row()[order[at] as usize];
            while half < n && cluster(half) == cluster(half - 1) {
                half += 1;
            }
        }
    }
    let (choosing, testing) = order.split_at_mut(half);
    // Rows in order are read faster.
    choosing.sort_unstable();
    testing.sort_unstable();
    let (choosing, testing) = (&*choosing, &*testing);
    let chooser = Chooser::new(columns, success, weights, choosing);
    let chain = chooser.best_chain(target)?;
    let count = |limits: &Limits, rows: &[u32]| {
        let inside = rows.iter().map(|row| *row as usize).filter(|row| contains(limits, columns, *row));
        counted(inside.map(|row| (success[row], weights.map_or(1.0, |of| of[row]))), weights.is_some())
    };
    let mut best: Option<Found> = None;
    // The chain is nested and starts with the largest box.
    for limits in chain.into_iter().rev() {
        let held_out = count(&limits, testing);
        let lower_bound = match clusters {
            None => clopper_pearson(held_out, confidence).low,
            Some(clusters) => {
                let inside =
                    |row: usize| testing.binary_search(&(row as u32)).is_ok() && contains(&limits, columns, row);
                let found = RateByCluster::of(&[clusters], success, inside);
                if found.clusters < FEWEST_CLUSTERS { 0.0 } else { found.interval(confidence).low }
            }
        };
        let verified = lower_bound >= target;
        if !verified && best.is_some() {
            break;
        }
        let both = [count(&limits, choosing), held_out];
        let sum = |of: fn(Trials) -> u64| both.iter().map(|t| of(*t)).sum();
        let all = Trials::new(sum(Trials::successes), sum(Trials::n)).unwrap_or(Trials::NONE);
        best = Some(Found { limits, held_out, held_out_rows: testing.len() as u64, lower_bound, verified, all });
        if !verified {
            break;
        }
    }
    best
}

/// Counts of as many independent rows as have the same rate and variance.
fn counted(rows: impl Iterator<Item = (bool, f64)>, weighted: bool) -> Trials {
    if !weighted {
        return Trials::count(rows.map(|(success, _)| success));
    }
    let (success, weights): (Vec<bool>, Vec<f64>) = rows.unzip();
    let Ok(found) = hajek(&success, &weights, Confidence::P95) else { return Trials::NONE };
    let n = found.independent.floor();
    let k = (n * found.rate.unwrap_or(0.0)).round().clamp(0.0, n);
    Trials::new(k as u64, n as u64).unwrap_or(Trials::NONE)
}

/// The number of rows inside a box that show a rate of `rate` to be at least `target` with a probability of 80 %. `None`
/// if `rate` is not above `target`.
pub fn rows_needed(rate: f64, target: f64, confidence: Confidence) -> Option<u64> {
    if rate <= target || target <= 0.0 {
        return None;
    }
    // Normal approximation, then at least enough rows for a bound without failures.
    let spread = |p: f64| (p * (1.0 - p)).sqrt();
    let n = ((confidence.z() * spread(target) + 0.8416 * spread(rate.min(1.0))) / (rate - target)).powi(2);
    let without_failures = confidence.tail().ln() / target.ln();
    Some(n.max(without_failures).ceil() as u64)
}

/// The choosing rows, as cells of each column.
struct Chooser {
    cells: Vec<Coded>,
    success: Vec<bool>,
    weights: Option<Vec<f64>>,
}

struct Coded {
    /// The cell of each row.
    code: Vec<u8>,
    count: usize,
    /// The smallest and the largest value in each cell of a numeric column.
    spans: Option<Vec<[f64; 2]>>,
}

/// The cells of each column that are inside.
type Kept = Vec<Vec<bool>>;

impl Chooser {
    fn new(columns: &[Column<'_>], success: &[bool], weights: Option<&[f64]>, rows: &[u32]) -> Self {
        let cells = columns.iter().map(|column| Coded::of(column, rows)).collect();
        let weights = weights.map(|of| rows.iter().map(|row| of[*row as usize]).collect());
        Self { cells, success: rows.iter().map(|row| success[*row as usize]).collect(), weights }
    }

    /// The effective counts of some of the rows.
    fn count(&self, rows: impl Iterator<Item = u32>) -> Trials {
        let row = |row: u32| (self.success[row as usize], self.weight(row));
        counted(rows.map(row), self.weights.is_some())
    }

    fn weight(&self, row: u32) -> f64 {
        self.weights.as_ref().map_or(1.0, |of| of[row as usize])
    }

    /// The columns with a significant effect among the choosing rows, the strongest first.
    fn candidates(&self) -> Vec<usize> {
        let scanned = self.cells.iter().enumerate().filter_map(|(column, coded)| {
            let mut rows = vec![Vec::new(); coded.count];
            coded.code.iter().enumerate().for_each(|(row, code)| rows[usize::from(*code)].push(row as u32));
            let trials: Vec<Trials> = rows.into_iter().map(|rows| self.count(rows.into_iter())).collect();
            let order = if coded.spans.is_some() { Order::Ordered } else { Order::Unordered };
            Some((column, scan(&trials, order, REPLICATES, column as u64)?))
        });
        let mut scanned: Vec<(usize, Scan)> = scanned.collect();
        let p: Vec<f64> = scanned.iter().map(|(_, scan)| scan.p.min(1.0)).collect();
        let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
        let mut kept = adjusted.iter().map(|p| *p <= LEVEL);
        scanned.retain(|_| kept.next().unwrap_or(false));
        scanned.sort_by(|a, b| b.1.log_ratio.total_cmp(&a.1.log_ratio));
        scanned.into_iter().map(|(column, _)| column).collect()
    }

    /// The chain with the largest promising box, from the whole space to the smallest box.
    fn best_chain(&self, target: f64) -> Option<Vec<Limits>> {
        let candidates = self.candidates();
        let tried = candidates.len().min(TRIED);
        let mut subsets: Vec<Vec<usize>> = vec![candidates.clone()];
        for a in 0..tried {
            for b in a + 1..tried {
                for c in b + 1..tried {
                    subsets.push(vec![candidates[a], candidates[b], candidates[c]]);
                }
            }
        }
        // Whether a box looks good enough: a one-sided 84 % bound.
        let one_se = Confidence::new(0.6827).unwrap_or(Confidence::P95);
        let mut best: Option<((u64, f64), Vec<Kept>)> = None;
        for subset in subsets {
            let chain = self.peel(&subset);
            let largest = chain.iter().find(|(_, t)| wilson(*t, one_se).low >= target).map_or(0, |(_, t)| t.n());
            let highest = chain.iter().map(|(_, t)| wilson(*t, Confidence::P95).low).fold(0.0, f64::max);
            if best.as_ref().is_none_or(|(score, _)| (largest, highest) > *score) {
                // Beyond the box with the highest bound, boxes only get smaller.
                let last = chain.iter().rposition(|(_, t)| wilson(*t, Confidence::P95).low >= highest).unwrap_or(0);
                best = Some(((largest, highest), chain.into_iter().take(last + 1).map(|(kept, _)| kept).collect()));
            }
        }
        let (_, chain) = best?;
        Some(chain.iter().map(|kept| self.limits(kept)).collect())
    }

    /// Boxes of at most [`MAX_COLUMNS`] of the columns in `subset`, each inside the one before.
    fn peel(&self, subset: &[usize]) -> Vec<(Kept, Trials)> {
        let mut kept: Kept = self.cells.iter().map(|c| vec![true; c.count]).collect();
        let mut rows: Vec<u32> = (0..self.success.len() as u32).collect();
        let mut limited: Vec<usize> = Vec::new();
        let mut chain = Vec::new();
        loop {
            let inside = self.count(rows.iter().copied());
            chain.push((kept.clone(), inside));
            if inside.failures() == 0 {
                return chain;
            }
            let open = |column: &&usize| limited.len() < MAX_COLUMNS || limited.contains(column);
            let mut best: Option<(f64, usize, Vec<usize>)> = None;
            for column in subset.iter().filter(open) {
                self.worst_slab(*column, &kept[*column], &rows, inside, &mut best);
            }
            let Some((_, column, slab)) = best else { return chain };
            slab.iter().for_each(|cell| kept[column][*cell] = false);
            rows.retain(|row| kept[column][usize::from(self.cells[column].code[*row as usize])]);
            if !limited.contains(&column) {
                limited.push(column);
            }
        }
    }

    /// The slab of a column whose failures exceed those of the box most significantly.
    fn worst_slab(
        &self,
        column: usize,
        kept: &[bool],
        rows: &[u32],
        inside: Trials,
        best: &mut Option<(f64, usize, Vec<usize>)>,
    ) {
        let coded = &self.cells[column];
        let (mut n, mut failures) = (vec![0.0; coded.count], vec![0.0; coded.count]);
        for row in rows {
            let (cell, weight) = (usize::from(coded.code[*row as usize]), self.weight(*row));
            n[cell] += weight;
            failures[cell] += if self.success[*row as usize] { 0.0 } else { weight };
        }
        let (all, all_failures) = (n.iter().sum::<f64>(), failures.iter().sum::<f64>());
        let rate = all_failures / all.max(f64::MIN_POSITIVE);
        // One unit of weight is that many independent rows.
        let worth = inside.n() as f64 / all.max(f64::MIN_POSITIVE);
        let mut offer = |cells: &[usize]| {
            let (slab_n, slab_failures) =
                cells.iter().fold((0.0, 0.0), |(a, b), cell| (a + n[*cell], b + failures[*cell]));
            let left = all - slab_n;
            if left * worth < FEWEST || slab_n <= 0.0 {
                return;
            }
            let spread = (slab_n * rate * (1.0 - rate) * left / all / worth).sqrt();
            let z = (slab_failures - slab_n * rate) / spread.max(1e-9);
            if z > 0.0 && best.as_ref().is_none_or(|(most, ..)| z > *most) {
                *best = Some((z, column, cells.to_vec()));
            }
        };
        let open: Vec<usize> = (0..coded.count).filter(|cell| kept[*cell]).collect();
        if coded.spans.is_none() {
            open.iter().for_each(|level| offer(&[*level]));
            return;
        }
        for width in [1, 2, 4, 8].into_iter().filter(|width| *width < open.len()) {
            offer(&open[..width]);
            offer(&open[open.len() - width..]);
        }
    }

    fn limits(&self, kept: &Kept) -> Limits {
        let limited = |(column, kept): (usize, &Vec<bool>)| {
            let first = kept.iter().position(|k| *k)?;
            let last = kept.iter().rposition(|k| *k)?;
            if kept.iter().all(|k| *k) {
                return None;
            }
            Some((
                column,
                match &self.cells[column].spans {
                    None => Inside::Levels(kept.clone()),
                    // Halfway between the cells, so that no gap belongs to neither side.
                    Some(spans) => Inside::Range {
                        low: (first > 0).then(|| 0.5 * (spans[first - 1][1] + spans[first][0])),
                        high: (last + 1 < spans.len()).then(|| 0.5 * (spans[last][1] + spans[last + 1][0])),
                    },
                },
            ))
        };
        kept.iter().enumerate().filter_map(limited).collect()
    }
}

impl Coded {
    fn of(column: &Column<'_>, rows: &[u32]) -> Self {
        let value = |row: &u32| column.values[*row as usize];
        if let Some(levels) = column.levels {
            // Levels beyond 256 share the last code and cannot be removed one by one.
            let code = rows.iter().map(|row| (value(row) as usize).min(255) as u8).collect();
            return Self { code, count: levels.min(256), spans: None };
        }
        let mut sorted: Vec<f64> = rows.iter().map(value).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut starts: Vec<f64> = Vec::new();
        for i in 0..CELLS {
            let Some(start) = sorted.get(i * sorted.len() / CELLS) else { continue };
            if starts.last().is_none_or(|last| start > last) {
                starts.push(*start);
            }
        }
        let code =
            rows.iter().map(|row| starts.partition_point(|s| *s <= value(row)).saturating_sub(1) as u8).collect();
        let span = |i: usize| {
            let end = starts.get(i + 1).map_or(sorted.len(), |next| sorted.partition_point(|v| v < next));
            [starts[i], sorted[end.max(1) - 1]]
        };
        Self { code, count: starts.len(), spans: Some((0..starts.len()).map(span).collect()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    const TARGET: f64 = 0.9;

    /// Rows of four numeric columns and one with four levels, with this law of success.
    fn rows(seed: u64, n: usize, law: impl Fn(&[f64]) -> f64) -> (Vec<Vec<f64>>, Vec<bool>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut columns = vec![Vec::new(); 5];
        let mut success = Vec::new();
        for _ in 0..n {
            let mut x: Vec<f64> = (0..5).map(|_| uniform(&mut rng)).collect();
            x[4] = (4.0 * x[4]).floor();
            success.push(uniform(&mut rng) < law(&x));
            columns.iter_mut().zip(x).for_each(|(column, x)| column.push(x));
        }
        (columns, success)
    }

    fn searched(columns: &[Vec<f64>], success: &[bool], seed: u64) -> Found {
        let of = |(i, values): (usize, &Vec<f64>)| (values.clone(), (i == 4).then_some(4));
        let owned: Vec<(Vec<f64>, Option<usize>)> = columns.iter().enumerate().map(of).collect();
        let columns: Vec<Column<'_>> =
            owned.iter().map(|(values, levels)| Column { values, levels: *levels }).collect();
        search(&columns, success, None, None, TARGET, Confidence::P95, seed).unwrap()
    }

    /// The true rate inside a box.
    fn truth(limits: &Limits, law: impl Fn(&[f64]) -> f64) -> f64 {
        let (columns, _) = rows(777, 20_000, |_| 1.0);
        let (mut sum, mut n) = (0.0, 0.0);
        for row in 0..20_000 {
            let x: Vec<f64> = columns.iter().map(|c| c[row]).collect();
            if limits.iter().all(|(column, inside)| inside.contains(x[*column])) {
                sum += law(&x);
                n += 1.0;
            }
        }
        sum / n
    }

    #[test]
    fn verified_boxes_reach_the_target() {
        // The rate rises slowly to the target, so that choosing rows always flatter some box.
        let law = |x: &[f64]| 0.6 + 0.35 * x[0].min(1.0 - 0.3 * x[1]);
        let mut wrong = 0;
        for seed in 0..100 {
            let (columns, success) = rows(seed, 1_000, law);
            let found = searched(&columns, &success, seed);
            wrong += u32::from(found.verified && truth(&found.limits, law) < TARGET);
        }
        assert!(wrong <= 6, "{wrong} of 100 boxes are verified and below the target");
    }

    #[test]
    fn planted_box_is_found() {
        let good = |x: &[f64]| x[0] > 0.3 && x[2] < 0.8 && x[4] != 1.0;
        let law = |x: &[f64]| if good(x) { 0.98 } else { 0.4 };
        let (columns, success) = rows(5, 4_000, law);
        let found = searched(&columns, &success, 5);
        assert!(found.verified && found.lower_bound >= TARGET, "{found:?}");
        let share = found.held_out.n() as f64 / found.held_out_rows as f64;
        assert!(share > 0.35, "0.42 at most: {found:?}");
        assert_eq!(found.limits.len(), 3);
        let levels = found.limits.iter().find(|(column, _)| *column == 4).unwrap();
        assert_eq!(levels.1, Inside::Levels(vec![true, false, true, true]));
    }

    #[test]
    fn no_box_is_verified_without_one() {
        for seed in 0..20 {
            let (columns, success) = rows(seed, 1_000, |_| 0.5);
            assert!(!searched(&columns, &success, seed).verified);
        }
        assert!(search(&[], &[true; 200], None, None, TARGET, Confidence::P95, 1).is_none());
    }

    #[test]
    fn needed_rows_grow_near_the_target() {
        let needed = |rate| rows_needed(rate, TARGET, Confidence::P95);
        assert_eq!(needed(0.9), None);
        assert!(needed(0.92).unwrap() > needed(0.97).unwrap());
        assert!(needed(1.0).unwrap() >= 35);
    }
}
