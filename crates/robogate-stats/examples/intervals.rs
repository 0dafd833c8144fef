//! How often intervals of a crossing contain it, how often the AUC of noise differs significantly from 0.5, and how exact subset simulation
//! is on problems with known answers. Prints the tables of `docs/results/risk-model.md` and `docs/results/rare.md`.
//!
//! Usage: `intervals crossing|auc|rare [REPETITIONS]`

#![expect(clippy::print_stdout, reason = "an example prints its results")]

use std::convert::Infallible;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::Confidence;
use robogate_stats::binning::Edges;
use robogate_stats::logistic::{Data, Options, RegressionError, fit};
use robogate_stats::rare::{EVENT, Plan, Point, points_per_level, subset};
use robogate_stats::roc::{RocError, cross_validate, stratified_folds};
use robogate_stats::threshold::{Threshold, ThresholdOptions, threshold};

/// A margin of a point.
type Margin = dyn Fn(&[f64]) -> f64;

fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

type Law = fn(f64) -> f64;
const LAWS: [(&str, Law, f64); 7] = [
    ("jump .93 to .3", |x| if x < 0.63 { 0.93 } else { 0.3 }, 0.63),
    ("jump .98 to .02", |x| if x < 0.41 { 0.98 } else { 0.02 }, 0.41),
    ("jump .7 to .4", |x| if x < 0.53 { 0.7 } else { 0.4 }, 0.53),
    ("jump, sloped sides", |x| if x < 0.63 { 0.95 - 0.2 * x } else { 0.4 - 0.3 * x }, 0.63),
    ("steep curve", |x| 1.0 / (1.0 + (40.0 * (x - 0.6)).exp()), 0.6),
    ("curve", |x| 1.0 / (1.0 + (8.0 * (x - 0.6)).exp()), 0.6),
    ("line", |x| 0.95 - 0.75 * x, 0.6),
];

fn crossing(repetitions: u64) {
    println!("| law | rows | contains the crossing | median length |");
    println!("|---|---|---|---|");
    for (name, law, truth) in LAWS {
        for rows in [200, 500, 2000] {
            let (mut inside, mut lengths) = (0, Vec::new());
            for seed in 0..repetitions {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let x: Vec<f64> = (0..rows).map(|_| uniform(&mut rng)).collect();
                let y: Vec<bool> = x.iter().map(|x| uniform(&mut rng) < law(*x)).collect();
                let Ok(edges) = Edges::equal_count(&x, (rows / 50).clamp(4, 20)) else { continue };
                let Ok(found) = threshold(&x, &y, None, None, &edges, ThresholdOptions::default()) else { continue };
                // An end outside the range, and no crossing at all, leave the range on that side.
                let (low, high) = match found.threshold {
                    Threshold::Crosses { low, high, .. } => (low.unwrap_or(0.0), high.unwrap_or(1.0)),
                    Threshold::CrossesMoreThanOnce { .. } => continue,
                    Threshold::DoesNotCross { .. } => (0.0, 1.0),
                };
                inside += usize::from(low <= truth && truth <= high);
                lengths.push(high - low);
            }
            lengths.sort_by(f64::total_cmp);
            let share = 100.0 * inside as f64 / lengths.len() as f64;
            println!("| {name} | {rows} | {share:.1} % | {:.3} |", lengths[lengths.len() / 2]);
        }
    }
}

/// An error of a fit or of an AUC.
struct Failed;
impl From<RocError> for Failed {
    fn from(_: RocError) -> Self {
        Self
    }
}
impl From<RegressionError> for Failed {
    fn from(_: RegressionError) -> Self {
        Self
    }
}

fn noise(repetitions: u64) {
    println!("| columns | rows | success rate | interval excludes 0.5 |");
    println!("|---|---|---|---|");
    for width in [1, 3, 8] {
        for (rows, rate) in [(100, 0.5), (300, 0.8), (1000, 0.5), (1000, 0.95)] {
            let (mut outside, mut all) = (0_usize, 0_usize);
            for seed in 0..repetitions {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let columns: Vec<Vec<f64>> =
                    (0..width).map(|_| (0..rows).map(|_| uniform(&mut rng)).collect()).collect();
                let y: Vec<bool> = (0..rows).map(|_| uniform(&mut rng) < rate).collect();
                let folds = stratified_folds(&y, None, 5, 0);
                let take = |of: &[usize]| -> Vec<Vec<f64>> {
                    columns.iter().map(|column| of.iter().map(|row| column[*row]).collect()).collect()
                };
                let found = cross_validate::<Failed>(&y, None, &folds, Confidence::P95, |train, test| {
                    let (own, other) = (take(train), take(test));
                    let success: Vec<bool> = train.iter().map(|row| y[*row]).collect();
                    let views: Vec<&[f64]> = own.iter().map(Vec::as_slice).collect();
                    let model = fit(Data::new(&views, &success, None)?, Options::default())?;
                    let views: Vec<&[f64]> = other.iter().map(Vec::as_slice).collect();
                    Ok(model.probabilities(&views).unwrap_or_default())
                });
                if let Ok(found) = found {
                    all += 1;
                    outside += usize::from(!found.interval.contains(0.5));
                }
            }
            println!("| {width} | {rows} | {rate} | {:.1} % |", 100.0 * outside as f64 / all.max(1) as f64);
        }
    }
}

