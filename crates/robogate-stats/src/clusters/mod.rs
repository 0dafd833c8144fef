//! Rows that depend on each other: clusters, and what can be said about a rate from them.
//!
//! A cluster is a set of rows that share something which moves their rate: a scenario, a day, an operator, a robot. Rows of
//! different clusters are independent. All inference then counts clusters, not rows.
//!
//! [`RateByCluster`] is the rate over new clusters. Its variance is that of a ratio of cluster totals, G/(G-1) Σ (kᵢ - p nᵢ)²
//! / n². It determines the effective number of rows p (1 - p) / variance, at most n. The interval is that of Clopper and
//! Pearson with the effective number, multiplied by the squared ratio of the normal quantile and that of Student's t
//! with one degree of freedom less than clusters (Korn and Graubard 1998). Clusters of unequal size count as (Σ n)² / Σ n² of
//! equal size. If all outcomes are equal, nothing shows how much clusters differ, and each counts as one row.
//!
//! Several groupings of the same rows can overlap, such as days and scenarios. The variance of the rate is then the sum of
//! those of all groupings less the part that each of them contains twice (Cameron, Gelbach and Miller 2011), and at least the
//! largest of them.
//!
//! Limit: at rates above 0.9 with fewer than 50 clusters the interval covers 90 to 95 % instead of 95 %, because few clusters
//! seldom contain the rare bad one.
//!
//! Sources: Korn and Graubard (1998), Survey Methodology 24; Cameron, Gelbach and Miller (2011), JBES 29.

mod difference;
mod settings;

use std::collections::BTreeMap;

use robogate_maths::beta::{beta_quantile, student_quantile};

use crate::interval::{Confidence, Interval, Trials};

pub use difference::{independent_clusters, paired_clusters};
pub use settings::{Setting, equal_settings};

/// Fewest clusters for any claim.
pub const FEWEST: usize = 8;
/// With fewer clusters, only large effects are found.
pub const LOW_POWER: usize = 15;
/// The name of the division into blocks of neighbouring rows ([`crate::serial::blocks_of_neighbours`]).
pub const NEIGHBOURS: &str = "neighbouring rows";

/// One division of rows into clusters, and what it is by: a column, for example.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grouping {
    /// What rows of a cluster share.
    pub by: String,
    /// The clusters.
    pub clusters: Clusters,
}

/// Leaves out divisions whose clusters lie within those of another one, and puts the coarsest first.
pub fn coarsest_first(mut found: Vec<Grouping>) -> Vec<Grouping> {
    found.sort_by_key(|grouping| grouping.clusters.count());
    let mut kept: Vec<Grouping> = Vec::new();
    for grouping in found {
        if !kept.iter().any(|coarser| grouping.clusters.is_within(&coarser.clusters)) {
            kept.push(grouping);
        }
    }
    kept
}

/// A division of rows into clusters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Clusters {
    of_row: Vec<usize>,
    count: usize,
}

impl Clusters {
    /// Rows with equal labels are one cluster. Clusters are numbered in the order of their first rows.
    pub fn of_labels<T: Ord>(labels: impl IntoIterator<Item = T>) -> Self {
        let mut known: BTreeMap<T, usize> = BTreeMap::new();
        let of_row: Vec<usize> = labels
            .into_iter()
            .map(|label| {
                let next = known.len();
                *known.entry(label).or_insert(next)
            })
            .collect();
        Self { of_row, count: known.len() }
    }

    /// The cluster of each row, from 0.
    pub fn of_row(&self) -> &[usize] {
        &self.of_row
    }

    /// The number of clusters.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether some rows share a cluster, and some do not.
    pub fn divides(&self) -> bool {
        self.count > 1 && self.count < self.of_row.len()
    }

    /// The rows at these positions.
    #[must_use]
    pub fn take(&self, rows: impl IntoIterator<Item = usize>) -> Self {
        Self::of_labels(rows.into_iter().map(|row| self.of_row[row]))
    }

    /// Whether each cluster lies within one cluster of `other`.
    pub fn is_within(&self, other: &Self) -> bool {
        let mut seen = vec![None; self.count];
        self.of_row.iter().zip(&other.of_row).all(|(own, of)| *seen[*own].get_or_insert(*of) == *of)
    }

