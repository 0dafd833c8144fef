use crate::{all_close, bools, close, count, float, floats, formula, list, reference};
use robogate_stats::Confidence;
use robogate_stats::logistic::{
    Caution, Coefficient, Covariance, Data, Dropped, Estimator, Fit, Options, RegressionError, Scale, SeparationKind,
    Term, firth_profile, fit, separation,
};
use serde_json::Value;

const ML: Options =
    Options { scale: Scale::Raw, estimator: Estimator::MaximumLikelihood, covariance: Covariance::Model };
const FIRTH: Options = Options { estimator: Estimator::Firth, ..ML };

fn columns(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(floats).collect()
}

fn borrowed(columns: &[Vec<f64>]) -> Vec<&[f64]> {
    columns.iter().map(Vec::as_slice).collect()
}

fn coefficients(fit: &Fit) -> Vec<Coefficient> {
    let mut all = vec![fit.intercept];
    all.extend(fit.terms.iter().filter_map(|t| t.coefficient().copied()));
    all
}

fn agrees(name: &str, fit: &Fit, expected: &Value, tolerance: f64) {
    let c = coefficients(fit);
    let pick = |f: fn(&Coefficient) -> f64| c.iter().map(f).collect::<Vec<_>>();
    all_close(&format!("{name} estimate"), &pick(|c| c.estimate), &floats(&expected["estimate"]), tolerance);
    all_close(&format!("{name} se"), &pick(|c| c.se), &floats(&expected["se"]), tolerance);
    if expected["z"].is_array() {
        all_close(&format!("{name} z"), &pick(|c| c.z), &floats(&expected["z"]), tolerance);
        all_close(&format!("{name} ln p"), &pick(|c| c.ln_p), &floats(&expected["ln_p"]), tolerance);
        close(&format!("{name} ln L"), fit.log_likelihood, float(&expected["log_likelihood"]), 1e-9);
        let q = c.len();
        let covariance: Vec<f64> = (0..q * q).map(|i| fit.covariance(i / q, i % q).unwrap()).collect();
        all_close(&format!("{name} covariance"), &covariance, &floats(&expected["covariance"]), tolerance);
    }
}

#[test]
fn maximum_likelihood_matches_statsmodels() {
    let case = &reference()["plain"];
    let owned = columns(&case["columns"]);
    let columns = borrowed(&owned);
    let outcomes = bools(&case["outcomes"]);
    let weights = floats(&case["weights"]);
    let plain = Data::new(&columns, &outcomes, None).unwrap();
    let weighted = Data::new(&columns, &outcomes, Some(&weights)).unwrap();
    // The third column is at 1000 ± 3, so the reference itself loses digits on the raw scale.
    agrees("raw", &fit(plain, ML).unwrap(), &case["raw"], 1e-7);
    let standardized = Options { scale: Scale::Standardized, ..ML };
    agrees("standardized", &fit(plain, standardized).unwrap(), &case["standardized"], 1e-9);
    agrees("weighted", &fit(weighted, ML).unwrap(), &case["weighted"], 1e-7);
    let sandwich = Options { covariance: Covariance::Sandwich, ..ML };
    agrees("sandwich", &fit(weighted, sandwich).unwrap(), &case["sandwich"], 1e-7);
}

#[test]
fn firth_matches_direct_maximisation() {
    let case = &reference()["plain"];
    let owned = columns(&case["columns"]);
    let columns = borrowed(&owned);
    let outcomes = bools(&case["outcomes"]);
    let weights = floats(&case["weights"]);
    let options = Options { scale: Scale::Standardized, ..FIRTH };
    agrees("firth", &fit(Data::new(&columns, &outcomes, None).unwrap(), options).unwrap(), &case["firth"], 1e-6);
    let two = &columns[..2];
    agrees(
        "firth weighted",
        &fit(Data::new(two, &outcomes, Some(&weights)).unwrap(), FIRTH).unwrap(),
        &case["firth_weighted"],
        1e-6,
    );
}

#[test]
fn rare_events_match_and_are_flagged() {
    let case = &reference()["rare"];
    let owned = [formula(10_000, 7919, 10_007), formula(10_000, 104_729, 99_991)];
    let columns = borrowed(&owned);
    let mut outcomes = vec![false; 10_000];
    for row in case["rows"].as_array().unwrap() {
        outcomes[row.as_u64().unwrap() as usize] = true;
    }
    let data = Data::new(&columns, &outcomes, None).unwrap();
    let found = fit(data, ML).unwrap();
    agrees("rare", &found, &case["raw"], 1e-8);
    assert_eq!(found.cautions, vec![Caution::FewEvents { events: 10, coefficients: 2 }]);
    agrees("rare firth", &fit(data, FIRTH).unwrap(), &case["firth"], 1e-6);
}

