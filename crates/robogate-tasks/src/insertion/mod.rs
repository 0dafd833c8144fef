//! Peg insertion: pick up a square peg and insert it into a hole with a small clearance.
//!
//! [`whitney`] has the limits of wedging and jamming that the physics is verified against, [`parts`] the geometry.

mod claims;
mod controller;
mod foresight;
mod parameters;
pub mod parts;
mod referee;
mod scene;
mod spec;
pub mod whitney;

use crate::arm::{ArmSettings, HasSettings, on_arm, rows};
use crate::settings::SettingRow;

/// The task's name.
const NAME: &str = "insertion";

/// The insertion task.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Insertion {
    /// The settings of the arm.
    pub arm: ArmSettings,
    /// The tip is seated within this distance of the full depth, in metres.
    pub seat_tolerance_m: f64,
    /// A stuck peg is pressed with at least this force along the hole's axis, in newtons ...
    pub stuck_force_n: f64,
    /// ... for this long in total since its last progress, in seconds.
    pub stuck_duration_s: f64,
    /// A peg that is pressed with more than this force, in newtons ...
    pub jam_force_n: f64,
    /// ... for this long, in seconds, is jammed.
    pub jam_duration_s: f64,
}

impl Insertion {
    /// The task with its default settings.
    pub const DEFAULT: Self = Self {
        arm: ArmSettings::lasting(40.0),
        seat_tolerance_m: 0.002,
        stuck_force_n: 10.0,
        stuck_duration_s: 3.0,
        jam_force_n: 80.0,
        jam_duration_s: 0.5,
    };
}

on_arm!(Insertion);

impl HasSettings for Insertion {
    fn rows(&self) -> Vec<SettingRow<Self>> {
        rows([
            SettingRow::number(
                "seat_tolerance_m",
                "The peg is seated if its tip is within this distance of the full depth.",
                [1e-4, 0.02],
                |task: &mut Self| &mut task.seat_tolerance_m,
            ),
            SettingRow::number(
                "stuck_force_n",
                "A peg without progress is stuck if it is pressed with at least this force along the hole's axis.",
                [0.1, 1e4],
                |task| &mut task.stuck_force_n,
            ),
            SettingRow::number(
                "stuck_duration_s",
                "A peg is stuck after this time of pressing without progress.",
                [0.01, 3600.0],
                |task| &mut task.stuck_duration_s,
            ),
            SettingRow::number(
                "jam_force_n",
                "A peg that is pressed with more than this force along the hole's axis is jammed.",
                [0.1, 1e6],
                |task| &mut task.jam_force_n,
            ),
            SettingRow::number("jam_duration_s", "Duration of pressing that is a jam.", [1e-3, 3600.0], |task| {
                &mut task.jam_duration_s
            }),
        ])
    }
}
