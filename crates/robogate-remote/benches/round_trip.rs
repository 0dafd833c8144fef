//! What the bridge itself costs: a Rust client and Python servers on the loopback, their simulator next to free.
//!
//! `ROBOGATE_BRIDGE_PYTHON=... cargo bench -p robogate-remote` (`bridges/common/setup.sh FOLDER` makes the Python). Fails
//! where a round trip is slower than the bridge may be.

#![expect(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints, and fails by panicking")]

use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use robogate_core::{Action, ArmCommand, Assignment, GripperCommand, Scenario, Seed, Simulator};
use robogate_remote::{NoWorld, Patience, Pool, Remote};
use robogate_zmtp::Address;

#[expect(dead_code, reason = "tests use the rest")]
#[path = "../../robogate-zmtp/tests/support/mod.rs"]
mod support;

/// Control periods whose times are taken, within the toy's time limit each episode.
const PERIODS: usize = 4000;
const EPISODE: usize = 99;
/// What a round trip may cost: of state alone, and with a picture of 256 x 256 pixels.
const STATE: Duration = Duration::from_micros(150);
const PICTURE: Duration = Duration::from_micros(500);

fn server(python: &std::path::Path) -> (support::Peer, Address) {
    let peer = support::Peer::start(python, &support::root().join("bridges/common/tests/toy.py"), &[]);
    let said: serde_json::Value = serde_json::from_str(&peer.said).unwrap();
    let address = said["listening"].as_str().unwrap().parse().unwrap();
    (peer, address)
}

fn scenario(index: usize) -> Scenario {
    let index = index as u64;
    Scenario { index, seed: Seed::campaign(1).episode(index), requested: Assignment::default() }
}

fn action() -> Action {
    let arm = ArmCommand::JointPositions(vec![0.5, 0.1, 0.3]);
    Action { arm, gripper: GripperCommand::Open, phase: None }
}

/// Times of so many calls, sorted.
fn times(simulator: &mut dyn Simulator, mut call: impl FnMut(&mut dyn Simulator)) -> Vec<Duration> {
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

fn remote(pool: &Arc<Pool>) -> Remote<NoWorld> {
    Remote::new(Arc::clone(pool), None).unwrap()
}

/// Steps per second of so many workers at once.
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
        println!("ROBOGATE_BRIDGE_PYTHON names no Python with pyzmq and msgpack: nothing is measured");
        return ExitCode::FAILURE;
    };
    let (_one, first) = server(&python);
    let (_other, second) = server(&python);
    let patience = Patience::of(Duration::from_secs(10));
    let connect = |addresses: &[Address]| Arc::new(Pool::connect(addresses, patience, Box::new(|_| {})).unwrap());
    let pool = connect(std::slice::from_ref(&first));
    let mut slow = false;
    let mut simulator = remote(&pool);
    let mut say = |what: &str, times: &[Duration], limit: Duration| {
        let (median, p99) = (times[PERIODS / 2], times[PERIODS * 99 / 100]);
        println!("{what:<28} {median:>9.1?} median {p99:>9.1?} for 99 of 100, {limit:?} allowed");
        slow |= median > limit;
    };
    let steps = {
        // Steps are their own warming up: two a turn, one of them timed.
        let step = |simulator: &mut dyn Simulator| drop(simulator.step(&action()).unwrap());
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
    say("step, state alone", &steps, STATE);
    let renders = times(&mut simulator, |simulator| drop(simulator.render().unwrap()));
    say("render, 256 x 256 pixels", &renders, PICTURE);
    drop(simulator);
    let one = rate(&pool, 1);
    drop(pool);
    let both = connect(&[first, second]);
    let two = rate(&both, 2);
    println!("one server {one:>8.0} steps/s, two servers {two:>8.0} steps/s: {:.2} times", two / one);
    if slow { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
