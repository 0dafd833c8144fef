//! The risk model: two learners, their mean chosen by cross-validation, and its calibration.

use std::num::NonZeroUsize;
use std::sync::Arc;

use robogate_core::{Assignment, Fault, Scenario, Seed};
use robogate_stats::boosting::{Boosting, BoostingError, Options};
use robogate_stats::logistic::{Data, RegressionError};
use robogate_stats::ridge;
use robogate_stats::spline_logistic::SplineLogistic;

use crate::{Inputs, in_parallel};

/// Number of parts of the cross-validation.
const FOLDS: usize = 5;

/// The shares of the boosting among which cross-validation chooses.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// Prior variance of the calibration line, which hardly shrinks it.
const WEAK: f64 = 100.0;

/// An episode for training: its scenario and whether it succeeded.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The scenario.
    pub scenario: Scenario,
    /// Whether the episode succeeded.
    pub success: bool,
}

/// A learner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Learner {
    /// The mean of both learners that predicts best in cross-validation.
    #[default]
    Chosen,
    /// Monotone gradient boosting alone.
    Boosting,
    /// Ridge logistic regression on splines and products alone.
    Splines,
}

/// How a model is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fitting {
    /// The learner.
    pub learner: Learner,
    /// Smallest number of episodes of each outcome.
    pub least: usize,
    /// Largest number of threads. The model does not depend on it.
    pub threads: NonZeroUsize,
}

impl Default for Fitting {
    fn default() -> Self {
        Self { learner: Learner::default(), least: RiskModel::LEAST, threads: NonZeroUsize::MIN }
    }
}

/// What cross-validation chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Share of the boosting in the mean of the log-odds; the rest is the spline model.
    pub boosting_share: f64,
    /// Mean log loss of the predictions of rows that were not fitted, after calibration.
    pub log_loss: f64,
    /// Their Brier score.
    pub brier: f64,
    /// Intercept and slope of the calibration: log-odds = intercept + slope x mean log-odds.
    pub calibration: [f64; 2],
}

/// The chance of success from parameters, hidden draws and physical margins.
#[derive(Debug, Clone)]
pub struct RiskModel {
    inputs: Arc<Inputs>,
    boosting: Option<Boosting>,
    splines: Option<SplineLogistic>,
    choice: Choice,
}

