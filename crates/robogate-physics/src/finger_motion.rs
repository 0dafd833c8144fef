//! Motion of fingers that drives move through linkages, equalities or tendons.

#[cfg(feature = "mujoco")]
use crate::ParallelJaw;
use crate::{Robot, RobotError};

/// Positions of drives and joints of a gripper as functions of its opening, measured in the model.
#[derive(Debug, Clone, PartialEq)]
pub struct FingerMotion {
    /// Names of the gripper's joints, in the model's order.
    pub joints: Vec<String>,
    /// Names of the joints that equalities couple to the drives, and that get a drive of their own.
    #[cfg(feature = "mujoco")]
    pub(crate) followers: Vec<String>,
    /// The measured states, from closed to open. At least two.
    pub(crate) states: Vec<FingerState>,
    /// Distance between the closed pads at the tool centre point, in metres.
    #[cfg(feature = "mujoco")]
    pub(crate) closed_at_tool_m: f64,
    /// Largest distance from the tool centre point to the fingertips, in metres.
    #[cfg(feature = "mujoco")]
    pub(crate) tip_m: f64,
}

/// A state of a gripper at rest.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FingerState {
    /// Distance between the pads, in metres.
    pub(crate) opening_m: f64,
    /// Distance between the pads along the y axis of the tool centre point, in metres. Only for pads that open like a V, between which
    /// that distance changes more than the smallest one.
    #[cfg(feature = "mujoco")]
    pub(crate) at_tool_m: Option<f64>,
    /// Position of each drive and each follower, in the model's unit.
    #[cfg(feature = "mujoco")]
    pub(crate) drives: Vec<f64>,
    /// Share of each of them in the opening: what the opening changes if it alone moves, by what it changes if all move together. The sum
    /// is 1. Joints that keep a pad parallel have a negative share.
    #[cfg(feature = "mujoco")]
    pub(crate) shares: Vec<f64>,
    /// Position of each joint, in the model's unit.
    pub(crate) joints: Vec<f64>,
}

#[cfg(feature = "mujoco")]
impl FingerState {
    /// Distance between the pads where they hold a part, in metres.
    pub(crate) fn held_m(&self) -> f64 {
        self.at_tool_m.unwrap_or(self.opening_m)
    }
}

/// What the position of a drive stands for.
#[cfg(feature = "mujoco")]
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DriveReading {
    /// The opening, in metres.
    pub(crate) opening_m: f64,
    /// The change of the distance between the pads, where they hold a part, by the drive's position.
    pub(crate) slope: f64,
}

impl FingerMotion {
    /// The motion of this robot's fingers. `None` without drives (`[[gripper.drive]]`), or in a build without MuJoCo.
    ///
    /// # Errors
    /// If the robot's model is invalid, or its fingers do not move from open to closed.
    #[cfg(feature = "mujoco")]
    pub fn of(robot: &Robot) -> Result<Option<Self>, RobotError> {
        match robot.settings.gripper.jaw() {
            Some(jaw) if !jaw.drives.is_empty() => crate::MujocoEngine::finger_motion_of(robot),
            _ => Ok(None),
        }
    }

    /// The motion of this robot's fingers. `None` without drives (`[[gripper.drive]]`), or in a build without MuJoCo.
    ///
    /// # Errors
    /// None in this build.
    #[cfg(not(feature = "mujoco"))]
    pub fn of(_: &Robot) -> Result<Option<Self>, RobotError> {
        Ok(None)
    }

    /// Positions of the joints at an opening (m), between the measured states.
    pub fn joints_at(&self, opening_m: f64) -> Vec<f64> {
        let (before, after, share) = self.between(|state| state.opening_m, opening_m);
        let share = share.clamp(0.0, 1.0);
        before.joints.iter().zip(&after.joints).map(|(a, b)| a + share * (b - a)).collect()
    }

    /// The opening that a drive's position stands for.
    #[cfg(feature = "mujoco")]
    pub(crate) fn reading(&self, drive: usize, position: f64) -> DriveReading {
        let (before, after, share) = self.between(|state| state.drives[drive], position);
        DriveReading {
            opening_m: before.opening_m + share * (after.opening_m - before.opening_m),
            slope: (after.held_m() - before.held_m()) / (after.drives[drive] - before.drives[drive]),
        }
    }

    /// The names of all drives, those of `jaw` and the followers.
    #[cfg(feature = "mujoco")]
    pub(crate) fn driven<'a>(&'a self, jaw: &'a ParallelJaw) -> impl Iterator<Item = &'a String> {
        jaw.drives.iter().map(|drive| &drive.moves).chain(&self.followers)
    }

    /// The shares of all drives at an opening (m).
    #[cfg(feature = "mujoco")]
    pub(crate) fn shares_at(&self, opening_m: f64) -> &[f64] {
        &self.between(|state| state.opening_m, opening_m).0.shares
    }

