//! How often intervals of production figures contain the truth, and how many pairs show a difference of two policies by stages and by success.
//! Prints the tables of `docs/results/production.md`.
//!
//! Usage: `production [REPETITIONS]`

#![expect(clippy::print_stdout, reason = "an example prints its results")]

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::renewal::{event_rate, median_run, reward_rate};
use robogate_stats::survival::{kaplan_meier, quantile_time, tolerance_interval};
use robogate_stats::{Confidence, Trials, clopper_pearson};

/// The time limit of a cycle.
const LIMIT: f64 = 15.0;

fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A cell: the rate of drops, which end early, and the mean of the exponential part of the time to success.
#[derive(Clone, Copy)]
struct Cell {
    name: &'static str,
    drops: f64,
    mean: f64,
}

impl Cell {
    /// Duration and success of a cycle: 4 s and an exponential time until success, cut at the limit.
    fn cycle(self, rng: &mut ChaCha8Rng) -> (f64, bool) {
        let time = 4.0 - self.mean * (1.0 - uniform(rng)).ln();
        if uniform(rng) < self.drops { (2.0 + 2.0 * uniform(rng), false) } else { (time.min(LIMIT), time < LIMIT) }
    }

    /// Success rate, units per second, and seconds between failures.
    fn truth(self) -> (f64, f64, f64) {
        let late = (-(LIMIT - 4.0) / self.mean).exp();
        let success = (1.0 - self.drops) * (1.0 - late);
        let time = self.drops * 3.0 + (1.0 - self.drops) * (4.0 + self.mean * (1.0 - late));
        (success, success / time, time / (1.0 - success))
    }

    /// A quantile of the time to success if nothing ended an episode before.
    fn quantile(self, q: f64) -> f64 {
        4.0 - self.mean * (1.0 - q).ln()
    }
}

const CELLS: [Cell; 3] = [
    Cell { name: "good cell", drops: 0.02, mean: 2.0 },
    Cell { name: "slow cell", drops: 0.02, mean: 6.0 },
    Cell { name: "drops", drops: 0.25, mean: 2.0 },
];

fn coverage(repetitions: u64) {
    println!(
        "| cell | cycles | units per hour | cycles between failures | time between assists | longest run | median | 90 % quantile | tolerance |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for cell in CELLS {
        let (success, per_second, between) = cell.truth();
        for n in [50, 200, 1000] {
            let mut inside = [0_u32; 7];
            for seed in 0..repetitions {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let cycles: Vec<(f64, bool)> = (0..n).map(|_| cell.cycle(&mut rng)).collect();
                let times: Vec<f64> = cycles.iter().map(|c| c.0).collect();
                let units: Vec<f64> = cycles.iter().map(|c| f64::from(u8::from(c.1))).collect();
                let failed: Vec<bool> = cycles.iter().map(|c| !c.1).collect();
                let (Some(units), Some(failures)) =
                    (reward_rate(&units, &times, Confidence::P95), event_rate(&failed, &times, Confidence::P95))
                else {
                    continue;
                };
                let rate = clopper_pearson(Trials::count(cycles.iter().map(|c| c.1)), Confidence::P95);
                // The median of the longest run among as many cycles.
                let run = median_run(n, success);
                let steps = kaplan_meier(&times, &cycles.iter().map(|c| c.1).collect::<Vec<bool>>(), Confidence::P95);
                let quantile = |q: f64| {
                    let found = quantile_time(&steps, q);
                    // Beyond the limit nothing was seen: an open end contains it.
                    let truth = cell.quantile(q);
                    found.low.is_some_and(|low| low <= truth) && found.high.is_none_or(|high| truth <= high)
                        || truth >= LIMIT && found.low.is_none()
                };
                let mut sorted: Vec<f64> = cycles.iter().filter(|c| c.1).map(|c| c.0).collect();
                sorted.sort_by(f64::total_cmp);
                let tolerance = tolerance_interval(sorted.len() as u64, 0.9, 0.95).is_none_or(|[low, high]| {
                    let below = |t: f64| {
                        let all = 1.0 - (-(LIMIT - 4.0) / cell.mean).exp();
                        (1.0 - (-(t - 4.0) / cell.mean).exp()) / all
                    };
                    below(sorted[high as usize - 1]) - below(sorted[low as usize - 1]) >= 0.9
                });
                let found = [
                    units.interval.contains(per_second),
                    rate.contains(success),
                    failures.interval.contains(1.0 / between),
                    (median_run(n, rate.low)..=median_run(n, rate.high)).contains(&run),
                    quantile(0.5),
                    quantile(0.9),
                    tolerance,
                ];
                inside.iter_mut().zip(found).for_each(|(count, hit)| *count += u32::from(hit));
            }
            let shares: Vec<String> =
                inside.iter().map(|count| format!("{:.1} %", 100.0 * f64::from(*count) / repetitions as f64)).collect();
            println!("| {} | {n} | {} |", cell.name, shares.join(" | "));
        }
    }
}

