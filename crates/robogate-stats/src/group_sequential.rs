//! Repeated tests at a known number of looks: the joint p-value of the smallest single one.
//!
//! A test statistic that sums independent results behaves like Brownian motion at the times 1, 2, ..., K of equally
//! spaced looks. If each look rejects where its own p-value is at most a constant, the probability of any rejection is
//! that of the motion crossing z √k. It is computed by integrating the density from look to look (Armitage, McPherson
//! and Rowe 1969). [`joint_p`] converts the smallest p-value of all looks so far to one that holds for all of them. The
//! run may stop at any look.
//!
//! With a known maximum, such a test stops earlier than one that is valid forever (Pocock 1977). [`paired_p`] is the
//! test of two policies on the same scenarios: at each look the score test of the difference, in its exact form for few
//! pairs. Its limits are not the same at each look but C (k/K)^(Δ - 1/2) (Wang and Tsiatis 1987). With Δ = 0.6 the first
//! looks are easier to pass than the last ones: clear cases, which are the most frequent ones, end earlier. Snyder et al.
//! 2025 ("Is your imitation learning policy better than mine? Policy comparison with near-optimal stopping", arXiv
//! 2503.10966) optimise the limits numerically for a given number of trials; one parameter is enough to come close for any
//! number of looks. The figures are in `docs/results/comparison-power.md`.
//!
//! Limit: looks are equally spaced and their maximum is fixed before the first episode. The joint distribution of the
//! looks is the asymptotic one; its error is measured by `tests/group_sequential.rs`.

use std::collections::BTreeMap;

use robogate_maths::normal;

use crate::compare::Pairs;
use crate::difference::EXACT_PAIRS;
use crate::non_inferiority::{NotAMargin, Side, check, largest_tail_on, statistic};

/// Largest number of looks that are integrated. [`paired_p`] uses more looks than this at every step of that size, and
/// [`joint_p`] adds the probability of the later ones.
pub const MOST_LOOKS: u64 = 100;
/// Distance of two points of the integration, in standard deviations of one step.
const STEP: f64 = 0.05;
/// Points of the search over the unknown rate of the exact test.
const GRID: u32 = 60;
/// Δ of the paired test. Pocock's limits have 0.5.
const SHAPE: f64 = 0.6;
/// Smallest single p-value that is distinguished from 0.
const LEAST_P: f64 = 1e-15;

/// The probability that one of `looks` equally spaced looks has a p-value of at most `p`, if the hypothesis is true. For more
/// than [`MOST_LOOKS`] looks it is slightly too large.
pub fn joint_p(p: f64, looks: u64) -> f64 {
    if p.is_nan() || p >= 0.5 {
        return 1.0;
    }
    if p <= 0.0 || looks <= 1 {
        return p.max(0.0);
    }
    let z = normal::quantile(1.0 - p);
    (crossing(z, looks.min(MOST_LOOKS), 0.5) + later_crossing(z, looks)).clamp(p, 1.0)
}

/// At most the probability that the motion first crosses z √k at one of the looks after [`MOST_LOOKS`]. The continuous motion
/// does so at the rate z φ(z) / 2 in the logarithm of time (Siegmund 1985, Sequential Analysis).
fn later_crossing(z: f64, looks: u64) -> f64 {
    // z φ(z) is largest at z = 1. Below, the limit keeps the sum monotonic.
    let z = z.max(1.0);
    0.5 * z * density(z) * (looks.max(MOST_LOOKS) as f64 / MOST_LOOKS as f64).ln()
}

/// The probability that one of `looks` equally spaced looks has a statistic of at least `limit` (k/K)^(0.6 - 1/2), if the
/// hypothesis is true. 1 for a limit of at most 0.
pub fn boundary_p(limit: f64, looks: u64) -> f64 {
    let looks = looks.clamp(1, MOST_LOOKS);
    if limit.is_nan() || limit <= 0.0 {
        return 1.0;
    }
    crossing(limit, looks, SHAPE).clamp(0.0, 1.0)
}

/// The statistic of a single p-value at look `at` of `looks`, in units of the limit of that look.
fn scaled(p: f64, at: u64, looks: u64) -> f64 {
    let part = (at as f64 / looks.max(1) as f64).min(1.0);
    normal::quantile(1.0 - p.clamp(LEAST_P, 1.0 - LEAST_P)) / part.powf(SHAPE - 0.5)
}

/// The limit at which one of `looks` looks rejects with probability `error`.
fn limit(error: f64, looks: u64) -> f64 {
    let (mut low, mut high) = (0.0, 9.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if boundary_p(middle, looks) <= error { high = middle } else { low = middle }
    }
    high
}

/// The probability that the motion crosses z (k/K)^(Δ - 1/2) √k at one of the looks k = 1, ..., K.
fn crossing(z: f64, looks: u64, shape: f64) -> f64 {
    crosses(looks, |look| z * (look as f64 / looks as f64).powf(shape - 0.5))
}

