//! A random policy: the lower bound of a ranking.

use robogate_core::{Action, ArmCommand, Fault, GripperCommand, Observation, Policy, Seed, Stream, TaskSpec};

/// Largest translation and rotation of an action along and about each axis, in metres and radians (paper, section 7.1).
const TRANSLATION_M: f64 = 0.02;
const ROTATION_RAD: f64 = 0.05;

/// Draws the seven numbers of an action uniformly from -1 to 1: six of a tool delta, and one for the gripper, which opens
/// above 0. The draws depend on the episode's seed only.
#[derive(Debug, Clone)]
pub struct Random {
    stream: Stream,
}

impl Random {
    /// A random policy. Each episode has its own draws.
    pub fn new() -> Self {
        Self { stream: stream(Seed::campaign(0)) }
    }
}

impl Default for Random {
    fn default() -> Self {
        Self::new()
    }
}

impl Policy for Random {
    fn reset(&mut self, _: &TaskSpec, seed: Seed) -> Result<(), Fault> {
        self.stream = stream(seed);
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        let mut draw = |scale: f64| scale * (2.0 * self.stream.uniform() - 1.0);
        let translation_m = std::array::from_fn(|_| draw(TRANSLATION_M));
        let rotation_rad = std::array::from_fn(|_| draw(ROTATION_RAD));
        let gripper = if draw(1.0) > 0.0 { GripperCommand::Open } else { GripperCommand::Close };
        Ok(Action { arm: ArmCommand::ToolDelta { translation_m, rotation_rad }, gripper, phase: None })
    }
}

fn stream(seed: Seed) -> Stream {
    seed.stream("random policy")
}

#[cfg(test)]
mod tests {
    use robogate_core::Pose;

    use super::*;

    fn episode(seed: Seed) -> Vec<Action> {
        let task = TaskSpec {
            instruction: String::new(),
            control_period_s: 0.05,
            time_limit_s: 10.0,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: Pose::IDENTITY,
            target_pose: Pose::IDENTITY,
            tolerance_m: 0.05,
            approach_speed_m_s: None,
        };
        let observation = Observation {
            time_s: 0.0,
            joint_positions: vec![0.0; 7],
            joint_velocities: vec![0.0; 7],
            gripper_opening_m: Some(0.08),
            tool_pose: Pose::IDENTITY,
            images: Vec::new(),
        };
        let mut policy = Random::new();
        policy.reset(&task, seed).unwrap();
        (0..500).map(|_| policy.act(&observation).unwrap()).collect()
    }

    #[test]
    fn draws_are_uniform() {
        let actions = episode(Seed::campaign(3).episode(1));
        let x: Vec<f64> = actions
            .iter()
            .map(|action| match action.arm {
                ArmCommand::ToolDelta { translation_m: [x, ..], .. } => x / TRANSLATION_M,
                ArmCommand::JointPositions(_) => f64::NAN,
            })
            .collect();
        let (mean, square) = (x.iter().sum::<f64>() / 500.0, x.iter().map(|x| x * x).sum::<f64>() / 500.0);
        // Four standard errors of the mean (1/sqrt(3)) and of the mean square (1/3 with deviation 0.298).
        assert!(mean.abs() < 0.103 && (square - 1.0 / 3.0).abs() < 0.053, "{mean} {square}");
        let open = actions.iter().filter(|action| action.gripper == GripperCommand::Open).count();
        assert!((205..=295).contains(&open), "{open}");
    }

    #[test]
    fn draws_depend_on_the_seed() {
        let seed = |n| Seed::campaign(3).episode(n);
        assert_eq!(episode(seed(1)), episode(seed(1)));
        assert_ne!(episode(seed(1)), episode(seed(2)));
    }
}
