//! ROC analysis: how well a score separates successes from failures.
//!
//! AUC = P(score of a success > score of a failure) + ½ P(equal), from midranks in O(n log n). Its variance is
//! DeLong's: with vᵢ the fraction of failures with a lower score than success i, and uⱼ the fraction of successes with
//! a higher score than failure j, var = S²(v)/m + S²(u)/n, computed from pooled and within-class midranks (Sun and Xu).
//! The interval is Student's with Welch-Satterthwaite's degrees of freedom, (a + b)² / (a²/(m - 1) + b²/(n - 1)) for the
//! two terms a and b, because few rows of a class say little about their own variance.
//!
//! Rows of one cluster, such as repeats of a scenario, may depend on each other. The variance is then Obuchowski's: sums
//! of v - AUC and u - AUC over each cluster take the place of single rows, and the covariance of both sums is added. With
//! one row per cluster it is DeLong's. The degrees of freedom count clusters, and are at most their number minus 1.
//!
//! If that variance is zero (perfect order), the interval instead comes from min(m, n) disjoint pairs, which are
//! independent trials of the event behind the AUC (Clopper-Pearson). No two pairs share a cluster.
//!
//! Limits: at an area of 0.76 the 95 % interval covers 95 % with 100 and 300 rows in the classes, 94 % with 40 and 40,
//! 94 % with 15 and 200, and 89 % with 5 and 100, because the AUC of few rows is skewed. The mean over five folds covers
//! 95 % with 12 and 100. With 60 clusters of five rows an interval covers 95 %, and one that ignores the clusters 88 %
//! (`tests/coverage.rs`). Clusters are of similar size: one that holds most rows of a class makes the interval too narrow. Rows of a
//! cluster have about the same score, so their own pairs draw the AUC of a fold with few clusters towards 1/2 (by 0.003
//! with 60 clusters of five rows). An AUC applies to the population that its rows were sampled from. AUCs of two designs, or in
//! sample against out of sample, are not comparable. [`compare`] is for two scores on the same rows.
//! Sources: DeLong, DeLong and Clarke-Pearson (1988), Biometrics 44; Obuchowski (1997), Biometrics 53, for clusters; Sun
//! and Xu (2014), IEEE Signal Processing Letters 21(11); Satterthwaite (1946), Biometrics Bulletin 2(6); LeDell, Petersen
//! and van der Laan (2015) for the pooled variance over folds.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::interval::{Confidence, Interval, Trials, clopper_pearson};
use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_maths::beta::{ln_student_two_sided, student_quantile};

/// The reason why a score cannot be evaluated.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum RocError {
    /// Scores, outcomes, clusters or folds differ in length.
    #[error("{found} values. Expected {expected}, one for each outcome")]
    Length {
        /// Rows of the outcomes.
        expected: usize,
        /// Values found.
        found: usize,
    },
    /// A score is NaN.
    #[error("score of row {row} is not a number")]
    NotANumber {
        /// Index of the row.
        row: usize,
    },
    /// All outcomes are equal, or there are no rows.
    #[error("there are {successes} successes and {failures} failures. An AUC needs both")]
    OneClass {
        /// Rows that succeeded.
        successes: usize,
        /// Rows that failed.
        failures: usize,
    },
}

/// The method of an AUC interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AucMethod {
    /// DeLong's or Obuchowski's variance with Student's quantile, clamped to [0, 1].
    DeLong,
    /// Disjoint pairs, because the order is perfect and the variance is zero.
    DisjointPairs,
    /// The interval is [0, 1], because a class has only one row or is in only one cluster.
    Unknown,
}

/// Area under the ROC curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Auc {
    /// Estimate.
    pub auc: f64,
    /// DeLong's standard error, or Obuchowski's with clusters. `None` if a class is in fewer than two rows or clusters.
    pub se: Option<f64>,
    /// Degrees of freedom of the standard error. `None` without one, and if it is zero.
    pub df: Option<f64>,
    /// Interval at the requested level.
    pub interval: Interval,
    /// The method of the interval.
    pub method: AucMethod,
    /// Rows that succeeded.
    pub successes: usize,
    /// Rows that failed.
    pub failures: usize,
}

