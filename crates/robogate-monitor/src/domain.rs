//! The validated region: whether a cycle lies inside it, and the failure probability that the risk model predicts.
//!
//! Both can be computed before a robot fails:
//!
//! - **Envelope**: each reported parameter is compared with the evaluated range or categories. If the cycle reports every
//!   parameter of the risk model, the combination is checked too: the variance of the model's log-odds, x' V x, must not
//!   exceed the largest one among the episodes that the model was fitted to. Beyond it the model extrapolates, although each
//!   parameter is inside its own range.
//! - **Risk**: the chance of failure by the calibrated model of the reference ([`Predictor`]), or by the logistic one, p = 1 / (1 +
//!   exp(-x' b)) with a penalty for each category. The cycle must report every parameter of both.
//!
//! Limitations: an envelope of ranges is a box, and x' V x is an ellipsoid around the mean; neither detects a hole
//! inside. The risk model has the limitations that the analysis states. A parameter that is not in the envelope is not
//! checked. Source for x' V x as the domain of a regression: Montgomery, Peck and Vining, Introduction to Linear
//! Regression Analysis, "hidden extrapolation".
use std::collections::BTreeMap;

use robogate_stats::flexible::Scorer;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::cycle::{Cycle, MOST_PARAMETERS, ParameterValue};

/// Most columns of a predictor.
const MOST_COLUMNS: usize = 256;

/// The validated region of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// The evaluated values of each parameter.
    pub envelope: BTreeMap<String, Validated>,
    /// The model of P(failure). `None` if the run does not allow one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub risk: Option<Risk>,
}

/// The evaluated values of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Validated {
    /// A range from low to high, both inclusive, in the unit of the parameter's name.
    Range([f64; 2]),
    /// One of these categories.
    Words(Vec<String>),
}

/// A model of P(failure): the logistic one, whose covariance shows extrapolation, and a calibrated one that predicts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Risk {
    /// Log-odds of a failure if all terms are 0.
    pub intercept: f64,
    /// The parameters.
    pub terms: Vec<RiskTerm>,
    /// Covariance of the intercept and the coefficients, row by row.
    pub covariance: Vec<f64>,
    /// The largest variance of the log-odds among the episodes that the model was fitted to.
    pub most_variance: f64,
    /// The model that predicts. Absent in files of version 0.2 and older: the logistic model then predicts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predictor: Option<Predictor>,
}

/// A calibrated model of P(success) without an assumption about the shape of the effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "WrittenPredictor", into = "WrittenPredictor")]
#[schemars(!try_from, with = "WrittenPredictor")]
pub struct Predictor {
    columns: Vec<PredictorColumn>,
    model: Scorer,
}

/// A column of the predictor: the value of a parameter, or whether it has this category.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictorColumn {
    /// The parameter.
    pub parameter: String,
    /// The category. Absent for a number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
}

/// A predictor as it is written.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct WrittenPredictor {
    /// The columns.
    columns: Vec<PredictorColumn>,
    /// The calibration, the terms of the splines and the trees, one a line.
    model: Vec<String>,
}

impl Predictor {
    /// A model of rows with these columns.
    pub fn new(columns: Vec<PredictorColumn>, model: Scorer) -> Self {
        Self { columns, model }
    }

    /// P(failure). `None` if a parameter is missing or of another type.
    fn of(&self, cycle: &Cycle) -> Option<f64> {
        let mut row = [0.0; MOST_COLUMNS];
        let row = row.get_mut(..self.columns.len())?;
        for (slot, column) in row.iter_mut().zip(&self.columns) {
            *slot = match (cycle.parameters.get(&column.parameter)?, &column.category) {
                (ParameterValue::Number(number), None) => *number,
                (ParameterValue::Word(word), Some(category)) => f64::from(u8::from(word == category)),
                _ => return None,
            };
        }
        Some(1.0 / (1.0 + self.model.log_odds(row).exp()))
    }
}

impl TryFrom<WrittenPredictor> for Predictor {
    type Error = String;

