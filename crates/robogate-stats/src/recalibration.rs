//! Correction of a model's log-odds from few trials, and tests of what it does not explain.
//!
//! P(success of a trial) = logistic(a + b η), with the model's log-odds η. a = 0 and b = 1 means that the model is right.
//! The posterior of (a, b) is computed on a grid, with the priors a ~ N(0, 2²) and b ~ N(1, 1): it exists for any
//! outcomes, also if all trials succeed. A posterior that is narrow for the grid is computed again on a finer one around it.
//!
//! [`effects`] tests whether columns (parameters) explain outcomes beyond a + b η: score statistics, whose joint
//! distribution under the corrected model is simulated. p-values are adjusted for the largest statistic of all columns
//! (Westfall and Young 1993, single step), so the probability of naming any column without effect is at most α.
//!
//! Trials that share effects count less: a design effect d (the variance of their success rate relative to independent
//! trials) divides the log-likelihood and the squared score statistics (Rao and Scott 1992, Biometrics 48).
//!
//! Limits: trials are independent given the model, but for d. The simulation keeps (a, b) at their estimate; the columns are made
//! orthogonal to both, so the error is of second order. Sources: Cox (1958), Biometrika 45 (recalibration); Rao (1948).

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};

use crate::Interval;

/// Largest |η| of a model. Beyond it, a model claims more certainty than episodes can show.
pub const LARGEST_LOG_ODDS: f64 = 6.0;
/// The lowest value of a grid, the highest one, and their number.
type Grid = (f64, f64, usize);

/// The first grid of a.
const SHIFTS: Grid = (-7.0, 7.0, 141);
/// The first grid of b.
const SLOPES: Grid = (-1.5, 4.5, 97);
/// Fewest steps of the grid in a standard deviation of the posterior.
const STEPS: f64 = 2.0;
/// Half the width of a finer grid, in standard deviations of the posterior on the coarse one.
const REACH: f64 = 7.0;
/// Most trials whose log-odds are used as they are.
const MOST_SINGLE: usize = 1_000;
/// Standard deviations of the priors.
const PRIOR: (f64, f64) = (2.0, 1.0);
/// Simulated sets of outcomes.
const SIMULATIONS: usize = 1_999;

/// A quantity with the interval of its posterior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posterior {
    /// The mean.
    pub mean: f64,
    /// The central interval.
    pub interval: Interval,
}

