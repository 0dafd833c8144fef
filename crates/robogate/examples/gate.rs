//! Simulate, gate, read the verdict: `cargo run --release -p robogate --example gate`.
//!
//! Your own environment and policy (two small traits of `robogate-core`) can replace those of the pendulum.
#![expect(clippy::print_stdout, reason = "an example prints")]

use std::num::NonZeroUsize;
use std::sync::atomic::AtomicBool;

use robogate_campaign::{Plan, ThreadPool, Worker, WorkerFactory, folder::DICTIONARY, start};
use robogate_core::{Fault, ParameterSpace};
use robogate_dictionary::{Dictionary, Engine, Platform, Provenance, Robot, SCHEMA_VERSION, Tool};
use robogate_gate::{Question, Record, Requirements, Sampling};
use robogate_tasks::{SelfContained, pendulum::Pendulum};

struct Workers;

impl WorkerFactory for Workers {
    fn worker(&self) -> Result<Worker, Fault> {
        Ok(Worker { environment: Pendulum::DEFAULT.environment()?, policy: Pendulum::DEFAULT.controller() })
    }
}

fn main() -> anyhow::Result<()> {
    let (folder, task) = (tempfile::tempdir()?, Pendulum::DEFAULT.task());
    let provenance = Provenance {
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine { name: Pendulum::DEFAULT.engine()?.name.to_owned(), version: None, build_sha256: None },
        robot: Robot { name: task.name.to_string(), sha256: None, dimensions: None },
        policy: "scripted".to_owned(),
        space: ParameterSpace::from_toml(Pendulum::DEFAULT.space())?,
        question_sha256: None,
        platform: Some(Platform::here()),
        task: task.clone(),
        world: serde_json::Value::Null,
        plan: serde_json::Value::Null,
        seed: 0,
        source: None,
    };
    let pool = ThreadPool { factory: &Workers, threads: NonZeroUsize::MIN, stop: &AtomicBool::new(false) };
    start(folder.path(), &Plan::from_toml("[uniform]\nepisodes = 200")?, provenance, &pool, &mut |_| {})?;

    let record = Record::of(&Dictionary::open(&folder.path().join(DICTIONARY))?)?;
    let requirements = Requirements::open("default", &task)?;
    let question = Question { requirements: &requirements, baseline: None, against: None, sampling: Sampling::Fixed };
    let evaluation = question.evaluate(&record)?;
    for result in &evaluation.results {
        println!("{}: {:?}", result.id, result.status);
    }
    println!("verdict: {}", evaluation.verdict.as_str());
    Ok(())
}

#[test]
fn the_example_runs() -> anyhow::Result<()> {
    main()
}
