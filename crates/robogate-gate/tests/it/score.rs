use robogate_core::FailureMode;
use robogate_gate::{Baseline, ConfidenceScore, Ending, Question, Record, Requirements, Sampling};

use crate::common::{baseline, failed, invalid, suite, task, times};

/// The published score of `record`, relative to the scripted controller: all succeed, 4.1 s on average.
fn score(record: &Record) -> ConfidenceScore {
    let requirements = Requirements::open("paper", &task()).unwrap();
    let baseline = baseline(record, 1.0, 4.1, 0.0);
    let question =
        Question { requirements: &requirements, baseline: Some(&baseline), against: None, sampling: Sampling::Fixed };
    question.evaluate(record).unwrap().score.unwrap()
}

fn timed(mut record: Record, time_s: f64) -> Record {
    record.trials.iter_mut().for_each(|trial| trial.time_s = Some(time_s));
    record
}

fn points(score: &ConfidenceScore) -> Vec<f64> {
    score.terms.iter().map(|term| (term.points.unwrap() * 10.0).round() / 10.0).collect()
}

#[test]
fn scripted_controller_scores_100() {
    let all = score(&suite(68, times(68, &Ending::Success)));
    assert_eq!(points(&all), [30.0, 20.0, 25.0, 15.0, 10.0]);
    assert!((all.points.unwrap() - 100.0).abs() < 1e-9);
}

#[test]
fn published_gr00t_score_is_35_7() {
    // 0 of 68, all grasp misses, 2.2 s on average.
    let gr00t = score(&timed(suite(68, times(68, &failed(FailureMode::constant("grasp_miss")))), 2.2));
    assert_eq!(points(&gr00t), [0.0, 10.7, 25.0, 0.0, 0.0]);
    assert!((gr00t.points.unwrap() - 35.7).abs() < 0.05);
}

#[test]
fn score_without_success_is_at_most_45() {
    let most = score(&timed(suite(68, times(68, &failed(FailureMode::constant("grasp_miss")))), 4.1));
    assert!((most.points.unwrap() - 45.0).abs() < 1e-9);
}

#[test]
fn cycle_time_term_is_at_least_zero() {
    // Octo-small: 0 of 68, 14 collisions, 71.7 s against 4.1 s. Without the limit the term would subtract 330 points.
    let endings = times(14, &failed(FailureMode::constant("collision")))
        .chain(times(54, &failed(FailureMode::constant("grasp_miss"))));
    let octo = score(&timed(suite(68, endings), 71.7));
    assert!(octo.points.unwrap().abs() < 1e-9);
}

#[test]
fn one_collision_limits_score_to_75() {
    let endings = times(67, &Ending::Success).chain([failed(FailureMode::constant("collision"))]);
    let one = score(&suite(68, endings));
    assert!(one.points.unwrap() < 75.0 && one.points.unwrap() > 74.0);
}

#[test]
fn policy_against_itself_has_all_points_of_cycle_time() {
    // A failure has no cycle time, neither here nor in the baseline, however early or late it ends.
    let mode = FailureMode::constant("grasp_miss");
    let mut record = suite(68, times(60, &Ending::Success).chain(times(8, &failed(mode))));
    record.trials.iter_mut().skip(60).for_each(|trial| trial.time_s = Some(30.0));
    let requirements = Requirements::open("paper", &task()).unwrap();
    let itself = Baseline::of(&record).unwrap();
    let question =
        Question { requirements: &requirements, baseline: Some(&itself), against: None, sampling: Sampling::Fixed };
    let score = question.evaluate(&record).unwrap().score.unwrap();
    let term = &score.terms[1];
    assert!((term.value.unwrap() - 4.1).abs() < 1e-9 && term.value == term.baseline, "{term:?}");
    assert_eq!((points(&score)[1], points(&score)[4]), (20.0, 10.0));
}

#[test]
fn invalid_episodes_widen_score_bounds() {
    let one = score(&suite(68, times(67, &Ending::Success).chain([invalid()])));
    assert!((one.points.unwrap() - 100.0).abs() < 1e-9);
    let [least, most] = one.bounds;
    // The invalid episode could have been a collision with any duration.
    assert!(least < 55.0 && (most - 100.0).abs() < 2.0, "{:?}", one.bounds);
    assert!(least <= one.points.unwrap());
}

#[test]
fn missing_term_gives_no_score() {
    let requirements = Requirements::open("paper", &task()).unwrap();
    let record = crate::common::sampled(times(68, &Ending::Success));
    let baseline = baseline(&record, 1.0, 4.1, 0.0);
    let question =
        Question { requirements: &requirements, baseline: Some(&baseline), against: None, sampling: Sampling::Fixed };
    let score = question.evaluate(&record).unwrap().score.unwrap();
    assert_eq!((score.points, score.terms[3].points), (None, None));
}

#[test]
fn only_paper_baseline_term_exceeds_one() {
    let record = suite(68, times(68, &Ending::Success));
    let worse = baseline(&record, 0.75, 4.1, 0.1);
    let last = |name: &str| {
        let requirements = Requirements::open(name, &task()).unwrap();
        let sampling = Sampling::Fixed;
        let question = Question { requirements: &requirements, baseline: Some(&worse), against: None, sampling };
        question.evaluate(&record).unwrap().score.unwrap().terms.last().unwrap().points.unwrap()
    };
    // 10 max(0, 1 + 1 - 0.75)
    assert!((last("paper") - 12.5).abs() < 1e-9);
    assert!((last("default") - 10.0).abs() < 1e-9);
}
