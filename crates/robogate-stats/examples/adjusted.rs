//! Coverage of the interval with known distributions, and the episodes that it saves: `cargo run -p robogate-stats
//! --example adjusted [-- SETS]`.
//!
//! Five uniform parameters, as a Latin hypercube and as independent points. Deterministic: the same number of sets prints
//! the same table.

#![expect(clippy::unwrap_used, reason = "a simulation that cannot run should stop")]
#![expect(clippy::print_stdout, reason = "the table is the result")]

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::adjusted::{Control, ROWS_PER_COEFFICIENT, adjusted};
use robogate_stats::{Confidence, Trials, wilson};

const PARAMETERS: usize = 5;

type Law = fn(&[f64]) -> f64;

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

const LAWS: [(&str, Law); 8] = [
    ("no effect, rate 0.3", |_| 0.3),
    ("no effect, rate 0.9", |_| 0.9),
    ("weak: two parameters", |x| logistic(1.0 + x[0] - x[1])),
    ("weak: five parameters, rate 0.9", |x| logistic(2.0 + x.iter().sum::<f64>() - 2.5)),
    ("strong: two parameters", |x| logistic(12.0 * x[0] - 8.0 * x[1])),
    ("strong, rate 0.85", |x| logistic(3.0 + 12.0 * x[0] - 8.0 * x[1])),
    ("strong: a box", |x| if x[0] > 0.3 && x[1] < 0.8 { 0.97 } else { 0.3 }),
    ("strong: a steep threshold", |x| logistic(60.0 * (x[0] - 0.35))),
];

fn main() {
    let sets: usize = std::env::args().nth(1).map_or(4_000, |word| word.parse().unwrap());
    println!(
        "{sets} sets for each row. The standard deviation of a coverage of 95 % is {:.2} %.",
        100.0 * (0.0475 / sets as f64).sqrt()
    );
    println!(
        "| law | points | episodes | coverage | Wilson's coverage | independent episodes of the same precision | saved |"
    );
    println!("|---|---|---:|---:|---:|---:|---:|");
    for (name, law) in LAWS {
        let mut rng = ChaCha8Rng::seed_from_u64(2026);
        let mut truth = 0.0;
        for _ in 0..1_600_000 {
            let at: Vec<f64> = (0..PARAMETERS).map(|_| uniform(&mut rng)).collect();
            truth += law(&at) / 1_600_000.0;
        }
        for latin in [true, false] {
            for n in [600, 2_000] {
                let (mut done, mut covered, mut plain, mut effective) = (0_u32, 0, 0, 0.0);
                for _ in 0..sets {
                    let points = points(&mut rng, n, latin);
                    let outcomes: Vec<bool> = (0..n)
                        .map(|i| {
                            let at: Vec<f64> = points.iter().map(|column| column[i]).collect();
                            uniform(&mut rng) < law(&at)
                        })
                        .collect();
                    // As many knots as the analysis uses.
                    let knots = (n / (2 * ROWS_PER_COEFFICIENT) / PARAMETERS + 1).clamp(2, 8);
                    let controls: Vec<Control> = points.into_iter().map(|at| Control::Uniform { at, knots }).collect();
                    // Too few episodes of the rarer outcome: reports have no such interval then.
                    let Ok(found) = adjusted(&controls, &outcomes, Confidence::P95) else { continue };
                    done += 1;
                    covered += u32::from(found.interval.contains(truth));
                    effective += found.effective;
                    let trials = Trials::count(outcomes.iter().copied());
                    plain += u32::from(wilson(trials, Confidence::P95).contains(truth));
                }
                let effective = effective / f64::from(done);
                let share = |count: u32| format!("{:.1} %", 100.0 * f64::from(count) / f64::from(done));
                println!(
                    "| {name} | {} | {n} | {} | {} | {effective:.0} | {:.0} % |",
                    if latin { "Latin hypercube" } else { "independent" },
                    share(covered),
                    share(plain),
                    100.0 * (1.0 - n as f64 / effective)
                );
            }
        }
    }
}

fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    ((rng.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

fn shuffle(rng: &mut ChaCha8Rng, cells: &mut [usize]) {
    for last in (1..cells.len()).rev() {
        cells.swap(last, (uniform(rng) * (last + 1) as f64) as usize);
    }
}

/// A point set: a Latin hypercube, or independent points.
fn points(rng: &mut ChaCha8Rng, n: usize, latin: bool) -> Vec<Vec<f64>> {
    let column = |_| {
        if !latin {
            return (0..n).map(|_| uniform(rng)).collect();
        }
        let mut cells: Vec<usize> = (0..n).collect();
        shuffle(rng, &mut cells);
        cells.into_iter().map(|cell| (cell as f64 + uniform(rng)) / n as f64).collect()
    };
    (0..PARAMETERS).map(column).collect()
}
