//! Agreement tests for ROC, calibration, frontier, thresholds, comparisons, weights, correlations and modes.

use crate::{all_close, bools, close, count, float, floats, formula, list, reference};
use robogate_maths::beta::student_quantile;
use robogate_stats::binning::Edges;
use robogate_stats::calibration::{Bins, calibration};
use robogate_stats::compare::{Pairs, at_least, at_most, mcnemar_exact, newcombe, newcombe_paired, z_test};
use robogate_stats::correlation::{cramers_v, pearson, point_biserial, spearman};
use robogate_stats::limit_state::{CompatibleSet, LimitState};
use robogate_stats::logistic::{Data, Options, RegressionError, fit};
use robogate_stats::modes::{Joint, distribution};
use robogate_stats::multiplicity::holm;
use robogate_stats::resample::{percentile_ends, standard_error};
use robogate_stats::roc::{RocError, auc, compare, cross_validate, curve};
use robogate_stats::threshold::{Threshold, ThresholdOptions, threshold};
use robogate_stats::weighted::{hajek, horvitz_thompson};
use robogate_stats::{Confidence, Trials};
use serde_json::Value;

const P95: Confidence = Confidence::P95;

fn plain(reference: &Value) -> (Vec<Vec<f64>>, Vec<bool>, Vec<f64>) {
    let case = &reference["plain"];
    let columns = list(&case["columns"]).iter().map(floats).collect();
    (columns, bools(&case["outcomes"]), floats(&case["weights"]))
}

#[test]
fn auc_matches_scikit_learn() {
    let reference = reference();
    let (_, outcomes, _) = plain(&reference);
    let case = &reference["roc"];
    let (first, second) = (floats(&case["first"]), floats(&case["second"]));
    for (i, scores) in [&first, &second].into_iter().enumerate() {
        let ours = auc(scores, &outcomes, None, P95).unwrap();
        close("auc", ours.auc, floats(&case["auc"])[i], 1e-12);
        close("se", ours.se.unwrap(), floats(&case["se"])[i], 1e-11);
    }
    let ours = auc(&first, &outcomes, None, P95).unwrap();
    all_close("interval", &[ours.interval.low, ours.interval.high], &floats(&case["interval"]), 1e-11);
    let clusters: Vec<usize> = (0..outcomes.len()).map(|row| row / 3).collect();
    let ours = auc(&first, &outcomes, Some(&clusters), P95).unwrap();
    close("clustered se", ours.se.unwrap(), float(&case["clustered_se"]), 1e-11);
    let both = compare(&first, &second, &outcomes, P95).unwrap().unwrap();
    close("difference se", both.se, float(&case["difference_se"]), 1e-10);
    close("difference p", both.ln_p.unwrap(), float(&case["difference_ln_p"]), 1e-9);
    let points = curve(&second, &outcomes).unwrap();
    let pick = |f: fn(&robogate_stats::roc::RocPoint) -> f64| points.iter().map(f).collect::<Vec<_>>();
    all_close("fpr", &pick(|p| p.false_positive_rate), &floats(&case["fpr"]), 1e-12);
    all_close("tpr", &pick(|p| p.true_positive_rate), &floats(&case["tpr"]), 1e-12);
    all_close("threshold", &pick(|p| p.threshold)[1..], &floats(&case["thresholds"]), 1e-12);
}

#[derive(Debug)]
struct Failed;
impl From<RocError> for Failed {
    fn from(_: RocError) -> Self {
        Self
    }
}
impl From<RegressionError> for Failed {
    fn from(_: RegressionError) -> Self {
        Self
    }
}

#[test]
fn cross_validation_matches_scikit_learn() {
    let reference = reference();
    let (columns, outcomes, _) = plain(&reference);
    let folds: Vec<usize> = (0..outcomes.len()).map(|i| i % 5).collect();
    let result = cross_validate::<Failed>(&outcomes, None, &folds, P95, |train, test| {
        let pick = |c: &[f64], rows: &[usize]| rows.iter().map(|&i| c[i]).collect::<Vec<f64>>();
        let (a, b) = (pick(&columns[0], train), pick(&columns[1], train));
        let y: Vec<bool> = train.iter().map(|&i| outcomes[i]).collect();
        let model = fit(Data::new(&[&a, &b], &y, None)?, Options::default())?;
        let (a, b) = (pick(&columns[0], test), pick(&columns[1], test));
        Ok(model.probabilities(&[&a, &b]).unwrap())
    })
    .unwrap();
    let ours: Vec<f64> = result.folds.iter().map(|f| f.unwrap()).collect();
    all_close("folds", &ours, &floats(&reference["cross_validated"]["folds"]), 1e-9);
    // Satterthwaite's degrees of freedom of the mean of the folds.
    let (mut sum, mut spread) = (0.0, 0.0);
    for fold in 0..5 {
        let of = |i: &usize| folds[*i] == fold;
        let (scores, truth): (Vec<f64>, Vec<bool>) =
            (0..folds.len()).filter(of).map(|i| (result.scores[i], outcomes[i])).unzip();
        let one = auc(&scores, &truth, None, P95).unwrap();
        sum += one.se.unwrap().powi(2);
        spread += one.se.unwrap().powi(4) / one.df.unwrap();
    }
    let se = sum.sqrt() / 5.0;
    let half = student_quantile(sum * sum / spread, 0.95) * se;
    close("se", result.se.unwrap(), se, 1e-12);
    all_close("interval", &[result.interval.low, result.interval.high], &[result.auc - half, result.auc + half], 1e-12);
}