/// For each row, the fraction of the other class that it is ahead of. Stored per class in row order.
struct Placements {
    auc: f64,
    of_successes: Vec<f64>,
    of_failures: Vec<f64>,
}

fn placements(scores: &[f64], outcomes: &[bool]) -> Result<Placements, RocError> {
    if scores.len() != outcomes.len() {
        return Err(RocError::Length { expected: outcomes.len(), found: scores.len() });
    }
    if let Some(row) = scores.iter().position(|s| s.is_nan()) {
        return Err(RocError::NotANumber { row });
    }
    let successes = outcomes.iter().filter(|o| **o).count();
    let failures = outcomes.len() - successes;
    if successes == 0 || failures == 0 {
        return Err(RocError::OneClass { successes, failures });
    }
    let mut order: Vec<u32> = (0..scores.len() as u32).collect();
    order.sort_unstable_by(|&a, &b| scores[a as usize].total_cmp(&scores[b as usize]));
    // One pass over groups of equal scores gives the fraction of the other class below each row.
    let mut below = vec![0.0; scores.len()];
    let (mut lower_successes, mut lower_failures) = (0.0, 0.0);
    let mut at = 0;
    while at < order.len() {
        let score = scores[order[at] as usize];
        let mut end = at;
        let (mut s, mut f) = (0.0, 0.0);
        while end < order.len() && scores[order[end] as usize] <= score {
            if outcomes[order[end] as usize] {
                s += 1.0;
            } else {
                f += 1.0;
            }
            end += 1;
        }
        for &row in &order[at..end] {
            below[row as usize] =
                if outcomes[row as usize] { lower_failures + 0.5 * f } else { lower_successes + 0.5 * s };
        }
        lower_successes += s;
        lower_failures += f;
        at = end;
    }
    let (m, n) = (successes as f64, failures as f64);
    let mut of_successes = Vec::with_capacity(successes);
    let mut of_failures = Vec::with_capacity(failures);
    for (b, success) in below.iter().zip(outcomes) {
        if *success {
            of_successes.push(b / n);
        } else {
            of_failures.push(1.0 - b / m);
        }
    }
    Ok(Placements { auc: of_successes.iter().sum::<f64>() / m, of_successes, of_failures })
}

/// The deviations of placements from the mean of their class, summed by cluster.
struct Deviations {
    /// One sum for each cluster with a success.
    of_successes: Vec<f64>,
    /// One sum for each cluster with a failure.
    of_failures: Vec<f64>,
    /// The products of both sums of a cluster, added up.
    products: f64,
    clusters: usize,
    successes: usize,
    failures: usize,
}

/// A variance with its degrees of freedom.
struct Variance {
    value: f64,
    df: f64,
}

impl Deviations {
    /// `of_successes` and `of_failures` are in row order. Without clusters each row is one.
    fn of(of_successes: &[f64], of_failures: &[f64], outcomes: &[bool], clusters: Option<&[usize]>) -> Self {
        let (successes, failures) = (of_successes.len(), of_failures.len());
        let (of_successes, of_failures) = (centred(of_successes), centred(of_failures));
        let Some(clusters) = clusters else {
            let clusters = successes + failures;
            return Self { of_successes, of_failures, products: 0.0, clusters, successes, failures };
        };
        let (mut next_success, mut next_failure) = (of_successes.into_iter(), of_failures.into_iter());
        let mut sums: BTreeMap<usize, [Option<f64>; 2]> = BTreeMap::new();
        for (success, cluster) in outcomes.iter().zip(clusters) {
            let deviation = if *success { next_success.next() } else { next_failure.next() };
            let sum = &mut sums.entry(*cluster).or_default()[usize::from(*success)];
            *sum = Some(sum.unwrap_or(0.0) + deviation.unwrap_or(0.0));
        }
        let of_class = |class: usize| -> Vec<f64> { sums.values().filter_map(|sum| sum[class]).collect() };
        Self {
            of_successes: of_class(1),
            of_failures: of_class(0),
            products: sums.values().filter_map(|[failures, successes]| Some((*failures)? * (*successes)?)).sum(),
            clusters: sums.len(),
            successes,
            failures,
        }
    }

