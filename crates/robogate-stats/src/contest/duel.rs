//! Two policies, A and B, one trial of each per block.

use super::boundary::{Boundary, z};
use super::intervals::{Won, difference};
use super::lattice::Step;
use super::{ContestError, check};
use crate::compare::Pairs;
use crate::interval::{Confidence, Interval};

/// Futility: a contest ends where |z| is at most SLOPE (t - FROM), from t = [`FUTILE_FROM`] on.
const SLOPE: f64 = 2.35;
const FROM: f64 = 0.25;
const FUTILE_FROM: f64 = 0.35;

/// What a contest of two policies says after a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// Run another block.
    GoOn,
    /// The first policy is better.
    FirstBetter,
    /// The second policy is better.
    SecondBetter,
    /// All blocks have run, or the rest of them is unlikely to show a difference. This does not prove that the two are equal. The
    /// test stays valid if more of the planned blocks run nevertheless.
    NoDifferenceShown,
}

/// The true rates of two policies, and the correlation of their outcomes within a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Success rate of the first policy.
    pub first: f64,
    /// Success rate of the second policy.
    pub second: f64,
    /// Correlation within a block. Impossible values are replaced by the nearest possible one.
    pub correlation: f64,
}

impl Truth {
    fn step(self) -> Step {
        let (p, q) = (self.first.clamp(0.0, 1.0), self.second.clamp(0.0, 1.0));
        let shared = self.correlation * (p * (1.0 - p) * q * (1.0 - q)).sqrt();
        let both = (p * q + shared).clamp((p + q - 1.0).max(0.0), p.min(q));
        Step { first: p - both, second: q - both }
    }
}

/// How a contest of two policies ends for given true rates. Exact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedDuel {
    /// Probability of "the first is better".
    pub first_better: f64,
    /// Probability of "the second is better".
    pub second_better: f64,
    /// Probability of no difference shown.
    pub no_difference: f64,
    /// Expected number of blocks. Each block is two trials.
    pub blocks: f64,
}

/// A contest of two policies.
///
/// Call [`Duel::block`] with the outcomes of each complete block in their order. A block with an invalid trial is left out: call
/// nothing for it. Leaving out blocks keeps the error only if the reason does not depend on the outcomes.
#[derive(Debug, Clone, PartialEq)]
pub struct Duel {
    boundary: Boundary,
    looks: Vec<Won>,
    pairs: Pairs,
    decision: Decision,
}

impl Duel {
    /// Plans a contest of at most `blocks` blocks. `error` is the largest probability of a false "better", on both sides together
    /// and over all blocks.
    ///
    /// # Errors
    /// A number of blocks or an error that cannot be planned.
    pub fn new(blocks: u64, error: f64) -> Result<Self, ContestError> {
        check(blocks, error)?;
        let boundary = Boundary::new(1, blocks, error);
        Ok(Self { boundary, looks: Vec::new(), pairs: Pairs::default(), decision: Decision::GoOn })
    }

    /// Adds a block: whether each policy succeeded. A decision for a policy is final; later blocks only narrow the interval.
    pub fn block(&mut self, first: bool, second: bool) -> Decision {
        let count = match (first, second) {
            (true, true) => &mut self.pairs.both,
            (true, false) => &mut self.pairs.first_only,
            (false, true) => &mut self.pairs.second_only,
            (false, false) => &mut self.pairs.neither,
        };
        *count += 1;
        let (b, a) = (self.pairs.first_only, self.pairs.second_only);
        self.looks.push(Won { first: b, second: a, blocks: self.pairs.n() });
        if matches!(self.decision, Decision::FirstBetter | Decision::SecondBetter) {
            return self.decision;
        }
        let n = self.pairs.n();
        self.decision = if self.boundary.is_reached(n, b.max(a), b.min(a)) {
            if b > a { Decision::FirstBetter } else { Decision::SecondBetter }
        } else if n >= self.boundary.blocks() || self.is_futile(n, b.max(a), b.min(a)) {
            Decision::NoDifferenceShown
        } else {
            Decision::GoOn
        };
        self.decision
    }

    /// The decision after the last block.
    pub fn decision(&self) -> Decision {
        self.decision
    }

    /// The blocks so far.
    pub fn pairs(&self) -> Pairs {
        self.pairs
    }

    /// The largest number of blocks.
    pub fn blocks(&self) -> u64 {
        self.boundary.blocks()
    }

