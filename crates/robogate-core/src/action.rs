//! What a policy answers, and what a task takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Word;

/// What a policy answers to an observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// The motion.
    pub command: Command,
    /// The gripper: from -1 (open fully, or let go) to 1 (close with the set force, or take hold). A binary gripper
    /// closes above 0. `None` where the task has no gripper of its own.
    pub gripper: Option<f64>,
    /// The phase that the policy reports: recorded, never judged.
    pub phase: Option<Word>,
}

impl Action {
    /// The gripper command that opens.
    pub const OPEN: f64 = -1.0;
    /// The gripper command that closes.
    pub const CLOSE: f64 = 1.0;
}

/// A motion until the next action.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Reach these measured joint positions (rad; m for a sliding joint) at the end of the control period.
    JointPosition(Vec<f64>),
    /// Move the tool centre point relative to where it was last sent to.
    ToolDelta {
        /// Translation along the axes of the base frame, in metres.
        translation_m: [f64; 3],
        /// Rotation about the axes of the base frame, as a rotation vector (axis times angle) in radians.
        rotation_rad: [f64; 3],
    },
    /// Numbers whose meaning is the task's own.
    Vector(Vec<f64>),
}

/// The actions that a task takes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActionSpec {
    /// The kinds of command, at least one in a task that runs; the first is the task's own.
    #[serde(default)]
    pub spaces: Vec<ActionSpace>,
    /// The gripper beside the command; absent where there is none, or where it is part of the vector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperKind>,
}

/// A kind of command.
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
        /// The unit of a translation on the wire, and the largest one in a control period, in metres.
        translation_m: f64,
        /// The unit of a rotation on the wire, and the largest one in a control period, in radians.
        rotation_rad: f64,
    },
    /// [`Command::Vector`].
    Vector {
        /// What each number is; their number is that of the action's numbers.
        names: Vec<String>,
        /// The smallest value of each.
        low: Vec<f64>,
        /// The largest value of each.
        high: Vec<f64>,
    },
}

/// What a gripper can be commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperKind {
    /// Open or closed: above 0 it closes.
    Binary,
    /// Anything between.
    Continuous,
}

/// How far beyond its bound a number may be by rounding, as a share of the range.
const ROUNDING: f64 = 1e-6;

impl ActionSpec {
    /// The joints, where joint positions are taken.
    pub fn joints(&self) -> Option<&[String]> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::JointPosition { joints } => Some(&**joints),
            _ => None,
        })
    }

    /// What 1 means in a tool delta on the wire, in metres and radians, where tool deltas are taken.
    pub fn tool_delta(&self) -> Option<(f64, f64)> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::ToolDelta { translation_m, rotation_rad } => Some((*translation_m, *rotation_rad)),
            _ => None,
        })
    }

    /// Lower and upper bounds, where vectors are taken.
    pub fn vector(&self) -> Option<(&[f64], &[f64])> {
        self.spaces.iter().find_map(|space| match space {
            ActionSpace::Vector { low, high, .. } => Some((&**low, &**high)),
            _ => None,
        })
    }

    /// The accepted kinds of command, for messages.
    pub fn kinds(&self) -> String {
        let kinds: Vec<&str> = self.spaces.iter().map(ActionSpace::as_str).collect();
        kinds.join(" or ")
    }

    /// Whether `action` is one of these; the error says what was expected.
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

    /// Rejects a declaration that no action can meet.
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
                Err("joint_position has no joints".to_owned())
            }
            ActionSpace::ToolDelta { translation_m, rotation_rad }
                if !(*translation_m > 0.0 && *rotation_rad > 0.0 && finite(&[*translation_m, *rotation_rad])) =>
            {
                Err("the unit of tool_delta must be positive".to_owned())
            }
            ActionSpace::Vector { names, low, high } => {
                let same = names.len() == low.len() && low.len() == high.len();
                if names.is_empty() || !same {
                    return Err("vector needs a name, a low and a high for each of its numbers".to_owned());
                }
                match low.iter().zip(high).position(|(low, high)| !(low < high && low.is_finite() && high.is_finite()))
                {
                    Some(i) => {
                        Err(format!("`{}`: low {} is not below high {}, both finite", names[i], low[i], high[i]))
                    }
                    None => Ok(()),
                }
            }
            _ => Ok(()),
        })
    }
}

impl ActionSpace {
    /// Its name in data.
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
