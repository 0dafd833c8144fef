//! Writes docs/results/gate-power.md: power, errors and episodes of a gate of 20 rounds of 68.
//!
//! `cargo run --release -p robogate-stats --example gate_power -- "27 November 2026" docs/results/gate-power.md`
//!
//! Exact operating characteristics by recursion, for equal rates of the scenarios, beside the fixed-size test of the same budget
//! and Wald's bound; a scan of unequal rates; and live gates with all parts of the evidence.

#[path = "../tests/support/recursion.rs"]
mod recursion;

use std::fmt::Write as _;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use recursion::{crossing, round};
use robogate_stats::budgeted::Budget;
use robogate_stats::operating::{Characteristic, RateTest, Schedule, characteristics};
use robogate_stats::stratified::Strata;

const BUDGET: Budget = Budget { per_round: 68, rounds: 20 };
const LIMITS: [f64; 10] = [0.5, 0.6, 0.7, 0.8, 0.9, 0.92, 0.95, 0.97, 0.98, 0.99];
const STEPS: [f64; 10] = [-8.0, -4.0, -3.0, -2.5, -2.0, 2.0, 2.5, 3.0, 4.0, 8.0];
/// Limits and true rates of the live gates.
const CELLS: [(f64, f64); 10] = [
    (0.5, 0.54),
    (0.7, 0.73),
    (0.8, 0.83),
    (0.9, 0.92),
    (0.92, 0.94),
    (0.92, 0.9),
    (0.95, 0.965),
    (0.97, 0.958),
    (0.98, 0.99),
    (0.99, 0.984),
];
const GATES: u64 = 2_000;

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(date), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err(std::io::Error::other("expected a date and the file to write"));
    };
    let mut out = String::from("# Errors and episodes of the gate\n\n");
    let _ = writeln!(
        out,
        "{date}. `cargo run --release -p robogate-stats --example gate_power -- \"{date}\" docs/results/gate-power.md` writes \
         this page. All random numbers have fixed seeds.\n"
    );
    power(&mut out);
    unequal(&mut out);
    live(&mut out);
    std::fs::write(path, out)
}

fn test_of(limit: f64) -> RateTest {
    RateTest { at_least: limit, alpha: 0.05, beta: 0.05 }
}

