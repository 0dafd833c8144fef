//! Compares penalised fits and crossed means with `tests/reference/ridge.py`.

use robogate_stats::Confidence;
use robogate_stats::crossed::crossed_mean;
use robogate_stats::logistic::Data;
use robogate_stats::ridge::{by_evidence, fit};
use serde_json::Value;

use super::{all_close, close, float, floats, formula, list};

fn reference() -> Value {
    serde_json::from_str(include_str!("../reference/ridge.json")).unwrap()
}

fn logistic(t: f64) -> f64 {
    1.0 / (1.0 + (-t).exp())
}

#[test]
fn ridge_matches_scikit_learn() {
    let n = 300;
    let centred = |multiplier, modulus| formula(n, multiplier, modulus).iter().map(|v| v * 2.0 - 1.0).collect();
    let (a, b, c): (Vec<f64>, Vec<f64>, Vec<f64>) = (centred(37, 101), centred(53, 211), centred(71, 307));
    let product: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a * b).collect();
    let twice: Vec<f64> = c.iter().map(|c| 2.0 * c).collect();
    let law = |i: usize| logistic(3.0 * a[i] - 2.0 * b[i] + product[i]);
    let y: Vec<bool> = formula(n, 29, 97).iter().enumerate().map(|(i, u)| *u < law(i)).collect();
    let w: Vec<f64> = formula(n, 11, 13).iter().map(|v| 0.5 + v).collect();
    let columns: [&[f64]; 5] = [&a, &b, &product, &c, &twice];
    let fresh: [&[f64]; 5] =
        [&[0.0, 0.9, -1.0], &[0.0, -0.9, 4.0], &[0.0, -0.81, -4.0], &[0.0, 0.3, -3.0], &[0.0, 0.6, -6.0]];
    let mut evidence = Vec::new();
    for case in list(&reference()["ridge"]) {
        let weighted = case["weighted"].as_bool().unwrap();
        let data = Data::new(&columns, &y, weighted.then_some(&w)).unwrap();
        let found = fit(data, float(&case["s2"])).unwrap();
        let name = format!("s2 {} weighted {weighted}", case["s2"]);
        for (ours, theirs) in found.coefficients.iter().zip(floats(&case["beta"])) {
            assert!((ours - theirs).abs() < 1e-7, "{name}: {ours} {theirs}");
        }
        close(&name, found.log_likelihood, float(&case["log_likelihood"]), 1e-7);
        close(&name, found.log_evidence, float(&case["evidence"]), 1e-7);
        let moderated: Vec<f64> = found.log_odds(&fresh).unwrap().into_iter().map(logistic).collect();
        all_close(&name, &moderated, &floats(&case["moderated"]), 1e-6);
        if !weighted {
            evidence.push((float(&case["s2"]), found.log_evidence));
        }
    }
    let data = Data::new(&columns, &y, None).unwrap();
    let best = by_evidence(data, &evidence.iter().map(|(s2, _)| *s2).collect::<Vec<_>>()).unwrap().unwrap();
    let most = evidence.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    close("largest evidence", best.log_evidence, most.1, 1e-9);
    close("its prior", best.prior_variance, most.0, 0.0);
}

#[test]
fn crossed_mean_matches_reference() {
    let reference = reference();
    let values = floats(&reference["repeats"]["values"]);
    let table: Vec<Vec<f64>> = values.iter().map(|v| vec![*v; 3]).collect();
    let found = crossed_mean(&table, Confidence::P95).unwrap();
    let interval = found.interval.unwrap();
    all_close("t", &[interval.low, interval.high], &floats(&reference["repeats"]["interval"]), 1e-9);

    let cell = |r: u64, i: u64| ((r * 31 + i * 17 + r * i * 7) % 23) as f64 / 23.0;
    let table: Vec<Vec<f64>> = (0..4).map(|r| (0..11).map(|i| cell(r, i)).collect()).collect();
    let found = crossed_mean(&table, Confidence::new(0.9).unwrap()).unwrap();
    let interval = found.interval.unwrap();
    all_close("both", &[interval.low, interval.high], &floats(&reference["crossed"]["interval"]), 1e-9);
    close("se of repeats", found.se_repeats.unwrap(), float(&reference["crossed"]["se_repeats"]), 1e-12);
    close("se of rows", found.se_rows.unwrap(), float(&reference["crossed"]["se_rows"]), 1e-12);
}
