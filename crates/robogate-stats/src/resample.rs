//! Bootstrap on counts, and percentile intervals.
//!
//! Resampling n rows with replacement changes a statistic of binned data only through the cell counts, and these are
//! multinomial with the observed shares. Sampling the counts directly is the same bootstrap at a cost independent of n.
//! Each count is a conditional binomial, sampled by inversion from zero or outward from the mode. Sources: Efron and
//! Tibshirani (1993), chapters 6 and 13; Devroye (1986), X.4, for inversion from the mode.

use crate::interval::Confidence;
use rand_chacha::ChaCha8Rng;
use rand_core::Rng;
use robogate_maths::beta::ln_binomial_pmf;
use robogate_maths::gamma::ln_gamma;

/// Draws a uniform number in [0, 1) with 53 bits.
pub(crate) fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// Draws a binomial count.
pub(crate) fn binomial(rng: &mut ChaCha8Rng, n: u64, p: f64) -> u64 {
    if n == 0 || p <= 0.0 {
        return 0;
    }
    if p >= 1.0 {
        return n;
    }
    if p > 0.5 {
        return n - binomial(rng, n, 1.0 - p);
    }
    let size = n as f64;
    let odds = p / (1.0 - p);
    let mut u = uniform(rng);
    if size * p < 30.0 {
        let mut mass = (size * (-p).ln_1p()).exp();
        let mut k = 0;
        while u >= mass && k < n {
            u -= mass;
            mass *= (size - k as f64) / (k as f64 + 1.0) * odds;
            k += 1;
        }
        return k;
    }
    let mode = ((size + 1.0) * p).floor();
    let at_mode = ln_binomial_pmf(mode, size, p).exp();
    let (mut up, mut down) = (mode, mode);
    let (mut up_mass, mut down_mass) = (at_mode, at_mode);
    if u < at_mode {
        return mode as u64;
    }
    u -= at_mode;
    loop {
        let mut moved = false;
        if up < size {
            up_mass *= (size - up) / (up + 1.0) * odds;
            up += 1.0;
            moved = up_mass > 0.0;
            if u < up_mass {
                return up as u64;
            }
            u -= up_mass;
        }
        if down > 0.0 {
            down_mass *= down / ((size - down + 1.0) * odds);
            down -= 1.0;
            moved |= down_mass > 0.0;
            if u < down_mass {
                return down as u64;
            }
            u -= down_mass;
        }
        if !moved {
            // Reached only if rounding leaves a remainder after every mass has underflowed.
            return mode as u64;
        }
    }
}

/// Draws the number of successes among `draws` rows that are taken without replacement from `population` rows with
/// `successes` successes. By inversion outward from the mode.
pub(crate) fn hypergeometric(rng: &mut ChaCha8Rng, population: u64, successes: u64, draws: u64) -> u64 {
    let least = (draws + successes).saturating_sub(population);
    let most = draws.min(successes);
    if least >= most {
        return most;
    }
    let (all, good, taken) = (population as f64, successes as f64, draws as f64);
    let mode = (((taken + 1.0) * (good + 1.0) / (all + 2.0)).floor()).clamp(least as f64, most as f64);
    let ln_choose = |n: f64, k: f64| ln_gamma(n + 1.0) - ln_gamma(k + 1.0) - ln_gamma(n - k + 1.0);
    let at_mode = (ln_choose(good, mode) + ln_choose(all - good, taken - mode) - ln_choose(all, taken)).exp();
    let mut u = uniform(rng);
    if u < at_mode {
        return mode as u64;
    }
    u -= at_mode;
    let (mut up, mut down) = (mode, mode);
    let (mut up_mass, mut down_mass) = (at_mode, at_mode);
    loop {
        let mut moved = false;
        if up < most as f64 {
            up_mass *= (good - up) * (taken - up) / ((up + 1.0) * (all - good - taken + up + 1.0));
            up += 1.0;
            moved = up_mass > 0.0;
            if u < up_mass {
                return up as u64;
            }
            u -= up_mass;
        }
        if down > least as f64 {
            down_mass *= down * (all - good - taken + down) / ((good - down + 1.0) * (taken - down + 1.0));
            down -= 1.0;
            moved |= down_mass > 0.0;
            if u < down_mass {
                return down as u64;
            }
            u -= down_mass;
        }
        if !moved {
            // Reached only if rounding leaves a remainder after every mass has underflowed.
            return mode as u64;
        }
    }
}

/// Shuffles a list (Fisher and Yates).
pub(crate) fn shuffle<T>(rng: &mut ChaCha8Rng, list: &mut [T]) {
    for last in (1..list.len()).rev() {
        list.swap(last, (uniform(rng) * (last + 1) as f64) as usize);
    }
}

/// Fills `drawn` with multinomial counts that have the total and the shares of `observed`.
pub(crate) fn multinomial(rng: &mut ChaCha8Rng, observed: &[u64], drawn: &mut [u64]) {
    let mut left_observed: u64 = observed.iter().sum();
    let mut left = left_observed;
    for (o, d) in observed.iter().zip(drawn) {
        if left == 0 || *o == 0 {
            *d = 0;
            continue;
        }
        *d = binomial(rng, left, *o as f64 / left_observed as f64);
        left -= *d;
        left_observed -= o;
    }
}

