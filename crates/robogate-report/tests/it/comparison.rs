//! Comparisons as pages and as sentences.

use robogate_analysis::{Comparison, ComparisonOptions};
use robogate_core::{FailureMode, Fault, FaultKind, Outcome};
use robogate_report::{
    ComparisonHeadline, ComparisonReport, comparison_html, comparison_json, comparison_limits, comparison_markdown,
};
use tempfile::TempDir;

use crate::runs::{boxes, changed, saved};
use crate::synthetic::law;

fn paired() -> ComparisonOptions {
    ComparisonOptions { paired: true, ..ComparisonOptions::default() }
}

#[test]
fn headline_names_a_difference() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let worse = |i: u64, by_law| match by_law {
        Outcome::Success if i.is_multiple_of(25) => Outcome::Failure(FailureMode::constant("collision")),
        other => other,
    };
    let all = [saved(&dir, "a", &space, law(&space, 600)), saved(&dir, "b", &space, changed(&space, 600, worse))];
    let of = Comparison::of(&all, &ComparisonOptions::default()).unwrap();
    let headline = ComparisonHeadline::of(&of);
    assert!(headline.answer.contains("The difference is significant"), "{headline:?}");
}

#[test]
fn too_little_evidence_is_stated() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let broken = |_, _| Outcome::Invalid(Fault::new(FaultKind::Diverged, "made up"));
    let mut focused = law(&space, 100);
    focused.iter_mut().for_each(|entry| entry.stage = "boundary".to_owned());
    let all = [
        saved(&dir, "good", &space, law(&space, 80)),
        saved(&dir, "broken", &space, changed(&space, 30, broken)),
        saved(&dir, "empty", &space, Vec::new()),
        saved(&dir, "focused", &space, focused),
    ];
    let of = Comparison::of(&all, &ComparisonOptions::default()).unwrap();
    let headline = ComparisonHeadline::of(&of);
    assert!(headline.answer.contains("No comparison is possible"), "{headline:?}");
    let limits = comparison_limits(&of);
    assert!(limits.iter().any(|limit| limit.contains("focused design only")), "{limits:?}");
    crate::pages::balanced(&comparison_html(&of)).unwrap();
}

#[test]
fn page_is_self_contained_and_deterministic() {
    let dir = TempDir::new().unwrap();
    let space = boxes();
    let worse = |i: u64, by_law| {
        if i.is_multiple_of(4) { Outcome::Failure(FailureMode::constant("collision")) } else { by_law }
    };
    let all = [
        saved(&dir, "<b>a", &space, changed(&space, 900, |_, by_law| by_law)),
        saved(&dir, "b", &space, changed(&space, 900, worse)),
    ];
    for options in [ComparisonOptions::default(), paired()] {
        let of = Comparison::of(&all, &options).unwrap();
        let page = comparison_html(&of);
        crate::pages::balanced(&page).unwrap();
        assert_eq!(page, comparison_html(&Comparison::of(&all, &options).unwrap()));
        assert!(page.len() < 400 * 1024, "{}", page.len());
        assert!(!page.contains("<b>a"));
        for forbidden in ["http://", "https://", "src=", "@import", "url(http", "//cdn"] {
            assert!(!page.contains(forbidden), "{forbidden}");
        }
        assert!(comparison_markdown(&of).contains("## Limits"));
        assert_eq!(serde_json::from_str::<Comparison>(&comparison_json(&of)).unwrap(), of);
    }
}

#[test]
fn schema_is_up_to_date() {
    crate::pages::is_up_to_date(
        "tests/golden/comparison.schema.json",
        &(crate::pages::schema::<ComparisonReport<'static>>()),
    );
}