    fn try_from(written: WrittenPredictor) -> Result<Self, String> {
        let n = written.columns.len();
        if n > MOST_COLUMNS {
            return Err(format!("the predictor has {n} columns. Expected at most {MOST_COLUMNS}"));
        }
        let model = Scorer::parse(&written.model, n).map_err(|why| format!("the model of the predictor: {why}"))?;
        Ok(Self { columns: written.columns, model })
    }
}

impl From<Predictor> for WrittenPredictor {
    fn from(predictor: Predictor) -> Self {
        Self { model: predictor.model.lines(), columns: predictor.columns }
    }
}

/// One parameter of the risk model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RiskTerm {
    /// The parameter.
    pub parameter: String,
    /// Log-odds of a failure per unit, per unit of penalty, or per unit of the logarithm.
    pub coefficient: f64,
    /// Whether the natural logarithm of the parameter enters the model.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub log: bool,
    /// The penalty of each category, for a categorical parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub penalties: Option<BTreeMap<String, f64>>,
}

/// An error in a validated region.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DomainError {
    /// An invalid range.
    #[error(
        "the envelope of `{0}` is not valid. Expected a range of two finite numbers, low first, or a list of categories"
    )]
    Envelope(String),
    /// More parameters than a cycle can report.
    #[error("{0} parameters. Expected at most {MOST_PARAMETERS}, the most that a cycle reports")]
    Parameters(usize),
    /// A covariance matrix of the wrong size.
    #[error("the covariance of the risk model has {found} numbers. Expected {expected} for its terms")]
    Covariance {
        /// The given size.
        found: usize,
        /// The expected size: (terms + 1)².
        expected: usize,
    },
    /// A number that is not finite.
    #[error("the risk model contains a number that is not finite")]
    NotFinite,
}

/// The result for one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Judged {
    /// Whether the cycle lies outside the validated region. `None` if it reports no parameter of the envelope.
    pub outside: Option<bool>,
    /// Whether only the combination of its parameters lies outside.
    pub by_combination: bool,
    /// P(failure). `None` without a model, or if a parameter of the model is missing.
    pub risk: Option<f64>,
}

impl Domain {
    /// Checks ranges and sizes.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), DomainError> {
        for (name, validated) in &self.envelope {
            let good = match validated {
                Validated::Range([low, high]) => low.is_finite() && high.is_finite() && low <= high,
                Validated::Words(words) => !words.is_empty(),
            };
            if !good {
                return Err(DomainError::Envelope(name.clone()));
            }
        }
        let terms = self.risk.as_ref().map_or(0, |risk| risk.terms.len());
        let most = self.envelope.len().max(terms);
        if most > MOST_PARAMETERS {
            return Err(DomainError::Parameters(most));
        }
        let Some(risk) = &self.risk else { return Ok(()) };
        let (found, expected) = (risk.covariance.len(), (terms + 1).pow(2));
        if found != expected {
            return Err(DomainError::Covariance { found, expected });
        }
        let penalties = risk.terms.iter().filter_map(|term| term.penalties.as_ref()).flat_map(BTreeMap::values);
        let coefficients = risk.terms.iter().map(|term| &term.coefficient);
        let mut all =
            penalties.chain(coefficients).chain(&risk.covariance).chain([&risk.intercept, &risk.most_variance]);
        if all.all(|x| x.is_finite()) { Ok(()) } else { Err(DomainError::NotFinite) }
    }

    /// Judges a cycle. Calls `seen` for each parameter of the envelope that it reports, with the parameter's index, its value, and whether
    /// that lies outside.
    pub fn judge(&self, cycle: &Cycle, mut seen: impl FnMut(usize, &ParameterValue, bool)) -> Judged {
        let (mut reported, mut beyond) = (false, false);
        for (place, (name, validated)) in self.envelope.iter().enumerate() {
            let Some(value) = cycle.parameters.get(name) else { continue };
            reported = true;
            let outside = !validated.holds(value);
            beyond |= outside;
            seen(place, value, outside);
        }
        let predicted = self.risk.as_ref().and_then(|risk| risk.of(cycle));
        let by_combination = !beyond && predicted.is_some_and(|(_, extrapolates)| extrapolates);
        Judged {
            outside: reported.then_some(beyond || by_combination),
            by_combination,
            risk: predicted.map(|(risk, _)| risk),
        }
    }
}

