//! The gate with a known budget: its errors for scenarios with unequal rates, and live gates against the recursion.

#[path = "support/recursion.rs"]
mod recursion;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use recursion::{crossing, round};
use robogate_stats::Trials;
use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{RateTest, Schedule, characteristic, characteristics};
use robogate_stats::stratified::Strata;

#[test]
// For a fixed mean, the extreme distributions of a sum of independent results have rates 0, 1 and one other value (Hoeffding
// 1956). No error of theirs exceeds that of equal rates.
fn unequal_rates_do_not_raise_the_error() {
    for (m, rounds, p0) in
        [(30, 10, 0.5), (30, 10, 0.9), (30, 10, 0.08), (50, 12, 0.95), (24, 8, 0.98), (68, 20, 0.02), (68, 20, 0.92)]
    {
        let budget = Budget { per_round: m, rounds };
        let boundary = budget.boundary(p0, 0.05);
        let equal = crossing(&round(m, 0, 0, p0), &boundary);
        assert!(equal <= 0.05 && equal > 0.025, "{m} x {rounds} at {p0}: {equal}");
        for always in (0..m).step_by(3) {
            for never in (0..3).chain((3..m - always).step_by(4)) {
                let others = m - always - never.min(m - always);
                let rate = (m as f64 * p0 - always as f64) / others as f64;
                if others == 0 || always + never >= m || !(0.0..=1.0).contains(&rate) {
                    continue;
                }
                let error = crossing(&round(m, always, never, rate), &boundary);
                assert!(error <= 0.05, "{always} always, {never} never, others {rate}: {error}");
            }
        }
    }
}

fn unit(random: &mut ChaCha8Rng) -> f64 {
    ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

/// Whether the test of "above `limit`" shows it in any round of a live gate, with all parts of the evidence.
fn shown(budget: Budget, rates: &[f64], limit: f64, boundary: &[u64], seed: u64) -> bool {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut strata = Strata::default();
    boundary.iter().any(|needed| {
        let results: Vec<(usize, bool)> = rates.iter().enumerate().map(|(s, p)| (s, unit(&mut random) < *p)).collect();
        strata.round(&results);
        strata.trials().successes() >= *needed || strata.ln_evidence_above(limit) >= (1.0 / (0.4 * 0.05_f64)).ln()
    }) && budget.rounds as usize == boundary.len()
}

#[test]
fn live_gates_keep_the_error() {
    let budget = Budget { per_round: 50, rounds: 20 };
    for (limit, rates) in [
        (0.92, vec![0.92; 50]),
        (0.92, (0..50).map(|i| if i % 2 == 0 { 1.0 } else { 0.84 }).collect()),
        (0.92, (0..50).map(|i| f64::from(u8::from(i < 46))).collect()),
        (0.8, (0..50).map(|i| 0.6 + 0.4 * f64::from(i) / 49.0).collect::<Vec<f64>>()),
    ] {
        let boundary = budget.boundary(limit, 0.05);
        let gates = 4_000;
        let wrong =
            (0..gates).filter(|seed| shown(budget, &rates, limit, &boundary, *seed)).count() as f64 / gates as f64;
        assert!(wrong <= 0.05 + 3.0 * (0.05 * 0.95 / gates as f64).sqrt(), "{limit}: {wrong}");
    }
}

#[test]
fn live_gates_confirm_the_recursion() {
    let budget = Budget { per_round: 68, rounds: 20 };
    for (limit, rate) in [
        (0.5, 0.54),
        (0.7, 0.73),
        (0.8, 0.83),
        (0.9, 0.92),
        (0.92, 0.94),
        (0.92, 0.95),
        (0.95, 0.965),
        (0.97, 0.98),
        (0.98, 0.99),
        (0.99, 0.997),
    ] {
        let test = RateTest { at_least: limit, alpha: 0.05, beta: 1e-9 };
        let exact = characteristic(test, Schedule::Budget(budget), rate).met;
        let boundary = budget.boundary(limit, 0.05);
        let gates = 600;
        let found =
            (0..gates).filter(|seed| shown(budget, &[rate; 68], limit, &boundary, *seed)).count() as f64 / gates as f64;
        let error = 3.5 * (exact * (1.0 - exact) / gates as f64).sqrt() + 0.01;
        assert!((found - exact).abs() <= error, "{limit} at {rate}: {found} live, {exact} exact");
    }
}

#[test]
fn power_is_near_that_of_the_fixed_test() {
    let budget = Budget { per_round: 68, rounds: 20 };
    for limit in [0.5_f64, 0.7, 0.9, 0.92, 0.95, 0.97, 0.98, 0.99] {
        let unit = (limit * (1.0 - limit) / 1_360.0).sqrt();
        let steps = [-4.0, -3.0, -2.5, -2.0, 2.0, 2.5, 3.0, 4.0];
        let steps: Vec<f64> = steps.into_iter().filter(|step| limit + step * unit < 1.0).collect();
        let rates: Vec<f64> = steps.iter().map(|step| limit + step * unit).collect();
        let test = RateTest { at_least: limit, alpha: 0.05, beta: 0.05 };
        let of = |schedule| characteristics(test, schedule, &rates);
        let (gates, fixed) = (of(Schedule::Budget(budget)), of(Schedule::Fixed { n: 1_360 }));
        for ((step, gate), fixed) in steps.into_iter().zip(gates).zip(fixed) {
            let right = |c: robogate_stats::operating::Characteristic| if step > 0.0 { c.met } else { c.violated };
            let share = if limit > 0.98 { 0.93 } else { 0.95 };
            assert!(right(gate) >= share * right(fixed), "{limit} {step}: {} {}", right(gate), right(fixed));
            let most = if step.abs() >= 4.0 { 0.52 } else { 0.83 };
            assert!(gate.trials <= most * 1_360.0, "{limit} {step}: {}", gate.trials);
        }
    }
}

#[test]
fn few_trials_show_nothing() {
    let budget = Budget { per_round: 5, rounds: 2 };
    assert!(budget.boundary(0.99, 0.05).iter().zip([5, 10]).all(|(needed, n)| *needed > n));
    assert!(budget.ln_p(&[Trials::new(5, 5).unwrap()], &[Strata::default()], 0.99) > 0.05_f64.ln());
}
