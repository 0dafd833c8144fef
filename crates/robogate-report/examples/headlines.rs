//! How often reports name something: `cargo run -p robogate-report --example headlines [-- SETS [SIMULATION...] [RATE/ROWS...]]`.
//! `200 1 0.01/10000` measures one row of simulation 1.
//!
//! Simulation 1: success depends on nothing. Simulation 2: one planted effect in one tenth of a parameter's range.
//! Simulation 3: the box of the advice, at a rate that reaches the target nowhere or only in a small part. Deterministic:
//! the same number of sets prints the same table. `docs/results/headlines.md` has the figures.

#![expect(clippy::unwrap_used, reason = "a simulation that cannot run should stop")]
#![expect(clippy::print_stdout, reason = "the table is the result")]

#[path = "../../robogate-analysis/tests/it/named.rs"]
mod named;
#[path = "../../robogate-analysis/tests/it/noise.rs"]
mod noise;
#[path = "../../robogate-analysis/tests/it/episodes.rs"]
mod synthetic;

use named::named;
use noise::{planted, simulated};

/// Rows of simulation 2.
const ROWS: u64 = 3_000;
/// Simulated sets without and with an effect that measure the best possible test.
const BEST_SETS: [u64; 2] = [2_000, 1_000];

fn main() {
    let sets: u64 = std::env::args().nth(1).map_or(200, |word| word.parse().unwrap());
    // Without further arguments all simulations run.
    let (rows, chosen): (Vec<String>, Vec<String>) = std::env::args().skip(2).partition(|word| word.contains('/'));
    let wanted = |number: &str| chosen.is_empty() || chosen.iter().any(|word| word == number);
    let row = |rate: f64, of: u64| rows.is_empty() || rows.contains(&format!("{rate}/{of}"));
    if wanted("1") {
        noise(sets, &row);
    }
    if wanted("2") {
        planted_effects(sets, &row);
    }
    if wanted("3") {
        boxes(sets);
    }
}

/// Whether the row of this rate and number of episodes is measured.
type Wanted<'a> = &'a dyn Fn(f64, u64) -> bool;

fn noise(sets: u64, wanted: Wanted<'_>) {
    println!("Simulation 1: success depends on none of 10 parameters; {sets} sets each");
    println!("| rate | rows | reports that name anything |");
    println!("|---|---|---|");
    for rate in [0.01, 0.1, 0.5, 0.99] {
        for rows in [300, 1_000, 3_000, 10_000].into_iter().filter(|rows| wanted(rate, *rows)) {
            let reports = (0..sets).filter(|seed| !named(&simulated(*seed, rows, |_| rate)).is_empty()).count();
            println!("| {rate} | {rows} | {} |", share(reports, sets));
        }
    }
}

fn planted_effects(sets: u64, wanted: Wanted<'_>) {
    println!(
        "\nSimulation 2: odds of success divided or multiplied by 3 in one tenth of one parameter; {sets} sets each"
    );
    println!(
        "| rate elsewhere | odds in the tenth | rows | named first | named at all | another one named too | best possible test |"
    );
    println!("|---|---|---|---|---|---|---|");
    for rate in [0.1, 0.2, 0.5, 0.9] {
        for (ratio, odds) in [(3.0, "a third"), (1.0 / 3.0, "three times")] {
            // Rows at which the effect becomes visible, where 3,000 are too few.
            let more =
                if named_by_best(rate, ratio, ROWS) < 0.95 { vec![ROWS, 2 * ROWS, 3 * ROWS] } else { vec![ROWS] };
            for rows in more.into_iter().filter(|rows| wanted(rate, *rows)) {
                let (mut first, mut any, mut other) = (0, 0, 0);
                for seed in 0..sets {
                    // The tenth lies anywhere in the range, also at its ends.
                    let from = 0.9 * seed as f64 / (sets - 1).max(1) as f64;
                    let analysis = simulated(seed, rows, planted(rate, ratio, from));
                    let named = named(&analysis);
                    first += usize::from(named.first().is_some_and(|name| name == "p3"));
                    any += usize::from(named.iter().any(|name| name == "p3"));
                    other += usize::from(named.iter().any(|name| name != "p3"));
                }
                println!(
                    "| {rate} | {odds} | {rows} | {} | {} | {} | {:.1} % |",
                    share(first, sets),
                    share(any, sets),
                    share(other, sets),
                    100.0 * named_by_best(rate, ratio, rows)
                );
            }
        }
    }
}

