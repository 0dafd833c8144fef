//! Tests that any input gives a result or a typed error: no panic, no probability outside [0, 1], and no NaN as an
//! estimate.

#![expect(clippy::disallowed_methods, reason = "tests measure times and find their settings in the environment")]
#![expect(clippy::unwrap_used, reason = "test helpers fail by panicking")]

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::binning::{Edges, per_bin};
use robogate_stats::calibration::{Bins, calibration};
use robogate_stats::compare::{Pairs, at_least, at_most, mcnemar_exact, newcombe, newcombe_paired, z_test};
use robogate_stats::correlation::{cramers_v, pearson, point_biserial, spearman};
use robogate_stats::limit_state::LimitState;
use robogate_stats::logistic::{Covariance, Data, Estimator, Options, Scale, firth_profile, fit, separation};
use robogate_stats::modes::transitions;
use robogate_stats::multiplicity::holm;
use robogate_stats::roc::{auc, compare, curve, stratified_folds};
use robogate_stats::threshold::{Threshold, ThresholdOptions, threshold};
use robogate_stats::weighted::{hajek, horvitz_thompson};
use robogate_stats::{Confidence, Interval, Trials, clopper_pearson, wilson};

/// Values of damaged real files, among ordinary ones.
fn value(rng: &mut ChaCha8Rng, finite: bool) -> f64 {
    const ODD: [f64; 14] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        1e-320,
        -1e-308,
        1e308,
        -1e308,
        1e16,
        1.0000000000000002,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
    ];
    let kind = rng.next_u32() % 100;
    if kind < 25 {
        let odd = ODD[rng.next_u32() as usize % ODD.len()];
        if finite && !odd.is_finite() { 0.25 } else { odd }
    } else if kind < 60 {
        f64::from(rng.next_u32() % 4)
    } else {
        f64::from(rng.next_u32()) / f64::from(u32::MAX) * 4.0 - 2.0
    }
}

fn values(rng: &mut ChaCha8Rng, n: usize, finite: bool) -> Vec<f64> {
    (0..n).map(|_| value(rng, finite)).collect()
}

/// Valid weights, from the smallest to the largest.
fn weight(rng: &mut ChaCha8Rng) -> f64 {
    match rng.next_u32() % 12 {
        0 | 1 => 0.0,
        2 => 1e-150,
        3 => 1e150,
        4 => 1e-9,
        _ => f64::from(rng.next_u32() % 40) / 8.0,
    }
}

#[track_caller]
fn is_unit(i: Interval) {
    assert!(0.0 <= i.low && i.low <= i.high && i.high <= 1.0, "{i:?}");
}