impl Validated {
    /// Whether a value was evaluated. A value of another type was not.
    pub fn holds(&self, value: &ParameterValue) -> bool {
        match (self, value) {
            (Self::Range([low, high]), ParameterValue::Number(x)) => low <= x && x <= high,
            (Self::Words(words), ParameterValue::Word(word)) => words.contains(word),
            _ => false,
        }
    }
}

impl Risk {
    /// P(failure), and whether the model extrapolates. `None` if a parameter is missing or unknown.
    fn of(&self, cycle: &Cycle) -> Option<(f64, bool)> {
        let mut x = [0.0; MOST_PARAMETERS + 1];
        let x = x.get_mut(..=self.terms.len())?;
        let (one, rest) = x.split_first_mut()?;
        *one = 1.0;
        let mut log_odds = self.intercept;
        for (slot, term) in rest.iter_mut().zip(&self.terms) {
            *slot = match (cycle.parameters.get(&term.parameter)?, &term.penalties) {
                (ParameterValue::Number(number), None) if !term.log => *number,
                // Other numbers have no logarithm, so the model says nothing about them.
                (ParameterValue::Number(number), None) if *number > 0.0 => number.ln(),
                (ParameterValue::Word(word), Some(penalties)) => *penalties.get(word)?,
                _ => return None,
            };
            log_odds += term.coefficient * *slot;
        }
        let rows = self.covariance.chunks_exact(x.len()).zip(x.iter());
        let variance: f64 = rows.map(|(row, a)| a * row.iter().zip(x.iter()).map(|(v, b)| v * b).sum::<f64>()).sum();
        let risk = match &self.predictor {
            Some(predictor) => predictor.of(cycle)?,
            None => 1.0 / (1.0 + (-log_odds).exp()),
        };
        // Rounding must not exclude the episodes at the edge.
        let inside = variance <= self.most_variance * (1.0 + 1e-9);
        Some((if risk.is_finite() { risk } else { 1.0 }, !inside))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two correlated parameters and a categorical one, as in the reference of a campaign.
    fn domain() -> Domain {
        let json = r#"{
            "envelope": {"mass_kg": {"range": [0.1, 0.8]}, "friction": {"range": [0.2, 1.0]}, "shape": {"words": ["box", "can"]}},
            "risk": {"intercept": -4, "terms": [
                {"parameter": "mass_kg", "coefficient": 5}, {"parameter": "friction", "coefficient": -2},
                {"parameter": "shape", "coefficient": 3, "penalties": {"box": 0.1, "can": 0.5}}],
                "covariance": [1,0,0,0, 0,1,0.9,0, 0,0.9,1,0, 0,0,0,0], "most_variance": 2.5}}"#;
        serde_json::from_str(json).unwrap()
    }

