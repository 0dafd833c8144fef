//! The factors of each metric's detector, with their assumptions.
//!
//! All use a confidence bound of the baseline, not its point estimate. The bound on false alarms holds for every true
//! value within that confidence bound. `baseline_confidence` is the probability that the confidence bound is correct.

use crate::detector::Factors;

/// Odds ratios of the alternatives, with their weights.
///
/// From 1.4 (a failure rate of 5 % becomes 6.9 %) to 30 (one drop in a thousand becomes three in a hundred).
const ODDS: [(f64, f64); 8] =
    [(1.4, 0.18), (1.8, 0.18), (2.3, 0.18), (3.0, 0.18), (4.0, 0.13), (6.0, 0.08), (12.0, 0.04), (30.0, 0.03)];

/// Fractions of the largest bet for which no factor is negative.
const BETS: [f64; 6] = [0.08, 0.16, 0.3, 0.45, 0.65, 0.9];

/// Factors for an event (a failure, a drop, a collision) whose probability is at most `bound` before the change.
/// Symbols: 0 without the event, 1 with it.
///
/// The factor is the likelihood ratio of q > bound to the bound. It grows with the event, so its expectation is at most
/// 1 for every probability up to the bound. Assumption: given the past, the event has at most this probability. `None`
/// unless the bound lies strictly between 0 and 1.
pub fn event(bound: f64) -> Option<Factors> {
    Factors::new(&odds(bound)?.map(|(weight, no, yes)| (weight, vec![no, yes])))
}

/// Factors for the shares of categories (failure modes), each at most its `bounds` before the change. Symbols: the code
/// of the category.
///
/// Each category has the alternatives of [`event`]: if the mix changes, some share grows. A category whose bound is 0
/// or 1 has no alternatives. `None` if no category has any.
pub fn shares(bounds: &[f64]) -> Option<Factors> {
    let one = |(kind, bound): (usize, &f64)| {
        let table = |(weight, no, yes): (f64, f64, f64)| {
            let mut factors = vec![no; bounds.len()];
            if let Some(factor) = factors.get_mut(kind) {
                *factor = yes;
            }
            (weight, factors)
        };
        odds(*bound).into_iter().flatten().map(table).collect::<Vec<_>>()
    };
    Factors::new(&bounds.iter().enumerate().flat_map(one).collect::<Vec<_>>())
}

/// Weight, factor without the event, and factor with it, for each alternative.
fn odds(bound: f64) -> Option<[(f64, f64, f64); 8]> {
    (bound > 0.0 && bound < 1.0).then(|| {
        ODDS.map(|(times, weight)| {
            // The odds of q are `times` the odds of the bound.
            let q = times * bound / (1.0 - bound + times * bound);
            (weight, (1.0 - q) / (1.0 - bound), q / bound)
        })
    })
}

/// Factors for a score from 0 to 1 whose mean is at most `bound` before the change: 1 + λ (score - bound), a bet on the
/// mean.
///
/// `scores` contains the score of each symbol. The only assumption is the bound on the mean, given the past.
fn bets(scores: &[f64], bound: f64) -> Vec<(f64, Vec<f64>)> {
    if bound.is_nan() || bound <= 0.0 || bound >= 0.98 {
        return Vec::new();
    }
    let bet = |share: f64| (1.0, scores.iter().map(|score| 1.0 + share / bound * (score - bound)).collect());
    BETS.map(bet).to_vec()
}

/// Number of steps of the risk.
const RISK_STEPS: u8 = 128;

/// The step of a risk: √p in 128 equal parts, so that steps are narrow for small risks.
pub(crate) fn risk_step(risk: f64) -> u8 {
    // The highest step includes 1; a cast of NaN gives 0.
    ((risk.sqrt() * f64::from(RISK_STEPS)) as u8).min(RISK_STEPS - 1)
}

/// The middle of a step.
pub(crate) fn risk_of(step: u8) -> f64 {
    ((f64::from(step) + 0.5) / f64::from(RISK_STEPS)).powi(2)
}

/// Factors for a risk (predicted P(failure)) whose mean is at most `bound` before the change. Symbols: the step of
/// `risk_step`.
///
/// The score is the lower end of the step, so a mean risk within the bound has a mean score within it.
pub fn risk(bound: f64) -> Option<Factors> {
    let scores: Vec<f64> = (0..RISK_STEPS).map(|step| (f64::from(step) / f64::from(RISK_STEPS)).powi(2)).collect();
    Factors::new(&bets(&scores, bound))
}

/// A distribution of cycle times in bins.
#[derive(Debug, Clone, PartialEq)]
pub struct Binned {
    /// Inner edges, increasing. Bin 0 lies below the first edge, the last bin above the last one.
    pub edges: Vec<f64>,
    /// Share of the baseline in each bin.
    pub shares: Vec<f64>,
    /// Number of cycles of the baseline.
    pub n: usize,
}

impl Binned {
    /// Creates bins of about equal counts from finite values. `None` with fewer than 20 values, or if all are equal.
    pub fn of(values: &[f64], bins: usize) -> Option<Self> {
        if values.len() < 20 {
            return None;
        }
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let mut edges: Vec<f64> = (1..bins).filter_map(|i| sorted.get(i * sorted.len() / bins).copied()).collect();
        edges.dedup();
        edges.retain(|edge| Some(edge) != sorted.first());
        if edges.is_empty() {
            return None;
        }
        let mut counts = vec![0.0; edges.len() + 1];
        for value in &sorted {
            if let Some(count) = counts.get_mut(edges.partition_point(|edge| edge <= value)) {
                *count += 1.0;
            }
        }
        let n = sorted.len();
        Some(Self { edges, shares: counts.iter().map(|c: &f64| c / n as f64).collect(), n })
    }

