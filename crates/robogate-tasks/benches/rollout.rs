//! Benchmark: processor time of an episode in the state machine, as a ratio to a plain loop over the same environment and
//! policy within one run.
//!
//! `cargo bench -p robogate-tasks --bench rollout [-- EPISODES]`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints its results and fails by panicking")]

use std::fs;
use std::hint::black_box;
use std::sync::Arc;

use robogate_core::{
    Environment, GAVE_UP, Observation, ParameterSpace, Policy, Sampler, Scenario, Seed, SingleEnvironments,
    SinglePolicies, Start, check_applied, rollout, rollout_all, samplers,
};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::SelfContained;
use robogate_tasks::pendulum::Pendulum;
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

type Pair = (Box<dyn Environment>, Box<dyn Policy>);

fn main() {
    let episodes: usize = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(300);
    let robot = built_in_robot("franka").unwrap();
    compare("pick_place", FRANKA_SPACE, episodes, &|| {
        let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
        let policy = Scripted::new(robot.clone(), engine.chain().clone());
        (Box::new(PickPlace::default().on(Box::new(engine), Rig::default()).unwrap()), Box::new(policy))
    });
    compare("pendulum", Pendulum::DEFAULT.space(), episodes, &|| {
        (Pendulum::DEFAULT.environment().unwrap(), Pendulum::DEFAULT.controller())
    });
}

fn compare(name: &str, space: &str, episodes: usize, pair: &dyn Fn() -> Pair) {
    let space = Arc::new(ParameterSpace::from_toml(space).unwrap());
    let design = samplers::Uniform.design(&space, episodes, Seed::campaign(1).stream("bench")).unwrap();
    let (mut environment, mut policy) = pair();
    let (of_batch, its_policy) = pair();
    let mut batch = SingleEnvironments::new(vec![of_batch]).unwrap();
    let mut its_policies = SinglePolicies::new(vec![its_policy]);
    let mut seconds = [0.0; 3];
    for i in 0..episodes {
        let index = i as u64;
        let scenario =
            Scenario { index, seed: Seed::campaign(1).episode(index), requested: design.assignment(i).unwrap() };
        // Alternating, so that all run under the same machine load, and each first in turn.
        for at in 0..3 {
            let which = (i + at) % 3;
            let begun = processor_s();
            match which {
                0 => plain(&mut *environment, &mut *policy, &scenario),
                1 => drop(black_box(rollout(&mut *environment, &mut *policy, &scenario))),
                _ => drop(black_box(rollout_all(&mut batch, &mut its_policies, std::slice::from_ref(&scenario)))),
            }
            seconds[which] += processor_s() - begun;
        }
    }
    let [plain, single, batch] = seconds.map(|seconds| 1e3 * seconds / episodes as f64);
    println!("{name}: {plain:.3} ms of processor time for each episode in a plain loop");
    println!("{name}: state machine {:.4} x, batch with one slot {:.4} x", single / plain, batch / plain);
}

/// An episode in a plain loop with the same checks and the same record.
fn plain(environment: &mut dyn Environment, policy: &mut dyn Policy, scenario: &Scenario) {
    let task = Arc::clone(environment.task());
    let Start { instance, mut observation, applied } = environment.reset(scenario).unwrap();
    check_applied(&scenario.requested, &applied).unwrap();
    let draws = environment.draws(scenario).unwrap();
    policy.reset(&task, &instance, scenario.seed).unwrap();
    let limit = task.limit_ticks().unwrap();
    let records_giving_up = task.measure(GAVE_UP.as_str()).is_some();
    let (mut gave_up_s, mut hash, mut last) = (None, 0_u64, None);
    for _ in 0..limit {
        if policy.wants_images() {
            observation.images = environment.render().unwrap();
        }
        let action = policy.act(&observation).unwrap();
        task.check_action(&action).unwrap();
        let mut step = environment.step(&action).unwrap();
        if gave_up_s.is_none() && policy.gave_up() {
            gave_up_s = Some(observation.time_s);
            step.events.push("policy gave up".to_owned());
        }
        if records_giving_up {
            step.measures.set(GAVE_UP, gave_up_s);
        }
        let foregone = if gave_up_s.is_some() { environment.foregone_ending() } else { None };
        hash = hash.rotate_left(23).wrapping_add(step.state_hash);
        let ended = step.ending.is_some() || foregone.is_some();
        last = Some((step.measures, step.ending.or(foregone), action.phase));
        if ended {
            break;
        }
        observation = step.observation;
    }
    black_box::<(_, _, _, _, &Observation)>((draws, hash, last, applied, &observation));
}

/// Processor time of this thread, in seconds.
fn processor_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-9
}
