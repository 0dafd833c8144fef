//! Requirements on production and on stages.

use std::sync::Arc;

use robogate_core::{Better, MeasureSpec, TaskSpec, Word};
use robogate_gate::{Against, Ending, Question, Record, Requirements, Sampling, Status};

use crate::common::{judge, requirements, sampled, task, trial};

/// 300 episodes: four of five succeed in 6 s, the others end at the limit of 15 s.
fn record() -> Record {
    let mut record = sampled([]);
    for index in 0..300 {
        let ending = if index % 5 == 4 { Ending::Failure(None) } else { Ending::Success };
        let time_s = Some(if index % 5 == 4 { 15.0 } else { 6.0 });
        record.trials.push(robogate_gate::Trial { time_s, ..trial(index, ending) });
    }
    record
}

fn gate(metric: &str, limit: &str) -> Requirements {
    requirements(&format!("name = \"p\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"{metric}\"\n{limit}\n"))
}

#[test]
fn production_figures_are_judged() {
    // 0.8 units in 0.8 x 6 + 0.2 x 15 = 7.8 s, a failure each 5 episodes and each 39 s.
    let cases = [
        ("units_per_hour", "ceiling = 15\nat_least = ", 3600.0 * 0.8 / 7.8, ["250", "600"]),
        ("mean_cycles_between_failures", "at_least = ", 5.0, ["4", "7"]),
        ("time_between_assists_s", "ceiling = 15\nat_least = ", 39.0, ["28", "60"]),
        ("longest_clean_run", "at_least = ", 4.0, ["10", "60"]),
        ("time_to_success_s:p75", "at_most = ", 6.0, ["8", "5"]),
    ];
    for (metric, before, observed, limits) in cases {
        for sampling in [Sampling::Fixed, Sampling::Sequential] {
            let found = limits.map(|limit| judge(&gate(metric, &format!("{before}{limit}")), &record(), sampling));
            let results = found.each_ref().map(|found| &found.results[0]);
            assert!((results[0].figure.observed.unwrap() - observed).abs() < 1e-9, "{metric}: {:?}", results[0].figure);
            // The anytime test of a rate needs more episodes than these for the quantile.
            if sampling == Sampling::Fixed {
                assert_eq!(results.map(|result| result.status), [Status::Met, Status::Violated], "{metric}");
            }
            if let Some([low, high]) = results[0].interval.filter(|_| metric != "longest_clean_run") {
                assert!(low < observed && observed < high, "{metric} {sampling:?}: {low} {high}");
            }
        }
    }
    let production = judge(&gate("success", "at_least = 0.5"), &record(), Sampling::Fixed).production.unwrap();
    assert!((production.units_per_hour.at.unwrap() - 3600.0 * 0.8 / 7.8).abs() < 1e-9);
    assert_eq!(production.median_cycle_time_s.at, Some(6.0));
    assert_eq!((production.longest_clean_run.at, production.tolerance_cycle_time_s), (Some(19.0), Some([6.0, 6.0])));
}

#[test]
fn invalid_episodes_count_against_production() {
    let mut record = record();
    for trial in record.trials.iter_mut().step_by(10) {
        trial.ending = crate::common::invalid();
    }
    let found = judge(&gate("units_per_hour", "ceiling = 15\nat_least = 320"), &record, Sampling::Fixed);
    let result = &found.results[0];
    assert_eq!((result.status, result.invalid), (Status::Undecided, 30));
    assert!(result.figure.least.unwrap() < 320.0 && result.figure.most.unwrap() > 390.0, "{:?}", result.figure);
}

#[test]
fn impossible_production_is_rejected() {
    let error = |metric: &str, limit: &str| {
        let text = format!("name = \"p\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"{metric}\"\n{limit}\n");
        Requirements::from_toml(&text).unwrap_err().to_string()
    };
    assert!(error("units_per_hour", "at_least = 300").contains("`ceiling`"));
    assert!(error("units_per_hour", "at_most = 300\nceiling = 15").contains("at_least"));
    assert!(error("mean_cycles_between_failures", "at_least = 1").contains("holds for every policy"));
    assert!(error("longest_clean_run", "at_least = 2.5").contains("integer"));
    assert!(error("time_to_success_s:p90", "at_least = 2").contains("at_most"));
    let question = gate("longest_clean_run", "at_least = 301");
    let question = Question { requirements: &question, baseline: None, against: None, sampling: Sampling::Fixed };
    assert!(question.evaluate(&record()).unwrap_err().to_string().contains("300 episodes have no run of 301"));
}

/// A task with the stages grasped, lifted and placed.
fn staged() -> TaskSpec {
    let name = Word::constant("stages");
    let measure = MeasureSpec { name, unit: String::new(), meaning: String::new(), better: Better::Higher };
    let stages = ["grasped", "lifted", "placed"].map(|stage| Word::new(stage).unwrap()).to_vec();
    let mut task = task();
    task.measures.push(measure);
    TaskSpec { stages, ..task }
}

/// 200 paired episodes with the same successes, whose failures reach this many stages.
fn reaching(stages: f64) -> Record {
    let mut record = record();
    record.task = Arc::new(staged());
    record.trials.truncate(200);
    for trial in &mut record.trials {
        trial.ending = if trial.index % 2 == 0 { Ending::Success } else { Ending::Failure(None) };
        trial.measures.set(Word::constant("stages"), Some(stages));
    }
    record
}

#[test]
fn stages_are_an_outcome() {
    // Half of the episodes succeed, and the others go half of the way: 0.75.
    let found = judge(&gate("stage", "at_least = 0.6"), &reaching(2.0), Sampling::Sequential);
    let result = &found.results[0];
    assert_eq!((result.figure.observed, result.status), (Some(0.75), Status::Met));
    let low = judge(&gate("stage", "at_least = 0.9"), &reaching(2.0), Sampling::Sequential);
    assert_eq!(low.results[0].status, Status::Violated);
    let question = gate("stage", "at_least = 0.6");
    let question = Question { requirements: &question, baseline: None, against: None, sampling: Sampling::Fixed };
    assert!(question.evaluate(&record()).unwrap_err().to_string().contains("declares no stages"));
}

#[test]
fn comparisons_see_stages() {
    let (other, this) = (reaching(1.0), reaching(2.0));
    let question = gate("success", "at_least = 0.2");
    let against = Some(Against { record: &other, margin: 0.05 });
    let question = Question { requirements: &question, baseline: None, against, sampling: Sampling::Fixed };
    let comparison = question.evaluate(&this).unwrap().comparison.unwrap();
    // Both succeed in the same episodes.
    assert_eq!((comparison.difference, comparison.only_this), (Some(0.0), 0));
    let stage = comparison.stage.unwrap();
    assert_eq!((stage.pairs, stage.difference), (200, 0.125));
    assert!(stage.p_better < 0.001 && stage.p_worse > 0.5 && stage.interval_95[0] > 0.0, "{stage:?}");
}
