//! Compares gradient boosting and the spline model with LightGBM and scikit-learn (`tests/reference/boosting.py`).

use robogate_stats::boosting::{Boosting, Monotone, Options};
use robogate_stats::spline_logistic::SplineLogistic;
use serde_json::Value;

use super::{bools, count, float, floats, list};

struct Rows {
    columns: Vec<Vec<f64>>,
    success: Vec<bool>,
}

impl Rows {
    fn read(value: &Value) -> Self {
        Self { columns: list(&value["columns"]).iter().map(floats).collect(), success: bools(&value["success"]) }
    }

    fn views(&self) -> Vec<&[f64]> {
        self.columns.iter().map(Vec::as_slice).collect()
    }

    fn predict(&self, log_odds: impl Fn(&[f64]) -> f64) -> Vec<f64> {
        let row = |row: usize| self.columns.iter().map(|column| column[row]).collect::<Vec<f64>>();
        (0..self.success.len()).map(|at| 1.0 / (1.0 + (-log_odds(&row(at))).exp())).collect()
    }
}

fn mean_square(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64
}

#[test]
fn learners_match_references() {
    let reference: Value = serde_json::from_str(include_str!("../reference/boosting.json")).unwrap();
    let (train, test) = (Rows::read(&reference["train"]), Rows::read(&reference["test"]));
    let truth = floats(&reference["test"]["p"]);
    let outcomes: Vec<f64> = test.success.iter().map(|y| f64::from(u8::from(*y))).collect();

    let given = &reference["options"];
    let options = Options {
        trees: count(&given["trees"]) as usize,
        learning_rate: float(&given["learning_rate"]),
        leaves: count(&given["leaves"]) as usize,
        rows_of_leaf: count(&given["rows_of_leaf"]) as usize,
        row_share: 1.0,
        column_share: 1.0,
        ..Options::default()
    };
    let constraints = [Monotone::Increasing, Monotone::Decreasing, Monotone::Free, Monotone::Free];
    let model = Boosting::fit(&train.views(), &train.success, &constraints, options).unwrap();
    let ours = test.predict(|row| model.log_odds(row));
    let (brier, error) = (mean_square(&ours, &outcomes), mean_square(&ours, &truth));
    for name in ["lightgbm", "histogram"] {
        let theirs = &reference[name];
        let first = floats(&theirs["first"]);
        let apart = mean_square(&ours[..first.len()], &first).sqrt();
        // The two references are 0.05 apart, because they cut bins differently.
        assert!(apart < 0.06, "{name}: predictions are {apart} apart");
        assert!(brier < float(&theirs["brier"]) + 0.002, "{name}: Brier score {brier}");
        assert!(error < float(&theirs["error"]) + 0.002, "{name}: error {error}");
    }

    let model = SplineLogistic::fit(&train.views(), &train.success, &[0, 1, 2]).unwrap();
    let ours = test.predict(|row| model.log_odds(row));
    // The evidence selects one of three prior variances.
    let apart = |theirs: &Value| {
        let first = floats(&theirs["first"]);
        first.iter().zip(&ours).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let nearest = list(&reference["splines"]).iter().map(apart).fold(f64::INFINITY, f64::min);
    assert!(nearest < 1e-5, "the nearest spline model of scikit-learn is {nearest} apart");
}
