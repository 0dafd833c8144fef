//! Headlines and limits in sentences.

use robogate_report::{Headline, limits};

use crate::synthetic::{analysed, law, space};

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
