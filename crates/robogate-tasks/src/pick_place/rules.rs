//! The rules of the task that a cell may change.

use robogate_physics::Robot;
use serde::{Deserialize, Serialize};

use super::cell::TIME_LIMIT_S;
use super::scene::workspace_scale;
use crate::arm::CONTROL_PERIOD_S;

/// The rules of pick and place that a cell may change. A run records them; an absent rule has its default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rules {
    /// Time limit of an episode, in seconds: an integer multiple of the control period.
    pub time_limit_s: f64,
    /// The robot presses if a contact force on it is above this, in newtons. While it holds the part, the grip force is
    /// added.
    pub jam_force_n: f64,
    /// Pressing for this long is a jam, in seconds.
    pub jam_duration_s: f64,
    /// Largest angle between the part at rest and its orientation at the target, in radians. `None` accepts every
    /// orientation, as the paper does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_tolerance_rad: Option<f64>,
    /// The failure modes that the task reports.
    pub modes: ModeSet,
    /// The size of the workspace.
    pub workspace: Workspace,
}

/// The size of the workspace: of all placements, the target and the circle of the obstacles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Workspace {
    /// That of the paper, scaled down about the base if the robot cannot reach all of it.
    #[default]
    Scaled,
    /// That of the paper for every robot.
    Paper,
}

/// A set of failure modes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModeSet {
    /// Every mode of the task.
    #[default]
    All,
    /// The four modes of the paper: `jam` and `misplaced` are reported as `timeout`.
    Paper,
}

impl Default for Rules {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The longest time limit, in seconds: a day.
const LONGEST_S: f64 = 86_400.0;

impl Rules {
    /// The default rules.
    pub const DEFAULT: Self = Self {
        time_limit_s: TIME_LIMIT_S,
        jam_force_n: 100.0,
        jam_duration_s: 0.05,
        orientation_tolerance_rad: None,
        modes: ModeSet::All,
        workspace: Workspace::Scaled,
    };

    /// The same rules with the modes and the workspace of the paper.
    #[must_use]
    pub fn like_the_paper(self) -> Self {
        Self { modes: ModeSet::Paper, workspace: Workspace::Paper, ..self }
    }

    /// The scale of this robot's workspace about its base.
    pub(crate) fn workspace_scale(&self, robot: &Robot) -> f64 {
        match self.workspace {
            Workspace::Scaled => workspace_scale(robot.settings.arm.reach_m),
            Workspace::Paper => 1.0,
        }
    }

    /// Whether these are the default rules.
    pub fn are_default(&self) -> bool {
        *self == Self::default()
    }

    /// Rejects rules out of range. The error names the rule and the accepted values.
    pub fn check(&self) -> Result<(), String> {
        let periods = self.time_limit_s / CONTROL_PERIOD_S;
        if !(0.999..=LONGEST_S / CONTROL_PERIOD_S).contains(&periods) || (periods - periods.round()).abs() > 1e-6 {
            return Err(format!(
                "the time limit of {} s is out of range. Expected a multiple of {CONTROL_PERIOD_S} s, at most {LONGEST_S} s",
                self.time_limit_s
            ));
        }
        let positive = [("force", self.jam_force_n, "N"), ("duration", self.jam_duration_s, "s")];
        if let Some((what, value, unit)) =
            positive.into_iter().find(|(_, value, _)| !(*value > 0.0 && value.is_finite()))
        {
            return Err(format!("the {what} of a jam is {value} {unit}. Expected a number above 0"));
        }
        match self.orientation_tolerance_rad {
            Some(angle) if !(angle > 0.0 && angle <= std::f64::consts::PI) => Err(format!(
                "the orientation tolerance of {:.3} degrees is out of range. Expected above 0 and at most 180 degrees",
                angle.to_degrees()
            )),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_checked() {
        assert_eq!(Rules::default().check(), Ok(()));
        for time_limit_s in [0.0, -1.0, 0.03, 1e9, f64::NAN] {
            assert!(Rules { time_limit_s, ..Rules::default() }.check().is_err(), "{time_limit_s}");
        }
        assert!(Rules { jam_force_n: 0.0, ..Rules::default() }.check().is_err());
        assert!(Rules { jam_duration_s: f64::INFINITY, ..Rules::default() }.check().is_err());
        assert!(Rules { orientation_tolerance_rad: Some(4.0), ..Rules::default() }.check().is_err());
        assert_eq!(Rules { time_limit_s: 20.0, ..Rules::default() }.check(), Ok(()));
    }

    #[test]
    fn absent_rules_are_default() {
        assert_eq!(serde_json::from_str::<Rules>("{}").unwrap(), Rules::default());
        assert!(serde_json::from_str::<Rules>(r#"{"jam": 3}"#).is_err());
    }
}