/// Chances to pass each of three stages, and then to succeed.
type Policy = [f64; 4];

fn stages(repetitions: u64) {
    const PAIRS: usize = 1_000;
    const SHARED: f64 = 0.5;
    let pairs: [(&str, Policy, Policy); 4] = [
        ("equal", [0.9, 0.8, 0.8, 0.7], [0.9, 0.8, 0.8, 0.7]),
        ("better at all stages", [0.9, 0.8, 0.8, 0.7], [0.95, 0.88, 0.88, 0.8]),
        ("better grasp only", [0.6, 0.7, 0.7, 0.5], [0.85, 0.7, 0.7, 0.5]),
        ("better last step only", [0.9, 0.9, 0.9, 0.6], [0.9, 0.9, 0.9, 0.75]),
    ];
    println!("| policies | success of A and B | by | B is better | B is worse | mean pairs, of at most {PAIRS} |");
    println!("|---|---|---|---|---|---|");
    let looks: Vec<usize> = (1..=PAIRS / 20).map(|look| 20 * look).collect();
    for (name, a, b) in pairs {
        let rate = |p: Policy| p.iter().product::<f64>();
        let mut decided = [[0_u32; 2]; 2];
        let mut used = [0_usize; 2];
        for seed in 0..repetitions {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut differences: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
            for _ in 0..PAIRS {
                // A part of the scenarios has the same draws for both policies.
                let shared = uniform(&mut rng) < SHARED;
                let own: Vec<[f64; 2]> = (0..4).map(|_| [uniform(&mut rng), uniform(&mut rng)]).collect();
                let steps = |policy: Policy, which: usize| {
                    policy.iter().zip(&own).take_while(|(p, u)| u[if shared { 0 } else { which }] < **p).count()
                };
                let (a, b) = (steps(a, 0), steps(b, 1));
                differences[0].push(1.0 + (b as f64 - a as f64) / 4.0);
                differences[1].push(1.0 + f64::from(u8::from(b == 4)) - f64::from(u8::from(a == 4)));
            }
            for (which, values) in differences.iter().enumerate() {
                let end = looks.iter().find_map(|end| {
                    let mean = BoundedMean::new(values, std::slice::from_ref(end), 2.0).ok()?;
                    let wanted = -0.025_f64.ln();
                    let better = mean.ln_evidence_above(1.0) >= wanted;
                    (better || mean.ln_evidence_below(1.0) >= wanted).then_some((*end, better))
                });
                used[which] += end.map_or(PAIRS, |end| end.0);
                if let Some((_, better)) = end {
                    decided[which][usize::from(!better)] += 1;
                }
            }
        }
        for (which, by) in ["stages", "success"].into_iter().enumerate() {
            let share = |n: u32| 100.0 * f64::from(n) / repetitions as f64;
            println!(
                "| {name} | {:.3}, {:.3} | {by} | {:.1} % | {:.1} % | {:.0} |",
                rate(a),
                rate(b),
                share(decided[which][0]),
                share(decided[which][1]),
                used[which] as f64 / repetitions as f64
            );
        }
    }
}

fn main() {
    let repetitions = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(1_000);
    coverage(repetitions);
    println!();
    stages(repetitions);
}