/// The probability that the motion, divided by √k, reaches `limit(k)` at one of the looks k = 1, ..., K.
pub(crate) fn crosses(looks: u64, limit: impl Fn(u64) -> f64) -> f64 {
    // Below this, a path does not return to the boundary within the remaining looks.
    let lowest = -7.0 * (looks as f64).sqrt();
    let reach = (7.0 / STEP) as i64;
    let kernel: Vec<f64> = (-reach..=reach).map(|i| density(i as f64 * STEP) * STEP).collect();
    // The density of the motion among the paths that have not crossed, at lowest + i STEP.
    let place = |x: f64| ((x - lowest) / STEP).floor() as i64;
    let mut going: Vec<f64> = Vec::new();
    let mut crossed = 0.0;
    for look in 1..=looks {
        let top = limit(look) * (look as f64).sqrt();
        let size = usize::try_from(place(top + 7.0)).unwrap_or(0) + 1;
        let mut next = vec![0.0; size];
        if look == 1 {
            for (i, density_here) in next.iter_mut().enumerate() {
                *density_here = density(lowest + i as f64 * STEP);
            }
        } else {
            for (i, mass) in going.iter().enumerate().filter(|(_, mass)| **mass > 1e-14) {
                for (j, k) in kernel.iter().enumerate() {
                    let at = i as i64 + j as i64 - reach;
                    if let Some(place) = usize::try_from(at).ok().and_then(|at| next.get_mut(at)) {
                        *place += mass * k;
                    }
                }
            }
        }
        // The point next to the boundary belongs to both sides in proportion.
        let boundary = (top - lowest) / STEP;
        for (i, mass) in next.iter_mut().enumerate() {
            let above = (i as f64 + 0.5 - boundary).clamp(0.0, 1.0);
            crossed += above * *mass * STEP;
            *mass *= 1.0 - above;
        }
        going = next;
    }
    crossed
}

/// The p-value at which a single look rejects, so that one of `looks` looks rejects with probability `error`.
pub fn single_p(error: f64, looks: u64) -> f64 {
    let (mut low, mut high) = (0.0_f64, error);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if joint_p(middle, looks) <= error { low = middle } else { high = middle }
    }
    low
}

/// The paired test with its limits computed once, for many simulated runs.
#[derive(Debug)]
pub struct PairedRun {
    margin: f64,
    looks: u64,
    /// The limits at which "not worse" and "worse" are shown.
    limits: [f64; 2],
    /// Decisions that were computed before, by look and numbers of pairs.
    known: BTreeMap<[u64; 4], [bool; 2]>,
}

impl PairedRun {
    /// The test with errors `alpha` ("not worse") and `beta` ("worse") over `looks` looks.
    ///
    /// # Errors
    /// [`NotAMargin`] unless 0 < `margin` < 1.
    pub fn new(margin: f64, looks: u64, alpha: f64, beta: f64) -> Result<Self, NotAMargin> {
        let looks = looks.clamp(1, MOST_LOOKS);
        let limits = [limit(alpha, looks), limit(beta, looks)];
        Ok(Self { margin: check(margin)?, looks, limits, known: BTreeMap::new() })
    }

    /// Whether "not worse" and "worse" are shown by look `at` (from 1) at all pairs so far.
    pub fn look(&mut self, at: u64, pairs: Pairs) -> [bool; 2] {
        let (margin, looks, limits) = (self.margin, self.looks, self.limits);
        let shown = |side, limit| scaled(single(pairs, margin, side), at, looks) >= limit;
        *self
            .known
            .entry([at, pairs.n(), pairs.first_only, pairs.second_only])
            .or_insert_with(|| [shown(Side::Better, limits[0]), shown(Side::Worse, limits[1])])
    }
}

