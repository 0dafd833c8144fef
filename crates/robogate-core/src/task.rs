//! Task specifications: tasks declared as data.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    Action, ActionSpec, Assignment, Domain, FailureMode, Measures, Observation, Parameter, ParameterSpace, Scale,
    SettingSpec, Value, Word,
};

/// A task, as declared by the component that holds the world.
///
/// All other components use this declaration: the columns of the dictionary, the metrics of the gate, the sections of a
/// report and the reference of the monitor. A remote environment sends it in its hello, and every run stores it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TaskSpec {
    /// The task's name (`pick_place`).
    pub name: Word,
    /// The version. Increase it when a failure mode, a measure or the rule for success changes its meaning.
    pub version: u32,
    /// The task in natural language.
    pub instruction: String,
    /// Time between two actions, in seconds. Zero, and absent in files, if unknown, as in the task of an imported
    /// dictionary.
    #[serde(default, skip_serializing_if = "unknown")]
    pub control_period_s: f64,
    /// Time limit of an episode in simulated seconds. An episode that reaches it is a timeout. Zero if unknown.
    #[serde(default, skip_serializing_if = "unknown")]
    pub time_limit_s: f64,
    /// The failure modes, in the order of reports. Every task also has `timeout`, listed or not.
    pub failure_modes: Vec<FailureModeSpec>,
    /// The measures of each episode.
    #[serde(default)]
    pub measures: Vec<MeasureSpec>,
    /// The hidden draws of each episode. Absent in files of earlier versions and of tasks without draws.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub draws: Vec<DrawSpec>,
    /// The phases that a policy may report, in order. Empty if the task has none.
    #[serde(default)]
    pub phases: Vec<Word>,
    /// The stages of an episode before success, in order ("grasped", "lifted"). The measure [`Self::STAGES`] counts those that an
    /// episode reached. Absent if the task has none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages: Vec<Word>,
    /// The parameters that can vary.
    #[serde(default)]
    pub parameters: Vec<ParameterSpec>,
    /// The settings, with their values. Absent in files of tasks without settings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<SettingSpec>,
    /// The observations that the policy receives.
    #[serde(default)]
    pub observation: ObservationSpec,
    /// The actions that the task accepts.
    #[serde(default)]
    pub action: ActionSpec,
    /// Data for the task's own components. Other code ignores it.
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub details: serde_json::Value,
}

fn unknown(seconds: &f64) -> bool {
    *seconds <= 0.0
}

/// A declared failure mode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FailureModeSpec {
    /// The name in data files and reports.
    pub name: FailureMode,
    /// What happened, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// The severity of the failure.
    #[serde(default)]
    pub severity: Severity,
    /// The mode that contains this one in a published, coarser list of modes. Absent if the list has this mode itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_as: Option<FailureMode>,
}

/// The severity of a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The failure costs time.
    Minor,
    /// The task is not completed.
    #[default]
    Major,
    /// Parts, the robot or people are at risk.
    Critical,
}

/// A declared measure: a number that is recorded per episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MeasureSpec {
    /// The name of the measure and of its column in the dictionary.
    pub name: Word,
    /// The unit as text (`N`, `m`). Empty for a number without unit.
    #[serde(default)]
    pub unit: String,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// Whether smaller or larger values are better.
    #[serde(default)]
    pub better: Better,
}

/// A declared draw: a number that an episode samples from its seed and that no parameter sets (an encoder bias, the
/// position of an obstacle), or that follows from such numbers.
///
/// Draws explain outcomes that parameters alone cannot. They are not parameters: they cannot be set on the real robot,
/// so advice never names them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DrawSpec {
    /// The name of the draw and of its column in the dictionary.
    pub name: Word,
    /// The unit as text (`m`, `rad`). Empty for a number without unit.
    #[serde(default)]
    pub unit: String,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub meaning: String,
}

/// Whether smaller or larger values of a measure are better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Smaller values are better.
    Lower,
    /// Larger values are better.
    Higher,
    /// Neither: the measure is descriptive.
    #[default]
    Neither,
}

