//! Requirements on the success rate of the real robot.

use robogate_gate::{
    Ending, Evaluation, GateError, Question, RealEvidence, RealStratum, Requirements, Sampling, Status, Verdict,
};

use crate::common::sampled;

const REQUIREMENTS: &str = "name = 'real'\nmode = 'confidence'\n\n[[requirement]]\nmetric = 'success'\nat_least = 0.8\n\n\
                            [[requirement]]\nmetric = 'real:success'\nat_least = 0.7\n";

fn evidence(successes: [u64; 2], trials: [u64; 2]) -> RealEvidence {
    let stratum = |i: usize| RealStratum { share: 0.5, trials: trials[i], successes: successes[i] };
    RealEvidence {
        format: RealEvidence::FORMAT,
        task: sampled([]).task.name.as_str().to_owned(),
        robot: "franka".to_owned(),
        policy: "scripted".to_owned(),
        population: "the operating space".to_owned(),
        trials_sha256: "b".repeat(64),
        simulation_sha256: "c".repeat(64),
        strata: [stratum(0), stratum(1)],
    }
}

fn judged(real: Option<RealEvidence>) -> Result<Evaluation, GateError> {
    let mut record = sampled((0..200).map(|_| Ending::Success));
    record.real = real;
    let requirements = Requirements::from_toml(REQUIREMENTS).unwrap();
    Question { requirements: &requirements, baseline: None, against: None, sampling: Sampling::Fixed }.evaluate(&record)
}

#[test]
fn real_trials_decide_their_requirement() {
    let verdict = |successes, trials| {
        let evaluation = judged(Some(evidence(successes, trials))).unwrap();
        assert!(evaluation.real.is_some());
        (evaluation.verdict, evaluation.results[1].status)
    };
    assert_eq!(verdict([24, 25], [25, 25]), (Verdict::Pass, Status::Met));
    assert_eq!(verdict([5, 12], [25, 25]), (Verdict::Fail, Status::Violated));
    assert_eq!(verdict([4, 5], [5, 5]), (Verdict::Inconclusive, Status::Undecided));
}

#[test]
fn no_real_trials_are_no_evidence() {
    let evaluation = judged(None).unwrap();
    assert_eq!(evaluation.results[1].status, Status::NoEvidence);
    assert_eq!(evaluation.verdict, Verdict::Inconclusive);
}

#[test]
fn foreign_trials_are_rejected() {
    let other = RealEvidence { policy: "another".to_owned(), ..evidence([24, 25], [25, 25]) };
    let error = judged(Some(other)).unwrap_err().to_string();
    assert!(error.contains("`another`"), "{error}");
    assert!(judged(Some(evidence([26, 25], [25, 25]))).is_err());
}

#[test]
fn real_evidence_round_trips() {
    let found = evidence([24, 25], [25, 25]);
    let path = std::path::Path::new("real.json");
    assert_eq!(RealEvidence::from_json(path, &found.to_json()).unwrap(), found);
    assert!(RealEvidence::from_json(path, "{}").is_err());
}