fn density(x: f64) -> f64 {
    (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt()
}

/// p-values of both hypotheses about "the second is not worse than the first by `margin` or more", after the looks so
/// far: that it is worse (small if not worse is shown), and that it is not (small if worse is shown).
///
/// `looks` are the counts of all pairs at each look; `planned` is the largest number of looks.
///
/// # Errors
/// [`NotAMargin`] unless 0 < `margin` < 1.
pub fn paired_p(looks: &[[Pairs; 2]], planned: u64, margin: f64) -> Result<[f64; 2], NotAMargin> {
    check(margin).map(|margin| both(looks, planned, margin))
}

/// Each look has the counts with the worst and with the best outcome of unknown pairs.
fn both(looks: &[[Pairs; 2]], planned: u64, margin: f64) -> [f64; 2] {
    let planned = planned.max(looks.len() as u64);
    // Looks beyond the limit are used at equal distances.
    let every = planned.div_ceil(MOST_LOOKS).max(1);
    let used = || looks.iter().zip(1_u64..).filter(|(_, at)| at % every == 0).map(|(look, at)| (look, at / every));
    let joint = |side: Side, which: usize| {
        let at = |(look, at): (&[Pairs; 2], u64)| scaled(single(look[which], margin, side), at, planned / every);
        boundary_p(used().map(at).fold(f64::NEG_INFINITY, f64::max), planned / every)
    };
    [joint(Side::Better, 0), joint(Side::Worse, 1)]
}

fn single(pairs: Pairs, margin: f64, side: Side) -> f64 {
    if pairs.n() <= EXACT_PAIRS {
        return largest_tail_on(pairs, margin, side, GRID).exp();
    }
    let z = statistic(pairs.first_only, pairs.second_only, pairs.n(), margin);
    normal::ln_sf(if side == Side::Better { z } else { -z }).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pocock_constants_are_reproduced() {
        // One-sided errors of 0.05, 0.025 and 0.005 (Jennison and Turnbull 2000, table 2.1, two-sided 0.1, 0.05, 0.01).
        for (looks, z, error) in [
            (2, 1.875, 0.05),
            (5, 2.122, 0.05),
            (10, 2.270, 0.05),
            (20, 2.392, 0.05),
            (5, 2.413, 0.025),
            (10, 3.117, 0.005),
        ] {
            let found = joint_p(normal::ln_sf(z).exp(), looks);
            assert!((found - error).abs() < 0.02 * error + 2e-4, "{looks} looks: {found} instead of {error}");
        }
    }

    #[test]
    fn a_thousand_looks_hold_for_ten_thousand_pairs() {
        use rand_core::{Rng, SeedableRng};

        // The limits of 100 and of 1,000 looks for an error of 5 % on both sides.
        let limits = [2.875, 3.098];
        for (limit, looks) in limits.into_iter().zip([100, 1_000]) {
            let found = 2.0 * joint_p(normal::ln_sf(limit).exp(), looks);
            assert!((found - 0.05).abs() < 0.001, "{looks} looks: {found}");
        }
        // Runs that could stop after each pair, with an exact test up to 300 pairs, which the correction for continuity
        // approximates. Each pair has a difference, which is the case with most independent looks.
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let (runs, mut rejected) = (2_000, [0; 2]);
        for _ in 0..runs {
            let (mut sum, mut largest, mut bits) = (0_i64, 0.0_f64, 0);
            for n in 0..10_000_u64 {
                bits = if n.is_multiple_of(64) { rng.next_u64() } else { bits >> 1 };
                sum += if bits & 1 == 1 { 1 } else { -1 };
                let correction = if n < EXACT_PAIRS { 1.0 } else { 0.0 };
                let excess = (sum.unsigned_abs() as f64 - correction).max(0.0);
                largest = largest.max(excess * excess / (n + 1) as f64);
            }
            for (rejected, limit) in rejected.iter_mut().zip(limits) {
                *rejected += u32::from(largest >= limit * limit);
            }
        }
        // 5 % of 2,000 is 100, with a standard deviation of 10.
        assert!(rejected[0] > 130 && rejected[1] <= 125, "{rejected:?} of {runs}");
    }

    #[test]
    fn limits_rise_from_look_to_look() {
        let of = limit(0.05, 20);
        assert!((boundary_p(of, 20) - 0.05).abs() < 1e-6);
        // The first look is easier to pass than with Pocock's constant 2.392, the last one harder.
        assert!(of * (1.0 / 20.0_f64).powf(SHAPE - 0.5) < 2.1 && of > 2.7, "{of}");
        let one = normal::quantile(0.97);
        assert!((boundary_p(scaled(0.03, 1, 1), 1) - 0.03).abs() < 1e-3 && (scaled(0.03, 1, 1) - one).abs() < 1e-9);
        assert_eq!((boundary_p(-1.0, 20), boundary_p(f64::NAN, 20)), (1.0, 1.0));
        assert!(scaled(0.0, 3, 20).is_finite() && scaled(1.0, 3, 20) < 0.0);
    }

    #[test]
    fn one_look_keeps_its_p_value() {
        assert_eq!(joint_p(0.03, 1), 0.03);
        assert_eq!((joint_p(0.0, 20), joint_p(0.7, 20)), (0.0, 1.0));
        let mut last = 0.0;
        for looks in [1, 2, 5, 20, 100, 101, 1_000] {
            let found = joint_p(0.01, looks);
            assert!(found >= last && found <= 0.01 * looks as f64 + 1e-4, "{looks}: {found}");
            last = found;
        }
    }

    #[test]
    fn agreement_shows_not_worse() {
        let look = |n: u64| {
            let pairs = Pairs { both: n, ..Pairs::default() };
            [pairs, pairs]
        };
        let looks: Vec<[Pairs; 2]> = (1..=3).map(|i| look(68 * i)).collect();
        let [met, violated] = paired_p(&looks, 20, 0.05).unwrap();
        assert!(met < 0.01 && violated > 0.5, "{met} {violated}");
        assert!(paired_p(&looks, 20, 0.0).is_err());
    }
}