#[test]
fn calibration_matches_scikit_learn() {
    let reference = reference();
    let (_, outcomes, weights) = plain(&reference);
    let case = &reference["calibration"];
    let stated = floats(&case["stated"]);
    let ours = calibration(&stated, &outcomes, None, None, Bins::EqualWidth(10), P95).unwrap();
    close("brier", ours.brier, float(&case["brier"]), 1e-12);
    close("log loss", ours.log_loss.unwrap(), float(&case["log_loss"]), 1e-12);
    close("ece", ours.expected_error, float(&case["expected_error"]), 1e-11);
    let observed: Vec<f64> = ours.bins.iter().map(|b| b.observed).collect();
    let mean: Vec<f64> = ours.bins.iter().map(|b| b.stated).collect();
    all_close("observed", &observed, &floats(&case["observed"]), 1e-12);
    all_close("stated", &mean, &floats(&case["mean_stated"]), 1e-12);
    let weighted = calibration(&stated, &outcomes, Some(&weights), None, Bins::EqualCount(10), P95).unwrap();
    close("weighted brier", weighted.brier, float(&case["brier_weighted"]), 1e-12);
    close("weighted log loss", weighted.log_loss.unwrap(), float(&case["log_loss_weighted"]), 1e-12);
}

#[test]
fn frontier_matches_numerical_solution() {
    let reference = reference();
    let (columns, outcomes, _) = plain(&reference);
    let (state, _) = LimitState::fit(&columns[0], &columns[1], &outcomes, None, None, Options::default(), 0.5).unwrap();
    for case in list(&reference["limit_state"]["points"]) {
        let point = state.at(float(&case["y"]), P95).unwrap();
        close("x", point.x, float(&case["x"]), 1e-7);
        close("se", point.se, float(&case["se"]), 1e-6);
        let ends = floats(&case["ends"]);
        match point.set {
            CompatibleSet::Bounded(i) | CompatibleSet::Outside(i) => all_close("set", &[i.low, i.high], &ends, 1e-6),
            CompatibleSet::Everything => assert!(ends.is_empty()),
        }
    }
}

#[test]
fn thresholds_match_row_bootstrap() {
    let u = formula(4_000, 7919, 4_001);
    let v = formula(4_000, 104_729, 99_991);
    let outcomes: Vec<bool> = u.iter().zip(&v).map(|(u, v)| 0.15 + 0.6 * u > *v).collect();
    let weights: Vec<f64> = (0..4_000).map(|i| if i % 3 == 0 { 2.5 } else { 0.5 }).collect();
    let edges = Edges::equal_width(&u, 10).unwrap();
    let options = ThresholdOptions { replicates: 4_000, ..Default::default() };
    for (name, weights) in [("plain", None), ("weighted", Some(weights.as_slice()))] {
        let case = &reference()["threshold"][name];
        let found = threshold(&u, &outcomes, weights, None, &edges, options).unwrap();
        let monotone: Vec<f64> = found.bins.iter().map(|b| b.monotone_rate).collect();
        all_close("monotone", &monotone, &floats(&case["monotone"]), 1e-12);
        let Threshold::Crosses { at, low, high, se, .. } = found.threshold else { panic!("it crosses") };
        close(name, at, float(&case["at"]), 1e-10);
        // Two bootstraps of 4,000 replicates: the error of an SE is about 1.1 %, that of a percentile end about 4 % of
        // the SE.
        let (se, theirs) = (se.unwrap(), float(&case["se"]));
        assert!((se / theirs - 1.0).abs() < 0.05, "{name}: {se} against {theirs}");
        for (ours, end) in [low.unwrap(), high.unwrap()].iter().zip(floats(&case["interval"])) {
            assert!((ours - end).abs() < 0.25 * theirs, "{name}: {ours} against {end}");
        }
    }
}

#[test]
fn rate_comparisons_match_statsmodels() {
    for case in list(&reference()["two_rates"]) {
        let trials = |k, n| Trials::new(count(&case[k]), count(&case[n])).unwrap();
        let (a, b) = (trials("k1", "n1"), trials("k2", "n2"));
        let test = z_test(a, b).unwrap();
        close("z", test.z, float(&case["z"]), 1e-12);
        close("p", test.ln_p, float(&case["ln_p"]), 1e-11);
        let d = newcombe(a, b, P95);
        // The reference does not clamp at ±1.
        let theirs: Vec<f64> = floats(&case["newcombe"]).iter().map(|e| e.clamp(-1.0, 1.0)).collect();
        for (ours, end) in [d.interval.low, d.interval.high].iter().zip(theirs) {
            assert!((ours - end).abs() < 1e-12, "{case}: {ours} against {end}");
        }
    }
}

