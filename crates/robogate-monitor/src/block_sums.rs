//! Serial dependence of a stream: how much more sums of consecutive cycles vary than those of independent ones.
//!
//! Blocks have 1, 2, 4, ... cycles. The variance of their sums, divided by their length and by the variance of single cycles, is 1
//! for independent cycles. It grows with the length if neighbouring cycles are alike: retries, batches of parts, shifts, a
//! temperature that follows the day. The largest ratio that is significantly above 1 is the inflation.
//!
//! A lasting change and steady wear move sums too, and must not hide themselves. So the variance within windows of neighbouring blocks
//! must be above that of independent cycles too, without the window that has the largest one, where a change would be. While an alarm is
//! active, only blocks of up to 64 cycles are used.
//!
//! Evidence of a detector is raised to the power 1 / inflation. For independent cycles the bound on false alarms still holds, by
//! Jensen's inequality. For dependent ones it holds approximately: the sum of the logarithms then has the variance for which the
//! expectation of its exponential is 1. Source: the adjustment of composite likelihoods (Pauli, Racugno and Ventura 2011, Statistica
//! Sinica 21).

use robogate_maths::normal;
use serde::{Deserialize, Serialize};

/// Lengths of blocks: 2^0 to 2^12 cycles.
const SCALES: usize = 13;
/// Blocks of a window.
const WINDOW: u32 = 8;
/// Windows from which their own variance is tested: one of them is left out.
const WINDOWS: u32 = 3;
/// Blocks from which a length is tested.
const FEWEST: u32 = 5;
/// Shorter blocks hardly feel a lasting change.
const SHORT: usize = 6;
/// The normal score above which a ratio counts as above 1 (p = 3e-5): it is tested again and again.
const SURE: f64 = 4.0;
/// The normal score from which the variance within windows tells dependence from one lasting change.
const LIKELY: f64 = 2.0;
/// The steps of an inflation, so that detectors are seldom rebuilt. One step more covers that longer blocks vary more.
const STEP: f64 = 1.25;

/// Sums of blocks of all lengths.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct BlockSums {
    // Stores of earlier versions have other sums under `scales`. These start empty then, and what was found is kept meanwhile.
    #[serde(rename = "lengths")]
    scales: [Scale; SCALES],
}

/// The sums of blocks of one length.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
struct Scale {
    blocks: u32,
    /// The sum of the last block, if the next one makes a pair with it.
    waits: f64,
    /// The sum and the squares of the blocks of the present window, and of all.
    window: [f64; 2],
    all: [f64; 2],
    /// The sum of the squared deviations from the means of the windows, and that of the window with the most.
    within: f64,
    largest: f64,
}

impl Scale {
    fn add(&mut self, sum: f64) {
        self.blocks = self.blocks.saturating_add(1);
        for sums in [&mut self.window, &mut self.all] {
            *sums = [sums[0] + sum, sums[1] + sum * sum];
        }
        if self.blocks.is_multiple_of(WINDOW) {
            let [sum, squares] = std::mem::take(&mut self.window);
            let apart = (squares - sum * sum / f64::from(WINDOW)).max(0.0);
            self.within += apart;
            self.largest = self.largest.max(apart);
        }
    }

    fn windows(&self) -> u32 {
        self.blocks / WINDOW
    }

    fn variance(&self) -> f64 {
        let n = f64::from(self.blocks);
        let [sum, squares] = self.all;
        ((squares - sum * sum / n) / (n - 1.0)).max(0.0)
    }

    /// The variance within windows without the largest one, and its degrees of freedom.
    fn variance_within(&self) -> (f64, f64) {
        let (windows, each) = (f64::from(self.windows()), f64::from(WINDOW - 1));
        // The mean of the largest of so many chi-squared numbers (Wilson and Hilferty 1931 and Blom 1958).
        let z = normal::quantile((windows - 0.375) / (windows + 0.25));
        let spread = 2.0 / (9.0 * each);
        let largest = each * (1.0 - spread + z * spread.sqrt()).powi(3);
        ((self.within - self.largest) / (windows * each - largest), (windows - 1.0) * each)
    }
}

/// How cycles depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Inflation {
    /// Length of the blocks, in cycles that report the metric.
    pub cycles: u64,
    /// The variance of their sums, relative to that of independent cycles. Rounded up to steps of 25 %, and one step more.
    pub ratio: f64,
}

