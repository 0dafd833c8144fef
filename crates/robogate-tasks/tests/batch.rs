//! Tests that built-in tasks in a batch give the episodes of the single loop, bit for bit.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use robogate_core::latency::{Execution, ExecutionMode, Latency, with_latency};
use robogate_core::{
    Environment, Episode, ParameterSpace, Policy, Sampler, Scenario, Seed, SingleEnvironments, SinglePolicies, rollout,
    rollout_all, samplers,
};
use robogate_physics::{Engine, MujocoEngine, Robot, built_in_robot};
use robogate_tasks::SelfContained;
use robogate_tasks::pendulum::Pendulum;
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

type Pair = (Box<dyn Environment>, Box<dyn Policy>);

/// Compares 64 episodes in this many slots with single ones, and returns them.
fn compare(space: &str, slots: usize, pair: &dyn Fn() -> Pair) -> Vec<Episode> {
    let space = Arc::new(ParameterSpace::from_toml(space).unwrap());
    let design = samplers::Uniform.design(&space, 64, Seed::campaign(3).stream("batch")).unwrap();
    let scenario = |i: usize| {
        let index = i as u64;
        Scenario { index, seed: Seed::campaign(3).episode(index), requested: design.assignment(i).unwrap() }
    };
    let scenarios: Vec<Scenario> = (0..design.len()).map(scenario).collect();
    let (mut environment, mut policy) = pair();
    let single: Vec<Episode> =
        scenarios.iter().map(|scenario| rollout(&mut *environment, &mut *policy, scenario)).collect();
    let (environments, policies) = (0..slots).map(|_| pair()).unzip();
    let mut environments = SingleEnvironments::new(environments).unwrap();
    let batch = rollout_all(&mut environments, &mut SinglePolicies::new(policies), &scenarios);
    for (single, batch) in single.iter().zip(&batch) {
        assert_eq!(batch, single);
    }
    assert_eq!(batch.len(), single.len());
    batch
}

/// Whether slots become free at different times.
fn differ_in_length(episodes: &[Episode]) -> bool {
    episodes.iter().any(|episode| episode.ticks != episodes[0].ticks)
}

#[test]
fn pendulums_in_a_batch_equal_single_ones() {
    let episodes = compare(Pendulum::DEFAULT.space(), 64, &|| {
        (Pendulum::DEFAULT.environment().unwrap(), Pendulum::DEFAULT.controller())
    });
    assert!(differ_in_length(&episodes));
}

#[test]
fn delayed_pendulums_in_a_batch_equal_single_ones() {
    let episodes = compare(Pendulum::DEFAULT.space(), 10, &|| {
        let latency = Latency::Gamma { mean_s: 0.08, sd_s: 0.05 };
        let execution = Execution { latency, mode: ExecutionMode::Queue };
        with_latency(Pendulum::DEFAULT.environment().unwrap(), Pendulum::DEFAULT.controller(), execution)
    });
    assert!(episodes.iter().all(|episode| episode.draws.get("inference_latency_mean_s").is_some()));
}

fn robot() -> Robot {
    built_in_robot("franka").unwrap()
}

#[test]
fn pick_and_place_in_a_batch_equals_single_episodes() {
    let episodes = compare(FRANKA_SPACE, 16, &|| {
        let engine = MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap();
        let policy = Scripted::new(robot(), engine.chain().clone());
        (Box::new(PickPlace::default().on(Box::new(engine), Rig::default()).unwrap()), Box::new(policy))
    });
    assert!(differ_in_length(&episodes));
}