#[test]
fn paired_comparisons_match_reference() {
    for case in list(&reference()["pairs"]) {
        let t: Vec<u64> = list(&case["table"]).iter().map(count).collect();
        let pairs = Pairs { both: t[0], first_only: t[1], second_only: t[2], neither: t[3] };
        let (ours, theirs) = (mcnemar_exact(pairs), float(&case["ln_p"]));
        assert!((ours - theirs).abs() < 1e-11 * theirs.abs().max(1.0), "{case}: {ours}");
        let d = newcombe_paired(pairs, P95).interval;
        for (ours, end) in [d.low, d.high].iter().zip(floats(&case["newcombe"])) {
            assert!((ours - end).abs() < 1e-12, "{case}: {ours} against {end}");
        }
    }
}

#[test]
fn exact_tests_match_in_far_tails() {
    for case in list(&reference()["one_rate"]) {
        let trials = Trials::new(count(&case["k"]), count(&case["n"])).unwrap();
        let p0 = float(&case["p0"]);
        for (ours, theirs) in
            [(at_most(trials, p0), float(&case["at_most"])), (at_least(trials, p0), float(&case["at_least"]))]
        {
            assert!((ours - theirs).abs() < 1e-10 * theirs.abs().max(1.0), "{case}: {ours} against {theirs}");
        }
    }
}

#[test]
fn holm_matches_statsmodels() {
    let case = &reference()["holm"];
    all_close("holm", &holm(&floats(&case["p"])).unwrap(), &floats(&case["adjusted"]), 1e-14);
}

#[test]
fn weighted_rates_match_least_squares() {
    let reference = reference();
    let (_, outcomes, weights) = plain(&reference);
    let case = &reference["weighted"];
    let ours = hajek(&outcomes, &weights, P95).unwrap();
    close("rate", ours.rate.unwrap(), float(&case["rate"]), 1e-12);
    close("se", ours.se.unwrap(), float(&case["se"]), 1e-11);
    close("effective", ours.effective, float(&case["effective"]), 1e-12);
    let h = horvitz_thompson(&outcomes, &weights, 500.0).unwrap();
    close("ht", h.rate, float(&case["horvitz_thompson"]), 1e-12);
    close("ht se", h.se.unwrap(), float(&case["horvitz_thompson_se"]), 1e-11);
}

#[test]
fn correlations_match_scipy() {
    let reference = reference();
    let (columns, outcomes, _) = plain(&reference);
    let (s1, s2) = (floats(&reference["roc"]["first"]), floats(&reference["roc"]["second"]));
    let case = &reference["correlation"];
    let found = [
        ("pearson", pearson(&columns[0], &s1, P95).unwrap()),
        ("point_biserial", point_biserial(&columns[0], &outcomes, P95).unwrap()),
        ("spearman", spearman(&s1, &s2, P95).unwrap()),
    ];
    for (name, ours) in found {
        close(name, ours.r, float(&case[name]["r"]), 1e-11);
        close(name, ours.ln_p.unwrap(), float(&case[name]["ln_p"]), 1e-10);
    }
    let i = found[0].1.interval;
    all_close("fisher", &[i.low, i.high], &floats(&case["pearson"]["interval"]), 1e-11);

    let cramer = &case["cramer"];
    let codes = |key: &str| list(&cramer[key]).iter().map(|c| count(c) as usize).collect::<Vec<_>>();
    let ours = cramers_v(&codes("a"), &codes("b")).unwrap();
    close("v", ours.v, float(&cramer["v"]), 1e-11);
    close("chi squared", ours.chi_squared, float(&cramer["chi_squared"]), 1e-11);
    close("p", ours.ln_p, float(&cramer["ln_p"]), 1e-11);
    close("expected", ours.smallest_expected, float(&cramer["smallest_expected"]), 1e-12);
    let high: Vec<usize> = columns[0].iter().map(|x| usize::from(*x > 0.5)).collect();
    let success: Vec<usize> = outcomes.iter().map(|o| usize::from(*o)).collect();
    close("phi", cramers_v(&high, &success).unwrap().phi.unwrap(), float(&case["phi"]), 1e-11);
}

#[test]
fn simultaneous_shares_match_statsmodels() {
    let case = &reference()["modes"];
    let counts: Vec<u64> = list(&case["counts"]).iter().map(count).collect();
    let shares = distribution(&counts, Joint::Simultaneous, P95);
    let ours: Vec<f64> = shares.iter().flat_map(|s| [s.interval.low, s.interval.high]).collect();
    for (ours, theirs) in ours.iter().zip(floats(&case["goodman"])) {
        assert!((ours - theirs).abs() < 1e-12, "{ours} against {theirs}");
    }
}

#[test]
fn percentiles_match_numpy() {
    let case = &reference()["percentile"];
    let mut values = floats(&case["values"]);
    close("sd", standard_error(&values).unwrap(), float(&case["sd"]), 1e-12);
    let (low, high) = percentile_ends(&mut values, Confidence::new(0.9).unwrap()).unwrap();
    all_close("ends", &[low, high], &floats(&case["ends"]), 1e-12);
}
