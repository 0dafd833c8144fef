//! Limits of contact forces that the user supplies.

use std::fs;
use std::sync::Arc;

use robogate_core::{Better, Contacting, FailureMode, MeasureSpec, PEAK_CONTACT_FORCE, Region, Touched, region_pairs};
use robogate_gate::{ForceLimits, GateError, Question, Record, Requirements, Sampling, Status, Trial, Verdict};

use crate::common::{failed, sampled, task, times};

const LIMITS: &str = "
source = \"risk assessment 7\"
[[limit]]
name = \"hand\"
robot = [\"hand\", \"fingers\"]
on = [\"surroundings\"]
quasi_static_n = 100.0
transient_n = 200.0
";

fn opened(text: &str) -> Result<ForceLimits, GateError> {
    let dir = tempfile::TempDir::new().unwrap();
    let path = dir.path().join("limits.toml");
    fs::write(&path, text).unwrap();
    ForceLimits::open(&path)
}

/// Episodes of a task that records forces by region.
fn recorded(endings: impl IntoIterator<Item = robogate_gate::Ending>) -> Record {
    let mut record = sampled(endings);
    let mut task = task();
    for (region, touched) in region_pairs() {
        task.measures.extend(Contacting::ALL.map(|kind| MeasureSpec {
            name: kind.measure(region, touched),
            unit: "N".to_owned(),
            meaning: String::new(),
            better: Better::Lower,
        }));
    }
    record.task = Arc::new(task);
    record
}

fn touch(trial: &mut Trial, region: Region, touched: Touched, forces: [f64; 2]) {
    for (kind, force) in Contacting::ALL.into_iter().zip(forces) {
        trial.measures.set(kind.measure(region, touched), Some(force));
    }
    trial.measures.set(PEAK_CONTACT_FORCE, Some(forces[0]));
}

#[test]
fn contacts_above_a_limit_are_listed() {
    let mut record = recorded(times(5, &robogate_gate::Ending::Success));
    let trials = &mut record.trials;
    touch(&mut trials[0], Region::Fingers, Touched::Surroundings, [199.0, 99.0]);
    touch(&mut trials[1], Region::Fingers, Touched::Surroundings, [150.0, 101.0]);
    touch(&mut trials[2], Region::Hand, Touched::Surroundings, [300.0, 20.0]);
    // The limit applies neither to parts nor to the arm.
    touch(&mut trials[3], Region::Fingers, Touched::Part, [900.0, 900.0]);
    touch(&mut trials[4], Region::Arm, Touched::Surroundings, [900.0, 900.0]);
    let [result] = &opened(LIMITS).unwrap().results(record.trials.iter())[..] else { panic!("one limit") };
    assert_eq!((result.episodes, result.unknown, result.exceeding), (5, 0, 2));
    let found: Vec<_> =
        result.contacts.iter().map(|contact| (contact.episode, contact.kind, contact.force_n)).collect();
    assert_eq!(found, [(2, Contacting::Transient, 300.0), (1, Contacting::QuasiStatic, 101.0)]);
    assert_eq!(
        result.contacts[0].text(),
        "episode 2 (success): hand on the surroundings, 300 N transient (limit 200 N)"
    );
}

#[test]
fn exceeded_limits_fail_a_gate() {
    let judge = |hard: usize| {
        let mut record = recorded(times(600, &robogate_gate::Ending::Success));
        record.trials.iter_mut().for_each(|trial| touch(trial, Region::Fingers, Touched::Part, [30.0, 30.0]));
        for trial in &mut record.trials[..hard] {
            touch(trial, Region::Hand, Touched::Surroundings, [300.0, 10.0]);
        }
        let requirements = Requirements::open("default", &record.task).unwrap();
        let requirements = requirements.with_force_limits(opened(LIMITS).unwrap()).unwrap();
        let question =
            Question { requirements: &requirements, baseline: None, against: None, sampling: Sampling::Fixed };
        let evaluation = question.evaluate(&record).unwrap();
        let of = evaluation.results.iter().find(|result| result.id == "force_limit:hand").unwrap();
        (of.status, evaluation.verdict == Verdict::Fail, evaluation.force_limits[0].exceeding)
    };
    assert_eq!(judge(0), (Status::Met, false, 0));
    assert_eq!(judge(60), (Status::Violated, true, 60));
}

/// An engine in another process may report the largest force alone.
#[test]
fn unknown_forces_do_not_meet_a_limit() {
    let mut record = recorded(times(600, &failed(FailureMode::TIMEOUT)));
    record.trials.iter_mut().for_each(|trial| trial.measures.set(PEAK_CONTACT_FORCE, Some(10.0)));
    let limits = opened(LIMITS).unwrap();
    assert_eq!(limits.results(record.trials.iter())[0].unknown, 600);
    let requirements = Requirements::open("default", &record.task).unwrap().with_force_limits(limits).unwrap();
    let question = Question { requirements: &requirements, baseline: None, against: None, sampling: Sampling::Fixed };
    let evaluation = question.evaluate(&record).unwrap();
    let of = evaluation.results.iter().find(|result| result.id == "force_limit:hand").unwrap();
    assert_eq!(of.status, Status::NoEvidence);
}

#[test]
fn wrong_limits_are_explained() {
    let limit = |lines: &str| format!("[[limit]]\nname = \"hand\"\n{lines}\n");
    for (text, expected) in [
        (String::new(), "limit"),
        ("limit = []".to_owned(), "no [[limit]]"),
        (limit(""), "quasi_static_n"),
        (limit("transient_n = -3.0"), "above 0 N"),
        (limit("transient_n = nan"), "above 0 N"),
        (limit("transient_n = 3.0\nquasi_static_n = 4.0"), "below `quasi_static_n`"),
        (limit("transient_n = 3.0\nrobot = []"), "matches no contact"),
        (limit("transient_n = 3.0\nrobot = [\"skull\"]"), "skull"),
        (limit("transient_n = 3.0\nat_most = 1.0"), "share of episodes"),
        (limit("transient_n = 3.0") + &limit("transient_n = 4.0"), "duplicate"),
        ("[[limit]]\nname = \"a hand\"\ntransient_n = 3.0\n".to_owned(), "a hand"),
    ] {
        let error = opened(&text).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("limits.toml"), "{text}: {error}");
    }
    let error = opened(LIMITS).unwrap().check_task(&task()).unwrap_err().to_string();
    assert!(error.contains("records contact forces of these regions of the robot: none"), "{error}");
}
