//! The difference of two success rates: an interval and a p-value that come from one test and therefore agree.
//!
//! The interval contains exactly the differences d that the test of "p₁ - p₂ = d" does not reject, and the p-value is
//! that of d = 0. The interval excludes 0 if and only if p is at most one minus its level.
//!
//! - [`independent`]: the score test of Miettinen and Nurminen. Its statistic is (p̂₁ - p̂₂ - d) / sqrt(V), where V uses
//!   the most likely rates that differ by d, with the factor N/(N-1).
//! - [`paired`]: the same scenarios under both conditions. Tango's score statistic orders the tables. With up to
//!   [`EXACT_PAIRS`] pairs the p-value is the exact unconditional one, as in [`crate::non_inferiority`]; above that it is
//!   the normal one.
//!
//! Limit: trials (pairs) are independent. The normal p-values are approximations; their error is below 0.01 in the
//! coverage simulations of `tests/difference.rs`. Sources: Miettinen and Nurminen (1985), Statistics in Medicine 4,
//! 213-226; Tango (1998), Statistics in Medicine 17, 891-908.

use robogate_maths::normal;

use crate::compare::Pairs;
use crate::interval::{Confidence, Interval, Trials};
use crate::non_inferiority::{Side, largest_tail_on, statistic};

/// Largest number of pairs for which the paired test is exact. The search over the unknown rate takes longer above.
pub const EXACT_PAIRS: u64 = 300;

/// Points of the search over the unknown rate of the exact test.
const GRID: u32 = 60;

/// The difference of two rates with its test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreDifference {
    /// First rate minus second. `None` if one has no trials.
    pub estimate: Option<f64>,
    /// The differences that the test does not reject, within [-1, 1].
    pub interval: Interval,
    /// ln of the two-sided p-value of equal rates. 0 (p = 1) without trials.
    pub ln_p: f64,
}

impl ScoreDifference {
    const NONE: Self = Self { estimate: None, interval: Interval { low: -1.0, high: 1.0 }, ln_p: 0.0 };

    /// Inverts one-sided tests. `above(d)` is ln p of "the difference is at most d", `below(d)` of "at least d".
    fn invert(estimate: f64, confidence: Confidence, above: impl Fn(f64) -> f64, below: impl Fn(f64) -> f64) -> Self {
        let ln_tail = confidence.tail().ln();
        let (at_most_0, at_least_0) = (above(0.0), below(0.0));
        // Both searches start at 0, so each end is on the same side of 0 as the decision of the test at 0.
        let rejects_low = at_most_0 <= ln_tail;
        let rejects_high = at_least_0 <= ln_tail;
        let low = end(|d| above(d) <= ln_tail, if rejects_low { [0.0, estimate] } else { [-1.0, estimate.min(0.0)] });
        let high =
            -end(|d| below(-d) <= ln_tail, if rejects_high { [0.0, -estimate] } else { [-1.0, -estimate.max(0.0)] });
        let ln_p = (at_most_0.min(at_least_0) + std::f64::consts::LN_2).min(0.0);
        Self { estimate: Some(estimate), interval: Interval { low, high }, ln_p }
    }
}

/// The largest d in the range up to which `rejected` holds. The lower end of the range if it holds nowhere.
fn end(rejected: impl Fn(f64) -> bool, [low, high]: [f64; 2]) -> f64 {
    let (mut low, mut high) = (low, high.max(low));
    for _ in 0..18 {
        let middle = 0.5 * (low + high);
        if rejected(middle) { low = middle } else { high = middle }
    }
    low
}

/// The difference of two independent rates.
pub fn independent(first: Trials, second: Trials, confidence: Confidence) -> ScoreDifference {
    let (Some(p1), Some(p2)) = (first.rate(), second.rate()) else { return ScoreDifference::NONE };
    let z = |d: f64| miettinen_nurminen(first, second, d);
    ScoreDifference::invert(p1 - p2, confidence, |d| normal::ln_sf(z(d)), |d| normal::ln_sf(-z(d)))
}

/// The statistic of "p₁ - p₂ = d". Large if the difference is above d.
fn miettinen_nurminen(first: Trials, second: Trials, d: f64) -> f64 {
    let (n1, n2) = (first.n() as f64, second.n() as f64);
    let (x1, x2) = (first.successes() as f64, second.successes() as f64);
    let n = n1 + n2;
    // The cubic equation of the most likely p₂ if p₁ = p₂ + d (their appendix 1).
    let l3 = n;
    let l2 = (n1 + 2.0 * n2) * d - n - (x1 + x2);
    let l1 = (n2 * d - n - 2.0 * x2) * d + x1 + x2;
    let l0 = x2 * d * (1.0 - d);
    let third = l2 / (3.0 * l3);
    let q = third.powi(3) - l1 * l2 / (6.0 * l3 * l3) + l0 / (2.0 * l3);
    let root = (third * third - l1 / (3.0 * l3)).max(0.0).sqrt();
    let p = if q >= 0.0 { root } else { -root };
    let angle =
        if p.abs() > 0.0 { (std::f64::consts::PI + (q / p.powi(3)).clamp(-1.0, 1.0).acos()) / 3.0 } else { 0.0 };
    let second_rate = (2.0 * p * angle.cos() - third).clamp(0.0_f64.max(-d), 1.0_f64.min(1.0 - d));
    let first_rate = (second_rate + d).clamp(0.0, 1.0);
    let variance =
        (first_rate * (1.0 - first_rate) / n1 + second_rate * (1.0 - second_rate) / n2) * n / (n - 1.0).max(1.0);
    ratio(x1 / n1 - x2 / n2 - d, variance)
}

