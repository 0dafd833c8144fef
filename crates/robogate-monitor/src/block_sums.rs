//! Serial dependence of a stream: how much more sums of consecutive cycles vary than those of independent ones.
//!
//! Blocks have 1, 2, 4, ... cycles. The variance of their sums, divided by their length and by the variance of single cycles, is 1
//! for independent cycles. It grows with the length if neighbouring cycles are alike: retries, batches of parts, shifts, a
//! temperature that follows the day. The largest ratio that is significantly above 1 is the inflation. A lasting change moves sums too, but
//! it raises an alarm long before it looks like dependence. While an alarm is active, only blocks of up to 64 cycles are used.
//!
//! Evidence of a detector is raised to the power 1 / inflation. For independent cycles the bound on false alarms still holds, by
//! Jensen's inequality. For dependent ones it holds approximately: the sum of the logarithms then has the variance for which the
//! expectation of its exponential is 1. Source: the adjustment of composite likelihoods (Pauli, Racugno and Ventura 2011, Statistica
//! Sinica 21).

use serde::{Deserialize, Serialize};

/// Lengths of blocks: 2^0 to 2^12 cycles.
const SCALES: usize = 13;
/// Blocks from which a length is tested.
const FEWEST: u32 = 5;
/// Shorter blocks hardly feel a lasting change.
const SHORT: usize = 6;
/// The normal score above which a ratio counts as above 1 (p = 3e-5): it is tested again and again.
const SURE: f64 = 4.0;
/// The steps of an inflation, so that detectors are seldom rebuilt. One step more covers that longer blocks vary more.
const STEP: f64 = 1.25;

/// Sums of blocks of all lengths.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct BlockSums {
    scales: [Scale; SCALES],
}

/// The sums of blocks of one length.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Scale {
    blocks: u32,
    sum: f64,
    squares: f64,
    /// The sum of the last block, if the next one makes a pair with it.
    waits: f64,
}

impl Scale {
    fn variance(&self) -> f64 {
        let n = f64::from(self.blocks);
        ((self.squares - self.sum * self.sum / n) / (n - 1.0)).max(0.0)
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
            scale.blocks = scale.blocks.saturating_add(1);
            scale.sum += sum;
            scale.squares += sum * sum;
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
        let tested =
            self.scales.iter().take(scales).zip(0_u32..).skip(1).take_while(|(scale, _)| scale.blocks >= FEWEST);
        let found = tested.filter_map(|(scale, k)| {
            let length = 2.0_f64.powi(k as i32);
            let ratio = scale.variance() / (length * single);
            // Sums of few rare events have long tails, which cost degrees of freedom.
            let kurtosis = ((1.0 / single - 6.0) / length).max(0.0);
            let n = f64::from(scale.blocks);
            let freedom = 2.0 / (2.0 / (n - 1.0) + kurtosis / n);
            let spread = 2.0 / (9.0 * freedom);
            let score = (ratio.cbrt() - (1.0 - spread)) / spread.sqrt();
            (score > SURE).then_some((ratio, k))
        });
        let (ratio, k) = found.max_by(|a, b| a.0.total_cmp(&b.0))?;
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
