//! Studies of synthetic laws with a known answer.

use robogate_analysis::AnalysisError;
use robogate_analysis::study::{Arm, Figures, Learner, Measure, Repeat, Study, Verdict, predictions};
use robogate_core::Outcome;
use robogate_dictionary::Dictionary;

use crate::designs::{Focus, Law, dictionary, even, sampled, study};
use crate::synthetic::space;

fn of(study: &Study, learner: Learner, arm: Arm) -> &Figures {
    study.figures(learner, arm).unwrap()
}

#[test]
fn incomplete_design_is_worse() {
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
    let score = of(&study, Learner::Flexible, Arm::PureBoundary).score(Measure::BoundaryError).unwrap();
    let difference = score.difference_to_uniform.as_ref().unwrap();
    assert_eq!(score.verdict, Some(Verdict::Worse), "{score:?}");
    // The design cannot know a quarter of the space, of which 60 % look like failures.
    assert!((0.05..0.2).contains(&difference.mean), "{difference:?}");
}

#[test]
fn predictions_are_those_of_the_study() {
    let law: Law = |at| if at[0] > 0.6 { 0.9 } else { 0.2 };
    let dir = tempfile::tempdir().unwrap();
    let space = space(&["box", "sphere"]);
    let make =
        |name: &str, seed: u64, n: u64| dictionary(dir.path(), name, &space, sampled(&space, seed, n, 0, law, even));
    let (test, train) = (make("test", 999, 300), make("train", 1, 80));
    let repeat = Repeat { uniform: &train, two_stage: &train, two_stage_weights: vec![1.0; 80], pure_boundary: &train };
    let study = Study::of(&test, &[repeat]).unwrap();
    for learner in [Learner::MainEffects, Learner::Flexible] {
        let chances = predictions(learner, &train, &test).unwrap();
        let success = test.entries().map(|row| f64::from(u8::from(row.unwrap().episode.outcome == Outcome::Success)));
        let brier = chances.iter().zip(success).map(|(q, y)| (q - y).powi(2)).sum::<f64>() / 300.0;
        let published = of(&study, learner, Arm::Uniform).score(Measure::Brier).unwrap().value.mean;
        assert!((brier - published).abs() < 1e-12, "{learner:?}: {brier} {published}");
    }
}

#[test]
fn focusing_helps_with_one_threshold() {
    let law: Law = |at| if at[0] > 0.6 { 1.0 } else { 0.0 };
    let near: Focus = |at| at[0] = 0.56 + 0.08 * at[0];
    let of_repeats = |repeats| {
        let study = study(law, near, near, repeats, 60);
        of(&study, Learner::MainEffects, Arm::PureBoundary).score(Measure::BoundaryError).unwrap().clone()
    };
    let score = of_repeats(10);
    assert_eq!(score.verdict, Some(Verdict::Better), "{score:?}");
    // With five repeats its own interval excludes 0, but the simultaneous interval of nine comparisons does not.
    let fewer = of_repeats(5);
    assert!(fewer.difference_to_uniform.as_ref().unwrap().interval_95.unwrap()[1] < 0.0);
    assert_eq!(fewer.verdict, Some(Verdict::NotSignificant), "{fewer:?}");
}

#[test]
fn easy_rows_raise_only_in_sample_auc() {
    // The main-effects model is true here, so both designs fit it. The second stage adds rows at both extremes.
    let law: Law = |at| 1.0 / (1.0 + (-5.0 * (at[0] - at[1])).exp());
    let easy: Focus = |at| {
        let end = if at[2] < 0.5 { [0.8, 0.0] } else { [0.0, 0.8] };
        at[0] = end[0] + 0.2 * at[0];
        at[1] = end[1] + 0.2 * at[1];
    };
    let study = study(law, easy, easy, 3, 400);
    let [uniform, two] = [Arm::Uniform, Arm::TwoStage].map(|arm| of(&study, Learner::MainEffects, arm));
    let on_test = |f: &Figures| f.score(Measure::Auc).unwrap().value.mean;
    assert!(two.mean_auc_in_sample() - uniform.mean_auc_in_sample() > 0.03, "{two:?}");
    assert!(on_test(two) - on_test(uniform) < 0.01, "{two:?}");
}

#[test]
fn one_repeat_has_no_interval() {
    let law: Law = |at| at[0];
    let study = study(law, even, even, 1, 80);
    assert!(study.figures(Learner::Paper, Arm::Uniform).is_none());
    let score = of(&study, Learner::MainEffects, Arm::TwoStage).score(Measure::Auc).unwrap();
    let difference = score.difference_to_uniform.as_ref().unwrap();
    assert_eq!((difference.interval_95, score.verdict), (None, Some(Verdict::NotSignificant)));
    assert_eq!(study, crate::designs::study(law, even, even, 1, 80), "the same dictionaries give a different study");
}

#[test]
fn one_outcome_gives_no_figures() {
    let study = study(|_| 1.0, even, even, 2, 40);
    assert!(study.learners.iter().flat_map(|l| &l.arms).all(|arm| arm.figures.because().is_some()));
}

#[test]
fn mismatched_dictionaries_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let [here, other] = [space(&["box", "sphere"]), space(&["box", "ball"])];
    let law: Law = |at| at[0];
    let test = dictionary(dir.path(), "test", &here, sampled(&here, 1, 50, 0, law, even));
    let foreign = dictionary(dir.path(), "foreign", &other, sampled(&other, 2, 50, 0, law, even));
    let judged = |uniform: &Dictionary, weights: usize| {
        let repeat = Repeat { uniform, two_stage: &test, two_stage_weights: vec![1.0; weights], pure_boundary: &test };
        Study::of(&test, &[repeat]).unwrap_err()
    };
    for (error, part) in [(judged(&foreign, 50), "`shape`"), (judged(&test, 49), "49 weights for the 50 rows")] {
        assert!(matches!(error, AnalysisError::NoStudy { .. }) && error.to_string().contains(part), "{error}");
    }
}