/// A declared parameter: a property of a scenario that can vary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterSpec {
    /// The name. It ends with the unit, if there is one (`mass_kg`).
    pub name: Arc<str>,
    /// The unit as text. Empty for a value without unit.
    #[serde(default)]
    pub unit: String,
    /// The meaning, in one sentence.
    #[serde(default)]
    pub meaning: String,
    /// The accepted values.
    #[serde(flatten)]
    pub allowed: Allowed,
    /// The default value. Absent if the default depends on other parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal: Option<Value>,
    /// Where the applied value is read back.
    #[serde(default)]
    pub read_from: String,
    /// The family of perturbations that the parameter belongs to (`light`). A control arm measures the effect of each family.
    /// Absent if the parameter is in no family.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub family: Option<Word>,
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
    /// A choice.
    Categorical {
        /// The listed choices.
        choices: Vec<Arc<str>>,
        /// Whether other words of the same form are also accepted.
        #[serde(default)]
        open: bool,
    },
}

impl Allowed {
    /// Checks that a value is among these. The error names them.
    pub fn accepts(&self, value: &Value) -> Result<(), String> {
        let wrong = |expected: String| Err(format!("expected {expected}"));
        match (self, value) {
            (Self::Continuous { low, high }, Value::Number(x)) if (*low..=*high).contains(x) => Ok(()),
            (Self::Continuous { low, high }, Value::Integer(n)) if (*low..=*high).contains(&(*n as f64)) => Ok(()),
            (Self::Continuous { low, high }, _) => wrong(format!("a number from {low} to {high}")),
            (Self::Integer { low, high }, Value::Integer(n)) if (*low..=*high).contains(n) => Ok(()),
            (Self::Integer { low, high }, Value::Number(x))
                if x.fract() == 0.0 && (*low as f64..=*high as f64).contains(x) =>
            {
                Ok(())
            }
            (Self::Integer { low, high }, _) => wrong(format!("an integer from {low} to {high}")),
            (Self::Categorical { choices, open }, Value::Category(word)) if *open || choices.contains(word) => Ok(()),
            (Self::Categorical { choices, .. }, _) => wrong(format!("one of {}", choices.join(", "))),
        }
    }

    /// Rejects an empty or an infinite range.
    fn check(&self) -> Result<(), String> {
        match self {
            Self::Continuous { low, high } if !(low.is_finite() && high.is_finite() && low <= high) => {
                Err(format!("the range {low} to {high} is not valid: expected finite numbers in increasing order"))
            }
            Self::Integer { low, high } if low > high => {
                Err(format!("the range {low} to {high} is not valid: expected integers in increasing order"))
            }
            Self::Categorical { choices, .. } if choices.is_empty() => {
                Err("`choices` is empty; expected at least one".to_owned())
            }
            _ => Ok(()),
        }
    }
}

/// The specification of the observations.
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
    /// The name. The names in [`crate::vectors`] have a fixed meaning.
    pub name: Word,
    /// The length of the vector.
    pub length: usize,
    /// The unit of the numbers. Empty for numbers without unit or with different units.
    #[serde(default)]
    pub unit: String,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CameraSpec {
    /// The name.
    pub name: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

/// Information about one episode that the policy may use. It contains only facts that are known before the episode,
/// without the episode's noise.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskInstance {
    /// The task in natural language, for language-conditioned policies.
    pub instruction: String,
    /// Data for the task's own components, for example the nominal position of the part.
    #[serde(default, skip_serializing_if = "serde_json::Value::is_null")]
    pub details: serde_json::Value,
}

/// Largest number of entries in each list of a task.
const MOST: usize = 1024;