    /// The opening that all drives together stand for, in metres, from the opening of each.
    #[cfg(feature = "mujoco")]
    pub(crate) fn opening(&self, openings: &[f64]) -> f64 {
        openings.iter().zip(self.shares_at(openings[0])).map(|(opening, share)| opening * share).sum()
    }

    /// The part of the pads' force that each drive gives, from the opening (m) that each stands for and the servo of a finger. Every drive
    /// has the servo in its share, and so holds its joint where the others are: the equality that couples them carries little.
    #[cfg(feature = "mujoco")]
    pub(crate) fn forces(&self, openings: &[f64], servo: impl Fn(f64) -> f64) -> Vec<f64> {
        let shares = self.shares_at(openings[0]);
        let own = openings.iter().zip(shares).map(|(opening, share)| share.abs() * servo(*opening));
        if shares.iter().all(|share| *share >= 0.0) {
            return own.collect();
        }
        // A joint with a negative share gives its part of the force with the other sign, and is held where the others are all the same.
        let size: f64 = shares.iter().map(|share| share.abs()).sum();
        let among = openings.iter().zip(shares).map(|(opening, share)| opening * share.abs() / size).sum();
        let [together, among] = [servo(self.opening(openings)), servo(among)];
        own.zip(shares).map(|(own, share)| own + share * together - share.abs() * among).collect()
    }

    /// The largest share of a drive, as an absolute value.
    #[cfg(feature = "mujoco")]
    pub(crate) fn largest_share(&self, drive: usize) -> f64 {
        self.states.iter().map(|state| state.shares[drive].abs()).fold(0.0, f64::max)
    }

    /// The two neighbouring states around a value, and its share of the way from the first to the second: outside of 0 to 1
    /// beyond the ends.
    fn between(&self, of: impl Fn(&FingerState) -> f64, value: f64) -> (&FingerState, &FingerState, f64) {
        let last = self.states.len() - 1;
        let direction = (of(&self.states[last]) - of(&self.states[0])).signum();
        let after = (1..last).find(|k| direction * (of(&self.states[*k]) - value) >= 0.0).unwrap_or(last);
        let (before, after) = (&self.states[after - 1], &self.states[after]);
        (before, after, (value - of(before)) / (of(after) - of(before)))
    }

    /// Opening of the closed gripper, in metres.
    #[cfg(feature = "mujoco")]
    pub(crate) fn narrowest_m(&self) -> f64 {
        self.states[0].opening_m
    }

    /// The open gripper.
    #[cfg(feature = "mujoco")]
    pub(crate) fn open(&self) -> &FingerState {
        &self.states[self.states.len() - 1]
    }

    /// Largest change of the opening by a drive's position, as an absolute value.
    #[cfg(feature = "mujoco")]
    pub(crate) fn steepest(&self, drive: usize) -> f64 {
        let slope = |pair: &[FingerState]| {
            (pair[1].held_m() - pair[0].held_m()) / (pair[1].drives[drive] - pair[0].drives[drive])
        };
        self.states.windows(2).map(|pair| slope(pair).abs()).fold(0.0, f64::max)
    }
}

#[cfg(all(test, feature = "mujoco"))]
mod tests {
    use super::*;

    fn motion() -> FingerMotion {
        let state = |opening_m: f64, drive: f64, joint: f64| FingerState {
            opening_m,
            at_tool_m: None,
            drives: vec![drive],
            shares: vec![1.0],
            joints: vec![joint, -joint],
        };
        FingerMotion {
            joints: vec!["left".to_owned(), "right".to_owned()],
            followers: Vec::new(),
            closed_at_tool_m: 0.0,
            states: vec![state(0.0, 0.8, 0.8), state(0.03, 0.5, 0.5), state(0.08, 0.0, 0.0)],
            tip_m: 0.01,
        }
    }

    #[test]
    fn openings_invert_joint_positions() {
        let motion = motion();
        for (opening, joint) in [(0.0, 0.8), (0.015, 0.65), (0.055, 0.25), (0.08, 0.0), (0.2, 0.0)] {
            let joints = motion.joints_at(opening);
            assert!((joints[0] - joint).abs() < 1e-12 && (joints[1] + joint).abs() < 1e-12, "{opening}: {joints:?}");
        }
    }

    #[test]
    fn drive_positions_give_openings() {
        let motion = motion();
        for (position, opening, slope) in
            [(0.65, 0.015, -0.1), (0.25, 0.055, -0.1), (-0.1, 0.09, -0.1), (0.9, -0.01, -0.1)]
        {
            let reading = motion.reading(0, position);
            assert!(
                (reading.opening_m - opening).abs() < 1e-12 && (reading.slope - slope).abs() < 1e-12,
                "{reading:?}"
            );
        }
        assert!((motion.steepest(0) - 0.1).abs() < 1e-12 && motion.narrowest_m() == 0.0);
    }
}
