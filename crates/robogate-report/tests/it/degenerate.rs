//! With insufficient data, pages are written and state what cannot be estimated.

use std::path::Path;

use robogate_analysis::{Analysis, Source};
use robogate_core::{FailureMode, Fault, FaultKind, Outcome};
use robogate_dictionary::results::{self, Mapping};
use robogate_report::{analysis_json, html, markdown};

use crate::synthetic::{analysed, space, with_outcomes};

/// Writes the Markdown of an analysis, and fails on a panic or a meaningless number.
fn written(analysis: &Analysis) -> String {
    let (page, text) = (html(analysis), markdown(analysis));
    // The document has everything but the predicting model itself.
    let document = analysis_json(analysis);
    assert_eq!(analysis_json(&serde_json::from_str::<Analysis>(&document).unwrap()), document);
    let (shown, _) = page.split_once("<script>").unwrap();
    assert!(!text.contains("NaN") && !shown.contains("NaN") && !text.contains("inf "));
    assert!(page.contains("</html>"));
    text
}

fn written_of(n: u64, outcome_of: impl Fn(u64) -> Outcome) -> String {
    written(&analysed(&space(&["box", "sphere"]), with_outcomes(n, outcome_of)))
}

#[test]
fn empty_dictionary_has_a_page() {
    assert!(written_of(0, |_| Outcome::Success).contains("there is no evidence about this policy"));
}

#[test]
fn faults_are_named() {
    let text = written_of(30, |_| Outcome::Invalid(Fault::new(FaultKind::Unavailable, "gone")));
    assert!(text.contains("30 unavailable"));
}

#[test]
fn few_rows_have_a_page() {
    for n in [1, 3] {
        written_of(n, |i| if i == 0 { Outcome::Success } else { Outcome::Failure(FailureMode::TIMEOUT) });
    }
}

#[test]
fn single_outcome_bounds_the_rate() {
    let text = written_of(200, |_| Outcome::Success);
    assert!(text.contains("No failure was observed. This bounds the failure rate"));
    written_of(200, |_| Outcome::Failure(FailureMode::constant("grasp_miss")));
}

#[test]
fn separation_is_explained() {
    let went = |i: u64| {
        let heavy = crate::synthetic::point(&space(&["box", "sphere"]), i).number("mass_kg").unwrap() > 1.0;
        if heavy { Outcome::Failure(FailureMode::constant("grip_loss")) } else { Outcome::Success }
    };
    assert!(written_of(300, went).contains("Firth"));
}

#[test]
fn unrecorded_failure_modes_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let (csv, path) = (dir.path().join("results.csv"), dir.path().join("results.parquet"));
    let rows: String = (0..100).map(|i| format!("{},{i}\n", u8::from(i % 3 > 0))).collect();
    std::fs::write(&csv, format!("success,seed\n{rows}")).unwrap();
    results::import(&csv, &path, None, &Mapping::default()).unwrap();
    let analysis = Analysis::of(&Source::open(&path).unwrap(), Path::new("results.parquet"), &[]).unwrap();
    let text = written(&analysis);
    assert!(text.contains("The failure modes are uncertain") && !text.contains("What to do"));
}
