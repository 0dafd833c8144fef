//! The trials to run next.

use std::collections::BTreeMap;

use robogate_core::{Domain, Parameter, ParameterSpace, Seed, Value};
use robogate_stats::format::significant;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::labels::{mode_label, parameter_label, value_with_unit};

/// Number of proposed trials.
const TRIALS: usize = 10;

/// The trials to run next, and what they are expected to bring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NextTrials {
    /// One setting from each tenth of the population by predicted success, the hardest first.
    pub settings: Vec<NextTrial>,
    /// Half the width of the interval today.
    pub half_width: f64,
    /// Half the width that is expected after these trials, if rates and correlation stay the same.
    pub expected_half_width: f64,
    /// Real trials without the simulation that would be needed in addition for the same width.
    pub without_simulation: u64,
}

/// One proposed trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NextTrial {
    /// The setting in words.
    pub setting: String,
    /// The value of each parameter. Absent in documents from earlier versions.
    #[serde(default)]
    pub values: BTreeMap<String, Value>,
    /// P(success) by the simulation.
    pub simulated: f64,
    /// P(success) by the corrected simulation.
    pub expected: f64,
}

/// A setting in words: "friction 0.31, mass 0.42 kg, shape box".
fn in_words(space: &ParameterSpace, point: &[f64]) -> String {
    let word = |(parameter, value): (&Parameter, &f64)| {
        let text = match &parameter.domain {
            Domain::Continuous { .. } => significant(*value, 2),
            Domain::Integer { .. } => format!("{value:.0}"),
            Domain::Categorical { choices } => mode_label(choices.get(*value as usize).map_or("", |choice| choice)),
        };
        format!("{} {}", parameter_label(&parameter.name), value_with_unit(&text, &parameter.name))
    };
    space.parameters().iter().zip(point).map(word).collect::<Vec<_>>().join(", ")
}

/// Chooses one random point from each tenth of the population by prediction; in a population of fewer than ten points, some
/// occur several times. They stay a random sample of the
/// population, so the interval remains valid, and they cover easy and hard settings. `n` trials are worth `worth`.
pub(super) fn next(
    space: &ParameterSpace,
    points: &[Vec<f64>],
    predicted: &[f64],
    corrected: impl Fn(f64, &[f64]) -> f64,
    half_width: f64,
    [n, worth]: [f64; 2],
) -> NextTrials {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| predicted[*a].total_cmp(&predicted[*b]).then(a.cmp(b)));
    // The seed depends on the number of trials, so that the next request proposes other points.
    let mut random = Seed::campaign(n as u64).stream("next trials");
    let settings = (0..TRIALS)
        .filter_map(|part| {
            let (from, to) = (part * order.len() / TRIALS, (part + 1) * order.len() / TRIALS);
            let at = *order.get(from + random.below((to - from).max(1)))?;
            let simulated = predicted[at];
            let value =
                |(parameter, coded): (&Parameter, &f64)| (parameter.name.to_string(), parameter.domain.decode(*coded));
            Some(NextTrial {
                setting: in_words(space, &points[at]),
                values: space.parameters().iter().zip(&points[at]).map(value).collect(),
                simulated,
                expected: corrected(simulated, &points[at]),
            })
        })
        .collect();
    let more = TRIALS as f64;
    let gain = worth / n;
    NextTrials {
        settings,
        half_width,
        expected_half_width: half_width * (n / (n + more)).sqrt(),
        without_simulation: (gain * (n + more) - n).max(0.0).round() as u64,
    }
}
