//! Errors of the decision, also where an operator who knows the policies declares trials invalid.

use robogate_core::{Seed, Stream};
use robogate_trial::{BlockResults, Judge, Question, Secret, Verdict};

use crate::plan;

/// Studies without an effect, and the share in which one of the policies wins. An attacker declares `share` of the failures of the
/// first policy invalid before they end, and lets them be repeated.
fn wins(judge: &Judge, arms: usize, blocks: usize, rate: f64, share: f64, studies: u64) -> f64 {
    let mut wins = 0;
    for study in 0..studies {
        let stream = &mut Seed::campaign(7).episode(study).stream("attack");
        let mut results: Vec<BlockResults> = Vec::new();
        let mut dropped = vec![false; arms];
        while results.len() < blocks {
            let mut block =
                BlockResults { success: vec![None; arms], repeated: vec![0; arms], first: vec![None; arms] };
            for arm in (0..arms).filter(|arm| !dropped[*arm]) {
                let run = |stream: &mut Stream| stream.uniform() < rate;
                let mut success = run(stream);
                while arm == 0 && !success && stream.uniform() < share {
                    block.repeated[arm] += 1;
                    success = run(stream);
                }
                block.success[arm] = Some(success);
            }
            results.push(block);
            let decision = judge.decision(&results);
            dropped.clone_from(&decision.dropped);
            if decision.is_final() {
                wins += u64::from(matches!(decision.answer, Verdict::Best(_) | Verdict::Pass));
                break;
            }
        }
    }
    wins as f64 / studies as f64
}

#[test]
fn invalid_failures_win_nothing() {
    let secret = Secret::draw().unwrap();
    let judge = Judge::new(&plan(Question::Better, &["a", "b"], 60, &secret)).unwrap();
    for (rate, share) in [(0.7, 0.8), (0.7, 1.0), (0.9, 0.8), (0.5, 0.5), (0.7, 0.0)] {
        let wins = wins(&judge, 2, 60, rate, share, 1_000);
        assert!(wins <= 0.06, "rate {rate}, {share} of the failures invalid: {wins}");
    }
    let limit = Judge::new(&plan(Question::AtLeast(0.8), &["a"], 60, &secret)).unwrap();
    let wins = wins(&limit, 1, 60, 0.8, 0.8, 1_000);
    assert!(wins <= 0.06, "limit: {wins}");
}

/// The same data without the rule, so that the test above is known to see the attack.
#[test]
fn attack_works_without_the_rule() {
    let secret = Secret::draw().unwrap();
    let judge = Judge::new(&plan(Question::Better, &["a", "b"], 60, &secret)).unwrap();
    let mut wins = 0;
    for study in 0..200 {
        let stream = &mut Seed::campaign(8).episode(study).stream("attack");
        let mut results = Vec::new();
        for _ in 0..60 {
            let lucky = 0.7 / (1.0 - 0.3 * 0.8);
            let success = vec![Some(stream.uniform() < lucky), Some(stream.uniform() < 0.7)];
            results.push(BlockResults { success, repeated: vec![0; 2], first: vec![None; 2] });
            let decision = judge.decision(&results);
            if decision.is_final() {
                wins += u64::from(decision.answer == Verdict::Best(0));
                break;
            }
        }
    }
    assert!(wins > 60, "{wins} of 200");
}

/// Failures that are corrected to successes gain nothing: the test counts the first result against the claim.
#[test]
fn corrections_do_not_win() {
    let secret = Secret::draw().unwrap();
    let judge = Judge::new(&plan(Question::Better, &["a", "b"], 60, &secret)).unwrap();
    let mut wins = 0;
    for study in 0..200 {
        let stream = &mut Seed::campaign(8).episode(study).stream("corrections");
        let mut results = Vec::new();
        for _ in 0..60 {
            let [a, b] = [0, 1].map(|_| stream.uniform() < 0.7);
            let corrected = !a && stream.uniform() < 0.8;
            let success = vec![Some(a || corrected), Some(b)];
            results.push(BlockResults { success, repeated: vec![0; 2], first: vec![corrected.then_some(false), None] });
            let decision = judge.decision(&results);
            if decision.is_final() {
                wins += u64::from(decision.answer == Verdict::Best(0));
                break;
            }
        }
    }
    assert!(wins <= 10, "{wins} of 200");
}

#[test]
fn best_of_four_is_found() {
    let secret = Secret::draw().unwrap();
    let judge = Judge::new(&plan(Question::Best, &["a", "b", "c", "d"], 90, &secret)).unwrap();
    let (mut right, mut lost, mut trials) = (0, 0, 0);
    for study in 0..100 {
        let stream = &mut Seed::campaign(9).episode(study).stream("best");
        let (mut results, mut dropped) = (Vec::new(), vec![false; 4]);
        while results.len() < 90 {
            let rates = [0.6, 0.9, 0.6, 0.6];
            let mut run = |arm: usize| (!dropped[arm]).then(|| stream.uniform() < rates[arm]);
            let success: Vec<Option<bool>> = (0..4).map(&mut run).collect();
            trials += success.iter().flatten().count();
            results.push(BlockResults { success, repeated: vec![0; 4], first: vec![None; 4] });
            let decision = judge.decision(&results);
            dropped = decision.dropped.clone();
            if decision.is_final() {
                right += u64::from(decision.answer == Verdict::Best(1));
                lost += u64::from(decision.dropped[1]);
                break;
            }
        }
    }
    assert!(right >= 75 && lost <= 5, "right {right}, best eliminated {lost}");
    assert!(trials <= 100 * 230, "{} trials on average", trials / 100);
}

/// The figures of docs/results/trials.md.
#[test]
#[ignore = "takes minutes"]
fn attacks_on_many_studies() {
    let secret = Secret::draw().unwrap();
    let judge = Judge::new(&plan(Question::Better, &["a", "b"], 100, &secret)).unwrap();
    for (rate, share) in [(0.7, 0.0), (0.7, 0.4), (0.7, 0.8), (0.7, 1.0), (0.9, 0.8), (0.5, 0.8)] {
        let wins = wins(&judge, 2, 100, rate, share, 5_000);
        println!("two policies, rate {rate}, {share} of the failures invalid: {wins}");
        assert!(wins <= 0.056);
    }
    let limit = Judge::new(&plan(Question::AtLeast(0.8), &["a"], 100, &secret)).unwrap();
    for share in [0.0, 0.8] {
        let wins = wins(&limit, 1, 100, 0.8, share, 5_000);
        println!("limit 0.8, {share} of the failures invalid: {wins}");
        assert!(wins <= 0.056);
    }
}