/// The posterior of the correction.
#[derive(Debug, Clone)]
pub struct Recalibration {
    /// (a, b, probability), in order of the grid.
    points: Vec<(f64, f64, f64)>,
    level: f64,
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Log-odds with the numbers of successes and failures. Many trials are counted together where their log-odds are equal to
/// 0.01, which is far less than their posterior can tell.
fn counted(eta: &[f64], outcomes: &[bool]) -> Vec<[f64; 3]> {
    let one = |(eta, y): (&f64, &bool)| [*eta, f64::from(u8::from(*y)), f64::from(u8::from(!*y))];
    let trials: Vec<[f64; 3]> = eta.iter().zip(outcomes).map(one).collect();
    if trials.len() <= MOST_SINGLE {
        return trials;
    }
    let mut together = BTreeMap::new();
    for [eta, successes, failures] in trials {
        let of = together.entry((100.0 * eta).round() as i64).or_insert([0.0; 2]);
        *of = [of[0] + successes, of[1] + failures];
    }
    together.into_iter().map(|(eta, [successes, failures])| [eta as f64 / 100.0, successes, failures]).collect()
}

/// The posterior on a grid. Points without weight only cost time, and are left out.
fn on_grid(shifts: Grid, slopes: Grid, log_likelihood: impl Fn(f64, f64) -> f64) -> Vec<(f64, f64, f64)> {
    let value = |(low, high, n): Grid, i: usize| low + (high - low) * i as f64 / (n - 1) as f64;
    let mut points = Vec::with_capacity(shifts.2 * slopes.2);
    for i in 0..shifts.2 {
        let a = value(shifts, i);
        for j in 0..slopes.2 {
            let b = value(slopes, j);
            let prior = -0.5 * ((a / PRIOR.0).powi(2) + ((b - 1.0) / PRIOR.1).powi(2));
            points.push((a, b, prior + log_likelihood(a, b)));
        }
    }
    let top = points.iter().map(|p| p.2).fold(f64::NEG_INFINITY, f64::max);
    points.iter_mut().for_each(|p| p.2 = (p.2 - top).exp());
    let total: f64 = points.iter().map(|p| p.2).sum();
    points.iter_mut().for_each(|p| p.2 /= total);
    points.retain(|p| p.2 > 1e-12);
    points
}

/// The log-odds of a probability, limited to [`LARGEST_LOG_ODDS`].
pub fn log_odds(p: f64) -> f64 {
    let p = p.clamp(1e-12, 1.0 - 1e-12);
    (p / (1.0 - p)).ln().clamp(-LARGEST_LOG_ODDS, LARGEST_LOG_ODDS)
}

impl Recalibration {
    /// The posterior after trials with these log-odds and outcomes, whose log-likelihood is divided by `design_effect`.
    /// `level` is that of the intervals.
    pub fn of(eta: &[f64], outcomes: &[bool], design_effect: f64, level: f64) -> Self {
        let trials = counted(eta, outcomes);
        let log_likelihood = |a: f64, b: f64| {
            let of_outcome = |x: f64, count: f64| if count > 0.0 { -count * x.exp().ln_1p() } else { 0.0 };
            let of_trial = |[eta, successes, failures]: &[f64; 3]| {
                let x = a + b * eta;
                of_outcome(-x, *successes) + of_outcome(x, *failures)
            };
            trials.iter().map(of_trial).sum::<f64>() / design_effect
        };
        let (mut shifts, mut slopes) = (SHIFTS, SLOPES);
        let mut found = Self { points: on_grid(shifts, slopes, log_likelihood), level };
        // Each grid has a tenth of the step of the last one, or resolves the posterior.
        for _ in 0..4 {
            let finer = (found.finer(shifts, |a, _| a), found.finer(slopes, |_, b| b));
            if finer == (None, None) {
                break;
            }
            (shifts, slopes) = (finer.0.unwrap_or(shifts), finer.1.unwrap_or(slopes));
            found.points = on_grid(shifts, slopes, log_likelihood);
        }
        found
    }

    /// A finer grid around the posterior of a coordinate, if it is narrow for `grid`.
    fn finer(&self, grid: Grid, coordinate: impl Fn(f64, f64) -> f64) -> Option<Grid> {
        let (low, high, n) = grid;
        let moment =
            |of: &dyn Fn(f64) -> f64| self.points.iter().map(|(a, b, w)| w * of(coordinate(*a, *b))).sum::<f64>();
        let mean = moment(&|x| x);
        let step = (high - low) / (n - 1) as f64;
        // The step itself, because the variance on a coarse grid may be 0.
        let deviation = moment(&|x| (x - mean).powi(2)).sqrt();
        let reach = REACH * deviation.max(step);
        (deviation < STEPS * step).then(|| ((mean - reach).max(low), (mean + reach).min(high), n))
    }

    /// The posterior of a function of (a, b).
    pub fn of_function(&self, function: impl Fn(f64, f64) -> f64) -> Posterior {
        let mut values: Vec<(f64, f64)> = self.points.iter().map(|(a, b, w)| (function(*a, *b), *w)).collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mean = values.iter().map(|(x, w)| x * w).sum();
        let quantile = |q: f64| {
            let mut sum = 0.0;
            let at = values.iter().find(|(_, w)| {
                sum += w;
                sum >= q
            });
            at.or(values.last()).map_or(f64::NAN, |(x, _)| *x)
        };
        let tail = 0.5 * (1.0 - self.level);
        Posterior { mean, interval: Interval { low: quantile(tail), high: quantile(1.0 - tail) } }
    }

    /// a: how much the log-odds of success differ where the model predicts 50 %.
    pub fn shift(&self) -> Posterior {
        self.of_function(|a, _| a)
    }

    /// b: how much of the model's differences between settings is found in the trials.
    pub fn slope(&self) -> Posterior {
        self.of_function(|_, b| b)
    }

    /// P(success) at log-odds `eta` of the model.
    pub fn success(&self, eta: f64) -> Posterior {
        self.of_function(|a, b| logistic(a + b * eta))
    }