/// The power of the best possible test of "some parameter has an effect" at an error of 5 %.
///
/// The test knows the rate elsewhere, the odds ratio and the width of the tenth. It does not know the parameter or the
/// position. By the lemma of Neyman and Pearson, no test has a larger power on average over parameters and positions
/// than the one that rejects for a large mean of the likelihood ratios of all of them. No report can name an effect more
/// often than this test finds one.
fn named_by_best(rate: f64, ratio: f64, rows: u64) -> f64 {
    let inside = planted(rate, ratio, 0.0)(&[0.0; 10]);
    let gain = [((1.0 - inside) / (1.0 - rate)).ln(), (inside / rate).ln()];
    let statistic = |set: u64, effect: bool| {
        let from = 0.9 * synthetic::unit(set, 1);
        let mut columns: Vec<Vec<(f64, f64)>> = vec![Vec::new(); 10];
        for row in 0..rows {
            let of = (set + 1) * 1_000_003 + row;
            let at: Vec<f64> = (1..=10).map(|salt| synthetic::unit(of, salt)).collect();
            let p = if effect { planted(rate, ratio, from)(&at) } else { rate };
            let ln = gain[usize::from(synthetic::unit(of, 99) < p)];
            columns.iter_mut().zip(&at).for_each(|(column, x)| column.push((*x, ln)));
        }
        let mut ratios = Vec::new();
        for column in &mut columns {
            column.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (mut low, mut high, mut sum) = (0, 0, 0.0);
            for position in 0..=180 {
                let start = f64::from(position) / 200.0;
                while high < column.len() && column[high].0 < start + 0.1 {
                    sum += column[high].1;
                    high += 1;
                }
                while low < high && column[low].0 < start {
                    sum -= column[low].1;
                    low += 1;
                }
                ratios.push(sum);
            }
        }
        let largest = ratios.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        largest + ratios.iter().map(|ln| (ln - largest).exp()).sum::<f64>().ln()
    };
    let [without, with] = BEST_SETS;
    let mut null: Vec<f64> = (0..without).map(|set| statistic(set, false)).collect();
    null.sort_by(f64::total_cmp);
    let limit = null[(0.95 * without as f64) as usize];
    (without..without + with).filter(|set| statistic(*set, true) > limit).count() as f64 / with as f64
}

fn boxes(sets: u64) {
    println!("\nSimulation 3: boxes stated to reach 90 % with 95 % confidence");
    println!("| law | rows | stated | stated and wrong | mean volume |");
    println!("|---|---|---|---|---|");
    // The rate of every part of a box: products of one factor for each parameter.
    let ramp = |at: &[f64]| 0.55 + 0.4 * at[3].min(1.0 - 0.25 * at[4]);
    let corner = |at: &[f64]| if at[3] > 0.3 && at[4] < 0.8 { 0.97 } else { 0.45 };
    let almost = |at: &[f64]| if at[3] > 0.3 && at[4] < 0.8 { 0.895 } else { 0.45 };
    let laws: [(&str, Law<'_>); 3] = [
        ("97 % in 56 % of the space", &corner),
        ("89.5 % in 56 % of the space", &almost),
        ("a slow ramp up to 95 %", &ramp),
    ];
    for (name, law) in laws {
        for rows in [1_000, 3_000] {
            let (mut stated, mut wrong, mut volume) = (0, 0, 0.0);
            for seed in 0..sets {
                let analysis = simulated(seed, rows, law);
                let Some(found) = analysis.safe_box.estimated().filter(|found| found.verified) else { continue };
                stated += 1;
                volume += found.volume;
                wrong += usize::from(true_rate(found, law) < found.target);
            }
            println!(
                "| {name} | {rows} | {} | {} | {:.1} % |",
                share(stated, sets),
                share(wrong, sets),
                100.0 * volume / stated.max(1) as f64
            );
        }
    }
}

/// The probability of success at a point of the unit cube.
type Law<'a> = &'a dyn Fn(&[f64]) -> f64;

fn share(count: usize, sets: u64) -> String {
    format!("{:.1} %", 100.0 * count as f64 / sets as f64)
}

/// The true rate inside a box, by many points of the unit cube.
fn true_rate(found: &robogate_analysis::SafeBox, law: Law<'_>) -> f64 {
    let space = noise::ten();
    let (mut sum, mut n) = (0.0, 0.0);
    for i in 0..20_000 {
        let at: Vec<f64> = (1..=space.len() as u64).map(|salt| synthetic::unit(7_000_000_000 + i, salt)).collect();
        let inside = found.limits.iter().all(|limit| {
            let position = space.position(&limit.parameter).unwrap();
            let domain = &space.parameters()[position].domain;
            match domain.decode(domain.from_unit(at[position])) {
                robogate_core::Value::Category(level) => limit.levels.iter().any(|known| **known == *level),
                value => {
                    let value = domain.encode(&value).unwrap();
                    limit.low.is_none_or(|low| value >= low) && limit.high.is_none_or(|high| value <= high)
                }
            }
        });
        if inside {
            sum += law(&at);
            n += 1.0;
        }
    }
    sum / f64::max(n, 1.0)
}
