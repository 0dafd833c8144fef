//! When invalid episodes or the trials of the real robot rule out a pass.

use robogate_core::FailureMode;
use robogate_gate::{
    Against, Ending, Evaluation, Question, RealEvidence, RealStratum, Record, Requirements, RuledOut, Sampling, Verdict,
};
use serde_json::json;

use crate::common::{failed, invalid, judge, requirements, suite};

const CASES: u64 = 16;
const PLANNED: u64 = 20 * CASES;

fn gate() -> Requirements {
    requirements(
        "name = \"g\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.8\n[[requirement]]\nmetric = \"cycle_time_s\"\nat_most = 9.0\nceiling = 15.0\n",
    )
}

fn point() -> Requirements {
    requirements(
        "name = \"p\"\nmode = \"point\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.8\n[[requirement]]\nmetric = \"failure_count:collision\"\nat_most = 60\n",
    )
}

/// So many rounds of a suite of which 20 are planned.
fn rounds(n: u64, ending: impl Fn(u64) -> Ending) -> Record {
    Record { planned: Some(PLANNED), ..suite(CASES, (0..n * CASES).map(ending)) }
}

fn miss() -> Ending {
    failed(FailureMode::constant("grasp_miss"))
}

/// Invalid episodes with shares from none to nearly all, and the other episodes all as good as possible.
#[test]
fn ruled_out_gates_cannot_pass() {
    let mut ruled = [0; 2];
    for requirements in [gate(), point()] {
        for sampling in [Sampling::Fixed, Sampling::Sequential] {
            for every in [2, 3, 5, 7] {
                for n in [1, 2, 4, 8, 19] {
                    let ending = |i: u64| if i.is_multiple_of(every) { invalid() } else { Ending::Success };
                    let so_far = rounds(n, ending);
                    let now = judge(&requirements, &so_far, sampling);
                    let rest = |i: u64| if i < n * CASES { ending(i) } else { Ending::Success };
                    let at_end = judge(&requirements, &rounds(20, rest), sampling).verdict;
                    let out = now.ruled_out.is_some();
                    ruled[usize::from(out)] += 1;
                    assert!(!out || at_end != Verdict::Pass, "{sampling:?} {every} {n}: {}", now.because);
                }
            }
        }
    }
    assert!(ruled.iter().all(|n| *n > 10), "{ruled:?}");
}

#[test]
fn most_episodes_invalid_stops_early() {
    for sampling in [Sampling::Fixed, Sampling::Sequential] {
        let evaluate =
            |n| judge(&gate(), &rounds(n, |i| if i % 10 == 3 { Ending::Success } else { invalid() }), sampling);
        let first = (1..=20).find(|n| evaluate(*n).ruled_out.is_some()).unwrap();
        let found = evaluate(first);
        // 15 of 16 or 14 of 16 invalid episodes per round; at most about a fifth of 320 may be invalid.
        assert!((2..=4).contains(&first), "{first}");
        assert_eq!(found.verdict, Verdict::Inconclusive);
        assert!(found.results.iter().all(|result| result.next.is_none()), "a new gate would meet the same fault");
        assert!(found.because.contains("no result of the other"), "{}", found.because);
        let out = found.ruled_out.unwrap();
        let written = json!({
            "planned": PLANNED,
            "requirement": "success",
            "fault": "diverged: test",
            "with_fault": found.counts.invalid,
            "first": 0,
        });
        assert_eq!(serde_json::to_value(&out).unwrap(), written);
        assert_eq!(serde_json::from_value::<RuledOut>(written).unwrap(), out);
        // Once it is ruled out, it stays so.
        assert!((first..20).all(|n| evaluate(n).ruled_out.is_some()));
    }
}

#[test]
fn gate_without_valid_episodes_is_invalid() {
    let found = judge(&gate(), &rounds(1, |_| invalid()), Sampling::Sequential);
    assert_eq!((found.verdict, found.ruled_out.unwrap().requirement), (Verdict::Invalid, None));
    assert!(found.because.starts_with("all 16 episodes are invalid"), "{}", found.because);
}

#[test]
fn few_invalid_episodes_change_nothing() {
    let found = judge(&gate(), &rounds(2, |i| if i == 5 { invalid() } else { Ending::Success }), Sampling::Sequential);
    assert!(found.ruled_out.is_none());
    // All planned episodes ran: nothing was stopped.
    let whole = rounds(20, |i| if i % 10 == 3 { Ending::Success } else { invalid() });
    assert!(judge(&gate(), &whole, Sampling::Sequential).ruled_out.is_none());
}

