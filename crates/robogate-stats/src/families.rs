//! Paired effects of several families of perturbations: the difference of two success rates on the same scenarios, for each
//! family, with intervals that hold together.
//!
//! Each difference has the score test of [`crate::difference::paired`] (exact for few pairs). Bonferroni's adjustment covers
//! the families, so that intervals and p-values agree: an interval excludes 0 if its adjusted p-value is at most the error.
//! If a run was tested after each of several rounds, the number of pairs depends on the results. The error of each look
//! is then that of [`crate::group_sequential`], which holds for all of them together.
//!
//! A pair with an invalid episode could have had any result. The interval covers all of them.

use crate::compare::Pairs;
use crate::difference::{ScoreDifference, paired};
use crate::group_sequential::{joint_p, single_p};
use crate::interval::{Confidence, Interval};

/// The pairs of one family. The first of a pair is the perturbed episode, the second its twin without the perturbation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FamilyPairs {
    /// Pairs of valid episodes.
    pub valid: Pairs,
    /// Pairs with an invalid episode.
    pub invalid: u64,
}

/// The effect of one family.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FamilyEffect {
    /// Rate with the perturbation minus rate without it. `None` without a valid pair.
    pub difference: Option<f64>,
    /// The interval. The intervals of all families hold together at the confidence level.
    pub interval: Interval,
    /// The two-sided p-value of "no effect" for the least favourable outcome of invalid pairs, adjusted for all families
    /// and looks.
    pub adjusted_p: f64,
}

impl FamilyEffect {
    /// Whether the perturbation is shown to lower the success rate.
    pub fn is_harmful(&self) -> bool {
        self.interval.high < 0.0
    }

    /// Whether the perturbation is shown to raise the success rate.
    pub fn is_beneficial(&self) -> bool {
        self.interval.low > 0.0
    }
}

/// The effects of all families. `looks` is the largest number of times that the run could have been stopped, 1 for a fixed
/// number of pairs.
pub fn paired_effects(families: &[FamilyPairs], confidence: Confidence, looks: u64) -> Vec<FamilyEffect> {
    let count = families.len().max(1) as f64;
    let tail = confidence.tail() / count;
    // The level at which one look at one family is tested.
    let each = Confidence::new(1.0 - 2.0 * single_p(tail, looks)).unwrap_or(confidence);
    families
        .iter()
        .map(|of| {
            let at = |first_only: u64, second_only: u64| -> ScoreDifference {
                let Pairs { first_only: b, second_only: c, .. } = of.valid;
                paired(Pairs { first_only: b + first_only, second_only: c + second_only, ..of.valid }, each)
            };
            let [worst, best] = if of.invalid == 0 { [at(0, 0); 2] } else { [at(0, of.invalid), at(of.invalid, 0)] };
            let one_sided = 0.5 * worst.ln_p.max(best.ln_p).exp();
            // Invalid pairs can even change the sign: then there is no effect for one of their outcomes.
            let opposite = worst.estimate.unwrap_or(0.0) * best.estimate.unwrap_or(0.0) <= 0.0;
            FamilyEffect {
                difference: (of.valid.n() > 0)
                    .then(|| (of.valid.first_only as f64 - of.valid.second_only as f64) / of.valid.n() as f64),
                interval: Interval { low: worst.interval.low, high: best.interval.high },
                adjusted_p: if opposite { 1.0 } else { (2.0 * count * joint_p(one_sided, looks)).min(1.0) },
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    fn pairs(both: u64, first_only: u64, second_only: u64, neither: u64) -> FamilyPairs {
        FamilyPairs { valid: Pairs { both, first_only, second_only, neither }, invalid: 0 }
    }

    #[test]
    fn one_family_is_the_paired_test() {
        let of = pairs(40, 2, 11, 7);
        let [found] = paired_effects(&[of], Confidence::P95, 1)[..] else { panic!("one family") };
        let expected = paired(of.valid, Confidence::P95);
        assert!((found.interval.low - expected.interval.low).abs() < 1e-4);
        assert!((found.interval.high - expected.interval.high).abs() < 1e-4);
        assert!((found.adjusted_p - expected.ln_p.exp()).abs() < 1e-9);
        assert!(found.is_harmful() && !found.is_beneficial());
    }

    #[test]
    fn more_families_and_looks_widen_the_interval() {
        let of = pairs(40, 2, 11, 7);
        let width = |families: usize, looks: u64| {
            let found = paired_effects(&vec![of; families], Confidence::P95, looks)[0];
            assert_eq!(found.adjusted_p <= 0.05, found.is_harmful() || found.is_beneficial(), "{families} {looks}");
            found.interval.high - found.interval.low
        };
        assert!(width(1, 1) < width(1, 5) && width(1, 5) < width(6, 5) && width(1, 1) < width(6, 1));
    }

    #[test]
    fn invalid_pairs_can_hide_an_effect() {
        let mut of = pairs(40, 0, 12, 8);
        assert!(paired_effects(&[of], Confidence::P95, 1)[0].is_harmful());
        of.invalid = 12;
        let found = paired_effects(&[of], Confidence::P95, 1)[0];
        assert!(!found.is_harmful() && found.adjusted_p >= 1.0, "{found:?}");
        assert_eq!(paired_effects(&[FamilyPairs::default()], Confidence::P95, 1)[0].difference, None);
    }

    #[test]
    fn families_without_effect_are_rarely_named() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (sets, mut named) = (60, 0);
        for _ in 0..sets {
            let families: Vec<FamilyPairs> = (0..4)
                .map(|_| {
                    let mut of = FamilyPairs::default();
                    for _ in 0..20 {
                        match (uniform(&mut rng) < 0.8, uniform(&mut rng) < 0.8) {
                            (true, true) => of.valid.both += 1,
                            (true, false) => of.valid.first_only += 1,
                            (false, true) => of.valid.second_only += 1,
                            (false, false) => of.valid.neither += 1,
                        }
                    }
                    of
                })
                .collect();
            let found = paired_effects(&families, Confidence::P95, 1);
            named += u32::from(found.iter().any(|of| of.is_harmful() || of.is_beneficial()));
        }
        // 5 % of 60 is 3, with a standard deviation of 1.7.
        assert!(named <= 8, "{named} of {sets}");
    }
}
