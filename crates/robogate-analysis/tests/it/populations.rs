//! Focused rows count by their sampling weights, and never as a plain sample of the operating space.

use std::sync::Arc;

use robogate_analysis::{Advice, Population, ShapeKind};
use robogate_core::{Assignment, FailureMode, Outcome, Value};
use robogate_dictionary::Label;

use crate::hold;
use crate::synthetic::{analysed, entry, law, outcome, point, space, unit};

/// The true success rate of the law over the operating space, estimated from many points.
fn truth() -> f64 {
    let space = space(&["box"]);
    let n = 40_000;
    let successes =
        (0..n).filter(|i| outcome(i + 1_000_000, &point(&space, i + 1_000_000)) == Outcome::Success).count();
    successes as f64 / n as f64
}

/// A focused stage in the upper half of friction (on its own scale), with the weights of a campaign.
fn focused(n: u64, from: u64) -> Vec<robogate_dictionary::Entry> {
    let space = space(&["box"]);
    (from..from + n)
        .map(|i| {
            let mut requested = point(&space, i);
            hold(&mut requested, &space, "friction", 0.5 + 0.5 * unit(i, 50));
            let went = outcome(i, &requested);
            let mut entry = entry(i, requested, went);
            "boundary".clone_into(&mut entry.stage);
            entry.weight = 0.5;
            entry
        })
        .collect()
}

#[test]
fn focused_rows_count_by_their_weights() {
    let space = space(&["box"]);
    let truth = truth();
    let alone = analysed(&space, law(&space, 2_000));
    let both = analysed(&space, law(&space, 2_000).into_iter().chain(focused(4_000, 2_000)).collect());
    assert_eq!(both.population, Population::OperatingSpace);
    let stage = both.success.stages.iter().find(|s| s.stage == "boundary").unwrap();
    assert_eq!(stage.population, Population::FocusedDesign);
    let plain = stage.rate.rate.unwrap();
    assert!((plain - truth).abs() > 0.1, "the focused rate {plain} is far from the truth {truth}");
    let rate = both.success.rate;
    assert_eq!(rate.n, 5_960);
    assert!((rate.rate.unwrap() - truth).abs() < 0.025, "{rate:?} for {truth}");
    assert!(rate.weighted_as.unwrap() > 2_000.0);
    let width = |[low, high]: [f64; 2]| high - low;
    assert!(width(rate.wilson_95) < width(alone.success.rate.wilson_95));
    let weighting = both.success.weighting.as_ref().unwrap().estimated().unwrap();
    assert!((weighting.region_share - 0.5).abs() < 0.01);
    assert_eq!((weighting.rows, weighting.chosen), (5_960, 4_000));
    // The cells of a parameter have their rates in the operating space. In plain counts, those of mass would be too high.
    for cell in &both.marginal_effects.iter().find(|effect| effect.parameter == "mass_kg").unwrap().cells {
        let [from, to] = cell.range.unwrap();
        let of_mass = |i: u64| {
            let mut requested = point(&space, i + 1_000_000);
            hold(&mut requested, &space, "mass_kg", (0.5 * (from + to) - 0.05) / 1.95);
            outcome(i + 1_000_000, &requested) == Outcome::Success
        };
        let truth = (0..4_000).filter(|i| of_mass(*i)).count() as f64 / 4_000.0;
        assert!((cell.rate.rate.unwrap() - truth).abs() < 0.09, "{:?} for {truth}", cell.rate);
    }
}

/// An active stage: the first half of its rows is a uniform sample, the model chose the others in the upper half of friction.
/// The weights are those of the mixture with equal shares: 2/(1 + 2) above, 2/(1 + 0) below.
fn active(n: u64, from: u64) -> Vec<robogate_dictionary::Entry> {
    let space = space(&["box"]);
    let middle = (0.05_f64 * 1.2).sqrt();
    (from..from + n)
        .map(|i| {
            let mut requested = point(&space, i);
            let chosen = i >= from + n / 2;
            if chosen {
                hold(&mut requested, &space, "friction", 0.5 + 0.5 * unit(i, 50));
            }
            let above = requested.number("friction").unwrap() > middle;
            let went = outcome(i, &requested);
            let mut entry = entry(i, requested, went);
            "active".clone_into(&mut entry.stage);
            if chosen { "active" } else { "uniform" }.clone_into(&mut entry.design);
            entry.weight = if above { 2.0 / 3.0 } else { 2.0 };
            entry
        })
        .collect()
}

