//! Power and episodes of a gate of 20 rounds of 68: `cargo run --release -p robogate-stats --example gate_power`.
//!
//! Exact operating characteristics by recursion, for equal rates of the scenarios, beside the fixed-size test of the same budget
//! and Wald's bound. `docs/results/gate-power.md` has the figures.

#![expect(clippy::print_stdout, reason = "the table is the result")]

use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{RateTest, Schedule, characteristics};

const BUDGET: Budget = Budget { per_round: 68, rounds: 20 };

fn main() {
    let most = (BUDGET.per_round * BUDGET.rounds) as f64;
    println!(
        "| limit | true rate | standard errors | fixed decides | gate decides | share | e-process decides | episodes / budget | Wald / budget |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for limit in [0.5, 0.6, 0.7, 0.8, 0.9, 0.92, 0.95, 0.97, 0.98, 0.99] {
        let test = RateTest { at_least: limit, alpha: 0.05, beta: 0.05 };
        let unit = (limit * (1.0 - limit) / most).sqrt();
        let steps = [-8.0, -4.0, -3.0, -2.5, -2.0, 2.0, 2.5, 3.0, 4.0, 8.0];
        let rates: Vec<(f64, f64)> =
            steps.iter().map(|step| (*step, limit + step * unit)).filter(|(_, p)| *p > 0.0 && *p < 1.0).collect();
        let values: Vec<f64> = rates.iter().map(|(_, p)| *p).chain([limit]).collect();
        let of = |schedule| characteristics(test, schedule, &values);
        let gate = of(Schedule::Budget(BUDGET));
        let evidence = of(Schedule::Rounds { per_round: BUDGET.per_round, rounds: BUDGET.rounds });
        let fixed = of(Schedule::Fixed { n: BUDGET.per_round * BUDGET.rounds });
        for (at, (step, p)) in rates.iter().enumerate() {
            let right = |c: &robogate_stats::operating::Characteristic| if *step > 0.0 { c.met } else { c.violated };
            // Wald's bound of the mean number of episodes at errors 5 % and 1 - the power of the gate.
            let (miss, alpha) = ((1.0 - right(&gate[at])).clamp(1e-9, 0.999), 0.05);
            let gain = (1.0 - miss) * ((1.0 - miss) / alpha).ln() + miss * (miss / (1.0 - alpha)).ln();
            let apart = p * (p / limit).ln() + (1.0 - p) * ((1.0 - p) / (1.0 - limit)).ln();
            println!(
                "| {limit} | {p:.4} | {step:+} | {:.3} | {:.3} | {:.3} | {:.3} | {:.2} | {:.2} |",
                right(&fixed[at]),
                right(&gate[at]),
                right(&gate[at]) / right(&fixed[at]),
                right(&evidence[at]),
                gate[at].trials / most,
                (gain / apart / most).min(1.0)
            );
        }
        if let Some(at_limit) = gate.last() {
            println!(
                "| {limit} | {limit} | 0 | | error {:.4} / {:.4} | | | {:.2} | |",
                at_limit.met,
                at_limit.violated,
                at_limit.trials / most
            );
        }
    }
}