#[test]
fn tiny_p_values_stay_finite() {
    let case = &reference()["overwhelming"]["raw"];
    let u = formula(20_000, 7919, 20_011);
    let v = formula(20_000, 104_729, 99_991);
    let outcomes: Vec<bool> = u.iter().zip(&v).map(|(u, v)| u + 0.8 * (v - 0.5) > 0.5).collect();
    let columns = [u.as_slice()];
    let found = fit(Data::new(&columns, &outcomes, None).unwrap(), ML).unwrap();
    agrees("overwhelming", &found, case, 1e-8);
    assert!(coefficients(&found)[1].ln_p < -700.0);
}

#[test]
fn complete_separation_uses_firth() {
    let case = &reference()["complete"];
    let owned = columns(&case["columns"]);
    let columns = borrowed(&owned);
    let outcomes = bools(&case["outcomes"]);
    let data = Data::new(&columns, &outcomes, None).unwrap();
    let Err(RegressionError::Separated(found)) = fit(data, ML) else { panic!("expected separation") };
    assert_eq!((found.kind, found.rows), (SeparationKind::Complete, 8));
    assert_eq!((found.columns, found.signs), (vec![0], vec![1]));
    let answer = fit(data, Options::default()).unwrap();
    assert_eq!(answer.estimator, Estimator::Firth);
    agrees("complete", &answer, &case["firth"], 1e-6);
    let profile = firth_profile(data, 0, Confidence::P95).unwrap();
    let expected = &case["profile"];
    close("profile estimate", profile.estimate, float(&expected["estimate"]), 1e-6);
    all_close("profile", &[profile.interval.low, profile.interval.high], &floats(&expected["interval"]), 1e-6);
    close("profile p", profile.ln_p, float(&expected["ln_p"]), 1e-6);
}

#[test]
fn quasi_separation_uses_firth() {
    let case = &reference()["quasi"];
    let owned = columns(&case["columns"]);
    let columns = borrowed(&owned);
    let outcomes = bools(&case["outcomes"]);
    let data = Data::new(&columns, &outcomes, None).unwrap();
    let found = separation(data).unwrap().unwrap();
    assert_eq!((found.kind, found.rows), (SeparationKind::Quasi, 40));
    assert_eq!((found.columns, found.signs), (vec![2], vec![-1]));
    agrees("quasi", &fit(data, Options::default()).unwrap(), &case["firth"], 1e-6);
    for (name, column) in [("profile", 2), ("profile_x", 0)] {
        let profile = firth_profile(data, column, Confidence::P95).unwrap();
        let expected = &case[name];
        all_close(name, &[profile.interval.low, profile.interval.high], &floats(&expected["interval"]), 1e-6);
        close(name, profile.ln_p, float(&expected["ln_p"]), 1e-5);
    }
}

/// Asserts the number of separated rows, and returns the kind that follows from it.
fn separates(columns: &[&[f64]], outcomes: &[bool], rows: u64, case: &str) -> &'static str {
    let data = Data::new(columns, outcomes, None).unwrap();
    let found = separation(data).unwrap();
    assert_eq!(found.as_ref().map_or(0, |found| found.rows as u64), rows, "{case}");
    assert!(fit(data, Options::default()).is_ok(), "{case}");
    match found.map(|found| found.kind) {
        None => "none",
        Some(SeparationKind::Quasi) => "quasi",
        Some(SeparationKind::Complete) => {
            assert_eq!(rows as usize, outcomes.len(), "{case}");
            "complete"
        }
    }
}

#[test]
fn separation_matches_scipy() {
    let mut kinds = std::collections::BTreeMap::new();
    let reference: Value = serde_json::from_str(include_str!("../reference/separation.json")).unwrap();
    for case in list(&reference["small"]) {
        let owned = columns(&case["columns"]);
        let outcomes: Vec<bool> = list(&case["outcomes"]).iter().map(|o| count(o) > 0).collect();
        let kind = separates(&borrowed(&owned), &outcomes, count(&case["rows"]), &case.to_string());
        *kinds.entry(kind).or_insert(0) += 1;
    }
    assert!(kinds.len() == 3 && kinds.values().all(|n| *n >= 10), "{kinds:?}");
}