/// The reason why a model cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RiskError {
    /// Too few episodes of one outcome.
    #[error("{successes} successes and {failures} failures. Expected at least {least} of each")]
    TooFew {
        /// Number of successes.
        successes: usize,
        /// Number of failures.
        failures: usize,
        /// Expected number of each.
        least: usize,
    },
    /// The task cannot set a scenario up.
    #[error("episode {index}: {fault}")]
    Scenario {
        /// The index of the episode.
        index: u64,
        /// The problem.
        fault: Fault,
    },
    /// Gradient boosting cannot be fitted.
    #[error(transparent)]
    Boosting(#[from] BoostingError),
    /// The spline model cannot be fitted.
    #[error(transparent)]
    Splines(#[from] RegressionError),
}

impl RiskModel {
    /// The usual smallest number of episodes of each outcome for a fit.
    pub const LEAST: usize = 10;

    /// Fits a model to these episodes.
    ///
    /// # Errors
    /// Too few episodes of one outcome, or a scenario that the task cannot set up.
    pub fn fit(inputs: Arc<Inputs>, samples: &[Sample], how: Fitting) -> Result<Self, RiskError> {
        enough(samples, how.least)?;
        let rows = rows(&inputs, samples)?;
        let outcomes: Vec<bool> = samples.iter().map(|sample| sample.success).collect();
        let mut order: Vec<usize> = (0..rows.len()).collect();
        Seed::campaign(0).stream("risk model folds").shuffle(&mut order);
        // Each outcome is spread evenly over the parts.
        order.sort_by_key(|row| outcomes[*row]);
        // The part of each row in the cross-validation.
        let mut part = vec![0; rows.len()];
        order.iter().enumerate().for_each(|(at, row)| part[*row] = at % FOLDS);
        // One fit without each part, and the last one to all rows.
        let mut fits = in_parallel(how.threads, FOLDS + 1, |left_out| {
            let train: Vec<usize> = (0..rows.len()).filter(|row| part[*row] != left_out).collect();
            Pair::fit(&inputs, &rows, &outcomes, &train, how.learner)
        })
        .into_iter()
        .collect::<Result<Vec<Pair>, _>>()?;
        let held_out: Vec<[f64; 2]> = rows.iter().zip(&part).map(|(row, part)| fits[*part].log_odds(row)).collect();
        let mut best: Option<Choice> = None;
        for share in how.learner.shares() {
            let mixed: Vec<f64> = held_out.iter().map(|both| mix(*both, *share)).collect();
            let choice = calibrated(&mixed, &outcomes, *share)?;
            if best.is_none_or(|best| choice.log_loss < best.log_loss) {
                best = Some(choice);
            }
        }
        let (Some(Pair { boosting, splines }), Some(choice)) = (fits.pop(), best) else {
            return Err(RiskError::TooFew { successes: 0, failures: 0, least: 1 });
        };
        Ok(Self { inputs, boosting, splines, choice })
    }

    /// What cross-validation chose.
    pub fn choice(&self) -> Choice {
        self.choice
    }

    /// The inputs.
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// The spline model, unless it was not fitted. Its log-odds come before the calibration.
    pub fn splines(&self) -> Option<&SplineLogistic> {
        self.splines.as_ref()
    }

    /// The log-odds of success of one episode, whose seed determines its draws.
    fn log_odds(&self, scenario: &Scenario) -> Result<f64, Fault> {
        let Choice { boosting_share, calibration: [intercept, slope], .. } = self.choice;
        let row = self.inputs.row(scenario)?;
        let both = [
            self.boosting.as_ref().map_or(0.0, |model| model.log_odds(&row)),
            self.splines.as_ref().map_or(0.0, |model| model.log_odds(&row)),
        ];
        Ok(intercept + slope * mix(both, boosting_share))
    }

    /// The chance of success of one episode, whose seed determines its draws.
    ///
    /// # Errors
    /// A fault if the task cannot set the scenario up.
    pub fn told(&self, scenario: &Scenario) -> Result<f64, Fault> {
        self.log_odds(scenario).map(logistic)
    }

    /// The chance of success of these parameters, averaged over this number of fresh draws. Every point sees the same
    /// draws. One is enough for a task without draws.
    ///
    /// # Errors
    /// A fault if the task cannot set the parameters up with any of the draws.
    pub fn averaged(&self, requested: &Assignment, draws: u64) -> Result<f64, Fault> {
        let draws = if self.inputs.knows_draws() { draws.max(1) } else { 1 };
        let (mut sum, mut count, mut problem) = (0.0, 0_u32, None);
        for draw in 0..draws {
            match self.told(&Inputs::fresh(requested, draw)) {
                Ok(p) => {
                    sum += p;
                    count += 1;
                }
                // A draw may have no room for its obstacles. The episode would be invalid.
                Err(fault) => problem = Some(fault),
            }
        }
        match (count, problem) {
            (0, Some(fault)) => Err(fault),
            _ => Ok(sum / f64::from(count.max(1))),
        }
    }
}

/// Rejects too few episodes of one outcome.
fn enough(samples: &[Sample], least: usize) -> Result<(), RiskError> {
    let successes = samples.iter().filter(|sample| sample.success).count();
    let failures = samples.len() - successes;
    if successes.min(failures) < least { Err(RiskError::TooFew { successes, failures, least }) } else { Ok(()) }
}

/// The columns of all episodes.
fn rows(inputs: &Inputs, samples: &[Sample]) -> Result<Vec<Vec<f64>>, RiskError> {
    let row = |Sample { scenario, .. }: &Sample| {
        inputs.row(scenario).map_err(|fault| RiskError::Scenario { index: scenario.index, fault })
    };
    samples.iter().map(row).collect()
}

impl Learner {
    fn shares(self) -> &'static [f64] {
        match self {
            Self::Chosen => &SHARES,
            Self::Boosting => &[1.0],
            Self::Splines => &[0.0],
        }
    }
}

