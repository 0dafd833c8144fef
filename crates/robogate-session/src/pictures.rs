//! Whether the cameras of an environment show anything: one colour everywhere, or always the same picture, is no observation.

use robogate_core::{Environment, Fault, Image, Policy, Scenario};
use robogate_tasks::Random;

/// Number of control periods with random actions after which the pictures are compared.
const PERIODS: usize = 20;

/// Problems of the cameras in an episode with random actions, in sentences. Empty for an environment that ends the episode first, as
/// far as its pictures could not be compared.
///
/// # Errors
/// An environment that cannot be reset or that renders nothing.
pub fn picture_problems(environment: &mut dyn Environment, scenario: &Scenario) -> Result<Vec<String>, Fault> {
    let start = environment.reset(scenario)?;
    let first = environment.render()?;
    let mut problems: Vec<String> = first.iter().filter_map(one_colour).collect();
    let (task, mut policy) = (environment.task().clone(), Random::new());
    if !problems.is_empty() || policy.check(&task).is_err() {
        return Ok(problems);
    }
    policy.reset(&task, &start.instance, scenario.seed)?;
    let (mut observation, mut states) = (start.observation, Vec::new());
    for _ in 0..PERIODS {
        let step = environment.step(&policy.act(&observation)?)?;
        if step.ending.is_some() {
            return Ok(problems);
        }
        states.push(step.state_hash);
        observation = step.observation;
    }
    let moves = states.windows(2).any(|pair| pair[0] != pair[1]);
    if moves && !first.is_empty() && environment.render()? == first {
        let names: Vec<&str> = first.iter().map(|image| &*image.camera).collect();
        problems.push(format!(
            "the cameras {} show the same picture after {PERIODS} control periods with random actions, although the state changed: the \
             frames are stale, or no camera sees what moves",
            names.join(", ")
        ));
    }
    Ok(problems)
}

/// The problem of an image with one colour. `None` if it has several.
fn one_colour(image: &Image) -> Option<String> {
    let colour = image.rgb.first_chunk::<3>()?;
    image.rgb.chunks_exact(3).all(|pixel| pixel == colour).then(|| {
        let [red, green, blue] = colour;
        format!(
            "the camera {} shows one colour everywhere (red {red}, green {green}, blue {blue}): it is not rendered, or it sees nothing. \
             Without a display, set MUJOCO_GL=egl",
            image.camera
        )
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use robogate_core::{Action, Assignment, Observation, Seed, Start, Step, TaskInstance, TaskSpec};

    use super::*;

    /// An environment whose camera shows the number of control periods, up to a limit.
    struct Counting {
        task: Arc<TaskSpec>,
        periods: u8,
        seen: u8,
        base: [u8; 3],
    }

    impl Environment for Counting {
        fn task(&self) -> &Arc<TaskSpec> {
            &self.task
        }

        fn reset(&mut self, _: &Scenario) -> Result<Start, Fault> {
            self.periods = 0;
            let (instance, observation) = (TaskInstance::default(), Observation::default());
            Ok(Start { instance, observation, applied: Assignment::default() })
        }

        fn step(&mut self, _: &Action) -> Result<Step, Fault> {
            self.periods += 1;
            let measures = Default::default();
            let state_hash = u64::from(self.periods);
            Ok(Step { observation: Observation::default(), measures, ending: None, events: Vec::new(), state_hash })
        }

        fn render(&mut self) -> Result<Vec<Image>, Fault> {
            let shown = self.periods.min(self.seen);
            let rgb = [self.base, [shown, 0, 0]].concat();
            Ok(vec![Image { camera: "front".to_owned(), width: 2, height: 1, rgb }])
        }
    }

    fn problems(seen: u8, base: [u8; 3]) -> Vec<String> {
        // Random actions can drive it.
        let task = crate::registry::TASKS.first().unwrap().task();
        let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() };
        picture_problems(&mut Counting { task, periods: 0, seen, base }, &scenario).unwrap()
    }

    #[test]
    fn stale_and_empty_pictures_are_named() {
        assert_eq!(problems(255, [9, 9, 9]), Vec::<String>::new());
        assert!(problems(0, [9, 9, 9])[0].contains("the cameras front show the same picture"));
        assert!(problems(255, [0, 0, 0])[0].contains("front shows one colour everywhere (red 0, green 0, blue 0)"));
    }
}
