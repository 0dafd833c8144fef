//! Distances between episodes in the space of their parameters, and the nearest passing twin in words.

use crate::labels::{parameter_label, value_with_unit};
use crate::table::ParameterKind;

/// Maximum number of parameters in a sentence about the difference of two episodes.
const MAX_DIFFERENCES: usize = 3;
/// Smallest difference that is named, as a share of the parameter's range.
const LEAST_DIFFERENCE: f64 = 1e-3;

impl ParameterKind {
    /// A value on a scale from 0 to 1; that of a categorical parameter is its level. A missing value is 0.
    pub(crate) fn position(&self, x: f64) -> f64 {
        let position = match self {
            Self::Continuous { low, high, log: true } if *low > 0.0 => {
                (x.max(*low).ln() - low.ln()) / (high.ln() - low.ln())
            }
            Self::Continuous { low, high, .. } => (x - low) / (high - low),
            Self::Integer { low, high } => (x - *low as f64) / (*high as f64 - *low as f64),
            Self::Categorical { .. } => x,
        };
        if position.is_finite() { position } else { 0.0 }
    }

    /// The distance of two positions along this parameter: 1 for different levels.
    pub(crate) fn apart(&self, a: f64, b: f64) -> f64 {
        let off = (a - b).abs();
        match self {
            Self::Categorical { .. } => f64::from(off > 0.5),
            Self::Continuous { .. } | Self::Integer { .. } => off,
        }
    }

    /// A value for display.
    pub(crate) fn show(&self, value: f64) -> String {
        match self {
            Self::Continuous { .. } => robogate_stats::format::number(value),
            Self::Integer { .. } => format!("{value:.0}"),
            Self::Categorical { levels } => levels.get(value as usize).cloned().unwrap_or_default(),
        }
    }
}

/// A parameter of a failed episode and of its passing twin.
pub(crate) struct Difference<'a> {
    pub(crate) name: &'a str,
    pub(crate) kind: &'a ParameterKind,
    pub(crate) failed: f64,
    pub(crate) passed: f64,
}

/// The largest differences as a sentence about the passing episode.
pub(crate) fn sentence<'a>(parameters: impl Iterator<Item = Difference<'a>>) -> String {
    let apart = |one: &Difference<'_>| {
        let [failed, passed] = [one.failed, one.passed].map(|value| one.kind.position(value));
        one.kind.apart(failed, passed)
    };
    let mut all: Vec<(f64, Difference<'_>)> =
        parameters.map(|one| (apart(&one), one)).filter(|(off, _)| *off > LEAST_DIFFERENCE).collect();
    // A stable sort: equal differences stay in order of the parameters.
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let text = |(_, one): &(f64, Difference<'_>)| {
        let [failed, passed] = [one.failed, one.passed].map(|value| value_with_unit(&one.kind.show(value), one.name));
        format!("{} {passed} instead of {failed}", parameter_label(one.name))
    };
    let parts: Vec<String> = all.iter().take(MAX_DIFFERENCES).map(text).collect();
    if parts.is_empty() { "The parameters are the same.".to_owned() } else { format!("It has {}.", parts.join(", ")) }
}
