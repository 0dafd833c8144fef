//! Predictions of learners for synthetic laws with a known answer.

use robogate_analysis::learners::{Learner, predictions};
use robogate_core::Outcome;
use robogate_dictionary::Dictionary;

use crate::designs::{Focus, Law, dictionary, even, sampled};
use crate::synthetic::space;

/// Mean share of 1,500 even test episodes on the wrong side of 50 %, over three runs of `n` episodes.
fn error(learner: Learner, law: Law, focus: Focus, n: u64) -> f64 {
    let dir = tempfile::tempdir().unwrap();
    let space = space(&["box", "sphere"]);
    let make = |name: &str, seed, n, focused, focus: Focus| {
        dictionary(dir.path(), name, &space, sampled(&space, seed, n, focused, law, focus))
    };
    let test = make("test", 999, 1500, 0, even);
    let outcomes: Vec<bool> = test.entries().map(|row| row.unwrap().episode.outcome == Outcome::Success).collect();
    let wrong = |train: &Dictionary| {
        let chances = predictions(learner, train, &test).unwrap();
        chances.iter().zip(&outcomes).filter(|(p, success)| (**p >= 0.5) != **success).count()
    };
    (0..3).map(|r| wrong(&make(&format!("train-{r}"), 1 + r, n, n, focus))).sum::<usize>() as f64 / 4500.0
}

#[test]
fn incomplete_design_is_worse() {
    // Episodes without obstacles always succeed. The focused design only contains obstacles, near the frontier.
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
    let [even, focused] = [even, near].map(|focus| error(Learner::Flexible, law, focus, 240));
    // The design cannot know a quarter of the space, of which 60 % look like failures.
    assert!((0.05..0.2).contains(&(focused - even)), "{even} {focused}");
}

#[test]
fn focusing_helps_with_one_threshold() {
    let law: Law = |at| if at[0] > 0.6 { 1.0 } else { 0.0 };
    let near: Focus = |at| at[0] = 0.56 + 0.08 * at[0];
    let [even, focused] = [even, near].map(|focus| error(Learner::MainEffects, law, focus, 60));
    assert!(focused < even, "{even} {focused}");
}

#[test]
fn impossible_predictions_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let [here, other] = [space(&["box", "sphere"]), space(&["box", "ball"])];
    let law: Law = |at| at[0];
    let test = dictionary(dir.path(), "test", &here, sampled(&here, 1, 50, 0, law, even));
    let foreign = dictionary(dir.path(), "foreign", &other, sampled(&other, 2, 50, 0, law, even));
    let error = |learner, train| predictions(learner, train, &test).unwrap_err().to_string();
    assert!(error(Learner::MainEffects, &foreign).contains("parameter `shape` is missing or of another type"));
    assert!(error(Learner::Paper, &test).contains("which the paper's model needs"));
}
