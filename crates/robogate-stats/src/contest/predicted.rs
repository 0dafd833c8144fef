//! One policy against a limit, with predictions of a simulation as a control variate.
//!
//! Each trial has a set-up from the population, and the simulation predicts its success with the probability f. The mean m of the
//! predictions over the population is known. Instead of the outcome Y, the test bets on Y - c (f - m), whose mean is the same for
//! every c. The coefficient c is the slope of a regression of the earlier outcomes on their predictions, shrunk to 0 and between
//! 0 and 1. Because c uses only earlier trials, the capital is a test martingale however wrong the predictions are: a bad
//! simulation costs trials and never validity. The bets are constant shares of the largest possible loss, mixed with equal weights.
//!
//! Limit: m is the mean over the population that the set-ups are drawn from. An estimate of m from few set-ups adds an error that
//! the test does not know. Sources: Waudby-Smith and Ramdas (2024), Journal of the Royal Statistical Society B 86 (betting);
//! Glynn and Szechtman (2002), "Some new perspectives on the method of control variates".

use super::{ContestError, check};
use crate::bounded_mean::ln_mean_exp;
use crate::operating::Answer;

/// The bets, in units of the largest possible loss. Good predictions leave little spread, and large bets then pay.
const BETS: [f64; 6] = [0.15, 0.4, 0.6, 0.75, 0.9, 0.97];
/// The sum of squares that the regression has before the first trial: it shrinks the slope to 0.
const SHRINKAGE: f64 = 0.25;

/// A sequential test of "the success rate is at least a limit" with predictions.
///
/// Call [`Predicted::trial`] after each trial. It may stop at any time.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    limit: f64,
    mean: f64,
    error: f64,
    /// ln of the capital of each bet on "above the limit" and on "below".
    capital: [[f64; BETS.len()]; 2],
    /// The largest capital so far, as ln.
    most: [f64; 2],
    /// The first answer that was reached.
    answer: Answer,
    trials: u64,
    successes: u64,
    /// Sums of (f - m) Y, f - m and (f - m)².
    sums: [f64; 3],
}

impl Predicted {
    /// Plans a test. `mean` is the mean prediction over the population, and `error` the largest probability of each wrong answer.
    ///
    /// # Errors
    /// A limit outside (0, 1), a mean outside [0, 1], or an error outside (0, 0.5).
    pub fn new(limit: f64, mean: f64, error: f64) -> Result<Self, ContestError> {
        check(1, error)?;
        if !(limit > 0.0 && limit < 1.0) {
            return Err(ContestError::Rate(limit));
        }
        if !(0.0..=1.0).contains(&mean) {
            return Err(ContestError::Rate(mean));
        }
        let capital = [[0.0; BETS.len()]; 2];
        let answer = Answer::Open;
        Ok(Self { limit, mean, error, capital, most: [0.0; 2], answer, trials: 0, successes: 0, sums: [0.0; 3] })
    }

    /// Adds a trial: its outcome, and the prediction for its set-up. Returns the answer so far, which is final once it is not
    /// [`Answer::Open`].
    ///
    /// # Errors
    /// A prediction outside [0, 1]. The trial is not added then.
    pub fn trial(&mut self, success: bool, prediction: f64) -> Result<Answer, ContestError> {
        if !(0.0..=1.0).contains(&prediction) {
            return Err(ContestError::Rate(prediction));
        }
        let (c, apart, y) = (self.slope(), prediction - self.mean, f64::from(u8::from(success)));
        let gain = y - self.limit - c * apart;
        // The largest possible loss of a bet on "above", and of one on "below".
        let losses = [self.limit + c * (1.0 - self.mean), 1.0 - self.limit + c * self.mean];
        for ((capital, gain), loss) in self.capital.iter_mut().zip([gain, -gain]).zip(losses) {
            for (ln, bet) in capital.iter_mut().zip(BETS) {
                *ln += (bet / loss * gain).ln_1p();
            }
        }
        for (most, capital) in self.most.iter_mut().zip(&self.capital) {
            *most = most.max(ln_mean_exp(capital));
        }
        self.trials += 1;
        self.successes += u64::from(success);
        for (sum, term) in self.sums.iter_mut().zip([apart * y, apart, apart * apart]) {
            *sum += term;
        }
        let [met, violated] = self.most.map(|ln| ln >= -self.error.ln());
        self.answer = match (self.answer, met, violated) {
            (Answer::Open, true, _) => Answer::Met,
            (Answer::Open, _, true) => Answer::Violated,
            (first, _, _) => first,
        };
        Ok(self.answer)
    }

