//! Two policies on the same scenarios: `cargo run --release -p robogate --example compare`.
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::sync::atomic::AtomicBool;

use anyhow::Context;
use robogate_session::{EnvironmentChoice, GateRequest, PolicyChoice, Subject, Workers};

fn main() -> anyhow::Result<()> {
    let environment = EnvironmentChoice { task: "pendulum".to_owned(), ..EnvironmentChoice::default() };
    let random = PolicyChoice { policy: Some("random".to_owned()), ..PolicyChoice::default() };
    let subject = Subject::of(&environment, &PolicyChoice::default())?;
    let rival = Subject::of(&environment, &random)?;
    let request = GateRequest { rounds: Some(2), ..GateRequest::of(subject.sampled_suite(32, 1)?) };
    let folder = tempfile::tempdir()?;
    let workers = Workers { threads: None, in_flight: None, stop: &AtomicBool::new(false) };
    let evaluation = request.decide(subject, Some(rival), folder.path(), workers, &mut |_| {})?;
    let comparison = evaluation.comparison.context("both policies ran")?;
    let (better, worse) = (comparison.only_this, comparison.only_other);
    println!("only the first policy succeeded in {better} scenarios, only {} in {worse}", comparison.policy);
    let points = 100.0 * comparison.difference.context("some pair is valid")?;
    let [low, high] = comparison.interval_95.map(|share| 100.0 * share);
    println!("difference of the success rates: {points:+.1} points (95 % interval {low:+.1} to {high:+.1})");
    println!("{}: {}", evaluation.verdict.as_str(), evaluation.because);
    Ok(())
}

#[test]
fn the_example_runs() -> anyhow::Result<()> {
    main()
}