#[test]
fn chosen_rows_of_an_active_stage_count_by_their_weights() {
    let space = space(&["box"]);
    let truth = truth();
    let both = analysed(&space, law(&space, 1_000).into_iter().chain(active(4_000, 1_000)).collect());
    assert_eq!(both.population, Population::OperatingSpace);
    // 980 valid rows of the uniform stage and all of the active one.
    assert_eq!(both.success.rate.n, 4_980);
    let rate = both.success.rate.rate.unwrap();
    assert!((rate - truth).abs() < 0.025, "{rate} for {truth}");
    let stage = |name: &str| both.success.stages.iter().find(|s| s.stage == name).unwrap();
    assert_eq!(stage("active").population, Population::FocusedDesign);
    assert_eq!(stage("active (uniform part)").population, Population::OperatingSpace);
    assert_eq!(stage("active").weighted, None, "the chosen rows alone have no region");
    let plain = stage("active").rate.rate.unwrap();
    assert!((plain - truth).abs() > 0.1, "the chosen rows alone: {plain} for {truth}");
}

#[test]
fn focused_rows_are_not_operating_rates() {
    let space = space(&["box"]);
    let analysis = analysed(&space, focused(500, 0));
    assert_eq!(analysis.population, Population::FocusedDesign);
}

#[test]
fn invalid_episodes_bound_the_rate() {
    let space = space(&["box"]);
    let analysis = analysed(&space, law(&space, 1_000));
    let bounds = &analysis.success.bounds;
    assert_eq!(bounds.invalid, 20);
    assert_eq!(bounds.faults[0].fault, "diverged");
    let rate = analysis.success.rate.rate.unwrap();
    assert!(bounds.worst_case.unwrap() < rate && rate < bounds.best_case.unwrap());
}

#[test]
fn frontier_follows_the_law() {
    // -1 + 6 mu - 2 m = 0 at mu = (1 + 2 m) / 6.
    let space = space(&["box"]);
    let analysis = analysed(&space, law(&space, 20_000));
    assert_eq!(analysis.envelopes.len(), 1, "the most influential pair is that of the task");
    let frontier = analysis.envelopes[0].frontier.estimated().unwrap();
    assert!(!frontier.contradicted);
    for point in frontier.curve.iter().filter(|p| p.observed) {
        let truth = (1.0 + 2.0 * point.y) / 6.0;
        assert!((point.x - truth).abs() < 0.06, "{} for {truth} at mass {}", point.x, point.y);
    }
}

#[test]
fn suites_are_not_operating_rates() {
    let space = space(&["box"]);
    let of_a_suite = |mut entry: robogate_dictionary::Entry| {
        "suite".clone_into(&mut entry.stage);
        entry
    };
    let analysis = analysed(&space, law(&space, 500).into_iter().map(of_a_suite).collect());
    assert_eq!(analysis.population, Population::Suite);
    assert_eq!(analysis.success.stages[0].population, Population::Suite);
    assert!(analysis.claims.advice.iter().all(|advice| !matches!(advice, Advice::Operate { .. })));
}

#[test]
fn maps_classify_most_of_their_area() {
    // 3,000 episodes over friction and mass.
    let space = space(&["box"]);
    let analysis = analysed(&space, law(&space, 3_000));
    let map = analysis.envelopes[0].map.estimated().unwrap();
    let classified = map.zones.safe + map.zones.boundary + map.zones.danger;
    assert!(2 * classified >= map.cells.len() as u64, "{:?}", map.zones);
    let mut wrong = 0;
    for (i, cell) in map.cells.iter().enumerate() {
        let model = cell.model.unwrap();
        // The law at the middle of the cell: friction on its logarithmic scale, mass linear.
        let unit = |at: usize| (at as f64 + 0.5) / 10.0;
        let friction = 0.05 * (1.2_f64 / 0.05).powf(unit(i / 10));
        let mass = 0.05 + 1.95 * unit(i % 10);
        let truth = 1.0 / (1.0 + (1.0 - 6.0 * friction + 2.0 * mass).exp());
        wrong += u32::from(truth < model.interval_95[0] || truth > model.interval_95[1]);
    }
    assert!(wrong <= 15, "{wrong} of {} intervals miss the law", map.cells.len());
}

