//! Headlines and limits in sentences.

use robogate_report::{Headline, html, limits, markdown};
use robogate_stats::format::percent;

use crate::synthetic::{analysed, law, space, unit, with_outcomes};
use robogate_core::{FailureMode, Outcome};

/// The headline and the first limit of 500 episodes of one stage.
fn of_stage(stage: &str) -> (Headline, String) {
    let space = space(&["box"]);
    let mut entries = law(&space, 500);
    entries.iter_mut().for_each(|entry| stage.clone_into(&mut entry.stage));
    let analysis = analysed(&space, entries);
    (Headline::of(&analysis), limits(&analysis).swap_remove(0))
}

#[test]
fn focused_rows_are_not_operating_rates() {
    let (headline, limit) = of_stage("boundary");
    assert!(headline.answer.contains("not the operating space"));
    assert!(limit.contains("No rate here applies to the operating space"));
}

#[test]
fn suites_are_not_operating_rates() {
    let (headline, limit) = of_stage("suite");
    assert!(headline.answer.contains("not the operating space"));
    assert!(limit.contains("No rate here applies to an operating space"));
    assert!(headline.what_to_do.iter().all(|line| !line.contains("Operate")));
}

#[test]
fn headline_rate_is_the_same_everywhere() {
    // Half of the active stage was chosen at random among heavy parts, which fail more often.
    let space = space(&["box"]);
    let mut entries = law(&space, 1_000);
    for entry in entries.iter_mut().skip(250) {
        "active".clone_into(&mut entry.stage);
        let heavy = entry.episode.scenario.requested.number("mass_kg").unwrap() > 1.0;
        let chosen = heavy && unit(entry.episode.scenario.index, 40) < 0.7;
        if chosen { "active" } else { "uniform" }.clone_into(&mut entry.design);
        entry.weight = if heavy { 0.6 } else { 1.4 };
    }
    let analysis = analysed(&space, entries);
    let rate = analysis.success.rate;
    let plain = rate.successes as f64 / rate.n as f64;
    let shown = percent(rate.rate.unwrap());
    assert!((rate.rate.unwrap() - plain).abs() > 0.02, "{shown} and plain {plain}");
    let headline = Headline::of(&analysis);
    assert!(headline.answer.contains(&shown) && headline.answer.contains("sampling weights"), "{}", headline.answer);
    for page in [html(&analysis), markdown(&analysis)] {
        // A page may join number and unit by another space.
        assert!(page.contains(shown.trim_end_matches(" %")), "{shown}");
    }
}

#[test]
fn reports_without_an_effect_state_their_power() {
    let failed = |i: u64| unit(i, 99) < 0.15;
    let outcome = |i| if failed(i) { Outcome::Failure(FailureMode::constant("grasp_miss")) } else { Outcome::Success };
    let headline = Headline::of(&analysed(&space(&["box", "sphere"]), with_outcomes(300, outcome)));
    let line =
        headline.where_it_fails.iter().find(|line| line.contains("No parameter has a significant effect")).unwrap();
    assert!(
        line.contains("with a probability of 80 %") && line.contains("A difference of 10 points needs about"),
        "{line}"
    );
}

#[test]
fn modes_without_a_record_have_no_share() {
    // All failures are of unknown mode, so each mode may have caused any of them.
    let outcome = |i| if unit(i, 99) < 0.2 { Outcome::Failure(FailureMode::UNKNOWN) } else { Outcome::Success };
    let analysis = analysed(&space(&["box", "sphere"]), with_outcomes(400, outcome));
    let declared = analysis.failure_modes.modes.iter().filter(|mode| mode.declared);
    let bounds: Vec<[f64; 2]> = declared.map(|mode| mode.interval_95).collect();
    assert!(!bounds.is_empty() && bounds.iter().all(|[low, high]| *low <= 0.0 && *high > 0.99), "{bounds:?}");
}
