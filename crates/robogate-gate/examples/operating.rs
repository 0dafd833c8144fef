//! Prints how many episodes sequential testing saves, as a Markdown table.
#![expect(clippy::print_stdout, reason = "an example that prints")]

use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{RateTest, Schedule, characteristic};

/// The smallest fixed number of episodes, in complete rounds, at which the exact test passes with probability `power`.
fn fixed(test: RateTest, p: f64, power: f64) -> Option<u64> {
    (1..=200).map(|rounds| 68 * rounds).find(|n| characteristic(test, Schedule::Fixed { n: *n }, p).met >= power)
}

fn main() {
    let test = RateTest { at_least: 0.92, alpha: 0.05, beta: 0.05 };
    let rounds = Schedule::Budget(Budget { per_round: 68, rounds: 20 });
    println!("| true rate | pass | fail | open | expected episodes | of 1,360 saved | fixed number with that power |");
    println!("|---:|---:|---:|---:|---:|---:|---:|");
    for p in [1.0, 0.99, 0.98, 0.97, 0.96, 0.95, 0.94, 0.92, 0.90, 0.88, 0.85, 0.80] {
        let c = characteristic(test, rounds, p);
        let same = if c.met > 0.05 { fixed(test, p, c.met.min(0.999)) } else { None };
        println!(
            "| {p:.2} | {:.1} % | {:.1} % | {:.1} % | {:.0} | {:.0} % | {} |",
            100.0 * c.met,
            100.0 * c.violated,
            100.0 * c.open,
            c.trials,
            100.0 * (1.0 - c.trials / 1360.0),
            same.map_or_else(|| "-".to_owned(), |n| n.to_string())
        );
    }
}