    /// The variance of the AUC. `None` if a class is in fewer than two clusters.
    fn variance(&self) -> Option<Variance> {
        let a = variance_of_mean(&self.of_successes, self.successes)?;
        let b = variance_of_mean(&self.of_failures, self.failures)?;
        let k = self.clusters as f64;
        let shared = 2.0 * k / (k - 1.0) * self.products / (self.successes as f64 * self.failures as f64);
        let free = |sums: &[f64]| sums.len() as f64 - 1.0;
        let df = (a + b).powi(2) / (a * a / free(&self.of_successes) + b * b / free(&self.of_failures));
        let value = a + b + shared;
        // A negative covariance can leave nothing but rounding errors.
        Some(Variance { value: if value > 1e-12 * (a + b) { value } else { 0.0 }, df: df.min(k - 1.0) })
    }

    /// The number of pairs of a success and a failure of which no two share a cluster.
    fn disjoint_pairs(&self) -> usize {
        self.of_successes.len().min(self.of_failures.len()).min(self.clusters / 2)
    }
}

/// The values minus their mean.
fn centred(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| value - mean).collect()
}

/// The variance of the mean of `n` values from their deviations summed by cluster: S²/n with one value per cluster.
/// `None` below two clusters.
fn variance_of_mean(sums: &[f64], n: usize) -> Option<f64> {
    let (k, n) = (sums.len() as f64, n as f64);
    (sums.len() > 1).then(|| sums.iter().map(|sum| sum * sum).sum::<f64>() / (k - 1.0) / (n * n / k))
}

/// Returns an error unless there is one cluster for each outcome.
fn one_each(clusters: Option<&[usize]>, outcomes: &[bool]) -> Result<(), RocError> {
    match clusters {
        Some(clusters) if clusters.len() != outcomes.len() => {
            Err(RocError::Length { expected: outcomes.len(), found: clusters.len() })
        }
        _ => Ok(()),
    }
}

/// AUC of `scores` (higher means more likely to succeed) with its interval.
///
/// `clusters[i]` is the cluster of row i. Without clusters, rows are independent.
///
/// # Errors
/// Unequal lengths, NaN, or one class only.
pub fn auc(
    scores: &[f64],
    outcomes: &[bool],
    clusters: Option<&[usize]>,
    confidence: Confidence,
) -> Result<Auc, RocError> {
    let p = placements(scores, outcomes)?;
    one_each(clusters, outcomes)?;
    let deviations = Deviations::of(&p.of_successes, &p.of_failures, outcomes, clusters);
    let variance = deviations.variance();
    let (interval, method) = match &variance {
        Some(Variance { value, df }) if *value > 0.0 => {
            let half = student_quantile(*df, confidence.level()) * value.sqrt();
            let interval = Interval { low: (p.auc - half).max(0.0), high: (p.auc + half).min(1.0) };
            (interval, AucMethod::DeLong)
        }
        // Zero variance and a perfect or perfectly reversed order.
        Some(_) if p.auc >= 1.0 || p.auc <= 0.0 => {
            let pairs = deviations.disjoint_pairs() as u64;
            let won = if p.auc >= 1.0 { pairs } else { 0 };
            let interval = Trials::new(won, pairs).map_or(Interval::UNIT, |t| clopper_pearson(t, confidence));
            (interval, AucMethod::DisjointPairs)
        }
        _ => (Interval::UNIT, AucMethod::Unknown),
    };
    Ok(Auc {
        auc: p.auc,
        se: variance.as_ref().map(|v| v.value.sqrt()),
        df: variance.filter(|v| v.value > 0.0).map(|v| v.df),
        interval,
        method,
        successes: p.of_successes.len(),
        failures: p.of_failures.len(),
    })
}

/// A comparison of two scores on the same rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AucComparison {
    /// AUC of the first minus AUC of the second.
    pub difference: f64,
    /// Standard error of the difference.
    pub se: f64,
    /// Student's interval for the difference.
    pub interval: Interval,
    /// ln of the two-sided p-value of Student's test for equal AUCs. `None` if both scores order every pair the same
    /// (se = 0).
    pub ln_p: Option<f64>,
}