/// Both learners, fitted to the same rows.
struct Pair {
    boosting: Option<Boosting>,
    splines: Option<SplineLogistic>,
}

impl Pair {
    fn fit(
        inputs: &Inputs,
        rows: &[Vec<f64>],
        outcomes: &[bool],
        train: &[usize],
        learner: Learner,
    ) -> Result<Self, RiskError> {
        let columns: Vec<Vec<f64>> =
            (0..inputs.names().len()).map(|at| train.iter().map(|row| rows[*row][at]).collect()).collect();
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let outcomes: Vec<bool> = train.iter().map(|row| outcomes[*row]).collect();
        let boosting = match learner {
            Learner::Splines => None,
            Learner::Chosen | Learner::Boosting => {
                Some(Boosting::fit(&views, &outcomes, inputs.constraints(), Options::default())?)
            }
        };
        let splines = match learner {
            Learner::Boosting => None,
            Learner::Chosen | Learner::Splines => Some(SplineLogistic::fit(&views, &outcomes, inputs.interacting())?),
        };
        Ok(Self { boosting, splines })
    }

    fn log_odds(&self, row: &[f64]) -> [f64; 2] {
        [
            self.boosting.as_ref().map_or(0.0, |model| model.log_odds(row)),
            self.splines.as_ref().map_or(0.0, |model| model.log_odds(row)),
        ]
    }
}

fn mix([boosting, splines]: [f64; 2], share: f64) -> f64 {
    share * boosting + (1.0 - share) * splines
}

/// Calibrates log-odds of rows that were not fitted with a line (Platt 1999), and scores the result.
fn calibrated(log_odds: &[f64], outcomes: &[bool], boosting_share: f64) -> Result<Choice, RiskError> {
    let line = ridge::fit(Data::new(&[log_odds], outcomes, None)?, WEAK)?.coefficients;
    // A negative slope would turn the prediction around. It means that the model found nothing.
    let calibration = [line[0], line.get(1).map_or(0.0, |slope| slope.max(0.0))];
    let predicted = log_odds.iter().map(|score| calibration[0] + calibration[1] * score);
    let [log_loss, brier] = scores(predicted, outcomes);
    Ok(Choice { boosting_share, log_loss, brier, calibration })
}

/// Mean log loss and Brier score of predicted log-odds.
fn scores(predicted: impl Iterator<Item = f64>, outcomes: &[bool]) -> [f64; 2] {
    let (mut log_loss, mut brier) = (0.0, 0.0);
    for (log_odds, success) in predicted.zip(outcomes) {
        let p = logistic(log_odds);
        let likely = if *success { p } else { 1.0 - p };
        log_loss -= likely.max(1e-15).ln();
        brier += (1.0 - likely).powi(2);
    }
    let n = outcomes.len().max(1) as f64;
    [log_loss / n, brier / n]
}

