//! Sequential tests of the mean of a bounded quantity, without an assumption about its distribution.
//!
//! Values are between 0 and a known ceiling u. To test "the mean is at least m", a gambler bets a fixed fraction c of
//! the possible loss on each value x being below m. The capital is multiplied by 1 + c (m - x)/(u - m). If the mean is
//! m or more, no bet has a positive expected gain, and the mean capital of several gamblers ever reaches 1/α with
//! probability at most α. The fractions form a geometric grid from 0.99 downwards, because the best fraction depends on
//! the unknown spread.
//!
//! The bets are constant, so the argument of [`crate::anytime`] about rounds of different scenarios applies: the tested
//! mean is the mean over the scenarios, and looks are at the end of complete rounds. The capital increases in m, so the
//! m that are not rejected form an interval.
//!
//! Limit: the ceiling must be known in advance (a time limit), not the largest observed value. An unnecessarily high
//! ceiling costs episodes. Source: Waudby-Smith and Ramdas (2024), Journal of the Royal Statistical Society B 86
//! (betting; here a grid of constant bets).

use crate::interval::Interval;

/// Number of bet sizes: 0.99, halved repeatedly.
pub(crate) const STAKES: u32 = 12;

/// A value outside its stated bounds.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("value {index} is {value}. Expected a number from 0 to {ceiling}")]
pub struct OutOfBounds {
    /// Position in the input.
    pub index: usize,
    /// Value found.
    pub value: f64,
    /// The ceiling, as given.
    pub ceiling: f64,
}

/// Values from 0 to a ceiling, in the order of observation.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundedMean<'a> {
    values: &'a [f64],
    looks: &'a [usize],
    ceiling: f64,
}

impl<'a> BoundedMean<'a> {
    /// Creates the test. `looks` are the numbers of values at each look, in increasing order. A single look at all
    /// values is a sample of fixed size.
    ///
    /// # Errors
    /// [`OutOfBounds`] for the first value below 0, above `ceiling` or not a number.
    pub fn new(values: &'a [f64], looks: &'a [usize], ceiling: f64) -> Result<Self, OutOfBounds> {
        match values.iter().position(|x| !(0.0..=ceiling).contains(x)) {
            Some(index) => Err(OutOfBounds { index, value: values[index], ceiling }),
            None => Ok(Self { values, looks, ceiling }),
        }
    }

    /// ln of the largest evidence over all looks against "the mean is at least `m`".
    pub fn ln_evidence_below(&self, m: f64) -> f64 {
        self.evidence(m / self.ceiling, |x| x)
    }

    /// ln of the largest evidence over all looks against "the mean is at most `m`".
    pub fn ln_evidence_above(&self, m: f64) -> f64 {
        self.evidence(1.0 - m / self.ceiling, |x| 1.0 - x)
    }

    /// The means that no look rejects. Each side has the error probability `tail`.
    pub fn interval(&self, tail: f64) -> Interval {
        let wanted = -tail.ln();
        let high = boundary(|m| self.evidence(m, |x| x) < wanted);
        let low = 1.0 - boundary(|m| self.evidence(m, |x| 1.0 - x) < wanted);
        Interval { low: low * self.ceiling, high: high * self.ceiling }
    }

    /// Evidence against "the mean of `side(x / ceiling)` is at least m", with all values from 0 to 1.
    fn evidence(&self, m: f64, side: impl Fn(f64) -> f64) -> f64 {
        if m.is_nan() || m <= 0.0 {
            return 0.0;
        }
        if m >= 1.0 {
            // The mean can equal the ceiling only if every value does.
            let seen = self.looks.last().map_or(&[][..], |&n| &self.values[..n.min(self.values.len())]);
            let below = m > 1.0 || seen.iter().any(|&x| side(x / self.ceiling) < 1.0);
            return if below { f64::INFINITY } else { 0.0 };
        }
        let mut capital = [0.0_f64; STAKES as usize];
        let mut most = 0.0_f64;
        let mut from = 0;
        for &look in self.looks {
            let to = look.min(self.values.len());
            for &x in self.values.get(from..to).unwrap_or_default() {
                let gain = (m - side(x / self.ceiling)) / (1.0 - m);
                for (ln, i) in capital.iter_mut().zip(0..) {
                    *ln += (stake(i) * gain).ln_1p();
                }
            }
            from = to.max(from);
            most = most.max(ln_mean_exp(&capital));
        }
        most
    }
}

/// The fraction of the possible loss that a gambler bets.
pub(crate) fn stake(i: i32) -> f64 {
    0.99 * 0.5_f64.powi(i)
}

pub(crate) fn ln_mean_exp(values: &[f64]) -> f64 {
    let top = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    top + (values.iter().map(|v| (v - top).exp()).sum::<f64>() / values.len() as f64).ln()
}

/// The largest m in [0, 1] up to which `open` holds everywhere. 1 if it always holds.
pub(crate) fn boundary(open: impl Fn(f64) -> bool) -> f64 {
    if open(1.0) {
        return 1.0;
    }
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if open(middle) { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_values_leave_whole_range() {
        let none = BoundedMean::new(&[], &[0], 15.0).unwrap();
        assert_eq!(none.interval(0.05), Interval { low: 0.0, high: 15.0 });
        assert_eq!(none.ln_evidence_below(4.0), 0.0);
    }

    #[test]
    fn value_above_ceiling_is_named() {
        let error = BoundedMean::new(&[3.0, 17.2], &[2], 15.0).unwrap_err();
        assert_eq!((error.index, error.value), (1, 17.2));
        assert!(BoundedMean::new(&[f64::NAN], &[1], 15.0).is_err());
    }

    #[test]
    fn expected_capital_is_one_at_limit() {
        // All sequences of eight values of 3 and 12 with mean 6 and a ceiling of 15: probabilities 2/3 and 1/3.
        let mut expected = 0.0;
        for code in 0..256_u32 {
            let values: Vec<f64> = (0..8).map(|i| if code >> i & 1 == 1 { 12.0 } else { 3.0 }).collect();
            let chance =
                (1.0_f64 / 3.0).powi(code.count_ones() as i32) * (2.0_f64 / 3.0).powi(8 - code.count_ones() as i32);
            // One look: the maximum with the initial capital 1 is not taken, which keeps the mean exact.
            let mut capital = [0.0_f64; STAKES as usize];
            for x in &values {
                for (ln, i) in capital.iter_mut().zip(0..) {
                    *ln += (0.99 * 0.5_f64.powi(i) * (6.0 - x) / 9.0).ln_1p();
                }
            }
            let single = ln_mean_exp(&capital);
            let here = BoundedMean::new(&values, &[8], 15.0).unwrap().ln_evidence_below(6.0);
            assert!((here - single.max(0.0)).abs() < 1e-12);
            expected += chance * single.exp();
        }
        assert!((expected - 1.0).abs() < 1e-12, "{expected}");
    }

    #[test]
    fn interval_contains_the_mean() {
        let values: Vec<f64> = (0..136).map(|i| 3.5 + f64::from(i % 7) * 0.2).collect();
        let mean = values.iter().sum::<f64>() / 136.0;
        let data = BoundedMean::new(&values, &[68, 136], 15.0).unwrap();
        let mut last = 0.0;
        for i in 0..150 {
            let e = data.ln_evidence_below(f64::from(i) / 10.0);
            assert!(e >= last);
            last = e;
        }
        let interval = data.interval(0.05);
        assert!(interval.contains(mean) && interval.width() < 1.5, "{interval:?}");
        assert!(data.ln_evidence_above(interval.low) >= 20.0_f64.ln() - 1e-6);
    }
}
