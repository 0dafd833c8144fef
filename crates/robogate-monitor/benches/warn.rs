//! Measures the cost of a warner in one robot: the figures of docs/results/warn.md.
//!
//! `cargo bench -p robogate-monitor --bench warn`
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a measurement that fails ends")]
#![expect(clippy::print_stdout, reason = "it prints what it measured")]

use std::hint::black_box;
use std::time::Instant;

use robogate_core::{Seed, SignalGroup, SignalKind, Signals};
use robogate_monitor::warn::{Features, Track, Warner, train};

/// The numbers of a seven-axis arm with joints, velocities, pose of the tool, gripper and joint commands.
const GROUPS: [(&str, SignalKind, usize); 6] = [
    ("joint_positions", SignalKind::Observation, 7),
    ("joint_velocities", SignalKind::Observation, 7),
    ("tool_pose", SignalKind::Observation, 7),
    ("gripper_opening", SignalKind::Observation, 1),
    ("joint_position", SignalKind::Command, 7),
    ("gripper", SignalKind::Gripper, 1),
];
const WIDTH: usize = 30;
const TICKS: usize = 100;

fn main() {
    let groups =
        GROUPS.map(|(name, kind, length)| SignalGroup { name: name.to_owned(), kind, length, unit: String::new() });
    let signals = Signals { period_s: 0.05, groups: groups.into(), gripper_in_vector: None };
    let features = Features { signals, parameters: Vec::new() };
    let mut stream = Seed::campaign(1).stream("bench");
    let mut track = |index: u64, fails: bool| Track {
        index,
        scenario: index,
        sampled: true,
        failure: fails.then(|| "lost".to_owned()),
        event_s: 0.05 * TICKS as f64,
        times: (0..TICKS).map(|i| 0.05 * i as f32).collect(),
        rows: (0..TICKS * WIDTH).map(|i| (i as f32 / 300.0).sin() + 0.1 * stream.normal() as f32).collect(),
        parameters: Vec::new(),
        scenario_numbers: Vec::new(),
    };
    for (name, failing) in [("trees", 2), ("distance", u64::MAX)] {
        let tracks: Vec<Track> = (0..300).map(|i| track(i, i % failing == 1)).collect();
        let detector = train(features.clone(), &tracks.iter().collect::<Vec<_>>(), 1).unwrap();
        let mut warner = Warner::new(&detector, f64::INFINITY);
        let mut best = f64::INFINITY;
        for track in &tracks {
            warner.start(&[]);
            let start = Instant::now();
            for (row, time_s) in track.rows.chunks_exact(WIDTH).zip(&track.times) {
                black_box(warner.observe(*time_s, row));
            }
            best = best.min(start.elapsed().as_secs_f64() / TICKS as f64);
        }
        println!("{name}: {:.2} us a control period (best of 300 episodes), {} bytes", 1e6 * best, warner.bytes());
    }
}