impl BlockSums {
    /// Adds the score of a cycle, 0 to 1.
    pub(crate) fn add(&mut self, score: f64) {
        let mut sum = score;
        for scale in &mut self.scales {
            scale.add(sum);
            if scale.blocks % 2 == 1 {
                scale.waits = sum;
                return;
            }
            sum += scale.waits;
        }
    }

    /// Whether it is time to look for dependence again: after every 64 scores.
    pub(crate) fn is_due(&self) -> bool {
        const EVERY: u32 = 64;
        self.scales[0].blocks.is_multiple_of(EVERY)
    }

    /// The largest inflation. `None` if no length shows any. The one that was known before is kept until there are as many blocks
    /// of its length.
    pub(crate) fn inflation(&self, known: Option<Inflation>) -> Option<Inflation> {
        let lacks = |known: &Inflation| u64::from(self.scales[0].blocks) < u64::from(FEWEST) * known.cycles;
        known.filter(lacks).or_else(|| self.largest(SCALES))
    }

    /// The inflation while an alarm is active: the known one, or a larger one of short blocks.
    pub(crate) fn inflation_in_alarm(&self, known: Option<Inflation>) -> Option<Inflation> {
        let ratio = |of: Option<Inflation>| of.map_or(1.0, |of| of.ratio);
        let found = self.largest(SHORT + 1);
        if ratio(found) > ratio(known) { found } else { known }
    }

    fn largest(&self, scales: usize) -> Option<Inflation> {
        let single = self.scales[0].variance();
        if self.scales[0].blocks < FEWEST || single <= 0.0 {
            return None;
        }
        // The score of a ratio. Sums of few rare events have long tails, which cost degrees of freedom.
        let score = |ratio: f64, freedom: f64, scale: &Scale, length: f64| {
            let kurtosis = ((1.0 / single - 6.0) / length).max(0.0);
            let spread = 1.0 / 9.0 * (2.0 / freedom + kurtosis / f64::from(scale.blocks));
            (ratio.cbrt() - (1.0 - spread)) / spread.sqrt()
        };
        let (mut within, mut found) = (f64::NEG_INFINITY, None::<(f64, u32)>);
        for (scale, k) in self.scales.iter().take(scales).zip(0_u32..).skip(1) {
            let length = 2.0_f64.powi(k as i32);
            if scale.blocks < FEWEST {
                break;
            }
            if scale.windows() >= WINDOWS {
                let (variance, freedom) = scale.variance_within();
                within = score(variance / (length * single), freedom, scale, length);
            }
            let ratio = scale.variance() / (length * single);
            let is_sure = score(ratio, f64::from(scale.blocks - 1), scale, length) > SURE && within > LIKELY;
            if is_sure && found.is_none_or(|(most, _)| ratio > most) {
                found = Some((ratio, k));
            }
        }
        let (ratio, k) = found?;
        Some(Inflation { cycles: 1 << k, ratio: STEP.powf((ratio.ln() / STEP.ln()).ceil().max(1.0) + 1.0) })
    }
}

#[cfg(test)]
mod tests {
    use robogate_core::Seed;

    use super::*;

    fn of(n: u64, score: impl Fn(u64, f64) -> f64) -> Option<Inflation> {
        let mut stream = Seed::campaign(5).stream("block sums");
        let mut sums = BlockSums::default();
        (0..n).for_each(|i| sums.add(score(i, stream.uniform())));
        sums.inflation(None)
    }

    #[test]
    fn independent_cycles_have_none() {
        for rate in [0.001, 0.01, 0.05, 0.5] {
            assert_eq!(of(20_000, |_, u| f64::from(u8::from(u < rate))), None, "{rate}");
        }
        assert_eq!(of(20_000, |_, u| u), None);
        assert_eq!(of(3, |_, u| u), None);
        assert_eq!(of(20_000, |_, _| 1.0), None);
    }

    #[test]
    fn batches_have_their_inflation() {
        // Batches of 200 with 2 % and 8 %: 1 + 199 · 0.0009 / 0.0475 = 4.8.
        let found = of(20_000, |i, u| f64::from(u8::from(u < if i / 200 % 2 == 0 { 0.02 } else { 0.08 }))).unwrap();
        assert!((3.0..=9.0).contains(&found.ratio) && (64..=512).contains(&found.cycles), "{found:?}");
        let mut few = BlockSums::default();
        (0..100).for_each(|_| few.add(0.5));
        assert_eq!((few.inflation(Some(found)), few.inflation(None)), (Some(found), None));
    }
}
