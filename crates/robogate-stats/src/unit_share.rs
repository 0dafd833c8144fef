//! Share of the units of a fleet that meet their requirements, from verdicts on a sample of units.
//!
//! Each unit is judged on finitely many episodes. The verdict "meets" is wrong with a probability of at most α for a unit
//! that does not meet the requirements, "violates" with at most α for one that does, and a unit may stay undecided. Let π
//! be the share of units that meet them, and p the probability that a random unit is judged "meets". Then
//!
//! p ≤ π + α (1 - π), so π ≥ (p - α) / (1 - α),
//!
//! and likewise for "violates". [`unit_share`] replaces both probabilities by exact (Clopper-Pearson) bounds. The interval
//! is valid for any distribution of units, any rule by which a unit stays undecided, and any number of units. Undecided
//! units widen it: they may be either.
//!
//! Limit: units must be independent draws from one population, and so must be their episodes.
//! Sources: Rogan and Gladen (1978), American Journal of Epidemiology 107, for the correction; Manski (2003), Partial
//! Identification of Probability Distributions, for undecided units; Clopper and Pearson (1934), Biometrika 26(4).

use crate::{Confidence, Interval, Trials, clopper_pearson};

/// The numbers of units by verdict.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct UnitVerdicts {
    /// Units that are judged to meet the requirements.
    pub meets: u64,
    /// Units that are judged to violate them.
    pub violates: u64,
    /// Units without a decision.
    pub undecided: u64,
}

impl UnitVerdicts {
    /// The number of units.
    pub fn units(self) -> u64 {
        self.meets + self.violates + self.undecided
    }
}

/// The interval of the share of units that meet the requirements. `error` is the largest probability of a wrong verdict, in
/// [0, 1). Without units, or with an `error` outside this range, it is [0, 1].
pub fn unit_share(verdicts: UnitVerdicts, error: f64, confidence: Confidence) -> Interval {
    if !(0.0..1.0).contains(&error) {
        return Interval { low: 0.0, high: 1.0 };
    }
    let at_least = |units: u64| {
        let bound = clopper_pearson(Trials::new(units, verdicts.units()).unwrap_or(Trials::NONE), confidence).low;
        ((bound - error) / (1.0 - error)).clamp(0.0, 1.0)
    };
    let (low, high) = (at_least(verdicts.meets), 1.0 - at_least(verdicts.violates));
    // Both bounds hold together with the stated confidence. They can only cross if more verdicts are wrong than `error` allows.
    Interval { low: low.min(high), high: high.max(low) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::{binomial, uniform};
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    fn share(meets: u64, violates: u64, undecided: u64, error: f64) -> Interval {
        unit_share(UnitVerdicts { meets, violates, undecided }, error, Confidence::P95)
    }

    #[test]
    fn without_errors_it_is_exact_interval() {
        let exact = clopper_pearson(Trials::new(17, 20).unwrap(), Confidence::P95);
        let ours = share(17, 3, 0, 0.0);
        assert!((ours.low - exact.low).abs() < 1e-12 && (ours.high - exact.high).abs() < 1e-12, "{ours:?}");
    }

    #[test]
    fn undecided_units_and_errors_widen_interval() {
        let (exact, undecided, wrong) = (share(17, 3, 0, 0.0), share(15, 1, 4, 0.0), share(17, 3, 0, 0.05));
        assert!(undecided.low < exact.low && undecided.high > exact.high);
        assert!(wrong.low < exact.low && wrong.high > exact.high);
        let nothing = share(0, 0, 20, 0.05);
        assert!(nothing.low <= 0.0 && nothing.high >= 1.0);
        assert!(share(0, 0, 0, 0.05).high >= 1.0 && share(3, 0, 0, f64::NAN).low <= 0.0);
    }

    /// The verdict on a unit whose success rate must be at least `limit`: two exact one-sided tests of level `error`.
    fn judge(successes: u64, episodes: u64, limit: f64, error: f64) -> UnitVerdicts {
        let level = Confidence::new(1.0 - 2.0 * error).unwrap();
        let interval = clopper_pearson(Trials::new(successes, episodes).unwrap(), level);
        let (meets, violates) = (u64::from(interval.low >= limit), u64::from(interval.high < limit));
        UnitVerdicts { meets, violates, undecided: 1 - meets - violates }
    }

    /// Simulated fleets: the interval must contain the true share at least as often as stated. The hardest populations have
    /// many units just below and just above the limit, whose verdicts are wrong as often as the test allows.
    #[test]
    fn interval_covers_true_share() {
        const FLEETS: u64 = 1_000;
        let (limit, error) = (0.9, 0.05);
        // Success rates of the units with their shares, and the episodes of each unit.
        let populations: [(&[(f64, f64)], u64); 5] = [
            (&[(0.98, 0.8), (0.7, 0.2)], 200),
            (&[(0.95, 0.5), (0.85, 0.5)], 60),
            (&[(0.9, 0.5), (0.8999, 0.5)], 300),
            (&[(0.8999, 1.0)], 500),
            (&[(0.9, 1.0)], 500),
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(16);
        for (population, episodes) in populations {
            let verdict_of: Vec<UnitVerdicts> = (0..=episodes).map(|k| judge(k, episodes, limit, error)).collect();
            let truth: f64 = population.iter().filter(|(rate, _)| *rate >= limit).map(|(_, share)| share).sum();
            for units in [5, 20, 60] {
                let mut covered = 0;
                for _ in 0..FLEETS {
                    let mut verdicts = UnitVerdicts::default();
                    for _ in 0..units {
                        let mut u = uniform(&mut rng);
                        let drawn = population.iter().find(|(_, share)| {
                            u -= share;
                            u < 0.0
                        });
                        let rate = drawn.unwrap_or(&population[0]).0;
                        let one = verdict_of[binomial(&mut rng, episodes, rate) as usize];
                        verdicts.meets += one.meets;
                        verdicts.violates += one.violates;
                        verdicts.undecided += one.undecided;
                    }
                    let interval = unit_share(verdicts, error, Confidence::P95);
                    covered += u64::from(interval.low - 1e-12 <= truth && truth <= interval.high + 1e-12);
                }
                // Three standard errors of 1,000 fleets below 95 %.
                assert!(covered as f64 / FLEETS as f64 > 0.929, "{population:?}, {units} units: {covered} of {FLEETS}");
            }
        }
    }
}