    /// The outcomes of each cluster, over the rows for which `used` is true.
    pub fn trials(&self, outcomes: &[bool], used: impl Fn(usize) -> bool) -> Vec<Trials> {
        let mut counts = vec![(0, 0); self.count];
        for (row, (cluster, success)) in self.of_row.iter().zip(outcomes).enumerate() {
            if used(row) {
                counts[*cluster].0 += u64::from(*success);
                counts[*cluster].1 += 1;
            }
        }
        counts.into_iter().map(|(k, n)| Trials::new(k, n).unwrap_or(Trials::NONE)).collect()
    }

    /// The share of the variance of a column that lies between clusters, from 0 to 1. For levels, the mean over their
    /// indicators. `None` for a constant column.
    pub fn between_share(&self, values: &[f64], levels: Option<usize>) -> Option<f64> {
        let mut sizes = vec![0.0; self.count];
        self.of_row.iter().for_each(|cluster| sizes[*cluster] += 1.0);
        let share = |value: &dyn Fn(usize) -> f64| {
            let n = self.of_row.len() as f64;
            let mean = (0..self.of_row.len()).map(value).sum::<f64>() / n;
            let mut sums = vec![0.0; self.count];
            let mut total = 0.0;
            for (row, cluster) in self.of_row.iter().enumerate() {
                let apart = value(row) - mean;
                sums[*cluster] += apart;
                total += apart * apart;
            }
            let between: f64 = sums.iter().zip(&sizes).filter(|(_, n)| **n > 0.0).map(|(sum, n)| sum * sum / n).sum();
            (between, total)
        };
        let (between, total) = match levels {
            None => share(&|row| values[row]),
            Some(levels) => (0..levels)
                .map(|level| share(&|row| f64::from(u8::from(values[row] as usize == level))))
                .fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d)),
        };
        (total > 0.0).then(|| between / total)
    }
}

/// A rate over new clusters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateByCluster {
    /// All rows.
    pub trials: Trials,
    /// Clusters with rows: the fewest of all groupings.
    pub clusters: usize,
    /// The number of independent rows with the same variance.
    pub effective: f64,
    /// (Normal quantile / Student quantile)², by which the effective number is multiplied at a level of 95 %.
    degrees: f64,
}

impl RateByCluster {
    /// The rate of the rows for which `used` is true. `groupings` are one or more divisions of the same rows.
    pub fn of(groupings: &[&Clusters], outcomes: &[bool], used: impl Fn(usize) -> bool + Copy) -> Self {
        let rows = (0..outcomes.len()).filter(|row| used(*row));
        let trials = Trials::count(rows.map(|row| outcomes[row]));
        let n = trials.n() as f64;
        let rate = trials.rate().unwrap_or(0.5);
        let of_rows = rate * (1.0 - rate) / n;
        let (mut sum, mut largest) = (0.0, of_rows);
        let (mut clusters, mut degrees) = (usize::MAX, f64::INFINITY);
        for grouping in groupings {
            let cells = grouping.trials(outcomes, used);
            let filled: Vec<(f64, f64)> =
                cells.iter().filter(|t| t.n() > 0).map(|t| (t.successes() as f64, t.n() as f64)).collect();
            let g = filled.len() as f64;
            let squares: f64 = filled.iter().map(|(k, n)| (k - rate * n).powi(2)).sum();
            let variance = if g > 1.0 { g / (g - 1.0) * squares / (n * n) } else { 0.25 };
            sum += variance;
            largest = largest.max(variance);
            clusters = clusters.min(filled.len());
            degrees = degrees.min(n * n / filled.iter().map(|(_, n)| n * n).sum::<f64>() - 1.0);
        }
        let variance = (sum - (groupings.len() as f64 - 1.0) * of_rows).max(largest);
        let clusters = if clusters == usize::MAX { 0 } else { clusters };
        let effective = if trials.successes() == 0 || trials.failures() == 0 {
            clusters as f64
        } else {
            (rate * (1.0 - rate) / variance).min(n)
        };
        Self { trials, clusters, effective, degrees }
    }