fn power(out: &mut String) {
    let most = (BUDGET.per_round * BUDGET.rounds) as f64;
    let mut table = String::from(
        "| limit | true rate | standard errors | fixed decides | gate decides | share | e-process decides | episodes / budget | Wald / budget |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    // The smallest share of the fixed test's power, and the largest means where it has a power of 0.5 and at four.
    let (mut least, mut near, mut far) = ((f64::INFINITY, 0.0), 0.0_f64, 0.0_f64);
    for limit in LIMITS {
        let unit = (limit * (1.0 - limit) / most).sqrt();
        let rates: Vec<(f64, f64)> =
            STEPS.iter().map(|step| (*step, limit + step * unit)).filter(|(_, p)| *p > 0.0 && *p < 1.0).collect();
        let values: Vec<f64> = rates.iter().map(|(_, p)| *p).chain([limit]).collect();
        let of = |schedule| characteristics(test_of(limit), schedule, &values);
        let gate = of(Schedule::Budget(BUDGET));
        let evidence = of(Schedule::Rounds { per_round: BUDGET.per_round, rounds: BUDGET.rounds });
        let fixed = of(Schedule::Fixed { n: BUDGET.per_round * BUDGET.rounds });
        for (at, (step, p)) in rates.iter().enumerate() {
            let right = |c: &Characteristic| if *step > 0.0 { c.met } else { c.violated };
            let (share, episodes) = (right(&gate[at]) / right(&fixed[at]), gate[at].trials / most);
            if right(&fixed[at]) >= 0.5 {
                near = near.max(episodes);
                if share < least.0 {
                    least = (share, limit);
                }
            }
            if step.abs() >= 4.0 {
                far = far.max(episodes);
            }
            // Wald's bound of the mean number of episodes at errors 5 % and 1 - the power of the gate.
            let (miss, alpha) = ((1.0 - right(&gate[at])).clamp(1e-9, 0.999), 0.05);
            let gain = (1.0 - miss) * ((1.0 - miss) / alpha).ln() + miss * (miss / (1.0 - alpha)).ln();
            let apart = p * (p / limit).ln() + (1.0 - p) * ((1.0 - p) / (1.0 - limit)).ln();
            let _ = writeln!(
                table,
                "| {limit} | {p:.4} | {step:+} | {:.3} | {:.3} | {share:.3} | {:.3} | {episodes:.2} | {:.2} |",
                right(&fixed[at]),
                right(&gate[at]),
                right(&evidence[at]),
                (gain / apart / most).min(1.0)
            );
        }
        if let Some(at_limit) = gate.last() {
            let _ = writeln!(
                table,
                "| {limit} | {limit} | 0 | | error {:.4} / {:.4} | | | {:.2} | |",
                at_limit.met,
                at_limit.violated,
                at_limit.trials / most
            );
        }
    }
    let _ = writeln!(
        out,
        "## Power within a known budget\n\n\
         Exact recursions for 20 rounds of 68 episodes, equal rates, error 5 % on each side. \"Standard errors\" is the distance of \
         the true rate from the limit in standard errors of 1,360 episodes.\n\
         \"Fixed decides\" is the power of one exact test of all 1,360 episodes, \"share\" the power of the gate divided by it, and \
         \"e-process\" the gate without a known largest number of rounds.\n\
         \"Episodes\" is the mean with undecided gates. \"Wald\" is Wald's bound of the mean number of episodes of a test with the \
         gate's errors, without rounds and without a largest number.\n\
         The rows at a distance of 0 state the probabilities of a wrong \"met\" and a wrong \"violated\".\n\n\
         Where the fixed test has a power of at least 0.5, the smallest share is {:.3} (limit {}) and the largest mean {near:.2} of the \
         budget. At four standard errors the largest mean is {far:.2}.\n\n{table}",
        least.0, least.1
    );
}

fn unequal(out: &mut String) {
    out.push_str(
        "## Scenarios with unequal rates\n\n\
         The mean of the scenarios' rates is the limit, where both answers are wrong. The e-process part is proved for any rates. The \
         boundary part is checked and not proved: for a fixed mean, the extreme mixes have\n\
         scenarios that always succeed, scenarios that never do, and one other rate (Hoeffding 1956). The table has the largest error of \
         all such mixes in a grid (steps of 2 scenarios).\n\n\
         | limit | equal rates: met | largest: met | mix | equal rates: violated | largest: violated | mix |\n|---|---|---|---|---|---|---|\n",
    );
    for limit in LIMITS {
        let mut cells = String::new();
        for p0 in [limit, 1.0 - limit] {
            let boundary = BUDGET.boundary(p0, 0.05);
            let m = BUDGET.per_round;
            let equal = crossing(&round(m, 0, 0, p0), &boundary);
            let mut worst = (equal, "equal".to_owned());
            for always in (0..m).step_by(2) {
                for never in (0..4).chain((4..m).step_by(2)).filter(|never| always + never < m) {
                    let rate = (m as f64 * p0 - always as f64) / (m - always - never) as f64;
                    if (0.0..=1.0).contains(&rate) && always + never > 0 {
                        let error = crossing(&round(m, always, never, rate), &boundary);
                        if error > worst.0 + 1e-9 {
                            worst = (error, format!("{always} always, {never} never, others {rate:.3}"));
                        }
                    }
                }
            }
            let _ = write!(cells, " {equal:.4} | {:.4} | {} |", worst.0, worst.1);
        }
        let _ = writeln!(out, "| {limit} |{cells}");
    }
    out.push('\n');
}

fn live(out: &mut String) {
    let _ = writeln!(
        out,
        "## Live gates\n\n{GATES} gates for each row, with all parts of the evidence, beside the recursion for the pooled parts.\n\n\
         | limit | true rate | answer | recursion | live | standard error |\n|---|---|---|---|---|---|"
    );
    for (limit, rate) in CELLS {
        let met = rate > limit;
        let test = RateTest { alpha: 0.05, beta: 1e-9, at_least: if met { limit } else { 1.0 - limit } };
        let p = if met { rate } else { 1.0 - rate };
        let exact = characteristics(test, Schedule::Budget(BUDGET), &[p])[0].met;
        let boundary = BUDGET.boundary(test.at_least, 0.05);
        let shown = (0..GATES).filter(|seed| shows(&boundary, test.at_least, p, *seed)).count() as f64 / GATES as f64;
        let error = (exact * (1.0 - exact) / GATES as f64).sqrt();
        let answer = if met { "met" } else { "violated" };
        let _ = writeln!(out, "| {limit} | {rate} | {answer} | {exact:.3} | {shown:.3} | {error:.3} |");
    }
}

/// Whether a live gate shows that the rate is above `limit`.
fn shows(boundary: &[u64], limit: f64, rate: f64, seed: u64) -> bool {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut strata = Strata::default();
    boundary.iter().any(|needed| {
        let unit = |random: &mut ChaCha8Rng| ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
        let results: Vec<(usize, bool)> =
            (0..BUDGET.per_round as usize).map(|scenario| (scenario, unit(&mut random) < rate)).collect();
        strata.round(&results);
        strata.trials().successes() >= *needed || strata.ln_evidence_above(limit) >= (1.0 / (0.4 * 0.05_f64)).ln()
    })
}
