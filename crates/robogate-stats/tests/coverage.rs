//! Simulated coverage of intervals without a closed form. The bounds are the nominal 95 %, with the known error of the
//! asymptotic method at these sizes and three Monte-Carlo standard errors.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::binning::Edges;
use robogate_stats::compare::{Pairs, newcombe_paired};
use robogate_stats::logistic::{Data, firth_profile};
use robogate_stats::roc::{RocError, auc, cross_validate, stratified_folds};
use robogate_stats::threshold::{Threshold, ThresholdOptions, threshold};
use robogate_stats::weighted_events::event_rate;
use robogate_stats::{Confidence, Interval};

fn unit(random: &mut ChaCha8Rng) -> f64 {
    ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

/// A standard normal number (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    (-2.0 * unit(random).ln()).sqrt() * (std::f64::consts::TAU * unit(random)).cos()
}

/// Fraction of `runs` intervals that contain `truth`.
fn coverage(runs: u64, truth: f64, mut interval: impl FnMut(&mut ChaCha8Rng) -> Interval) -> f64 {
    let held = (0..runs).filter(|run| interval(&mut ChaCha8Rng::seed_from_u64(*run)).contains(truth)).count();
    held as f64 / runs as f64
}

/// The area for scores N(1, 1) of successes and N(0, 1) of failures: Phi(1 / sqrt 2).
const AREA: f64 = 0.760_249_938_906_523;

/// Scores of this many successes and failures, and their outcomes.
fn scored(random: &mut ChaCha8Rng, successes: usize, failures: usize) -> (Vec<f64>, Vec<bool>) {
    let outcomes: Vec<bool> = (0..successes + failures).map(|i| i < successes).collect();
    let scores = outcomes.iter().map(|o| normal(random) + f64::from(u8::from(*o))).collect();
    (scores, outcomes)
}

#[test]
fn delong_interval_has_nominal_coverage() {
    // With very few rows in a class the area is skewed, and Student's interval is known to be too short, as in the last case.
    for (successes, failures, least) in [(100, 300, 0.935), (40, 40, 0.93), (15, 200, 0.912), (5, 100, 0.855)] {
        let covered = coverage(2_000, AREA, |random| {
            let (scores, outcomes) = scored(random, successes, failures);
            auc(&scores, &outcomes, None, Confidence::P95).unwrap().interval
        });
        println!("AUC, {successes} and {failures}: {covered:.3}");
        assert!((least..=0.965).contains(&covered), "{successes} and {failures}: {covered}");
    }
}

#[test]
fn cross_validated_interval_has_nominal_coverage() {
    // With two or three successes in a fold, the normal quantile covers 90 %.
    for (successes, failures) in [(12, 100), (15, 200), (30, 100)] {
        let covered = coverage(2_000, AREA, |random| {
            let (scores, outcomes) = scored(random, successes, failures);
            let folds = stratified_folds(&outcomes, None, 5, 0);
            let found = cross_validate::<RocError>(&outcomes, None, &folds, Confidence::P95, |_, test| {
                Ok(test.iter().map(|&row| scores[row]).collect())
            });
            found.unwrap().interval
        });
        println!("AUC over folds, {successes} and {failures}: {covered:.3}");
        assert!((0.925..=0.975).contains(&covered), "{successes} and {failures}: {covered}");
    }
}

#[test]
fn clustered_interval_has_nominal_coverage() {
    // Scenarios with several rows of one score s ~ N(0, 1). A row succeeds if s + e > 0 with its own e ~ N(0, 1), so the area
    // is 5/6: four times an orthant of three normal numbers with the correlations 1/2, 1/2 and 0.
    for (clusters, rows) in [(60, 5), (30, 10)] {
        let mut alone = 0;
        let covered = coverage(2_000, 5.0 / 6.0, |random| {
            let names: Vec<usize> = (0..clusters * rows).map(|row| row / rows).collect();
            let of_cluster: Vec<f64> = (0..clusters).map(|_| normal(random)).collect();
            let scores: Vec<f64> = names.iter().map(|cluster| of_cluster[*cluster]).collect();
            let outcomes: Vec<bool> = scores.iter().map(|score| score + normal(random) > 0.0).collect();
            let by_row = auc(&scores, &outcomes, None, Confidence::P95).unwrap().interval;
            alone += usize::from(by_row.contains(5.0 / 6.0));
            auc(&scores, &outcomes, Some(&names), Confidence::P95).unwrap().interval
        });
        println!("AUC, {clusters} clusters of {rows}: {covered:.3}, by row {:.3}", alone as f64 / 2_000.0);
        assert!((0.925..=0.975).contains(&covered), "{clusters} clusters of {rows}: {covered}");
        assert!(alone < 1_820, "{clusters} clusters of {rows} by row: {alone} of 2,000");
    }
}

#[test]
fn threshold_interval_covers_crossing() {
    // Success has probability x, so the rate crosses one half at 0.5.
    let options = ThresholdOptions { replicates: 300, ..ThresholdOptions::default() };
    let edges = Edges::new((0..=10).map(|i| f64::from(i) / 10.0).collect()).unwrap();
    let covered = coverage(500, 0.5, |random| {
        let values: Vec<f64> = (0..600).map(|_| unit(random)).collect();
        let outcomes: Vec<bool> = values.iter().map(|x| unit(random) < *x).collect();
        match threshold(&values, &outcomes, None, None, &edges, options).unwrap().threshold {
            Threshold::Crosses { low, high, .. } => {
                Interval { low: low.unwrap_or(f64::NEG_INFINITY), high: high.unwrap_or(f64::INFINITY) }
            }
            other => panic!("expected one crossing, got {other:?}"),
        }
    });
    assert!((0.92..=1.0).contains(&covered), "{covered}");
}

