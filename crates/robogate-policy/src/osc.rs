//! The motion of an arm under robosuite's `OSC_POSE` controller.
//!
//! The controller pulls the hand towards a goal like a critically damped spring of unit mass. Each action sets the goal
//! relative to the measured pose, so the hand follows far behind: ten actions of 1.0 (0.05 m each) move it by 0.11 m and
//! not by 0.5 m. An action without rotation leaves the goal of the orientation as it is (`set_goal` of robosuite 1.4.1).
//!
//! The spring and its damping are those of the controller. A drag that fades models the rest of the arm, and a limit of
//! the spring's pull on rotations models the torque limit of the wrist. Their constants were fitted to the motions of
//! `tests/libero/robosuite.json`, which they reproduce within 6 % of the distance.
//!
//! Limits: the response is the same for all directions and postures. Rotations about horizontal axes were not fitted.

/// Damping of the spring: critical for robosuite's stiffness of 150 / s², in 1/s.
const DAMPING: f64 = 24.49;
/// Stiffness of the spring, in 1/s². Slightly less than robosuite's, because the arm has friction.
const STIFFNESS: f64 = 140.0;
/// Length of an integration step, in seconds: that of robosuite's simulation.
const STEP_S: f64 = 0.002;

/// Constants of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Constants {
    /// Drag at the start of a motion, in 1/s.
    drag: f64,
    /// Time constant with which the drag fades, in seconds.
    fades_s: f64,
    /// Offset of the goal at which the pull of the spring saturates.
    saturates: f64,
}

const TRANSLATION: Constants = Constants { drag: 10.0, fades_s: 0.1, saturates: f64::INFINITY };
const ROTATION: Constants = Constants { drag: 8.0, fades_s: 0.2, saturates: 0.3 };

/// One axis: a translation, or a component of a rotation vector.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    constants: Constants,
    /// Remaining offset of the goal, in metres or radians.
    goal: f64,
    /// Velocity, in m/s or rad/s.
    velocity: f64,
    /// Velocity to which the drag has adapted.
    adapted: f64,
}

impl Axis {
    fn at_rest(constants: Constants) -> Self {
        Self { constants, goal: 0.0, velocity: 0.0, adapted: 0.0 }
    }

    /// Moves for a control period. Returns the displacement to command.
    ///
    /// A robot's servo trails its commands by half a control period. The commanded motion is ahead by as much.
    fn advance(&mut self, period_s: f64) -> f64 {
        let Constants { drag, fades_s, saturates } = self.constants;
        let steps = (period_s / STEP_S).round().clamp(1.0, 1000.0);
        let step_s = period_s / steps;
        let before = self.velocity;
        let mut moved = 0.0;
        for _ in 0..steps as u32 {
            let pull = STIFFNESS * self.goal / (1.0 + (self.goal / saturates).powi(2)).sqrt();
            let acceleration = pull - DAMPING * self.velocity - drag * (self.velocity - self.adapted);
            self.adapted += step_s * (self.velocity - self.adapted) / fades_s;
            self.velocity += step_s * acceleration;
            self.goal -= step_s * self.velocity;
            moved += step_s * self.velocity;
        }
        moved + 0.5 * period_s * (self.velocity - before)
    }

    /// The goal with which the axis moves by `wanted` in the next control period, or the nearest one up to `limit`.
    fn goal_for(self, wanted: f64, period_s: f64, limit: f64) -> f64 {
        // The displacement increases with the goal.
        let moves = |goal: f64| Self { goal, ..self }.advance(period_s);
        let (mut low, mut high) = (-limit, limit);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if moves(middle) < wanted { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// Largest goal that is searched for a motion, in metres or radians.
const MAX_GOAL: f64 = 10.0;

/// The six axes of the hand, in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Osc {
    translation: [Axis; 3],
    rotation: [Axis; 3],
}

impl Default for Osc {
    fn default() -> Self {
        Self { translation: [Axis::at_rest(TRANSLATION); 3], rotation: [Axis::at_rest(ROTATION); 3] }
    }
}

/// Applies `change` to each axis and its number.
fn each(axes: &[Axis; 3], numbers: [f64; 3], change: impl Fn(&Axis, f64) -> f64) -> [f64; 3] {
    let mut result = numbers;
    result.iter_mut().zip(axes).for_each(|(number, axis)| *number = change(axis, *number));
    result
}

impl Osc {
    /// Sets the goal relative to the present pose: a translation in metres and a rotation vector.
    pub(crate) fn set_goal(&mut self, translation_m: [f64; 3], rotation_rad: [f64; 3]) {
        self.translation.iter_mut().zip(translation_m).for_each(|(axis, goal)| axis.goal = goal);
        if rotation_rad.iter().any(|n| n.abs() > 0.0) {
            self.rotation.iter_mut().zip(rotation_rad).for_each(|(axis, goal)| axis.goal = goal);
        }
    }

    /// Moves for a control period. Returns the translation in metres and the rotation vector to command.
    pub(crate) fn advance(&mut self, period_s: f64) -> ([f64; 3], [f64; 3]) {
        let moved = |axes: &mut [Axis; 3]| {
            let mut displacement = [0.0; 3];
            displacement.iter_mut().zip(axes).for_each(|(moved, axis)| *moved = axis.advance(period_s));
            displacement
        };
        (moved(&mut self.translation), moved(&mut self.rotation))
    }

    /// The goal with which the next commanded motion is this translation and rotation vector.
    pub(crate) fn goal_for(
        &self,
        translation_m: [f64; 3],
        rotation_rad: [f64; 3],
        period_s: f64,
    ) -> ([f64; 3], [f64; 3]) {
        let goal = |axis: &Axis, wanted: f64| axis.goal_for(wanted, period_s, MAX_GOAL);
        (each(&self.translation, translation_m, goal), each(&self.rotation, rotation_rad, goal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goals_are_inverted() {
        let mut osc = Osc::default();
        for step in 0..40 {
            let phase = 0.3 * f64::from(step);
            let wanted = ([0.01 * phase.sin(), -0.005, 0.002], [0.0, 0.01 * phase.cos(), 0.03]);
            let (translation, rotation) = osc.goal_for(wanted.0, wanted.1, 0.05);
            osc.set_goal(translation, rotation);
            let moved = osc.advance(0.05);
            let pairs = moved.0.into_iter().chain(moved.1).zip(wanted.0.into_iter().chain(wanted.1));
            pairs.for_each(|(got, want)| assert!((got - want).abs() < 1e-12, "{step}: {got} {want}"));
        }
    }

    #[test]
    fn zero_rotation_keeps_the_goal() {
        let mut osc = Osc::default();
        osc.set_goal([0.0; 3], [0.0, 0.0, 0.5]);
        osc.advance(0.05);
        osc.set_goal([0.0; 3], [0.0; 3]);
        let later: f64 = (0..100).map(|_| osc.advance(0.05).1[2]).sum();
        assert!(later > 0.4, "{later}");
    }
}
