//! The difference of two success rates: an interval and a p-value that come from one test and therefore agree.
//!
//! The interval contains exactly the differences d that the test of "p₁ - p₂ = d" does not reject, and the p-value is
//! that of d = 0. The interval excludes 0 if and only if p is at most one minus its level.
//!
//! - [`independent`]: the score statistic of Miettinen and Nurminen orders the tables. It is (p̂₁ - p̂₂ - d) / sqrt(V),
//!   where V uses the most likely rates that differ by d, with the factor N/(N-1). If the smaller sample has at most
//!   [`EXACT_TRIALS`] trials, the p-value is the exact unconditional one of Chan and Zhang: the largest probability, over
//!   all pairs of rates that differ by d, of a table at least as extreme. With more trials it is the normal one
//!   ([`independent_normal`]).
//! - [`paired`]: the same scenarios under both conditions. Tango's score statistic orders the tables. With up to
//!   [`EXACT_PAIRS`] pairs the p-value is the exact unconditional one, as in [`crate::non_inferiority`]; above that it is
//!   the normal one.
//!
//! Exact means that the error of each one-sided test is at most its level for all rates. For very unequal samples it is
//! much smaller near a rate of 0 or 1, because the least favourable rate decides. The smallest exact p-value of independent
//! samples is 1e-100.
//!
//! Limit: trials (pairs) are independent. The unknown rate is searched on a grid with refinements. The normal p-values
//! are approximations. With pairs, their error is below 0.01 in the simulations of `tests/comparison_power.rs`. With
//! independent samples it grows with the ratio of the sizes: against a much larger sample, an error of 5 % becomes up to
//! 16 % where the smaller sample has less than one expected failure (or success), and 7 % where it has two.
//!
//! Sources: Miettinen and Nurminen (1985), Statistics in Medicine 4, 213-226; Chan and Zhang (1999), Biometrics 55,
//! 1202-1209; Tango (1998), Statistics in Medicine 17, 891-908.

use std::f64::consts::FRAC_PI_2;

use robogate_maths::{beta::ln_binomial_pmf, normal};

use crate::compare::Pairs;
use crate::interval::{Confidence, Interval, Trials};
use crate::non_inferiority::{Side, largest_tail_on, statistic};

/// Largest number of pairs for which the paired test is exact. The search over the unknown rate takes longer above.
pub const EXACT_PAIRS: u64 = 300;

/// Largest number of trials in the smaller of two independent samples for which their test is exact. The time grows with
/// it, and with the square root of the larger number.
pub const EXACT_TRIALS: u64 = 200;

/// Points of the search over the unknown rate of the exact tests.
const GRID: u32 = 60;
/// Smallest p-value of the exact test of independent samples.
const LEAST_P: f64 = 1e-100;

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
    if first.n().min(second.n()) > EXACT_TRIALS {
        return independent_normal(first, second, confidence);
    }
    let (Some(p1), Some(p2)) = (first.rate(), second.rate()) else { return ScoreDifference::NONE };
    // One function for both directions: swapped samples mirror the result exactly.
    let above = |d: f64| largest_tail(first, second, d);
    let below = |d: f64| largest_tail(second, first, -d);
    ScoreDifference::invert(p1 - p2, confidence, above, below)
}

/// The same with the normal approximation for any number of trials.
pub fn independent_normal(first: Trials, second: Trials, confidence: Confidence) -> ScoreDifference {
    let (Some(p1), Some(p2)) = (first.rate(), second.rate()) else { return ScoreDifference::NONE };
    let sizes = [first.n() as f64, second.n() as f64];
    let z = |d: f64| miettinen_nurminen([first.successes() as f64, second.successes() as f64], sizes, d);
    ScoreDifference::invert(p1 - p2, confidence, |d| normal::ln_sf(z(d)), |d| normal::ln_sf(-z(d)))
}

/// The statistic of "p₁ - p₂ = d" for these successes and trials. Large if the difference is above d.
fn miettinen_nurminen(successes: [f64; 2], trials: [f64; 2], d: f64) -> f64 {
    let [p1, p2] = most_likely(successes, trials, d);
    let ([x1, x2], [n1, n2]) = (successes, trials);
    let n = n1 + n2;
    let variance = (p1 * (1.0 - p1) / n1 + p2 * (1.0 - p2) / n2) * n / (n - 1.0).max(1.0);
    ratio(x1 / n1 - x2 / n2 - d, variance)
}