impl TaskSpec {
    /// Rejects a declaration that contradicts itself.
    pub fn check(&self) -> Result<(), TaskError> {
        self.limit_ticks()?;
        let lists = [
            ("failure_modes", self.failure_modes.len()),
            ("measures", self.measures.len()),
            ("draws", self.draws.len()),
            ("phases", self.phases.len()),
            ("stages", self.stages.len()),
            ("parameters", self.parameters.len()),
            ("settings", self.settings.len()),
            ("observation.vectors", self.observation.vectors.len()),
            ("observation.cameras", self.observation.cameras.len()),
        ];
        if let Some((list, found)) = lists.into_iter().find(|(_, found)| *found > MOST) {
            return Err(TaskError::TooMany { list, found, most: MOST });
        }
        unique("failure_modes", self.failure_modes.iter().map(|mode| mode.name.as_str()))?;
        unique("measures", self.measures.iter().map(|measure| measure.name.as_str()))?;
        unique("draws", self.draws.iter().map(|draw| draw.name.as_str()))?;
        unique("phases", self.phases.iter().map(|phase| phase.as_str()))?;
        unique("stages", self.stages.iter().map(|stage| stage.as_str()))?;
        if !self.stages.is_empty() && self.measure(Self::STAGES).is_none() {
            return Err(TaskError::Stages);
        }
        unique("parameters", self.parameters.iter().map(|parameter| &*parameter.name))?;
        unique("settings", self.settings.iter().map(|setting| &*setting.name))?;
        unique("observation.vectors", self.observation.vectors.iter().map(|vector| vector.name.as_str()))?;
        unique("observation.cameras", self.observation.cameras.iter().map(|camera| &*camera.name))?;
        self.action.check().map_err(TaskError::Action)?;
        self.parameters.iter().try_for_each(ParameterSpec::check)?;
        self.settings.iter().try_for_each(|setting| {
            let values = || setting.default.iter().chain(&setting.value).try_for_each(|value| setting.accepts(value));
            setting
                .allowed
                .check()
                .and_then(|()| values())
                .map_err(|problem| TaskError::Setting { setting: setting.name.to_string(), problem })
        })
    }

    /// The measure that counts the stages that an episode reached.
    pub const STAGES: &str = "stages";

    /// The share of the way to success that an episode went, of which success is the last step: 1 for a success, otherwise the reached stages
    /// divided by one more than all of them. `None` if the task declares no stages, or if the episode did not count them.
    pub fn stage_share(&self, success: bool, measures: &Measures) -> Option<f64> {
        let all = self.stages.len() as f64;
        match (self.stages.is_empty(), success) {
            (true, _) => None,
            (false, true) => Some(1.0),
            (false, false) => measures.get(Self::STAGES).map(|reached| reached.clamp(0.0, all) / (all + 1.0)),
        }
    }

    /// The time limit as a number of control periods.
    pub fn limit_ticks(&self) -> Result<u32, TaskError> {
        // Compared as a count: a sum of periods accumulates rounding errors, which would change the limit.
        let limit = (self.time_limit_s / self.control_period_s).round();
        if (1.0..=f64::from(u32::MAX)).contains(&limit) {
            Ok(limit as u32)
        } else {
            Err(TaskError::TimeLimit { limit_s: self.time_limit_s, period_s: self.control_period_s })
        }
    }

    /// Every failure mode of the task, in the order of reports. `timeout` is last unless it is declared.
    pub fn modes(&self) -> impl Iterator<Item = FailureMode> + '_ {
        let declared = self.failure_modes.iter().map(|mode| mode.name);
        let timeout =
            (!self.failure_modes.iter().any(|mode| mode.name == FailureMode::TIMEOUT)).then_some(FailureMode::TIMEOUT);
        declared.chain(timeout)
    }

    /// Whether the task declares this failure mode. Any other failure has an unknown kind.
    pub fn declares(&self, mode: FailureMode) -> bool {
        self.modes().any(|known| known == mode)
    }

    /// The failure mode under which published data lists this one: itself, unless the task declares another one.
    pub fn published_mode(&self, mode: FailureMode) -> FailureMode {
        let declared = self.failure_modes.iter().find(|spec| spec.name == mode);
        declared.and_then(|spec| spec.published_as).unwrap_or(mode)
    }

    /// The measure with this name.
    pub fn measure(&self, name: &str) -> Option<&MeasureSpec> {
        self.measures.iter().find(|measure| measure.name == name)
    }

    /// The values of the settings.
    pub fn setting_values(&self) -> Assignment {
        let valued = |setting: &SettingSpec| Some((Arc::clone(&setting.name), setting.value.clone()?));
        self.settings.iter().filter_map(valued).collect()
    }

    /// The settings whose value is not the default, as text. Empty if all have their defaults.
    pub fn changed_settings(&self) -> String {
        let changed = self.settings.iter().filter(|setting| setting.is_changed());
        changed.filter_map(SettingSpec::shown).collect::<Vec<_>>().join(", ")
    }

    /// The parameter with this name.
    pub fn parameter(&self, name: &str) -> Option<&ParameterSpec> {
        self.parameters.iter().find(|parameter| &*parameter.name == name)
    }

    /// The declared families of perturbations with those of `names` that belong to them, in the order of the declarations.
    pub fn families_among<'a>(&self, names: impl Iterator<Item = &'a str> + Clone) -> Vec<(Word, Vec<Arc<str>>)> {
        let mut families: Vec<(Word, Vec<Arc<str>>)> = Vec::new();
        for spec in &self.parameters {
            let Some(family) = spec.family.filter(|_| names.clone().any(|name| name == &*spec.name)) else { continue };
            let name = Arc::clone(&spec.name);
            match families.iter_mut().find(|(known, _)| *known == family) {
                Some((_, of)) => of.push(name),
                None => families.push((family, vec![name])),
            }
        }
        families
    }

    /// The space of all parameters that the task allows to vary, over their full declared ranges. Returns an error if
    /// the task declares no parameter.
    pub fn declared_space(&self) -> Result<ParameterSpace, crate::SpaceError> {
        let varies = self
            .parameters
            .iter()
            .filter_map(|spec| Some(Parameter { name: Arc::clone(&spec.name), domain: spec.domain()? }));
        ParameterSpace::new(format!("{} (declared ranges)", self.name), varies.collect())
    }

    /// Checks that `observation` has the declared vectors with their lengths.
    pub fn check_observation(&self, observation: &Observation) -> Result<(), String> {
        for spec in &self.observation.vectors {
            match observation.vector(spec.name.as_str()) {
                None => return Err(format!("the observation has no vector `{}`", spec.name)),
                Some(vector) if vector.len() != spec.length => {
                    let (name, found, due) = (spec.name, vector.len(), spec.length);
                    return Err(format!("the observation's `{name}` has {found} numbers; expected {due}"));
                }
                Some(_) => {}
            }
        }
        match observation.vectors.len() == self.observation.vectors.len() {
            true => Ok(()),
            false => Err("the observation has a vector that the task does not declare".to_owned()),
        }
    }

    /// Checks that the task accepts `action`.
    pub fn check_action(&self, action: &Action) -> Result<(), String> {
        self.action.accepts(action)
    }
}

