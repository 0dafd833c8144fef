//! Paired effects of several families of perturbations: the difference of two success rates on the same scenarios, for each
//! family, with intervals that hold together.
//!
//! Each difference has the score test of [`crate::difference::paired`] (exact for few pairs). Bonferroni's adjustment covers
//! the families, so that intervals and p-values agree: an interval excludes 0 if its adjusted p-value is at most the error.
//! If a run was tested after each of several rounds, the number of pairs depends on the results. The error of each look
//! is then that of [`crate::group_sequential`], which holds for all of them together.
//!
//! Several perturbed episodes of a family can share a twin, for example with several severities of one perturbation. Their
//! pairs are dependent, so each twin is one observation: the mean difference of its pairs. The test and the interval are
//! Student's, with n - 1 degrees of freedom for n twins. The differences of rare failures often have no spread, and
//! Student's interval alone covered 10 to 90 % in simulations instead of 95 %. The sum of their squared deviations is
//! therefore at least 2, as if two twins differed from the others.
//! Bonferroni's adjustment also holds for families that share their twins, because it holds for any dependence.
//!
//! A pair with an invalid episode could have had any result. The interval covers all of them.

use robogate_maths::beta::{ln_student_two_sided, student_quantile};

use crate::compare::Pairs;
use crate::difference::paired;
use crate::group_sequential::{joint_p, single_p};
use crate::interval::{Confidence, Interval};

/// Smallest sum of squared deviations of the differences of twins.
const LEAST_SQUARES: f64 = 2.0;

/// The pairs of one family. The first of a pair is the perturbed episode, the second its twin without the perturbation.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FamilyPairs {
    /// Pairs of valid episodes.
    pub valid: Pairs,
    /// Pairs with an invalid episode.
    pub invalid: u64,
    /// All pairs by twin, if a twin has several. Empty if each pair has its own twin.
    pub shared: Vec<SharedTwin>,
}

impl FamilyPairs {
    /// Twins of valid pairs. 0 if each pair has its own twin.
    pub fn shared_twins(&self) -> u64 {
        self.shared.iter().filter(|twin| twin.difference().is_some()).count() as u64
    }
}

/// A twin and the perturbed episodes that are compared with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SharedTwin {
    /// Whether the twin succeeded. `None` if it is invalid.
    nominal: Option<bool>,
    successes: u64,
    failures: u64,
    invalid: u64,
}

impl SharedTwin {
    /// A twin without perturbed episodes. `nominal` is whether it succeeded, `None` if it is invalid.
    pub fn new(nominal: Option<bool>) -> Self {
        Self { nominal, successes: 0, failures: 0, invalid: 0 }
    }

    /// Adds a perturbed episode: whether it succeeded, `None` if it is invalid.
    pub fn add(&mut self, perturbed: Option<bool>) {
        match perturbed {
            Some(true) => self.successes += 1,
            Some(false) => self.failures += 1,
            None => self.invalid += 1,
        }
    }

    /// Perturbed episodes.
    pub fn episodes(&self) -> u64 {
        self.successes + self.failures + self.invalid
    }

    /// The mean difference of the valid pairs. `None` without a valid pair.
    fn difference(&self) -> Option<f64> {
        let valid = self.successes + self.failures;
        let nominal = self.nominal.filter(|_| valid > 0)?;
        Some(self.successes as f64 / valid as f64 - f64::from(nominal))
    }

    /// The smallest and the largest mean difference for the possible outcomes of invalid episodes.
    fn range(&self) -> [f64; 2] {
        let rate = |successes: u64| successes as f64 / self.episodes().max(1) as f64;
        let [least, most] = self.nominal.map_or([0.0, 1.0], |success| [f64::from(success); 2]);
        [rate(self.successes) - most, rate(self.successes + self.invalid) - least]
    }
}

