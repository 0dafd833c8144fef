//! The learners of the study: each gets rows and gives the log-odds of success of rows, seen and unseen.

use robogate_stats::fourier::Fourier;
use robogate_stats::logistic::{Data, Options, RegressionError, fit, interaction};
use robogate_stats::ridge;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::models::missing;
use crate::rows::{ParameterColumn, ParameterKind, Sample};
use crate::task::{InteractionModel, TaskAnalysis};

/// Frequencies of the flexible learner: twice as many columns.
const FREQUENCIES: usize = 96;
/// Its length scales, in units of the square root of the number of parameters: the typical distance of two points
/// is the square root of two.
const LENGTH_SCALES: [f64; 3] = [0.35, 0.7, 1.4];
/// Its prior variances.
const PRIOR_VARIANCES: [f64; 5] = [1.0, 5.0, 25.0, 125.0, 625.0];
/// The frequencies are the same in every fit.
const SEED: u64 = 2007;

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Learner {
    /// The logistic model that the paper publishes for the task: main effects and interactions.
    Paper,
    /// A logistic model of every parameter, in its own scale, with a column for each category.
    MainEffects,
    /// Bayesian logistic regression on the same columns and on random Fourier features of them, length scale and
    /// prior chosen by evidence.
    Flexible,
}

/// Log-odds of success.
pub(super) struct Scores {
    /// Of the rows that the model was fitted to.
    pub(super) own: Vec<f64>,
    /// Of the test rows.
    pub(super) test: Vec<f64>,
}

impl Learner {
    /// All, the simplest first.
    pub const ALL: [Self; 3] = [Self::Paper, Self::MainEffects, Self::Flexible];

    /// Its name for people.
    pub(super) fn name(self, task: &TaskAnalysis) -> &'static str {
        match self {
            Self::Paper => task.interactions.map_or("published model", |model| model.name),
            Self::MainEffects => "main effects",
            Self::Flexible => "flexible",
        }
    }

    /// What it is, for people.
    pub(super) fn about(self, task: &TaskAnalysis) -> &'static str {
        match self {
            Self::Paper => task.interactions.map_or("none is published for this task", |model| model.about),
            Self::MainEffects => {
                "a logistic model of every parameter in its own scale (the logarithm where it is drawn so), with a \
                 column for each category"
            }
            Self::Flexible => {
                "Bayesian logistic regression on the same columns and 192 random Fourier features of them; length \
                 scale and prior variance by evidence"
            }
        }
    }

    /// Fits `train` and scores it and `test`. What the columns look like follows from the test set's space alone.
    pub(super) fn scores(
        self,
        train: &Sample,
        weights: Option<&[f64]>,
        test: &Sample,
        task: &TaskAnalysis,
    ) -> Result<Scores, String> {
        match self {
            Self::Paper => {
                let model = task.interactions.as_ref().ok_or("no model is published for this task")?;
                if let Some(missing) = missing(test, model) {
                    return Err(format!("there is no {missing}, which the paper's model is made of"));
                }
                let scaling: Vec<(f64, f64)> =
                    model.main.iter().filter_map(|m| train.parameter(m)).map(|p| moments(&p.values)).collect();
                plain(train, weights, test, |sample| interactions(sample, model, &scaling))
            }
            Self::MainEffects => plain(train, weights, test, |sample| coordinates(sample, test, 1)),
            Self::Flexible => flexible(train, weights, test),
        }
    }
}

/// Maximum likelihood, or Firth's where the data are separated.
fn plain(
    train: &Sample,
    weights: Option<&[f64]>,
    test: &Sample,
    columns: impl Fn(&Sample) -> Vec<Vec<f64>>,
) -> Result<Scores, String> {
    let (own, other) = (columns(train), columns(test));
    let views: Vec<&[f64]> = own.iter().map(Vec::as_slice).collect();
    let data = Data::new(&views, &train.success, weights).map_err(said)?;
    let found = fit(data, Options::default()).map_err(said)?;
    let beta = found.raw_coefficients();
    Ok(Scores { own: linear(beta, &own, train.len()), test: linear(beta, &other, test.len()) })
}

