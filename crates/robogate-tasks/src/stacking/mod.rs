//! Stacking: put two parts on a third one, in a given order and with a given offset.
//!
//! Three equal cubes stand on the table. The first one of the order stays where it is; the arm stacks the other two on
//! it. [`statics`] has the limits of overhang that the physics is verified against.

mod claims;
mod controller;
mod foresight;
mod parameters;
mod referee;
mod scene;
mod spec;
pub mod statics;

use crate::arm::{ArmSettings, HasSettings, jam_rows, on_arm, rows};
use crate::settings::SettingRow;

/// The task's name.
const NAME: &str = "stacking";

/// The stacking task.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stacking {
    /// The settings of the arm.
    pub arm: ArmSettings,
    /// A part is in its place within this horizontal distance of its offset from the part below, in metres.
    pub tolerance_m: f64,
    /// A part has tipped over beyond this angle, in radians.
    pub tilt_limit_rad: f64,
    /// The robot presses if a contact force on it is above this, in newtons. While it holds a part, the grip force is added.
    pub jam_force_n: f64,
    /// Pressing for this long is a jam, in seconds.
    pub jam_duration_s: f64,
}

impl Stacking {
    /// The task with its default settings.
    pub const DEFAULT: Self = Self {
        arm: ArmSettings::lasting(30.0),
        tolerance_m: 0.01,
        tilt_limit_rad: 0.262,
        jam_force_n: 100.0,
        jam_duration_s: 0.05,
    };
}

on_arm!(Stacking);

impl HasSettings for Stacking {
    fn rows() -> Vec<SettingRow<Self>> {
        let own = [
            SettingRow::number(
                "tolerance_m",
                "Largest horizontal distance of a part from its place on the part below.",
                [1e-4, 0.05],
                |task: &mut Self| &mut task.tolerance_m,
            ),
            SettingRow::number(
                "tilt_limit_rad",
                "A part of the stack has toppled beyond this angle.",
                [0.01, 1.5],
                |task| &mut task.tilt_limit_rad,
            ),
        ];
        rows(own.into_iter().chain(jam_rows(|task: &mut Self| &mut task.jam_force_n, |task| &mut task.jam_duration_s)))
    }
}
