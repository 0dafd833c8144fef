//! Production as a renewal process: cycles follow each other, each with a duration and a reward.
//!
//! - The long-run reward per time is E(reward) / E(duration) (renewal-reward theorem). Its interval contains the r for which the mean of
//!   reward - r x duration does not differ significantly from 0 (Fieller 1954), with Student's t.
//! - The longest run of successes among n independent cycles with success rate p is shorter than m with probability a(n), where
//!   a(i) = 1 for i < m, a(m) = 1 - p^m, and a(i) = a(i-1) - (1-p) p^m a(i-m-1) (Feller, An Introduction to Probability
//!   Theory, volume 1, XIII.7).
//!
//! Limit: cycles are independent and have one distribution.
//!
//! Sources: Ross, Introduction to Probability Models, chapter 7; Fieller (1954), JRSS B 16.

use robogate_maths::beta::student_quantile;

use crate::interval::{Confidence, Interval, Trials, clopper_pearson};

/// A long-run reward per time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RewardRate {
    /// Sum of the rewards / sum of the durations.
    pub rate: f64,
    /// Its interval. The upper end is infinite if the mean duration is not significantly above 0.
    pub interval: Interval,
}

/// The reward per time of these cycles. `None` with fewer than two cycles, unequal lengths, or a total duration that is not positive.
pub fn reward_rate(rewards: &[f64], durations: &[f64], confidence: Confidence) -> Option<RewardRate> {
    let n = durations.len() as f64;
    let (reward, time) = (rewards.iter().sum::<f64>() / n, durations.iter().sum::<f64>() / n);
    if rewards.len() != durations.len() || durations.len() < 2 || time.is_nan() || time <= 0.0 || !reward.is_finite() {
        return None;
    }
    let (mut rr, mut rt, mut tt) = (0.0, 0.0, 0.0);
    for (r, t) in rewards.iter().zip(durations) {
        let (r, t) = (r - reward, t - time);
        (rr, rt, tt) = (rr + r * r, rt + r * t, tt + t * t);
    }
    let factor = student_quantile(n - 1.0, confidence.level()).powi(2) / (n * (n - 1.0));
    // (reward - x time)² = factor (rr - 2 x rt + x² tt), a quadratic equation in x.
    let (a, b, c) = (time * time - factor * tt, reward * time - factor * rt, reward * reward - factor * rr);
    let root = (b * b - a * c).max(0.0).sqrt();
    let interval = if a > 0.0 {
        Interval { low: ((b - root) / a).max(0.0), high: (b + root) / a }
    } else {
        Interval { low: 0.0, high: f64::INFINITY }
    };
    Some(RewardRate { rate: reward / time, interval })
}

/// Events per time of these cycles. With few events Fieller's interval is too short, so it is extended to that of the share of cycles with
/// an event (Clopper and Pearson) divided by the mean duration. `None` as for [`reward_rate`].
pub fn event_rate(events: &[bool], durations: &[f64], confidence: Confidence) -> Option<RewardRate> {
    let rewards: Vec<f64> = events.iter().map(|event| f64::from(u8::from(*event))).collect();
    let RewardRate { rate, interval } = reward_rate(&rewards, durations, confidence)?;
    let time = durations.iter().sum::<f64>() / durations.len() as f64;
    let share = clopper_pearson(Trials::count(events.iter().copied()), confidence);
    let (low, high) = (interval.low.min(share.low / time), interval.high.max(share.high / time));
    Some(RewardRate { rate, interval: Interval { low, high } })
}

/// The probability that the longest run of successes among `n` cycles with success rate `p` is at least `length`.
pub fn run_probability(n: usize, length: usize, p: f64) -> f64 {
    if length == 0 {
        return 1.0;
    }
    if n < length {
        return 0.0;
    }
    let run = p.powf(length as f64);
    let mut shorter = vec![1.0; n + 1];
    shorter[length] = 1.0 - run;
    for i in length + 1..=n {
        shorter[i] = shorter[i - 1] - (1.0 - p) * run * shorter[i - length - 1];
    }
    (1.0 - shorter[n]).clamp(0.0, 1.0)
}

/// The success rate at which the longest run among `n` cycles is at least `length` with a probability of 50 %. 1 if there are fewer
/// cycles.
pub fn rate_of_run(n: usize, length: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if run_probability(n, length, middle) < 0.5 { low = middle } else { high = middle }
    }
    high
}

/// The median of the longest run among `n` cycles with success rate `p`: the largest length that is reached with at least 50 %.
pub fn median_run(n: usize, p: f64) -> usize {
    let (mut low, mut high) = (0, n + 1);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if run_probability(n, middle, p) >= 0.5 { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    #[test]
    fn runs_match_enumeration() {
        let p: f64 = 0.7;
        for length in 0..=10 {
            let mut exact = 0.0;
            for code in 0..1024_u32 {
                let (mut run, mut longest) = (0, 0);
                for i in 0..10 {
                    run = if code >> i & 1 == 1 { run + 1 } else { 0 };
                    longest = longest.max(run);
                }
                let k = code.count_ones() as i32;
                exact += if longest >= length { p.powi(k) * (1.0 - p).powi(10 - k) } else { 0.0 };
            }
            assert!((run_probability(10, length, p) - exact).abs() < 1e-12, "{length}");
        }
        let p = rate_of_run(500, 60);
        assert!((run_probability(500, 60, p) - 0.5).abs() < 1e-9 && median_run(500, p + 1e-6) == 60);
    }

    #[test]
    fn interval_covers_units_per_hour() {
        // Successes take 8 s and more, a quarter of the cycles fails after 15 s: 0.75 / (0.75 x 10 + 0.25 x 15) per second.
        let (truth, mut inside) = (0.75 / 11.25, 0);
        for seed in 0..1000 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let cycles: Vec<(f64, f64)> = (0..80)
                .map(|_| match uniform(&mut rng) < 0.75 {
                    true => (1.0, 8.0 - 2.0 * (1.0 - uniform(&mut rng)).ln()),
                    false => (0.0, 15.0),
                })
                .collect();
            let (rewards, times): (Vec<f64>, Vec<f64>) = cycles.into_iter().unzip();
            inside += usize::from(reward_rate(&rewards, &times, Confidence::P95).unwrap().interval.contains(truth));
        }
        assert!((930..=970).contains(&inside), "{inside}");
    }
}