/// The effect of one family.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FamilyEffect {
    /// Rate with the perturbation minus rate without it, as a mean over twins if pairs share them. `None` without a valid pair.
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
            let Tested { difference, interval, one_sided } =
                if of.shared.is_empty() { by_pair(of, each) } else { by_twin(&of.shared, each) };
            FamilyEffect {
                difference,
                interval,
                adjusted_p: one_sided.map_or(1.0, |p| (2.0 * count * joint_p(p, looks)).min(1.0)),
            }
        })
        .collect()
}

/// One family at one look, before the adjustment.
struct Tested {
    difference: Option<f64>,
    interval: Interval,
    /// The one-sided p-value of "no effect". `None` if there is no effect for some outcome of invalid pairs.
    one_sided: Option<f64>,
}

/// The paired test of pairs that each have their own twin.
fn by_pair(of: &FamilyPairs, each: Confidence) -> Tested {
    let Pairs { first_only: b, second_only: c, .. } = of.valid;
    let at = |first_only: u64, second_only: u64| {
        paired(Pairs { first_only: b + first_only, second_only: c + second_only, ..of.valid }, each)
    };
    let [worst, best] = if of.invalid == 0 { [at(0, 0); 2] } else { [at(0, of.invalid), at(of.invalid, 0)] };
    // Invalid pairs can even change the sign: then there is no effect for one of their outcomes.
    let opposite = worst.estimate.unwrap_or(0.0) * best.estimate.unwrap_or(0.0) <= 0.0;
    Tested {
        difference: (of.valid.n() > 0).then(|| (b as f64 - c as f64) / of.valid.n() as f64),
        interval: Interval { low: worst.interval.low, high: best.interval.high },
        one_sided: (!opposite).then(|| 0.5 * worst.ln_p.max(best.ln_p).exp()),
    }
}