    /// The two-sided p-value of "both rates are equal", valid over all looks so far.
    pub fn p_value(&self) -> f64 {
        self.boundary.p_value(&self.looks)
    }

    /// The success rate of the first policy minus that of the second, with an interval that holds after all blocks
    /// simultaneously. It is wider than that of a fixed number of blocks.
    pub fn interval(&self, confidence: Confidence) -> Interval {
        difference(&self.looks, confidence.tail())
    }

    fn is_futile(&self, n: u64, ahead: u64, behind: u64) -> bool {
        let t = n as f64 / self.boundary.blocks() as f64;
        t >= FUTILE_FROM && z(ahead, behind) <= SLOPE * (t - FROM)
    }

    /// How the contest ends for given true rates, before any block has run.
    pub fn expected(&self, truth: Truth) -> ExpectedDuel {
        let found = self.boundary.course(truth.step(), |n, ahead, behind| self.is_futile(n, ahead, behind));
        ExpectedDuel {
            first_better: found.first,
            second_better: found.second,
            no_difference: (1.0 - found.first - found.second).max(0.0),
            blocks: found.blocks,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_hold_for_every_share_of_differences() {
        for blocks in [1, 6, 20, 52] {
            let duel = Duel::new(blocks, 0.05).unwrap();
            let mut largest = 0.0_f64;
            for i in 1..=97 {
                let found = duel.boundary.course(Step::equal(f64::from(i) / 97.0), |_, _, _| false);
                largest = largest.max(found.first + found.second);
            }
            assert!(largest <= 0.0502, "{blocks} blocks: {largest}");
            assert!(blocks < 20 || largest > 0.045, "{blocks} blocks: {largest}");
        }
    }

    #[test]
    fn correlation_and_futility_never_raise_the_error() {
        let duel = Duel::new(52, 0.05).unwrap();
        for rate in [0.3, 0.6, 0.9] {
            for correlation in [-1.0, -0.3, 0.0, 0.5, 0.9] {
                let found = duel.expected(Truth { first: rate, second: rate, correlation });
                assert!(found.first_better + found.second_better <= 0.05, "{rate} {correlation}: {found:?}");
            }
        }
    }

    // 60 % against 90 %: a fixed number of blocks needs 42 for 90 % power.
    #[test]
    fn clear_differences_end_early() {
        let duel = Duel::new(52, 0.05).unwrap();
        let truth = |correlation| Truth { first: 0.6, second: 0.9, correlation };
        let (apart, together) = (duel.expected(truth(0.0)), duel.expected(truth(0.3)));
        assert!(apart.second_better >= 0.9 && apart.blocks <= 31.5, "{apart:?}");
        assert!(together.second_better >= 0.98 && together.blocks <= 28.0, "{together:?}");
        let equal = duel.expected(Truth { first: 0.75, second: 0.75, correlation: 0.0 });
        assert!(equal.blocks <= 30.0 && equal.no_difference >= 0.95, "{equal:?}");
    }

    #[test]
    fn decisions_and_p_values_agree() {
        let mut duel = Duel::new(40, 0.05).unwrap();
        let mut at = 0;
        while duel.decision() == Decision::GoOn {
            assert!(duel.p_value() > 0.05);
            at += 1;
            duel.block(at % 5 == 0, true);
        }
        assert_eq!(duel.decision(), Decision::SecondBetter);
        assert!(duel.p_value() <= 0.05 && at < 20, "{} after {at}", duel.p_value());
        assert!(duel.interval(Confidence::P95).high < 0.2);
        // A decision is final.
        assert_eq!(duel.block(true, false), Decision::SecondBetter);
    }

    #[test]
    fn equal_outcomes_end_without_a_difference() {
        let mut duel = Duel::new(40, 0.05).unwrap();
        let blocks = (1..).find(|_| duel.block(true, true) != Decision::GoOn);
        assert_eq!((blocks, duel.decision()), (Some(14), Decision::NoDifferenceShown));
        assert!((duel.p_value() - 1.0).abs() < 1e-12 && duel.interval(Confidence::P95).contains(0.0));
    }

    #[test]
    fn unusable_plans_are_rejected() {
        assert_eq!(Duel::new(0, 0.05), Err(ContestError::Blocks(0)));
        assert_eq!(Duel::new(10, 0.7), Err(ContestError::Error(0.7)));
        assert!(Duel::new(10, f64::NAN).is_err());
    }
}
