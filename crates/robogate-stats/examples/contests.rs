//! Writes the figures of `docs/results/contests.md`: error, power and length of the contests in [`robogate_stats::contest`].
//!
//! `cargo run -p robogate-stats --example contests` prints Markdown. Contests of two policies are exact; the others are simulated
//! with fixed seeds.
#![expect(clippy::print_stdout, reason = "an example program prints its result")]

use robogate_stats::contest::{ContestError, Duel, Elimination, Guarantee, Schedule, Truth};

fn main() -> Result<(), ContestError> {
    duels()?;
    trials_of_four()?;
    Ok(())
}

fn duels() -> Result<(), ContestError> {
    println!("| largest | rates | correlation | better shown | worse shown | mean blocks |\n|---|---|---|---|---|---|");
    for blocks in [52, 100] {
        let duel = Duel::new(blocks, 0.05)?;
        for (first, second) in [(0.9, 0.6), (0.95, 0.8), (0.6, 0.6), (0.75, 0.75), (0.9, 0.9)] {
            for correlation in [0.0, 0.3] {
                let found = duel.expected(Truth { first, second, correlation });
                println!(
                    "| {blocks} | {first} / {second} | {correlation} | {:.3} | {:.4} | {:.1} |",
                    found.first_better, found.second_better, found.blocks
                );
            }
        }
    }
    Ok(())
}

fn trials_of_four() -> Result<(), ContestError> {
    println!("\n| guarantee | rates | best alone | best dropped | any best dropped | first after | trials | left |");
    println!("|---|---|---|---|---|---|---|---|");
    for guarantee in [Guarantee::BestStays, Guarantee::NoFalseElimination] {
        let contest = Elimination::new(4, Schedule { per_look: 1, looks: 90 }, guarantee, 0.05)?;
        for rates in [[0.9, 0.6, 0.6, 0.6], [0.95, 0.8, 0.8, 0.8], [0.8, 0.7, 0.6, 0.5], [0.6; 4], [0.9; 4]] {
            let found = contest.expected(&rates, 0.0, 2_000, 1)?;
            println!(
                "| {guarantee:?} | {rates:?} | {:.3} | {:.4} | {:.4} | {:.1} | {:.0} | {:.2} |",
                found.best_alone,
                found.best_dropped,
                found.any_best_dropped,
                found.first_after.unwrap_or(f64::NAN),
                found.trials,
                found.left
            );
        }
    }
    Ok(())
}