fn four_branch(u: &[f64]) -> f64 {
    let (x, y, s) = (u[0], u[1], 2.0_f64.sqrt());
    let a = 3.0 + 0.1 * (x - y).powi(2);
    (a - (x + y) / s).min(a + (x + y) / s).min(x - y + 7.0 / s).min(y - x + 7.0 / s)
}

fn himmelblau(u: &[f64]) -> f64 {
    let (a, b) = (0.75 * u[0] - 0.5, 0.75 * u[1] - 1.5);
    (a * a / 1.81 + b / 1.81 - 11.0).powi(2) + (a / 1.81 + b * b / 1.81 - 7.0).powi(2) - 95.0
}

fn metaball(u: &[f64]) -> f64 {
    let (x, y) = (u[0], u[1]);
    30.0 / ((4.0 * (x + 2.0).powi(2) / 9.0 + y * y / 25.0).powi(2) + 1.0)
        + 20.0 / (((x - 2.5).powi(2) / 4.0 + (y - 0.5).powi(2) / 25.0).powi(2) + 1.0)
        - 5.0
}

fn rare(repetitions: u64) {
    let linear = |beta: f64| move |u: &[f64]| beta - u.iter().sum::<f64>() / (u.len() as f64).sqrt();
    let (at_3, at_6) = (3.090_232_306_167_814, 4.753_424_308_822_899);
    // The probabilities of the curved events are sums over a grid of 6,000 x 6,000 points (prototype `exact2d`).
    let problems: [(&str, usize, f64, Box<Margin>); 7] = [
        ("linear", 2, 1e-3, Box::new(linear(at_3))),
        ("linear", 2, 1e-6, Box::new(linear(at_6))),
        ("linear", 100, 1e-3, Box::new(linear(at_3))),
        ("linear", 100, 1e-6, Box::new(linear(at_6))),
        ("four branches", 2, 0.0, Box::new(four_branch)),
        ("Himmelblau", 2, 0.0, Box::new(himmelblau)),
        ("metaball", 2, 1.1283e-5, Box::new(metaball)),
    ];
    println!(
        "| problem | dimensions | probability | RMS error | mean of the stated variation | bias | within 30 % | evaluations |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (name, dimensions, mut exact, margin) in problems {
        if exact == 0.0 {
            exact = on_a_grid(&margin);
        }
        let (mut square, mut bias, mut stated, mut near, mut evaluations) = (0.0, 0.0, 0.0, 0, 0);
        for seed in 0..repetitions {
            let plan = Plan { dimensions, draws: false, points: points_per_level(10_000, exact), budget: 10_000, seed };
            let Ok(run) = subset(plan, |points: &[Point]| {
                Ok::<_, Infallible>(
                    points.iter().map(|point| margin(&point.u)).map(|m| if m <= 0.0 { EVENT } else { m }).collect(),
                )
            });
            let error = run.probability / exact - 1.0;
            square += error * error;
            bias += error;
            stated += run.variation.unwrap_or(1.0);
            near += u32::from(error.abs() < 0.3);
            evaluations += run.evaluations;
        }
        let n = repetitions as f64;
        println!(
            "| {name} | {dimensions} | {exact:.4e} | {:.3} | {:.3} | {:+.3} | {:.2} | {} |",
            (square / n).sqrt(),
            stated / n,
            bias / n,
            f64::from(near) / n,
            evaluations / repetitions as usize
        );
    }
}

/// The probability of a margin up to 0 in two dimensions, as a sum over a grid.
fn on_a_grid(margin: &dyn Fn(&[f64]) -> f64) -> f64 {
    let (cells, reach) = (4_000, 8.0_f64);
    let place = |i: i32| (f64::from(i) + 0.5) / f64::from(cells) * 2.0 * reach - reach;
    let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt() * 2.0 * reach / f64::from(cells);
    let row = |i: i32| {
        let inside = (0..cells).filter(|j| margin(&[place(i), place(*j)]) <= 0.0);
        density(place(i)) * inside.map(|j| density(place(j))).sum::<f64>()
    };
    (0..cells).map(row).sum()
}

fn main() {
    let argument = |at| std::env::args().nth(at);
    let repetitions = |default| argument(2).and_then(|text| text.parse().ok()).unwrap_or(default);
    match argument(1).as_deref() {
        Some("crossing") => crossing(repetitions(400)),
        Some("auc") => noise(repetitions(400)),
        Some("rare") => rare(repetitions(30)),
        _ => println!("usage: intervals crossing|auc|rare [REPETITIONS]"),
    }
}
