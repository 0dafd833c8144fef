use robogate_core::{FailureMode, Seed, Stream};
use robogate_gate::{Ending, Leaderboard, Metric, ScoreTerm, Scoring};

use crate::common::{failed, suite};

const CASES: u64 = 24;

fn board(stream: &mut Stream, rates: &[f64]) -> Leaderboard {
    let success = ScoreTerm {
        name: "Success".to_owned(),
        metric: Metric::Success,
        category: None,
        weight: 1.0,
        scoring: Scoring::Linear { full_at: 1.0 },
    };
    let mut entries = Vec::new();
    for (i, rate) in rates.iter().enumerate() {
        let endings: Vec<Ending> = (0..CASES)
            .map(|_| match stream.uniform() < *rate {
                true => Ending::Success,
                false => failed(FailureMode::constant("timeout")),
            })
            .collect();
        entries.push((format!("policy {i}"), suite(CASES, endings)));
    }
    Leaderboard::of(&entries, &[success], None).unwrap()
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
