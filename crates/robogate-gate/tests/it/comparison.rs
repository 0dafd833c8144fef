use robogate_core::FailureMode;
use robogate_gate::{
    Against, Ending, Evaluation, GateError, Question, Record, Requirements, Sampling, Status, Verdict,
};

use crate::common::{drawn, failed, invalid, requirements, suite};

/// A demand that anything meets, so that the comparison alone decides.
fn easy() -> Requirements {
    requirements("name = \"e\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success_rate\"\nat_least = 0.05\n")
}

fn ask(this: &Record, other: &Record, margin: f64, sampling: Sampling) -> Result<Evaluation, GateError> {
    let requirements = easy();
    let against = Some(Against { record: other, margin });
    Question { requirements: &requirements, baseline: None, against, sampling }.evaluate(this)
}

fn endings(n: u64, fails: impl Fn(u64) -> bool) -> Vec<Ending> {
    (0..n).map(|i| if fails(i) { failed(FailureMode::GraspMiss) } else { Ending::Success }).collect()
}

#[test]
fn b_may_replace_a_once_it_is_shown_to_be_no_worse_than_the_margin() {
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
fn few_pairs_decide_nothing_and_equal_outcomes_are_no_proof() {
    let a = drawn(endings(20, |_| false));
    let found = ask(&a.clone(), &a, 0.05, Sampling::Fixed).unwrap();
    assert_eq!((found.comparison.unwrap().status, found.verdict), (Status::Undecided, Verdict::Inconclusive));
}

#[test]
fn an_invalid_episode_counts_for_whichever_answer_it_would_spoil() {
    let a = drawn(endings(59, |_| false));
    let mut b = a.clone();
    // 59 agreeing pairs just show a margin of five points; with one of them unknown they do not.
    assert_eq!(ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap().status, Status::Met);
    b.trials[7].ending = invalid();
    let c = ask(&b, &a, 0.05, Sampling::Fixed).unwrap().comparison.unwrap();
    assert_eq!((c.status, c.invalid, c.both), (Status::Undecided, 1, 58));
}

#[test]
fn worlds_that_are_not_the_same_are_no_pair() {
    let a = suite(8, endings(16, |_| false));
    let mut b = a.clone();
    b.trials[3].seed = 7;
    let error = ask(&b, &a, 0.05, Sampling::Fixed).unwrap_err();
    assert!(matches!(error, GateError::NotPaired { index: 3, .. }), "{error}");
    let other = drawn(endings(16, |_| false));
    assert!(matches!(ask(&other, &a, 0.05, Sampling::Fixed), Err(GateError::ForeignBaseline { .. })));
    assert!(matches!(ask(&a, &a, 5.0, Sampling::Fixed), Err(GateError::Margin(_))));
    assert!(matches!(ask(&a, &a, 5.0, Sampling::Sequential), Err(GateError::Margin(_))));
}

#[test]
fn only_rounds_that_both_ran_are_paired() {
    let long = suite(8, endings(80, |_| false));
    let short = suite(8, endings(20, |_| false));
    let c = ask(&long, &short, 0.05, Sampling::Sequential).unwrap().comparison.unwrap();
    assert_eq!(c.both, 16);
}
