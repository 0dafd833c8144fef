//! A task as data: everything that RoboGate knows about it.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Action, ActionSpec, Domain, FailureMode, Observation, Parameter, ParameterSpace, Scale, Value, Word};

/// A task, as the component that holds the world declares it.
///
/// Everything downstream derives from this declaration: the columns of the dictionary, the metrics of the gate, the
/// sections of a report, the reference of the monitor. It is sent in the hello of a remote environment and stored
/// with every run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TaskSpec {
    /// The task's name (`pick_place`).
    pub name: Word,
    /// Changes where a failure mode, a measure or the rule for success changes its meaning.
    pub version: u32,
    /// The task in words.
    pub instruction: String,
    /// Time between two actions, in seconds. Zero, and left out of files, where it is not known: in the task of an
    /// imported dictionary.
    #[serde(default, skip_serializing_if = "unknown")]
    pub control_period_s: f64,
    /// An episode that lasts this long is a timeout, in simulated seconds. Zero where it is not known.
    #[serde(default, skip_serializing_if = "unknown")]
    pub time_limit_s: f64,
    /// How a policy can fail, in the order in which reports list it. Every task also has `timeout`, whether or not
    /// it is listed.
    pub failure_modes: Vec<FailureModeSpec>,
    /// What is measured in each episode.
    #[serde(default)]
    pub measures: Vec<MeasureSpec>,
    /// The phases that a policy may report, in order; empty where the task has none.
    #[serde(default)]
    pub phases: Vec<Word>,
    /// What can be varied.
    #[serde(default)]
    pub parameters: Vec<ParameterSpec>,
    /// What a policy sees.
    #[serde(default)]
    pub observation: ObservationSpec,
    /// What a policy may answer.
    #[serde(default)]
    pub action: ActionSpec,
    /// Data that only this task's own components understand.
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub details: serde_json::Value,
}

fn unknown(seconds: &f64) -> bool {
    *seconds <= 0.0
}

/// A way to fail.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FailureModeSpec {
    /// Its name in data and reports.
    pub name: FailureMode,
    /// What happened, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// How bad it is.
    #[serde(default)]
    pub severity: Severity,
}

/// How bad a failure is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Time is lost.
    Minor,
    /// The task is not done.
    #[default]
    Major,
    /// Parts, robot or people are at risk.
    Critical,
}

/// Something that is measured in each episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MeasureSpec {
    /// Its name: the column in the dictionary.
    pub name: Word,
    /// Its unit, as people write it (`N`, `m`); empty where it has none.
    #[serde(default)]
    pub unit: String,
    /// What it is, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// Which values are better.
    #[serde(default)]
    pub better: Better,
}

/// Which values of a measure are better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Small ones.
    Lower,
    /// Large ones.
    Higher,
    /// Neither: the measure describes and does not judge.
    #[default]
    Neither,
}

/// Something that can be varied between episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterSpec {
    /// Its name, with the unit as its ending where there is one (`mass_kg`).
    pub name: Arc<str>,
    /// Its unit, as people write it; empty where it has none.
    #[serde(default)]
    pub unit: String,
    /// What it is, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// What it may be.
    #[serde(flatten)]
    pub allowed: Allowed,
    /// What it is where nothing else is requested; absent where it then follows something else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal: Option<Value>,
    /// Where its applied value is read.
    #[serde(default)]
    pub read_from: String,
}

/// The values that an environment accepts for a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Allowed {
    /// A real number, both ends included.
    Continuous {
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// An integer, both ends included.
    Integer {
        /// Smallest value.
        low: i64,
        /// Largest value.
        high: i64,
    },
    /// A word.
    Categorical {
        /// The words to choose from.
        choices: Vec<Arc<str>>,
        /// Whether other words of the same form are accepted, too.
        #[serde(default)]
        open: bool,
    },
}

/// What a policy sees.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ObservationSpec {
    /// Named vectors of numbers.
    pub vectors: Vec<VectorSpec>,
    /// Cameras.
    #[serde(default)]
    pub cameras: Vec<CameraSpec>,
}

/// A named vector of an observation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VectorSpec {
    /// Its name. The names in [`crate::vectors`] have a fixed meaning.
    pub name: Word,
    /// How many numbers it has.
    pub length: usize,
    /// The unit of its numbers; empty where they have none or several.
    #[serde(default)]
    pub unit: String,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CameraSpec {
    /// Its name.
    pub name: String,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// What is special about one episode of a task: what an engineer of the cell would know beforehand, not what the
/// episode's noise made of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskInstance {
    /// The task in words, for language-conditioned policies.
    pub instruction: String,
    /// Data that only the task's own components understand (where the part nominally is, say).
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub details: serde_json::Value,
}

