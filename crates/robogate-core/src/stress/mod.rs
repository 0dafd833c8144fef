//! Stress in transit: what happens to observations and actions between an environment and a policy.
//!
//! An environment renders what it renders. In a real cell the image is noisy, blurred, late or compressed, the state has an offset, the
//! command is rounded, and the operator words the task in another way. [`with_stress`] puts an adapter between any environment and any
//! policy that does the same, without a change of either. Each kind of stress is a parameter of the scenario with a range and a nominal
//! value without effect, so that a campaign finds the limit at which the policy fails. All randomness comes from the seed of the
//! episode.

mod adapter;
mod image;
mod jpeg;
mod words;

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Allowed, Domain, Parameter, ParameterSpec, Scale, TaskSpec, Value, Word};

pub use adapter::with_stress;

/// The names of all parameters of stress begin like this.
pub const STRESS_PREFIX: &str = "transit_";

/// Largest number of other wordings of an instruction, and the largest length of one in characters.
pub const MOST_WORDINGS: usize = 256;
/// Largest length of a wording in characters.
pub const MOST_CHARACTERS: usize = 1000;

/// A group of parameters of stress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StressGroup {
    /// What the cameras see.
    Images,
    /// The numbers of the observation.
    State,
    /// The commands.
    Actions,
    /// The words of the task.
    Language,
}

/// One parameter of stress.
#[derive(Debug)]
pub struct StressParameter {
    /// Its name, which begins with [`STRESS_PREFIX`].
    pub name: &'static str,
    /// Its group.
    pub group: StressGroup,
    unit: &'static str,
    family: Word,
    /// The value without effect.
    nominal: f64,
    /// The range that is sampled, which is the allowed range too.
    range: [f64; 2],
    whole: bool,
    meaning: &'static str,
}

macro_rules! rows {
    ($($group:ident $name:ident $unit:literal $family:literal $nominal:literal $low:literal $high:literal $kind:ident $meaning:literal;)*) => {
        /// All parameters of stress.
        pub const STRESS: &[StressParameter] = &[$(StressParameter {
            name: concat!("transit_", stringify!($name)),
            group: StressGroup::$group,
            unit: $unit,
            family: Word::constant($family),
            nominal: $nominal,
            range: [$low, $high],
            whole: rows!(@whole $kind),
            meaning: $meaning,
        }),*];
    };
    (@whole whole) => { true };
    (@whole real) => { false };
}

rows! {
    Images noise "levels" "image_noise" 0.0 0.0 80.0 real "standard deviation of the noise of each colour value of an image, of 255 levels";
    Images blur_px "px" "image_blur" 0.0 0.0 8.0 real "standard deviation of the blur of images";
    Images brightness "levels" "image_light" 0.0 -120.0 120.0 real "levels that are added to each colour value of an image, of 255";
    Images contrast "1" "image_light" 1.0 0.2 2.0 real "factor of the distance of each colour value from the middle";
    Images warmth "levels" "image_colour" 0.0 -80.0 80.0 real "levels that are added to red and taken from blue, of 255";
    Images jpeg_loss "1" "image_jpeg" 0.0 0.0 99.0 real "100 minus the quality of a JPEG compression (tables of Annex K of ITU-T T.81); below 0.5 there is none";
    Images occlusion "1" "image_occlusion" 0.0 0.0 0.6 real "share of each image that a grey square covers; its place is drawn for each episode and camera";
    Images crop "1" "image_view" 0.0 0.0 0.3 real "share of width and height that is cut off at each side; the rest is enlarged";
    Images rotation_deg "deg" "image_view" 0.0 -30.0 30.0 real "rotation of images about their centre";
    Images dropped_frames "1" "image_timing" 0.0 0.0 0.9 real "share of the images that do not arrive; the last one that did is repeated";
    Images delayed_frames "control periods" "image_timing" 0.0 0.0 20.0 whole "age of the images in control periods";
    Images dropped_camera "1" "camera_dropped" 0.0 0.0 8.0 whole "number of the camera whose images are black, in the order of the task; 0 for none";
    State state_noise "1" "state_noise" 0.0 0.0 0.1 real "standard deviation of the noise of each number of the state, in its own unit";
    State state_bias "1" "state_bias" 0.0 0.0 0.1 real "standard deviation of the offset of each number of the state, in its own unit; drawn for each episode";
    State delayed_state "control periods" "state_timing" 0.0 0.0 20.0 whole "age of the state in control periods";
    Actions action_step "1" "action_step" 0.0 0.0 0.1 real "each number of a command is rounded to a multiple of this, in its own unit";
    Actions delayed_action "control periods" "action_timing" 0.0 0.0 10.0 whole "delay of each command in control periods; the robot holds its position until the first one arrives";
    Language typos "1" "language" 0.0 0.0 0.3 real "share of the letters of the instruction that are exchanged with their successor";
    Language letter_case "1" "language" 0.0 0.0 2.0 whole "letters of the instruction: 0 as they are, 1 small, 2 capital";
    Language wording "1" "language" 0.0 0.0 256.0 whole "number of the wording of the instruction in the file of wordings; 0 for that of the task";
}

