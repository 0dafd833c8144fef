//! Prediction-powered inference of a success rate from few trials and the predictions of a model.
//!
//! A model that never saw the trials predicts P(success) for each trial and for the whole population. With the
//! prediction f and its population mean m, the mean of z = y - λ (f - m) is the success rate for every λ. The better the
//! model, the less z varies. λ = 1 is prediction-powered inference, λ = cov(y, f) / var(f) its power-tuned form, and
//! λ = 0 uses the trials alone.
//!
//! [`rate`] differs from both papers in three ways, because their normal intervals cover 70 to 90 % at 20 to 50 trials
//! and rates near 1:
//! - λ of a trial comes from the other trials (cross-fitting), and is between 0 and [`LARGEST_TUNING`].
//! - The interval is Wilson's at the number of trials alone that would have the same variance, n / r, with
//!   r = var(z) / var(y). It has Wilson's coverage where predictions do not help.
//! - r has a margin for its own uncertainty, `MARGIN` (1 - r) / n, and `PSEUDO` trials are added that predictions do not
//!   explain: among few trials, predictions may happen to explain all. If r is more than 10 % above that of the trials alone,
//!   these give the answer, so an unsuitable model makes the interval at most 5 % wider.
//!
//! Groups of trials (operator, day, repeated setting) share effects. Their variance is that of the sums by group, with
//! Student's quantile; of several groupings the one with the largest variance counts. Equal outcomes of all trials do not
//! show how much a group shares: each group then counts as one trial.
//!
//! Limits: trials are a random sample of the population, or groups are. The model must not depend on the trials. The
//! coverage is approximate; [`crate::exact_strata`] is exact. Sources: Angelopoulos, Bates, Fannjiang, Jordan and Zrnic
//! (2023), Science 382; Angelopoulos, Duchi and Zrnic (2023), PPI++, arXiv 2311.01453; Badithela et al. (2025),
//! arXiv 2510.04354, for robots.

use std::collections::BTreeMap;

use robogate_maths::beta::student_quantile;

use crate::interval::{Confidence, Interval, Trials, wilson, wilson_real};

/// Largest λ. Predictions that are too close to each other need more than 1.
pub const LARGEST_TUNING: f64 = 2.0;
/// The relative margin of the variance ratio, times the number of trials.
const MARGIN: f64 = 8.0;
/// Trials that predictions do not explain, in addition to those that were made.
const PSEUDO: f64 = 3.0;
/// Largest variance ratio of an answer with predictions, relative to the trials alone.
const WIDEST: f64 = 1.1;
/// Fewest trials. Below, the interval covers too rarely if the predictions are good: 88 % at ten trials.
pub const FEWEST: usize = 20;

/// A model's predictions over the population.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// Their mean.
    pub mean: f64,
    /// Their variance.
    pub variance: f64,
    /// Number of population points. Infinite if the mean is known exactly.
    pub points: f64,
}

impl Predicted {
    /// Mean and variance of predictions at points of the population.
    pub fn of(predictions: &[f64]) -> Self {
        let n = predictions.len().max(1) as f64;
        let mean = predictions.iter().sum::<f64>() / n;
        let variance = predictions.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / n;
        Self { mean, variance, points: n }
    }
}

/// A success rate from trials and predictions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoweredRate {
    /// The estimate.
    pub rate: f64,
    /// Its interval.
    pub interval: Interval,
    /// The mean λ.
    pub tuning: f64,
    /// Correlation of outcomes and predictions. `None` if either does not vary.
    pub correlation: Option<f64>,
    /// The number of independent trials without predictions that would give an interval of the same width.
    pub worth: f64,
    /// The interval of the trials without predictions, for the same groups.
    pub alone: Interval,
}

/// The reason why there is no estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PoweredError {
    /// Too few trials.
    #[error("{0} {noun} too few. Expected at least {FEWEST}", noun = if *.0 == 1 { "trial is" } else { "trials are" })]
    Few(usize),
    /// Columns of different lengths, or a prediction that is not a probability.
    #[error("the predictions or groups do not match the trials")]
    Mismatch,
    /// All trials are in one group.
    #[error("all trials belong to one group, so the variation between groups is unknown")]
    OneGroup,
}