fn logistic(t: f64) -> f64 {
    1.0 / (1.0 + (-t).exp())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use robogate_core::{
        Better, Domain, FeatureSpec, Foresight, Measures, Parameter, ParameterSpace, Scale, Value, Word,
    };

    use super::*;

    /// A part succeeds if its size x plus a hidden offset in -0.3 to 0.3 is below 0.5.
    struct Hidden;

    const OFFSET: Word = Word::constant("offset");

    fn offset(seed: Seed) -> f64 {
        seed.stream("offset").between(-0.3, 0.3)
    }

    impl Foresight for Hidden {
        fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
            Ok([(OFFSET, Some(offset(scenario.seed)))].into_iter().collect())
        }

        fn feature_specs(&self) -> &[FeatureSpec] {
            &[FeatureSpec { name: "room", unit: "m", meaning: "Free space.", better: Better::Higher }]
        }

        fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
            let x = scenario.requested.number("x").unwrap_or(f64::NAN);
            Ok(vec![0.5 - x - offset(scenario.seed)])
        }
    }

    fn space() -> ParameterSpace {
        let domain = || Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
        let parameter = |name: &str| Parameter { name: name.into(), domain: domain() };
        let shape =
            Parameter { name: "shape".into(), domain: Domain::Categorical { choices: vec!["a".into(), "b".into()] } };
        ParameterSpace::new("test", vec![parameter("x"), parameter("y"), shape]).unwrap()
    }

    fn samples(n: u64) -> Vec<Sample> {
        (0..n)
            .map(|index| {
                let seed = Seed::campaign(5).episode(index);
                let mut stream = seed.stream("point");
                let (x, y) = (stream.uniform(), stream.uniform());
                let shape = if stream.uniform() < 0.5 { "a" } else { "b" };
                let requested: Assignment = [
                    (Arc::from("x"), Value::Number(x)),
                    (Arc::from("y"), Value::Number(y)),
                    (Arc::from("shape"), Value::Category(shape.into())),
                ]
                .into_iter()
                .collect();
                Sample { scenario: Scenario { index, seed, requested }, success: x + offset(seed) < 0.5 }
            })
            .collect()
    }

    fn brier(p: impl Fn(&Scenario) -> f64, samples: &[Sample]) -> f64 {
        let square = |sample: &Sample| (p(&sample.scenario) - f64::from(u8::from(sample.success))).powi(2);
        samples.iter().map(square).sum::<f64>() / samples.len() as f64
    }

    #[test]
    fn draws_sharpen_the_model() {
        let all = samples(800);
        let (train, test) = all.split_at(300);
        let fit = |foresight: Option<Arc<dyn Foresight>>| {
            RiskModel::fit(Arc::new(Inputs::new(&space(), foresight)), train, Fitting::default()).unwrap()
        };
        let (told, blind) = (fit(Some(Arc::new(Hidden))), fit(None));
        let [with, without] = [&told, &blind].map(|model| brier(|s| model.told(s).unwrap(), test));
        // Without the draw the best possible score is about 0.1, with it nearly 0.
        assert!(with < 0.03 && without > 0.07, "{with} {without}");
        // Averaged over fresh draws, the told model is a model of the parameters: it finds the linear transition.
        let truth = |s: &Scenario| ((0.5 - s.requested.number("x").unwrap() + 0.3) / 0.6).clamp(0.0, 1.0);
        let error = |p: &dyn Fn(&Scenario) -> f64| {
            test.iter().map(|s| (p(&s.scenario) - truth(&s.scenario)).powi(2)).sum::<f64>() / test.len() as f64
        };
        let averaged = error(&|s| told.averaged(&s.requested, 64).unwrap());
        assert!(averaged < 0.005, "{averaged}");
    }

    #[test]
    fn learners_can_be_fixed() {
        let all = samples(200);
        for (learner, share) in [(Learner::Boosting, 1.0), (Learner::Splines, 0.0)] {
            let model =
                RiskModel::fit(Arc::new(Inputs::new(&space(), None)), &all, Fitting { learner, ..Fitting::default() })
                    .unwrap();
            assert!((model.choice().boosting_share - share).abs() < 1e-12);
            assert!(model.choice().brier < 0.25, "{:?}", model.choice());
        }
    }

    #[test]
    fn one_outcome_is_rejected() {
        let successes: Vec<Sample> = samples(100).into_iter().filter(|s| s.success).collect();
        let n = successes.len();
        let error = RiskModel::fit(Arc::new(Inputs::new(&space(), None)), &successes, Fitting::default()).unwrap_err();
        assert_eq!(error, RiskError::TooFew { successes: n, failures: 0, least: 10 });
    }
}
