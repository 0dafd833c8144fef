//! Benchmark: processor time of the conditions of a task from a file, as a share of the time of its episodes, within one run.
//!
//! `cargo bench -p robogate-tasks --bench conditions [-- EPISODES]`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark prints its results and fails by panicking")]

use std::fs;
use std::hint::black_box;

use robogate_core::{Assignment, Scenario, Seed, rollout};
use robogate_physics::{Engine, MujocoEngine, built_in_robot};
use robogate_tasks::file::FileTask;
use robogate_tasks::{ArmDeclaration, ArmTask, Rig};

const DRAWER: &str = include_str!("../../../assets/tasks/drawer/task.toml");

fn main() {
    let episodes: u64 = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(20);
    // Both run to the time limit. One has failures, stages and measures.
    let success = DRAWER.find("[success]").unwrap();
    let (head, rest) = DRAWER.split_at(success);
    let all = format!("{head}[success]\nwhen = \"joint(drawer) > 20 cm and {}", rest.split_once("and ").unwrap().1);
    let expert = DRAWER.split_at(DRAWER.find("[expert]").unwrap()).1;
    let none = format!("{head}[success]\nwhen = \"time() > 60 s\"\n{expert}");
    let mut seconds = [0.0; 2];
    for index in 0..episodes {
        for at in 0..2 {
            let which = (index as usize + at) % 2;
            seconds[which] += run([&all, &none][which], index);
        }
    }
    let [all, none] = seconds;
    println!("conditions of the drawer: {:.1} % of the time of an episode", 100.0 * (all - none) / all);
}

/// Processor time of an episode, in seconds.
fn run(text: &str, index: u64) -> f64 {
    let task = FileTask::read(text).unwrap();
    let robot = built_in_robot("franka").unwrap();
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    let mut expert = task.controller(robot, engine.chain().clone());
    let mut environment = task.on(Box::new(engine), Rig::default()).unwrap();
    let scenario = Scenario { index, seed: Seed::campaign(1).episode(index), requested: Assignment::default() };
    let begun = processor_s();
    let episode = black_box(rollout(&mut environment, &mut *expert, &scenario));
    assert!((episode.time_s - 20.0).abs() < 1e-9, "{:?} at {} s", episode.outcome, episode.time_s);
    processor_s() - begun
}

/// Processor time of this thread, in seconds.
fn processor_s() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    1e-9 * text.split(' ').next().unwrap().parse::<f64>().unwrap()
}