/// The most likely rates that differ by `d`.
fn most_likely([x1, x2]: [f64; 2], [n1, n2]: [f64; 2], d: f64) -> [f64; 2] {
    let n = n1 + n2;
    if d.abs() <= 0.0 {
        return [(x1 + x2) / n; 2];
    }
    // The cubic equation of the most likely p₂ if p₁ = p₂ + d (Miettinen and Nurminen, appendix 1).
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
    let mut second = 2.0 * p * angle.cos() - third;
    // The cosine of an angle near 0 loses half of the digits, and equally extreme tables must have equal statistics.
    for _ in 0..2 {
        let value = ((l3 * second + l2) * second + l1) * second + l0;
        let slope = (3.0 * l3 * second + 2.0 * l2) * second + l1;
        if slope.abs() > 0.0 {
            second -= (value / slope).clamp(-1e-6, 1e-6);
        }
    }
    let second = second.clamp(0.0_f64.max(-d), 1.0_f64.min(1.0 - d));
    [(second + d).clamp(0.0, 1.0), second]
}

/// ln of the largest probability, over all pairs of rates with "p₁ - p₂ = d", of a statistic at least as large as the
/// observed one. Small if the difference is above d.
fn largest_tail(first: Trials, second: Trials, d: f64) -> f64 {
    let failed = |of: Trials| Trials::new(of.failures(), of.n()).unwrap_or(Trials::NONE);
    // The smaller sample comes first. If this exchanges the samples, failures are counted: 1 - p₂ - (1 - p₁) is d, too.
    let (small, large) = if first.n() <= second.n() { (first, second) } else { (failed(second), failed(first)) };
    // Differences of -1 and 1 leave a single pair of rates. The search needs a range.
    let d = d.clamp(1e-9 - 1.0, 1.0 - 1e-9);
    let ends = ends_of_tail(small, large, d);
    // Only the p-value of equal rates is reported, so it needs all its digits. The others are compared with the level.
    let least = if d.abs() <= 0.0 { LEAST_P } else { 1e-16 };
    let tail = |rate: f64| {
        let (first, masses) = binomial_masses(large.n(), rate, least);
        let sums = masses.iter().scan(0.0_f64, |sum, mass| {
            *sum += mass;
            Some(*sum)
        });
        let below: Vec<f64> = std::iter::once(0.0).chain(sums).collect();
        let (from, masses) = binomial_masses(small.n(), rate + d, least);
        let of = |(mass, end): (&f64, &usize)| mass * below[end.saturating_sub(first).min(below.len() - 1)];
        masses.iter().zip(&ends[from..]).map(of).sum::<f64>()
    };
    // The rate of the larger sample by an angle: rates near both ends of the range are close to each other.
    let (low, high) = ((-d).max(0.0), (1.0 - d).min(1.0));
    let rate = |angle: f64| low + (high - low) * angle.sin().powi(2);
    let angle = |rate: f64| ((rate - low) / (high - low)).clamp(0.0, 1.0).sqrt().asin();
    let grid = (0..=GRID).map(|i| FRAC_PI_2 * f64::from(i) / f64::from(GRID));
    let sizes = [small.n() as f64, large.n() as f64];
    let [_, likely] = most_likely([small.successes() as f64, large.successes() as f64], sizes, d);
    // In a much larger sample the probability is a saw-tooth function of the rate: it falls steeply where one more count
    // of the smaller sample leaves the tail. It is large two standard deviations before.
    let before = |end: usize| {
        let centre = (end as f64 - 0.5) / sizes[1];
        (centre.sqrt().asin() - 1.0 / sizes[1].sqrt()).max(0.0).sin().powi(2)
    };
    let mut teeth: Vec<usize> = ends.iter().copied().filter(|end| (1..=large.n() as usize).contains(end)).collect();
    teeth.dedup();
    let special = teeth.into_iter().map(before).chain([likely]).filter(|rate| (low..=high).contains(rate)).map(angle);
    let at = |angle: f64| (angle, tail(rate(angle)));
    let larger = |a: (f64, f64), b: (f64, f64)| if b.1 > a.1 { b } else { a };
    let mut best = grid.chain(special).map(at).fold((0.0, 0.0), larger);
    let mut step = FRAC_PI_2 / f64::from(GRID);
    for _ in 0..10 {
        step *= 0.5;
        let sides = [best.0 - step, best.0 + step].map(|angle| at(angle.clamp(0.0, FRAC_PI_2)));
        best = sides.into_iter().fold(best, larger);
    }
    best.1.clamp(LEAST_P, 1.0).ln()
}

