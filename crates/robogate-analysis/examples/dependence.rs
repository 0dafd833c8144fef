//! How often reports on dependent rows are wrong: `cargo run --release -p robogate-analysis --example dependence [-- REPORTS]`.
//!
//! Success depends on no parameter, and each cluster (scenario, day, operator, robot) has its own rate. The table counts the
//! reports that name anything, and the 95 % intervals that contain the rate of new clusters. Seeds are fixed.
//! `docs/results/dependence.md` has the figures.

#![expect(clippy::unwrap_used, reason = "a simulation that cannot run should stop")]
#![expect(clippy::print_stdout, reason = "the table is the result")]

#[path = "../tests/it/clusters.rs"]
mod clusters;
#[path = "../tests/it/named.rs"]
mod named;

use clusters::{DESIGNS, Design, Settings, analysed, compared, true_rate};
use named::named;

fn main() {
    let reports: u64 = std::env::args().nth(1).map_or(400, |word| word.parse().unwrap());
    println!("| design | names something | interval covers | mean width |\n|---|---|---|---|");
    for design in &DESIGNS {
        let (mut claims, mut covered, mut width) = (0, 0, 0.0);
        for seed in 1_000..1_000 + reports {
            let analysis = analysed(design, seed, 0.0);
            let [low, high] = analysis.success.rate.wilson_95;
            claims += u64::from(!named(&analysis).is_empty());
            covered += u64::from((low..=high).contains(&true_rate(design.rates)));
            width += high - low;
        }
        let share = |k: u64| 100.0 * k as f64 / reports as f64;
        let mean = 100.0 * width / reports as f64;
        println!("| {} | {:.1} % | {:.1} % | {mean:.1} points |", design.name, share(claims), share(covered));
    }
    println!("\n| design | effect in log-odds over the range | named |\n|---|---|---|");
    let scenarios = Design { rates: [1.2, 0.8], ..DESIGNS[0] };
    for (design, clusters, effect) in
        [(scenarios, 6, 5.0), (scenarios, 10, 5.0), (scenarios, 20, 3.0), (scenarios, 20, 5.0), (DESIGNS[5], 8, 2.0)]
    {
        let design = Design { clusters, ..design };
        let named = (0..reports)
            .filter(|seed| named(&analysed(&design, *seed, effect)).contains(&"friction".to_owned()))
            .count();
        let kind = if design.settings == Settings::EachRow { "days, new settings in each row" } else { "scenarios" };
        println!("| {clusters} {kind} x {} | {effect} | {:.1} % |", design.rows, 100.0 * named as f64 / reports as f64);
    }
    println!("\n| comparison of policies with equal mean rates | called different |\n|---|---|");
    for (scenarios, seeds) in [(8, 5), (8, 40), (15, 20), (40, 5)] {
        let different = (0..reports).filter(|seed| compared(scenarios, seeds, *seed) <= 0.05).count();
        println!("| {scenarios} scenarios x {seeds} seeds | {:.1} % |", 100.0 * different as f64 / reports as f64);
    }
}
