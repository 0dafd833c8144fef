//! The paper's risk model: P(failure) from every parameter, categories as penalties.
//!
//! The paper names nine features: five continuous ones, obstacles, a shape penalty, a placement penalty and the intercept.
//! It does not define the penalties. Here the penalty of a level is its failure rate, drawn towards the overall one by ten
//! episodes' worth: (f + 10 p) / (n + 10), with f failures in n episodes of the level and the overall rate p,
//! counted in the training rows alone. In cross-validation each fold's penalties come from the other folds.
//!
//! Limit: in sample the penalties have seen the outcomes that they predict, so that the standard errors of their
//! coefficients are too small and the in-sample AUC leans upwards; the cross-validated figures do not.
//! Source for the coding: Micci-Barreca (2001), SIGKDD Explorations 3(1).

use robogate_stats::Confidence;
use robogate_stats::calibration::{Bins, Calibration, calibration};
use robogate_stats::logistic::{Data, Fit, Options, RegressionError, Scale, fit};
use robogate_stats::roc::{RocError, RocPoint, auc, cross_validate, curve, stratified_folds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Regression, why};
use crate::Finding;
use crate::labels::parameter_label;
use crate::rate::ends;
use crate::rows::{ParameterColumn, ParameterKind, Sample};
use crate::task::TaskAnalysis;

/// Folds of the cross-validation.
const FOLDS: usize = 5;
/// Episodes' worth by which a level's failure rate is drawn towards the overall one.
const PRIOR: f64 = 10.0;
/// Points kept of a ROC curve.
const ROC_POINTS: usize = 120;

/// P(failure) from the parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RiskModel {
    /// Whether its features are the paper's nine; else it is a model of the same form over what there is.
    pub paper_features: bool,
    /// The regression, coefficients per standard deviation; above 0 they raise the chance of failure.
    pub regression: Regression,
    /// The penalties of each categorical parameter, from all rows.
    pub penalties: Vec<Penalty>,
    /// The same model as one asks it: coefficients per unit and their covariance.
    pub scoring: Scoring,
    /// How well it tells failures from successes.
    pub roc: Finding<RocFigures>,
    /// Whether its probabilities come true, in sample.
    pub calibration_in_sample: Finding<CalibrationFigures>,
    /// The same for rows that the model had not seen.
    pub calibration_cross_validated: Finding<CalibrationFigures>,
}

/// A logistic model of P(failure) in the parameters' own units: p = 1 / (1 + exp(-(intercept + Σ coefficient · x))), where x is the
/// value of a number, and of a category the penalty of its level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scoring {
    /// Log-odds of a failure where every x is 0.
    pub intercept: f64,
    /// The parameters that have a coefficient.
    pub terms: Vec<ScoringTerm>,
    /// Covariance of the intercept and the coefficients, row by row.
    pub covariance: Vec<f64>,
    /// The largest variance x' V x of the log-odds among the rows: beyond it the model extrapolates.
    pub most_variance: f64,
}

/// One parameter of a model that is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScoringTerm {
    /// The parameter; where it has penalties, they stand in [`RiskModel::penalties`].
    pub parameter: String,
    /// Log-odds per unit, or per unit of penalty.
    pub coefficient: f64,
}

impl Scoring {
    fn of(fit: &Fit, parameters: &[ParameterColumn], columns: &[&[f64]]) -> Self {
        let raw = fit.raw_coefficients();
        let size = raw.len();
        // The intercept, then the columns that have a coefficient.
        let estimated = |i: &usize| *i == 0 || fit.terms.get(i - 1).is_some_and(|term| term.coefficient().is_some());
        let kept: Vec<usize> = (0..size).filter(estimated).collect();
        let at = |i: usize, j: usize| fit.raw_covariance()[i * size + j];
        let variance = |row: usize| {
            let x = |i: usize| if i == 0 { 1.0 } else { columns[i - 1][row] };
            kept.iter().map(|i| kept.iter().map(|j| x(*i) * x(*j) * at(*i, *j)).sum::<f64>()).sum::<f64>()
        };
        let rows = columns.first().map_or(0, |column| column.len());
        Self {
            intercept: raw[0],
            terms: kept[1..]
                .iter()
                .map(|i| ScoringTerm { parameter: parameters[i - 1].name.clone(), coefficient: raw[*i] })
                .collect(),
            covariance: kept.iter().flat_map(|i| kept.iter().map(move |j| at(*i, *j))).collect(),
            most_variance: (0..rows).map(variance).fold(0.0, f64::max),
        }
    }
}

/// The penalties of one categorical parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Penalty {
    /// The parameter.
    pub parameter: String,
    /// Its levels.
    pub levels: Vec<PenaltyLevel>,
}

/// The penalty of one level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PenaltyLevel {
    /// The level.
    pub level: String,
    /// Its failure rate, drawn towards the overall one.
    pub penalty: f64,
}

