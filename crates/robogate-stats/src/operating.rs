//! Operating characteristics of a gate on one rate, computed before any episode runs.
//!
//! A requirement "at least p₀" is met once it is shown at error α, and violated once the opposite is shown at error β.
//! With a fixed number of trials, both are exact binomial tests at the end. In rounds, both are the tests of
//! [`crate::stratified`] after each round, or those of [`crate::budgeted`] if the largest number of rounds is known, and the
//! first decision ends the run. The probabilities are exact: the
//! distribution of the number of successes is propagated from round to round.
//!
//! Only the pooled part of that test is computed, so scenarios with different rates are decided no later.
//!
//! Limit: every trial has the same success probability p. Rounds of different scenarios with the same mean vary less,
//! so the figures apply to the suite with the largest variance.

use crate::budgeted::Budget;
use crate::compare::{at_least, at_most};
use crate::interval::Trials;
use crate::stratified::{ln_pooled_part_above, ln_pooled_part_below};
use robogate_maths::beta::ln_binomial_pmf;

/// The number of trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schedule {
    /// A fixed number, evaluated once.
    Fixed {
        /// Trials.
        n: u64,
    },
    /// Rounds, evaluated after each.
    Rounds {
        /// Trials in a round.
        per_round: u64,
        /// At most this many rounds.
        rounds: u64,
    },
    /// Rounds, evaluated after each, with a largest number that is fixed before the first ([`crate::budgeted`]).
    Budget(Budget),
}

/// A requirement on a rate, with its two error probabilities. Express "at most" as "at least" of the failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateTest {
    /// The smallest accepted rate.
    pub at_least: f64,
    /// Largest probability of "met" if the requirement does not hold.
    pub alpha: f64,
    /// Largest probability of "violated" if the requirement holds.
    pub beta: f64,
}

/// The result of one test on a rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The requirement is shown to hold.
    Met,
    /// The requirement is shown to be violated.
    Violated,
    /// Undecided.
    Open,
}

impl RateTest {
    /// The result after a fixed number of trials.
    pub fn fixed(&self, trials: Trials) -> Answer {
        self.answer(at_least(trials, self.at_least), at_most(trials, self.at_least))
    }

    /// The result at one of any number of looks.
    pub fn look(&self, trials: Trials) -> Answer {
        self.answer(-ln_pooled_part_above(trials, self.at_least), -ln_pooled_part_below(trials, self.at_least))
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

    /// The smallest number of trials after which the requirement can be met, if all succeed. `None` above `most`.
    pub fn fewest(&self, schedule: Schedule, most: u64) -> Option<u64> {
        if let Schedule::Budget(budget) = schedule {
            let boundary = budget.boundary(self.at_least, self.alpha);
            let rounds = (1..).map(|round| round * budget.per_round).zip(&boundary);
            // A test of fewer trials than the first that a perfect policy passes cannot exist in any budget.
            let within = rounds.into_iter().find(|(n, needed)| *needed <= n).map(|(n, _)| n);
            return within.or_else(|| self.fewest(Schedule::Fixed { n: 0 }, most));
        }
        let met = |n: u64| {
            let all = Trials::new(n, n).unwrap_or(Trials::NONE);
            match schedule {
                Schedule::Fixed { .. } => self.fixed(all) == Answer::Met,
                _ => self.look(all) == Answer::Met,
            }
        };
        if !met(most) {
            return None;
        }
        // The evidence of an all-success sequence increases with every trial.
        let (mut open, mut done) = (0, most);
        while done - open > 1 {
            let middle = open + (done - open) / 2;
            if met(middle) { done = middle } else { open = middle }
        }
        Some(done)
    }
}

/// The probabilities of the results.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Characteristic {
    /// Probability of "met".
    pub met: f64,
    /// Probability of "violated".
    pub violated: f64,
    /// Probability of no decision at the end.
    pub open: f64,
    /// Expected number of trials.
    pub trials: f64,
}

/// Computes the characteristic of the test under `schedule` if the true rate is `p`.
pub fn characteristic(test: RateTest, schedule: Schedule, p: f64) -> Characteristic {
    of_rate(&mut Answers::new(test, schedule), p)
}

/// [`characteristic`] for several true rates. The answers of the test, which cost most, are computed once for all rates.
pub fn characteristics(test: RateTest, schedule: Schedule, rates: &[f64]) -> Vec<Characteristic> {
    let mut answers = Answers::new(test, schedule);
    rates.iter().map(|p| of_rate(&mut answers, *p)).collect()
}

/// The answers of a test after each round. They depend on the counts alone, not on the true rate.
struct Answers {
    test: RateTest,
    fixed: bool,
    /// The answers, if the number of rounds is known.
    boundaries: Option<Boundaries>,
    per_round: u64,
    /// For each round and number of successes.
    known: Vec<Vec<Option<Answer>>>,
}

