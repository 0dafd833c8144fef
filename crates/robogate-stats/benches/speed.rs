//! Compares the speed of large fits with statsmodels, scikit-learn and SciPy, on the same data in one run.
//!
//! Run `ROBOGATE_BENCH_PYTHON=venv/bin/python cargo bench -p robogate-stats [-- ROWS]` with the packages of
//! `tests/reference/requirements.txt`. Without that variable only RoboGate's times are printed.

#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock and finds its Python in the environment")]
#![expect(clippy::print_stdout, reason = "a benchmark prints its results")]
#![expect(clippy::unwrap_used, reason = "a benchmark fails by panicking")]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use robogate_stats::Confidence;
use robogate_stats::binning::Edges;
use robogate_stats::correlation::spearman;
use robogate_stats::logistic::{Data, Options, fit, separation};
use robogate_stats::roc::auc;
use robogate_stats::threshold::{ThresholdOptions, threshold};

const COLUMNS: usize = 10;

/// Rows of the bootstrap: the paper's two stages.
const BOOTSTRAP_ROWS: usize = 20_000;

const MULTIPLIERS: [u64; COLUMNS] =
    [7919, 104_729, 15_485_863, 32_452_843, 49_979_687, 67_867_967, 86_028_121, 122_949_823, 141_650_939, 160_481_183];

fn formula(n: u64, multiplier: u64, modulus: u64) -> Vec<f64> {
    (0..n).map(|i| (i * multiplier % modulus) as f64 / modulus as f64).collect()
}

fn timed<T>(times: &mut BTreeMap<&'static str, f64>, name: &'static str, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    times.insert(name, start.elapsed().as_secs_f64());
    result
}

fn main() {
    let rows: usize = std::env::args().skip(1).find_map(|word| word.parse().ok()).unwrap_or(1_000_000);
    assert!(rows >= BOOTSTRAP_ROWS, "expected at least {BOOTSTRAP_ROWS} rows");
    let x: Vec<Vec<f64>> = MULTIPLIERS.iter().map(|m| formula(rows as u64, *m, 1_000_003)).collect();
    let noise = formula(rows as u64, 179_424_673, 999_983);
    let outcomes: Vec<bool> =
        (0..rows).map(|i| 1.0 / (1.0 + (1.0 + 2.0 * x[1][i] - 4.0 * x[0][i]).exp()) > noise[i]).collect();
    let columns: Vec<&[f64]> = x.iter().map(Vec::as_slice).collect();
    let mut ours = BTreeMap::new();

    let data = Data::new(&columns, &outcomes, None).unwrap();
    let model = timed(&mut ours, "logistic", || fit(data, Options::default()).unwrap());
    let scores = model.probabilities(&columns).unwrap();
    let area = timed(&mut ours, "auc", || auc(&scores, &outcomes, None, Confidence::P95).unwrap());
    timed(&mut ours, "thresholds", || {
        for column in &x[..5] {
            let column = &column[..BOOTSTRAP_ROWS];
            let edges = Edges::equal_count(column, 20).unwrap();
            threshold(column, &outcomes[..BOOTSTRAP_ROWS], None, None, &edges, ThresholdOptions::default()).unwrap();
        }
    });
    timed(&mut ours, "spearman", || spearman(&x[0], &scores, Confidence::P95).unwrap());
    // A column marks a tenth of the rows, in which no episode succeeds.
    let mut marked = columns.clone();
    let mark: Vec<f64> = (0..rows).map(|i| f64::from(u8::from(i % 10 == 3))).collect();
    marked[COLUMNS - 1] = &mark;
    let never: Vec<bool> = outcomes.iter().enumerate().map(|(i, o)| *o && i % 10 != 3).collect();
    let separated = Data::new(&marked, &never, None).unwrap();
    timed(&mut ours, "separation found", || separation(separated).unwrap().unwrap());
    timed(&mut ours, "Firth's fit where separated", || fit(separated, Options::default()).unwrap());

    println!("{rows} rows, {COLUMNS} columns; thresholds: 5 columns of {BOOTSTRAP_ROWS} rows, 1,000 replicates");
    for (name, seconds) in &ours {
        println!("{name:<66} {seconds:>9.3} s");
    }
    let Some(python) = std::env::var_os("ROBOGATE_BENCH_PYTHON") else {
        println!("ROBOGATE_BENCH_PYTHON is not set: the Python packages were not measured");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let bytes = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    std::fs::write(folder.path().join("x.f64"), x.iter().flat_map(|c| bytes(c)).collect::<Vec<u8>>()).unwrap();
    std::fs::write(folder.path().join("scores.f64"), bytes(&scores)).unwrap();
    let classes: Vec<u8> = outcomes.iter().map(|o| u8::from(*o)).collect();
    std::fs::write(folder.path().join("outcomes.u8"), classes).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers.py");
    let output = Command::new(python)
        .arg(script)
        .arg(folder.path())
        .args([rows.to_string(), COLUMNS.to_string()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let peers: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // A ratio is meaningful only if both results agree.
    for (ours, theirs) in model.raw_coefficients().iter().zip(peers["coefficients"].as_array().unwrap()) {
        assert!((ours - theirs.as_f64().unwrap()).abs() < 1e-6, "coefficients differ: {ours} and {theirs}");
    }
    assert!((area.auc - peers["auc"].as_f64().unwrap()).abs() < 1e-9, "areas differ");
    for (name, seconds) in peers["seconds"].as_object().unwrap() {
        let seconds = seconds.as_f64().unwrap();
        let ratio = seconds / ours[name.split(',').next().unwrap().split(' ').next().unwrap()];
        println!("{name:<66} {seconds:>9.3} s  {ratio:>7.1} x ours");
    }
}