/// The quotient of an excess and a standard deviation, also if the variance is 0.
fn ratio(excess: f64, variance: f64) -> f64 {
    if variance > 1e-300 {
        excess / variance.sqrt()
    } else if excess.abs() < 1e-12 {
        0.0
    } else {
        f64::INFINITY.copysign(excess)
    }
}

/// The difference of two rates on the same scenarios.
pub fn paired(pairs: Pairs, confidence: Confidence) -> ScoreDifference {
    let n = pairs.n();
    if n == 0 {
        return ScoreDifference::NONE;
    }
    let (b, c) = (pairs.first_only, pairs.second_only);
    let estimate = (b as f64 - c as f64) / n as f64;
    let swapped = Pairs { first_only: c, second_only: b, ..pairs };
    let exact = n <= EXACT_PAIRS;
    // ln p of "the difference is at least d": small if the second is better.
    let at_least = |pairs: Pairs, d: f64, side: Side| -> f64 {
        let d = d.clamp(0.0, 1.0 - 1e-9);
        if exact {
            return largest_tail_on(pairs, d, side, GRID);
        }
        let z = statistic(pairs.first_only, pairs.second_only, n, d);
        normal::ln_sf(if side == Side::Better { z } else { -z })
    };
    let below = |d: f64| if d >= 0.0 { at_least(pairs, d, Side::Better) } else { at_least(swapped, -d, Side::Worse) };
    let above = |d: f64| if d >= 0.0 { at_least(pairs, d, Side::Worse) } else { at_least(swapped, -d, Side::Better) };
    ScoreDifference::invert(estimate, confidence, above, below)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn t(k: u64, n: u64) -> Trials {
        Trials::new(k, n).unwrap()
    }

    fn agrees(found: ScoreDifference, confidence: Confidence) {
        let significant = found.ln_p <= (1.0 - confidence.level()).ln();
        let excludes = found.interval.low > 0.0 || found.interval.high < 0.0;
        assert_eq!(significant, excludes, "{found:?}");
    }

    #[test]
    fn interval_and_p_value_agree() {
        for (x, n, y, m) in
            [(31, 50, 12, 47), (50, 50, 49, 50), (9, 9, 5, 5), (0, 30, 4, 30), (20, 40, 20, 40), (0, 4, 4, 4)]
        {
            agrees(independent(t(x, n), t(y, m), Confidence::P95), Confidence::P95);
        }
        for n in [20, 68, 2_000] {
            for b in 0..9 {
                for c in [0, 1, 4] {
                    let pairs = Pairs { both: n - b - c, first_only: b, second_only: c, neither: 0 };
                    agrees(paired(pairs, Confidence::P95), Confidence::P95);
                }
            }
        }
    }

    #[test]
    fn swapping_mirrors_the_result() {
        let (a, b) =
            (independent(t(31, 50), t(12, 47), Confidence::P95), independent(t(12, 47), t(31, 50), Confidence::P95));
        assert!((a.interval.low + b.interval.high).abs() < 1e-5 && (a.ln_p - b.ln_p).abs() < 1e-9);
        let pairs = Pairs { both: 50, first_only: 9, second_only: 2, neither: 7 };
        let swapped = Pairs { first_only: 2, second_only: 9, ..pairs };
        let (a, b) = (paired(pairs, Confidence::P95), paired(swapped, Confidence::P95));
        assert!((a.interval.low + b.interval.high).abs() < 1e-5 && (a.ln_p - b.ln_p).abs() < 1e-9, "{a:?} {b:?}");
    }

    #[test]
    fn a_tie_is_centred() {
        let tie = paired(Pairs { both: 60, first_only: 4, second_only: 4, neither: 0 }, Confidence::P95);
        assert_eq!((tie.estimate, tie.ln_p), (Some(0.0), 0.0));
        assert!((tie.interval.low + tie.interval.high).abs() < 1e-4, "{tie:?}");
    }

    #[test]
    fn no_trials_have_no_difference() {
        assert_eq!(independent(Trials::NONE, t(1, 2), Confidence::P95), ScoreDifference::NONE);
        assert_eq!(paired(Pairs::default(), Confidence::P95), ScoreDifference::NONE);
    }
}