    /// The interval of the rate over new clusters. [0, 1] with fewer than two clusters.
    pub fn interval(&self, confidence: Confidence) -> Interval {
        if self.clusters < 2 || self.degrees <= 0.0 {
            return Interval::UNIT;
        }
        let ratio = confidence.z() / student_quantile(self.degrees.max(1.0), confidence.level());
        let all_equal = self.trials.successes() == 0 || self.trials.failures() == 0;
        // Without differences there is no estimated variance whose uncertainty Student's t describes.
        let n = if all_equal { self.effective } else { self.effective * ratio * ratio };
        let k = n * self.trials.rate().unwrap_or(0.5);
        let tail = confidence.tail();
        let end = |k: f64, n: f64| if k <= 0.0 { 0.0 } else { beta_quantile(k, n - k + 1.0, tail) };
        Interval { low: end(k, n), high: 1.0 - end(n - k, n) }
    }

    /// Counts of independent rows with the same rate and variance, rounded towards fewer rows.
    pub fn effective_trials(&self) -> Trials {
        let n = self.effective.floor().max(0.0);
        let k = (n * self.trials.rate().unwrap_or(0.0)).round().clamp(0.0, n);
        Trials::new(k as u64, n as u64).unwrap_or(Trials::NONE)
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    use super::*;
    use crate::resample::uniform;

    /// How often the interval contains the mean rate of clusters whose rates are uniform in a range.
    fn coverage(clusters: usize, rows: usize, [low, high]: [f64; 2]) -> f64 {
        let mut inside = 0;
        for seed in 0..500 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let rates: Vec<f64> = (0..clusters).map(|_| low + (high - low) * uniform(&mut rng)).collect();
            let outcomes: Vec<bool> = (0..clusters * rows).map(|row| uniform(&mut rng) < rates[row / rows]).collect();
            let of = Clusters::of_labels((0..clusters * rows).map(|row| row / rows));
            let interval = RateByCluster::of(&[&of], &outcomes, |_| true).interval(Confidence::P95);
            inside += usize::from(interval.contains(0.5 * (low + high)));
        }
        inside as f64 / 500.0
    }

    #[test]
    fn interval_covers_new_clusters() {
        for (clusters, rows, range) in [(8, 60, [0.3, 1.0]), (15, 60, [0.0, 1.0]), (50, 20, [0.6, 1.0])] {
            let found = coverage(clusters, rows, range);
            assert!((0.925..=0.985).contains(&found), "{clusters} x {rows}: {found}");
        }
    }

    #[test]
    fn equal_outcomes_count_clusters() {
        let of = Clusters::of_labels((0..600).map(|row| row / 60));
        let all = RateByCluster::of(&[&of], &[true; 600], |_| true);
        let low = all.interval(Confidence::P95).low;
        assert!((low - 0.025_f64.powf(0.1)).abs() < 1e-9, "that of 10 of 10: {low}");
    }

    #[test]
    fn crossed_groupings_add_their_variance() {
        // Ten days and ten scenarios, each with its own rate.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let effect: Vec<f64> = (0..20).map(|_| 0.4 * uniform(&mut rng)).collect();
        let rate = |row: usize| 0.1 + effect[row % 10] + effect[10 + row / 10 % 10];
        let outcomes: Vec<bool> = (0..5_000).map(|row| uniform(&mut rng) < rate(row)).collect();
        let (days, scenarios) =
            (Clusters::of_labels((0..5_000).map(|i| i % 10)), Clusters::of_labels((0..5_000).map(|i| i / 10 % 10)));
        let width = |of: &[&Clusters]| RateByCluster::of(of, &outcomes, |_| true).interval(Confidence::P95).width();
        assert!(width(&[&days, &scenarios]) > width(&[&days]).max(width(&[&scenarios])));
        assert!(!days.is_within(&scenarios));
    }

    #[test]
    fn between_share_tells_scenario_columns_from_others() {
        let of = Clusters::of_labels((0..400).map(|row| row / 20));
        let scenario: Vec<f64> = (0..400).map(|row| f64::from(row / 20)).collect();
        let other: Vec<f64> = (0..400).map(|row| f64::from(row * 7 % 20)).collect();
        assert!(of.between_share(&scenario, None).unwrap() > 0.99);
        assert!(of.between_share(&other, None).unwrap() < 0.05);
        assert!(of.between_share(&scenario, Some(20)).unwrap() > 0.99);
        assert_eq!(of.between_share(&[1.0; 400], None), None);
    }
}
