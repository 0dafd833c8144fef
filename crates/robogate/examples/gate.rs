//! Simulate, gate, read the verdict: `cargo run --release -p robogate --example gate`.
//!
//! `EnvironmentChoice` also selects a robot, an engine, settings of the task, or an environment in Python (`env`); `PolicyChoice`
//! a policy server or a network.
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::sync::atomic::AtomicBool;

use robogate_session::{EnvironmentChoice, GateRequest, PolicyChoice, Subject, Workers};

fn main() -> anyhow::Result<()> {
    let environment = EnvironmentChoice { task: "pendulum".to_owned(), ..EnvironmentChoice::default() };
    let subject = Subject::of(&environment, &PolicyChoice::default())?;
    let request = GateRequest { rounds: Some(4), ..GateRequest::of(subject.sampled_suite(32, 1)?) };
    let folder = tempfile::tempdir()?;
    let workers = Workers { threads: None, in_flight: None, stop: &AtomicBool::new(false) };
    let evaluation = request.decide(subject, None, folder.path(), workers, &mut |_| {})?;
    for result in &evaluation.results {
        println!("{}: {:?}", result.id, result.status);
    }
    println!("{}: {}", evaluation.verdict.as_str(), evaluation.because);
    Ok(())
}

#[test]
fn the_example_runs() -> anyhow::Result<()> {
    main()
}
