//! The file of a detector.

use robogate_core::{Assignment, Value};
use robogate_stats::boosting::Boosting;
use serde::{Deserialize, Serialize};

use super::detector::{Detector, Distance, Model};
use super::features::{Features, MOST_SIGNALS};
use super::train::{Calibration, WarnError};

/// The conditions of a promise: it holds for episodes of the same kind.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conditions {
    /// The task and its version.
    pub task: String,
    /// The physics engine, or the simulator.
    pub engine: String,
    /// The robot.
    pub robot: String,
    /// The policy, with the digest of its file where it is known.
    pub policy: String,
    /// The population of scenarios.
    pub population: String,
}

impl Conditions {
    /// The differences from other conditions, in words.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let pairs = [
            ("task", &self.task, &other.task),
            ("engine", &self.engine, &other.engine),
            ("robot", &self.robot, &other.robot),
            ("policy", &self.policy, &other.policy),
            ("population", &self.population, &other.population),
        ];
        let differ = pairs.into_iter().filter(|(_, a, b)| a != b);
        differ.map(|(what, a, b)| format!("{what}: {b} in place of {a}")).collect()
    }
}

/// A parameter as a number.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KnownParameter {
    /// The name.
    pub name: String,
    /// The choices of a categorical parameter, which become 0, 1, 2, ... Empty for a number.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<String>,
}

impl KnownParameter {
    /// A choice as a number: its place, NaN if it is unknown.
    pub fn number_of(&self, choice: &str) -> f64 {
        self.choices.iter().position(|one| one == choice).map_or(f64::NAN, |at| at as f64)
    }

    /// The parameter in these as a number, NaN if it is not among them.
    pub fn number_in(&self, parameters: &Assignment) -> f64 {
        match parameters.get(&self.name) {
            Some(Value::Number(x)) => *x,
            Some(Value::Integer(n)) => *n as f64,
            Some(Value::Category(word)) => self.number_of(word),
            None => f64::NAN,
        }
    }
}

/// When the event of a failure mode is, if it is not its end: the first time at which a measure is above a limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventRule {
    /// The failure mode.
    pub mode: String,
    /// The measure.
    pub measure: String,
    /// The limit, in the unit of the measure.
    pub above: f64,
}

/// The baselines beside the detector, calibrated with the same successes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baselines {
    /// The threshold of the clock, in seconds.
    pub clock: f64,
    /// The threshold of the scenario's risk. Absent without such a model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario: Option<f64>,
    /// The parameters of the scenario's risk.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<KnownParameter>,
    /// The trees of the scenario's risk.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub trees: Vec<String>,
}

/// A detector in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WarnFile {
    /// The version of the format.
    pub warn_format: u32,
    /// The conditions of the calibration.
    pub conditions: Conditions,
    /// The runs whose episodes trained the detector or gave the threshold: SHA-256 (hex) of their provenance. They measure no promise.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub runs: Vec<String>,
    /// The columns of the detector.
    pub features: Features,
    /// The parameters of [`Features::parameters`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub known: Vec<KnownParameter>,
    /// Boosted trees for the log-odds of success, one a line.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub trees: Vec<String>,
    /// The distance to successes, in place of trees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance: Option<Distance>,
    /// The threshold and its promise.
    pub calibration: Calibration,
    /// Events that are not the end of the episode.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<EventRule>,
    /// The baselines.
    pub baselines: Baselines,
}

impl WarnFile {
    /// The version of the format that this version writes.
    pub const FORMAT: u32 = 1;

    /// The detector of this file.
    ///
    /// # Errors
    /// Tables that do not fit together.
    pub fn detector(&self) -> Result<Detector, WarnError> {
        let broken = |why: &str| WarnError::Tables(why.to_owned());
        if self.warn_format != Self::FORMAT {
            return Err(WarnError::Tables(format!("format {} is not known to this version", self.warn_format)));
        }
        let signals = &self.features.signals;
        if signals.checked_width().is_none_or(|width| width == 0 || width > MOST_SIGNALS) {
            return Err(broken("the signals have no numbers, or too many"));
        }
        // The command of the gripper is one number, the last of a row.
        let grippers = signals.groups.iter().rev().skip(1).any(|of| of.kind == robogate_core::SignalKind::Gripper);
        let long = signals.groups.iter().any(|of| of.kind == robogate_core::SignalKind::Gripper && of.length != 1);
        let vector = signals.groups.iter().find(|of| of.name == "vector").map_or(0, |of| of.length);
        let outside = signals.gripper_in_vector.is_some_and(|(at, _)| at >= vector);
        if grippers || long || outside || !(signals.period_s > 0.0 && signals.period_s.is_finite()) {
            return Err(broken("the signals are not those of a task"));
        }
        if self.features.parameters.len() != self.known.len() {
            return Err(broken("`known` and `features.parameters` have different lengths"));
        }
        let columns = self.features.names().len();
        let model = match &self.distance {
            Some(distance) => {
                distance.check(columns).map_err(WarnError::Tables)?;
                Model::Distance(distance.clone())
            }
            None => Model::Trees(Boosting::parse(&self.trees, columns).ok_or_else(|| broken("the trees are damaged"))?),
        };
        Ok(Detector { features: self.features.clone(), model })
    }

    /// The model of the scenario's risk. `None` if the file has none.
    ///
    /// # Errors
    /// Damaged trees.
    pub fn scenario_risk(&self) -> Result<Option<Boosting>, WarnError> {
        if self.baselines.trees.is_empty() {
            return Ok(None);
        }
        let trees = Boosting::parse(&self.baselines.trees, self.baselines.parameters.len());
        trees.map(Some).ok_or_else(|| WarnError::Tables("the trees of the scenario's risk are damaged".to_owned()))
    }
}
