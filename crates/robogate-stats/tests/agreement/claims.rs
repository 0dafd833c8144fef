//! Compares the tests behind headlines with `tests/reference/claims.py`.

use robogate_stats::adjusted::{Control, adjusted};
use robogate_stats::likelihood_ratio::likelihood_ratio;
use robogate_stats::logistic::{Data, Options, fit, interaction};
use robogate_stats::scan::{Order, scan};
use robogate_stats::score_test::{ScoreTest, two_sided};
use robogate_stats::{Confidence, Trials};
use serde_json::Value;

use super::{close, count, float, formula, list};

const ROWS: u64 = 400;

fn reference() -> Value {
    serde_json::from_str(include_str!("../reference/claims.json")).unwrap()
}

/// Two numbers from -1 to 1, five levels, and outcomes.
fn rows() -> (Vec<f64>, Vec<f64>, Vec<u64>, Vec<bool>) {
    let centred = |multiplier, modulus| -> Vec<f64> {
        formula(ROWS, multiplier, modulus).iter().map(|v| v * 2.0 - 1.0).collect()
    };
    let (a, b) = (centred(37, 101), centred(53, 211));
    let level: Vec<u64> = (0..ROWS).map(|i| i * 7 % 5).collect();
    let p = |i: usize| 1.0 / (1.0 + (-(a[i] - 2.0 * b[i] + if level[i] == 2 { 0.8 } else { 0.0 })).exp());
    let y = formula(ROWS, 29, 97).iter().enumerate().map(|(i, u)| *u < p(i)).collect();
    (a, b, level, y)
}

#[test]
fn likelihood_ratio_matches_statsmodels() {
    let (a, b, level, y) = rows();
    let dummies: Vec<Vec<f64>> = (1..5).map(|k| level.iter().map(|l| f64::from(u8::from(*l == k))).collect()).collect();
    let small: [&[f64]; 2] = [&a, &b];
    let large: Vec<&[f64]> = small.iter().copied().chain(dummies.iter().map(Vec::as_slice)).collect();
    let fitted = |columns: &[&[f64]]| fit(Data::new(columns, &y, None).unwrap(), Options::default()).unwrap();
    let found = likelihood_ratio(&fitted(&large), &fitted(&small)).unwrap();
    let expected = &reference()["likelihood_ratio"];
    assert_eq!(found.df as u64, count(&expected["df"]));
    close("statistic", found.statistic, float(&expected["statistic"]), 1e-8);
    close("ln p", found.ln_p, float(&expected["ln_p"]), 1e-8);
}

#[test]
fn score_test_matches_statsmodels() {
    let (a, b, _, y) = rows();
    let columns: [&[f64]; 2] = [&a, &b];
    let data = Data::new(&columns, &y, None).unwrap();
    let z = ScoreTest::new(data, &fit(data, Options::default()).unwrap()).unwrap().z(&interaction(&a, &b)).unwrap();
    let expected = &reference()["score_test"];
    close("chi-squared", z * z, float(&expected["chi_squared"]), 1e-7);
    close("p", two_sided(z), float(&expected["p"]), 1e-7);
}

#[test]
fn scan_matches_scipy_permutations() {
    let expected = &reference()["scan"];
    let counts = |name: &str| list(&expected[name]).iter().map(count).collect::<Vec<u64>>();
    let cells: Vec<Trials> =
        counts("k").into_iter().zip(counts("n")).map(|(k, n)| Trials::new(k, n).unwrap()).collect();
    let found = scan(&cells, Order::Ordered, 20_000, 1).unwrap();
    close("log ratio", found.log_ratio, float(&expected["log_ratio"]), 1e-12);
    // Sampling stops after twenty replicates that reach the statistic, so the mean over seeds is compared.
    let mean = (0..400).map(|seed| scan(&cells, Order::Ordered, 20_000, seed).unwrap().p).sum::<f64>() / 400.0;
    let p = float(&expected["p"]);
    assert!((mean - p).abs() < 0.1 * p, "{mean} for {p}");
}

#[test]
fn adjusted_rate_matches_statsmodels() {
    let (_, _, _, y) = rows();
    let levels = |multiplier, modulus, levels: usize| Control::Levels {
        of: formula(ROWS, multiplier, modulus).iter().map(|u| (u * levels as f64) as u16).collect(),
        shares: vec![1.0 / levels as f64; levels],
    };
    let found = adjusted(&[levels(37, 101, 4), levels(53, 211, 3)], &y, Confidence::P95).unwrap();
    let expected = &reference()["adjusted"];
    close("rate", found.rate, float(&expected["rate"]), 1e-10);
    close("se", found.se, float(&expected["se"]), 1e-10);
    let uniform = |multiplier, modulus, knots| Control::Uniform { at: formula(ROWS, multiplier, modulus), knots };
    let found = adjusted(&[uniform(37, 101, 5), uniform(53, 211, 3)], &y, Confidence::P95).unwrap();
    let expected = &reference()["adjusted_linear"];
    close("rate", found.rate, float(&expected["rate"]), 1e-8);
    close("se", found.se, float(&expected["se"]), 1e-8);
}