fn one_round(rng: &mut ChaCha8Rng) {
    let n = [0, 1, 2, 3, 5, 9, 30, 200][rng.next_u32() as usize % 8];
    let finite = !rng.next_u32().is_multiple_of(4);
    let x = values(rng, n, finite);
    let y = values(rng, n, finite);
    let odd_weights = rng.next_u32().is_multiple_of(8);
    let weights: Vec<f64> = (0..n).map(|_| if odd_weights { value(rng, false) } else { weight(rng) }).collect();
    let share = rng.next_u32() % 5;
    let outcomes: Vec<bool> = (0..n).map(|_| rng.next_u32() % 4 < share).collect();
    let level = Confidence::P95;

    let k = rng.next_u64() % 50;
    let trials = Trials::new(k.min(n as u64), n as u64).unwrap();
    let other = Trials::count(outcomes.iter().copied());
    is_unit(wilson(trials, level));
    is_unit(clopper_pearson(trials, level));
    let difference = newcombe(trials, other, level).interval;
    assert!(-1.0 <= difference.low && difference.low <= difference.high && difference.high <= 1.0);
    let _ = z_test(trials, other);
    let p0 = value(rng, finite);
    assert!(at_most(trials, p0) <= 0.0);
    assert!(at_least(trials, p0) <= 0.0);
    let pairs = Pairs { both: k, first_only: k / 3, second_only: k % 7, neither: 3 };
    assert!(mcnemar_exact(pairs) <= 0.0);
    let _ = newcombe_paired(pairs, level);

    let clusters: Vec<usize> = (0..n).map(|i| (i * 7 + k as usize) % 9).collect();
    for clusters in [None, Some(clusters.as_slice())] {
        if let Ok(a) = auc(&x, &outcomes, clusters, level) {
            is_unit(a.interval);
            assert!(a.interval.contains(a.auc) || (a.auc - a.interval.high).abs() < 1e-12);
        }
        // Also with a row without a cluster.
        let clusters = clusters.map(|clusters| clusters.get(1..).unwrap_or_default());
        let folds = stratified_folds(&outcomes, clusters, k as usize, k);
        assert!(folds.len() == n && folds.iter().all(|fold| *fold < (k as usize).max(2)));
    }
    let _ = (compare(&x, &y, &outcomes, level), curve(&x, &outcomes));
    for bins in [Bins::EqualWidth(k as usize), Bins::EqualCount(k as usize)] {
        let stated: Vec<f64> = x.iter().map(|v| v.clamp(0.0, 1.0)).collect();
        if let Ok(c) = calibration(&stated, &outcomes, Some(&weights), Some(&clusters), bins, level) {
            for b in c.bins {
                is_unit(b.interval);
            }
        }
    }
    if let Ok(r) = hajek(&outcomes, &weights, level) {
        is_unit(r.interval);
        assert!(r.rate.is_none_or(|r| (0.0..=1.0).contains(&r)));
    }
    let _ = horvitz_thompson(&outcomes, &weights, value(rng, finite));
    for c in
        [pearson(&x, &y, level), point_biserial(&x, &outcomes, level), spearman(&x, &y, level)].into_iter().flatten()
    {
        assert!((-1.0..=1.0).contains(&c.r) && !c.interval.low.is_nan());
    }
    let codes: Vec<usize> = (0..n).map(|_| rng.next_u32() as usize % 4).collect();
    let others: Vec<usize> = outcomes.iter().map(|o| usize::from(*o)).collect();
    if let Ok(a) = cramers_v(&codes, &others) {
        assert!((0.0..=1.0).contains(&a.v) && (0.0..=1.0).contains(&a.v_corrected));
    }
    let _ = holm(&x);
    for edges in [Edges::equal_width(&x, k as usize), Edges::equal_count(&x, k as usize)].into_iter().flatten() {
        let cells = per_bin(&x, &outcomes, &edges).unwrap();
        assert_eq!(cells.cells.iter().map(|c| c.n()).sum::<u64>() as usize + cells.outside, n);
        let options = ThresholdOptions { replicates: 20, ..Default::default() };
        for w in [None, Some(weights.as_slice())] {
            if let Ok(found) = threshold(&x, &outcomes, w, None, &edges, options)
                && let Threshold::Crosses { at, .. } = found.threshold
            {
                assert!(at.is_finite());
            }
        }
        let _ = transitions(&x, &codes, 4, &edges, level);
    }
    regressions(rng, &x, &y, &outcomes, &weights);
}

fn regressions(rng: &mut ChaCha8Rng, x: &[f64], y: &[f64], outcomes: &[bool], weights: &[f64]) {
    let mixed: Vec<f64> = x.iter().zip(y).map(|(a, b)| a - 2.0 * b).collect();
    let columns = [x, y, mixed.as_slice()];
    let width = rng.next_u32() as usize % 4;
    for w in [None, Some(weights)] {
        let Ok(data) = Data::new(&columns[..width], outcomes, w) else { continue };
        for estimator in [Estimator::MaximumLikelihood, Estimator::Firth, Estimator::FirthIfSeparated] {
            let options = Options { scale: Scale::Raw, estimator, covariance: Covariance::Sandwich };
            if let Ok(found) = fit(data, options) {
                assert!(!found.log_likelihood.is_nan() && !found.intercept.estimate.is_nan());
                for c in found.terms.iter().filter_map(|t| t.coefficient()) {
                    assert!(!c.estimate.is_nan() && !c.se.is_nan());
                }
            }
        }
        let _ = separation(data);
        if outcomes.len() < 40 {
            let _ = firth_profile(data, 0, Confidence::P95);
        }
    }
    if let Ok((state, _)) = LimitState::fit(x, y, outcomes, None, None, Options::default(), 0.5) {
        let _ = (state.pole(), state.validity(), state.curve(7, Confidence::P95));
    }
}

#[test]
fn garbage_never_panics() {
    let mut rng = ChaCha8Rng::seed_from_u64(20_261_121);
    for _ in 0..400 {
        one_round(&mut rng);
    }
}

#[test]
#[ignore = "takes ten minutes; run after changes to the numerics"]
fn garbage_for_ten_minutes() {
    let start = std::time::Instant::now();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut rounds = 0_u64;
    while start.elapsed().as_secs() < 600 {
        one_round(&mut rng);
        rounds += 1;
    }
    eprintln!("{rounds} rounds");
}