/// For each number of successes of the smaller sample, the number of counts of the larger one (0, 1, ...) whose statistic
/// is at least as large as the observed one.
fn ends_of_tail(small: Trials, large: Trials, d: f64) -> Vec<usize> {
    let statistic = |x: u64, y: u64| miettinen_nurminen([x as f64, y as f64], [small.n() as f64, large.n() as f64], d);
    let seen = statistic(small.successes(), large.successes());
    // The tolerance prevents rounding from excluding tables that are as extreme as the observed one.
    let wanted = seen - 1e-8 * (1.0 + seen.abs().min(1e6));
    let mut end = 0;
    let next = |x: u64| {
        // The statistic increases with the first count and decreases with the second one.
        let mut above = large.n() + 1;
        while end < above {
            let y = end + (above - end) / 2;
            if statistic(x, y) >= wanted { end = y + 1 } else { above = y }
        }
        end as usize
    };
    (0..=small.n()).map(next).collect()
}

/// The probabilities of neighbouring counts of a binomial sample, and the first of these counts. Counts with a
/// probability below `least` are left out.
fn binomial_masses(n: u64, rate: f64, least: f64) -> (usize, Vec<f64>) {
    if rate <= 0.0 {
        return (0, vec![1.0]);
    }
    if rate >= 1.0 {
        return (n as usize, vec![1.0]);
    }
    let size = n as f64;
    let mode = ((size + 1.0) * rate).floor().min(size);
    let odds = rate / (1.0 - rate);
    let start = (mode, ln_binomial_pmf(mode, size, rate).exp());
    // The ratios do not wait for the previous mass.
    let down = |(k, mass): &(f64, f64)| (*k > 0.0).then(|| (k - 1.0, mass * (k / ((size - k + 1.0) * odds))));
    let up = |(k, mass): &(f64, f64)| (*k < size).then(|| (k + 1.0, mass * ((size - k) / (k + 1.0) * odds)));
    let kept = |(_, mass): &(f64, f64)| *mass >= least;
    let mut masses: Vec<f64> =
        std::iter::successors(Some(start), down).take_while(kept).map(|(_, mass)| mass).collect();
    let first = mode as usize + 1 - masses.len().max(1);
    masses.reverse();
    masses.extend(std::iter::successors(Some(start), up).skip(1).take_while(kept).map(|(_, mass)| mass));
    (first, masses)
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
        for (x, n, y, m) in [
            (31, 50, 12, 47),
            (50, 50, 49, 50),
            (9, 9, 5, 5),
            (0, 30, 4, 30),
            (20, 40, 20, 40),
            (0, 4, 4, 4),
            (1, 1, 0, 1),
            (17, 20, 9_900, 10_000),
            (60, 200, 201, 400),
            (250, 300, 200, 300),
        ] {
            agrees(independent(t(x, n), t(y, m), Confidence::P95), Confidence::P95);
            agrees(independent_normal(t(x, n), t(y, m), Confidence::P95), Confidence::P95);
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
        for (one, two) in [(t(31, 50), t(12, 47)), (t(9, 12), t(4, 12)), (t(7, 12), t(7, 12)), (t(0, 3), t(400, 400))] {
            let (a, b) = (independent(one, two, Confidence::P95), independent(two, one, Confidence::P95));
            assert_eq!((a.interval.low, a.interval.high, a.ln_p), (-b.interval.high, -b.interval.low, b.ln_p));
        }
        let (one, two) = (t(310, 500), t(120, 470));
        let (a, b) = (independent(one, two, Confidence::P95), independent(two, one, Confidence::P95));
        assert!((a.interval.low + b.interval.high).abs() < 1e-5 && (a.ln_p - b.ln_p).abs() < 1e-9);
        let pairs = Pairs { both: 50, first_only: 9, second_only: 2, neither: 7 };
        let swapped = Pairs { first_only: 2, second_only: 9, ..pairs };
        let (a, b) = (paired(pairs, Confidence::P95), paired(swapped, Confidence::P95));
        assert!((a.interval.low + b.interval.high).abs() < 1e-5 && (a.ln_p - b.ln_p).abs() < 1e-9, "{a:?} {b:?}");
    }

    /// The largest probability of a table at least as extreme, by all tables at each of many rates.
    fn by_all_tables([x, n]: [u64; 2], [y, m]: [u64; 2], d: f64) -> f64 {
        let sizes = [n as f64, m as f64];
        let statistic = |i: u64, j: u64| miettinen_nurminen([i as f64, j as f64], sizes, d);
        let wanted = statistic(x, y) - 1e-8;
        let all = (0..=n).flat_map(|i| (0..=m).map(move |j| (i, j)));
        let extreme: Vec<(u64, u64)> = all.filter(|(i, j)| statistic(*i, *j) >= wanted).collect();
        let masses = |n: u64, p: f64| -> Vec<f64> {
            let choose = |k: u64| (0..k).map(|i| (n - i) as f64 / (k - i) as f64).product::<f64>();
            (0..=n).map(|k| choose(k) * p.powi(k as i32) * (1.0 - p).max(0.0).powi((n - k) as i32)).collect()
        };
        let (low, high) = ((-d).max(0.0), (1.0 - d).min(1.0));
        let tail = |i: u32| {
            let p = low + (high - low) * (FRAC_PI_2 * f64::from(i) / 2_000.0).sin().powi(2);
            let (a, b) = (masses(n, p + d), masses(m, p));
            extreme.iter().map(|(i, j)| a[*i as usize] * b[*j as usize]).sum::<f64>()
        };
        (0..=2_000).map(tail).fold(0.0, f64::max)
    }

    #[test]
    fn fast_tail_matches_all_tables() {
        for (x, y) in [(7, 0), (5, 3), (6, 11), (1, 10), (0, 0)] {
            for d in [-0.4, -0.05, 0.0, 0.1, 0.6] {
                let found = largest_tail(t(x, 7), t(y, 12), d).exp();
                let all = by_all_tables([x, 7], [y, 12], d);
                assert!((found / all - 1.0).abs() < 1e-4, "{x} {y} {d}: {found} {all}");
                let found = largest_tail(t(y, 12), t(x, 7), d).exp();
                let all = by_all_tables([y, 12], [x, 7], d);
                assert!((found / all - 1.0).abs() < 1e-4, "swapped, {x} {y} {d}: {found} {all}");
            }
        }
        // Only the observed table is as extreme: 2 p^7 (1 - p)^12 is largest at p = 7/19.
        let p = 7.0_f64 / 19.0;
        let found = independent(t(7, 7), t(0, 12), Confidence::P95).ln_p.exp();
        assert!((found / (2.0 * p.powi(7) * (1.0 - p).powi(12)) - 1.0).abs() < 1e-6, "{found}");
    }

    #[test]
    fn masses_are_those_of_the_distribution() {
        for (n, p) in [(1, 0.3), (20, 0.99), (10_000, 0.001), (500, 0.5)] {
            let (first, masses) = binomial_masses(n, p, 1e-16);
            assert!((masses.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            for (k, mass) in (first..).zip(&masses) {
                assert!((mass / ln_binomial_pmf(k as f64, n as f64, p).exp() - 1.0).abs() < 1e-10, "{n} {p} {k}");
            }
        }
        assert_eq!((binomial_masses(9, 0.0, 1e-16), binomial_masses(9, 1.0, 1e-16)), ((0, vec![1.0]), (9, vec![1.0])));
    }

    #[test]
    fn large_samples_are_approximated() {
        let (one, two) = (t(180, EXACT_TRIALS + 1), t(190, EXACT_TRIALS + 1));
        assert_eq!(independent(one, two, Confidence::P95), independent_normal(one, two, Confidence::P95));
        let (one, two) = (t(180, EXACT_TRIALS), t(190, EXACT_TRIALS));
        let (exact, normal) = (independent(one, two, Confidence::P95), independent_normal(one, two, Confidence::P95));
        assert!(exact != normal && (exact.interval.width() / normal.interval.width() - 1.0).abs() < 0.2, "{exact:?}");
    }

    #[test]
    fn extreme_counts_give_numbers() {
        for (x, n) in [(0, 1), (1, 1), (0, 200), (200, 200)] {
            for (y, m) in [(0, 1), (1, 1), (0, 30_000), (30_000, 30_000)] {
                let found = independent(t(x, n), t(y, m), Confidence::P95);
                let Interval { low, high } = found.interval;
                assert!(
                    -1.0 <= low && low <= high && high <= 1.0 && found.ln_p.is_finite(),
                    "{x} {n} {y} {m}: {found:?}"
                );
                assert!(found.interval.contains(found.estimate.unwrap()), "{x} {n} {y} {m}: {found:?}");
            }
        }
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
