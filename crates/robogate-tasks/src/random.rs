//! A random policy, as a lower bound of a ranking.

use robogate_core::{Action, Command, Fault, Observation, Policy, Seed, Stream, TaskInstance, TaskSpec};

/// A policy that samples every number of an action uniformly within the bounds of the task: the numbers of a vector, or
/// the six of a tool delta, and one for the gripper, which opens above 0. The samples depend only on the episode's
/// seed.
#[derive(Debug, Clone)]
pub struct Random {
    stream: Stream,
    bounds: Bounds,
    /// Whether the task has a gripper.
    gripper: bool,
}

/// The bounds of the sampled actions.
#[derive(Debug, Clone, PartialEq)]
enum Bounds {
    /// Numbers within these bounds.
    Vector { low: Vec<f64>, high: Vec<f64> },
    /// Tool motions up to these limits, in metres and radians.
    ToolDelta { translation_m: f64, rotation_rad: f64 },
}

impl Bounds {
    fn of(task: &TaskSpec) -> Result<Self, String> {
        if let Some((low, high)) = task.action.vector() {
            return Ok(Self::Vector { low: low.to_vec(), high: high.to_vec() });
        }
        let (translation_m, rotation_rad) = task.action.tool_delta().ok_or_else(|| {
            format!(
                "the random policy needs bounded actions: vector or tool_delta; {} takes {}",
                task.name,
                task.action.kinds()
            )
        })?;
        Ok(Self::ToolDelta { translation_m, rotation_rad })
    }
}

impl Random {
    /// Creates a random policy. Each episode has different samples.
    pub fn new() -> Self {
        Self {
            stream: stream(Seed::campaign(0)),
            bounds: Bounds::Vector { low: Vec::new(), high: Vec::new() },
            gripper: false,
        }
    }
}

impl Default for Random {
    fn default() -> Self {
        Self::new()
    }
}

impl Policy for Random {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        Bounds::of(task).map(drop)
    }

    fn reset(&mut self, task: &TaskSpec, _: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.bounds = Bounds::of(task).map_err(|why| Fault::new(robogate_core::FaultKind::BadAction, why))?;
        self.gripper = task.action.gripper.is_some();
        self.stream = stream(seed);
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        let stream = &mut self.stream;
        let mut draw = |scale: f64| scale * (2.0 * stream.uniform() - 1.0);
        let command = match &self.bounds {
            Bounds::Vector { low, high } => {
                let middle = |(low, high): (&f64, &f64)| 0.5 * (low + high) + draw(0.5 * (high - low));
                Command::Vector(low.iter().zip(high).map(middle).collect())
            }
            Bounds::ToolDelta { translation_m, rotation_rad } => Command::ToolDelta {
                translation_m: std::array::from_fn(|_| draw(*translation_m)),
                rotation_rad: std::array::from_fn(|_| draw(*rotation_rad)),
            },
        };
        let gripper = self.gripper.then(|| if draw(1.0) > 0.0 { Action::OPEN } else { Action::CLOSE });
        Ok(Action { command, gripper, phase: None })
    }
}

fn stream(seed: Seed) -> Stream {
    seed.stream("random policy")
}

#[cfg(test)]
mod tests {
    use robogate_physics::built_in_robot;

    use super::*;
    use crate::pick_place::spec::spec;

    fn episode(task: &TaskSpec, seed: Seed) -> Vec<Action> {
        let mut policy = Random::new();
        policy.reset(task, &TaskInstance::default(), seed).unwrap();
        (0..500).map(|_| policy.act(&Observation::default()).unwrap()).collect()
    }

    fn arm() -> TaskSpec {
        spec(&built_in_robot("franka").unwrap(), Vec::new(), &crate::pick_place::PickPlace::DEFAULT)
    }

    #[test]
    fn tool_deltas_fill_their_range() {
        let actions = episode(&arm(), Seed::campaign(3).episode(1));
        let x: Vec<f64> = actions
            .iter()
            .map(|action| match action.command {
                Command::ToolDelta { translation_m: [x, ..], .. } => x / 0.02,
                _ => f64::NAN,
            })
            .collect();
        let (mean, square) = (x.iter().sum::<f64>() / 500.0, x.iter().map(|x| x * x).sum::<f64>() / 500.0);
        // The tolerance is four standard errors of the mean (1/sqrt(3)) and of the mean square (1/3 with standard
        // deviation 0.298).
        assert!(mean.abs() < 0.103 && (square - 1.0 / 3.0).abs() < 0.053, "{mean} {square}");
        let open = actions.iter().filter(|action| action.gripper == Some(Action::OPEN)).count();
        assert!((205..=295).contains(&open), "{open}");
    }

    #[test]
    fn vectors_keep_their_bounds() {
        let mut task = arm();
        let (low, high) = (vec![-1.0, 2.0], vec![1.0, 5.0]);
        let names = vec!["a".to_owned(), "b".to_owned()];
        task.action.spaces = vec![robogate_core::ActionSpace::Vector { names, low, high }];
        task.action.gripper = None;
        let actions = episode(&task, Seed::campaign(3).episode(1));
        assert!(actions.iter().all(|action| task.check_action(action).is_ok()));
    }

    #[test]
    fn unbounded_actions_are_rejected() {
        let mut task = arm();
        task.action.spaces.truncate(1);
        assert!(Random::new().check(&task).unwrap_err().contains("joint_position"));
    }

    #[test]
    fn draws_depend_on_the_seed() {
        let seed = |n| Seed::campaign(3).episode(n);
        assert_eq!(episode(&arm(), seed(1)), episode(&arm(), seed(1)));
        assert_ne!(episode(&arm(), seed(1)), episode(&arm(), seed(2)));
    }
}