#[test]
fn firth_profile_has_nominal_coverage() {
    // A rare category with a true effect of -2. In many of the samples it has no success.
    let mut separated = 0;
    let covered = coverage(1_000, -2.0, |random| {
        let mark: Vec<f64> = (0..120).map(|i| f64::from(u8::from(i % 8 == 0))).collect();
        let outcomes: Vec<bool> = mark.iter().map(|m| unit(random) < 1.0 / (1.0 + (0.5 + 2.0 * m).exp())).collect();
        separated += usize::from(!mark.iter().zip(&outcomes).any(|(m, o)| *m == 1.0 && *o));
        let columns: [&[f64]; 1] = [&mark];
        firth_profile(Data::new(&columns, &outcomes, None).unwrap(), 0, Confidence::P95).unwrap().interval
    });
    assert!(separated > 100, "too few separated samples: {separated} of 1,000");
    assert!((0.925..=0.985).contains(&covered), "{covered}");
}

#[test]
fn paired_interval_covers_difference() {
    // Probabilities: both succeed 0.6, only the first 0.2, only the second 0.1, neither 0.1.
    let covered = coverage(4_000, 0.1, |random| {
        let (first, second): (Vec<bool>, Vec<bool>) = (0..68)
            .map(|_| match unit(random) {
                u if u < 0.6 => (true, true),
                u if u < 0.8 => (true, false),
                u if u < 0.9 => (false, true),
                _ => (false, false),
            })
            .unzip();
        newcombe_paired(Pairs::count(&first, &second).unwrap(), Confidence::P95).interval
    });
    assert!((0.935..=0.975).contains(&covered), "{covered}");
}

/// A rare event, with an adaptive design whose model knows one region: events by rows, and their weights. The region has 2 % of the
/// space and the share `inside` of the events. Each row is uniform with 30 %, and otherwise chooses one of 64 points in
/// proportion to the event rate of its part of the space so far.
fn sought(random: &mut ChaCha8Rng, rate: f64, inside: f64, rows: usize) -> (Vec<bool>, Vec<f64>) {
    const SHARE: f64 = 0.02;
    const UNIFORM: f64 = 0.3;
    const POINTS: usize = 64;
    let chance = [rate * (1.0 - inside) / (1.0 - SHARE), rate * inside / SHARE];
    let mut counts = [[0.5, 1.0], [0.5, 1.0]];
    let (mut events, mut weights) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for _ in 0..rows {
        let points: Vec<usize> = (0..POINTS).map(|_| usize::from(unit(random) < SHARE)).collect();
        let score = |part: &usize| counts[*part][0] / counts[*part][1];
        let sum: f64 = points.iter().map(score).sum();
        let mut at = unit(random) * sum;
        let chosen = points.iter().find(|part| {
            at -= score(part);
            at < 0.0
        });
        let part = if unit(random) < UNIFORM { points[0] } else { *chosen.unwrap_or(&points[0]) };
        let probability = UNIFORM / POINTS as f64 + (1.0 - UNIFORM) * score(&part) / sum;
        let event = unit(random) < chance[part];
        counts[part] = [counts[part][0] + f64::from(u8::from(event)), counts[part][1] + 1.0];
        events.push(event);
        weights.push(1.0 / (POINTS as f64 * probability));
    }
    (events, weights)
}

#[test]
fn rare_rate_covers_at_five_failures() {
    println!("rate, in region, rows: failures, coverage, normal interval, worth");
    // The model knows nearly all events, half of them, or none.
    let cases = [(0.004, 0.9, 140), (0.004, 0.9, 300), (0.004, 0.5, 300), (0.004, 0.02, 1200), (0.02, 0.5, 100)];
    for (rate, inside, rows) in cases {
        let (mut events, mut worth, mut normal) = (0, 0.0, 0);
        let runs = 1_000;
        let covered = coverage(runs, rate, |random| {
            let (happened, weights) = sought(random, rate, inside, rows);
            let found = event_rate(&happened, &weights, Confidence::P95).unwrap();
            events += found.events;
            worth += found.worth.unwrap_or_default() / runs as f64;
            let n = rows as f64;
            let terms = happened.iter().zip(&weights).map(|(event, w)| if *event { *w } else { 0.0 });
            let (sum, square) = terms.fold((0.0, 0.0), |(sum, square), x| (sum + x, square + x * x));
            let half = 1.96 * (square / n - (sum / n).powi(2)).max(0.0).sqrt() / n.sqrt();
            normal += u64::from((sum / n - rate).abs() <= half);
            found.interval
        });
        let (events, normal) = (events as f64 / runs as f64, normal as f64 / runs as f64);
        println!("{rate} {inside} {rows}: {events:.1}, {covered:.3}, {normal:.3}, {worth:.0}");
        assert!(covered >= 0.935, "{rate} {inside} {rows}: {covered}");
    }
}
