//! Learners that are fitted to the rows of one run and predict the outcomes of others.

use robogate_dictionary::Dictionary;
use robogate_stats::fourier::Fourier;
use robogate_stats::logistic::{Data, Options, RegressionError, fit, interaction};
use robogate_stats::ridge;

use crate::AnalysisError;
use crate::models::missing;
use crate::table::{EpisodeTable, ParameterColumn, ParameterKind, Sample};
use crate::task::{InteractionModel, TaskAnalysis};

/// Number of frequencies of the flexible learner. Each gives two columns.
const FREQUENCIES: usize = 96;
/// Its length scales, in units of the square root of the number of parameters. The typical distance of two points is
/// the square root of two in these units.
const LENGTH_SCALES: [f64; 3] = [0.35, 0.7, 1.4];
/// Its candidate prior variances.
const PRIOR_VARIANCES: [f64; 5] = [1.0, 5.0, 25.0, 125.0, 625.0];
/// Seed of the frequencies, which are the same in every fit.
const SEED: u64 = 2007;

/// A learner.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Learner {
    /// The logistic model that the paper publishes for the task: main effects and interactions.
    Paper,
    /// A logistic model of all parameters, each on its own scale, with a column for each category.
    MainEffects,
    /// Bayesian logistic regression on the same columns and on random Fourier features of them. The evidence selects
    /// length scale and prior variance.
    Flexible,
}

impl Learner {
    /// Fits `train` and predicts the log-odds of success of the rows of `test`. The columns depend only on the space of the test set.
    fn scores(self, train: &Sample, test: &Sample, task: &TaskAnalysis) -> Result<Vec<f64>, String> {
        match self {
            Self::Paper => {
                let model = task.interactions.as_ref().ok_or("no model is published for this task")?;
                if let Some(missing) = missing(test, model) {
                    return Err(format!("the dataset has no {missing}, which the paper's model needs"));
                }
                let scaling: Vec<(f64, f64)> =
                    model.main.iter().filter_map(|m| train.parameter(m)).map(|p| moments(&p.values)).collect();
                plain(train, test, |sample| interactions(sample, model, &scaling))
            }
            Self::MainEffects => plain(train, test, |sample| coordinates(sample, test, 1)),
            Self::Flexible => flexible_scores(train, test, &mut |_, _| {}),
        }
    }
}

/// The chance of success of each valid row of `test`, in their order, by a learner that is fitted to all valid rows of `train`
/// with equal weights.
///
/// # Errors
/// A dictionary that cannot be read or whose parameters differ from those of `test`, or a failed fit.
pub fn predictions(learner: Learner, train: &Dictionary, test: &Dictionary) -> Result<Vec<f64>, AnalysisError> {
    let rows = EpisodeTable::read(test)?.valid();
    let sample = EpisodeTable::read(train)?.valid();
    let failed = |reason: String| AnalysisError::NoPrediction { path: train.path().to_owned(), reason };
    let foreign =
        |parameter: &&ParameterColumn| !sample.parameter(&parameter.name).is_some_and(|p| p.is_like(parameter));
    if let Some(parameter) = rows.parameters.iter().find(foreign) {
        let name = &parameter.name;
        return Err(failed(format!("parameter `{name}` is missing or of another type than in the test set")));
    }
    let task = TaskAnalysis::of_dictionary(test.provenance());
    let scores = learner.scores(&sample, &rows, task).map_err(failed)?;
    Ok(scores.iter().map(|log_odds| 1.0 / (1.0 + (-log_odds).exp())).collect())
}

/// Fits by maximum likelihood, or by Firth's method if the data are separated.
fn plain(train: &Sample, test: &Sample, columns: impl Fn(&Sample) -> Vec<Vec<f64>>) -> Result<Vec<f64>, String> {
    let (own, other) = (columns(train), columns(test));
    let views: Vec<&[f64]> = own.iter().map(Vec::as_slice).collect();
    let data = Data::new(&views, &train.success, None).map_err(reason)?;
    let found = fit(data, Options::default()).map_err(reason)?;
    let beta = found.raw_coefficients();
    Ok(linear(beta, &other, test.len()))
}