/// The success rate of the population from trials, the model's predictions for them, and groupings of the trials. Each
/// grouping has a group number for each trial.
///
/// # Errors
/// Too few trials or groups, or columns that do not match.
pub fn rate(
    outcomes: &[bool],
    predictions: &[f64],
    population: Predicted,
    groupings: &[Vec<usize>],
    confidence: Confidence,
) -> Result<PoweredRate, PoweredError> {
    let n = outcomes.len();
    let probability = |f: &f64| (0.0..=1.0).contains(f);
    if predictions.len() != n || !predictions.iter().all(probability) || groupings.iter().any(|g| g.len() != n) {
        return Err(PoweredError::Mismatch);
    }
    if n < FEWEST {
        return Err(PoweredError::Few(n));
    }
    if groupings.iter().any(|groups| groups.iter().all(|group| Some(group) == groups.first())) {
        return Err(PoweredError::OneGroup);
    }
    let y: Vec<f64> = outcomes.iter().map(|y| f64::from(u8::from(*y))).collect();
    let tuning = cross_fitted(&y, predictions, groupings);
    let z: Vec<f64> = y.iter().zip(predictions).zip(&tuning).map(|((y, f), l)| y - l * (f - population.mean)).collect();
    let mean_tuning = tuning.iter().sum::<f64>() / n as f64;
    let of_population = mean_tuning * mean_tuning * population.variance / population.points;
    let trials = Trials::count(outcomes.iter().copied());
    let p = trials.rate().unwrap_or(0.5);
    let binomial = binomial(p, n);
    let alone_ratio = design_effect(outcomes, groupings, confidence);
    let alone =
        if groupings.is_empty() { wilson(trials, confidence) } else { at(p, n as f64 / alone_ratio, confidence) };
    let correlation = correlation(&y, predictions);
    let of_trials =
        PoweredRate { rate: p, interval: alone, tuning: 0.0, correlation, worth: n as f64 / alone_ratio, alone };
    if binomial <= 0.0 {
        // Without both outcomes the data cannot show that predictions help.
        return Ok(of_trials);
    }
    let found = variance(&z, groupings, confidence) + of_population;
    let ratio = cautious(found / binomial / alone_ratio, n as f64);
    if ratio > WIDEST {
        return Ok(of_trials);
    }
    let half = 0.5 / n as f64;
    let estimate = (z.iter().sum::<f64>() / n as f64).clamp(half, 1.0 - half);
    let worth = n as f64 / (ratio * alone_ratio);
    Ok(PoweredRate {
        rate: estimate,
        interval: at(estimate, worth, confidence),
        tuning: mean_tuning,
        correlation,
        worth,
        alone,
    })
}

/// The variance ratio of `n` trials with the margin for its own uncertainty.
fn cautious(ratio: f64, n: f64) -> f64 {
    let ratio = ratio * (1.0 + MARGIN / n * (1.0 - ratio).max(0.0));
    if ratio < 1.0 { (n * ratio + PSEUDO) / (n + PSEUDO) } else { ratio }
}

/// How many times the variance of the success rate of these trials exceeds that of independent ones, including Student's
/// quantile for the number of groups. At least 1.
pub fn design_effect(outcomes: &[bool], groupings: &[Vec<usize>], confidence: Confidence) -> f64 {
    let n = outcomes.len();
    let trials = Trials::count(outcomes.iter().copied());
    let binomial = binomial(trials.rate().unwrap_or(0.5), n);
    if binomial > 0.0 {
        let y: Vec<f64> = outcomes.iter().map(|y| f64::from(u8::from(*y))).collect();
        return (variance(&y, groupings, confidence) / binomial).max(1.0);
    }
    groupings.iter().map(|groups| n as f64 / sums(&vec![0.0; n], groups).len().max(1) as f64).fold(1.0, f64::max)
}

/// The variance of the success rate of `n` independent trials.
fn binomial(rate: f64, n: usize) -> f64 {
    rate * (1.0 - rate) / (n as f64 - 1.0)
}

/// Wilson's interval at a rate and a number of trials that need not be an integer.
fn at(rate: f64, n: f64, confidence: Confidence) -> Interval {
    wilson_real(rate * n, n, confidence.z())
}

/// λ of each trial from the trials that share no group with it.
fn cross_fitted(y: &[f64], f: &[f64], groupings: &[Vec<usize>]) -> Vec<f64> {
    (0..y.len())
        .map(|i| {
            let apart = |j: usize| i != j && groupings.iter().all(|groups| groups[i] != groups[j]);
            let (mut n, mut sy, mut sf, mut syf, mut sff) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for j in (0..y.len()).filter(|j| apart(*j)) {
                n += 1.0;
                sy += y[j];
                sf += f[j];
                syf += y[j] * f[j];
                sff += f[j] * f[j];
            }
            if n < 3.0 {
                return 0.0;
            }
            let (spread, shared) = (sff - sf * sf / n, syf - sf * sy / n);
            if spread <= 1e-9 * n { 0.0 } else { (shared / spread).clamp(0.0, LARGEST_TUNING) }
        })
        .collect()
}

