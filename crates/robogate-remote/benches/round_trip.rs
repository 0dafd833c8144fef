//! Measures the overhead of the protocol: a Rust client and Python servers on the loopback interface. The simulator
//! does almost nothing.
//!
//! `ROBOGATE_BRIDGE_PYTHON=... cargo bench -p robogate-remote` (`bridges/common/setup.sh FOLDER` creates the Python
//! environment). Fails if the median of a round trip exceeds its limit.

#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and fails by panicking")]

use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use robogate_core::{Action, Assignment, Command, Environment, Scenario, Seed};
use robogate_remote::{Pool, RemoteEnvironment, Timeouts};
use robogate_zmtp::Address;

#[expect(dead_code, reason = "tests use the rest")]
#[path = "../../robogate-zmtp/tests/support/mod.rs"]
mod support;

/// Number of control periods that are measured.
const PERIODS: usize = 4000;
/// Control periods of an episode, within the time limit of the toy simulator.
const EPISODE: usize = 99;
/// Limits of a round trip: of the state only, and with an image of 256 x 256 pixels.
const STATE: Duration = Duration::from_micros(150);
const IMAGE: Duration = Duration::from_micros(500);

fn server(python: &std::path::Path) -> (support::Peer, Address) {
    let peer = support::Peer::start(python, &support::root().join("bridges/common/tests/toy.py"), &[]);
    let line: serde_json::Value = serde_json::from_str(&peer.first_line).unwrap();
    let address = line["listening"].as_str().unwrap().parse().unwrap();
    (peer, address)
}

fn scenario(index: usize) -> Scenario {
    let index = index as u64;
    Scenario { index, seed: Seed::campaign(1).episode(index), requested: Assignment::default() }
}

fn action() -> Action {
    let command = Command::JointPosition(vec![0.5, 0.1, 0.3]);
    Action { command, gripper: Some(Action::OPEN), phase: None }
}

/// Durations of [`PERIODS`] calls, sorted.
fn times(simulator: &mut dyn Environment, mut call: impl FnMut(&mut dyn Environment)) -> Vec<Duration> {
    let mut times = Vec::with_capacity(PERIODS);
    for k in 0..PERIODS {
        if k % EPISODE == 0 {
            simulator.reset(&scenario(k)).unwrap();
        }
        simulator.step(&action()).unwrap();
        let began = Instant::now();
        call(simulator);
        times.push(began.elapsed());
    }
    times.sort_unstable();
    times
}

fn remote(pool: &Arc<Pool>) -> RemoteEnvironment {
    RemoteEnvironment::new(Arc::clone(pool)).unwrap()
}

/// Steps per second of this number of parallel workers.
fn rate(pool: &Arc<Pool>, workers: usize) -> f64 {
    let began = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                let mut simulator = remote(pool);
                for k in 0..PERIODS {
                    if k % EPISODE == 0 {
                        simulator.reset(&scenario(k)).unwrap();
                    }
                    simulator.step(&action()).unwrap();
                }
            });
        }
    });
    (workers * PERIODS) as f64 / began.elapsed().as_secs_f64()
}

fn main() -> ExitCode {
    let Some(python) = std::env::var_os("ROBOGATE_BRIDGE_PYTHON").map(std::path::PathBuf::from) else {
        println!("set ROBOGATE_BRIDGE_PYTHON to a Python interpreter with pyzmq and msgpack");
        return ExitCode::FAILURE;
    };
    let (_one, first) = server(&python);
    let (_other, second) = server(&python);
    let timeouts = Timeouts::from_step(Duration::from_secs(10));
    let connect = |addresses: &[Address]| Arc::new(Pool::connect(addresses, timeouts, Box::new(|_| {})).unwrap());
    let pool = connect(std::slice::from_ref(&first));
    let mut slow = false;
    let mut simulator = remote(&pool);
    let mut print = |what: &str, times: &[Duration], limit: Duration| {
        let (median, p99) = (times[PERIODS / 2], times[PERIODS * 99 / 100]);
        println!("{what:<28} {median:>9.1?} median {p99:>9.1?} 99th percentile, limit {limit:?}");
        slow |= median > limit;
    };
    let steps = {
        let step = |simulator: &mut dyn Environment| drop(simulator.step(&action()).unwrap());
        let mut times = Vec::with_capacity(PERIODS);
        for k in 0..PERIODS {
            if k % EPISODE == 0 {
                simulator.reset(&scenario(k)).unwrap();
            }
            let began = Instant::now();
            step(&mut simulator);
            times.push(began.elapsed());
        }
        times.sort_unstable();
        times
    };
    print("step, state only", &steps, STATE);
    let renders = times(&mut simulator, |simulator| drop(simulator.render().unwrap()));
    print("render, 256 x 256 pixels", &renders, IMAGE);
    drop(simulator);
    let one = rate(&pool, 1);
    drop(pool);
    let both = connect(&[first, second]);
    let two = rate(&both, 2);
    println!("one server {one:>8.0} steps/s, two servers {two:>8.0} steps/s, ratio {:.2}", two / one);
    if slow { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