    fn judged(parameters: &str) -> (Judged, Vec<usize>) {
        let json =
            format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true,"parameters":{parameters}}}"#);
        let cycle: Cycle = serde_json::from_str(&json).unwrap();
        let mut outside = Vec::new();
        let judged = domain().judge(&cycle, |place, _, is_outside| outside.extend(is_outside.then_some(place)));
        (judged, outside)
    }

    #[test]
    fn inside_cycles_have_model_risk() {
        domain().check().unwrap();
        let (found, outside) = judged(r#"{"mass_kg": 0.3, "friction": 0.5, "shape": "can"}"#);
        assert_eq!((found.outside, outside.len()), (Some(false), 0));
        let expected = 1.0 / (1.0 + f64::exp(4.0 - 1.5 + 1.0 - 1.5));
        assert!((found.risk.unwrap() - expected).abs() < 1e-15);
    }

    #[test]
    fn logarithmic_terms_use_the_logarithm() {
        let mut domain = domain();
        domain.risk.as_mut().unwrap().terms[0].log = true;
        let risk = |mass: f64| {
            let parameters = format!(r#"{{"mass_kg": {mass}, "friction": 0.5, "shape": "can"}}"#);
            let json =
                format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true,"parameters":{parameters}}}"#);
            domain.judge(&serde_json::from_str(&json).unwrap(), |_, _, _| {}).risk
        };
        let expected = 1.0 / (1.0 + f64::exp(4.0 - 5.0 * 0.3_f64.ln() + 1.0 - 1.5));
        assert!((risk(0.3).unwrap() - expected).abs() < 1e-15);
        assert_eq!(risk(0.0), None);
    }

    #[test]
    fn predictor_replaces_logistic_risk() {
        let json = r#"{"columns": [{"parameter": "mass_kg"}, {"parameter": "shape", "category": "can"}],
            "model": ["calibration 0.5 line 0.1 1", "spline 1", "line 1 0.5 2 -0.4", "start 0.3", "tree 0<0.45 =0.2 =-2"]}"#;
        let predictor: Predictor = serde_json::from_str(json).unwrap();
        let mut domain = domain();
        domain.risk.as_mut().unwrap().predictor = Some(predictor.clone());
        let risk = |parameters: &str| {
            let json =
                format!(r#"{{"id":"a","robot":"r","recipe":"x","time_s":1,"success":true,"parameters":{parameters}}}"#);
            domain.judge(&serde_json::from_str(&json).unwrap(), |_, _, _| {}).risk
        };
        let expected = |trees: f64, spline: f64| 1.0 / (1.0 + f64::exp(0.1 + 0.5 * trees + 0.5 * spline));
        let can = risk(r#"{"mass_kg": 0.5, "friction": 0.5, "shape": "can"}"#).unwrap();
        assert!((can - expected(0.3 - 2.0, 1.0 - 0.4 * 0.5 / 2.0)).abs() < 1e-15);
        let light = risk(r#"{"mass_kg": 0.4, "friction": 0.5, "shape": "box"}"#).unwrap();
        assert!((light - expected(0.5, 1.0 + 0.4 * 0.5 / 2.0)).abs() < 1e-15);
        assert_eq!(risk(r#"{"mass_kg": 0.4, "friction": 0.5}"#), None);
        let again: Predictor = serde_json::from_str(&serde_json::to_string(&predictor).unwrap()).unwrap();
        assert_eq!(again, predictor);
        assert!(serde_json::from_str::<Predictor>(&json.replace("0<0.45", "2<0.45")).is_err());
    }

    #[test]
    fn parameters_outside_are_named() {
        // In the order of the names: friction, mass_kg, shape.
        assert_eq!(judged(r#"{"mass_kg": 0.81, "friction": 0.2, "shape": "can"}"#).1, [1]);
        assert_eq!(judged(r#"{"mass_kg": 0.8, "friction": 0.1999, "shape": "tube"}"#).1, [0, 2]);
        assert_eq!(judged(r#"{"mass_kg": "heavy"}"#).1, [1]);
    }

    #[test]
    fn unusual_combinations_are_outside() {
        let (found, outside) = judged(r#"{"mass_kg": 0.8, "friction": 1.0, "shape": "box"}"#);
        // 1 + 0.64 + 1 + 2 · 0.9 · 0.8 = 4.08 > 2.5.
        assert_eq!((found.outside, found.by_combination, outside.len()), (Some(true), true, 0));
    }

    #[test]
    fn missing_parameters_are_not_judged() {
        let (found, _) = judged(r#"{"mass_kg": 0.3}"#);
        assert_eq!((found.outside, found.risk), (Some(false), None));
        let (found, _) = judged(r#"{"humidity": 0.3}"#);
        assert_eq!((found.outside, found.risk), (None, None));
    }

    #[test]
    fn invalid_domains_are_rejected() {
        let with = |change: &dyn Fn(&mut Domain)| {
            let mut domain = domain();
            change(&mut domain);
            domain.check().unwrap_err()
        };
        let backwards = Validated::Range([1.0, 0.0]);
        let error = with(&|d| *d.envelope.get_mut("mass_kg").unwrap() = backwards.clone());
        assert_eq!(error, DomainError::Envelope("mass_kg".to_owned()));
        let error = with(&|d| d.risk.as_mut().unwrap().covariance.truncate(15));
        assert_eq!(error, DomainError::Covariance { found: 15, expected: 16 });
        let error = with(&|d| d.risk.as_mut().unwrap().intercept = f64::NAN);
        assert_eq!(error, DomainError::NotFinite);
    }
}