/// Rare outcomes, rare categories and up to 33 columns, from the integers of `tests/reference/separation.py`.
#[test]
fn separation_of_many_columns_matches_scipy() {
    fn unit(row: u64, column: u64, case: u64) -> f64 {
        let mut x = (row * 2_654_435_761 + column * 40_503 + case * 97 + 12_345) % (1 << 32);
        for (shift, factor) in [(15, 2_246_822_519), (13, 3_266_489_917), (16, 1)] {
            x = ((x ^ (x >> shift)) * factor) % (1 << 32);
        }
        x as f64 / (1_u64 << 32) as f64
    }
    let value = |row, column, case| {
        let u = unit(row, column, case);
        match column % 3 {
            0 => (100.0 * u).floor() / 100.0,
            1 => f64::from(u < 0.03),
            _ => (3.0 * u).floor(),
        }
    };
    let reference: Value = serde_json::from_str(include_str!("../reference/separation.json")).unwrap();
    for (case, expected) in (0..).zip(list(&reference["large"])) {
        let rows = count(&expected["rows"]);
        let owned: Vec<Vec<f64>> = (0..count(&expected["columns"]))
            .map(|column| (0..rows).map(|row| value(row, column, case)).collect())
            .collect();
        let outcomes: Vec<bool> = (0..rows)
            .zip(owned[0].iter().zip(&owned[1]).zip(&owned[2]))
            .map(|(row, ((x, special), level))| {
                let rare = unit(row, 99, case) < 0.02 + 0.01 * (case % 3) as f64;
                match case % 4 {
                    0 => rare,
                    1 => rare && *special < 0.5,
                    2 => x + level / 3.0 > 0.8,
                    _ if *special > 0.5 => *x > 0.5,
                    _ => rare,
                }
            })
            .collect();
        let text = format!("case {case}: {expected}");
        separates(&borrowed(&owned), &outcomes, count(&expected["separated"]), &text);
    }
}

#[test]
fn overlapping_outcomes_are_not_separated() {
    let case = &reference()["plain"];
    let owned = columns(&case["columns"]);
    let columns = borrowed(&owned);
    let outcomes = bools(&case["outcomes"]);
    assert_eq!(separation(Data::new(&columns, &outcomes, None).unwrap()), Ok(None));
}

#[test]
fn redundant_columns_are_dropped() {
    let case = &reference()["plain"];
    let owned = columns(&case["columns"]);
    let outcomes = bools(&case["outcomes"]);
    let constant = vec![0.3; outcomes.len()];
    let sum: Vec<f64> = owned[0].iter().zip(&owned[1]).map(|(a, b)| 2.0 * a - b + 7.0).collect();
    let columns: Vec<&[f64]> = vec![&constant, &owned[0], &owned[1], &sum, &owned[2]];
    let found = fit(Data::new(&columns, &outcomes, None).unwrap(), ML).unwrap();
    assert_eq!(found.terms[0], Term::Dropped(Dropped::Constant));
    assert_eq!(found.terms[3], Term::Dropped(Dropped::CollinearWith(vec![1, 2])));
    assert_eq!(found.covariance(1, 1), None);
    let c = coefficients(&found);
    let estimates: Vec<f64> = c.iter().map(|c| c.estimate).collect();
    all_close("estimate", &estimates, &floats(&case["raw"]["estimate"]), 1e-7);
}

#[test]
fn invalid_data_are_located() {
    let column = [0.0, f64::NAN];
    let columns = [column.as_slice()];
    assert!(matches!(
        Data::new(&columns, &[true, false], None),
        Err(RegressionError::NotFinite { column: 0, row: 1, .. })
    ));
    assert!(matches!(
        Data::new(&columns, &[true], None),
        Err(RegressionError::ColumnLength { column: 0, expected: 1, found: 2 })
    ));
    let none: [&[f64]; 0] = [];
    assert_eq!(fit(Data::new(&none, &[], None).unwrap(), ML), Err(RegressionError::NoRows));
    assert_eq!(
        fit(Data::new(&none, &[true, true], None).unwrap(), ML),
        Err(RegressionError::OneClass { rows: 2, success: true })
    );
    assert!(matches!(Data::new(&none, &[true], Some(&[-1.0])), Err(RegressionError::BadWeight { row: 0, .. })));
}

#[test]
fn empty_model_gives_weighted_rate() {
    let none: [&[f64]; 0] = [];
    let data = Data::new(&none, &[true, false, false], Some(&[3.0, 1.0, 0.0])).unwrap();
    let found = fit(data, ML).unwrap();
    assert!((found.probability(&[]).unwrap() - 0.75).abs() < 1e-12);
    assert_eq!(found.rows, 2);
}

#[test]
fn extreme_magnitudes_are_handled() {
    let big = [1e308, -1e308, 1e308, -1e308, 3.0, 2e307];
    let tiny = [1e-320, 0.0, 2e-320, 1e-320, 0.0, 3e-320];
    let outcomes = [true, false, false, true, true, false];
    let columns: Vec<&[f64]> = vec![&big, &tiny];
    if let Ok(found) = fit(Data::new(&columns, &outcomes, None).unwrap(), Options::default()) {
        assert!(coefficients(&found).iter().all(|c| !c.estimate.is_nan()));
    }
}
