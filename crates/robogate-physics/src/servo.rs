//! The joint servo, which converts commands at the control rate to smooth targets at every time step.

use crate::{Arm, Chain};

/// Follows joint commands through a quadratic B-spline with the commands as control points.
///
/// Within a control period the target moves from the midpoint of the last two commands to the midpoint of the last and
/// the new one. Velocity is continuous, acceleration is the second difference of the commands, and the target trails
/// the commands by half a period. Commands beyond the joints' range, speed or acceleration limits are clamped first,
/// as a robot's own controller does.
#[derive(Debug, Clone)]
pub struct Servo {
    /// The last three commands, oldest first.
    older: Vec<f64>,
    newer: Vec<f64>,
    newest: Vec<f64>,
    period: f64,
}

impl Servo {
    /// A servo at rest at `positions` (rad), with a control period in seconds.
    pub fn at_rest(positions: &[f64], period: f64) -> Self {
        Self { older: positions.to_vec(), newer: positions.to_vec(), newest: positions.to_vec(), period }
    }

    /// Takes the next command: joint positions in radians.
    pub fn command(&mut self, command: &[f64], arm: &Arm, chain: &Chain) {
        std::mem::swap(&mut self.older, &mut self.newer);
        self.newer.clone_from(&self.newest);
        for (i, wanted) in command.iter().enumerate() {
            let joint = &chain.joints[i];
            let (last, before) = (self.newer[i], self.older[i]);
            let step_limit = arm.velocity_limit_rad_s[i] * self.period;
            let change_limit = arm.acceleration_limit_rad_s2[i] * self.period * self.period;
            let step = (last - before) + ((wanted - last) - (last - before)).clamp(-change_limit, change_limit);
            self.newest[i] = (last + step.clamp(-step_limit, step_limit)).clamp(joint.range[0], joint.range[1]);
        }
    }

    /// The control points of the spline, oldest first.
    #[cfg(feature = "mujoco")]
    pub(crate) fn control_points(&self) -> [&[f64]; 3] {
        [&self.older, &self.newer, &self.newest]
    }

    /// Writes the target positions (rad) and velocities (rad/s) at the fraction `u` in (0, 1] of the control period.
    pub fn targets(&self, u: f64, positions: &mut [f64], velocities: &mut [f64]) {
        let (a, b, c) = (0.5 * (1.0 - u) * (1.0 - u), 0.5 + u * (1.0 - u), 0.5 * u * u);
        for i in 0..positions.len() {
            let (older, newer, newest) = (self.older[i], self.newer[i], self.newest[i]);
            positions[i] = a * older + b * newer + c * newest;
            velocities[i] = ((1.0 - u) * (newer - older) + u * (newest - newer)) / self.period;
        }
    }
}