/// Percentile interval of bootstrap replicates, by linear interpolation between order statistics (numpy's default).
///
/// Replicates may be infinite ("beyond the range"); an end next to an infinite replicate is infinite. The function
/// sorts its input. `None` without replicates or if one is NaN.
pub fn percentile_ends(replicates: &mut [f64], confidence: Confidence) -> Option<(f64, f64)> {
    if replicates.is_empty() || replicates.iter().any(|r| r.is_nan()) {
        return None;
    }
    replicates.sort_unstable_by(f64::total_cmp);
    let tail = confidence.tail();
    Some((quantile(replicates, tail), quantile(replicates, 1.0 - tail)))
}

/// A quantile of sorted values. There must be at least one value.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let h = (sorted.len() - 1) as f64 * q;
    let i = h.floor() as usize;
    let (a, b) = (sorted[i], sorted[(i + 1).min(sorted.len() - 1)]);
    let part = h - h.floor();
    if part <= 0.0 || a.is_infinite() {
        a
    } else if b.is_infinite() {
        b
    } else {
        a + part * (b - a)
    }
}

/// Standard deviation of replicates (divisor n - 1), which is the bootstrap standard error. `None` for fewer than two
/// replicates, or if one is not finite.
pub fn standard_error(replicates: &[f64]) -> Option<f64> {
    let n = replicates.len() as f64;
    if replicates.len() < 2 || replicates.iter().any(|r| !r.is_finite()) {
        return None;
    }
    let mean = replicates.iter().sum::<f64>() / n;
    Some((replicates.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_core::SeedableRng;

    #[test]
    fn binomial_moments_are_correct() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (n, p) in [(7, 0.3), (10_000, 0.002), (10_000, 0.4), (500, 0.93), (1_000_000, 0.5)] {
            let draws: Vec<f64> = (0..20_000).map(|_| binomial(&mut rng, n, p) as f64).collect();
            let mean = draws.iter().sum::<f64>() / 20_000.0;
            let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 20_000.0;
            let (m, v) = (n as f64 * p, n as f64 * p * (1.0 - p));
            assert!((mean - m).abs() < 5.0 * (v / 20_000.0).sqrt(), "n {n} p {p}: mean {mean}");
            assert!((variance / v - 1.0).abs() < 0.06, "n {n} p {p}: variance {variance} of {v}");
        }
    }

    #[test]
    fn binomial_fits_exact_probabilities() {
        // Chi-squared over k = 90..=150 of Binomial(400, 0.3).
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut counts = [0.0_f64; 401];
        for _ in 0..100_000 {
            counts[binomial(&mut rng, 400, 0.3) as usize] += 1.0;
        }
        let mut statistic = 0.0;
        for k in 90..=150 {
            let expected = 100_000.0 * ln_binomial_pmf(f64::from(k), 400.0, 0.3).exp();
            statistic += (counts[k as usize] - expected).powi(2) / expected;
        }
        assert!(statistic < 110.0, "chi-squared {statistic} on 61 cells");
    }

    #[test]
    fn hypergeometric_moments_are_correct() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for (all, good, taken) in [(20, 5, 8), (1_000, 990, 50), (10_000, 100, 500), (1_000_000, 500_000, 50_000)] {
            let draws: Vec<f64> = (0..20_000).map(|_| hypergeometric(&mut rng, all, good, taken) as f64).collect();
            let mean = draws.iter().sum::<f64>() / 20_000.0;
            let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 20_000.0;
            let (n, p, m) = (all as f64, good as f64 / all as f64, taken as f64);
            let v = m * p * (1.0 - p) * (n - m) / (n - 1.0);
            assert!((mean - m * p).abs() < 5.0 * (v / 20_000.0).sqrt(), "{all} {good} {taken}: mean {mean}");
            assert!((variance / v - 1.0).abs() < 0.06, "{all} {good} {taken}: variance {variance} of {v}");
        }
        assert_eq!(hypergeometric(&mut rng, 10, 10, 4), 4);
        assert_eq!(hypergeometric(&mut rng, 10, 0, 4), 0);
        assert_eq!(hypergeometric(&mut rng, 10, 3, 10), 3);
    }

    #[test]
    fn multinomial_keeps_total_and_empty_cells() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let observed = [0, 10, 0, 90, 400, 0];
        let mut drawn = [0; 6];
        for _ in 0..100 {
            multinomial(&mut rng, &observed, &mut drawn);
            assert_eq!(drawn.iter().sum::<u64>(), 500);
            assert_eq!((drawn[0], drawn[2], drawn[5]), (0, 0, 0));
        }
    }

    #[test]
    fn infinite_replicates_give_infinite_end() {
        let mut r = vec![f64::NEG_INFINITY; 10];
        r.extend((0..90).map(f64::from));
        let (low, high) = percentile_ends(&mut r, Confidence::P95).unwrap();
        assert!(low.is_infinite() && high.is_finite());
        assert_eq!(standard_error(&r), None);
    }
}
