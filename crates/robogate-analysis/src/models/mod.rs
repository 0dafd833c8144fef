//! Fitted models: the frontier, the interaction model and the risk model.

mod frontier;
mod interactions;
mod risk;

use robogate_stats::limit_state::LimitStateError;
use robogate_stats::logistic::{Caution, Dropped, Estimator, Fit, RegressionError, Separation, SeparationKind, Term};
use robogate_stats::{Confidence, Interval};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use frontier::{Frontier, FrontierPoint};
pub use risk::{
    CalibrationFigures, Penalty, PenaltyLevel, Predictor, PredictorColumn, ReliabilityBin, RiskModel, RocCurve,
    RocFigures, Scoring, ScoringTerm,
};

pub(crate) use frontier::frontier;
pub(crate) use interactions::{interactions, missing};
pub(crate) use risk::{Scored, risk};

/// A logistic regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Regression {
    /// The outcome whose log-odds it predicts: `success` or `failure`.
    pub outcome: String,
    /// Number of training rows.
    pub rows: u64,
    /// The estimator: `maximum_likelihood`, or `firth` if the data are separated.
    pub estimator: String,
    /// Whether coefficients are per standard deviation of their column, otherwise per unit.
    pub standardized: bool,
    /// The intercept, then every column.
    pub terms: Vec<Coefficient>,
    /// -2 ln L.
    pub deviance: f64,
    /// -2 ln L of the intercept-only model.
    pub null_deviance: f64,
    /// Warnings about the coefficients, in sentences.
    pub warnings: Vec<String>,
}

/// One column of a regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Coefficient {
    /// The column.
    pub term: String,
    /// Its coefficient, or the reason why it has none.
    pub estimate: crate::Finding<Estimate>,
}

/// A coefficient with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// Change of the log-odds.
    pub coefficient: f64,
    /// Standard error.
    pub se: f64,
    /// Coefficient divided by its standard error.
    pub z: f64,
    /// ln of the two-sided p-value. The p-value itself may be too small for an `f64`.
    pub ln_p: f64,
    /// Wald's 95 % interval.
    pub interval_95: [f64; 2],
}

impl Regression {
    pub(crate) fn of(fit: &Fit, outcome: &str, names: &[String], standardized: bool) -> Self {
        let estimate = |c: &robogate_stats::logistic::Coefficient| {
            let Interval { low, high } = c.interval(Confidence::P95);
            Estimate { coefficient: c.estimate, se: c.se, z: c.z, ln_p: c.ln_p.max(f64::MIN), interval_95: [low, high] }
        };
        let intercept =
            Coefficient { term: "intercept".to_owned(), estimate: crate::Finding::Estimated(estimate(&fit.intercept)) };
        let others = fit.terms.iter().zip(names).map(|(term, name)| Coefficient {
            term: name.clone(),
            estimate: match term {
                Term::Estimated(c) => crate::Finding::Estimated(estimate(c)),
                Term::Dropped(why) => crate::Finding::not(dropped(why, names)),
            },
        });
        Self {
            outcome: outcome.to_owned(),
            rows: fit.rows as u64,
            estimator: match fit.estimator {
                Estimator::Firth => "firth",
                _ => "maximum_likelihood",
            }
            .to_owned(),
            standardized,
            terms: std::iter::once(intercept).chain(others).collect(),
            deviance: fit.deviance(),
            null_deviance: -2.0 * fit.null_log_likelihood,
            warnings: fit.cautions.iter().map(|c| caution(c, outcome, names)).collect(),
        }
    }
}

fn dropped(why: &Dropped, names: &[String]) -> String {
    match why {
        Dropped::Constant => "it has the same value in every row".to_owned(),
        Dropped::CollinearWith(with) if with.is_empty() => "it is constant except for rounding".to_owned(),
        Dropped::CollinearWith(with) => {
            let with: Vec<String> = with.iter().filter_map(|i| names.get(*i)).cloned().collect();
            format!("it is a linear combination of {}", robogate_stats::format::list(&with))
        }
    }
}

fn caution(caution: &Caution, outcome: &str, names: &[String]) -> String {
    match caution {
        Caution::Separated(separation) => separated(separation, outcome, names),
        Caution::FewEvents { events, coefficients } => format!(
            "The rarer outcome has {events} rows for {coefficients} coefficients, fewer than ten for each: the coefficients \
             are uncertain and biased away from zero."
        ),
    }
}

fn separated(separation: &Separation, outcome: &str, names: &[String]) -> String {
    let kind = match separation.kind {
        SeparationKind::Complete => "Complete",
        SeparationKind::Quasi => "Quasi-complete",
    };
    let sign = |sign: i8| if sign > 0 { "larger" } else { "smaller" };
    let by: Vec<String> = separation
        .columns
        .iter()
        .zip(&separation.signs)
        .filter_map(|(column, s)| Some(format!("{} values of {}", sign(*s), names.get(*column)?)))
        .collect();
    let by = if by.is_empty() { "the intercept alone".to_owned() } else { robogate_stats::format::list(&by) };
    format!(
        "{kind} separation: {by} predict {outcome} without error in {} rows, so no maximum likelihood estimate exists. \
         The figures are those of Firth's penalised fit, and the Wald intervals are approximate.",
        separation.rows
    )
}

/// The reason why there is no regression, as the end of a sentence.
pub(crate) fn why(error: &RegressionError, names: &[String]) -> String {
    match error {
        RegressionError::NoRows => "there is no valid episode".to_owned(),
        RegressionError::OneClass { rows, .. } => {
            format!("all {rows} episodes have the same outcome")
        }
        RegressionError::NotSettled { .. } => "the fit did not converge; columns may be nearly collinear".to_owned(),
        RegressionError::Separated(separation) => separated(separation, "the outcome", names),
        other => other.to_string(),
    }
}

pub(crate) fn why_no_frontier(error: &LimitStateError, names: &[String]) -> String {
    match error {
        LimitStateError::Regression(error) => why(error, names),
        LimitStateError::MissingTerm { term } => {
            format!(
                "{} is constant or a linear combination of the others",
                names.get(*term).map_or("a column", String::as_str)
            )
        }
        other => other.to_string(),
    }
}
