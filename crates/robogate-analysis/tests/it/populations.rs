//! Focused rows are never used as an estimate of the operating space.

use robogate_analysis::{Advice, Population};
use robogate_core::Outcome;

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
fn headline_uses_the_uniform_stage() {
    let space = space(&["box"]);
    let alone = analysed(&space, law(&space, 2_000));
    let both = analysed(&space, law(&space, 2_000).into_iter().chain(focused(2_000, 2_000)).collect());
    assert_eq!(both.success.rate, alone.success.rate);
    assert_eq!(both.marginal_effects, alone.marginal_effects);
    assert_eq!(both.population, Population::OperatingSpace);
    let stage = both.success.stages.iter().find(|s| s.stage == "boundary").unwrap();
    assert_eq!(stage.population, Population::FocusedDesign);
}

#[test]
fn reweighting_recovers_the_operating_rate() {
    let space = space(&["box"]);
    let truth = truth();
    let both = analysed(&space, law(&space, 2_000).into_iter().chain(focused(4_000, 2_000)).collect());
    let found = both.success.reweighted.as_ref().unwrap().estimated().unwrap();
    let plain = both.success.stages.iter().find(|s| s.stage == "boundary").unwrap().rate.rate.unwrap();
    assert!((plain - truth).abs() > 0.1, "the focused rate {plain} is far from the truth {truth}");
    assert!((found.estimate.rate - truth).abs() < 0.025, "{} for {truth}", found.estimate.rate);
    assert!((found.region_share - 0.5).abs() < 0.01);
    assert!(found.estimate.effective_sample_size > 2_000.0);
    let width = |[low, high]: [f64; 2]| high - low;
    assert!(width(found.estimate.interval_95) < width(both.success.rate.wilson_95));
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
