//! Benchmark: processor time that episodes save because the scripted controller says when it has given up.
//!
//! `cargo bench -p robogate-tasks --bench giving_up [-- EPISODES]`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints its results and fails by panicking")]

use std::fs;
use std::sync::Arc;

use robogate_core::{
    Action, Fault, Observation, ParameterSpace, Policy, Sampler, Scenario, Seed, TaskInstance, TaskSpec, rollout,
    samplers,
};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

/// The scripted controller without the statement that it has given up.
struct Silent(Scripted);

impl Policy for Silent {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.0.check(task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.0.reset(task, instance, seed)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.0.act(observation)
    }
}

fn main() {
    let episodes: usize = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(300);
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    let design = samplers::Uniform.design(&space, episodes, Seed::campaign(1).stream("bench")).unwrap();
    let robot = built_in_robot("franka").unwrap();
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    let speaking = Scripted::new(robot, engine.chain().clone());
    let mut policies: [Box<dyn Policy>; 2] = [Box::new(Silent(speaking.clone())), Box::new(speaking)];
    let mut cell = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let (mut seconds, mut simulated) = ([0.0; 2], [0.0; 2]);
    let mut differ = 0;
    for i in 0..episodes {
        let index = i as u64;
        let requested = design.assignment(i).unwrap();
        let scenario = Scenario { index, seed: Seed::campaign(1).episode(index), requested };
        // Alternating, so that both run under the same machine load.
        let mut outcomes = Vec::new();
        for (k, policy) in policies.iter_mut().enumerate() {
            let begun = processor_s();
            let episode = rollout(&mut cell, &mut **policy, &scenario);
            seconds[k] += processor_s() - begun;
            simulated[k] += 0.05 * f64::from(episode.ticks);
            outcomes.push((episode.outcome, episode.time_s.to_bits()));
        }
        differ += usize::from(outcomes[0] != outcomes[1]);
    }
    for (name, k) in [("silent", 0), ("giving up", 1)] {
        let each = 1e3 * seconds[k] / episodes as f64;
        println!(
            "{name}: {each:.1} ms of processor time and {:.2} simulated s for each episode",
            simulated[k] / episodes as f64
        );
    }
    println!("{:.2} x the episodes per second of processor time", seconds[0] / seconds[1]);
    println!("{differ} of {episodes} episodes have another outcome or time");
}

/// Processor time of this thread, in seconds.
fn processor_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-9
}
