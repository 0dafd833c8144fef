//! Error and power of the sequential comparison of two policies, by simulation. The full tables are written by
//! `cargo test -p robogate-stats --test comparison_power -- --ignored`, to `target/tmp/comparison-power.txt`.
#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

use std::fmt::Write;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::compare::Pairs;
use robogate_stats::difference::{ScoreDifference, independent, independent_normal, paired};
use robogate_stats::group_sequential::PairedRun;
use robogate_stats::{Confidence, Interval, Trials};

const ALPHA: f64 = 0.05;
const MARGIN: f64 = 0.05;
const ROUNDS: usize = 20;
const PER_ROUND: usize = 68;

fn unit(random: &mut ChaCha8Rng) -> f64 {
    ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

/// Probabilities of "only the first" and "only the second" for each scenario.
type Scenarios = Vec<[f64; 2]>;

/// The results of one run: the pairs of each round, 0 for a pair that agrees, 1 for "only the first", 2 for "only the
/// second".
fn draw(scenarios: &Scenarios, random: &mut ChaCha8Rng) -> Vec<Vec<u8>> {
    let pair = |[first, second]: &[f64; 2], u: f64| {
        if u < *first {
            1
        } else if u < first + second {
            2
        } else {
            0
        }
    };
    (0..ROUNDS).map(|_| scenarios.iter().map(|s| pair(s, unit(random))).collect()).collect()
}

/// The round at which a conclusion is reached, and whether it is "not worse".
fn group_sequential(rounds: &[Vec<u8>], test: &mut PairedRun) -> Option<(usize, bool)> {
    let mut pairs = Pairs::default();
    for (at, round) in rounds.iter().enumerate() {
        for pair in round {
            match pair {
                1 => pairs.first_only += 1,
                2 => pairs.second_only += 1,
                _ => pairs.both += 1,
            }
        }
        let [met, violated] = test.look(at as u64 + 1, pairs);
        if met || violated {
            return Some((at + 1, met));
        }
    }
    None
}

/// The same with the betting test that is valid for any number of looks.
fn betting(rounds: &[Vec<u8>]) -> Option<(usize, bool)> {
    let mut values = Vec::new();
    for (at, round) in rounds.iter().enumerate() {
        values.extend(round.iter().map(|pair| match pair {
            1 => 0.0,
            2 => 2.0,
            _ => 1.0,
        }));
        let look = [values.len()];
        let mean = BoundedMean::new(&values, &look, 2.0).unwrap();
        let shown = |ln: f64| ln >= -ALPHA.ln();
        if shown(mean.ln_evidence_above(1.0 - MARGIN)) {
            return Some((at + 1, true));
        }
        if shown(mean.ln_evidence_below(1.0 - MARGIN)) {
            return Some((at + 1, false));
        }
    }
    None
}

/// Shares of "not worse" and "worse", and the mean number of pairs.
fn summary(found: &[Option<(usize, bool)>]) -> (f64, f64, f64) {
    let n = found.len() as f64;
    let share = |wanted: bool| found.iter().flatten().filter(|(_, met)| *met == wanted).count() as f64 / n;
    let pairs = found.iter().map(|run| run.map_or(ROUNDS, |(at, _)| at) * PER_ROUND).sum::<usize>() as f64 / n;
    (share(true), share(false), pairs)
}

fn both(scenarios: &Scenarios, gates: u64, test: &mut PairedRun) -> [(f64, f64, f64); 2] {
    let (mut new, mut old) = (Vec::new(), Vec::new());
    for i in 0..gates {
        let rounds = draw(scenarios, &mut ChaCha8Rng::seed_from_u64(i));
        new.push(group_sequential(&rounds, test));
        old.push(betting(&rounds));
    }
    [summary(&new), summary(&old)]
}

/// The same for the group-sequential test alone.
fn alone(scenarios: &Scenarios, gates: u64, test: &mut PairedRun) -> (f64, f64, f64) {
    let run = |i| group_sequential(&draw(scenarios, &mut ChaCha8Rng::seed_from_u64(i)), test);
    summary(&(0..gates).map(run).collect::<Vec<_>>())
}

/// All scenarios with the same probabilities.
fn equal(difference: f64, disagreement: f64) -> Scenarios {
    vec![[0.5 * (disagreement - difference), 0.5 * (disagreement + difference)]; PER_ROUND]
}

fn test() -> PairedRun {
    PairedRun::new(MARGIN, ROUNDS as u64, ALPHA, ALPHA).unwrap()
}

/// Scenarios with a difference of exactly the margin, in several mixes.
fn at_the_margin() -> Vec<(&'static str, Scenarios)> {
    let n = PER_ROUND as f64;
    let whole = (MARGIN * n).floor();
    let rest = MARGIN * n - whole;
    let deterministic = (0..PER_ROUND).map(|i| match i as f64 {
        i if i < whole => [1.0, 0.0],
        i if i < whole + 1.0 => [rest, 0.0],
        _ => [0.0, 0.0],
    });
    let half = (0..PER_ROUND).map(|i| if i % 2 == 0 { [0.3, 0.2] } else { [0.0, 0.0] });
    vec![
        ("equal, 5 % disagree", equal(-MARGIN, 0.0501)),
        ("equal, 10 % disagree", equal(-MARGIN, 0.1)),
        ("equal, 30 % disagree", equal(-MARGIN, 0.3)),
        ("equal, 60 % disagree", equal(-MARGIN, 0.6)),
        ("deterministic", deterministic.collect()),
        ("half and half", half.collect()),
    ]
}

#[test]
fn error_is_at_most_alpha() {
    let mut test = test();
    for (name, scenarios) in at_the_margin() {
        let (met, violated, _) = alone(&scenarios, 150, &mut test);
        let slack = 3.0 * (ALPHA * (1.0 - ALPHA) / 150.0_f64).sqrt();
        assert!(met <= ALPHA + slack && violated <= ALPHA + slack, "{name}: {met} {violated}");
    }
}

#[test]
fn needs_fewer_pairs() {
    let mut test = test();
    for (difference, disagreement, share) in [(0.0, 0.02, 0.7), (0.0, 0.1, 0.7), (-0.15, 0.25, 0.7)] {
        let [(met, violated, now), (.., before)] = both(&equal(difference, disagreement), 100, &mut test);
        assert!(met.max(violated) > 0.9, "{difference} {disagreement}: {met} {violated}");
        assert!(now <= share * before, "{difference} {disagreement}: {now} of {before} pairs");
    }
}

/// `tests/reference/comparison.py` computes these figures by recursion over all tables.
#[test]
fn pairs_match_the_exact_recursion() {
    let mut test = test();
    for (difference, disagreement, pairs) in [(0.0, 0.02, 144.0), (0.0, 0.1, 300.0), (0.1, 0.15, 76.0)] {
        let (met, _, found) = alone(&equal(difference, disagreement), 300, &mut test);
        // The standard deviation of the number of pairs is below 200.
        assert!(met > 0.98 && (found - pairs).abs() < 0.15 * pairs, "{difference} {disagreement}: {found} pairs");
    }
}

/// A test of two independent rates.
type Test = fn(Trials, Trials, Confidence) -> ScoreDifference;

#[test]
fn score_intervals_have_nominal_coverage() {
    for (n, first, second) in [(30_u64, 0.1, 0.05), (400, 0.1, 0.05), (400, 0.02, 0.02)] {
        let mut held = 0;
        let runs = if n > 100 { 300 } else { 40 };
        for i in 0..runs {
            let mut random = ChaCha8Rng::seed_from_u64(i);
            let mut pairs = Pairs::default();
            for _ in 0..n {
                let u = unit(&mut random);
                if u < first {
                    pairs.first_only += 1;
                } else if u < first + second {
                    pairs.second_only += 1;
                } else {
                    pairs.both += 1;
                }
            }
            held += u64::from(paired(pairs, Confidence::P95).interval.contains(first - second));
        }
        let covered = held as f64 / runs as f64;
        assert!(covered >= if n > 100 { 0.91 } else { 0.87 }, "{n} {first} {second}: {covered}");
    }
    // Two independent rates, by enumeration.
    let mass = |n: u64, p: f64| {
        let mut mass = vec![(1.0 - p).powi(n as i32)];
        for k in 0..n {
            mass.push(mass[k as usize] * (n - k) as f64 / (k + 1) as f64 * p / (1.0 - p));
        }
        mass
    };
    let tables = (0..=40).flat_map(|i| (0..=30).map(move |j| [(i, 40), (j, 30)]));
    let tables: Vec<[(u64, u64); 2]> = tables.collect();
    for (name, test, least) in [("exact", independent as Test, 0.95), ("normal", independent_normal as Test, 0.93)] {
        // The intervals do not depend on the true rates.
        let interval = |of: &[(u64, u64); 2]| {
            let [one, two] = of.map(|(k, n)| Trials::new(k, n).unwrap());
            test(one, two, Confidence::P95).interval
        };
        let intervals: Vec<Interval> = tables.iter().map(interval).collect();
        for (p, q) in [(0.5, 0.5), (0.9, 0.8), (0.95, 0.95)] {
            let (a, b) = (mass(40, p), mass(30, q));
            let held = tables.iter().zip(&intervals).filter(|(_, interval)| interval.contains(p - q));
            let covered: f64 = held.map(|([(i, _), (j, _)], _)| a[*i as usize] * b[*j as usize]).sum();
            assert!((least..0.995).contains(&covered), "{name} {p} {q}: {covered}");
        }
    }
}

#[test]
#[ignore = "takes minutes: writes the tables of docs/results/comparison-power.md"]
fn full_tables() {
    let (mut out, mut test) = (String::new(), test());
    for (name, scenarios) in at_the_margin() {
        let (met, violated, _) = alone(&scenarios, 10_000, &mut test);
        writeln!(out, "| {name} | {met:.4} | {violated:.4} |").unwrap();
        assert!(met <= ALPHA + 0.0066 && violated <= ALPHA + 0.0066, "{name}: {met} {violated}");
    }
    for (difference, disagreement) in
        [(0.0, 0.02), (0.0, 0.1), (0.05, 0.1), (0.1, 0.15), (-0.1, 0.15), (-0.15, 0.25), (-0.025, 0.1)]
    {
        let [(a, b, c), (d, e, f)] = both(&equal(difference, disagreement), 500, &mut test);
        writeln!(
            out,
            "| {:+.1} | {:.0} % | {a:.3} | {b:.3} | {c:.0} | {d:.3} | {e:.3} | {f:.0} | {:.2} |",
            100.0 * difference,
            100.0 * disagreement,
            c / f
        )
        .unwrap();
    }
    std::fs::write(concat!(env!("CARGO_TARGET_TMPDIR"), "/comparison-power.txt"), out).unwrap();
}