/// Compares two scores on the same rows, which are independent. `None` if a class has fewer than two rows.
///
/// # Errors
/// As [`auc`].
pub fn compare(
    first: &[f64],
    second: &[f64],
    outcomes: &[bool],
    confidence: Confidence,
) -> Result<Option<AucComparison>, RocError> {
    let a = placements(first, outcomes)?;
    let b = placements(second, outcomes)?;
    let minus = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
    let of_successes = minus(&a.of_successes, &b.of_successes);
    let of_failures = minus(&a.of_failures, &b.of_failures);
    let Some(Variance { value, df }) = Deviations::of(&of_successes, &of_failures, outcomes, None).variance() else {
        return Ok(None);
    };
    let difference = a.auc - b.auc;
    let se = value.sqrt();
    let half = student_quantile(df, confidence.level()) * se;
    Ok(Some(AucComparison {
        difference,
        se,
        interval: Interval { low: (difference - half).max(-1.0), high: (difference + half).min(1.0) },
        ln_p: (se > 0.0).then(|| ln_student_two_sided(df, difference / se)),
    }))
}

/// One point of a ROC curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RocPoint {
    /// Rows at or above this score are classified as successes. Infinite at the start, without such rows.
    pub threshold: f64,
    /// Fraction of failures classified as successes.
    pub false_positive_rate: f64,
    /// Fraction of successes classified as successes.
    pub true_positive_rate: f64,
}

/// The curve from (0, 0) to (1, 1), with one point per distinct score.
///
/// # Errors
/// As [`auc`].
pub fn curve(scores: &[f64], outcomes: &[bool]) -> Result<Vec<RocPoint>, RocError> {
    let p = placements(scores, outcomes)?;
    let (m, n) = (p.of_successes.len() as f64, p.of_failures.len() as f64);
    let mut order: Vec<u32> = (0..scores.len() as u32).collect();
    order.sort_unstable_by(|&a, &b| scores[b as usize].total_cmp(&scores[a as usize]));
    let mut points = vec![RocPoint { threshold: f64::INFINITY, false_positive_rate: 0.0, true_positive_rate: 0.0 }];
    let (mut s, mut f) = (0.0, 0.0);
    for (i, &row) in order.iter().enumerate() {
        let row = row as usize;
        if outcomes[row] {
            s += 1.0;
        } else {
            f += 1.0;
        }
        let last_of_its_score = order.get(i + 1).is_none_or(|&next| scores[next as usize] < scores[row]);
        if last_of_its_score {
            points.push(RocPoint { threshold: scores[row], false_positive_rate: f / n, true_positive_rate: s / m });
        }
    }
    Ok(points)
}

/// Assigns each row to one of `k` folds with both classes spread evenly. The result depends only on the inputs and the
/// seed.
///
/// `clusters[i]` is the cluster of row i, and all rows of a cluster are in the same fold. Clusters of several rows are
/// assigned first, those with the largest share of a class before the others, then single rows. Each goes to the fold where
/// it keeps both classes most even. A row without a cluster is single. `k` below 2 counts as 2.
pub fn stratified_folds(outcomes: &[bool], clusters: Option<&[usize]>, k: usize, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let cluster = |row: usize| clusters.and_then(|clusters| clusters.get(row));
    let mut order: Vec<usize> = (0..outcomes.len()).collect();
    order.sort_unstable_by_key(|&row| (cluster(row), row));
    let counted = |rows: &[usize]| -> [u128; 2] {
        let successes = rows.iter().filter(|&&row| outcomes[row]).count();
        [successes as u128, (rows.len() - successes) as u128]
    };
    let all = counted(&order);
    // Clusters of several rows, single successes, single failures.
    let mut strata: [Vec<&[usize]>; 3] = Default::default();
    for rows in order.chunk_by(|&a, &b| cluster(a).is_some() && cluster(a) == cluster(b)) {
        let stratum = match rows {
            [row] if outcomes[*row] => 1,
            [_] => 2,
            _ => 0,
        };
        strata[stratum].push(rows);
    }
    for stratum in &mut strata {
        // By first row, so that the numbers of the clusters do not matter.
        stratum.sort_unstable();
        for i in (1..stratum.len()).rev() {
            let other = below(&mut rng, i as u64 + 1) as usize;
            stratum.swap(i, other);
        }
    }
    strata[0].sort_by_key(|&rows| {
        let [successes, failures] = counted(rows);
        Reverse((successes * all[1]).max(failures * all[0]))
    });
    // More folds than rows would stay empty.
    let mut held = vec![[0_u128; 2]; k.clamp(2, outcomes.len().max(2))];
    let mut folds = vec![0; outcomes.len()];
    for &rows in strata.iter().flatten() {
        let [successes, failures] = counted(rows);
        // The increase of the sum of the squared shares that folds have of both classes, up to a constant and a factor.
        let imbalance = |fold: usize| {
            let [s, f] = held[fold];
            (s * successes * all[1] * all[1] + f * failures * all[0] * all[0], s + f)
        };
        let fold = (0..held.len()).min_by_key(|&fold| imbalance(fold)).unwrap_or(0);
        held[fold][0] += successes;
        held[fold][1] += failures;
        for &row in rows {
            folds[row] = fold;
        }
    }
    folds
}

