//! Benchmark: cost of an episode in each engine, as a ratio within one run.
//!
//! `cargo bench -p robogate-tasks --bench engines [-- EPISODES]`
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints its results and fails by panicking")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use robogate_core::{Environment, ParameterSpace, Policy, Sampler, Scenario, Seed, rollout, samplers};
use robogate_physics::{Engine, MujocoEngine, RapierEngine, Robot, built_in_robot};
use robogate_tasks::pick_place::{FRANKA_SPACE, PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

fn main() {
    let episodes: usize = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(100);
    let space = Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap());
    let design = samplers::Uniform.design(&space, episodes, Seed::campaign(1).stream("bench")).unwrap();
    let mut mujoco = bench(MujocoEngine::new(robot(), MujocoEngine::TIME_STEP_S).unwrap());
    let mut rapier = bench(RapierEngine::new(robot(), RapierEngine::TIME_STEP_S).unwrap());
    let mut took = [Duration::ZERO; 2];
    let mut simulated = [0.0; 2];
    for i in 0..episodes {
        let index = i as u64;
        let requested = design.assignment(i).unwrap();
        let scenario = Scenario { index, seed: Seed::campaign(1).episode(index), requested };
        // Alternating, so that both engines run under the same machine load.
        for (k, (simulator, policy)) in [&mut mujoco, &mut rapier].into_iter().enumerate() {
            let start = Instant::now();
            simulated[k] += rollout(&mut **simulator, &mut **policy, &scenario).time_s;
            took[k] += start.elapsed();
        }
    }
    let per_second = took.map(|took| episodes as f64 / took.as_secs_f64());
    for (name, k) in [("MuJoCo", 0), ("Rapier", 1)] {
        let times = simulated[k] / took[k].as_secs_f64();
        println!("{name} {:.1} Franka episodes/s, {times:.0} x real time", per_second[k]);
    }
    println!("an episode in Rapier costs {:.2} x one in MuJoCo", per_second[0] / per_second[1]);
}

fn robot() -> Robot {
    built_in_robot("franka").unwrap()
}

fn bench<E: Engine + 'static>(engine: E) -> (Box<dyn Environment>, Box<dyn Policy>) {
    let policy = Scripted::new(robot(), engine.chain().clone());
    (Box::new(PickPlace::default().on(Box::new(engine), Rig::default()).unwrap()), Box::new(policy))
}
