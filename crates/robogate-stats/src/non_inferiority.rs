//! Non-inferiority test: whether B may replace A. Both ran the same scenarios, and B may be worse by less than a margin
//! δ.
//!
//! Of n pairs, c succeeded only with B and b only with A. Tango's score statistic tests "p_B - p_A ≤ -δ"
//!
//! ```text
//! Z = (c - b + nδ) / sqrt(n (2q - δ(1+δ)))
//! 2n q² + (-b - c - (2n - c + b)δ) q + bδ(1+δ) = 0     (larger root)
//! ```
//!
//! where q is the most likely probability of "A only" if B is worse by exactly δ. Its normal p-value ([`tango`]) is an
//! approximation. With few discordant pairs its true level can exceed the nominal one. [`exact`] orders the tables by
//! the same statistic and takes the largest probability, over every q, of a table at least as extreme. Its level holds
//! for every n.
//!
//! Limit: pairs are independent and identically distributed. The nuisance parameter q is searched on a grid of 400
//! points with a refinement around the largest value.
//! Sources: Tango (1998), Statistics in Medicine 17, 891-908; Hsueh, Liu and Chen (2001), Biometrics 57, 478-483 (exact,
//! unconditional, and why the boundary of the hypothesis is enough).

use crate::compare::{Pairs, at_least, at_most};
use crate::interval::Trials;
use robogate_maths::{beta::ln_binomial_pmf, normal};

/// A margin that is out of range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the margin {margin} is out of range. Expected a number in (0, 1). Hint: write 5 percentage points as 0.05")]
pub struct NotAMargin {
    /// The margin, as given.
    pub margin: f64,
}

/// Checks the margin.
///
/// # Errors
/// [`NotAMargin`] unless 0 < `margin` < 1.
pub fn check(margin: f64) -> Result<f64, NotAMargin> {
    if margin > 0.0 && margin < 1.0 { Ok(margin) } else { Err(NotAMargin { margin }) }
}

/// The score statistic of [`tango`]. Large if the second is not worse by `margin`.
pub(crate) fn statistic(first_only: u64, second_only: u64, n: u64, margin: f64) -> f64 {
    let (b, c, n, d) = (first_only as f64, second_only as f64, n as f64, margin);
    let linear = -b - c - (2.0 * n - c + b) * d;
    let constant = b * d * (1.0 + d);
    let root = (linear * linear - 8.0 * n * constant).max(0.0).sqrt();
    let q = (root - linear) / (4.0 * n);
    let variance = n * (2.0 * q - d * (1.0 + d));
    let excess = c - b + n * d;
    if variance > 0.0 {
        excess / variance.sqrt()
    } else if excess > 0.0 {
        f64::INFINITY
    } else if excess < 0.0 {
        f64::NEG_INFINITY
    } else {
        0.0
    }
}

/// ln of Tango's approximate one-sided p-value for the hypothesis "the second is worse than the first by `margin` or
/// more". 0 (p = 1) without pairs.
///
/// # Errors
/// [`NotAMargin`] unless 0 < `margin` < 1.
pub fn tango(pairs: Pairs, margin: f64) -> Result<f64, NotAMargin> {
    let margin = check(margin)?;
    if pairs.n() == 0 {
        return Ok(0.0);
    }
    Ok(normal::ln_sf(statistic(pairs.first_only, pairs.second_only, pairs.n(), margin)))
}

/// ln of the exact p-value for the hypothesis of [`tango`]. 0 (p = 1) without pairs.
///
/// # Errors
/// [`NotAMargin`] unless 0 < `margin` < 1.
pub fn exact(pairs: Pairs, margin: f64) -> Result<f64, NotAMargin> {
    largest_tail(pairs, margin, Side::Better)
}

/// ln of the exact p-value for the hypothesis "the second is worse than the first by at most `margin`". Small if it is
/// significantly worse by more. 0 (p = 1) without pairs.
///
/// # Errors
/// [`NotAMargin`] unless 0 < `margin` < 1.
pub fn exact_worse(pairs: Pairs, margin: f64) -> Result<f64, NotAMargin> {
    largest_tail(pairs, margin, Side::Worse)
}

/// The tables that are at least as extreme as the observed one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// Tables with a statistic at least as large.
    Better,
    /// Tables with a statistic at most as large.
    Worse,
}

fn largest_tail(pairs: Pairs, margin: f64, side: Side) -> Result<f64, NotAMargin> {
    check(margin).map(|margin| largest_tail_on(pairs, margin, side, 400))
}

