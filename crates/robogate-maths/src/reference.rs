//! SciPy reference values of the tests, from `tests/reference/reference.json`.

use serde_json::Value;

fn section(name: &str) -> Value {
    let all: Value = serde_json::from_str(include_str!("../tests/reference/reference.json")).unwrap();
    all[name].clone()
}

/// Reads a list of numbers from a section.
pub(crate) fn list(name: &str, key: &str) -> Vec<f64> {
    serde_json::from_value(section(name)[key].clone()).unwrap()
}

/// Compares a function with the field `answer` of each case of a section, relative to its magnitude (at least 1e-3).
pub(crate) fn check(name: &str, answer: &str, tolerance: f64, f: impl Fn(&dyn Fn(&str) -> f64) -> f64) {
    for case in section(name).as_array().unwrap() {
        let get = |key: &str| case[key].as_f64().unwrap();
        let (ours, theirs) = (f(&get), get(answer));
        let error = (ours - theirs).abs() / theirs.abs().max(1e-3);
        assert!(error < tolerance, "{name} {case}: {ours} {error:.1e}");
    }
}
