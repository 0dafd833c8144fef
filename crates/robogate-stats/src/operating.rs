//! Operating characteristics of a gate on one rate, computed before anything runs.
//!
//! A requirement "at least p₀" is met once it is shown at error α, and violated once the contrary is shown at error β. With a
//! fixed number of trials both are exact binomial tests at its end; in rounds both are the tests of
//! [`crate::anytime`] after each round, and the first that answers ends it. The probabilities follow exactly, by carrying
//! the distribution of the number of successes from round to round.
//!
//! Limit: every trial has the same chance p. Rounds of different scenarios with that mean vary less, so the figures are those
//! of the suite with the largest variance.

use crate::anytime::{ln_evidence_above, ln_evidence_below};
use crate::compare::{at_least, at_most};
use crate::interval::Trials;
use robogate_maths::beta::ln_binomial_pmf;

/// How many trials there will be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schedule {
    /// This many, judged once.
    Fixed {
        /// Trials.
        n: u64,
    },
    /// Rounds, judged after each.
    Rounds {
        /// Trials in a round.
        per_round: u64,
        /// At most this many rounds.
        rounds: u64,
    },
}

/// A demand on a rate and its two error probabilities. "At most" is "at least" of the failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateTest {
    /// The rate must be at least this.
    pub at_least: f64,
    /// Largest probability of "met" where it is not.
    pub alpha: f64,
    /// Largest probability of "violated" where it is met.
    pub beta: f64,
}

/// What one test on a rate says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The demand is shown to hold.
    Met,
    /// The contrary is shown.
    Violated,
    /// Neither.
    Open,
}

impl RateTest {
    /// After a fixed number of trials.
    pub fn fixed(&self, trials: Trials) -> Answer {
        self.answer(at_least(trials, self.at_least), at_most(trials, self.at_least))
    }

    /// At one look among any number.
    pub fn look(&self, trials: Trials) -> Answer {
        self.answer(-ln_evidence_above(trials, self.at_least), -ln_evidence_below(trials, self.at_least))
    }

    fn answer(&self, ln_p_met: f64, ln_p_violated: f64) -> Answer {
        if ln_p_met <= self.alpha.ln() {
            Answer::Met
        } else if ln_p_violated <= self.beta.ln() {
            Answer::Violated
        } else {
            Answer::Open
        }
    }

    /// The fewest trials after which it can be met at all: every one a success. `None` beyond `most`.
    pub fn fewest(&self, schedule: Schedule, most: u64) -> Option<u64> {
        let met = |n: u64| {
            let all = Trials::new(n, n).unwrap_or(Trials::NONE);
            match schedule {
                Schedule::Fixed { .. } => self.fixed(all) == Answer::Met,
                Schedule::Rounds { .. } => self.look(all) == Answer::Met,
            }
        };
        if !met(most) {
            return None;
        }
        // All-success evidence grows with every trial.
        let (mut open, mut done) = (0, most);
        while done - open > 1 {
            let middle = open + (done - open) / 2;
            if met(middle) { done = middle } else { open = middle }
        }
        Some(done)
    }
}

/// What happens with which probability.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Characteristic {
    /// Of "met".
    pub met: f64,
    /// Of "violated".
    pub violated: f64,
    /// Of neither at the end.
    pub open: f64,
    /// Expected number of trials.
    pub trials: f64,
}

/// What the test does under `schedule` if the true rate is `p`.
pub fn characteristic(test: RateTest, schedule: Schedule, p: f64) -> Characteristic {
    let p = p.clamp(0.0, 1.0);
    let (per_round, rounds, fixed) = match schedule {
        Schedule::Fixed { n } => (n, 1, true),
        Schedule::Rounds { per_round, rounds } => (per_round, rounds, false),
    };
    let step: Vec<f64> = (0..=per_round).map(|k| mass(k, per_round, p)).collect();
    let mut going = vec![1.0];
    let mut out = Characteristic { met: 0.0, violated: 0.0, open: 1.0, trials: 0.0 };
    for round in 1..=rounds {
        out.trials += out.open * per_round as f64;
        let n = round * per_round;
        let mut next = vec![0.0; going.len() + per_round as usize];
        for (k, probability) in going.iter().enumerate().filter(|(_, m)| **m > 0.0) {
            for (j, s) in step.iter().enumerate() {
                next[k + j] += probability * s;
            }
        }
        out.open = 0.0;
        for (k, probability) in next.iter_mut().enumerate() {
            let trials = Trials::new(k as u64, n).unwrap_or(Trials::NONE);
            match if fixed { test.fixed(trials) } else { test.look(trials) } {
                Answer::Met => out.met += std::mem::take(probability),
                Answer::Violated => out.violated += std::mem::take(probability),
                Answer::Open => out.open += *probability,
            }
        }
        going = next;
    }
    out
}

/// Binomial mass, also at the ends of p.
fn mass(k: u64, n: u64, p: f64) -> f64 {
    if p <= 0.0 {
        f64::from(u8::from(k == 0))
    } else if p >= 1.0 {
        f64::from(u8::from(k == n))
    } else {
        ln_binomial_pmf(k as f64, n as f64, p).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GATE: RateTest = RateTest { at_least: 0.92, alpha: 0.05, beta: 0.05 };
    const ROUNDS: Schedule = Schedule::Rounds { per_round: 68, rounds: 20 };

    #[test]
    fn probabilities_sum_to_one() {
        for schedule in [ROUNDS, Schedule::Fixed { n: 500 }] {
            for i in 0..=20 {
                let c = characteristic(GATE, schedule, f64::from(i) / 20.0);
                assert!((c.met + c.violated + c.open - 1.0).abs() < 1e-10, "{c:?}");
            }
        }
    }

    #[test]
    fn neither_error_exceeds_its_level_at_the_limit() {
        for schedule in [ROUNDS, Schedule::Fixed { n: 68 }, Schedule::Fixed { n: 1_360 }] {
            let c = characteristic(GATE, schedule, 0.92);
            assert!(c.met <= 0.05 && c.violated <= 0.05, "{schedule:?} {c:?}");
        }
    }

    #[test]
    fn a_perfect_policy_needs_36_trials_of_a_fixed_number_and_few_more_with_looks() {
        assert_eq!(GATE.fewest(Schedule::Fixed { n: 0 }, 10_000), Some(36));
        let looking = GATE.fewest(ROUNDS, 10_000).unwrap();
        assert!((37..=68).contains(&looking), "{looking}");
        assert_eq!(characteristic(GATE, ROUNDS, 1.0).trials, 68.0);
    }

    #[test]
    fn a_demand_of_certainty_is_never_met() {
        assert_eq!(RateTest { at_least: 1.0, ..GATE }.fewest(ROUNDS, 1_000_000), None);
    }
}
