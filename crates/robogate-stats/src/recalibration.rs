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
//! [`Recalibration::with_effects`] adds single columns to the corrected model: log-odds of success a + b η + Σ g z, with the
//! prior g ~ N(0, 1) for a standardised column z. Its posterior consists of weighted draws: a Student distribution around the
//! mode proposes them, and importance weights correct it. An effect that was chosen by a test is on average estimated too
//! large; the prior draws it towards 0.
//!
//! Trials that share effects count less: a design effect d (the variance of their success rate relative to independent
//! trials) divides the log-likelihood and the squared score statistics (Rao and Scott 1992, Biometrics 48).
//!
//! The model itself was estimated from N rows, so its effect of a column is uncertain, too. With n trials from the same
//! distribution its variance is about b² n/N times that of the trials, so the tests have a design effect of d + b² n/N.
//!
//! Limits: trials are independent given the model, but for d. What a model cannot represent counts as an effect. The tests
//! keep the corrected model at its estimate; the columns are made orthogonal to it, so the error is of second order. Posteriors
//! do not include the uncertainty of the model itself. Sources: Cox (1958), Biometrika 45 (recalibration); Rao (1948);
//! Geweke (1989), Econometrica 57 (importance sampling).

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};

use robogate_maths::dense::{Cholesky, dot};
use robogate_maths::normal;

use crate::Interval;
use crate::resample::uniform;

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
/// Standard deviation of the prior of an effect.
const PRIOR_EFFECT: f64 = 1.0;
/// Draws of a posterior with effects.
const POSTERIOR_DRAWS: usize = 2_000;
/// Degrees of freedom of the distribution that proposes them.
const PROPOSAL_DF: usize = 5;
/// Most Newton steps to the mode of a posterior with effects.
const STEPS_TO_MODE: usize = 50;
/// Simulated sets of outcomes.
const SIMULATIONS: usize = 1_999;

/// Trials with the log-odds that a model predicts for them.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// The model's log-odds of success η, for each trial.
    pub eta: &'a [f64],
    /// Whether each trial succeeded.
    pub outcomes: &'a [bool],
    /// The variance of their success rate relative to independent trials, at least 1.
    pub design_effect: f64,
    /// The number of rows that the model was estimated from, for the tests of effects. Infinite for a model without error.
    pub model_rows: f64,
}

