//! Actions of a policy, and the specification of the actions that a task accepts.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Word;

/// The action of a policy for one control period.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// The motion of the arm.
    pub command: Command,
    /// The gripper command: from -1 (open fully, or release) to 1 (close with the set force, or grip). A binary gripper
    /// closes above 0. `None` if the task has no separate gripper command.
    pub gripper: Option<f64>,
    /// The phase that the policy reports. It is recorded and has no effect on the outcome.
    pub phase: Option<Word>,
}

impl Action {
    /// The gripper command that opens.
    pub const OPEN: f64 = -1.0;
    /// The gripper command that closes.
    pub const CLOSE: f64 = 1.0;
}

/// The motion until the next action.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Reach these measured joint positions (rad; m for a sliding joint) at the end of the control period.
    JointPosition(Vec<f64>),
    /// Move the tool centre point relative to its last commanded pose.
    ToolDelta {
        /// Translation along the axes of the base frame, in metres.
        translation_m: [f64; 3],
        /// Rotation about the axes of the base frame, as a rotation vector (axis times angle) in radians.
        rotation_rad: [f64; 3],
    },
    /// A vector of numbers with a meaning that the task defines.
    Vector(Vec<f64>),
}

impl Command {
    /// Its numbers; those of a motion of the tool are translation and rotation.
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Self::JointPosition(numbers) | Self::Vector(numbers) => numbers.clone(),
            Self::ToolDelta { translation_m, rotation_rad } => [*translation_m, *rotation_rad].concat(),
        }
    }
}

/// The specification of the actions that a task accepts.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActionSpec {
    /// The accepted kinds of command. A task that runs has at least one. The first is the task's native one.
    #[serde(default)]
    pub spaces: Vec<ActionSpace>,
    /// The gripper command beside the motion. Absent if there is no gripper, or if it is part of the vector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperKind>,
}

/// A kind of command and its limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ActionSpace {
    /// [`Command::JointPosition`].
    JointPosition {
        /// The joints, base to tip.
        joints: Vec<String>,
    },
    /// [`Command::ToolDelta`].
    ToolDelta {
        /// The unit of a translation on the wire, in metres. Also the largest translation in a control period.
        translation_m: f64,
        /// The unit of a rotation on the wire, in radians. Also the largest rotation in a control period.
        rotation_rad: f64,
    },
    /// [`Command::Vector`].
    Vector {
        /// The names of the numbers. Their count is the length of the vector.
        names: Vec<String>,
        /// The lower bound of each number.
        low: Vec<f64>,
        /// The upper bound of each number.
        high: Vec<f64>,
    },
}

/// The commands that a gripper accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperKind {
    /// Open or closed. A command above 0 closes.
    Binary,
    /// Any opening between open and closed.
    Continuous,
}

/// Tolerance at a bound for rounding errors, as a fraction of the range.
const ROUNDING: f64 = 1e-6;