/// The variance of the mean of `z`: the largest over independent trials and all groupings.
fn variance(z: &[f64], groupings: &[Vec<usize>], confidence: Confidence) -> f64 {
    let n = z.len() as f64;
    let mean = z.iter().sum::<f64>() / n;
    let apart: Vec<f64> = z.iter().map(|z| z - mean).collect();
    let independent = apart.iter().map(|z| z * z).sum::<f64>() / (n * (n - 1.0));
    let grouped = groupings.iter().map(|groups| {
        let sums = sums(&apart, groups);
        let count = sums.len() as f64;
        let variance = sums.iter().map(|sum| sum * sum).sum::<f64>() / (n * n) * count / (count - 1.0);
        let student = student_quantile(count - 1.0, confidence.level()) / confidence.z();
        variance * student * student
    });
    grouped.fold(independent, f64::max)
}

/// The sum of each group that occurs.
fn sums(values: &[f64], groups: &[usize]) -> Vec<f64> {
    let mut sums = BTreeMap::new();
    for (value, group) in values.iter().zip(groups) {
        *sums.entry(*group).or_insert(0.0) += value;
    }
    sums.into_values().collect()
}

/// Pearson's correlation. `None` if a column is constant.
fn correlation(y: &[f64], f: &[f64]) -> Option<f64> {
    let n = y.len() as f64;
    let (my, mf) = (y.iter().sum::<f64>() / n, f.iter().sum::<f64>() / n);
    let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
    for (y, f) in y.iter().zip(f) {
        a += (y - my) * (f - mf);
        b += (y - my).powi(2);
        c += (f - mf).powi(2);
    }
    (b > 1e-12 && c > 1e-12).then(|| a / (b * c).sqrt())
}

