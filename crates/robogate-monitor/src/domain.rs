//! What was validated: whether a cycle's parameters lie inside, and what the risk model expects of them.
//!
//! Two questions about a cycle that reports its parameters, both answered while the robot still succeeds:
//!
//! - **Is it inside the envelope?** Each reported parameter is held against the range, or the words, that were evaluated. Where the
//!   risk model can be asked, their combination is too: the variance of the model's log-odds, x' V x, must not exceed the
//!   largest one among the episodes that it was fitted to. Beyond it the model extrapolates although each parameter
//!   alone is inside its range.
//! - **How likely is a failure?** p = 1 / (1 + exp(-x' b)), with the coefficients b of the logistic risk model and a category's
//!   penalty in place of its word. Asked only where every parameter of the model is reported.
//!
//! Limit: an envelope of ranges is a box, and x' V x is an ellipsoid around the mean; neither knows of a hole inside. The risk model is
//! the analysis' own, with the limits that it states. A parameter that the envelope does not name is not judged.
//! Source for x' V x as the domain of a regression: Montgomery, Peck and Vining, Introduction to Linear Regression Analysis, "hidden
//! extrapolation".

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::cycle::{Cycle, MOST_PARAMETERS, ParameterValue};

/// What was validated.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// What each parameter was evaluated at.
    pub envelope: BTreeMap<String, Validated>,
    /// The model of P(failure); absent where the evidence allows none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub risk: Option<Risk>,
}

/// What one parameter was evaluated at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Validated {
    /// From low to high, both included, in the unit that the parameter's name ends with.
    Range([f64; 2]),
    /// One of these words.
    Words(Vec<String>),
}

/// A logistic model of P(failure).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Risk {
    /// Log-odds of a failure where every term is 0.
    pub intercept: f64,
    /// Its parameters.
    pub terms: Vec<RiskTerm>,
    /// Covariance of the intercept and the coefficients, row by row.
    pub covariance: Vec<f64>,
    /// The largest variance of the log-odds among the episodes that it was fitted to.
    pub most_variance: f64,
}

/// One parameter of the risk model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RiskTerm {
    /// The parameter.
    pub parameter: String,
    /// Log-odds of a failure per unit, or per unit of penalty.
    pub coefficient: f64,
    /// Of a word: the penalty that stands for each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub penalties: Option<BTreeMap<String, f64>>,
}

/// Why a domain cannot be one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DomainError {
    /// A range that is none.
    #[error("the envelope of `{0}` is neither a range of finite numbers, low first, nor a list of words")]
    Envelope(String),
    /// More parameters than a cycle can report.
    #[error("{0} parameters, but a cycle reports at most {MOST_PARAMETERS}")]
    Parameters(usize),
    /// A covariance of another size.
    #[error("the covariance of the risk model has {found} numbers, but {expected} belong to its terms")]
    Covariance {
        /// What it has.
        found: usize,
        /// (terms + 1)².
        expected: usize,
    },
    /// A number that is not finite.
    #[error("the risk model holds a number that is not finite")]
    NotFinite,
}

/// What is said of one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Judged {
    /// Whether it lies outside what was validated; `None` where it reports nothing that was.
    pub outside: Option<bool>,
    /// Whether it does so by the combination of its parameters alone.
    pub by_combination: bool,
    /// P(failure); `None` where a parameter of the model is missing, or there is no model.
    pub risk: Option<f64>,
}

impl Domain {
    /// Refuses what cannot be a domain.
    ///
    /// # Errors
    /// The first thing that is wrong.
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

    /// Judges a cycle. Each parameter of the envelope that lies outside is handed over with its place there.
    pub fn judge(&self, cycle: &Cycle, mut outside: impl FnMut(usize, &ParameterValue)) -> Judged {
        let (mut reported, mut beyond) = (false, false);
        for (place, (name, validated)) in self.envelope.iter().enumerate() {
            let Some(value) = cycle.parameters.get(name) else { continue };
            reported = true;
            if !validated.holds(value) {
                beyond = true;
                outside(place, value);
            }
        }
        let asked = self.risk.as_ref().and_then(|risk| risk.of(cycle));
        let by_combination = !beyond && asked.is_some_and(|(_, extrapolates)| extrapolates);
        Judged {
            outside: reported.then_some(beyond || by_combination),
            by_combination,
            risk: asked.map(|(risk, _)| risk),
        }
    }
}

