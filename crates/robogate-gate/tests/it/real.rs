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
        robot_sha256: None,
        policy: "scripted".to_owned(),
        policy_sha256: None,
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

/// Two policies of one profile have one name. A hash that is unknown on one side decides nothing.
#[test]
fn trials_of_other_files_are_rejected() {
    let trials = |robot: Option<&str>, policy: Option<&str>| RealEvidence {
        robot_sha256: robot.map(str::to_owned),
        policy_sha256: policy.map(str::to_owned),
        ..evidence([24, 25], [25, 25])
    };
    let mut record = sampled([]);
    record.policy_sha256 = Some("p1".to_owned());
    assert!(trials(Some("r1"), Some("p1")).check_subject(&record).is_ok());
    assert!(trials(None, None).check_subject(&record).is_ok());
    let error = trials(Some("r1"), Some("p2")).check_subject(&record).unwrap_err().to_string();
    assert!(error.contains("SHA-256 of the policy is `p2`") && !error.contains("robot's files"), "{error}");
    record.robot_sha256 = Some("r2".to_owned());
    let error = trials(Some("r1"), Some("p2")).check_subject(&record).unwrap_err().to_string();
    assert!(error.contains("SHA-256 of the robot's files is `r1`") && error.contains("`p2`"), "{error}");
}

/// The exact test of a million trials takes minutes, and evidence of others is verified.
#[test]
fn too_many_trials_are_rejected() {
    let path = std::path::Path::new("real.json");
    let read = |trials| RealEvidence::from_json(path, &evidence([1, 1], [trials, 1]).to_json());
    assert!(read(19_999).is_ok());
    for trials in [20_000, u64::MAX] {
        let error = read(trials).unwrap_err().to_string();
        assert!(error.contains("more than 20,000 trials"), "{error}");
    }
}

#[test]
fn real_evidence_round_trips() {
    let found = evidence([24, 25], [25, 25]);
    let path = std::path::Path::new("real.json");
    assert_eq!(RealEvidence::from_json(path, &found.to_json()).unwrap(), found);
    assert!(RealEvidence::from_json(path, "{}").is_err());
}
