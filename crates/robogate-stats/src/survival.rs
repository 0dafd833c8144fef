//! Times that are partly unknown: Kaplan and Meier's curve, its quantiles, and tolerance limits.
//!
//! A time is either observed or censored: the event would have happened later. The cycle time of an episode that ran into its time
//! limit is censored there. The curve is S(t) = Π (1 - d/n) over the times up to t with d events among n at risk. Its
//! interval is that of Greenwood's variance on the scale ln(-ln S), and the interval of a quantile contains the times at which
//! that of the curve contains the wanted share (Brookmeyer and Crowley 1982).
//!
//! A tolerance limit contains at least a share of the population with a stated confidence, for any continuous distribution: an order
//! statistic of the sample (Wilks 1941).

use robogate_maths::beta::ln_beta_cdf;

use crate::interval::{Confidence, Interval};

/// The curve after one time with events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurvivalStep {
    /// The time.
    pub time: f64,
    /// Times that are at least as large, before the events.
    pub at_risk: u64,
    /// Events at this time.
    pub events: u64,
    /// S after the events.
    pub survival: f64,
    /// The interval of S.
    pub interval: Interval,
}

/// A quantile of the time. `None` stands for "later than the last observed time".
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuantileTime {
    /// The first time by which at least this share of the events has happened.
    pub at: Option<f64>,
    /// Lower end of its interval.
    pub low: Option<f64>,
    /// Upper end of its interval.
    pub high: Option<f64>,
}

/// The curve of these times, of which `events` marks those that were observed. Times that are NaN are left out.
pub fn kaplan_meier(times: &[f64], events: &[bool], confidence: Confidence) -> Vec<SurvivalStep> {
    let mut all: Vec<(f64, bool)> =
        times.iter().copied().zip(events.iter().copied()).filter(|(time, _)| !time.is_nan()).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut survival, mut greenwood, mut at_risk) = (1.0, 0.0, all.len() as u64);
    let mut steps = Vec::new();
    for same in all.chunk_by(|a, b| a.0 == b.0) {
        let happened = same.iter().filter(|(_, event)| *event).count() as u64;
        if happened > 0 {
            let (n, d) = (at_risk as f64, happened as f64);
            survival *= 1.0 - d / n;
            greenwood += if happened < at_risk { d / (n * (n - d)) } else { f64::INFINITY };
            let interval = match survival > 0.0 {
                true => {
                    let half = confidence.z() * greenwood.sqrt() / survival.ln();
                    Interval { low: survival.powf((-half).exp()), high: survival.powf(half.exp()) }
                }
                false => Interval { low: 0.0, high: steps.last().map_or(1.0, |s: &SurvivalStep| s.interval.high) },
            };
            steps.push(SurvivalStep { time: same[0].0, at_risk, events: happened, survival, interval });
        }
        at_risk -= same.len() as u64;
    }
    steps
}

/// The time by which a share `q` of the events has happened.
pub fn quantile_time(steps: &[SurvivalStep], q: f64) -> QuantileTime {
    let first = |of: &dyn Fn(&SurvivalStep) -> f64| {
        steps.iter().find(|step| of(step) <= (1.0 - q) * (1.0 + 1e-12)).map(|step| step.time)
    };
    QuantileTime { at: first(&|s| s.survival), low: first(&|s| s.interval.low), high: first(&|s| s.interval.high) }
}

/// The place from 1 of the smallest of `n` sorted values that exceeds at least a share `content` of the population with this
/// confidence. `None` if there are too few values.
pub fn tolerance_limit(n: u64, content: f64, confidence: f64) -> Option<u64> {
    // The share below the s-th value has the distribution Beta(s, n - s + 1).
    let holds = |s: u64| ln_beta_cdf(s as f64, (n - s + 1) as f64, content, 1.0 - content).exp() <= 1.0 - confidence;
    first_place(n, holds)
}

/// The places from 1 of the two values, equally far from both ends of `n` sorted values, between which at least a share `content` of
/// the population lies with this confidence. `None` if there are too few values.
pub fn tolerance_interval(n: u64, content: f64, confidence: f64) -> Option<[u64; 2]> {
    // The share between the r-th and the s-th value has the distribution Beta(s - r, n - s + r + 1).
    let holds = |within: u64| {
        ln_beta_cdf(within as f64, (n - within + 1) as f64, content, 1.0 - content).exp() <= 1.0 - confidence
    };
    let within = first_place(n, holds)?;
    // Both ends are equally far from the middle, so the number between them may be one larger.
    let low = (n + 1).checked_sub(within)? / 2;
    (low >= 1).then(|| [low, n + 1 - low])
}

fn first_place(n: u64, holds: impl Fn(u64) -> bool) -> Option<u64> {
    let (mut low, mut high) = (0, n + 1);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if holds(middle) { high = middle } else { low = middle }
    }
    (high <= n).then_some(high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_match_wilks() {
        // The classical numbers of values for 95 % of the population with a confidence of 95 %: 59 for one limit, 93 for two.
        assert_eq!((tolerance_limit(58, 0.95, 0.95), tolerance_limit(59, 0.95, 0.95)), (None, Some(59)));
        assert_eq!((tolerance_interval(92, 0.95, 0.95), tolerance_interval(93, 0.95, 0.95)), (None, Some([1, 93])));
    }

    #[test]
    fn uncensored_curve_is_empirical() {
        let times = [3.0, 1.0, 2.0, 2.0, 5.0];
        let steps = kaplan_meier(&times, &[true; 5], Confidence::P95);
        let shares: Vec<f64> = steps.iter().map(|step| step.survival).collect();
        for (share, exact) in shares.iter().zip([0.8, 0.4, 0.2, 0.0]) {
            assert!((share - exact).abs() < 1e-12);
        }
        assert_eq!(quantile_time(&steps, 0.5).at, Some(2.0));
    }

    #[test]
    fn censored_times_leave_quantile_open() {
        let steps = kaplan_meier(&[1.0, 2.0, 15.0, 15.0], &[true, true, false, false], Confidence::P95);
        assert_eq!((quantile_time(&steps, 0.5).at, quantile_time(&steps, 0.9).at), (Some(2.0), None));
    }
}
