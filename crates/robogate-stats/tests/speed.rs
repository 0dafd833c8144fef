//! How long the large cases take; measured on request, since a shared machine's clock proves nothing in a test run:
//! `cargo test --release -p robogate-stats --test speed -- --ignored --nocapture`.

#![expect(clippy::print_stderr, reason = "the times are what it is run for")]

use robogate_stats::Confidence;
use robogate_stats::binning::Edges;
use robogate_stats::logistic::{Data, Options, firth_profile, fit, separation};
use robogate_stats::roc::auc;
use robogate_stats::threshold::{ThresholdOptions, threshold};
use std::time::Instant;

fn formula(n: u64, multiplier: u64, modulus: u64) -> Vec<f64> {
    (0..n).map(|i| (i * multiplier % modulus) as f64 / modulus as f64).collect()
}

const MULTIPLIERS: [u64; 10] =
    [7919, 104_729, 15_485_863, 32_452_843, 49_979_687, 67_867_967, 86_028_121, 122_949_823, 141_650_939, 160_481_183];

fn rows(n: u64, columns: usize) -> (Vec<Vec<f64>>, Vec<bool>) {
    let x: Vec<Vec<f64>> = MULTIPLIERS.iter().take(columns).map(|m| formula(n, *m, 1_000_003)).collect();
    let noise = formula(n, 179_424_673, 999_983);
    let outcomes = (0..n as usize)
        .map(|i| {
            let t = 4.0 * x[0][i] - 2.0 * x[1][i] - 1.0;
            1.0 / (1.0 + (-t).exp()) > noise[i]
        })
        .collect();
    (x, outcomes)
}

fn timed<T>(name: &str, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    eprintln!("{name}: {:.3} s", start.elapsed().as_secs_f64());
    result
}

#[test]
#[ignore = "a measurement, not a claim"]
fn large_cases() {
    let (x, outcomes) = rows(20_000, 5);
    let weights = formula(20_000, 104_729, 99_991);
    for (name, weights) in [("unweighted", None), ("all weights distinct", Some(weights.as_slice()))] {
        timed(&format!("thresholds, 5 x 20,000 rows x 1,000 replicates, {name}"), || {
            for column in &x {
                let edges = Edges::equal_count(column, 20).unwrap();
                threshold(column, &outcomes, weights, &edges, ThresholdOptions::default()).unwrap();
            }
        });
    }
    let (x, outcomes) = rows(1_000_000, 10);
    timed("thresholds, 5 x 1,000,000 rows x 1,000 replicates", || {
        for column in &x[..5] {
            let edges = Edges::equal_count(column, 20).unwrap();
            threshold(column, &outcomes, None, &edges, ThresholdOptions::default()).unwrap();
        }
    });
    let columns: Vec<&[f64]> = x.iter().map(Vec::as_slice).collect();
    let data = Data::new(&columns, &outcomes, None).unwrap();
    let model = timed("logistic, 1,000,000 rows x 10 columns", || fit(data, Options::default()).unwrap());
    let scores = timed("predictions, 1,000,000 rows", || model.probabilities(&columns).unwrap());
    timed("auc with its interval, 1,000,000 rows", || auc(&scores, &outcomes, Confidence::P95).unwrap());
    // One category in ten in which nothing succeeds.
    let mut with_category = x.clone();
    with_category[9] = (0..1_000_000).map(|i| f64::from(u8::from(i % 10 == 3))).collect();
    let never: Vec<bool> = outcomes.iter().enumerate().map(|(i, o)| *o && i % 10 != 3).collect();
    let columns: Vec<&[f64]> = with_category.iter().map(Vec::as_slice).collect();
    let data = Data::new(&columns, &never, None).unwrap();
    let found = timed("separation found, 1,000,000 rows", || separation(data).unwrap().unwrap());
    assert_eq!(found.columns, [9]);
    timed("logistic with Firth's answer, 1,000,000 rows", || fit(data, Options::default()).unwrap());
    let short: Vec<&[f64]> = columns.iter().map(|c| &c[..20_000]).collect();
    let data = Data::new(&short, &never[..20_000], None).unwrap();
    timed("firth profile, 20,000 rows", || firth_profile(data, 9, Confidence::P95).unwrap());
}
