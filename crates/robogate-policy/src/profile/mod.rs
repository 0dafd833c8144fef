//! Profiles: the observation and action mapping of a model, as data.

mod action;
mod check;
mod dialect;
mod memory;
mod observation;

use robogate_core::budget::Budget;
use serde::{Deserialize, Serialize};

pub use action::{ActionForm, Arm, Chunking, Frame, Rotation, Side};
pub(crate) use check::MAX_CHUNK;
pub use check::ProfileError;
pub use dialect::{Dialect, Gr00t, LeRobot};
pub use memory::Memory;
pub use observation::{Axes, Camera, Filter, Fit, Orientation, Part, State, Tool};

/// The description of a model and its server, from a TOML file: built in or supplied by the user.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Name of the policy in records and rankings.
    pub name: String,
    /// Description of the model.
    pub model: String,
    /// Notes for users.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub notes: String,
    /// The built-in profile whose published conventions the positive control of a gate uses, if this profile is an
    /// adapted copy of it. Default: this profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// Instruction for the model. Default: the instruction of the task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instruction: Option<String>,
    /// Wire format of the server.
    pub dialect: Dialect,
    /// Width and height in pixels at which the cameras of the cell are rendered. Default 256. Models that were trained
    /// on small images should not receive downsampled ones, because those are smoother.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rendered_px: Option<usize>,
    /// Images, in the order in which they are sent.
    #[serde(default, rename = "camera", skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Camera>,
    /// Vectors, in the order in which they are sent.
    #[serde(default, rename = "state", skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<State>,
    /// Outputs of a recurrent network that are its inputs at the next request. Only for ONNX files: servers keep their
    /// own state.
    #[serde(default, rename = "memory", skip_serializing_if = "Vec::is_empty")]
    pub memories: Vec<Memory>,
    /// Differences between the tool of the cell and that of the training data.
    #[serde(default)]
    pub tool: Tool,
    /// Meaning of the numbers of an action.
    pub action: ActionForm,
    /// Number of actions in a reply, and number of executed actions.
    pub chunk: Chunking,
    /// Timeouts and connection attempts.
    #[serde(default)]
    pub server: Timeouts,
}

/// Timeouts and connection attempts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Timeouts {
    /// Timeout for connecting, including the server's metadata, in seconds.
    pub connect_s: f64,
    /// Timeout for the first reply on a connection, in seconds. Some servers compile the model at that time.
    pub first_answer_s: f64,
    /// Timeout for each later reply, in seconds.
    pub answer_s: f64,
    /// Number of connection attempts for an episode. The pauses between them are 1, 2, 4, 8 s and so on.
    pub attempts: u32,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self { connect_s: 20.0, first_answer_s: 300.0, answer_s: 30.0, attempts: 5 }
    }
}

/// The built-in profiles, by name.
const BUILT_IN: &[(&str, &str)] = &[
    ("gr00t-n1.6", include_str!("../profiles/gr00t-n1.6.toml")),
    ("gr00t-n1.6-libero", include_str!("../profiles/gr00t-n1.6-libero.toml")),
    ("pi0-libero", include_str!("../profiles/pi0-libero.toml")),
    ("openvla", include_str!("../profiles/openvla.toml")),
    ("openvla-oft", include_str!("../profiles/openvla-oft.toml")),
    ("smolvla-vla-eval", include_str!("../profiles/smolvla-vla-eval.toml")),
    ("smolvla", include_str!("../profiles/smolvla.toml")),
    ("octo-base", include_str!("../profiles/octo-base.toml")),
    ("octo-small", include_str!("../profiles/octo-small.toml")),
    ("droid", include_str!("../profiles/droid.toml")),
    ("droid-roboarena", include_str!("../profiles/droid-roboarena.toml")),
    ("pi0-fast-libero", include_str!("../profiles/pi0-fast-libero.toml")),
    ("pi05-libero", include_str!("../profiles/pi05-libero.toml")),
    ("pi0-droid", include_str!("../profiles/pi0-droid.toml")),
    ("pi0-fast-droid", include_str!("../profiles/pi0-fast-droid.toml")),
    ("pi05-droid", include_str!("../profiles/pi05-droid.toml")),
    ("gr00t-n1.5-libero", include_str!("../profiles/gr00t-n1.5-libero.toml")),
    ("gr00t-n1.7-libero", include_str!("../profiles/gr00t-n1.7-libero.toml")),
    ("gr00t-n1.7-droid", include_str!("../profiles/gr00t-n1.7-droid.toml")),
    ("openvla-libero", include_str!("../profiles/openvla-libero.toml")),
    ("starvla-libero", include_str!("../profiles/starvla-libero.toml")),
    ("starvla-server-libero", include_str!("../profiles/starvla-server-libero.toml")),
    ("pi0-aloha-sim", include_str!("../profiles/pi0-aloha-sim.toml")),
    ("pi05-aloha", include_str!("../profiles/pi05-aloha.toml")),
    ("xpolicylab-dual-arm", include_str!("../profiles/xpolicylab-dual-arm.toml")),
    ("x-vla-libero", include_str!("../profiles/x-vla-libero.toml")),
    ("smolvla-base", include_str!("../profiles/smolvla-base.toml")),
    ("learned", include_str!("../profiles/learned.toml")),
];

impl Profile {
    /// Names of the built-in profiles.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// TOML text of a built-in profile.
    pub fn built_in(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
    }

    /// The profile with the published conventions of the model: [`Self::reference`], or this profile.
    ///
    /// # Errors
    /// If the built-in profile is not valid.
    pub fn published(&self) -> Result<Self, ProfileError> {
        match self.reference.as_deref().and_then(Self::built_in) {
            Some(text) => Self::from_toml(text),
            None => Ok(self.clone()),
        }
    }

    /// Parse and check a profile.
    pub fn from_toml(text: &str) -> Result<Self, ProfileError> {
        let profile: Self = Budget::FILE.toml(text).map_err(|e| ProfileError::Form(e.to_string()))?;
        profile.check()?;
        Ok(profile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_profiles_are_valid() {
        for name in Profile::built_in_names() {
            let profile = Profile::from_toml(Profile::built_in(name).unwrap()).unwrap();
            assert_eq!(profile.name, name);
            // Runs record profiles as JSON.
            let json = serde_json::to_string(&profile).unwrap();
            assert_eq!(serde_json::from_str::<Profile>(&json).unwrap(), profile, "{name}");
        }
    }
}
