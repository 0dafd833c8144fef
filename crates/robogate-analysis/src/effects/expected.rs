//! The failures that the parameters other than the tested one lead to expect.
//!
//! A ridge logistic regression on the ranks of the other numeric parameters and on the levels of the other categorical ones predicts
//! each row. The test of the parameter then compares failures with expectations, so that the part of their variance that the
//! other parameters explain does not hide its effect. The prior is chosen by evidence: where nothing has an effect, the expectation
//! is almost the overall rate.

use robogate_stats::correlation::midranks;
use robogate_stats::effect_test::Unit;
use robogate_stats::logistic::{Data, standardized};
use robogate_stats::ridge;

use crate::table::{ParameterKind, Sample};

/// Most columns of the model.
const MOST_COLUMNS: usize = 24;
/// Most levels of a categorical parameter in the model.
const MOST_LEVELS: usize = 8;
/// The prior variances of which the evidence selects one.
const PRIOR_VARIANCES: [f64; 4] = [0.02, 0.1, 0.5, 2.0];

/// The rows, with the failures that are expected without the parameter at this place.
pub(super) fn units(base: &Sample, without: usize) -> Vec<Unit> {
    let failed = predicted(base, without).unwrap_or_else(|| {
        let (all, failures) = (0..base.len()).fold((0.0, 0.0), |(all, failures), row| {
            let weight = base.weight(row);
            (all + weight, failures + if base.success[row] { 0.0 } else { weight })
        });
        vec![failures / f64::max(all, f64::MIN_POSITIVE); base.len()]
    });
    let unit = |(row, expected): (usize, f64)| {
        let n = base.weight(row);
        Unit { n, failures: if base.success[row] { 0.0 } else { n }, expected: n * expected }
    };
    failed.into_iter().enumerate().map(unit).collect()
}

/// The predicted chance of failure. `None` without other parameters, and if the model cannot be fitted.
fn predicted(base: &Sample, without: usize) -> Option<Vec<f64>> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for parameter in base.parameters.iter().enumerate().filter(|(at, _)| *at != without).map(|(_, p)| p) {
        match &parameter.kind {
            ParameterKind::Categorical { levels } if levels.len() > MOST_LEVELS => {}
            ParameterKind::Categorical { levels } => columns.extend((1..levels.len()).filter_map(|level| {
                let is = |value: &f64| f64::from(u8::from(*value as usize == level));
                standardized(&parameter.values.iter().map(is).collect::<Vec<_>>())
            })),
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => {
                columns.extend(standardized(&midranks(&parameter.values)));
            }
        }
    }
    columns.truncate(MOST_COLUMNS);
    if columns.is_empty() {
        return None;
    }
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let data = Data::new(&slices, &base.success, base.weights.as_deref()).ok()?;
    let found = ridge::by_evidence(data, &PRIOR_VARIANCES).ok()??;
    let log_odds = |row: usize| {
        let terms = slices.iter().zip(&found.coefficients[1..]).map(|(column, beta)| beta * column[row]);
        found.coefficients[0] + terms.sum::<f64>()
    };
    Some((0..base.len()).map(|row| 1.0 / (1.0 + log_odds(row).exp())).collect())
}
