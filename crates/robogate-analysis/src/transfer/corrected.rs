//! The corrected model of real success: shift and slope of the simulation's log-odds, and the effects of single parameters
//! that the trials show beyond both.
//!
//! The parameters are chosen one after the other: the most significant one joins the model, and the others are tested
//! again, until none is significant.

use robogate_core::{Domain, Parameter, ParameterSpace};
use robogate_stats::Confidence;
use robogate_stats::recalibration::{Effect, Observed, Posterior, Recalibration, effects, log_odds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::differences::ParameterDifference;
use super::{LEVEL, RealTrials, WithInterval};

/// Most parameters that join the model.
const MOST: usize = 3;
/// The seed of the tests and of the posterior.
const SEED: u64 = 1;

/// The effect of a parameter in the corrected model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrectedParameter {
    /// The parameter.
    pub parameter: String,
    /// The level, for a categorical parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
    /// The change of the log-odds of real success for one standard deviation of the population.
    pub effect: WithInterval,
}

/// A parameter as numbers: its place in its range, or whether it has a level.
#[derive(Debug, Clone, Copy)]
struct Column<'a> {
    parameter: &'a Parameter,
    /// Its position in the space.
    at: usize,
    level: Option<usize>,
}

impl<'a> Column<'a> {
    fn all(space: &'a ParameterSpace) -> Vec<Self> {
        let of = |(at, parameter): (usize, &'a Parameter)| -> Vec<Self> {
            match &parameter.domain {
                Domain::Categorical { choices } => {
                    (0..choices.len()).map(|level| Self { parameter, at, level: Some(level) }).collect()
                }
                _ => vec![Self { parameter, at, level: None }],
            }
        };
        space.parameters().iter().enumerate().flat_map(of).collect()
    }

    /// The number of a coded value.
    fn number(&self, coded: f64) -> f64 {
        match self.level {
            Some(level) => f64::from(u8::from(coded as usize == level)),
            None => self.parameter.domain.to_unit(coded),
        }
    }

    /// The numbers of all trials. A missing value has the mean of the others. `None` if all are missing.
    fn of_trials(&self, trials: &RealTrials) -> Option<Vec<f64>> {
        let known: Vec<f64> = trials.trials.iter().filter_map(|t| t.values[self.at]).collect();
        let mean = known.iter().map(|v| self.number(*v)).sum::<f64>() / known.len() as f64;
        let number = |value: Option<f64>| value.map_or(mean, |v| self.number(v));
        (!known.is_empty()).then(|| trials.trials.iter().map(|t| number(t.values[self.at])).collect())
    }

    fn name(&self) -> String {
        self.parameter.name.to_string()
    }

    fn level_name(&self) -> Option<String> {
        match &self.parameter.domain {
            Domain::Categorical { choices } => Some(choices.get(self.level?)?.to_string()),
            _ => None,
        }
    }
}

/// A column of the corrected model.
struct Term<'a> {
    column: Column<'a>,
    /// Mean and standard deviation over the population.
    mean: f64,
    deviation: f64,
}

impl<'a> Term<'a> {
    fn of(column: Column<'a>, points: &[Vec<f64>]) -> Self {
        let n = points.len().max(1) as f64;
        let numbers: Vec<f64> = points.iter().map(|point| column.number(point[column.at])).collect();
        let mean = numbers.iter().sum::<f64>() / n;
        let deviation = (numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
        // A population may have one value only.
        Self { column, mean, deviation: if deviation > 1e-9 { deviation } else { 1.0 } }
    }

    fn standard(&self, number: f64) -> f64 {
        (number - self.mean) / self.deviation
    }
}

/// The corrected model.
pub(super) struct CorrectedModel<'a> {
    posterior: Recalibration,
    terms: Vec<Term<'a>>,
}

impl<'a> CorrectedModel<'a> {
    /// The model of these trials, and the effect of each parameter beyond shift and slope. `predicted` are the simulation's
    /// predictions for the trials by a model of so many episodes, `points` the population.
    pub(super) fn of(
        space: &'a ParameterSpace,
        trials: &RealTrials,
        (predicted, episodes): (&[f64], usize),
        points: &[Vec<f64>],
        design_effect: f64,
    ) -> (Self, Vec<ParameterDifference>) {
        let (eta, outcomes): (Vec<f64>, _) = (predicted.iter().map(|p| log_odds(*p)).collect(), trials.outcomes());
        let observed = Observed { eta: &eta, outcomes: &outcomes, design_effect, model_rows: episodes as f64 };
        let level = Confidence::P95.level();
        let (columns, numbers): (Vec<Column<'_>>, Vec<Vec<f64>>) =
            Column::all(space).into_iter().filter_map(|column| Some((column, column.of_trials(trials)?))).unzip();
        let mut model = Self { posterior: Recalibration::of(observed, level), terms: Vec::new() };
        let mut tested = effects(observed, &numbers, &model.posterior, &[], SEED);
        let differences =
            columns.iter().zip(&tested).filter_map(|(column, effect)| Some(difference(column, (*effect)?))).collect();
        let mut known: Vec<Vec<f64>> = Vec::new();
        while let Some(next) = most_significant(&tested).filter(|_| known.len() < MOST) {
            let term = Term::of(columns[next], points);
            known.push(numbers[next].iter().map(|x| term.standard(*x)).collect());
            model.terms.push(term);
            model.posterior = Recalibration::with_effects(observed, &known, level, SEED);
            tested = effects(observed, &numbers, &model.posterior, &known, SEED);
        }
        (model, differences)
    }

    /// The posterior of shift, slope and effects.
    pub(super) fn posterior(&self) -> &Recalibration {
        &self.posterior
    }

    /// The values of the model's parameters at a setting, in standard deviations from their mean.
    pub(super) fn values(&self, setting: &[f64]) -> Vec<f64> {
        self.terms.iter().map(|term| term.standard(term.column.number(setting[term.column.at]))).collect()
    }

    /// P(success) at a setting for which the simulation predicts this probability.
    pub(super) fn success(&self, predicted: f64, setting: &[f64]) -> Posterior {
        self.posterior.success(log_odds(predicted), &self.values(setting))
    }

    /// The parameters in the model.
    pub(super) fn parameters(&self) -> Vec<CorrectedParameter> {
        let of = |(term, effect): (&Term<'_>, Posterior)| CorrectedParameter {
            parameter: term.column.name(),
            level: term.column.level_name(),
            effect: effect.into(),
        };
        self.terms.iter().zip(self.posterior.effects()).map(of).collect()
    }
}

/// The column with the most significant effect, if there is one.
fn most_significant(tested: &[Option<Effect>]) -> Option<usize> {
    let significant = tested
        .iter()
        .enumerate()
        .filter_map(|(i, effect)| Some((i, (*effect)?)))
        .filter(|(_, e)| e.adjusted_p <= LEVEL);
    significant.max_by(|(i, a), (j, b)| a.z.abs().total_cmp(&b.z.abs()).then(j.cmp(i))).map(|(i, _)| i)
}

fn difference(column: &Column<'_>, effect: Effect) -> ParameterDifference {
    let z = Confidence::P95.z();
    ParameterDifference {
        parameter: column.name(),
        level: column.level_name(),
        effect: effect.slope,
        interval_95: [effect.slope - z * effect.se, effect.slope + z * effect.se],
        adjusted_p: effect.adjusted_p,
    }
}