/// A fail holds for every outcome of the invalid episodes, so a gate that approaches it continues.
#[test]
fn expected_violation_is_awaited() {
    let ending = |i: u64| if i.is_multiple_of(2) { invalid() } else { miss() };
    let so_far = judge(&gate(), &rounds(8, ending), Sampling::Sequential);
    assert!(so_far.ruled_out.is_none(), "{}", so_far.because);
    assert_eq!(judge(&gate(), &rounds(20, ending), Sampling::Sequential).verdict, Verdict::Fail);
}

/// Trials of the real robot, `successes` of 25 in each stratum.
fn real(record: &Record, successes: u64) -> RealEvidence {
    RealEvidence {
        format: RealEvidence::FORMAT,
        task: record.task.name.as_str().to_owned(),
        robot: record.robot.clone(),
        robot_sha256: None,
        policy: record.policy.clone(),
        policy_sha256: None,
        population: "the operating space".to_owned(),
        trials_sha256: "b".repeat(64),
        simulation_sha256: "c".repeat(64),
        strata: [RealStratum { share: 0.5, trials: 25, successes }; 2],
    }
}

/// No simulated episode changes what the trials of the real robot show.
#[test]
fn undecided_trials_rule_out_a_pass() {
    let with = |limit: f64| {
        requirements(&format!(
            "name = \"r\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = {limit}\n\
             [[requirement]]\nmetric = \"real:success\"\nat_least = 0.7\n"
        ))
    };
    let judge = |rounds: Record, limit: f64, successes: Option<u64>, sampling| {
        let record = Record { real: successes.map(|n| real(&rounds, n)), ..rounds };
        crate::common::judge(&with(limit), &record, sampling)
    };
    for sampling in [Sampling::Fixed, Sampling::Sequential] {
        let found = judge(rounds(1, |_| Ending::Success), 0.5, Some(19), sampling);
        assert!(found.because.contains("do not show `real:success`: no result of the other 304"), "{}", found.because);
        let out = found.ruled_out.unwrap();
        let written = json!({ "planned": PLANNED, "requirement": "real:success" });
        assert_eq!(found.verdict, Verdict::Inconclusive);
        assert_eq!(serde_json::to_value(&out).unwrap(), written);
        assert_eq!(serde_json::from_value::<RuledOut>(written).unwrap(), out);
        assert_eq!(judge(rounds(1, |_| Ending::Success), 0.5, Some(25), sampling).verdict, Verdict::Pass);
        let violated = judge(rounds(1, |_| Ending::Success), 0.5, Some(3), sampling);
        assert!(violated.verdict == Verdict::Fail && violated.is_violated_by_trials());
        // Without trials there is no evidence, and nothing to rule out.
        let without = judge(rounds(1, |_| Ending::Success), 0.5, None, sampling);
        assert!(without.ruled_out.is_none() && without.because.starts_with("no evidence"), "{}", without.because);
        // All planned episodes ran.
        assert!(judge(rounds(20, |_| Ending::Success), 0.5, Some(19), sampling).ruled_out.is_none());
        // The simulation alone is about to fail.
        let failing = judge(rounds(1, |i| if i < 6 { miss() } else { Ending::Success }), 0.9, Some(19), sampling);
        assert!(failing.ruled_out.is_none(), "{}", failing.because);
    }
}

fn compared(this: &Record, other: &Record) -> Evaluation {
    let easy =
        requirements("name = \"e\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.05\n");
    let against = Some(Against { record: other, margin: 0.1 });
    Question { requirements: &easy, baseline: None, against, sampling: Sampling::Sequential }.evaluate(this).unwrap()
}

/// The invalid episodes of the other policy rule out a replacement as well.
#[test]
fn invalid_pairs_rule_out_a_replacement() {
    // With fewer rounds, the other pairs could still show that the one policy is better.
    let good = rounds(12, |_| Ending::Success);
    let broken = rounds(12, |i| if i % 10 == 3 { Ending::Success } else { invalid() });
    for (this, other) in [(&good, &broken), (&broken, &good)] {
        let found = compared(this, other);
        let out = found.ruled_out.unwrap();
        assert_eq!(out.requirement.as_deref(), Some("not worse than the other policy"));
        assert_eq!((found.verdict, out.fault.unwrap().with_fault), (Verdict::Inconclusive, 173));
        assert!(found.because.starts_with("173 of 192 pairs of episodes are invalid"), "{}", found.because);
    }
}