    /// The model's probability at which the corrected one is `target`. `None` if the slope may be 0 or negative.
    pub fn boundary(&self, target: f64) -> Option<Posterior> {
        let wanted = log_odds(target);
        (self.slope().interval.low > 0.0).then(|| self.of_function(|a, b| logistic((wanted - a) / b.max(1e-3))))
    }
}

/// The test of one column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effect {
    /// The score statistic: positive if outcomes are better than the model where the column is large.
    pub z: f64,
    /// p-value, adjusted for all columns of the call.
    pub adjusted_p: f64,
    /// The change of the log-odds of success for one standard deviation of the column (one Newton step).
    pub slope: f64,
    /// Its standard error.
    pub se: f64,
}

/// Tests which columns explain `outcomes` beyond the corrected model. `None` for a column that does not vary beyond the
/// model's log-odds. The squared statistics are divided by `design_effect`.
pub fn effects(
    eta: &[f64],
    outcomes: &[bool],
    columns: &[Vec<f64>],
    model: &Recalibration,
    design_effect: f64,
    seed: u64,
) -> Vec<Option<Effect>> {
    let (a, b) = (model.shift().mean, model.slope().mean);
    let p: Vec<f64> = eta.iter().map(|eta| logistic(a + b * eta)).collect();
    let w: Vec<f64> = p.iter().map(|p| p * (1.0 - p)).collect();
    let ready: Vec<Option<(Vec<f64>, f64)>> = columns.iter().map(|x| orthogonal(x, eta, &w)).collect();
    let z = |x: &[f64], information: f64, y: &mut dyn FnMut(usize) -> f64| -> f64 {
        x.iter().enumerate().map(|(i, x)| x * (y(i) - p[i])).sum::<f64>() / information.sqrt()
    };
    let found: Vec<Option<f64>> = ready
        .iter()
        .map(|ready| {
            let (x, information) = ready.as_ref()?;
            let z = z(x, *information, &mut |i| f64::from(u8::from(outcomes[i])));
            Some(z / design_effect.sqrt())
        })
        .collect();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut largest = Vec::with_capacity(SIMULATIONS);
    for _ in 0..SIMULATIONS {
        let y: Vec<f64> = p
            .iter()
            .map(|p| {
                let u = (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
                f64::from(u8::from(u < *p))
            })
            .collect();
        let most = ready.iter().flatten().map(|(x, information)| z(x, *information, &mut |i| y[i]).abs());
        largest.push(most.fold(0.0, f64::max));
    }
    found
        .iter()
        .zip(&ready)
        .map(|(found, ready)| {
            let (z, (_, information)) = ((*found)?, ready.as_ref()?);
            let above = largest.iter().filter(|most| **most >= z.abs() - 1e-12).count();
            let se = (design_effect / information).sqrt();
            Some(Effect { z, adjusted_p: (above + 1) as f64 / (SIMULATIONS + 1) as f64, slope: z * se, se })
        })
        .collect()
}

/// A standardised column without its weighted regression on 1 and η, and its information.
fn orthogonal(x: &[f64], eta: &[f64], w: &[f64]) -> Option<(Vec<f64>, f64)> {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let deviation = (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    if deviation.is_nan() || deviation <= 1e-12 {
        return None;
    }
    let x: Vec<f64> = x.iter().map(|x| (x - mean) / deviation).collect();
    let total: f64 = w.iter().sum();
    let weighted = |v: &[f64]| v.iter().zip(w).map(|(v, w)| v * w).sum::<f64>() / total;
    let (mx, me) = (weighted(&x), weighted(eta));
    let (mut shared, mut spread) = (0.0, 0.0);
    for ((x, eta), w) in x.iter().zip(eta).zip(w) {
        shared += w * (x - mx) * (eta - me);
        spread += w * (eta - me).powi(2);
    }
    let slope = if spread > 1e-12 { shared / spread } else { 0.0 };
    let rest: Vec<f64> = x.iter().zip(eta).map(|(x, eta)| x - mx - slope * (eta - me)).collect();
    let information: f64 = rest.iter().zip(w).map(|(x, w)| w * x * x).sum();
    (information > 1e-6 * total).then_some((rest, information))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data(seed: u64, n: usize, truth: impl Fn(f64, f64) -> f64) -> (Vec<f64>, Vec<f64>, Vec<bool>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        let (mut eta, mut x, mut y) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..n {
            let (e, v) = (6.0 * unit() - 3.0, unit());
            y.push(unit() < logistic(truth(e, v)));
            eta.push(e);
            x.push(v);
        }
        (eta, x, y)
    }

    #[test]
    fn intervals_cover_shift_and_slope() {
        let (mut shift, mut slope, mut boundary) = (0, 0, 0);
        for seed in 0..100 {
            let (eta, _, y) = data(seed, 40, |eta, _| 0.7 * eta - 0.8);
            let found = Recalibration::of(&eta, &y, 1.0, 0.95);
            shift += usize::from(found.shift().interval.contains(-0.8));
            slope += usize::from(found.slope().interval.contains(0.7));
            boundary += usize::from(found.boundary(0.5).is_none_or(|b| b.interval.contains(logistic(0.8 / 0.7))));
        }
        assert!(shift >= 90 && slope >= 90 && boundary >= 88, "{shift} {slope} {boundary}");
    }

    #[test]
    fn many_trials_have_a_narrow_posterior() {
        // Two log-odds, with the success rates of a right model: the posterior is normal around 0 and 1.
        let of = |n: usize, design_effect: f64| {
            let eta: Vec<f64> = (0..n).map(|i: usize| if i.is_multiple_of(2) { 1.0 } else { -1.0 }).collect();
            let share = logistic(1.0);
            let limit = |i: usize| if i.is_multiple_of(2) { share } else { 1.0 - share };
            let y: Vec<bool> = (0..n).map(|i| limit(i) > ((i / 2) as f64 + 0.5) / (n / 2) as f64).collect();
            Recalibration::of(&eta, &y, design_effect, 0.95)
        };
        for n in [400, 40_000] {
            let (shift, slope) = (of(n, 1.0).shift(), of(n, 1.0).slope());
            let half = 1.96 / (n as f64 * logistic(1.0) * logistic(-1.0)).sqrt();
            for (found, mean) in [(shift, 0.0), (slope, 1.0)] {
                assert!((found.mean - mean).abs() < 0.1 * half, "{n} {found:?}");
                assert!((found.interval.width() / (2.0 * half) - 1.0).abs() < 0.1, "{n} {half} {found:?}");
            }
        }
        let wider = of(400, 4.0).slope().interval.width() / of(400, 1.0).slope().interval.width();
        assert!((wider - 2.0).abs() < 0.15, "{wider}");
    }

    #[test]
    fn equal_outcomes_have_a_posterior() {
        let found = Recalibration::of(&[0.0; 20], &[true; 20], 1.0, 0.95);
        assert!(found.shift().interval.low > 0.0 && found.success(0.0).interval.high < 1.0);
        assert_eq!(found.boundary(0.5), None);
    }

    #[test]
    fn effects_have_the_stated_error() {
        let (mut named, mut planted) = (0, 0);
        for seed in 0..100 {
            let (eta, x, y) = data(seed, 40, |eta, _| eta - 0.5);
            let noise: Vec<Vec<f64>> = (0..5).map(|k| data(1_000 + 10 * seed + k, 40, |_, _| 0.0).1).collect();
            let model = Recalibration::of(&eta, &y, 1.0, 0.95);
            let columns: Vec<Vec<f64>> = noise.iter().cloned().chain([x]).collect();
            let found = effects(&eta, &y, &columns, &model, 1.0, seed);
            named += usize::from(found.iter().flatten().any(|effect| effect.adjusted_p <= 0.05));
            let (eta, x, y) = data(seed, 60, |eta, x| eta - 6.0 * x + 3.0);
            let model = Recalibration::of(&eta, &y, 1.0, 0.95);
            let columns: Vec<Vec<f64>> = noise.iter().map(|n| [&n[..], &n[..20]].concat()).chain([x]).collect();
            let found = effects(&eta, &y, &columns, &model, 1.0, seed);
            planted += usize::from(found[5].is_some_and(|effect| effect.adjusted_p <= 0.05 && effect.slope < 0.0));
        }
        assert!(named <= 11 && planted >= 55, "{named} {planted}");
    }
}