/// Uniform integer in 0..bound by rejection (Lemire 2019).
fn below(rng: &mut ChaCha8Rng, bound: u64) -> u64 {
    loop {
        let wide = u128::from(rng.next_u64()) * u128::from(bound);
        if wide as u64 >= bound.wrapping_neg() % bound {
            return (wide >> 64) as u64;
        }
    }
}

/// AUC of out-of-fold scores.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossValidated {
    /// Mean of the folds' AUCs.
    pub auc: f64,
    /// Standard error over folds, from the variance of the AUC in each. `None` if a fold has none.
    pub se: Option<f64>,
    /// Student's interval with Satterthwaite's degrees of freedom over folds, clamped to [0, 1]. [0, 1] without a standard
    /// error.
    pub interval: Interval,
    /// AUC of each fold. `None` if its test rows have only one class.
    pub folds: Vec<Option<f64>>,
    /// Out-of-fold score of each row.
    pub scores: Vec<f64>,
}

/// Cross-validates a score: for each fold, `score` gets the training rows and the test rows and returns one score per
/// test row.
///
/// `clusters[i]` is the cluster of row i, as in [`auc`], and `folds[i]` its fold. A cluster must be in one fold, as in
/// [`stratified_folds`]. The mean excludes folds with only one class.
///
/// # Errors
/// An error of `score`, or a [`RocError`] converted to its type.
pub fn cross_validate<E: From<RocError>>(
    outcomes: &[bool],
    clusters: Option<&[usize]>,
    folds: &[usize],
    confidence: Confidence,
    mut score: impl FnMut(&[usize], &[usize]) -> Result<Vec<f64>, E>,
) -> Result<CrossValidated, E> {
    if folds.len() != outcomes.len() {
        return Err(RocError::Length { expected: outcomes.len(), found: folds.len() }.into());
    }
    one_each(clusters, outcomes)?;
    let mut names: Vec<usize> = folds.to_vec();
    names.sort_unstable();
    names.dedup();
    let mut scores = vec![0.0; outcomes.len()];
    let mut per_fold = Vec::with_capacity(names.len());
    let mut judged = Vec::new();
    for fold in names {
        let (test, train): (Vec<usize>, Vec<usize>) = (0..outcomes.len()).partition(|&i| folds[i] == fold);
        let found = score(&train, &test)?;
        if found.len() != test.len() {
            return Err(RocError::Length { expected: test.len(), found: found.len() }.into());
        }
        for (row, value) in test.iter().zip(&found) {
            scores[*row] = *value;
        }
        let truth: Vec<bool> = test.iter().map(|&i| outcomes[i]).collect();
        let of_test = clusters.map(|clusters| test.iter().map(|&i| clusters[i]).collect::<Vec<usize>>());
        match auc(&found, &truth, of_test.as_deref(), confidence) {
            Ok(one) => {
                per_fold.push(Some(one.auc));
                judged.push(one);
            }
            Err(RocError::OneClass { .. }) => per_fold.push(None),
            Err(other) => return Err(other.into()),
        }
    }
    if judged.is_empty() {
        let successes = outcomes.iter().filter(|o| **o).count();
        return Err(RocError::OneClass { successes, failures: outcomes.len() - successes }.into());
    }
    let count = judged.len() as f64;
    let mean = judged.iter().map(|a| a.auc).sum::<f64>() / count;
    let variance: Option<f64> = judged.iter().map(|a| a.se.map(|s| s * s)).sum();
    let se = variance.map(|v| v.sqrt() / count).filter(|s| *s > 0.0);
    let spread: f64 = judged.iter().filter_map(|a| Some(a.se?.powi(4) / a.df?)).sum();
    let interval = se.zip(variance).map_or(Interval::UNIT, |(se, variance)| {
        let half = student_quantile(variance * variance / spread, confidence.level()) * se;
        // If nothing has an effect, the folds share the chance direction of their fits, and the mean varies more: by the factor of
        // Nadeau and Bengio. An AUC of 0.5 is rejected only beyond that.
        let chance = mean - 0.5;
        let wide = half * (1.0 + count / (count - 1.0).max(1.0)).sqrt();
        let (below, above) = if chance.abs() <= wide { ((-chance).min(0.0), (-chance).max(0.0)) } else { (0.0, 0.0) };
        Interval { low: (mean + below.min(-half)).max(0.0), high: (mean + above.max(half)).min(1.0) }
    });
    Ok(CrossValidated { auc: mean, se, interval, folds: per_fold, scores })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perfect_order_has_an_interval() {
        let a = auc(&[0.1, 0.2, 0.8, 0.9], &[false, false, true, true], None, Confidence::P95).unwrap();
        assert_eq!((a.auc, a.method), (1.0, AucMethod::DisjointPairs));
        assert!(a.interval.low < 0.2 && a.interval.high >= 1.0);
    }

    #[test]
    fn single_success_has_no_standard_error() {
        let a = auc(&[0.1, 0.5, 0.3], &[false, true, false], None, Confidence::P95).unwrap();
        assert_eq!((a.se, a.df, a.interval, a.method), (None, None, Interval::UNIT, AucMethod::Unknown));
    }

    #[test]
    fn equal_scores_give_one_half() {
        let a = auc(&[0.3; 6], &[true, false, true, false, true, false], None, Confidence::P95).unwrap();
        assert_eq!(a.auc, 0.5);
        assert_eq!(a.method, AucMethod::Unknown);
    }

    /// Scores of successes and failures that overlap.
    fn overlapping(rows: u32) -> (Vec<f64>, Vec<bool>) {
        let success = |i: u32| i * 7 % 10 < 4;
        (0..rows).map(|i| (f64::from(i * 37 % 101) + if success(i) { 30.0 } else { 0.0 }, success(i))).unzip()
    }

    /// Each value `times` times in a row.
    fn repeated<T: Copy>(values: &[T], times: usize) -> Vec<T> {
        values.iter().flat_map(|value| vec![*value; times]).collect()
    }

    #[test]
    fn interval_is_of_student() {
        // Two successes ahead of 3 and 1 of four failures, which are behind 2, 1, 1 and 0 successes: a = 1/16, b = 1/24.
        let scores = [0.7, 0.2, 0.1, 0.5, 0.6, 0.9];
        let outcomes = [true, true, false, false, false, false];
        let found = auc(&scores, &outcomes, None, Confidence::P95).unwrap();
        let (a, b): (f64, f64) = (0.0625, 1.0 / 24.0);
        let df = (a + b).powi(2) / (a * a + b * b / 3.0);
        assert!((found.auc - 0.5).abs() < 1e-15 && (found.se.unwrap() - (a + b).sqrt()).abs() < 1e-15, "{found:?}");
        assert!((found.df.unwrap() - df).abs() < 1e-12, "{found:?}");
        let narrow = auc(&scores, &outcomes, None, Confidence::new(0.5).unwrap()).unwrap();
        let half = student_quantile(df, 0.5) * (a + b).sqrt();
        assert!((narrow.interval.high - 0.5 - half).abs() < 1e-12, "{narrow:?}");
    }

    #[test]
    fn single_row_clusters_change_nothing() {
        let (scores, outcomes) = overlapping(60);
        let plain = auc(&scores, &outcomes, None, Confidence::P95).unwrap();
        let clusters: Vec<usize> = (0..60).map(|i| i * 17 % 60).collect();
        let found = auc(&scores, &outcomes, Some(&clusters), Confidence::P95).unwrap();
        assert!((found.se.unwrap() / plain.se.unwrap() - 1.0).abs() < 1e-12);
        assert!((found.df.unwrap() / plain.df.unwrap() - 1.0).abs() < 1e-12);
        assert!((found.interval.low - plain.interval.low).abs() < 1e-12);
        let short = auc(&scores, &outcomes, Some(&clusters[1..]), Confidence::P95);
        assert_eq!(short, Err(RocError::Length { expected: 60, found: 59 }));
    }

    #[test]
    fn copies_in_clusters_add_nothing() {
        let (scores, outcomes) = overlapping(60);
        let plain = auc(&scores, &outcomes, None, Confidence::P95).unwrap();
        let clusters: Vec<usize> = (0..60).collect();
        let (scores, outcomes, clusters) = (repeated(&scores, 2), repeated(&outcomes, 2), repeated(&clusters, 2));
        let found = auc(&scores, &outcomes, Some(&clusters), Confidence::P95).unwrap();
        assert!((found.auc - plain.auc).abs() < 1e-12);
        assert!((found.se.unwrap() / plain.se.unwrap() - 1.0).abs() < 1e-12, "{found:?} {plain:?}");
        assert!((found.df.unwrap() / plain.df.unwrap() - 1.0).abs() < 1e-12, "{found:?} {plain:?}");
        let rows = auc(&scores, &outcomes, None, Confidence::P95).unwrap();
        assert!(rows.se.unwrap() < 0.75 * found.se.unwrap());
    }

    #[test]
    fn clusters_with_both_classes_count_once() {
        // One success and one failure per cluster. Where clusters differ in level, their successes and failures rise and fall
        // together, and the AUC varies less than independent rows would suggest.
        let level = |i: usize| (i * 7 % 20) as f64;
        let outcomes: Vec<bool> = (0..40).map(|i| i % 2 == 0).collect();
        let ahead =
            |by: f64| -> Vec<f64> { (0..40).map(|i| level(i / 2) + if i % 2 == 0 { by } else { 0.0 }).collect() };
        let clusters: Vec<usize> = (0..40).map(|i| i / 2).collect();
        let found = auc(&ahead(2.5), &outcomes, Some(&clusters), Confidence::P95).unwrap();
        let rows = auc(&ahead(2.5), &outcomes, None, Confidence::P95).unwrap();
        assert!(found.se.unwrap() < 0.5 * rows.se.unwrap(), "{found:?} {rows:?}");
        assert!((found.df.unwrap() - 19.0).abs() < 1e-12, "{found:?}");
        // v + u is the same for all clusters: the order of the clusters cannot change this AUC.
        let constant = auc(&ahead(0.5), &outcomes, Some(&clusters), Confidence::P95).unwrap();
        assert_eq!((constant.se, constant.interval), (Some(0.0), Interval::UNIT));
    }

    #[test]
    fn perfect_order_counts_clusters() {
        let scores = [0.1, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9];
        let outcomes = [false, false, false, false, true, true, true, true];
        let rows = auc(&scores, &outcomes, None, Confidence::P95).unwrap();
        // Two clusters of failures and two of successes: two disjoint pairs instead of four.
        let found = auc(&scores, &outcomes, Some(&[0, 0, 1, 1, 2, 2, 3, 3]), Confidence::P95).unwrap();
        assert_eq!((rows.method, found.method), (AucMethod::DisjointPairs, AucMethod::DisjointPairs));
        assert!(found.interval.low < rows.interval.low, "{found:?} {rows:?}");
        // All successes in one cluster.
        let one = auc(&scores, &outcomes, Some(&[0, 1, 2, 3, 4, 4, 4, 4]), Confidence::P95).unwrap();
        assert_eq!((one.se, one.interval, one.method), (None, Interval::UNIT, AucMethod::Unknown));
    }

    #[test]
    fn one_class_and_nan_are_rejected() {
        assert!(matches!(auc(&[0.1], &[true], None, Confidence::P95), Err(RocError::OneClass { .. })));
        let found = auc(&[0.1, f64::NAN], &[true, false], None, Confidence::P95);
        assert!(matches!(found, Err(RocError::NotANumber { row: 1 })));
    }

    #[test]
    fn folds_are_stratified_and_seeded() {
        let outcomes: Vec<bool> = (0..103).map(|i| i % 4 == 0).collect();
        let folds = stratified_folds(&outcomes, None, 5, 7);
        for f in 0..5 {
            let rows: Vec<usize> = (0..103).filter(|&i| folds[i] == f).collect();
            let successes = rows.iter().filter(|&&i| outcomes[i]).count();
            assert!((20..=21).contains(&rows.len()) && (5..=6).contains(&successes));
        }
        assert_eq!(folds, stratified_folds(&outcomes, None, 5, 7));
        assert_ne!(folds, stratified_folds(&outcomes, None, 5, 8));
    }

    #[test]
    fn folds_keep_clusters_together() {
        // 60 clusters of one to five rows, of which few have failures.
        let clusters: Vec<usize> = (0..60).flat_map(|c| vec![c * 7 % 60; 1 + c % 5]).collect();
        let outcomes: Vec<bool> = clusters.iter().enumerate().map(|(i, c)| c % 6 > 0 || i % 3 == 0).collect();
        let folds = stratified_folds(&outcomes, Some(&clusters), 5, 3);
        for (i, a) in clusters.iter().enumerate() {
            assert!((0..i).all(|j| clusters[j] != *a || folds[j] == folds[i]));
        }
        let failures = outcomes.iter().filter(|o| !**o).count();
        for f in 0..5 {
            let rows: Vec<usize> = (0..folds.len()).filter(|&i| folds[i] == f).collect();
            let failed = rows.iter().filter(|&&i| !outcomes[i]).count();
            assert!(rows.len().abs_diff(folds.len() / 5) <= 2, "{} rows", rows.len());
            assert!(failed.abs_diff(failures / 5) <= 1, "{failed} of {failures} failures");
        }
        assert_eq!(folds, stratified_folds(&outcomes, Some(&clusters), 5, 3));
        assert_ne!(folds, stratified_folds(&outcomes, Some(&clusters), 5, 4));
    }

    #[test]
    fn single_rows_are_dealt_in_turn() {
        // Rows of each class in random order, one after the other to the next fold.
        let outcomes: Vec<bool> = (0..103).map(|i| i % 4 == 0).collect();
        let names: Vec<usize> = (0..103).map(|i| i * 5 % 103).collect();
        for k in [2, 5, 7, 200] {
            let mut rng = ChaCha8Rng::seed_from_u64(11);
            let mut expected = vec![0; 103];
            let mut next = 0;
            for class in [true, false] {
                let mut rows: Vec<usize> = (0..103).filter(|&i| outcomes[i] == class).collect();
                for i in (1..rows.len()).rev() {
                    rows.swap(i, below(&mut rng, i as u64 + 1) as usize);
                }
                for row in rows {
                    expected[row] = next % k;
                    next += 1;
                }
            }
            assert_eq!(stratified_folds(&outcomes, None, k, 11), expected, "{k} folds");
            assert_eq!(stratified_folds(&outcomes, Some(&names), k, 11), expected, "{k} folds, single clusters");
        }
    }

    #[test]
    fn cross_validation_is_out_of_fold() {
        let outcomes: Vec<bool> = (0..40).map(|i| i % 2 == 0).collect();
        let folds = stratified_folds(&outcomes, None, 4, 1);
        let mut seen = [0; 40];
        let result = cross_validate::<RocError>(&outcomes, None, &folds, Confidence::P95, |train, test| {
            assert!(test.iter().all(|t| !train.contains(t)) && train.len() + test.len() == 40);
            for &t in test {
                seen[t] += 1;
            }
            Ok(test.iter().map(|&t| (t % 7) as f64).collect())
        })
        .unwrap();
        assert!(seen.iter().all(|&s| s == 1));
        assert_eq!(result.folds.len(), 4);
        assert!(result.interval.contains(result.auc));
    }
}
