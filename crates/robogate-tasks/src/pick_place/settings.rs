//! The settings of pick and place.

use std::f64::consts::PI;

use robogate_physics::Robot;

use super::scene::workspace_scale;
use crate::arm::{ArmSettings, HasSettings, jam_rows, on_arm, rows};
use crate::settings::{Choice, SettingRow};

/// Pick and place with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PickPlace {
    /// The settings of the arm.
    pub arm: ArmSettings,
    /// The part is at its target within this horizontal distance, in metres.
    pub tolerance_m: f64,
    /// The robot presses if a contact force on it is above this, in newtons. While it holds the part, the grip force is
    /// added.
    pub jam_force_n: f64,
    /// Pressing for this long is a jam, in seconds.
    pub jam_duration_s: f64,
    /// Largest angle between the part at rest and its orientation at the target, in radians. A half turn accepts every
    /// orientation, as the paper does.
    pub orientation_tolerance_rad: f64,
    /// The failure modes that the task reports.
    pub modes: ModeSet,
    /// The size of the workspace.
    pub workspace: Workspace,
}

/// The size of the workspace: of all placements, the target and the circle of the obstacles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Workspace {
    /// That of the paper, scaled down about the base if the robot cannot reach all of it.
    #[default]
    Scaled,
    /// That of the paper for every robot.
    Paper,
}

/// A set of failure modes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ModeSet {
    /// Every mode of the task.
    #[default]
    All,
    /// The four modes of the paper: `jam` and `misplaced` are reported as `timeout`.
    Paper,
}

impl Choice for Workspace {
    fn words(&self) -> &'static [&'static str] {
        &["scaled", "paper"]
    }

    fn word(&self) -> &'static str {
        match self {
            Self::Scaled => "scaled",
            Self::Paper => "paper",
        }
    }

    fn choose(&mut self, word: &str) {
        *self = if word == "paper" { Self::Paper } else { Self::Scaled };
    }
}

impl Choice for ModeSet {
    fn words(&self) -> &'static [&'static str] {
        &["all", "paper"]
    }

    fn word(&self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Paper => "paper",
        }
    }

    fn choose(&mut self, word: &str) {
        *self = if word == "paper" { Self::Paper } else { Self::All };
    }
}

impl PickPlace {
    /// The task with its default settings.
    pub const DEFAULT: Self = Self {
        arm: ArmSettings::lasting(15.0),
        tolerance_m: 0.01,
        jam_force_n: 100.0,
        jam_duration_s: 0.05,
        orientation_tolerance_rad: PI,
        modes: ModeSet::All,
        workspace: Workspace::Scaled,
    };

    /// The scale of this robot's workspace about its base.
    pub(crate) fn workspace_scale(&self, robot: &Robot) -> f64 {
        match self.workspace {
            Workspace::Scaled => workspace_scale(robot.settings.arm.reach_m),
            Workspace::Paper => 1.0,
        }
    }

    /// The largest angle at the target, in radians. `None` if every orientation is accepted.
    pub(crate) fn orientation_limit_rad(&self) -> Option<f64> {
        (self.orientation_tolerance_rad < PI).then_some(self.orientation_tolerance_rad)
    }
}

on_arm!(PickPlace);

impl HasSettings for PickPlace {
    fn rows(&self) -> Vec<SettingRow<Self>> {
        let own = [
            SettingRow::number(
                "tolerance_m",
                "Largest horizontal distance of the part from its target.",
                [1e-4, 0.3],
                |task: &mut Self| &mut task.tolerance_m,
            ),
            SettingRow::number(
                "orientation_tolerance_rad",
                "Largest angle of the part at the target. A half turn accepts every orientation.",
                [1e-3, PI],
                |task| &mut task.orientation_tolerance_rad,
            ),
        ];
        let others = [
            SettingRow::choice(
                "failure_modes",
                "The failure modes that are reported: all, or the four of the paper.",
                |task: &mut Self| &mut task.modes,
            ),
            SettingRow::choice(
                "workspace",
                "The size of the workspace: that of the paper, scaled to the robot or not.",
                |task| &mut task.workspace,
            ),
        ];
        let jam = jam_rows(|task: &mut Self| &mut task.jam_force_n, |task| &mut task.jam_duration_s);
        rows(own.into_iter().chain(jam).chain(others))
    }
}
