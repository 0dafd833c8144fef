//! The risk model of scenarios.

use std::num::NonZeroUsize;
use std::sync::Arc;

use robogate_core::{Assignment, Fault, Scenario, Seed};
use robogate_stats::flexible::{Calibrated, Choice, Flexible, FlexibleError, Learner, Training};
use robogate_stats::spline_logistic::SplineLogistic;

use crate::Inputs;

/// Number of parts of the cross-validation.
const FOLDS: usize = 5;

/// An episode for training: its scenario and whether it succeeded.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The scenario.
    pub scenario: Scenario,
    /// Whether the episode succeeded.
    pub success: bool,
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

/// The chance of success from parameters, hidden draws and physical margins.
#[derive(Debug, Clone)]
pub struct RiskModel {
    inputs: Arc<Inputs>,
    model: Flexible,
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
    /// A learner cannot be fitted.
    #[error(transparent)]
    Fit(#[from] FlexibleError),
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
        let columns: Vec<Vec<f64>> =
            (0..inputs.names().len()).map(|at| rows.iter().map(|row| row[at]).collect()).collect();
        let training = Training {
            columns: &columns,
            outcomes: &outcomes,
            constraints: inputs.constraints(),
            interacting: inputs.interacting(),
        };
        let model = Flexible::fit(training, &part, (how.learner, Calibrated::Line), how.threads)?;
        Ok(Self { inputs, model })
    }

    /// What cross-validation chose.
    pub fn choice(&self) -> Choice {
        self.model.choice()
    }

    /// The inputs.
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// The spline model, unless it was not fitted. Its log-odds come before the calibration.
    pub fn splines(&self) -> Option<&SplineLogistic> {
        self.model.splines()
    }

    /// The log-odds of success of one episode, whose seed determines its draws.
    fn log_odds(&self, scenario: &Scenario) -> Result<f64, Fault> {
        Ok(self.model.log_odds(&self.inputs.row(scenario)?))
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