/// The most entries of each list of a task.
const MOST: usize = 1024;

impl TaskSpec {
    /// Rejects a declaration that contradicts itself.
    pub fn check(&self) -> Result<(), TaskError> {
        self.limit_ticks()?;
        let lists = [
            ("failure_modes", self.failure_modes.len()),
            ("measures", self.measures.len()),
            ("phases", self.phases.len()),
            ("parameters", self.parameters.len()),
            ("observation.vectors", self.observation.vectors.len()),
            ("observation.cameras", self.observation.cameras.len()),
        ];
        if let Some((list, found)) = lists.into_iter().find(|(_, found)| *found > MOST) {
            return Err(TaskError::TooMany { list, found, most: MOST });
        }
        unique("failure_modes", self.failure_modes.iter().map(|mode| mode.name.as_str()))?;
        unique("measures", self.measures.iter().map(|measure| measure.name.as_str()))?;
        unique("phases", self.phases.iter().map(|phase| phase.as_str()))?;
        unique("parameters", self.parameters.iter().map(|parameter| &*parameter.name))?;
        unique("observation.vectors", self.observation.vectors.iter().map(|vector| vector.name.as_str()))?;
        unique("observation.cameras", self.observation.cameras.iter().map(|camera| &*camera.name))?;
        self.action.check().map_err(TaskError::Action)?;
        self.parameters.iter().try_for_each(ParameterSpec::check)
    }

    /// How many control periods an episode has at most.
    pub fn limit_ticks(&self) -> Result<u32, TaskError> {
        // Counted, not summed: sums of a period drift, and the limit would depend on rounding.
        let limit = (self.time_limit_s / self.control_period_s).round();
        if (1.0..=f64::from(u32::MAX)).contains(&limit) {
            Ok(limit as u32)
        } else {
            Err(TaskError::TimeLimit { limit_s: self.time_limit_s, period_s: self.control_period_s })
        }
    }

    /// Every failure mode of the task, in the order of reports; `timeout` is last where it is not declared.
    pub fn modes(&self) -> impl Iterator<Item = FailureMode> + '_ {
        let declared = self.failure_modes.iter().map(|mode| mode.name);
        let timeout =
            (!self.failure_modes.iter().any(|mode| mode.name == FailureMode::TIMEOUT)).then_some(FailureMode::TIMEOUT);
        declared.chain(timeout)
    }

    /// Whether the task has this failure mode. A failure by another is of unknown kind.
    pub fn declares(&self, mode: FailureMode) -> bool {
        self.modes().any(|known| known == mode)
    }

    /// What a failure mode means, where the task says so.
    pub fn meaning_of(&self, mode: FailureMode) -> Option<&str> {
        self.failure_modes
            .iter()
            .find(|spec| spec.name == mode)
            .map(|spec| &*spec.meaning)
            .filter(|text| !text.is_empty())
    }

    /// A measure by its name.
    pub fn measure(&self, name: &str) -> Option<&MeasureSpec> {
        self.measures.iter().find(|measure| measure.name == name)
    }

    /// A parameter by its name.
    pub fn parameter(&self, name: &str) -> Option<&ParameterSpec> {
        self.parameters.iter().find(|parameter| &*parameter.name == name)
    }

    /// The space of everything that the task lets vary, over the whole of each declared range. Fails where the task
    /// declares no parameter.
    pub fn declared_space(&self) -> Result<ParameterSpace, crate::SpaceError> {
        let varies = self
            .parameters
            .iter()
            .filter_map(|spec| Some(Parameter { name: Arc::clone(&spec.name), domain: spec.domain()? }));
        ParameterSpace::new(format!("{} (declared ranges)", self.name), varies.collect())
    }

    /// Whether `observation` has the vectors that the task declares, each of its length.
    pub fn check_observation(&self, observation: &Observation) -> Result<(), String> {
        for spec in &self.observation.vectors {
            match observation.vector(spec.name.as_str()) {
                None => return Err(format!("the observation has no vector `{}`", spec.name)),
                Some(vector) if vector.len() != spec.length => {
                    let (name, found, due) = (spec.name, vector.len(), spec.length);
                    return Err(format!("the observation's `{name}` has {found} numbers; the task declares {due}"));
                }
                Some(_) => {}
            }
        }
        match observation.vectors.len() == self.observation.vectors.len() {
            true => Ok(()),
            false => Err("the observation has a vector that the task does not declare".to_owned()),
        }
    }

    /// Whether `action` is one that the task takes.
    pub fn check_action(&self, action: &Action) -> Result<(), String> {
        self.action.accepts(action)
    }
}

