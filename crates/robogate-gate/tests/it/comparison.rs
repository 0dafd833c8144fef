use robogate_core::{FailureMode, Value};
use robogate_gate::{
    Against, Ending, Evaluation, GateError, Planned, Question, Record, Requirements, Sampling, Status, Verdict,
    check_pairing,
};

use crate::common::{failed, invalid, requirements, sampled, suite};

/// Requirements that every policy meets, so that the comparison alone decides.
fn easy() -> Requirements {
    requirements("name = \"e\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.05\n")
}

fn ask(this: &Record, other: &Record, margin: f64, sampling: Sampling) -> Result<Evaluation, GateError> {
    let requirements = easy();
    let against = Some(Against { record: other, margin });
    Question { requirements: &requirements, baseline: None, against, sampling }.evaluate(this)
}

fn endings(n: u64, fails: impl Fn(u64) -> bool) -> Vec<Ending> {
    (0..n).map(|i| if fails(i) { failed(FailureMode::constant("grasp_miss")) } else { Ending::Success }).collect()
}

#[test]
fn replacement_requires_non_inferiority() {
    let a = suite(8, endings(400, |i| i % 20 == 0));
    let same = suite(8, endings(400, |i| i % 20 == 1));
    for sampling in [Sampling::Fixed, Sampling::Sequential] {
        let found = ask(&same, &a, 0.1, sampling).unwrap();
        let c = found.comparison.unwrap();
        assert_eq!((c.status, found.verdict), (Status::Met, Verdict::Pass), "{sampling:?} {}", c.p_met);
        assert_eq!((c.both, c.only_other, c.only_this, c.neither), (360, 20, 20, 0));
        assert_eq!(c.difference, Some(0.0));
    }
    let worse = suite(8, endings(400, |i| i % 3 == 0));
    for sampling in [Sampling::Fixed, Sampling::Sequential] {
        let found = ask(&worse, &a, 0.1, sampling).unwrap();
        let c = found.comparison.unwrap();
        assert_eq!((c.status, found.verdict), (Status::Violated, Verdict::Fail), "{sampling:?} {}", c.p_violated);
        assert!(c.interval_95[1] < 0.0 && c.p_different < 1e-6);
    }
}

#[test]
fn few_pairs_are_inconclusive() {
    let a = sampled(endings(20, |_| false));
    let found = ask(&a.clone(), &a, 0.05, Sampling::Fixed).unwrap();
    assert_eq!((found.comparison.unwrap().status, found.verdict), (Status::Undecided, Verdict::Inconclusive));
}

#[test]
fn invalid_pairs_count_as_worst_case() {
    let a = sampled(endings(59, |_| false));
    let mut b = a.clone();
    // 59 pairs with equal outcomes just show a margin of 5 points. With one invalid pair they do not.
    assert_eq!(ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap().status, Status::Met);
    b.trials[7].ending = invalid();
    let c = ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap();
    assert_eq!((c.status, c.invalid, c.both), (Status::Undecided, 1, 58));
}

#[test]
fn different_scenarios_are_not_paired() {
    let a = suite(8, endings(16, |_| false));
    let mut b = a.clone();
    b.trials[3].seed = 7;
    let error = ask(&b, &a, 0.05, Sampling::Fixed).unwrap_err();
    assert!(matches!(error, GateError::NotPaired { index: 3, .. }), "{error}");
    let other = sampled(endings(16, |_| false));
    assert!(matches!(ask(&other, &a, 0.05, Sampling::Fixed), Err(GateError::ForeignBaseline { .. })));
    assert!(matches!(ask(&a, &a, 5.0, Sampling::Fixed), Err(GateError::Margin(_))));
    assert!(matches!(ask(&a, &a, 5.0, Sampling::Sequential), Err(GateError::Margin(_))));
}

#[test]
fn only_common_rounds_are_paired() {
    let long = suite(8, endings(80, |_| false));
    let short = suite(8, endings(20, |_| false));
    let c = ask(&long, &short, 0.05, Sampling::Sequential).unwrap().comparison.unwrap();
    assert_eq!(c.both, 16);
}

/// Imported episodes of one case, each with its own seed.
fn imported(n: i64, seed: impl Fn(i64) -> i64, case: Option<&str>) -> Record {
    let mut record = sampled(endings(n as u64, |_| false));
    record.imported = true;
    for (trial, i) in record.trials.iter_mut().zip(0..) {
        trial.label.case = case.map(str::to_owned);
        trial.requested.set("source_seed", Value::Integer(seed(i)));
    }
    record
}

#[test]
fn imported_pairs_need_case_and_seed() {
    let a = imported(80, |i| i, Some("lift"));
    let b = imported(80, |i| 79 - i, Some("lift"));
    assert_eq!(ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap().both, 80);
    let half = imported(80, |i| i + 40, Some("lift"));
    assert_eq!(ask(&half, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap().both, 40);
    for other in [imported(80, |i| i, None), imported(80, |_| 0, Some("lift"))] {
        let error = ask(&other, &a, 0.05, Sampling::Fixed).unwrap_err();
        assert!(matches!(error, GateError::NoIdentity { .. }), "{error}");
    }
}

#[test]
fn files_without_cases_are_paired_by_seed() {
    let (a, b) = (imported(80, |i| i, None), imported(80, |i| 79 - i, None));
    assert_eq!(ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap().both, 80);
}

#[test]
fn files_without_seeds_are_paired_by_number() {
    let numbered = |reverse: bool| {
        let mut record = imported(80, |_| 0, Some("lift"));
        for (trial, i) in record.trials.iter_mut().zip(0..) {
            trial.requested =
                [("source_episode".into(), Value::Integer(if reverse { 79 - i } else { i }))].into_iter().collect();
        }
        record
    };
    let found = ask(&numbered(true), &numbered(false), 0.05, Sampling::Fixed).unwrap();
    assert_eq!(found.comparison.unwrap().both, 80);
}

#[test]
fn hopeless_comparisons_run_nothing() {
    let none = suite(8, []);
    let planned = |rounds, sampling| Planned { seed: 1, rounds, sampling, alpha: 0.05 };
    let few = suite(8, endings(16, |_| false));
    for sampling in [Sampling::Fixed, Sampling::Sequential] {
        let error = check_pairing(&few, &none, planned(20, sampling), 0.05).unwrap_err();
        assert!(matches!(error, GateError::TooFewPairs { pairs: 16, .. }), "{error}");
    }
    let many = suite(8, endings(800, |_| false));
    check_pairing(&many, &none, planned(100, Sampling::Sequential), 0.05).unwrap();
    // The other run has enough rounds, but this gate's budget has not.
    assert!(matches!(
        check_pairing(&many, &none, planned(1, Sampling::Sequential), 0.05),
        Err(GateError::TooFewPairs { pairs: 8, .. })
    ));
}
