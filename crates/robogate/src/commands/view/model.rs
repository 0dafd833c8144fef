//! The risk model of a run as numbers that the page evaluates.

use std::sync::Arc;

use robogate_analysis::{ExplorerTable, Role, ValueKind};
use robogate_core::{Domain, Scale, Scenario, Seed, Value};
use robogate_dictionary::Provenance;
use robogate_risk::{Fitting, Inputs, Learner, RiskModel, Sample, all_processors};
use robogate_stats::spline_logistic::SplineTerm;
use serde_json::{Value as Json, json};

/// Largest number of rows of a fit. More hardly change it, and the fit takes seconds.
const MAX_ROWS: usize = 4_000;
/// Digits of the numbers on the page.
const DIGITS: i32 = 9;

/// The valid episodes of a run for a fit, at equal distances in order of arrival. Those that the model of an active stage
/// chose are left out.
pub(super) struct Training {
    provenance: Arc<Provenance>,
    samples: Vec<Sample>,
    /// For each parameter, its column and its levels.
    columns: Vec<(usize, Vec<String>)>,
    valid: usize,
}

/// Copies the episodes of the run with this number from the table.
pub(super) fn training(table: &ExplorerTable, run: usize, provenance: &Arc<Provenance>) -> Training {
    let columns = table.columns();
    let find = |name: &str| columns.iter().position(|column| column.role == Role::Parameter && column.name == name);
    let of_role = |role: Role| columns.iter().find(|column| column.role == role);
    let (runs, outcomes, index) = (of_role(Role::Run), of_role(Role::Outcome), of_role(Role::Index));
    let stages = of_role(Role::Stage);
    let values = |column: Option<&robogate_analysis::ExplorerColumn>, row: usize| {
        column.and_then(|column| column.values().get(row).copied()).map_or(f64::NAN, f64::from)
    };
    let invalid = outcomes.and_then(|column| column.levels.iter().position(|level| level == "invalid"));
    // An active stage chooses its points knowing the hidden draws, so among its rows the rate at given parameters is not that
    // of the operating space. Its uniform part is another stage of the table.
    let chosen = stages.and_then(|column| column.levels.iter().position(|level| level == "active"));
    let is_chosen = |row: &usize| chosen.is_some_and(|code| values(stages, *row).to_bits() == (code as f64).to_bits());
    let is_valid = |row: &usize| {
        let outcome = values(outcomes, *row);
        values(runs, *row).to_bits() == (run as f64).to_bits()
            && invalid.is_none_or(|code| outcome.to_bits() != (code as f64).to_bits())
    };
    let valid: Vec<usize> = (0..table.rows()).filter(is_valid).collect();
    let rows: Vec<usize> = valid.iter().copied().filter(|row| !is_chosen(row)).collect();
    let step = rows.len().div_ceil(MAX_ROWS).max(1);
    let parameters: Vec<_> = provenance
        .space
        .parameters()
        .iter()
        .filter_map(|parameter| Some((Arc::clone(&parameter.name), &parameter.domain, find(&parameter.name)?)))
        .collect();
    let samples = rows.iter().step_by(step).map(|row| {
        let requested = parameters.iter().filter_map(|(name, domain, at)| {
            let column = &columns[*at];
            let value = f64::from(*column.values().get(*row)?);
            let value = match (domain, column.kind) {
                _ if value.is_nan() => return None,
                (Domain::Categorical { .. }, ValueKind::Category) => {
                    Value::Category(column.levels.get(value as usize)?.as_str().into())
                }
                (Domain::Integer { .. }, _) => Value::Integer(value as i64),
                _ => Value::Number(value),
            };
            Some((Arc::clone(name), value))
        });
        let index = values(index, *row) as u64;
        let scenario =
            Scenario { index, seed: Seed::campaign(provenance.seed).episode(index), requested: requested.collect() };
        // The first level of an outcome is always success.
        Sample { scenario, success: values(outcomes, *row) <= 0.0 }
    });
    Training {
        provenance: Arc::clone(provenance),
        samples: samples.collect(),
        columns: parameters.iter().map(|(_, _, at)| (*at, columns[*at].levels.clone())).collect(),
        valid: valid.len(),
    }
}

/// Fits the chance of success to parameters, averaged over the hidden draws, and returns its numbers.
///
/// # Errors
/// Too few episodes of one outcome, in words.
pub(super) fn fit(training: &Training) -> Result<Json, String> {
    let inputs = Arc::new(Inputs::new(&training.provenance.space, None));
    let how = Fitting { learner: Learner::Splines, threads: all_processors(), ..Fitting::default() };
    let model = RiskModel::fit(inputs, &training.samples, how).map_err(|error| error.to_string())?;
    let splines = model.splines().ok_or("the model has no splines")?;
    let parts = splines.parts();
    let mut columns = Vec::new();
    for (parameter, (column, levels)) in training.provenance.space.parameters().iter().zip(&training.columns) {
        match &parameter.domain {
            Domain::Continuous { low, high, scale } => {
                columns.push(json!({ "column": column, "low": low, "high": high, "log": *scale == Scale::Log }));
            }
            // The middle of a cell: (value - low + 1/2) / levels.
            Domain::Integer { low, high } => {
                columns.push(
                    json!({ "column": column, "low": *low as f64 - 0.5, "high": *high as f64 + 0.5, "log": false }),
                );
            }
            Domain::Categorical { choices } => columns.extend(choices.iter().map(|choice| {
                let level = levels.iter().position(|level| **level == **choice);
                json!({ "column": column, "level": level })
            })),
        }
    }
    let terms = parts.terms.iter().map(|term| match term {
        SplineTerm::Line(at) => json!([at]),
        SplineTerm::Hinge(at, knot) => json!([at, rounded(*knot), "hinge"]),
        SplineTerm::Product(a, b) => json!([a, b]),
    });
    let size = parts.coefficients.len();
    let factor = (0..size).flat_map(|i| &parts.precision_factor[i * size..=i * size + i]);
    let successes =
        training.samples.iter().filter(|sample| sample.success).count() as f64 / training.samples.len().max(1) as f64;
    let choice = model.choice();
    Ok(json!({
        "version": 1,
        "rows": training.samples.len(),
        "valid": training.valid,
        "brier": choice.brier,
        "brier_of_rate": successes * (1.0 - successes),
        "calibration": choice.calibration,
        "inputs": columns,
        "terms": terms.collect::<Vec<_>>(),
        "mean": parts.scale.iter().map(|(mean, _)| rounded(*mean)).collect::<Vec<_>>(),
        "deviation": parts.scale.iter().map(|(_, deviation)| rounded(*deviation)).collect::<Vec<_>>(),
        "coefficients": parts.coefficients.iter().map(|x| rounded(*x)).collect::<Vec<_>>(),
        "factor": factor.map(|x| rounded(*x)).collect::<Vec<_>>(),
    }))
}

/// A number with [`DIGITS`] significant digits, which keeps the page small.
fn rounded(x: f64) -> f64 {
    let size = if x.abs() > 0.0 { x.abs().log10().floor() as i32 } else { 0 };
    let unit = 10_f64.powi(size - DIGITS + 1);
    let text = format!("{:.*e}", (DIGITS - 1) as usize, (x / unit).round() * unit);
    text.parse().unwrap_or(x)
}
