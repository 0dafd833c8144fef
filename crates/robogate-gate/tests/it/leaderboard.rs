use robogate_core::{FailureMode, Seed, Stream};
use robogate_gate::{Ending, Leaderboard, Metric, Record, Sampling, ScoreTerm, Scoring};

use crate::common::{failed, suite};

const CASES: u64 = 24;

fn ranked(entries: &[(String, Record, Sampling)]) -> Leaderboard {
    let success = ScoreTerm {
        name: "Success".to_owned(),
        metric: Metric::Success,
        category: None,
        weight: 1.0,
        scoring: Scoring::Linear { full_at: 1.0 },
    };
    Leaderboard::of(entries, &[success], None).unwrap()
}

fn board(stream: &mut Stream, rates: &[f64]) -> Leaderboard {
    let mut entries = Vec::new();
    for (i, rate) in rates.iter().enumerate() {
        let endings: Vec<Ending> = (0..CASES)
            .map(|_| match stream.uniform() < *rate {
                true => Ending::Success,
                false => failed(FailureMode::constant("timeout")),
            })
            .collect();
        entries.push((format!("policy {i}"), suite(CASES, endings), Sampling::Fixed));
    }
    ranked(&entries)
}

#[test]
fn stopped_gates_have_a_wider_interval() {
    let run = || suite(CASES, vec![Ending::Success; 2 * CASES as usize]);
    let stopped = Record { planned: Some(5 * CASES), ..run() };
    let entries = [
        ("fixed".to_owned(), run(), Sampling::Fixed),
        ("gate".to_owned(), run(), Sampling::Sequential),
        ("stopped".to_owned(), stopped, Sampling::Fixed),
    ];
    let found = ranked(&entries);
    let of = |name: &str| found.standings.iter().find(|standing| standing.name == name).unwrap();
    let [fixed, gate, stopped] = ["fixed", "gate", "stopped"].map(of);
    assert_eq!([fixed.sequential, gate.sequential, stopped.sequential], [false, true, true]);
    assert_eq!(gate.success_95, stopped.success_95);
    assert!(gate.success_95[0] < fixed.success_95[0], "{gate:?} {fixed:?}");
}

#[test]
fn clear_leader_is_named() {
    let mut stream = Seed::campaign(1).stream("test");
    let leaders: Vec<_> = (0..10).map(|_| board(&mut stream, &[0.1, 0.95, 0.3]).leader).collect();
    assert!(leaders.iter().all(|leader| leader.as_deref() == Some("policy 1")), "{leaders:?}");
}

#[test]
fn equal_policies_have_no_leader() {
    let mut stream = Seed::campaign(2).stream("test");
    for rates in [&[0.5; 2][..], &[0.9; 4]] {
        let named = (0..100).filter(|_| board(&mut stream, rates).leader.is_some()).count();
        assert!(named <= 5, "a leader is named in {named} of 100 leaderboards of {} equal policies", rates.len());
    }
}

#[test]
fn only_policy_is_no_leader() {
    assert_eq!(board(&mut Seed::campaign(3).stream("test"), &[1.0]).leader, None);
}
