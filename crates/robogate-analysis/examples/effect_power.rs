//! How often reports name effects: `cargo run --release -p robogate-analysis --example effect_power [-- REPORTS]`.
//!
//! Laws of success over parameters that are sampled uniformly, with the test of the report, a permutation test of any shape alone (the
//! scan of success counts), and a logistic regression with products of pairs alone. All are corrected to the same error for
//! the same family. Seeds are fixed. `docs/results/effect-power.md` has the figures.

#![expect(clippy::unwrap_used, reason = "a simulation that cannot run should stop")]
#![expect(clippy::print_stdout, reason = "the table is the result")]

#[path = "../tests/it/episodes.rs"]
mod episodes;
#[path = "../tests/it/named.rs"]
mod named;

use std::path::Path;
use std::sync::Arc;

use episodes::{entry, unit, write};
use named::named;
use robogate_analysis::{Analysis, AnalysisOptions, LEVEL, Source};
use robogate_core::{FailureMode, Outcome, ParameterSpace};
use robogate_stats::Trials;
use robogate_stats::logistic::{Data, Options, fit, standardized};
use robogate_stats::multiplicity::holm;
use robogate_stats::scan::{Order, scan};

/// A law of success, and the parameters that have an effect.
struct Law {
    name: &'static str,
    rate: fn(&[f64]) -> f64,
    effects: &'static [usize],
}

const NAMES: [&str; 5] = ["delay_ms", "mass_kg", "friction", "noise_m", "offset_m"];

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Success falls with delay from 0.97 to 0.58, and a heavy object slips if friction is low.
fn cell(x: &[f64]) -> f64 {
    let held = logistic(6.0 * (x[2] - x[1]) + 4.0);
    (0.97 - 0.39 * x[0]) * held
}

const LAWS: [Law; 7] = [
    Law { name: "delay; mass and friction", rate: cell, effects: &[0, 1, 2] },
    Law { name: "nothing, rate 0.8", rate: |_| 0.8, effects: &[] },
    Law { name: "nothing, rate 0.97", rate: |_| 0.97, effects: &[] },
    Law { name: "step at 0.7", rate: |x| if x[1] > 0.7 { 0.65 } else { 0.9 }, effects: &[1] },
    Law { name: "band of a fifth", rate: |x| if (0.4..0.6).contains(&x[1]) { 0.55 } else { 0.9 }, effects: &[1] },
    Law { name: "valley", rate: |x| 0.95 - 1.6 * (x[1] - 0.5).powi(2), effects: &[1] },
    Law { name: "two curves", rate: |x| logistic(3.0 - 2.5 * x[0] * x[0] - 1.5 * x[1]), effects: &[0, 1] },
];

struct Rows {
    x: Vec<Vec<f64>>,
    success: Vec<bool>,
}

fn sampled(law: &Law, seed: u64, n: u64) -> Rows {
    let at = |i: u64| (0..NAMES.len() as u64).map(|p| unit((seed + 1) * 1_000_003 + i, p + 1)).collect::<Vec<f64>>();
    let x: Vec<Vec<f64>> = (0..n).map(at).collect();
    let draw = |(i, x): (usize, &Vec<f64>)| unit((seed + 1) * 1_000_003 + i as u64, 99) < (law.rate)(x);
    let success = x.iter().enumerate().map(draw).collect();
    Rows { x, success }
}

/// The names of a report.
fn reported(rows: &Rows) -> Vec<String> {
    use std::fmt::Write;
    let mut toml = "name = \"five\"\n".to_owned();
    for name in NAMES {
        write!(toml, "[[parameter]]\nkind = \"continuous\"\nname = \"{name}\"\nlow = 0.0\nhigh = 1.0\n").unwrap();
    }
    let space = ParameterSpace::from_toml(&toml).unwrap();
    let row = |(i, (x, success)): (usize, (&Vec<f64>, &bool))| {
        let value =
            |(p, u): (&robogate_core::Parameter, &f64)| (Arc::clone(&p.name), p.domain.decode(p.domain.from_unit(*u)));
        let requested = space.parameters().iter().zip(x).map(value).collect();
        let failed = Outcome::Failure(FailureMode::constant("grasp_miss"));
        entry(i as u64, requested, if *success { Outcome::Success } else { failed })
    };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write(&path, &space, rows.x.iter().zip(&rows.success).enumerate().map(row).collect());
    let options = AnalysisOptions { models: false, ..AnalysisOptions::default() };
    named(&Analysis::with(&Source::open(&path).unwrap(), Path::new("x.parquet"), &options).unwrap())
}