impl StressParameter {
    /// The range for this task. `None` if the task has nothing that the parameter acts on.
    fn range_for(&self, stress: &Stress, task: &TaskSpec) -> Option<[f64; 2]> {
        let cameras = task.observation.cameras.len();
        let [low, high] = self.range;
        let high = match (self.name, self.group) {
            (_, StressGroup::Images) if cameras == 0 => return None,
            ("transit_dropped_camera", _) => cameras as f64,
            ("transit_wording", _) => stress.wordings.len() as f64,
            _ => high,
        };
        (low < high).then_some([low, high])
    }

    fn domain(&self, [low, high]: [f64; 2]) -> Domain {
        match self.whole {
            true => Domain::Integer { low: low as i64, high: high as i64 },
            false => Domain::Continuous { low, high, scale: Scale::Linear },
        }
    }

    fn spec(&self, [low, high]: [f64; 2]) -> ParameterSpec {
        let nominal = match self.whole {
            true => Value::Integer(self.nominal as i64),
            false => Value::Number(self.nominal),
        };
        ParameterSpec {
            name: self.name.into(),
            unit: self.unit.to_owned(),
            meaning: self.meaning.to_owned(),
            allowed: match self.whole {
                true => Allowed::Integer { low: low as i64, high: high as i64 },
                false => Allowed::Continuous { low, high },
            },
            nominal: Some(nominal),
            read_from: "the adapter between environment and policy".to_owned(),
            family: Some(self.family),
        }
    }
}

/// The stress of a run: which parameters its scenarios may have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stress {
    /// Names of parameters ([`STRESS`]).
    pub parameters: Vec<String>,
    /// Other wordings of the instruction. Wording 1 is the first of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub wordings: Vec<String>,
}

impl Stress {
    /// Rejects an unknown parameter, and too many or too long wordings.
    ///
    /// # Errors
    /// The reason.
    pub fn check(&self) -> Result<(), String> {
        if let Some(unknown) = self.parameters.iter().find(|name| STRESS.iter().all(|row| row.name != **name)) {
            return Err(format!("`{unknown}` is not a parameter of stress"));
        }
        if self.wordings.len() > MOST_WORDINGS {
            return Err(format!("{} wordings. Expected at most {MOST_WORDINGS}", self.wordings.len()));
        }
        match self.wordings.iter().find(|text| text.is_empty() || text.chars().count() > MOST_CHARACTERS) {
            Some(text) => {
                Err(format!("a wording of {} characters. Expected 1 to {MOST_CHARACTERS}", text.chars().count()))
            }
            None => Ok(()),
        }
    }

    fn rows(&self) -> impl Iterator<Item = &'static StressParameter> {
        STRESS.iter().filter(|row| self.parameters.iter().any(|name| name == row.name))
    }

    /// The parameters that change words.
    pub fn of_language(&self) -> impl Iterator<Item = &'static str> {
        self.rows().filter(|row| row.group == StressGroup::Language).map(|row| row.name)
    }

    /// The parameters that change images.
    pub fn of_images(&self) -> impl Iterator<Item = &'static str> {
        self.rows().filter(|row| row.group == StressGroup::Images).map(|row| row.name)
    }

    /// What a space samples for this task: each parameter over its range. A task without cameras, and a run without wordings, lack some.
    pub fn parameters_for(&self, task: &TaskSpec) -> Vec<Parameter> {
        let parameter = |row: &StressParameter| {
            Some(Parameter { name: row.name.into(), domain: row.domain(row.range_for(self, task)?) })
        };
        self.rows().filter_map(parameter).collect()
    }

    /// The parameters that act on nothing in this task: images without a camera, other wordings without a file of them.
    pub fn without_effect(&self, task: &TaskSpec) -> Vec<&'static str> {
        self.rows().filter(|row| row.range_for(self, task).is_none()).map(|row| row.name).collect()
    }

    /// The task with the declarations of these parameters, other than those without effect.
    pub fn declared_in(&self, task: &Arc<TaskSpec>) -> Arc<TaskSpec> {
        let mut task = (**task).clone();
        let missing = self.rows().filter(|row| task.parameter(row.name).is_none());
        let specs: Vec<ParameterSpec> = missing.filter_map(|row| Some(row.spec(row.range_for(self, &task)?))).collect();
        task.parameters.extend(specs);
        Arc::new(task)
    }
}
