//! Studies as Markdown, as JSON and in sentences.

use robogate_analysis::study::Study;
use robogate_report::{study_answer, study_json, study_markdown};

use crate::designs::{Focus, Law, even, study};

#[test]
fn answer_names_the_worse_design() {
    // Episodes without obstacles always succeed. The focused designs only contain obstacles, near the frontier.
    let law: Law = |at| {
        if at[2] < 0.25 {
            0.98
        } else if at[0] > 0.6 {
            0.97
        } else {
            0.03
        }
    };
    let near: Focus = |at| {
        at[0] = 0.4 + 0.4 * at[0];
        at[2] = 0.25 + 0.75 * at[2];
    };
    let study = study(law, near, near, 3, 240);
    let answer = study_answer(&study);
    assert!(answer.iter().any(|s| s.contains("pure boundary") && s.contains("worse")), "{answer:?}");
    let page = study_markdown(&study);
    assert!(page.contains("AUC in sample") && page.contains("Do not compare the in-sample AUC"));
}

#[test]
fn missing_model_is_explained() {
    let study = study(|at| at[0], even, even, 1, 80);
    let page = study_markdown(&study);
    assert!(page.contains("which the paper's model needs"), "{page}");
    let json: serde_json::Value = serde_json::from_str(&study_json(&study)).unwrap();
    assert_eq!(json["version"], Study::VERSION);
}

#[test]
fn single_outcome_has_no_answer() {
    let study = study(|_| 1.0, even, even, 2, 40);
    assert!(study_markdown(&study).contains("the same outcome"));
    let answer = study_answer(&study);
    assert!(answer.iter().all(|s| s.contains("could not be compared")), "{answer:?}");
}