impl Observed<'_> {
    /// The variance of an effect beyond the model relative to independent trials and a model without error.
    fn of_effects(self, slope: f64) -> f64 {
        self.design_effect + slope * slope * self.eta.len() as f64 / self.model_rows
    }
}

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
    /// (a, b, probability), in order of the grid or of the draws.
    points: Vec<(f64, f64, f64)>,
    /// The effects at each point, one after the other.
    effects: Vec<f64>,
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
    /// The posterior after these trials. `level` is that of the intervals.
    pub fn of(observed: Observed<'_>, level: f64) -> Self {
        let trials = counted(observed.eta, observed.outcomes);
        let log_likelihood = |a: f64, b: f64| {
            let of_trial = |[eta, successes, failures]: &[f64; 3]| {
                let x = a + b * eta;
                ln_odds_part(-x, *successes) + ln_odds_part(x, *failures)
            };
            trials.iter().map(of_trial).sum::<f64>() / observed.design_effect
        };
        let (mut shifts, mut slopes) = (SHIFTS, SLOPES);
        let mut found = Self { points: on_grid(shifts, slopes, log_likelihood), effects: Vec::new(), level };
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

    /// The posterior with the effects of these standardised columns (one value for each trial). Without a column, that of
    /// [`Self::of`].
    pub fn with_effects(observed: Observed<'_>, columns: &[Vec<f64>], level: f64, seed: u64) -> Self {
        let posterior = WithEffects::of(observed, columns);
        let proposal = (!columns.is_empty()).then(|| posterior.mode()).flatten();
        let Some((mode, factor)) = proposal else { return Self::of(observed, level) };
        let size = mode.len();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draws = Vec::with_capacity(POSTERIOR_DRAWS);
        for _ in 0..POSTERIOR_DRAWS {
            let mut standard = || normal::quantile(((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64);
            let z: Vec<f64> = (0..size).map(|_| standard()).collect();
            let df = PROPOSAL_DF as f64;
            let scale = (df / (0..PROPOSAL_DF).map(|_| standard().powi(2)).sum::<f64>()).sqrt();
            let distance: f64 = z.iter().map(|z| (z * scale).powi(2)).sum();
            let ln_proposal = -0.5 * (df + size as f64) * (distance / df).ln_1p();
            // x = L⁻ᵀ z has the covariance A⁻¹ of a precision A = L Lᵀ. A x = L z.
            let mut step: Vec<f64> = factor.lower().chunks(size).map(|row| dot(row, &z)).collect();
            factor.solve(&mut step);
            let draw: Vec<f64> = mode.iter().zip(step).map(|(mode, step)| mode + scale * step).collect();
            let ln_weight = posterior.ln(&draw) - ln_proposal;
            draws.push((draw, ln_weight));
        }
        let top = draws.iter().map(|(_, ln_weight)| *ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = draws.iter().map(|(_, ln_weight)| (ln_weight - top).exp()).sum();
        Self {
            points: draws.iter().map(|(draw, w)| (draw[0], draw[1], (w - top).exp() / total)).collect(),
            effects: draws.iter().flat_map(|(draw, _)| draw[2..].iter().copied()).collect(),
            level,
        }
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

    /// The number of effects.
    fn columns(&self) -> usize {
        self.effects.len() / self.points.len().max(1)
    }

    /// The posterior of a function of a, b and the effects.
    pub fn of_function(&self, function: impl Fn(f64, f64, &[f64]) -> f64) -> Posterior {
        let columns = self.columns();
        let value = |(i, (a, b, w)): (usize, &(f64, f64, f64))| {
            (function(*a, *b, &self.effects[i * columns..(i + 1) * columns]), *w)
        };
        let mut values: Vec<(f64, f64)> = self.points.iter().enumerate().map(value).collect();
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
        self.of_function(|a, _, _| a)
    }

    /// b: how much of the model's differences between settings is found in the trials.
    pub fn slope(&self) -> Posterior {
        self.of_function(|_, b, _| b)
    }

    /// g: the change of the log-odds per unit of each column.
    pub fn effects(&self) -> Vec<Posterior> {
        (0..self.columns()).map(|k| self.of_function(|_, _, effects| effects[k])).collect()
    }

    /// P(success) at log-odds `eta` of the model and these values of the columns. Missing ones are 0.
    pub fn success(&self, eta: f64, values: &[f64]) -> Posterior {
        self.of_function(|a, b, effects| corrected(a, b, effects, eta, values))
    }

    /// The model's probability at which the corrected one is `target`, where all columns are 0. `None` if the slope may be 0
    /// or negative.
    pub fn boundary(&self, target: f64) -> Option<Posterior> {
        let wanted = log_odds(target);
        (self.slope().interval.low > 0.0).then(|| self.of_function(|a, b, _| logistic((wanted - a) / b.max(1e-3))))
    }
}

/// The corrected probability of success at log-odds `eta` of the model and values of the columns.
pub fn corrected(a: f64, b: f64, effects: &[f64], eta: f64, values: &[f64]) -> f64 {
    logistic(a + b * eta + effects.iter().zip(values).map(|(effect, value)| effect * value).sum::<f64>())
}

/// The log-likelihood of `count` outcomes whose opposite has the log-odds `x`.
fn ln_odds_part(x: f64, count: f64) -> f64 {
    if count > 0.0 { -count * x.exp().ln_1p() } else { 0.0 }
}

/// The posterior of (a, b, effects) up to a constant.
struct WithEffects<'a> {
    /// (1, η, columns) of each trial.
    rows: Vec<Vec<f64>>,
    observed: Observed<'a>,
}

impl<'a> WithEffects<'a> {
    fn of(observed: Observed<'a>, columns: &[Vec<f64>]) -> Self {
        let row = |(i, eta): (usize, &f64)| [1.0, *eta].into_iter().chain(columns.iter().map(|x| x[i])).collect();
        Self { rows: observed.eta.iter().enumerate().map(row).collect(), observed }
    }

    /// Mean and standard deviation of the prior of a coordinate.
    fn prior(coordinate: usize) -> (f64, f64) {
        match coordinate {
            0 => (0.0, PRIOR.0),
            1 => (1.0, PRIOR.1),
            _ => (0.0, PRIOR_EFFECT),
        }
    }

    fn ln(&self, at: &[f64]) -> f64 {
        let prior = |(k, x): (usize, &f64)| {
            let (mean, deviation) = Self::prior(k);
            -0.5 * ((x - mean) / deviation).powi(2)
        };
        let of_trial = |(row, success): (&Vec<f64>, &bool)| {
            let x = dot(row, at);
            ln_odds_part(if *success { -x } else { x }, 1.0)
        };
        let trials: f64 = self.rows.iter().zip(self.observed.outcomes).map(of_trial).sum();
        trials / self.observed.design_effect + at.iter().enumerate().map(prior).sum::<f64>()
    }

    /// The mode and the factor of the precision there, by Newton's method. The posterior is log-concave.
    fn mode(&self) -> Option<(Vec<f64>, Cholesky)> {
        let size = self.rows.first()?.len();
        let mut at: Vec<f64> = (0..size).map(|k| Self::prior(k).0).collect();
        let mut value = self.ln(&at);
        for _ in 0..STEPS_TO_MODE {
            let (gradient, factor) = self.derivatives(&at)?;
            let mut step = gradient;
            factor.solve(&mut step);
            // Halved until it improves; at the mode, no part of it does.
            let moved = |part: f64| at.iter().zip(&step).map(|(at, step)| at + part * step).collect::<Vec<f64>>();
            let mut tried = (0..20).map(|halvings| moved(0.5_f64.powi(halvings))).map(|to| (self.ln(&to), to));
            let Some((better, to)) = tried.find(|(ln, _)| *ln > value) else { break };
            let gain = better - value;
            (value, at) = (better, to);
            if gain < 1e-10 {
                break;
            }
        }
        let (_, factor) = self.derivatives(&at)?;
        Some((at, factor))
    }

    /// The gradient of the logarithm, and the factor of its negative second derivatives.
    fn derivatives(&self, at: &[f64]) -> Option<(Vec<f64>, Cholesky)> {
        let size = at.len();
        let (mut gradient, mut precision) = (vec![0.0; size], vec![0.0; size * size]);
        for (row, success) in self.rows.iter().zip(self.observed.outcomes) {
            let p = logistic(dot(row, at));
            let error = f64::from(u8::from(*success)) - p;
            for i in 0..size {
                gradient[i] += error * row[i] / self.observed.design_effect;
                for j in 0..size {
                    precision[i * size + j] += p * (1.0 - p) * row[i] * row[j] / self.observed.design_effect;
                }
            }
        }
        for k in 0..size {
            let (mean, deviation) = Self::prior(k);
            gradient[k] -= (at[k] - mean) / deviation.powi(2);
            precision[k * size + k] += deviation.powi(-2);
        }
        Some((gradient, Cholesky::new(&precision, size, 1e-12).ok()?))
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

/// Tests which columns explain the outcomes beyond the corrected model, which has the columns `known` already. `None` for a
/// column that does not vary beyond the model.
pub fn effects(
    observed: Observed<'_>,
    columns: &[Vec<f64>],
    model: &Recalibration,
    known: &[Vec<f64>],
    seed: u64,
) -> Vec<Option<Effect>> {
    let Observed { eta, outcomes, .. } = observed;
    let (a, b) = (model.shift().mean, model.slope().mean);
    let design_effect = observed.of_effects(b);
    let means: Vec<f64> = model.effects().iter().map(|effect| effect.mean).collect();
    let values = |i: usize| known.iter().map(|column| column[i]).collect::<Vec<f64>>();
    let p: Vec<f64> = eta.iter().enumerate().map(|(i, eta)| corrected(a, b, &means, *eta, &values(i))).collect();
    let w: Vec<f64> = p.iter().map(|p| p * (1.0 - p)).collect();
    let model: Vec<&[f64]> = std::iter::once(eta).chain(known.iter().map(Vec::as_slice)).collect();
    let ready: Vec<Option<(Vec<f64>, f64)>> = columns.iter().map(|x| orthogonal(x, &model, &w)).collect();
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
        let y: Vec<f64> = p.iter().map(|p| f64::from(u8::from(uniform(&mut random) < *p))).collect();
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

/// A standardised column without its weighted regression on 1 and the columns of the model, and its information.
fn orthogonal(x: &[f64], model: &[&[f64]], w: &[f64]) -> Option<(Vec<f64>, f64)> {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let deviation = (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    if deviation.is_nan() || deviation <= 1e-12 {
        return None;
    }
    let total: f64 = w.iter().sum();
    let centred = |v: &[f64]| -> Vec<f64> {
        let mean = v.iter().zip(w).map(|(v, w)| v * w).sum::<f64>() / total;
        v.iter().map(|v| v - mean).collect()
    };
    let standard: Vec<f64> = x.iter().map(|x| (x - mean) / deviation).collect();
    let mut rest = centred(&standard);
    // Gram-Schmidt: `axes` span the model.
    let mut axes: Vec<Vec<f64>> = Vec::with_capacity(model.len());
    for column in model {
        let mut axis = centred(column);
        axes.iter().for_each(|other| remove(&mut axis, other, w));
        remove(&mut rest, &axis, w);
        axes.push(axis);
    }
    let information: f64 = rest.iter().zip(w).map(|(x, w)| w * x * x).sum();
    (information > 1e-6 * total).then_some((rest, information))
}

/// Subtracts the weighted projection on `axis`.
fn remove(from: &mut [f64], axis: &[f64], w: &[f64]) {
    let (mut shared, mut spread) = (0.0, 0.0);
    for ((x, axis), w) in from.iter().zip(axis).zip(w) {
        shared += w * x * axis;
        spread += w * axis * axis;
    }
    let slope = if spread > 1e-12 { shared / spread } else { 0.0 };
    from.iter_mut().zip(axis).for_each(|(x, axis)| *x -= slope * axis);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logistic::{Data, Options, fit};

    fn data(seed: u64, n: usize, truth: impl Fn(f64, f64) -> f64) -> (Vec<f64>, Vec<f64>, Vec<bool>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = || uniform(&mut random);
        let (mut eta, mut x, mut y) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..n {
            let (e, v) = (6.0 * unit() - 3.0, unit());
            y.push(unit() < logistic(truth(e, v)));
            eta.push(e);
            x.push(v);
        }
        (eta, x, y)
    }

    fn observed<'a>(eta: &'a [f64], outcomes: &'a [bool], design_effect: f64) -> Observed<'a> {
        Observed { eta, outcomes, design_effect, model_rows: f64::INFINITY }
    }

    #[test]
    fn errors_of_the_model_are_no_effects() {
        // Four columns with an effect, and a model of it from as many rows as there are trials.
        let rows = |seed: u64| {
            let columns: Vec<Vec<f64>> = (0..4).map(|k| data(10 * seed + k, 300, |_, _| 0.0).1).collect();
            let truth = |i: usize| 2.0 * columns[0][i] - 3.0 * columns[1][i] + columns[2][i] + 0.5;
            let mut random = ChaCha8Rng::seed_from_u64(1_000_000 + seed);
            let success: Vec<bool> = (0..300).map(|i| uniform(&mut random) < logistic(truth(i))).collect();
            (columns, success)
        };
        let (mut named, mut named_without) = (0, 0);
        for seed in 0..100 {
            let (columns, success) = rows(2 * seed);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let model = fit(Data::new(&slices, &success, None).unwrap(), Options::default()).unwrap();
            let (columns, success) = rows(2 * seed + 1);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let eta: Vec<f64> = model.probabilities(&slices).unwrap().iter().map(|p| log_odds(*p)).collect();
            let known = observed(&eta, &success, 1.0);
            let recalibrated = Recalibration::of(known, 0.95);
            let names = |trials: Observed<'_>| {
                let found = effects(trials, &columns, &recalibrated, &[], seed);
                usize::from(found.iter().flatten().any(|effect| effect.adjusted_p <= 0.05))
            };
            named += names(Observed { model_rows: 300.0, ..known });
            named_without += names(known);
        }
        assert!(named <= 11 && named_without >= 12, "{named} {named_without}");
    }

    #[test]
    fn intervals_cover_shift_and_slope() {
        let (mut shift, mut slope, mut boundary) = (0, 0, 0);
        for seed in 0..100 {
            let (eta, _, y) = data(seed, 40, |eta, _| 0.7 * eta - 0.8);
            let found = Recalibration::of(observed(&eta, &y, 1.0), 0.95);
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
            Recalibration::of(observed(&eta, &y, design_effect), 0.95)
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
        let found = Recalibration::of(observed(&[0.0; 20], &[true; 20], 1.0), 0.95);
        assert!(found.shift().interval.low > 0.0 && found.success(0.0, &[]).interval.high < 1.0);
        assert_eq!(found.boundary(0.5), None);
    }

    #[test]
    fn effects_have_the_stated_error() {
        let (mut named, mut planted) = (0, 0);
        for seed in 0..100 {
            let (eta, x, y) = data(seed, 40, |eta, _| eta - 0.5);
            let noise: Vec<Vec<f64>> = (0..5).map(|k| data(1_000 + 10 * seed + k, 40, |_, _| 0.0).1).collect();
            let model = Recalibration::of(observed(&eta, &y, 1.0), 0.95);
            let columns: Vec<Vec<f64>> = noise.iter().cloned().chain([x]).collect();
            let found = effects(observed(&eta, &y, 1.0), &columns, &model, &[], seed);
            named += usize::from(found.iter().flatten().any(|effect| effect.adjusted_p <= 0.05));
            let (eta, x, y) = data(seed, 60, |eta, x| eta - 6.0 * x + 3.0);
            let model = Recalibration::of(observed(&eta, &y, 1.0), 0.95);
            let columns: Vec<Vec<f64>> = noise.iter().map(|n| [&n[..], &n[..20]].concat()).chain([x]).collect();
            let found = effects(observed(&eta, &y, 1.0), &columns, &model, &[], seed);
            planted += usize::from(found[5].is_some_and(|effect| effect.adjusted_p <= 0.05 && effect.slope < 0.0));
        }
        assert!(named <= 11 && planted >= 55, "{named} {planted}");
    }

    #[test]
    fn effects_join_the_model() {
        let truth = |eta: f64, z: f64| 0.8 * eta - 0.5 - 0.9 * z;
        // A standardised uniform column.
        let of = |x: f64| (x - 0.5) * 12.0_f64.sqrt();
        let (mut effect, mut shift, mut rates, mut places, mut plain_rates) = (0, 0, 0, 0, 0);
        for seed in 0..100 {
            let (eta, x, y) = data(seed, 60, |eta, x| truth(eta, of(x)));
            let column: Vec<f64> = x.iter().map(|x| of(*x)).collect();
            let trials = observed(&eta, &y, 1.0);
            let model = Recalibration::with_effects(trials, std::slice::from_ref(&column), 0.95, seed);
            let plain = Recalibration::of(trials, 0.95);
            effect += usize::from(model.effects()[0].interval.contains(-0.9));
            shift += usize::from(model.shift().interval.contains(-0.5));
            for (eta, z) in [(-1.5, -1.2), (0.0, 1.2), (1.5, 0.0), (1.5, 1.5)] {
                let rate = logistic(truth(eta, z));
                rates += usize::from(model.success(eta, &[z]).interval.contains(rate));
                plain_rates += usize::from(plain.success(eta, &[]).interval.contains(rate));
                places += 1;
            }
            // The effect is in the model, and explains nothing more.
            let more = effects(trials, &[column.clone(), eta.clone()], &model, std::slice::from_ref(&column), seed);
            assert_eq!(more, [None, None]);
        }
        assert!(effect >= 90 && shift >= 90, "{effect} {shift}");
        assert!(rates * 100 >= places * 91 && plain_rates * 100 < places * 75, "{rates} {plain_rates} of {places}");
    }

    #[test]
    fn draws_and_grid_have_the_same_posterior() {
        let (eta, _, y) = data(3, 60, |eta, _| 0.7 * eta - 0.8);
        let grid = Recalibration::of(observed(&eta, &y, 1.0), 0.95);
        // A column without information leaves the rest as it is, and its effect has its prior.
        let draws = Recalibration::with_effects(observed(&eta, &y, 1.0), &[vec![0.0; 60]], 0.95, 1);
        let near = |a: f64, b: f64| (a - b).abs() < 0.08;
        for (a, b) in [(grid.shift(), draws.shift()), (grid.slope(), draws.slope())] {
            let ends = near(a.interval.low, b.interval.low) && near(a.interval.high, b.interval.high);
            assert!(near(a.mean, b.mean) && ends, "{a:?} {b:?}");
        }
        let prior = draws.effects()[0];
        assert!(prior.mean.abs() < 0.1 && (prior.interval.width() - 3.92).abs() < 0.4, "{prior:?}");
        assert_eq!(Recalibration::with_effects(observed(&eta, &y, 1.0), &[], 0.95, 1).shift(), grid.shift());
    }
}