/// ln of the largest probability of a table at least as extreme, searched on `grid` points. `margin` is in [0, 1).
pub(crate) fn largest_tail_on(pairs: Pairs, margin: f64, side: Side, grid: u32) -> f64 {
    let n = pairs.n();
    // If the rates are equal and no pair differs, every table is at least as extreme.
    if n == 0 || (margin <= 0.0 && pairs.first_only + pairs.second_only == 0) {
        return 0.0;
    }
    let seen = statistic(pairs.first_only, pairs.second_only, n, margin);
    let least = thresholds(n, margin, seen, side);
    // "A only" has probability q, "B only" q - margin. Both and their sum must be probabilities.
    let (low, high) = (margin.max(1e-12), 0.5 * (1.0 + margin));
    let at = |q: f64| tail(&least, n, q, margin, side);
    let step = (high - low) / f64::from(grid);
    let (mut best, mut most) = (low, 0.0);
    for i in 0..=grid {
        let q = low + f64::from(i) * step;
        let p = at(q);
        if p > most {
            (best, most) = (q, p);
        }
    }
    let mut width = step;
    for _ in 0..12 {
        width *= 0.5;
        for q in [best - width, best + width] {
            let p = if q < low || q > high { 0.0 } else { at(q) };
            if p > most {
                (best, most) = (q, p);
            }
        }
    }
    most.min(1.0).ln()
}

/// For each number of "first only", the smallest "second only" whose statistic is at least `seen`, or above it for the
/// lower tail.
fn thresholds(n: u64, margin: f64, seen: f64, side: Side) -> Vec<u64> {
    // The tolerance prevents rounding from excluding the observed table from its tail.
    let slack = 1e-10 * (1.0 + seen.abs());
    let wanted = if side == Side::Better { seen - slack } else { seen + slack };
    (0..=n)
        .map(|b| {
            let (mut below, mut reached) = (0, n - b + 1);
            // The statistic increases with the number of "second only".
            while below < reached {
                let c = below + (reached - below) / 2;
                if statistic(b, c, n, margin) >= wanted { reached = c } else { below = c + 1 }
            }
            reached
        })
        .collect()
}

/// Probability of a table at least as extreme, if "first only" has probability `q`.
fn tail(least: &[u64], n: u64, q: f64, margin: f64, side: Side) -> f64 {
    let other = (q - margin).max(0.0);
    let mut sum = 0.0;
    for (b, &c) in (0..=n).zip(least) {
        let mass = if q >= 1.0 { f64::from(u8::from(b == n)) } else { ln_binomial_pmf(b as f64, n as f64, q).exp() };
        if mass < 1e-18 {
            continue;
        }
        let share = if q >= 1.0 { 0.0 } else { (other / (1.0 - q)).min(1.0) };
        let trials = |k: u64| Trials::new(k, n - b).unwrap_or(Trials::NONE);
        let rest = match side {
            Side::Better if c > n - b => 0.0,
            Side::Better => at_least(trials(c), share).exp(),
            Side::Worse if c == 0 => 0.0,
            Side::Worse => at_most(trials(c - 1), share).exp(),
        };
        sum += mass * rest;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(both: u64, first_only: u64, second_only: u64, neither: u64) -> Pairs {
        Pairs { both, first_only, second_only, neither }
    }

    #[test]
    fn no_pairs_show_nothing() {
        assert_eq!((tango(Pairs::default(), 0.05), exact(Pairs::default(), 0.05)), (Ok(0.0), Ok(0.0)));
    }

    #[test]
    fn margin_must_be_a_fraction() {
        for margin in [0.0, 1.0, -0.1, 5.0, f64::NAN] {
            assert!(exact(pairs(9, 1, 1, 0), margin).is_err());
        }
    }

    #[test]
    fn full_agreement_needs_59_pairs() {
        // With a margin of 0.05: if "A only" has probability 0.05, n pairs without one have probability 0.95^n.
        let p = |n: u64| exact(pairs(n, 0, 0, 0), 0.05).unwrap().exp();
        assert!((p(59) - 0.95_f64.powi(59)).abs() < 1e-9 && p(59) <= 0.05 && p(58) > 0.05, "{}", p(59));
    }

    #[test]
    fn table_never_shows_both() {
        for (b, c) in [(0, 0), (3, 1), (20, 0), (0, 20), (12, 10)] {
            let pairs = pairs(60 - b - c, b, c, 0);
            let (better, worse) = (exact(pairs, 0.05).unwrap().exp(), exact_worse(pairs, 0.05).unwrap().exp());
            assert!(better + worse >= 1.0, "{b} {c}: {better} {worse}");
        }
        assert!(exact_worse(pairs(40, 20, 0, 0), 0.05).unwrap().exp() < 1e-3);
    }

    #[test]
    fn exact_test_keeps_its_level() {
        let (n, margin) = (40_u64, 0.1);
        let mut rejected = Vec::new();
        for b in 0..=n {
            for c in 0..=n - b {
                if exact(pairs(n - b - c, b, c, 0), margin).unwrap().exp() <= 0.05 {
                    rejected.push((b, c));
                }
            }
        }
        let ln_factorial = |k: u64| (1..=k).map(|i| (i as f64).ln()).sum::<f64>();
        for i in 0..60 {
            let q = 0.1 + 0.45 * (f64::from(i) + 0.37) / 60.0;
            let other = q - margin;
            let chance: f64 = rejected
                .iter()
                .map(|&(b, c)| {
                    let rest = n - b - c;
                    (ln_factorial(n) - ln_factorial(b) - ln_factorial(c) - ln_factorial(rest)).exp()
                        * q.powi(b as i32)
                        * other.powi(c as i32)
                        * (1.0 - q - other).powi(rest as i32)
                })
                .sum();
            assert!(chance <= 0.0501, "q {q}: {chance}");
        }
    }
}
