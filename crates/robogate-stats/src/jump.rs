//! The interval of a jump of the rate along a parameter, at the resolution of single rows.
//!
//! The model is a rate p1 up to the jump and a rate p2 beyond it. The interval contains the places whose log-likelihood is less
//! than k below the largest one. If p1 and p2 are known, the log-likelihood at places before and after the true one is a random walk
//! with negative drift on each side, and k is the 95 % quantile of the larger maximum of both (Siegmund 1988). It is computed by
//! simulation of both walks with the estimated rates.
//!
//! The model is used only if it explains the rows at least as well as a logistic curve. Weights count with their effective number.
//!
//! Source: Siegmund (1988), International Statistical Review 56(1).

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::interval::{Confidence, Interval};
use crate::logistic::{Data, Options, fit};
use crate::resample::uniform;
use crate::scan::log_likelihood;
use crate::threshold::Direction;

/// Most rows. Of more, every n-th is used.
const MOST_ROWS: usize = 50_000;
/// Simulated pairs of walks.
const WALKS: usize = 2_000;
/// Steps of a walk, and how far below 0 it ends: it returns with a probability below 1e-5.
const STEPS: usize = 2_000;
const LOWEST: f64 = -12.0;

/// Log-likelihood by which a jump must explain the rows better than a logistic curve to be the only model.
const CLEAR: f64 = 4.0;
/// The part of each side next to the jump whose rates count too.
const NEAR: f64 = 0.3;

/// The interval of the jump through `level`, and whether a jump is clearly the better model. `None` if it does not explain the rows at
/// least as well as a logistic curve. Rows count as this share of independent ones.
pub(crate) fn jump(
    values: &[f64],
    outcomes: &[bool],
    weights: Option<&[f64]>,
    share: f64,
    (direction, level): (Direction, f64),
    confidence: Confidence,
) -> Option<(Interval, bool)> {
    let step = values.len().div_ceil(MOST_ROWS).max(1);
    let weight = |row: usize| weights.map_or(1.0, |w| w[row]);
    let mut rows: Vec<usize> = (0..values.len()).step_by(step).filter(|row| weight(*row) > 0.0).collect();
    rows.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let (sum, squares) = rows.iter().fold((0.0, 0.0), |(s, q), row| (s + weight(*row), q + weight(*row).powi(2)));
    let scale = share * sum / squares;
    let (mut cuts, mut left) = (Vec::new(), (0.0, 0.0));
    // Weighted successes and weight of all rows before each.
    let mut sums = vec![(0.0, 0.0)];
    let all = rows.iter().filter(|row| outcomes[**row]).map(|row| scale * weight(*row)).sum::<f64>();
    for pair in rows.windows(2) {
        let w = scale * weight(pair[0]);
        left = (left.0 + if outcomes[pair[0]] { w } else { 0.0 }, left.1 + w);
        sums.push(left);
        let (low, high) = (values[pair[0]], values[pair[1]]);
        if low < high {
            let right = (all - left.0, scale * sum - left.1);
            let rates = (left.0 / left.1, right.0 / right.1);
            cuts.push((
                log_likelihood(left.0, left.1) + log_likelihood(right.0, right.1),
                rates,
                low,
                high,
                sums.len() - 1,
            ));
        }
    }
    let (most, rates, _, _, at) = cuts.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let through = match direction {
        Direction::Rising => rates.0 < level && level < rates.1,
        Direction::Falling => rates.0 > level && level > rates.1,
    };
    let column: Vec<f64> = rows.iter().map(|row| values[*row]).collect();
    let success: Vec<bool> = rows.iter().map(|row| outcomes[*row]).collect();
    let scaled: Vec<f64> = rows.iter().map(|row| scale * weight(*row)).collect();
    let smooth = fit(Data::new(&[&column], &success, Some(&scaled)).ok()?, Options::default()).ok()?;
    if !through || most < smooth.log_likelihood {
        return None;
    }
    sums.push((all, scale * sum));
    // If the rates change along a side, those next to the jump decide.
    let rate = |from: usize, to: usize| (sums[to].0 - sums[from].0) / (sums[to].1 - sums[from].1);
    let first = ((1.0 - NEAR) * at as f64) as usize;
    let last = at + ((NEAR * (rows.len() - at) as f64).ceil() as usize).max(1);
    let near = (rate(first, at), rate(at, last));
    let through = (near.0 > near.1) == (rates.0 > rates.1);
    let k = largest_gain(rates, confidence).max(if through { largest_gain(near, confidence) } else { 0.0 });
    let inside = || cuts.iter().filter(|cut| cut.0 >= most - k);
    let low = inside().map(|cut| cut.2).fold(f64::INFINITY, f64::min);
    let high = inside().map(|cut| cut.3).fold(f64::NEG_INFINITY, f64::max);
    (low <= high).then_some((Interval { low, high }, most > smooth.log_likelihood + CLEAR))
}

/// The quantile of the largest gain in log-likelihood at a place other than that of the jump.
fn largest_gain((p1, p2): (f64, f64), confidence: Confidence) -> f64 {
    let inside = |p: f64| p.clamp(1e-3, 1.0 - 1e-3);
    let (p1, p2) = (inside(p1), inside(p2));
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut walk = |own: f64, other: f64| {
        let (success, failure) = ((other / own).ln(), ((1.0 - other) / (1.0 - own)).ln());
        let (mut at, mut most) = (0.0_f64, 0.0_f64);
        for _ in 0..STEPS {
            at += if uniform(&mut rng) < own { success } else { failure };
            most = most.max(at);
            if at < LOWEST {
                break;
            }
        }
        most
    };
    let mut gains: Vec<f64> = (0..WALKS).map(|_| walk(p1, p2).max(walk(p2, p1))).collect();
    gains.sort_unstable_by(f64::total_cmp);
    gains[((confidence.level() * WALKS as f64).ceil() as usize).clamp(1, WALKS) - 1] + 1e-9
}
