//! Error rates of 10,000 simulated gates whose true rate equals the limit.

use robogate_core::{FailureMode, Seed, Stream};
use robogate_gate::{Ending, Sampling, Verdict};
use robogate_stats::Trials;
use robogate_stats::operating::{Answer, RateTest, Schedule, characteristic};

use crate::common::{failed, judge, requirements, suite};

const CASES: u64 = 68;
const ROUNDS: u64 = 20;
const GATE: RateTest = RateTest { at_least: 0.92, alpha: 0.05, beta: 0.05 };

/// The outcomes of the scenarios of a round.
fn round(stream: &mut Stream, rates: &[f64]) -> u64 {
    rates.iter().map(|rate| u64::from(stream.uniform() < *rate)).sum()
}

/// Runs a gate round by round until it decides. Returns the verdict and the number of rounds.
fn gate(stream: &mut Stream, rates: &[f64]) -> (Answer, u64) {
    let mut successes = 0;
    for done in 1..=ROUNDS {
        successes += round(stream, rates);
        let answer = GATE.look(Trials::new(successes, done * CASES).unwrap());
        if answer != Answer::Open {
            return (answer, done);
        }
    }
    (Answer::Open, ROUNDS)
}

/// Success rates of hard and easy scenarios, half of each, with mean `mean`.
fn unlike(mean: f64) -> Vec<f64> {
    (0..CASES).map(|i| if i % 2 == 0 { 1.0 } else { 2.0 * mean - 1.0 }).collect()
}

#[test]
// At most 5 % of the gates at the limit may pass, and at most 5 % may fail.
fn simulated_error_rates_are_bounded() {
    for (name, rates) in [("alike", vec![0.92; CASES as usize]), ("unlike", unlike(0.92))] {
        let mut stream = Seed::campaign(20_261_121).stream(name);
        let (mut passed, mut failed) = (0, 0);
        for _ in 0..10_000 {
            match gate(&mut stream, &rates).0 {
                Answer::Met => passed += 1,
                Answer::Violated => failed += 1,
                Answer::Open => {}
            }
        }
        // 0.05 of 10,000 is 500. The expected counts are below it by more than three standard errors.
        assert!(passed + 66 <= 500 && failed + 66 <= 500, "{name}: {passed} passed, {failed} failed");
        assert!(passed > 50 && failed > 5, "{name}: the test has no power: {passed} {failed}");
    }
}

#[test]
fn simulation_matches_real_gate() {
    let gate_of_one =
        requirements("name = \"s\"\nmode = \"confidence\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.92\n");
    let mut stream = Seed::campaign(7).stream("agreement");
    let mut early = 0;
    for rate in [0.85, 0.92, 0.97] {
        for _ in 0..20 {
            let mut endings = Vec::new();
            let mut successes = 0;
            let mut answer = Answer::Open;
            for done in 1..=4 {
                for _ in 0..CASES {
                    let good = stream.uniform() < rate;
                    successes += u64::from(good);
                    endings.push(if good { Ending::Success } else { failed(FailureMode::TIMEOUT) });
                }
                let now = GATE.look(Trials::new(successes, done * CASES).unwrap());
                answer = if answer == Answer::Open { now } else { answer };
            }
            let verdict = judge(&gate_of_one, &suite(CASES, endings), Sampling::Sequential).verdict;
            let expected = match answer {
                Answer::Met => Verdict::Pass,
                Answer::Violated => Verdict::Fail,
                Answer::Open => Verdict::Inconclusive,
            };
            // The simulation has the pooled part of the evidence only, so the gate decides no later.
            if expected != Verdict::Inconclusive {
                assert_eq!(verdict, expected);
            } else {
                early += u32::from(verdict != Verdict::Inconclusive);
            }
        }
    }
    assert!(early <= 6, "{early} of 60 gates decide earlier");
}

#[test]
fn sequential_testing_saves_episodes() {
    let schedule = Schedule::Rounds { per_round: CASES, rounds: ROUNDS };
    let budget = (CASES * ROUNDS) as f64;
    for (rate, at_most) in [(1.0, 0.06), (0.98, 0.12), (0.96, 0.30), (0.85, 0.25), (0.70, 0.06)] {
        let exact = characteristic(GATE, schedule, rate);
        assert!(exact.trials <= at_most * budget, "{rate}: {} episodes of {budget}", exact.trials);
        let mut stream = Seed::campaign(11).stream("saved");
        let rates = vec![rate; CASES as usize];
        let taken: u64 = (0..1_000).map(|_| gate(&mut stream, &rates).1 * CASES).sum();
        let mean = taken as f64 / 1_000.0;
        assert!((mean / exact.trials - 1.0).abs() < 0.1, "{rate}: {mean} simulated, {} exact", exact.trials);
    }
}