impl ParameterSpec {
    /// The domain of all accepted values. `None` if there is only one value.
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

    /// Checks that the environment accepts a value. The error names the accepted values.
    pub fn accepts(&self, value: &Value) -> Result<(), String> {
        self.allowed.accepts(value).map_err(|expected| format!("parameter `{}` = {value}: {expected}", self.name))
    }

    fn check(&self) -> Result<(), TaskError> {
        let wrong = |problem: String| Err(TaskError::Parameter { parameter: self.name.to_string(), problem });
        if self.name.is_empty() || !self.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return wrong("the name is invalid: expected letters, digits and underscores".to_owned());
        }
        if let Err(why) = self.allowed.check() {
            return wrong(why);
        }
        match &self.nominal {
            None if self.family.is_some() => {
                wrong("it has a `family` and no `nominal` value; a family is compared with nominal values".to_owned())
            }
            Some(value) => self.accepts(value).or_else(|why| wrong(format!("the nominal value is not allowed: {why}"))),
            None => Ok(()),
        }
    }
}

fn unique<'a>(list: &'static str, names: impl Iterator<Item = &'a str>) -> Result<(), TaskError> {
    let mut seen = std::collections::BTreeSet::new();
    for name in names {
        // Some file readers ignore case, so names that differ only in case are duplicates.
        if !seen.insert(name.to_ascii_lowercase()) {
            return Err(TaskError::Duplicate { list, name: name.to_owned() });
        }
    }
    Ok(())
}

/// The reason why a task declaration is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TaskError {
    /// Stages without the measure that counts them.
    #[error("`stages` needs the measure `stages`, the number of stages that an episode reached")]
    Stages,
    /// The time limit is not a positive number of control periods.
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
    /// A list with too many entries.
    #[error("`{list}` has {found} entries; at most {most} are accepted")]
    TooMany {
        /// The list.
        list: &'static str,
        /// The length.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// A parameter with an invalid declaration.
    #[error("parameter `{parameter}`: {problem}")]
    Parameter {
        /// The name.
        parameter: String,
        /// The problem.
        problem: String,
    },
    /// A setting with an invalid declaration.
    #[error("setting `{setting}`: {problem}")]
    Setting {
        /// The name.
        setting: String,
        /// The problem.
        problem: String,
    },
    /// An invalid action specification.
    #[error("action: {0}")]
    Action(String),
}
