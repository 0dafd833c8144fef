//! What a picture costs.
//!
//! `cargo bench -p robogate-sim --bench camera [-- FOLDER]` prints milliseconds a picture of both cameras over the scenarios
//! of the industrial suite's kinds, and writes the pictures as PPM into the folder.
#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a program that prints what it measures")]

use std::time::SystemTime;

use robogate_core::{Assignment, Scenario, Seed, Simulator, Value};
use robogate_sim::{MujocoEngine, PickPlace, built_in_robot};

fn main() {
    let folder = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    for robot in ["franka", "ur5e"] {
        let engine = MujocoEngine::new(built_in_robot(robot).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
        let mut cell = PickPlace::new(engine, None).unwrap();
        for (name, settings) in scenes() {
            let mut requested = Assignment::default();
            for (parameter, value) in settings {
                requested.set(parameter, value);
            }
            cell.reset(&Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested }).unwrap();
            let images = cell.render().unwrap();
            let mut times: Vec<f64> = (0..30)
                .map(|_| {
                    let start = busy();
                    cell.render().unwrap();
                    (busy() - start) * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("{robot:<8} {name:<12} two pictures: median {:.2} ms, least {:.2} ms", times[15], times[0]);
            if let Some(folder) = &folder {
                for image in images {
                    let mut bytes = format!("P6 {} {} 255\n", image.width, image.height).into_bytes();
                    bytes.extend(&image.rgb);
                    std::fs::write(format!("{folder}/{robot}-{name}-{}.ppm", image.camera), bytes).unwrap();
                }
            }
        }
    }
}

/// Seconds that this process has been on a processor, so that others who use the machine do not count; where the system
/// does not say, the time of day.
fn busy() -> f64 {
    let nanoseconds = std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    let clock = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    nanoseconds.map_or_else(clock, |nanoseconds| nanoseconds * 1e-9)
}

fn scenes() -> Vec<(&'static str, Vec<(&'static str, Value)>)> {
    let word = |word: &'static str| Value::Category(word.into());
    vec![
        ("plain", vec![]),
        ("steel", vec![("table_material", word("steel")), ("shape", word("cylinder"))]),
        ("laminate", vec![("table_material", word("laminate")), ("shape", word("sphere"))]),
        ("rubber", vec![("table_material", word("rubber")), ("shape", word("L_shape"))]),
        ("cardboard", vec![("table_material", word("cardboard")), ("shape", word("irregular"))]),
        (
            "crowded",
            vec![
                ("obstacles", Value::Integer(5)),
                ("occluders", Value::Integer(3)),
                ("disturbance_speed_m_s", Value::Number(0.2)),
                ("object_transparency", Value::Number(0.7)),
            ],
        ),
    ]
}