impl ActionSpec {
    /// The joint names, if joint positions are accepted.
    pub fn joints(&self) -> Option<&[String]> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::JointPosition { joints } => Some(&**joints),
            _ => None,
        })
    }

    /// The unit of a tool delta on the wire, in metres and radians, if tool deltas are accepted.
    pub fn tool_delta(&self) -> Option<(f64, f64)> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::ToolDelta { translation_m, rotation_rad } => Some((*translation_m, *rotation_rad)),
            _ => None,
        })
    }

    /// Lower and upper bounds, if vectors are accepted.
    pub fn vector(&self) -> Option<(&[f64], &[f64])> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::Vector { low, high, .. } => Some((&**low, &**high)),
            _ => None,
        })
    }

    /// The names of the numbers, if vectors are accepted.
    pub fn vector_names(&self) -> Option<&[String]> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::Vector { names, .. } => Some(&**names),
            _ => None,
        })
    }

    /// The accepted kinds of command as text, for messages.
    pub fn kinds(&self) -> String {
        let kinds: Vec<&str> = self.spaces.iter().map(ActionSpace::as_str).collect();
        kinds.join(" or ")
    }

    /// Checks that `action` matches this specification. The error names the expected action.
    pub fn accepts(&self, action: &Action) -> Result<(), String> {
        let other = |what: &str| Err(format!("{what} is not an action of this task; expected {}", self.kinds()));
        match &action.command {
            Command::JointPosition(wanted) => match self.joints() {
                None => return other("joint_position"),
                Some(joints) if wanted.len() != joints.len() || !finite(wanted) => {
                    return Err(format!("expected {} finite joint positions, got {wanted:?}", joints.len()));
                }
                Some(_) => {}
            },
            Command::ToolDelta { translation_m, rotation_rad } => {
                if self.tool_delta().is_none() {
                    return other("tool_delta");
                }
                if !finite(translation_m) || !finite(rotation_rad) {
                    return Err(format!(
                        "expected a finite motion of the tool, got {translation_m:?} m, {rotation_rad:?} rad"
                    ));
                }
            }
            Command::Vector(values) => {
                let Some((low, high)) = self.vector() else { return other("vector") };
                if values.len() != low.len() || !finite(values) {
                    return Err(format!("expected {} finite numbers, got {values:?}", low.len()));
                }
                let outside = |i: &usize| {
                    let room = ROUNDING * (high[*i] - low[*i]);
                    values[*i] < low[*i] - room || values[*i] > high[*i] + room
                };
                if let Some(i) = (0..values.len()).find(outside) {
                    return Err(format!(
                        "number {i} of the action is {}; expected {} to {}",
                        values[i], low[i], high[i]
                    ));
                }
            }
        }
        match (self.gripper, action.gripper) {
            (Some(_), Some(command)) if (-1.0..=1.0).contains(&command) => Ok(()),
            (Some(_), command) => {
                Err(format!("expected a gripper command from -1 (open) to 1 (close), got {command:?}"))
            }
            (None, None) => Ok(()),
            (None, Some(_)) => Err("this task has no gripper command".to_owned()),
        }
    }

    /// Rejects a specification that no action can satisfy.
    pub(crate) fn check(&self) -> Result<(), String> {
        if self.spaces.is_empty() {
            return Err("`spaces` is empty; expected joint_position, tool_delta or vector".to_owned());
        }
        let kinds: Vec<&str> = self.spaces.iter().map(ActionSpace::as_str).collect();
        if let Some(i) = (1..kinds.len()).find(|i| kinds[..*i].contains(&kinds[*i])) {
            return Err(format!("`{}` is declared twice", kinds[i]));
        }
        self.spaces.iter().try_for_each(|space| match space {
            ActionSpace::JointPosition { joints } if joints.is_empty() => {
                Err("joint_position has no joints; expected at least one".to_owned())
            }
            ActionSpace::ToolDelta { translation_m, rotation_rad }
                if !(*translation_m > 0.0 && *rotation_rad > 0.0 && finite(&[*translation_m, *rotation_rad])) =>
            {
                Err("tool_delta: `translation_m` and `rotation_rad` must be positive".to_owned())
            }
            ActionSpace::Vector { names, low, high } => {
                let same = names.len() == low.len() && low.len() == high.len();
                if names.is_empty() || !same {
                    return Err("vector: `names`, `low` and `high` must have the same length, at least 1".to_owned());
                }
                match low.iter().zip(high).position(|(low, high)| !(low < high && low.is_finite() && high.is_finite()))
                {
                    Some(i) => Err(format!(
                        "`{}`: low {} must be below high {}, and both must be finite",
                        names[i], low[i], high[i]
                    )),
                    None => Ok(()),
                }
            }
            _ => Ok(()),
        })
    }
}

impl ActionSpace {
    /// The name in data files.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::JointPosition { .. } => "joint_position",
            Self::ToolDelta { .. } => "tool_delta",
            Self::Vector { .. } => "vector",
        }
    }
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|x| x.is_finite())
}