/// The scores of [`Learner::Flexible`]. `fitted` receives the number of fits so far and the number of all fits.
pub(crate) fn flexible_scores(
    train: &Sample,
    test: &Sample,
    fitted: &mut dyn FnMut(u32, u32),
) -> Result<Vec<f64>, String> {
    let (mut fits, all) = (0, (LENGTH_SCALES.len() * PRIOR_VARIANCES.len()) as u32);
    fitted(fits, all);
    let (own, other) = (coordinates(train, test, 0), coordinates(test, test, 0));
    let fourier = Fourier::new(own.len(), FREQUENCIES, SEED);
    let root = (test.parameters.len() as f64).sqrt();
    let columns = |coordinates: &[Vec<f64>], length: f64| {
        let views: Vec<&[f64]> = coordinates.iter().map(Vec::as_slice).collect();
        // The number of coordinates equals the dimension of the frequencies.
        let mut columns = fourier.columns(&views, length * root).unwrap_or_default();
        // Scaled so that the linear columns have the same total norm as the features.
        columns.extend(coordinates.iter().map(|c| c.iter().map(|x| x / root).collect::<Vec<f64>>()));
        columns
    };
    let mut best: Option<(f64, ridge::RidgeFit)> = None;
    for length in LENGTH_SCALES {
        let columns = columns(&own, length);
        let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let data = Data::new(&views, &train.success, None).map_err(reason)?;
        let mut count = || {
            fits += 1;
            fitted(fits, all);
        };
        let found = ridge::by_evidence_watched(data, &PRIOR_VARIANCES, &mut count).map_err(reason)?;
        if let Some(found) = found
            && best.as_ref().is_none_or(|(_, b)| found.log_evidence > b.log_evidence)
        {
            best = Some((length, found));
        }
    }
    let (length, model) = best.ok_or("no length scale could be fitted")?;
    let columns = columns(&other, length);
    let views: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    model.log_odds(&views).ok_or_else(|| "the columns do not match the model".to_owned())
}

fn reason(error: RegressionError) -> String {
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

/// Mean and standard deviation. The latter is 1 for a constant column.
fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    (mean, if deviation > 1e-12 * mean.abs().max(1e-300) { deviation } else { 1.0 })
}

/// The features of the published model, standardised by the moments of the training rows.
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

/// One column for each numeric parameter, and one for each level of a categorical one from `first_level` on. The
/// flexible learner uses all levels, so that two levels have the same distance as two random values of a number on
/// average. A plain fit leaves out one level.
fn coordinates(sample: &Sample, test: &Sample, first_level: usize) -> Vec<Vec<f64>> {
    let mut columns = Vec::new();
    for of in &test.parameters {
        let Some(column) = sample.parameter(&of.name) else { continue };
        match &of.kind {
            ParameterKind::Categorical { levels } => {
                columns.extend((first_level..levels.len()).map(|level| is(column, level)));
            }
            _ => columns.push(scaled(column, &of.kind)),
        }
    }
    columns
}

fn is(column: &ParameterColumn, level: usize) -> Vec<f64> {
    column.values.iter().map(|v| f64::from(u8::from(*v as usize == level))).collect()
}

/// A numeric parameter relative to the middle of its range, in units of its standard deviation under uniform sampling
/// on its own scale.
fn scaled(column: &ParameterColumn, kind: &ParameterKind) -> Vec<f64> {
    let unit = |x: f64| match kind {
        ParameterKind::Continuous { low, high, log: true } => (x / low).ln() / (high / low).ln(),
        ParameterKind::Continuous { low, high, log: false } => (x - low) / (high - low),
        ParameterKind::Integer { low, high } => (x - *low as f64 + 0.5) / (*high as f64 - *low as f64 + 1.0),
        ParameterKind::Categorical { .. } => x,
    };
    column.values.iter().map(|x| (unit(*x) - 0.5) * 12.0_f64.sqrt()).collect()
}