    /// The answer so far: the first one that was reached.
    pub fn answer(&self) -> Answer {
        self.answer
    }

    /// The p-value of "the rate is at most the limit" and that of "at least", valid after every trial.
    pub fn p_values(&self) -> [f64; 2] {
        self.most.map(|ln| (-ln).exp().min(1.0))
    }

    fn slope(&self) -> f64 {
        let rate = self.successes as f64 / self.trials.max(1) as f64;
        let [with, apart, squared] = self.sums;
        ((with - rate * apart) / (squared + SHRINKAGE)).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_core::SeedableRng;

    use super::*;
    use crate::resample::uniform;

    /// The share of runs with each answer, and the mean number of trials. A part `hard` of the set-ups succeeds at the rate
    /// `rates[0]`, the others at `rates[1]`; `shown` are the predictions for both.
    fn simulated(hard: f64, rates: [f64; 2], shown: [f64; 2], runs: u64) -> ([f64; 2], f64) {
        let mean = hard * shown[0] + (1.0 - hard) * shown[1];
        let (mut answers, mut trials) = ([0.0; 2], 0.0);
        for run in 0..runs {
            let random = &mut ChaCha8Rng::seed_from_u64(run);
            let mut test = Predicted::new(0.8, mean, 0.05).unwrap();
            while test.answer() == Answer::Open && test.trials < 300 {
                let at = usize::from(uniform(random) >= hard);
                test.trial(uniform(random) < rates[at], shown[at]).unwrap();
            }
            trials += test.trials as f64;
            match test.answer() {
                Answer::Met => answers[0] += 1.0,
                Answer::Violated => answers[1] += 1.0,
                Answer::Open => {}
            }
        }
        (answers.map(|n| n / runs as f64), trials / runs as f64)
    }

    // The true rate of a set-up correlates 0.6 and 0.8 with its outcomes. The rate is 92 % in both populations.
    const GOOD: [(f64, [f64; 2]); 2] = [(0.19, [0.58, 1.0]), (0.12, [0.32, 1.0])];

    #[test]
    fn good_predictions_save_trials() {
        for ((hard, rates), share) in GOOD.into_iter().zip([0.82, 0.75]) {
            let alone = simulated(hard, rates, [0.5; 2], 1_000);
            let with = simulated(hard, rates, rates, 1_000);
            assert!(with.1 <= share * alone.1 && with.0[0] >= alone.0[0], "{with:?} instead of {alone:?}");
        }
    }

    #[test]
    fn misleading_predictions_cost_little() {
        let (hard, rates) = GOOD[0];
        let alone = simulated(hard, rates, [0.5; 2], 1_000);
        let turned = simulated(hard, rates, [1.0, 0.2], 1_000);
        assert!(turned.1 <= 1.03 * alone.1, "{turned:?} instead of {alone:?}");
    }

    #[test]
    fn errors_hold_whatever_is_predicted() {
        for shown in [[0.2, 1.0], [1.0, 0.2], [0.5, 0.5], [0.0, 1.0]] {
            // The rate is 80 %, the limit.
            let (answers, _) = simulated(0.25, [0.5, 0.9], shown, 1_000);
            assert!(answers.iter().all(|share| *share <= 0.06), "{shown:?}: {answers:?}");
        }
    }

    #[test]
    fn first_answer_is_final() {
        let mut test = Predicted::new(0.8, 0.5, 0.05).unwrap();
        while test.answer() == Answer::Open {
            test.trial(false, 0.5).unwrap();
        }
        for _ in 0..1_000 {
            assert_eq!(test.trial(true, 0.5), Ok(Answer::Violated));
        }
        // Later trials would show the opposite.
        assert!(test.p_values()[0] <= 0.05, "{test:?}");
    }

    #[test]
    fn unusable_numbers_are_rejected() {
        assert_eq!(Predicted::new(1.0, 0.5, 0.05), Err(ContestError::Rate(1.0)));
        assert!(Predicted::new(0.8, f64::NAN, 0.05).is_err() && Predicted::new(0.8, 0.5, 0.0).is_err());
        let mut test = Predicted::new(0.8, 0.5, 0.05).unwrap();
        assert_eq!(test.trial(true, 1.5), Err(ContestError::Rate(1.5)));
        assert_eq!((test.trials, test.answer(), test.p_values()), (0, Answer::Open, [1.0; 2]));
    }
}
