//! Benchmark: cost of an image with MuJoCo's renderer.
//!
//! `cargo bench -p robogate-tasks --features egl --bench egl` prints processor milliseconds over all threads of the
//! process: per image (mean of front and wrist, 256 x 256 pixels), and for the first two images of an episode, which
//! upload the scene to the device.
#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results")]

use robogate_camera::EglRenderer;
use robogate_core::{Assignment, Environment, Scenario, Seed, Value};
use robogate_physics::{MujocoEngine, built_in_robot};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmTask, Rig};

fn main() {
    let crowded = vec![
        ("obstacles", Value::Integer(5)),
        ("occluders", Value::Integer(3)),
        ("disturbance_speed_m_s", Value::Number(0.2)),
        ("object_transparency", Value::Number(0.7)),
    ];
    println!("robot    scene      ms a picture   ms an episode's first two");
    for robot in ["franka", "ur5e"] {
        for (label, settings) in [("plain", vec![]), ("crowded", crowded.clone())] {
            let engine = MujocoEngine::new(built_in_robot(robot).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
            let renderer = EglRenderer::new(&engine).unwrap();
            let device = renderer.device().to_owned();
            let mut cell = PickPlace::default()
                .on(Box::new(engine), Rig { renderer: Some(Box::new(renderer)), ..Rig::default() })
                .unwrap();
            let mut requested = Assignment::default();
            settings.into_iter().for_each(|(name, value)| requested.set(name, value));
            let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
            let mut first = || {
                cell.reset(&scenario).unwrap();
                milliseconds(|| drop(cell.render().unwrap()))
            };
            first();
            let first = (first() + first() + first()) / 3.0;
            let picture = milliseconds(|| (0..20).for_each(|_| drop(cell.render().unwrap()))) / 40.0;
            println!("{robot:<8} {label:<8} {picture:>14.1} {first:>26.0}   {device}");
        }
    }
}

/// Processor time of all threads in milliseconds. The system's resolution is 10 ms.
fn milliseconds(work: impl FnOnce()) -> f64 {
    let busy = || {
        let text = std::fs::read_to_string("/proc/self/stat").unwrap();
        // The name in brackets may contain spaces; user and system time are fields 12 and 13 after it.
        let fields = text.rsplit(')').next().unwrap().split_whitespace();
        fields.skip(11).take(2).map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>() * 10.0
    };
    let start = busy();
    work();
    busy() - start
}