impl ParameterSpec {
    /// The domain that holds every accepted value; `None` where there is only one, so that nothing varies.
    pub fn domain(&self) -> Option<Domain> {
        match &self.allowed {
            Allowed::Continuous { low, high } if low < high => {
                Some(Domain::Continuous { low: *low, high: *high, scale: Scale::Linear })
            }
            Allowed::Integer { low, high } if low < high => Some(Domain::Integer { low: *low, high: *high }),
            Allowed::Categorical { choices, .. } if choices.len() > 1 => {
                Some(Domain::Categorical { choices: choices.clone() })
            }
            _ => None,
        }
    }

    /// Whether a value is one that the environment accepts; the error says what would be.
    pub fn accepts(&self, value: &Value) -> Result<(), String> {
        let wrong = |expected: String| Err(format!("parameter `{}` = {value}: expected {expected}", self.name));
        match (&self.allowed, value) {
            (Allowed::Continuous { low, high }, Value::Number(x)) if (*low..=*high).contains(x) => Ok(()),
            (Allowed::Continuous { low, high }, Value::Integer(n)) if (*low..=*high).contains(&(*n as f64)) => Ok(()),
            (Allowed::Continuous { low, high }, _) => wrong(format!("a number from {low} to {high}")),
            (Allowed::Integer { low, high }, Value::Integer(n)) if (*low..=*high).contains(n) => Ok(()),
            (Allowed::Integer { low, high }, Value::Number(x))
                if x.fract() == 0.0 && (*low as f64..=*high as f64).contains(x) =>
            {
                Ok(())
            }
            (Allowed::Integer { low, high }, _) => wrong(format!("an integer from {low} to {high}")),
            (Allowed::Categorical { choices, open }, Value::Category(word)) if *open || choices.contains(word) => {
                Ok(())
            }
            (Allowed::Categorical { choices, .. }, _) => wrong(format!("one of {}", choices.join(", "))),
        }
    }

    fn check(&self) -> Result<(), TaskError> {
        let wrong = |problem: String| Err(TaskError::Parameter { parameter: self.name.to_string(), problem });
        if self.name.is_empty() || !self.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return wrong("its name must be letters, digits and underscores".to_owned());
        }
        match &self.allowed {
            Allowed::Continuous { low, high } if !(low.is_finite() && high.is_finite() && low <= high) => {
                return wrong(format!("its range {low} to {high} is not valid: expected two rising finite numbers"));
            }
            Allowed::Integer { low, high } if low > high => {
                return wrong(format!("its range {low} to {high} is not valid: expected rising integers"));
            }
            Allowed::Categorical { choices, .. } if choices.is_empty() => return wrong("it has no choices".to_owned()),
            _ => {}
        }
        match &self.nominal {
            Some(value) => self.accepts(value).or_else(|why| wrong(format!("its nominal value is not allowed: {why}"))),
            None => Ok(()),
        }
    }
}

fn unique<'a>(list: &'static str, names: impl Iterator<Item = &'a str>) -> Result<(), TaskError> {
    let mut seen = std::collections::BTreeSet::new();
    for name in names {
        // Columns that differ in case alone are one column to some readers.
        if !seen.insert(name.to_ascii_lowercase()) {
            return Err(TaskError::Duplicate { list, name: name.to_owned() });
        }
    }
    Ok(())
}

/// Why a task's declaration is not valid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TaskError {
    /// The time limit is not a number of control periods.
    #[error("time limit {limit_s} s in control periods of {period_s} s is not a positive number of periods")]
    TimeLimit {
        /// The time limit, in seconds.
        limit_s: f64,
        /// The control period, in seconds.
        period_s: f64,
    },
    /// A name that is declared twice.
    #[error("`{name}` is declared twice in `{list}`")]
    Duplicate {
        /// The list.
        list: &'static str,
        /// The name.
        name: String,
    },
    /// A list without end.
    #[error("`{list}` has {found} entries; at most {most} are accepted")]
    TooMany {
        /// The list.
        list: &'static str,
        /// Its length.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// A parameter that cannot be varied as it is declared.
    #[error("parameter `{parameter}`: {problem}")]
    Parameter {
        /// Its name.
        parameter: String,
        /// What is wrong.
        problem: String,
    },
    /// An action that nothing can be.
    #[error("action: {0}")]
    Action(String),
}
