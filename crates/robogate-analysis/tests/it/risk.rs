//! The risk model of imported results with several episodes of the same scenes.

use robogate_analysis::{Analysis, ReplayReason};
use robogate_core::{FailureMode, Outcome};
use robogate_stats::{Confidence, Trials, wilson};

use crate::hold;
use crate::synthetic::{analysed, entry, point, space, unit, with_outcomes};

const SCENES: u64 = 60;
const REPEATS: u64 = 10;

/// Repeats of scenes with their own success rates, which do not depend on any parameter. The masses of successive episodes
/// differ by the share `apart` of their range.
fn imported(apart: f64) -> Analysis {
    let space = space(&["box", "sphere"]);
    let episode = |i: u64| {
        let scene = i / REPEATS;
        let mut requested = point(&space, scene);
        hold(&mut requested, &space, "mass_kg", 0.99 * unit(scene, 60) + apart * i as f64);
        let success = unit(i, 99) < 0.2 + 0.7 * unit(scene, 50);
        let outcome = if success { Outcome::Success } else { Outcome::Failure(FailureMode::constant("grasp_miss")) };
        let mut row = entry(i, requested, outcome);
        if apart == 0.0 {
            "imported".clone_into(&mut row.stage);
        }
        row
    };
    analysed(&space, (0..SCENES * REPEATS).map(episode).collect())
}

#[test]
fn scenes_stay_in_one_fold() {
    // Episodes sampled from a space are scenes of their own.
    let (repeats, single) = (imported(0.0), imported(1e-9));
    assert!(repeats.effects.by_scenario && !single.effects.by_scenario);
    let roc = |analysis: &Analysis| analysis.risk.estimated().unwrap().roc.estimated().unwrap().clone();
    let (repeats, single) = (roc(&repeats), roc(&single));
    let points = |roc: &robogate_analysis::RocFigures| {
        roc.curves.iter().find(|curve| curve.rows == "cross_validated").unwrap().points.len() as u64
    };
    // The model of one fold scores all episodes of a scene, so they have one score.
    assert!(points(&repeats) <= SCENES + 1, "{}", points(&repeats));
    assert!(points(&single) > SCENES + 1, "{}", points(&single));
    let width = |[low, high]: [f64; 2]| high - low;
    for [wide, narrow] in [
        [repeats.auc_cross_validated_95, single.auc_cross_validated_95],
        [repeats.auc_in_sample_95, single.auc_in_sample_95],
    ] {
        assert!(width(wide) > 1.2 * width(narrow), "{wide:?} {narrow:?}");
    }
}

#[test]
fn calibration_counts_scenes() {
    let analysis = imported(0.0);
    let risk = analysis.risk.estimated().unwrap();
    let (mut sum, mut of_rows) = (0.0, 0.0);
    for bin in &risk.calibration_cross_validated.estimated().unwrap().bins {
        let failures = (bin.observed * bin.rows as f64).round() as u64;
        let by_row = wilson(Trials::new(failures, bin.rows).unwrap(), Confidence::P95).width();
        let width = bin.interval_95[1] - bin.interval_95[0];
        assert!(width > by_row - 1e-9, "{bin:?}");
        sum += width;
        of_rows += by_row;
    }
    assert!(sum > 1.3 * of_rows, "{sum} {of_rows}");
}

#[test]
// In a law without any effect, no outcome of the frequent kind is unexpected.
fn expected_failures_are_not_called_unexpected() {
    let mostly =
        |i: u64| if unit(i, 99) < 0.2 { Outcome::Success } else { Outcome::Failure(FailureMode::constant("jam")) };
    let analysis = analysed(&space(&["box", "sphere"]), with_outcomes(600, mostly));
    let of = |reason: ReplayReason| analysis.replay.iter().filter(move |group| group.reason == reason);
    let risk = |figure: &str| -> f64 { figure.trim_start_matches("risk ").trim_end_matches(" %").parse().unwrap() };
    let failures: Vec<f64> =
        of(ReplayReason::UnexpectedFailure).flat_map(|group| &group.episodes).map(|e| risk(&e.figure)).collect();
    assert!(failures.iter().all(|risk| *risk < 50.0), "{failures:?}");
    assert!(of(ReplayReason::UnexpectedSuccess).next().is_some(), "successes are unexpected here");
}