#[test]
fn emphasis_beyond_the_volume_is_weighted() {
    use std::path::Path;
    // The volume is the upper half of friction, the emphasis the lower tenth of it and the lower half of mass.
    let space = space(&["box"]);
    let truth = truth();
    let focused = |from: u64| {
        (from..from + 3_000).map(move |i| {
            let space = crate::synthetic::space(&["box"]);
            let mut requested = point(&space, i);
            let is_emphasis = i < from + 1_000;
            let friction = if is_emphasis { 0.1 * unit(i, 50) } else { 0.5 + 0.5 * unit(i, 50) };
            hold(&mut requested, &space, "friction", friction);
            if is_emphasis {
                hold(&mut requested, &space, "mass_kg", 0.5 * unit(i, 51));
            }
            let went = outcome(i, &requested);
            let mut entry = entry(i, requested, went);
            "boundary".clone_into(&mut entry.stage);
            entry.weight = if is_emphasis { 3.0 * 0.05 } else { 1.5 * 0.5 };
            entry
        })
    };
    let boundary = r#"{"parameters": [], "volume": {"episodes": 2000, "share_of_operating_space": 0.5},
        "emphasis": {"region": {"episodes": 1000, "share_of_operating_space": 0.05}}}"#;
    let mut error = 0.0;
    for repeat in 0..6 {
        let dir = tempfile::tempdir().unwrap();
        let from = 10_000 * repeat;
        let uniform = (from..from + 1_000).map(|i| {
            let requested = point(&space, i);
            let went = outcome(i, &requested);
            entry(i, requested, went)
        });
        let path = dir.path().join("dictionary.parquet");
        crate::synthetic::write(&path, &space, uniform.chain(focused(from + 1_000)).collect());
        std::fs::write(dir.path().join("boundary.json"), boundary).unwrap();
        let of = |path: &Path| {
            let source = robogate_analysis::Source::open(path).unwrap();
            robogate_analysis::Analysis::of(&source, path, &[]).unwrap().success
        };
        let found = of(dir.path());
        error += (found.rate.rate.unwrap() - truth) / 6.0;
        // The file alone does not describe the regions, so the chosen rows are left out.
        let alone = of(&path);
        assert!(alone.weighting.unwrap().because().unwrap().contains("folder"));
        assert_eq!(alone.rate.n, 1_000);
    }
    assert!(error.abs() < 0.012, "mean error {error}");
}

/// Scenarios of a suite that draw one parameter each, with the nominal value of the others: new draws of a scenario are no repeats
/// of one. Heavy parts fail. All episodes with friction drawn fail often, whatever the value.
#[test]
fn draws_of_scenarios_are_compared_within_them() {
    let space = space(&["box"]);
    let of = |i: u64| {
        let case = ["friction", "mass_kg", "obstacles"][(i % 3) as usize];
        let nominal = |name: &str| match name {
            "friction" => Some(Value::Number(0.6)),
            "mass_kg" => Some(Value::Number(0.5)),
            "obstacles" => Some(Value::Integer(0)),
            _ => None,
        };
        let drawn = point(&space, i);
        let value = |name: &str, value: &Value| nominal(name).filter(|_| name != case).unwrap_or_else(|| value.clone());
        let requested: Assignment = drawn.iter().map(|(name, of)| (Arc::from(name), value(name, of))).collect();
        let fails = match case {
            "mass_kg" => requested.number("mass_kg").unwrap() > 1.2,
            "friction" => unit(i, 98) < 0.5,
            _ => unit(i, 98) < 0.03,
        };
        let failure = Outcome::Failure(FailureMode::constant("grip_loss"));
        let mut entry = entry(i, requested, if fails { failure } else { Outcome::Success });
        "suite".clone_into(&mut entry.stage);
        entry.label = Label { case: Some(case.to_owned()), ..Label::default() };
        entry
    };
    let analysis = analysed(&space, (0..300).map(of).collect());
    assert_eq!(analysis.population, Population::Suite);
    assert!(analysis.clusters.is_none(), "{:?}", analysis.clusters);
    let named: Vec<&str> = analysis.effects.significant().map(|effect| effect.parameter.as_str()).collect();
    assert_eq!(named, ["mass_kg"], "{:?}", analysis.effects.ranked);
    // Where it fails is told by the draws of its own scenario, not by the nominal value in the failing ones of friction.
    let shape = analysis.effects.significant().next().unwrap().shape.estimated().unwrap();
    assert_eq!((shape.kind, shape.steps.len()), (ShapeKind::Falling, 1), "{shape:?}");
    let step = shape.steps[0];
    assert!(step.interval_95[0] <= 1.2 && 1.2 <= step.interval_95[1] && step.at > 0.9, "{shape:?}");
}