/// The normal interval of the papers: the estimate and its interval for a given λ, or for the power-tuned λ.
///
/// It is for comparison with other implementations. At fewer than about 100 trials it covers too rarely.
pub fn normal(
    outcomes: &[f64],
    predictions: &[f64],
    population: &[f64],
    tuning: Option<f64>,
    confidence: Confidence,
) -> (f64, Interval) {
    let (n, big) = (outcomes.len() as f64, population.len() as f64);
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
    let variance = |x: &[f64], mean: f64| x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len().max(1) as f64;
    let all: Vec<f64> = predictions.iter().chain(population).copied().collect();
    let lambda = tuning.unwrap_or_else(|| {
        let (my, mf) = (mean(outcomes), mean(predictions));
        let shared = outcomes.iter().zip(predictions).map(|(y, f)| (y - my) * (f - mf)).sum::<f64>() / n;
        let spread = variance(&all, mean(&all)) * all.len() as f64 / (all.len() as f64 - 1.0).max(1.0);
        (shared / ((1.0 + n / big) * spread)).clamp(0.0, 1.0)
    });
    let rectified: Vec<f64> = outcomes.iter().zip(predictions).map(|(y, f)| y - lambda * f).collect();
    let (a, b) = (mean(&rectified), mean(population));
    let se = (variance(&rectified, a) / n + lambda * lambda * variance(population, b) / big).sqrt();
    let (rate, half) = (a + lambda * b, confidence.z() * se);
    (rate, Interval { low: rate - half, high: rate + half })
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::{Rng, SeedableRng};

    use super::*;

    fn unit(random: &mut ChaCha8Rng) -> f64 {
        ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Coverage and mean width relative to the trials alone. The prediction is `good` or `bad` for the success rates
    /// `p + a` and `p - a`, each for half of the population.
    fn simulated(n: usize, p: f64, a: f64, sets: u64) -> (f64, f64) {
        let population = Predicted { mean: 0.6, variance: 0.09, points: f64::INFINITY };
        let (mut covered, mut width, mut alone) = (0_u64, 0.0, 0.0);
        for set in 0..sets {
            let random = &mut ChaCha8Rng::seed_from_u64(set);
            let easy: Vec<bool> = (0..n).map(|_| unit(random) < 0.5).collect();
            let y: Vec<bool> = easy.iter().map(|easy| unit(random) < if *easy { p + a } else { p - a }).collect();
            let f: Vec<f64> = easy.iter().map(|easy| if *easy { 0.9 } else { 0.3 }).collect();
            let found = rate(&y, &f, population, &[], Confidence::P95).unwrap();
            covered += u64::from(found.interval.contains(p));
            width += found.interval.width();
            alone += found.alone.width();
        }
        (covered as f64 / sets as f64, width / alone)
    }

    #[test]
    fn coverage_holds_for_few_trials() {
        // With 0.55 and 0.4 or 0.44, a few trials may all end as predicted. The lowest coverage is 92 %, at 20 trials.
        for (n, least) in [(20, 0.915), (30, 0.93), (50, 0.93), (100, 0.93)] {
            for (p, a) in [(0.5, 0.0), (0.7, 0.0), (0.7, 0.25), (0.5, 0.45), (0.6, 0.35), (0.55, 0.4), (0.55, 0.44)] {
                let (covered, ratio) = simulated(n, p, a, 2_000);
                assert!(covered >= least, "{n} {p} {a}: {covered}");
                assert!(ratio <= 1.03, "{n} {p} {a}: {ratio}");
            }
        }
        assert!(simulated(50, 0.5, 0.45, 200).1 < 0.6);
    }

    #[test]
    fn groups_widen_the_interval() {
        let y: Vec<bool> = (0..40).map(|i| i / 10 % 2 == 0).collect();
        let f = vec![0.5; 40];
        let population = Predicted { mean: 0.5, variance: 0.0, points: f64::INFINITY };
        let of = |groups: &[Vec<usize>]| rate(&y, &f, population, groups, Confidence::P95).unwrap();
        let grouped = of(&[(0..40).map(|i| i / 10).collect()]);
        assert!(grouped.interval.width() > 2.0 * of(&[]).interval.width());
        assert!((grouped.interval.width() / grouped.alone.width() - 1.0).abs() < 0.02);
    }

    #[test]
    fn equal_outcomes_give_the_plain_interval() {
        let population = Predicted { mean: 0.8, variance: 0.1, points: 1000.0 };
        let f: Vec<f64> = (0..20).map(|i| f64::from(i) / 20.0).collect();
        let found = rate(&[true; 20], &f, population, &[], Confidence::P95).unwrap();
        assert_eq!(found.interval, wilson(Trials::new(20, 20).unwrap(), Confidence::P95));
    }

    #[test]
    fn equal_outcomes_of_groups_count_each_group_once() {
        let population = Predicted { mean: 0.8, variance: 0.1, points: 1000.0 };
        let f: Vec<f64> = (0..30).map(|i| f64::from(i) / 30.0).collect();
        let groups = [(0..30).map(|i| i / 10).collect::<Vec<usize>>()];
        let found = rate(&[true; 30], &f, population, &groups, Confidence::P95).unwrap();
        let three = wilson(Trials::new(3, 3).unwrap(), Confidence::P95);
        assert!((found.interval.low - three.low).abs() < 1e-12 && (found.worth - 3.0).abs() < 1e-12, "{found:?}");
        assert!((design_effect(&[false; 30], &groups, Confidence::P95) - 10.0).abs() < 1e-12);
        assert!((design_effect(&[false; 30], &[], Confidence::P95) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn misleading_predictions_do_not_widen_the_interval() {
        // One failure with a high prediction turns the sign of λ of every other trial.
        let population = Predicted { mean: 0.24, variance: 0.09, points: f64::INFINITY };
        let y: Vec<bool> = (0..20).map(|i| i >= 9).chain([false]).collect();
        let f: Vec<f64> = y.iter().map(|y| if *y { 0.12 } else { 0.1 }).take(20).chain([0.9]).collect();
        let found = rate(&y, &f, population, &[], Confidence::P95).unwrap();
        assert_eq!((found.rate, found.interval, found.tuning), (11.0 / 21.0, found.alone, 0.0));
        let random = &mut ChaCha8Rng::seed_from_u64(7);
        for _ in 0..2_000 {
            let n = FEWEST + (unit(random) * 20.0) as usize;
            let y: Vec<bool> = (0..n).map(|_| unit(random) < 0.5).collect();
            let f: Vec<f64> = (0..n).map(|_| unit(random)).collect();
            let found = rate(&y, &f, population, &[], Confidence::P95).unwrap();
            assert!(found.worth >= n as f64 / WIDEST - 1e-9, "{y:?} {f:?} {found:?}");
        }
    }

    #[test]
    fn unusable_trials_are_rejected() {
        let population = Predicted::of(&[0.5, 0.6]);
        let of = |y: &[bool], f: &[f64], g: &[Vec<usize>]| rate(y, f, population, g, Confidence::P95);
        assert_eq!(of(&[true; 19], &[0.5; 19], &[]), Err(PoweredError::Few(19)));
        assert_eq!(PoweredError::Few(1).to_string(), "1 trial is too few. Expected at least 20");
        assert_eq!(of(&[true; 20], &[0.5; 19], &[]), Err(PoweredError::Mismatch));
        assert_eq!(of(&[true; 20], &[f64::NAN; 20], &[]), Err(PoweredError::Mismatch));
        assert_eq!(of(&[true; 20], &[0.5; 20], &[vec![0; 20]]), Err(PoweredError::OneGroup));
    }
}
