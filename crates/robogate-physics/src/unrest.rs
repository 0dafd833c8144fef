//! Notices fingers that never come to rest, which is an error of the robot's model and not of a policy.

use crate::GripperCommand;

/// Duration of a window of observation, in seconds.
const WINDOW_S: f64 = 0.5;
/// The fingers are not at rest in a window if they reverse at least this often. No policy moves them so fast: commands change at
/// most at the control rate of 20 Hz, and the gripper has been given the same one all the time.
const REVERSALS: u32 = 40;
/// A reversal counts if the opening changes faster than this before and after it, in m/s.
const SPEED_M_S: f64 = 0.01;
/// Number of windows in a row after which the model is faulty.
const WINDOWS: u32 = 4;

/// Counts the reversals of the fingers while the command to the gripper does not change.
#[derive(Debug, Clone, Default)]
pub(crate) struct Unrest {
    command: Option<GripperCommand>,
    /// The last opening (m), and its last fast rate of change (m/s).
    opening: Option<f64>,
    rate: f64,
    steps: u32,
    reversals: u32,
    /// Windows in a row without rest.
    windows: u32,
}

impl Unrest {
    /// Takes the opening (m) after a time step (s). Returns the frequency of the motion in hertz once the fingers have not been at
    /// rest for two seconds.
    pub(crate) fn step(&mut self, command: GripperCommand, opening: f64, time_step: f64) -> Option<f64> {
        if self.command != Some(command) {
            *self = Self { command: Some(command), opening: Some(opening), ..Self::default() };
            return None;
        }
        let rate = (opening - self.opening.replace(opening)?) / time_step;
        if rate.abs() > SPEED_M_S {
            self.reversals += u32::from(rate * self.rate < 0.0);
            self.rate = rate;
        }
        self.steps += 1;
        let elapsed = f64::from(self.steps) * time_step;
        if elapsed < WINDOW_S - 1e-9 {
            return None;
        }
        let reversals = std::mem::take(&mut self.reversals);
        self.steps = 0;
        self.windows = if reversals >= REVERSALS { self.windows + 1 } else { 0 };
        (self.windows >= WINDOWS).then(|| f64::from(reversals) / (2.0 * elapsed))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// The time after which an opening, as a function of time, is reported, and its frequency.
    fn reported(opening: impl Fn(f64) -> f64, command: impl Fn(f64) -> GripperCommand) -> Option<(f64, f64)> {
        let mut unrest = Unrest::default();
        (0..5_000).find_map(|k| {
            let time = 0.002 * f64::from(k);
            unrest.step(command(time), opening(time), 0.002).map(|frequency| (time, frequency))
        })
    }

    #[test]
    fn oscillation_is_reported_after_two_seconds() {
        let found = reported(|time| 0.04 + 1e-4 * (TAU * 80.0 * time).sin(), |_| GripperCommand::Close);
        let (time, frequency) = found.unwrap();
        assert!((time - 2.0).abs() < 0.01 && (frequency - 80.0).abs() < 2.0, "{time} {frequency}");
    }

    #[test]
    fn motion_of_a_policy_is_not_reported() {
        // Closing, slow or small oscillation, and a command that changes every half second.
        assert_eq!(reported(|time| 0.08 - 0.005 * time, |_| GripperCommand::Close), None);
        assert_eq!(reported(|time| 0.04 + 1e-3 * (TAU * 10.0 * time).sin(), |_| GripperCommand::Close), None);
        assert_eq!(reported(|time| 0.04 + 1e-6 * (TAU * 80.0 * time).sin(), |_| GripperCommand::Close), None);
        let toggled = |time: f64| match time % 1.0 < 0.5 {
            true => GripperCommand::Open,
            false => GripperCommand::Close,
        };
        assert_eq!(reported(|time| 0.04 + 1e-4 * (TAU * 80.0 * time).sin(), toggled), None);
    }
}
