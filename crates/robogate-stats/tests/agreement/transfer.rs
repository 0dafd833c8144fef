//! Compares the normal prediction-powered intervals with ppi-python (`tests/reference/transfer.py`).

use robogate_stats::Confidence;
use robogate_stats::prediction_powered::normal;
use serde_json::Value;

use super::{float, floats, list};

#[test]
fn normal_intervals_match_ppi_python() {
    let reference: Value = serde_json::from_str(include_str!("../reference/transfer.json")).unwrap();
    for case in list(&reference) {
        let [y, f, population] = ["y", "f", "population"].map(|key| floats(&case[key]));
        let (rate, interval) = normal(&y, &f, &population, case["lambda"].as_f64(), Confidence::P95);
        for (found, key) in [(rate, "estimate"), (interval.low, "low"), (interval.high, "high")] {
            let expected = float(&case[key]);
            assert!((found - expected).abs() < 1e-9, "lambda {} {key}: {found} {expected}", case["lambda"]);
        }
    }
}