impl Validated {
    /// Whether a value was evaluated. A word for a number, or a number for a word, was not.
    pub fn holds(&self, value: &ParameterValue) -> bool {
        match (self, value) {
            (Self::Range([low, high]), ParameterValue::Number(x)) => low <= x && x <= high,
            (Self::Words(words), ParameterValue::Word(word)) => words.contains(word),
            _ => false,
        }
    }
}

impl Risk {
    /// P(failure), and whether the model extrapolates; `None` where a parameter is missing or has no number.
    fn of(&self, cycle: &Cycle) -> Option<(f64, bool)> {
        let mut x = [0.0; MOST_PARAMETERS + 1];
        let x = x.get_mut(..=self.terms.len())?;
        let (one, rest) = x.split_first_mut()?;
        *one = 1.0;
        let mut log_odds = self.intercept;
        for (slot, term) in rest.iter_mut().zip(&self.terms) {
            *slot = match (cycle.parameters.get(&term.parameter)?, &term.penalties) {
                (ParameterValue::Number(number), None) => *number,
                (ParameterValue::Word(word), Some(penalties)) => *penalties.get(word)?,
                _ => return None,
            };
            log_odds += term.coefficient * *slot;
        }
        let rows = self.covariance.chunks_exact(x.len()).zip(x.iter());
        let variance: f64 = rows.map(|(row, a)| a * row.iter().zip(x.iter()).map(|(v, b)| v * b).sum::<f64>()).sum();
        let risk = 1.0 / (1.0 + (-log_odds).exp());
        // The episodes at the edge themselves must not fall out by rounding.
        let inside = variance <= self.most_variance * (1.0 + 1e-9);
        Some((if risk.is_finite() { risk } else { 1.0 }, !inside))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two correlated parameters and a word, as a campaign would leave them.
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
        let judged = domain().judge(&cycle, |place, _| outside.push(place));
        (judged, outside)
    }

    #[test]
    fn a_cycle_inside_has_the_models_risk() {
        domain().check().unwrap();
        let (found, outside) = judged(r#"{"mass_kg": 0.3, "friction": 0.5, "shape": "can"}"#);
        assert_eq!((found.outside, outside.len()), (Some(false), 0));
        let expected = 1.0 / (1.0 + f64::exp(4.0 - 1.5 + 1.0 - 1.5));
        assert!((found.risk.unwrap() - expected).abs() < 1e-15);
    }

    #[test]
    fn what_lies_outside_is_named_and_both_ends_are_inside() {
        // In the order of the names: friction, mass_kg, shape.
        assert_eq!(judged(r#"{"mass_kg": 0.81, "friction": 0.2, "shape": "can"}"#).1, [1]);
        assert_eq!(judged(r#"{"mass_kg": 0.8, "friction": 0.1999, "shape": "tube"}"#).1, [0, 2]);
        assert_eq!(judged(r#"{"mass_kg": "heavy"}"#).1, [1]);
    }

    #[test]
    fn a_combination_beyond_the_fitted_ones_is_outside_although_each_parameter_is_inside() {
        let (found, outside) = judged(r#"{"mass_kg": 0.8, "friction": 1.0, "shape": "box"}"#);
        // 1 + 0.64 + 1 + 2 · 0.9 · 0.8 = 4.08 > 2.5.
        assert_eq!((found.outside, found.by_combination, outside.len()), (Some(true), true, 0));
    }

    #[test]
    fn what_is_not_reported_is_not_judged() {
        let (found, _) = judged(r#"{"mass_kg": 0.3}"#);
        assert_eq!((found.outside, found.risk), (Some(false), None));
        let (found, _) = judged(r#"{"humidity": 0.3}"#);
        assert_eq!((found.outside, found.risk), (None, None));
    }

    #[test]
    fn a_domain_that_cannot_be_is_refused() {
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