    /// The bin of a value.
    pub fn bin(&self, value: f64) -> u8 {
        // There are at most a few dozen bins.
        u8::try_from(self.edges.partition_point(|edge| *edge <= value)).unwrap_or(u8::MAX)
    }

    /// The middle rank of each bin, in 0..1.
    fn ranks(&self) -> Vec<f64> {
        let mut below = 0.0;
        let rank = |share: &f64| {
            let rank: f64 = below + 0.5 * share;
            below += share;
            rank
        };
        self.shares.iter().map(rank).collect()
    }

    fn mean(&self, scores: &[f64]) -> f64 {
        self.shares.iter().zip(scores).map(|(share, score)| share * score).sum()
    }

    /// Factors for a shift of the location, slower or faster. Symbols: the bin. The first half of the alternatives is
    /// slower.
    ///
    /// The score is the rank in the baseline. Its mean is at most the baseline's own plus ε = √(ln(2/α) / 2n), because
    /// the Dvoretzky-Kiefer-Wolfowitz inequality bounds all half-lines at once, hence all monotone scores. No shape of
    /// the distribution is assumed.
    pub fn location(&self, alpha: f64) -> Option<Factors> {
        let margin = ((2.0 / alpha).ln() / (2.0 * self.n as f64)).sqrt();
        let up = self.ranks();
        let down: Vec<f64> = up.iter().map(|rank| 1.0 - rank).collect();
        let mut all = bets(&up, self.mean(&up) + margin);
        all.extend(bets(&down, self.mean(&down) + margin));
        Factors::new(&all)
    }

    /// Factors for a wider spread. Symbols: the bin.
    ///
    /// The score is the distance of the rank from the middle, |2u - 1|. Its upper sets are two half-lines, so the
    /// margin is twice that of Dvoretzky, Kiefer and Wolfowitz. It also grows if the location moves far. `None` if the
    /// baseline is too small for a bound below 1.
    pub fn spread(&self, alpha: f64) -> Option<Factors> {
        let margin = 2.0 * ((2.0 / alpha).ln() / (2.0 * self.n as f64)).sqrt();
        let scores: Vec<f64> = self.ranks().iter().map(|rank| (2.0 * rank - 1.0).abs()).collect();
        Factors::new(&bets(&scores, self.mean(&scores) + margin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expected_factors_are_at_most_one() {
        for bound in [0.001, 0.05, 0.3, 0.9] {
            let factors = event(bound).unwrap();
            for truth in [0.0, 0.2 * bound, bound] {
                assert!(factors.largest_expectation(&[1.0 - truth, truth]) <= 1.0 + 1e-12, "{bound} {truth}");
            }
            assert!(factors.largest_expectation(&[1.0 - 1.1 * bound, 1.1 * bound]) > 1.0);
        }
        let factors = shares(&[0.5, 0.4, 0.3, 0.1, 0.05]).unwrap();
        assert!(factors.largest_expectation(&[0.5, 0.2, 0.2, 0.05, 0.05]) <= 1.0 + 1e-12);
        assert!(factors.largest_expectation(&[0.5, 0.1, 0.1, 0.1, 0.2]) > 1.0);
    }

    #[test]
    fn useless_bounds_give_no_detector() {
        for bound in [0.0, 1.0, -0.1, 2.0, f64::NAN] {
            assert_eq!(event(bound), None);
        }
        assert_eq!(shares(&[1.0, 1.0]), None);
        assert!(shares(&[1.0, 0.5]).is_some());
    }

    #[test]
    fn only_changed_cycle_times_are_evidence() {
        let times: Vec<f64> = (0..1000).map(|i| 4.0 + f64::from(i % 97) / 97.0).collect();
        let binned = Binned::of(&times, 20).unwrap();
        assert!((binned.shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let location = binned.location(0.01).unwrap();
        let spread = binned.spread(0.01).unwrap();
        assert!(location.largest_expectation(&binned.shares) <= 1.0);
        assert!(spread.largest_expectation(&binned.shares) <= 1.0);
        let mut slow = vec![0.0; binned.shares.len()];
        slow[binned.bin(10.0) as usize] = 1.0;
        assert!(location.largest_expectation(&slow) > 1.5);
        let mut wide = vec![0.0; binned.shares.len()];
        (wide[0], wide[binned.shares.len() - 1]) = (0.5, 0.5);
        assert!(spread.largest_expectation(&wide) > 1.3);
        assert!(location.largest_expectation(&wide) <= 1.0, "a wider spread is no shift");
    }

    #[test]
    fn only_higher_risk_is_evidence() {
        let factors = risk(0.05).unwrap();
        let alternating = |a: f64, b: f64| {
            let mut shares = vec![0.0; RISK_STEPS.into()];
            shares[usize::from(risk_step(a))] += 0.5;
            shares[usize::from(risk_step(b))] += 0.5;
            factors.largest_expectation(&shares)
        };
        assert!(alternating(0.02, 0.08) <= 1.0 && alternating(0.0, 0.1) <= 1.0);
        assert!(alternating(0.05, 0.12) > 1.1);
        assert_eq!((risk_step(0.0), risk_step(1.0), risk_step(f64::NAN)), (0, 127, 0));
        assert_eq!(risk(1.0), None);
    }

    #[test]
    fn few_or_equal_times_have_no_bins() {
        assert_eq!(Binned::of(&[4.0; 100], 20), None);
        assert_eq!(Binned::of(&[1.0, 2.0, 3.0], 20), None);
    }
}
