//! The effect of one parameter on each compared dataset: the slope of the log-odds of success over its logarithm.

use robogate_stats::Confidence;
use robogate_stats::logistic::{Data, Estimator, Options, Profile, RegressionError, firth_profile, fit};
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::axis::SharedAxis;
use crate::comparison::dataset::Dataset;
use crate::labels::parameter_label;
use crate::models::why;
use crate::rate::{Finding, Rate, ends};

/// The effect of one parameter on each compared dataset, over the range that all of them cover.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sensitivity {
    /// The parameter.
    pub parameter: String,
    /// The range, in the parameter's unit.
    pub range: [f64; 2],
    /// The lowest bin.
    pub low: [f64; 2],
    /// The highest bin.
    pub high: [f64; 2],
    /// The effect on each compared dataset, in their order.
    pub effects: Vec<Effect>,
    /// Names of the datasets in which larger values significantly lower success: all if every 95 % interval lies below
    /// 0 (intersection-union), otherwise those with a p-value of at most 0.05 after Holm's adjustment.
    pub lowers_success_of: Vec<String>,
}

/// The effect of the parameter on one dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Effect {
    /// Its name.
    pub name: String,
    /// Slope of the log-odds of success per unit of the parameter's natural logarithm: below 0, larger values lower
    /// success.
    pub slope: Finding<Slope>,
    /// Success in the lowest bin.
    pub low: Rate,
    /// Success in the highest bin.
    pub high: Rate,
}

/// A slope with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Slope {
    /// Change of the log-odds per unit of the natural logarithm.
    pub per_log_unit: f64,
    /// 95 % interval: Wald's, or the profile interval of the penalised fit if success and failure are separated. An
    /// unbounded end is `None`.
    pub interval_95: [Option<f64>; 2],
    /// Factor of the odds of success when the parameter doubles.
    pub odds_per_doubling: f64,
    /// ln of the two-sided p-value that the parameter has no effect.
    pub ln_p: f64,
    /// Whether it is Firth's penalised fit.
    pub penalised: bool,
}

/// Fits the effect of the parameter that the task declares for comparisons.
pub(crate) fn sensitivity(
    datasets: &[&Dataset<'_>],
    axes: &[SharedAxis],
    parameter: Option<&str>,
) -> Finding<Sensitivity> {
    let Some(parameter) = parameter else {
        return Finding::not("the task declares no parameter for this comparison");
    };
    let Some(axis) = axes.iter().find(|axis| axis.axis.parameter == parameter) else {
        return Finding::not(format!("not every dataset has {parameter}"));
    };
    let cells = axis.cells();
    let (Some(low), Some(high)) = (axis.range(0), axis.range(cells.saturating_sub(1))) else {
        return Finding::not(format!("{parameter} has no numeric range"));
    };
    let range = [low[0], high[1]];
    if range[0] <= 0.0 {
        return Finding::not(format!("{parameter} is not positive everywhere"));
    }
    let effects = datasets.iter().map(|dataset| {
        let trials = axis.trials(dataset);
        Effect {
            name: dataset.name.clone(),
            slope: slope(dataset, parameter, range),
            low: Rate::of(trials[0]),
            high: Rate::of(trials[cells - 1]),
        }
    });
    let effects: Vec<Effect> = effects.collect();
    let lowers_success_of = lowers_success_of(&effects);
    Finding::Estimated(Sensitivity { parameter: parameter.to_owned(), range, low, high, effects, lowers_success_of })
}

fn lowers_success_of(effects: &[Effect]) -> Vec<String> {
    let slopes = || effects.iter().map(|effect| effect.slope.estimated());
    let below_zero = |slope: Option<&Slope>| slope.and_then(|s| s.interval_95[1]).is_some_and(|high| high < 0.0);
    if slopes().all(below_zero) {
        return effects.iter().map(|effect| effect.name.clone()).collect();
    }
    let p: Vec<f64> = slopes().flatten().map(|slope| slope.ln_p.exp()).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    let estimated = effects.iter().filter_map(|effect| Some((effect, effect.slope.estimated()?)));
    let lowers = estimated.zip(adjusted).filter(|((_, slope), p)| *p <= 0.05 && slope.per_log_unit < 0.0);
    lowers.map(|((effect, _), _)| effect.name.clone()).collect()
}

fn slope(dataset: &Dataset<'_>, parameter: &str, [low, high]: [f64; 2]) -> Finding<Slope> {
    let Some(column) = dataset.parameter(parameter) else {
        return Finding::not(format!("the dataset has no {parameter}"));
    };
    let inside = |value: &f64| (low..=high).contains(value);
    let logs: Vec<f64> = column.values.iter().copied().filter(inside).map(f64::ln).collect();
    let rows = || (0..dataset.base.len()).filter(|row| inside(&column.values[*row]));
    let success: Vec<bool> = rows().map(|row| dataset.base.success[row]).collect();
    let weights: Option<Vec<f64>> = dataset.base.weights.as_ref().map(|of| rows().map(|row| of[row]).collect());
    slope_of(&logs, &success, weights.as_deref(), &parameter_label(parameter))
}

fn slope_of(logs: &[f64], success: &[bool], weights: Option<&[f64]>, label: &str) -> Finding<Slope> {
    let names = [format!("ln({label})")];
    let columns = [logs];
    let fitted = Data::new(&columns, success, weights)
        .and_then(|data| Ok((data, fit(data, Options::for_rows(weights.is_some()))?)));
    let (data, fitted) = match fitted {
        Ok(both) => both,
        Err(error) => return Finding::not(why(&error, &names)),
    };
    let Some(coefficient) = fitted.terms.first().and_then(|term| term.coefficient()) else {
        return Finding::not(format!("every episode has the same {label}"));
    };
    let doubling = |slope: f64| (slope * std::f64::consts::LN_2).exp();
    if fitted.estimator != Estimator::Firth {
        let [low, high] = ends(coefficient.interval(Confidence::P95));
        return Finding::Estimated(Slope {
            per_log_unit: coefficient.estimate,
            interval_95: [Some(low), Some(high)],
            odds_per_doubling: doubling(coefficient.estimate),
            ln_p: coefficient.ln_p.max(f64::MIN),
            penalised: false,
        });
    }
    let profile: Result<Profile, RegressionError> = firth_profile(data, 0, Confidence::P95);
    match profile {
        Ok(profile) => Finding::Estimated(Slope {
            per_log_unit: profile.estimate,
            interval_95: ends(profile.interval).map(|end| Some(end).filter(|end| end.is_finite())),
            odds_per_doubling: doubling(profile.estimate),
            ln_p: profile.ln_p.max(f64::MIN),
            penalised: true,
        }),
        Err(error) => Finding::not(why(&error, &names)),
    }
}
