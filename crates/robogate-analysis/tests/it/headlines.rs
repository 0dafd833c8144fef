//! Headlines name what is there, and nothing else.

use std::path::Path;
use std::sync::Arc;

use robogate_analysis::{Analysis, AnalysisOptions, ShapeKind, Source};
use robogate_core::{FailureMode, Outcome};

use crate::named::named;
use crate::noise::{planted, simulated, ten};
use crate::synthetic::{entry, unit, write};

/// The analysis of imported results: `repeats` episodes of each of `scenes` scenes, whose success rates do not depend on any
/// parameter.
fn imported(seed: u64, scenes: u64, repeats: u64) -> Analysis {
    let space = ten();
    let episode = |i: u64| {
        let scene = (seed + 1) * 1_000_003 + i / repeats;
        let value = |(at, p): (usize, &robogate_core::Parameter)| {
            (Arc::clone(&p.name), p.domain.decode(p.domain.from_unit(unit(scene, at as u64 + 1))))
        };
        let requested = space.parameters().iter().enumerate().map(value).collect();
        let success = unit((seed + 1) * 7_000_003 + i, 99) < 0.2 + 0.7 * unit(scene, 50);
        let outcome = if success { Outcome::Success } else { Outcome::Failure(FailureMode::constant("grasp_miss")) };
        let mut row = entry(i, requested, outcome);
        row.stage = "imported".to_owned();
        row
    };
    let options = AnalysisOptions { models: false, ..AnalysisOptions::default() };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dictionary.parquet");
    write(&path, &space, (0..scenes * repeats).map(episode).collect());
    Analysis::with(&Source::open(&path).unwrap(), Path::new("test.parquet"), &options).unwrap()
}

#[test]
fn imported_repeats_name_nothing() {
    let analyses: Vec<Analysis> = (0..12).map(|seed| imported(seed, 50, 20)).collect();
    assert!(analyses.iter().all(|analysis| analysis.effects.by_scenario));
    // 2.5 % of 12 is 0.3. As independent rows, nearly each set named three parameters.
    let names = analyses.iter().filter(|analysis| analysis.effects.significant().next().is_some()).count();
    assert!(names <= 2, "{names} of 12 imports name a parameter");
}

#[test]
fn noise_names_nothing() {
    // The program of `robogate-report` runs 200 sets of each rate and size.
    let mut reports = 0;
    for seed in 0..30 {
        for rate in [0.1, 0.5, 0.99] {
            reports += u32::from(!named(&simulated(seed, 300, |_| rate)).is_empty());
        }
    }
    // 2 % of 90 is 1.8, with a standard deviation of 1.3.
    assert!(reports <= 5, "{reports} of 90 reports name something");
}

#[test]
fn planted_effect_is_named() {
    for seed in 0..5 {
        let analysis = simulated(seed, 3_000, planted(0.5, 3.0, 0.33));
        let first = &analysis.claims.failure_regions[0];
        assert_eq!(first.parameter, "p3");
        assert_eq!(first.shape.kind, ShapeKind::Gap);
        let (from, to) = (first.shape.steps[0], first.shape.steps[1]);
        assert!(from.interval_95[0] < 0.34 && from.interval_95[1] > 0.32, "{from:?}");
        assert!(to.interval_95[0] < 0.44 && to.interval_95[1] > 0.42, "{to:?}");
    }
}

#[test]
fn two_sided_effects_have_both_ends() {
    // The rates of a released dictionary along an offset: 0, 12, 56, 62, 71, 65, 56, 76, 0, 0 %.
    let band = |at: &[f64]| {
        if at[5] < 0.2 {
            0.06
        } else if at[5] < 0.8 {
            0.64
        } else {
            0.01
        }
    };
    let analysis = simulated(1, 1_000, band);
    let first = &analysis.claims.failure_regions[0];
    assert_eq!((first.parameter.as_str(), first.shape.kind), ("p5", ShapeKind::Band));
    assert!((first.shape.steps[0].at - 0.2).abs() < 0.05 && (first.shape.steps[1].at - 0.8).abs() < 0.05);
    assert_eq!(analysis.effects.ranked[0].parameter, "p5");
    // Failure in a smooth valley.
    let valley = |at: &[f64]| 1.0 / (1.0 + (1.5 - 40.0 * (at[4] - 0.5).powi(2)).exp());
    let analysis = simulated(2, 2_000, valley);
    let first = &analysis.claims.failure_regions[0];
    assert_eq!((first.parameter.as_str(), first.shape.kind), ("p4", ShapeKind::Gap));
}

#[test]
fn interactions_are_found() {
    let analysis = simulated(3, 3_000, |at| 1.0 / (1.0 + (-12.0 * (at[4] - 0.5) * (at[5] - 0.5)).exp()));
    assert_eq!(analysis.claims.interactions, [["p4".to_owned(), "p5".to_owned()]]);
}

#[test]
fn bad_levels_are_named_in_words() {
    let law = |at: &[f64]| if (0.25..0.5).contains(&at[8]) { 0.3 } else { 0.97 };
    let analysis = simulated(4, 2_000, law);
    let region = &analysis.claims.failure_regions[0];
    assert_eq!((region.parameter.as_str(), region.shape.low_levels.as_slice()), ("p8", ["p8_1".to_owned()].as_slice()));
    let found = analysis.safe_box.estimated().unwrap();
    assert!(found.verified && found.lower_bound >= 0.9);
    assert_eq!(found.limits[0].excluded_levels, ["p8_1"]);
    assert!((found.volume - 0.75).abs() < 1e-9);
    assert!(found.avoided as f64 > 0.85 * found.failures as f64);
}

#[test]
fn conditions_list_single_parameters_and_pairs() {
    let law = |at: &[f64]| if at[4] > 0.6 && at[5] < 0.4 { 0.1 } else { 0.95 };
    let analysis = simulated(5, 2_000, law);
    let failing = &analysis.conditions.failing;
    let pair = failing.iter().find(|of| of.parameters.len() == 2).unwrap();
    let of = |name: &str| &pair.parameters.iter().find(|part| part.parameter == name).unwrap().ranges[0];
    let [above, below] = [of("p4"), of("p5")];
    assert!((above[0].unwrap() - 0.6).abs() < 0.06 && above[1].is_none(), "{above:?}");
    assert!((below[1].unwrap() - 0.4).abs() < 0.06 && below[0].is_none(), "{below:?}");
    assert!(pair.inside.rate.unwrap() < 0.2 && pair.outside.rate.unwrap() > 0.9);
    assert!(pair.lift.unwrap() > 3.0);
    assert_eq!(pair.inside.n + pair.outside.n, 2_000);
    assert!(failing.iter().any(|of| of.parameters.len() == 1));
}

#[test]
fn stated_number_of_episodes_shows_ten_points() {
    // Without an effect, the report states how many episodes a difference of 10 points needs.
    let stated = simulated(6, 300, |_| 0.9).conditions.power.unwrap();
    assert!((500..1_500).contains(&stated.episodes_for_10_points), "{stated:?}");
    let law = |at: &[f64]| if at[3] > 0.5 { 0.85 } else { 0.95 };
    let found = |seed: &u64| named(&simulated(*seed, stated.episodes_for_10_points, law)).contains(&"p3".to_owned());
    // 80 % of 40 is 32, with a standard deviation of 2.5.
    let found = (100..140).filter(found).count();
    assert!((25..=39).contains(&found), "{found} of 40 with {} episodes", stated.episodes_for_10_points);
}