fn flexible(train: &Sample, weights: Option<&[f64]>, test: &Sample) -> Result<Scores, String> {
    let (own, other) = (coordinates(train, test, 0), coordinates(test, test, 0));
    let fourier = Fourier::new(own.len(), FREQUENCIES, SEED);
    let root = (test.parameters.len() as f64).sqrt();
    let columns = |coordinates: &[Vec<f64>], length: f64| {
        let views: Vec<&[f64]> = coordinates.iter().map(Vec::as_slice).collect();
        // Their number is that of the frequencies' dimensions.
        let mut columns = fourier.columns(&views, length * root).unwrap_or_default();
        // Together the linear columns have the length that the features have.
        columns.extend(coordinates.iter().map(|c| c.iter().map(|x| x / root).collect::<Vec<f64>>()));
        columns
    };
    let mut best: Option<(f64, ridge::RidgeFit)> = None;
    for length in LENGTH_SCALES {
        let columns = columns(&own, length);
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let data = Data::new(&views, &train.success, weights).map_err(said)?;
        let found = ridge::by_evidence(data, &PRIOR_VARIANCES).map_err(said)?;
        if let Some(found) = found
            && best.as_ref().is_none_or(|(_, b)| found.log_evidence > b.log_evidence)
        {
            best = Some((length, found));
        }
    }
    let (length, model) = best.ok_or("there is nothing to choose from")?;
    let score = |coordinates: &[Vec<f64>]| {
        let columns = columns(coordinates, length);
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        model.log_odds(&views).ok_or("the columns do not fit")
    };
    Ok(Scores { own: score(&own)?, test: score(&other)? })
}

fn said(error: RegressionError) -> String {
    match error {
        RegressionError::OneClass { rows, .. } => format!("all {rows} training episodes have the same outcome"),
        other => other.to_string(),
    }
}

fn linear(beta: &[f64], columns: &[Vec<f64>], rows: usize) -> Vec<f64> {
    let mut eta = vec![beta.first().copied().unwrap_or(0.0); rows];
    for (b, column) in beta.iter().skip(1).zip(columns) {
        eta.iter_mut().zip(column).for_each(|(e, x)| *e += b * x);
    }
    eta
}

/// Mean and standard deviation, 1 for a column of one value.
fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    (mean, if deviation > 1e-12 * mean.abs().max(1e-300) { deviation } else { 1.0 })
}

/// The paper's features, standardised as the training rows were.
fn interactions(sample: &Sample, model: &InteractionModel, scaling: &[(f64, f64)]) -> Vec<Vec<f64>> {
    let mut columns: Vec<Vec<f64>> = model
        .main
        .iter()
        .filter_map(|m| sample.parameter(m))
        .zip(scaling)
        .map(|(p, (mean, deviation))| p.values.iter().map(|v| (v - mean) / deviation).collect())
        .collect();
    for (a, b) in model.products {
        columns.push(interaction(&columns[*a], &columns[*b]));
    }
    columns
}

/// A column for each number and one for each level of a category from `first_level` on. The flexible learner takes
/// all levels, so that two of them are as far apart as two draws of a number are on average; a plain fit all but one.
fn coordinates(sample: &Sample, test: &Sample, first_level: usize) -> Vec<Vec<f64>> {
    let mut columns = Vec::new();
    for of in &test.parameters {
        let Some(column) = sample.parameter(&of.name) else { continue };
        match &of.kind {
            ParameterKind::Categorical { words } => {
                columns.extend((first_level..words.len()).map(|level| is(column, level)));
            }
            _ => columns.push(scaled(column, &of.kind)),
        }
    }
    columns
}

fn is(column: &ParameterColumn, level: usize) -> Vec<f64> {
    column.values.iter().map(|v| f64::from(u8::from(*v as usize == level))).collect()
}

/// A number about the middle of its range, in units of the standard deviation that it has when drawn evenly in its scale.
fn scaled(column: &ParameterColumn, kind: &ParameterKind) -> Vec<f64> {
    let unit = |x: f64| match kind {
        ParameterKind::Continuous { low, high, log: true } => (x / low).ln() / (high / low).ln(),
        ParameterKind::Continuous { low, high, log: false } => (x - low) / (high - low),
        ParameterKind::Integer { low, high } => (x - *low as f64 + 0.5) / (*high as f64 - *low as f64 + 1.0),
        ParameterKind::Categorical { .. } => x,
    };
    column.values.iter().map(|x| (unit(*x) - 0.5) * 12.0_f64.sqrt()).collect()
}
