//! Compares every estimator with SciPy, statsmodels, scikit-learn, LightGBM or an independent implementation in Python.
//!
//! `tests/reference/generate.py`, `gate.py`, `ridge.py`, `separation.py`, `boosting.py`, `claims.py`, `survival.py` and
//! `transfer.py` compute the reference values. Their `requirements.txt` pins the versions.

#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

mod analysis;
mod boosting;
mod claims;
mod gate;
mod interval;
mod logistic;
mod ridge;
mod sequential;
mod survival;
mod transfer;

use serde_json::Value;

fn reference() -> Value {
    serde_json::from_str(include_str!("../reference/reference.json")).unwrap()
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap_or_else(|| panic!("not a list: {value}"))
}

fn floats(value: &Value) -> Vec<f64> {
    list(value).iter().map(float).collect()
}

fn float(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("not a number: {value}"))
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("not a count: {value}"))
}

fn bools(value: &Value) -> Vec<bool> {
    list(value).iter().map(|v| v.as_bool().unwrap()).collect()
}

/// ((i * multiplier) mod modulus) / modulus, with the same doubles as generate.py.
fn formula(n: u64, multiplier: u64, modulus: u64) -> Vec<f64> {
    (0..n).map(|i| (i * multiplier % modulus) as f64 / modulus as f64).collect()
}

/// Asserts that a and b differ by at most `tolerance` relative to |b|.
#[track_caller]
fn close(name: &str, a: f64, b: f64, tolerance: f64) {
    let error = (a - b).abs() / b.abs().max(1e-300);
    assert!(error <= tolerance || a.to_bits() == b.to_bits(), "{name}: {a} against {b}, off by {error:.1e}");
}

#[track_caller]
fn all_close(name: &str, a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len(), "{name}");
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        close(&format!("{name}[{i}]"), *x, *y, tolerance);
    }
}