/// Student's test of the mean differences of the twins.
fn by_twin(twins: &[SharedTwin], each: Confidence) -> Tested {
    let differences: Vec<f64> = twins.iter().filter_map(SharedTwin::difference).collect();
    let difference = (!differences.is_empty()).then(|| mean(&differences));
    if twins.len() < 2 {
        return Tested { difference, interval: Interval { low: -1.0, high: 1.0 }, one_sided: None };
    }
    let (worst, best): (Vec<f64>, Vec<f64>) =
        twins.iter().map(SharedTwin::range).map(|[low, high]| (low, high)).unzip();
    let (low, high) = (mean(&worst), mean(&best));
    // No outcome of invalid pairs has a larger sum of squares around its own mean than this one around another centre.
    let centre = 0.5 * (low + high);
    let squares: f64 =
        worst.iter().zip(&best).map(|(low, high)| (low - centre).powi(2).max((high - centre).powi(2))).sum();
    let n = twins.len() as f64;
    let error = (squares.max(LEAST_SQUARES) / (n * (n - 1.0))).sqrt();
    let half = student_quantile(n - 1.0, each.level()) * error;
    let nearest = if low > 0.0 { low } else { high };
    Tested {
        difference,
        interval: Interval { low: (low - half).max(-1.0), high: (high + half).min(1.0) },
        one_sided: (low > 0.0 || high < 0.0).then(|| 0.5 * ln_student_two_sided(n - 1.0, nearest / error).exp()),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    fn pairs(both: u64, first_only: u64, second_only: u64, neither: u64) -> FamilyPairs {
        FamilyPairs { valid: Pairs { both, first_only, second_only, neither }, ..FamilyPairs::default() }
    }

    #[test]
    fn one_family_is_the_paired_test() {
        let of = pairs(40, 2, 11, 7);
        let [found] = paired_effects(std::slice::from_ref(&of), Confidence::P95, 1)[..] else { panic!("one family") };
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
            let found = paired_effects(&vec![of.clone(); families], Confidence::P95, looks)[0];
            assert_eq!(found.adjusted_p <= 0.05, found.is_harmful() || found.is_beneficial(), "{families} {looks}");
            found.interval.high - found.interval.low
        };
        assert!(width(1, 1) < width(1, 5) && width(1, 5) < width(6, 5) && width(1, 1) < width(6, 1));
    }

    #[test]
    fn invalid_pairs_can_hide_an_effect() {
        let mut of = pairs(40, 0, 12, 8);
        assert!(paired_effects(std::slice::from_ref(&of), Confidence::P95, 1)[0].is_harmful());
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

    /// A family of `twins` twins with `episodes` perturbed episodes each.
    fn sharing(twins: usize, episodes: usize, mut outcomes: impl FnMut(usize) -> (bool, Vec<bool>)) -> FamilyPairs {
        let shared = (0..twins).map(|at| {
            let (nominal, perturbed) = outcomes(at);
            assert_eq!(perturbed.len(), episodes);
            let mut twin = SharedTwin::new(Some(nominal));
            perturbed.into_iter().for_each(|success| twin.add(Some(success)));
            twin
        });
        FamilyPairs { shared: shared.collect(), ..FamilyPairs::default() }
    }

    fn effect(of: FamilyPairs, looks: u64) -> FamilyEffect {
        paired_effects(&[of], Confidence::P95, looks)[0]
    }

    #[test]
    fn a_shared_twin_counts_once() {
        // Half of 40 twins lose both of their episodes: Student's interval of 20 differences of -1 and 20 of 0.
        let of = sharing(40, 2, |at| (true, vec![at % 2 == 0; 2]));
        let found = effect(of.clone(), 1);
        assert_eq!((of.shared_twins(), found.difference), (40, Some(-0.5)));
        let half = 2.022_691 * (10.0_f64 / (40.0 * 39.0)).sqrt();
        assert!((found.interval.low + 0.5 + half).abs() < 1e-5 && (found.interval.high + 0.5 - half).abs() < 1e-5);
        assert!(found.is_harmful() && found.adjusted_p < 1e-5, "{found:?}");
        assert!(effect(of, 5).interval.high > found.interval.high);
        let one = effect(sharing(1, 9, |_| (true, vec![false; 9])), 1);
        assert_eq!((one.difference, one.interval), (Some(-1.0), Interval { low: -1.0, high: 1.0 }));
        assert!(one.adjusted_p >= 1.0);
    }

    #[test]
    fn invalid_episodes_of_shared_twins_widen_the_interval() {
        let mut of = sharing(40, 2, |at| (true, vec![at % 2 == 0; 2]));
        let without = effect(of.clone(), 1).interval;
        of.shared.iter_mut().take(3).for_each(|twin| twin.add(None));
        let some = effect(of.clone(), 1);
        assert!(some.interval.low < without.low && some.interval.high > without.high && some.is_harmful());
        of.shared.iter_mut().for_each(|twin| twin.nominal = None);
        let all = effect(of.clone(), 1);
        assert_eq!((of.shared_twins(), all.difference), (0, None));
        assert!(!all.is_harmful() && !all.is_beneficial() && all.adjusted_p >= 1.0, "{all:?}");
    }

    #[test]
    fn variants_of_one_twin_are_not_independent() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let (sets, mut named, mut covered) = (2_000, 0, 0);
        for _ in 0..sets {
            // No effect: all outcomes have the same rate, but five episodes share the luck of their twin.
            let mut draw = || uniform(&mut rng) < 0.8;
            let none = effect(sharing(40, 5, |_| (draw(), (0..5).map(|_| draw()).collect())), 1);
            named += u32::from(none.is_harmful() || none.is_beneficial());
            // A rare one: all episodes of a twin fail together.
            let rare = effect(sharing(40, 5, |_| (true, vec![uniform(&mut rng) < 0.98; 5])), 1);
            covered += u32::from(rare.interval.low <= -0.02 && rare.interval.high >= -0.02);
        }
        // Five independent pairs for each twin would name 23 %; Student's interval alone would cover 55 %.
        assert!(named <= 150 && covered >= 1_880, "{named} named and {covered} covered of {sets}");
    }
}