/// How well a score tells failures from successes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RocFigures {
    /// AUC on the rows that the model was fitted to: too good by nature.
    pub auc_in_sample: f64,
    /// DeLong's 95 % interval.
    pub auc_in_sample_95: [f64; 2],
    /// Mean AUC over five folds that the model had not seen; absent where folds had one outcome only.
    pub auc_cross_validated: Option<f64>,
    /// 95 % interval from DeLong's variance in each fold.
    pub auc_cross_validated_95: [f64; 2],
    /// The curves, thinned.
    pub curves: Vec<RocCurve>,
}

/// A ROC curve: calling failures, share of failures found against share of successes called failures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RocCurve {
    /// `in_sample` or `cross_validated`.
    pub of: String,
    /// (share of successes called failures, share of failures found).
    pub points: Vec<[f64; 2]>,
}

/// Whether stated probabilities of failure come true.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CalibrationFigures {
    /// Mean of (p - y)².
    pub brier: f64,
    /// The same for always stating the overall rate: what a model must beat.
    pub brier_of_the_rate: f64,
    /// Mean of -ln P(outcome seen); absent where it is infinite.
    pub log_loss: Option<f64>,
    /// Expected calibration error over the bins.
    pub expected_calibration_error: f64,
    /// Ten bins of equal count.
    pub bins: Vec<ReliabilityBin>,
}

/// One bin of a reliability diagram.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReliabilityBin {
    /// Rows in it.
    pub rows: u64,
    /// Mean stated probability of failure.
    pub stated: f64,
    /// Observed failure rate.
    pub observed: f64,
    /// Its Wilson 95 % interval.
    pub interval_95: [f64; 2],
}

/// A stated probability of failure for each row, from a model that had not seen it where there is one.
pub(crate) struct Scored {
    pub(crate) p: Vec<f64>,
    pub(crate) unseen: bool,
}

pub(crate) fn risk(base: &Sample, task: &TaskAnalysis) -> Finding<(RiskModel, Scored)> {
    if base.parameters.is_empty() && base.len() > 0 {
        return Finding::not("there is no parameter to tell the episodes apart by");
    }
    let failed: Vec<bool> = base.success.iter().map(|s| !s).collect();
    let names: Vec<String> = base.parameters.iter().map(feature).collect();
    let everyone: Vec<usize> = (0..base.len()).collect();
    let coded = Coding::learn(&base.parameters, &failed, &everyone);
    let columns = coded.columns(&base.parameters, &everyone);
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let options = Options { scale: Scale::Standardized, ..Options::default() };
    let whole = match Data::new(&slices, &failed, None).and_then(|data| fit(data, options)) {
        Ok(whole) => whole,
        Err(error) => return Finding::not(why(&error, &names)),
    };
    let Some(p) = whole.probabilities(&slices) else {
        return Finding::not("the columns do not fit the model");
    };
    let scoring = Scoring::of(&whole, &base.parameters, &slices);
    drop(slices);
    drop(columns);
    let folds = stratified_folds(&failed, FOLDS, 0);
    let fewest = failed.iter().filter(|f| **f).count().min(base.success.iter().filter(|s| **s).count());
    let crossed = if fewest < FOLDS {
        Err(format!("the rarer outcome has {fewest} episodes, fewer than the {FOLDS} folds"))
    } else {
        cross_validate::<Trouble>(&failed, &folds, Confidence::P95, |train, test| {
            let coded = Coding::learn(&base.parameters, &failed, train);
            let columns = coded.columns(&base.parameters, train);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let outcomes: Vec<bool> = train.iter().map(|row| failed[*row]).collect();
            let fitted = fit(Data::new(&slices, &outcomes, None)?, Options::default())?;
            drop(slices);
            drop(columns);
            let columns = coded.columns(&base.parameters, test);
            let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            Ok(fitted.probabilities(&slices).unwrap_or_default())
        })
        .map_err(|trouble| match trouble {
            Trouble::Fit(error) => why(&error, &names),
            Trouble::Roc(error) => error.to_string(),
        })
    };
    let paper = task.risk_parameters;
    let model = RiskModel {
        paper_features: !paper.is_empty()
            && base.parameters.len() == paper.len()
            && paper.iter().all(|n| base.parameter(n).is_some()),
        regression: Regression::of(&whole, "failure", &names, true),
        penalties: coded.penalties(&base.parameters),
        scoring,
        roc: roc_figures(&p, &failed, crossed.as_ref().ok()),
        calibration_in_sample: calibrated(&p, &failed),
        calibration_cross_validated: match &crossed {
            Ok(crossed) => calibrated(&crossed.scores, &failed),
            Err(because) => Finding::not(because.clone()),
        },
    };
    let scored = match crossed {
        Ok(crossed) => Scored { p: crossed.scores, unseen: true },
        Err(_) => Scored { p, unseen: false },
    };
    Finding::Estimated((model, scored))
}

