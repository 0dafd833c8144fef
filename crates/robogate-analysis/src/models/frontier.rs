//! The closed-form frontier of two parameters: where the model predicts 50 % success.

use robogate_stats::clusters::Clusters;
use robogate_stats::limit_state::{CompatibleSet, LimitState, SuccessSide};
use robogate_stats::logistic::{Options, interaction};
use robogate_stats::{Confidence, Interval};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Regression, why_no_frontier};
use crate::labels::{label_and_unit, parameter_label};
use crate::table::{ParameterColumn, Sample};
use crate::{Finding, Rate};
use robogate_stats::format::significant;

/// Number of points of the curve.
const POINTS: usize = 41;
/// Predicted success rates that count as near the frontier.
const NEAR: [f64; 2] = [0.4, 0.6];

/// The frontier x*(y) = (-b0 - b2 y) / (b1 + b3 y) of logit P(success) = b0 + b1 x + b2 y + b3 x y.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Frontier {
    /// The parameter that the frontier is solved for.
    pub x: String,
    /// The parameter that the frontier depends on.
    pub y: String,
    /// The regression, in the parameters' own units.
    pub regression: Regression,
    /// b0 to b3.
    pub coefficients: [f64; 4],
    /// The formula with its coefficients.
    pub closed_form: String,
    /// The value of y at which the frontier diverges.
    pub pole: Option<f64>,
    /// The range of y in which the frontier lies within the observed ranges. `None` if it never does.
    pub valid_for: Option<[f64; 2]>,
    /// Whether success is more likely above the frontier, in the middle of that range.
    pub success_above: Option<bool>,
    /// The observed success rate where the model predicts 40 to 60 %: a check of the model near its own frontier.
    pub near: Rate,
    /// Whether that rate is significantly outside 40 to 60 %: the frontier is then not reliable.
    pub contradicted: bool,
    /// The curve with its pointwise 95 % bands.
    pub curve: Vec<FrontierPoint>,
}

/// The frontier at one y.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrontierPoint {
    /// The value of the parameter that the frontier depends on.
    pub y: f64,
    /// The value of the frontier.
    pub x: f64,
    /// Standard error by the delta method.
    pub se: f64,
    /// x ± 1.96 se.
    pub band_95: [f64; 2],
    /// The exact (Fieller) interval. `None` if it is unbounded, as near the pole.
    pub exact_95: Option<[f64; 2]>,
    /// Whether the point lies within the observed ranges. Otherwise it is an extrapolation.
    pub observed: bool,
}

pub(crate) fn frontier(base: &Sample, x: &ParameterColumn, y: &ParameterColumn) -> Finding<Frontier> {
    for parameter in [x, y] {
        if !parameter.is_numeric() {
            return Finding::not(format!(
                "{} is categorical, and a frontier needs two numeric parameters",
                parameter_label(&parameter.name)
            ));
        }
    }
    let names = [
        parameter_label(&x.name),
        parameter_label(&y.name),
        format!("{} \u{d7} {}", parameter_label(&x.name), parameter_label(&y.name)),
    ];
    let clusters = base.clusters().map(Clusters::of_row);
    let weights = base.weights.as_deref();
    let (state, fit) = match LimitState::fit(
        &x.values,
        &y.values,
        &base.success,
        weights,
        clusters,
        Options::for_rows(weights.is_some()),
        0.5,
    ) {
        Ok(found) => found,
        Err(error) => return Finding::not(why_no_frontier(&error, &names)),
    };
    let raw = fit.raw_coefficients();
    let coefficients: [f64; 4] = std::array::from_fn(|i| raw[i]);
    let valid = state.validity();
    let success_above = valid
        .and_then(|v| state.at(0.5 * (v.low + v.high), Confidence::P95))
        .map(|point| point.success == SuccessSide::Above);
    let finite = |i: Interval| [i.low, i.high].iter().all(|v| v.is_finite()).then_some([i.low, i.high]);
    let curve = state
        .curve(POINTS, Confidence::P95)
        .into_iter()
        .filter_map(|point| {
            Some(FrontierPoint {
                y: point.y,
                x: point.x,
                se: point.se,
                band_95: finite(point.band)?,
                exact_95: match point.set {
                    CompatibleSet::Bounded(interval) => finite(interval),
                    CompatibleSet::Outside(_) | CompatibleSet::Everything => None,
                },
                observed: point.observed,
            })
        })
        .collect();
    let product = interaction(&x.values, &y.values);
    let stated = fit.probabilities(&[&x.values, &y.values, &product]).unwrap_or_default();
    let near = Rate::of_rows(base, |row| stated.get(row).is_some_and(|p| (NEAR[0]..=NEAR[1]).contains(p)));
    Finding::Estimated(Frontier {
        near,
        contradicted: near.wilson_95[1] < NEAR[0] || near.wilson_95[0] > NEAR[1],
        x: x.name.clone(),
        y: y.name.clone(),
        regression: Regression::of(&fit, "success", &names, false),
        closed_form: {
            let formula = closed_form(&names[0], &names[1], coefficients);
            let units: Vec<String> = [x, y]
                .iter()
                .filter_map(|p| match label_and_unit(&p.name) {
                    (_, "") => None,
                    (name, unit) => Some(format!("{name} in {unit}")),
                })
                .collect();
            if units.is_empty() { formula } else { format!("{formula}   ({})", units.join(", ")) }
        },
        coefficients,
        pole: state.pole(),
        valid_for: valid.map(|v| [v.low, v.high]),
        success_above,
        curve,
    })
}

/// x*(y) = (a + b y) / (c + d y).
fn closed_form(x: &str, y: &str, [b0, b1, b2, b3]: [f64; 4]) -> String {
    let term = |value: f64| {
        let sign = if value < 0.0 { '\u{2212}' } else { '+' };
        format!("{sign} {}\u{b7}{y}", significant(value.abs(), 4))
    };
    format!("{x}*({y}) = ({} {}) / ({} {})", significant(-b0, 4), term(-b2), significant(b1, 4), term(b3))
}