/// The answers of a test with a known largest number of rounds.
#[derive(Debug, Clone)]
pub struct Boundaries {
    budget: Budget,
    met: Vec<u64>,
    violated: Vec<u64>,
}

impl Boundaries {
    /// Computes the answers once for all counts.
    pub fn new(test: RateTest, budget: Budget) -> Self {
        let (met, violated) =
            (budget.boundary(test.at_least, test.alpha), budget.boundary(1.0 - test.at_least, test.beta));
        Self { budget, met, violated }
    }

    /// The answer after complete rounds within the budget. Undecided for any other number of trials.
    pub fn look(&self, trials: Trials) -> Answer {
        let round = (trials.n() / self.budget.per_round.max(1)) as usize;
        match (self.met.get(round.wrapping_sub(1)), self.violated.get(round.wrapping_sub(1))) {
            (Some(met), _) if trials.successes() >= *met => Answer::Met,
            (_, Some(violated)) if trials.failures() >= *violated => Answer::Violated,
            _ => Answer::Open,
        }
    }
}

impl Answers {
    fn new(test: RateTest, schedule: Schedule) -> Self {
        let (per_round, rounds, fixed) = match schedule {
            Schedule::Fixed { n } => (n, 1, true),
            Schedule::Rounds { per_round, rounds } | Schedule::Budget(Budget { per_round, rounds }) => {
                (per_round, rounds, false)
            }
        };
        let boundaries = match schedule {
            Schedule::Budget(budget) => Some(Boundaries::new(test, budget)),
            Schedule::Fixed { .. } | Schedule::Rounds { .. } => None,
        };
        let known = (1..=rounds).map(|round| vec![None; (round * per_round) as usize + 1]).collect();
        Self { test, fixed, boundaries, per_round, known }
    }

    /// The answer with `k` successes after the round with the index `round`.
    fn get(&mut self, round: usize, k: usize) -> Answer {
        let (test, fixed, n) = (self.test, self.fixed, (round as u64 + 1) * self.per_round);
        if let Some(boundaries) = &self.boundaries {
            return boundaries.look(Trials::new(k as u64, n).unwrap_or(Trials::NONE));
        }
        *self.known[round][k].get_or_insert_with(|| {
            let trials = Trials::new(k as u64, n).unwrap_or(Trials::NONE);
            if fixed { test.fixed(trials) } else { test.look(trials) }
        })
    }
}

fn of_rate(answers: &mut Answers, p: f64) -> Characteristic {
    let p = p.clamp(0.0, 1.0);
    let per_round = answers.per_round;
    let step: Vec<f64> = (0..=per_round).map(|k| mass(k, per_round, p)).collect();
    let mut going = vec![1.0];
    let mut out = Characteristic { met: 0.0, violated: 0.0, open: 1.0, trials: 0.0 };
    for round in 0..answers.known.len() {
        out.trials += out.open * per_round as f64;
        let mut next = vec![0.0; going.len() + per_round as usize];
        for (k, probability) in going.iter().enumerate().filter(|(_, m)| **m > 0.0) {
            for (j, s) in step.iter().enumerate() {
                next[k + j] += probability * s;
            }
        }
        out.open = 0.0;
        for (k, probability) in next.iter_mut().enumerate() {
            match answers.get(round, k) {
                Answer::Met => out.met += std::mem::take(probability),
                Answer::Violated => out.violated += std::mem::take(probability),
                Answer::Open => out.open += *probability,
            }
        }
        going = next;
    }
    out
}

/// Binomial probability mass, also for p = 0 and p = 1.
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
    fn errors_keep_their_levels() {
        for schedule in [ROUNDS, Schedule::Fixed { n: 68 }, Schedule::Fixed { n: 1_360 }] {
            let c = characteristic(GATE, schedule, 0.92);
            assert!(c.met <= 0.05 && c.violated <= 0.05, "{schedule:?} {c:?}");
        }
    }

    #[test]
    fn perfect_policy_needs_few_trials() {
        assert_eq!(GATE.fewest(Schedule::Fixed { n: 0 }, 10_000), Some(36));
        let looking = GATE.fewest(ROUNDS, 10_000).unwrap();
        assert!((37..=68).contains(&looking), "{looking}");
        assert_eq!(characteristic(GATE, ROUNDS, 1.0).trials, 68.0);
    }

    #[test]
    fn shared_answers_change_no_figure() {
        for schedule in [Schedule::Rounds { per_round: 17, rounds: 6 }, Schedule::Fixed { n: 90 }] {
            let rates = [1.0, 0.98, 0.92, 0.8, 0.0];
            let each = rates.map(|p| characteristic(GATE, schedule, p));
            assert_eq!(characteristics(GATE, schedule, &rates), each);
        }
    }

    #[test]
    fn rate_of_one_is_never_met() {
        assert_eq!(RateTest { at_least: 1.0, ..GATE }.fewest(ROUNDS, 1_000_000), None);
    }
}
