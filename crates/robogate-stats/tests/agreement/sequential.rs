//! Compares score differences, joint p-values and stratified evidence with `tests/reference/gate.py`.

use robogate_stats::compare::Pairs;
use robogate_stats::difference::{independent_normal, paired};
use robogate_stats::group_sequential::{boundary_p, joint_p};
use robogate_stats::stratified::Strata;
use robogate_stats::{Confidence, Trials};
use serde_json::Value;

use super::{count, float, list};

fn reference() -> Value {
    serde_json::from_str(include_str!("../reference/gate.json")).unwrap()
}

#[test]
fn independent_differences_match_statsmodels() {
    for case in list(&reference()["independent"]) {
        let trials = |x: &str, n: &str| Trials::new(count(&case[x]), count(&case[n])).unwrap();
        let found = independent_normal(trials("x1", "n1"), trials("x2", "n2"), Confidence::P95);
        assert!((found.interval.low - float(&case["low"])).abs() < 2e-5, "{case} {found:?}");
        assert!((found.interval.high - float(&case["high"])).abs() < 2e-5, "{case} {found:?}");
        assert!((found.ln_p.exp() - float(&case["p"])).abs() < 1e-6, "{case} {found:?}");
    }
}

#[test]
fn paired_differences_match_tango() {
    for case in list(&reference()["paired"]) {
        let (b, c, n) = (count(&case["b"]), count(&case["c"]), count(&case["n"]));
        let pairs = Pairs { both: n - b - c, first_only: b, second_only: c, neither: 0 };
        let found = paired(pairs, Confidence::P95);
        assert!((found.interval.low - float(&case["low"])).abs() < 2e-5, "{case} {found:?}");
        assert!((found.interval.high - float(&case["high"])).abs() < 2e-5, "{case} {found:?}");
        assert!((found.ln_p.exp() - float(&case["p"])).abs() < 1e-6, "{case} {found:?}");
    }
}

#[test]
fn joint_p_values_match_multivariate_normal() {
    for case in list(&reference()["joint"]) {
        let found = joint_p(float(&case["p"]), count(&case["looks"]));
        assert!((found / float(&case["joint"]) - 1.0).abs() < 0.01, "{case}: {found}");
    }
}

#[test]
fn rising_limits_match_multivariate_normal() {
    for case in list(&reference()["boundary"]) {
        let found = boundary_p(float(&case["limit"]), count(&case["looks"]));
        assert!((found / float(&case["joint"]) - 1.0).abs() < 0.01, "{case}: {found}");
    }
}

#[test]
fn stratified_evidence_matches_slsqp() {
    for case in list(&reference()["stratified"]) {
        let mut strata = Strata::default();
        for round in list(&case["rounds"]) {
            let results: Vec<(usize, bool)> = list(round).iter().map(|x| count(x) == 1).enumerate().collect();
            strata.round(&results);
        }
        let found = strata.ln_evidence_above(float(&case["p0"]));
        assert!((found - float(&case["ln_evidence"])).abs() < 1e-4, "{case}: {found}");
    }
}
