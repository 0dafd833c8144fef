use std::sync::Arc;

use robogate_core::{Assignment, FailureMode, Fault, FaultKind, Measures, TaskSpec};
use robogate_dictionary::{Label, v1};
use robogate_gate::{
    Baseline, BaselineFigure, Conditions, Ending, Evaluation, Metric, Population, Question, Record, Requirements,
    Sampling, Trial,
};

/// The task of these tests.
pub(crate) fn task() -> TaskSpec {
    v1::task()
}

pub(crate) fn invalid() -> Ending {
    Ending::Invalid(Fault::new(FaultKind::Diverged, "test"))
}

pub(crate) fn failed(mode: FailureMode) -> Ending {
    Ending::Failure(Some(mode))
}

pub(crate) fn trial(index: u64, ending: Ending) -> Trial {
    let (label, requested) = (Label::default(), Assignment::default());
    Trial {
        index,
        seed: 1,
        label,
        requested,
        ending,
        time_s: Some(4.1),
        measures: Measures::default(),
        trajectory: None,
        unseen: Vec::new(),
        groups: Vec::new(),
        forces: Vec::new(),
    }
}

/// A record of episodes sampled from a space.
pub(crate) fn sampled(endings: impl IntoIterator<Item = Ending>) -> Record {
    let trials = endings.into_iter().zip(0..).map(|(ending, index)| trial(index, ending)).collect();
    let population = Population::Drawn { space: "test".to_owned(), sha256: "d".repeat(64) };
    record(population, trials)
}

/// Rounds of a suite of `cases` scenarios: even ones nominal, odd ones edge cases, with two groups in each.
pub(crate) fn suite(cases: u64, endings: impl IntoIterator<Item = Ending>) -> Record {
    let trials = endings
        .into_iter()
        .zip(0..)
        .map(|(ending, index)| Trial { label: label(index % cases), ..trial(index, ending) })
        .collect();
    let population = Population::Suite { name: "test-suite".to_owned(), sha256: "5".repeat(64), cases, fresh: false };
    record(population, trials)
}

pub(crate) fn label(case: u64) -> Label {
    Label {
        case: Some(format!("case-{case:02}")),
        category: Some(if case.is_multiple_of(2) { "nominal" } else { "edge_cases" }.to_owned()),
        group: Some(format!("group-{}", case % 4)),
    }
}

fn record(population: Population, trials: Vec<Trial>) -> Record {
    Record {
        stopping: None,
        controls: None,
        population,
        task: Arc::new(task()),
        robot: "franka".to_owned(),
        robot_sha256: None,
        policy: "scripted".to_owned(),
        policy_sha256: None,
        dataset_sha256: "a".repeat(64),
        trials,
        focused: 0,
        planned: None,
        imported: false,
        real: None,
        served: false,
        conditions: Conditions::default(),
        warner: None,
    }
}

/// A baseline with the same population as `record`.
pub(crate) fn baseline(record: &Record, success: f64, cycle_s: f64, miss: f64) -> Baseline {
    let mut baseline = Baseline::of(&Record { trials: vec![trial(0, Ending::Success)], ..sampled([]) }).unwrap();
    baseline.population = record.population.clone();
    baseline.figures = [
        (Metric::Success, success),
        (Metric::MEAN_CYCLE_TIME, cycle_s),
        (Metric::Failure(FailureMode::constant("grasp_miss")), miss),
    ]
    .into_iter()
    .map(|(metric, value)| BaselineFigure { metric, value })
    .collect();
    baseline
}

pub(crate) fn times(n: usize, ending: &Ending) -> impl Iterator<Item = Ending> + use<> {
    std::iter::repeat_n(ending.clone(), n)
}

pub(crate) fn requirements(toml: &str) -> Requirements {
    Requirements::from_toml(toml).unwrap()
}

pub(crate) fn judge(requirements: &Requirements, record: &Record, sampling: Sampling) -> Evaluation {
    Question { requirements, baseline: None, against: None, sampling }.evaluate(record).unwrap()
}