/// What stops a cross-validation.
enum Trouble {
    Fit(RegressionError),
    Roc(RocError),
}

impl From<RegressionError> for Trouble {
    fn from(error: RegressionError) -> Self {
        Self::Fit(error)
    }
}

impl From<RocError> for Trouble {
    fn from(error: RocError) -> Self {
        Self::Roc(error)
    }
}

fn feature(parameter: &ParameterColumn) -> String {
    let plain = parameter_label(&parameter.name);
    if parameter.is_numeric() { plain } else { format!("{plain} penalty") }
}

/// The penalties of all categorical parameters, learnt from some rows.
struct Coding(Vec<Option<Vec<f64>>>);

impl Coding {
    fn learn(parameters: &[ParameterColumn], failed: &[bool], rows: &[usize]) -> Self {
        let overall = rows.iter().filter(|row| failed[**row]).count() as f64 / rows.len().max(1) as f64;
        let learn = |parameter: &ParameterColumn| match &parameter.kind {
            ParameterKind::Categorical { words } => {
                let mut counts = vec![(0.0, 0.0); words.len()];
                for row in rows {
                    let level = &mut counts[parameter.values[*row] as usize];
                    level.0 += f64::from(u8::from(failed[*row]));
                    level.1 += 1.0;
                }
                Some(counts.iter().map(|(f, n)| (f + PRIOR * overall) / (n + PRIOR)).collect())
            }
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => None,
        };
        Self(parameters.iter().map(learn).collect())
    }

    fn columns(&self, parameters: &[ParameterColumn], rows: &[usize]) -> Vec<Vec<f64>> {
        let column = |(parameter, penalties): (&ParameterColumn, &Option<Vec<f64>>)| match penalties {
            Some(penalties) => rows.iter().map(|row| penalties[parameter.values[*row] as usize]).collect(),
            None => rows.iter().map(|row| parameter.values[*row]).collect(),
        };
        parameters.iter().zip(&self.0).map(column).collect()
    }

    fn penalties(&self, parameters: &[ParameterColumn]) -> Vec<Penalty> {
        parameters
            .iter()
            .zip(&self.0)
            .filter_map(|(parameter, penalties)| {
                let ParameterKind::Categorical { words } = &parameter.kind else { return None };
                let levels = words.iter().zip(penalties.as_ref()?);
                Some(Penalty {
                    parameter: parameter.name.clone(),
                    levels: levels
                        .map(|(level, penalty)| PenaltyLevel { level: level.clone(), penalty: *penalty })
                        .collect(),
                })
            })
            .collect()
    }
}

fn roc_figures(
    p: &[f64],
    failed: &[bool],
    crossed: Option<&robogate_stats::roc::CrossValidated>,
) -> Finding<RocFigures> {
    let found = match auc(p, failed, Confidence::P95) {
        Ok(found) => found,
        Err(error) => return Finding::not(error.to_string()),
    };
    let thinned = |of: &str, scores: &[f64]| {
        let points = curve(scores, failed).unwrap_or_default();
        RocCurve { of: of.to_owned(), points: thin(&points) }
    };
    let mut curves = vec![thinned("in_sample", p)];
    curves.extend(crossed.map(|crossed| thinned("cross_validated", &crossed.scores)));
    Finding::Estimated(RocFigures {
        auc_in_sample: found.auc,
        auc_in_sample_95: ends(found.interval),
        auc_cross_validated: crossed.map(|c| c.auc),
        auc_cross_validated_95: crossed.map_or([0.0, 1.0], |c| ends(c.interval)),
        curves,
    })
}

/// At most [`ROC_POINTS`] points, evenly along the curve; both ends stay.
fn thin(points: &[RocPoint]) -> Vec<[f64; 2]> {
    let along = |point: &RocPoint| point.false_positive_rate + point.true_positive_rate;
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut next = 0.0;
    for (i, point) in points.iter().enumerate() {
        if along(point) >= next || i + 1 == points.len() {
            kept.push([point.false_positive_rate, point.true_positive_rate]);
            next = along(point) + 2.0 / ROC_POINTS as f64;
        }
    }
    kept
}

fn calibrated(p: &[f64], failed: &[bool]) -> Finding<CalibrationFigures> {
    calibration(p, failed, None, Bins::EqualCount(10), Confidence::P95)
        .map(|found: Calibration| CalibrationFigures {
            brier: found.brier,
            brier_of_the_rate: found.brier_of_the_rate,
            log_loss: found.log_loss,
            expected_calibration_error: found.expected_error,
            bins: found
                .bins
                .iter()
                .map(|bin| ReliabilityBin {
                    rows: bin.rows as u64,
                    stated: bin.stated,
                    observed: bin.observed,
                    interval_95: ends(bin.interval),
                })
                .collect(),
        })
        .into()
}