/// The parameters that a scan of counts names, with Holm over all parameters.
fn scanned(rows: &Rows, seed: u64) -> Vec<usize> {
    let p = |at: usize| {
        let mut cells = vec![(0, 0); 50];
        for (x, success) in rows.x.iter().zip(&rows.success) {
            let cell = &mut cells[(x[at] * 50.0) as usize];
            *cell = (cell.0 + u64::from(*success), cell.1 + 1);
        }
        let trials: Vec<Trials> = cells.into_iter().map(|(k, n)| Trials::new(k, n).unwrap()).collect();
        scan(&trials, Order::Ordered, 4_000, seed).map_or(1.0, |found| found.p.min(1.0))
    };
    let adjusted = holm(&(0..NAMES.len()).map(p).collect::<Vec<_>>()).unwrap();
    (0..NAMES.len()).filter(|at| adjusted[*at] <= LEVEL).collect()
}

/// The parameters that a logistic regression with all products names: by themselves or in a product, with Holm over all terms.
fn regressed(rows: &Rows) -> Vec<usize> {
    let column = |at: usize| standardized(&rows.x.iter().map(|x| x[at]).collect::<Vec<_>>()).unwrap();
    let main: Vec<Vec<f64>> = (0..NAMES.len()).map(column).collect();
    let mut columns = main.clone();
    let mut of: Vec<Vec<usize>> = (0..NAMES.len()).map(|at| vec![at]).collect();
    for first in 0..NAMES.len() {
        for second in first + 1..NAMES.len() {
            columns.push(main[first].iter().zip(&main[second]).map(|(a, b)| a * b).collect());
            of.push(vec![first, second]);
        }
    }
    let slices: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let Ok(found) = Data::new(&slices, &rows.success, None).and_then(|data| fit(data, Options::default())) else {
        return Vec::new();
    };
    let p: Vec<f64> = found.terms.iter().map(|term| term.coefficient().map_or(1.0, |c| c.p())).collect();
    let adjusted = holm(&p).unwrap();
    let kept = adjusted.iter().zip(&of).filter(|(p, _)| **p <= LEVEL).flat_map(|(_, of)| of.clone());
    let mut kept: Vec<usize> = kept.collect();
    kept.sort_unstable();
    kept.dedup();
    kept
}

fn main() {
    let reports: u64 = std::env::args().nth(1).map_or(200, |word| word.parse().unwrap());
    println!("| law | episodes | report | scan alone | regression with pairs alone | report names something else |");
    println!("|---|---|---|---|---|---|");
    for n in [200, 1_000, 100, 500, 3_000] {
        for law in &LAWS {
            let mut counts = [[0_u64; NAMES.len()]; 3];
            let mut false_names = 0;
            for seed in 0..reports {
                let rows = sampled(law, seed, n);
                let names = reported(&rows);
                let of_report = (0..NAMES.len()).filter(|at| names.iter().any(|name| name == NAMES[*at])).collect();
                for (counts, named) in counts.iter_mut().zip([of_report, scanned(&rows, seed), regressed(&rows)]) {
                    named.iter().for_each(|at: &usize| counts[*at] += 1);
                }
                let other = |at: &usize| !law.effects.contains(at) && names.iter().any(|name| name == NAMES[*at]);
                false_names += u64::from((0..NAMES.len()).any(|at| other(&at)));
            }
            let share = |k: u64| format!("{:.0} %", 100.0 * k as f64 / reports as f64);
            let of = |counts: &[u64; NAMES.len()]| {
                let named: Vec<String> = law.effects.iter().map(|at| share(counts[*at])).collect();
                if named.is_empty() { "-".to_owned() } else { named.join(", ") }
            };
            let [report, scan, regression] = counts.each_ref().map(of);
            println!("| {} | {n} | {report} | {scan} | {regression} | {} |", law.name, share(false_names));
        }
    }
}
