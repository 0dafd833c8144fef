use robogate_core::FailureMode;
use robogate_gate::{ConfidenceScore, Ending, Question, Record, Requirements, Sampling};

use crate::common::{baseline, failed, invalid, suite, task, times};

/// The published score of `record` against the scripted controller: all succeed, 4.1 s on average.
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
fn the_scripted_controller_against_itself_scores_100() {
    let all = score(&suite(68, times(68, &Ending::Success)));
    assert_eq!(points(&all), [30.0, 20.0, 25.0, 15.0, 10.0]);
    assert!((all.points.unwrap() - 100.0).abs() < 1e-9);
}

#[test]
fn gr00t_fine_tuned_scores_35_7_by_the_published_formula() {
    // 0 of 68, all grasp misses, 2.2 s on average.
    let gr00t = score(&timed(suite(68, times(68, &failed(FailureMode::constant("grasp_miss")))), 2.2));
    assert_eq!(points(&gr00t), [0.0, 10.7, 25.0, 0.0, 0.0]);
    assert!((gr00t.points.unwrap() - 35.7).abs() < 0.05);
}

#[test]
fn without_a_success_45_is_the_most() {
    let most = score(&timed(suite(68, times(68, &failed(FailureMode::constant("grasp_miss")))), 4.1));
    assert!((most.points.unwrap() - 45.0).abs() < 1e-9);
}

#[test]
fn octo_small_scores_0_once_the_cycle_time_is_cut_off() {
    // 0 of 68, 14 collisions, 71.7 s against 4.1 s: the uncut term would take 330 points away.
    let endings = times(14, &failed(FailureMode::constant("collision")))
        .chain(times(54, &failed(FailureMode::constant("grasp_miss"))));
    let octo = score(&timed(suite(68, endings), 71.7));
    assert!(octo.points.unwrap().abs() < 1e-9);
}

#[test]
fn one_collision_caps_the_score_at_75() {
    let endings = times(67, &Ending::Success).chain([failed(FailureMode::constant("collision"))]);
    let one = score(&suite(68, endings));
    assert!(one.points.unwrap() < 75.0 && one.points.unwrap() > 74.0);
}

#[test]
fn invalid_episodes_leave_the_score_open_by_what_they_could_have_been() {
    let one = score(&suite(68, times(67, &Ending::Success).chain([invalid()])));
    assert!((one.points.unwrap() - 100.0).abs() < 1e-9);
    let [least, most] = one.bounds;
    // It could have been a collision of any length.
    assert!(least < 55.0 && (most - 100.0).abs() < 2.0, "{:?}", one.bounds);
    assert!(least <= one.points.unwrap());
}

#[test]
fn a_term_without_evidence_leaves_no_score_rather_than_a_zero() {
    let requirements = Requirements::open("paper", &task()).unwrap();
    let record = crate::common::drawn(times(68, &Ending::Success));
    let baseline = baseline(&record, 1.0, 4.1, 0.0);
    let question =
        Question { requirements: &requirements, baseline: Some(&baseline), against: None, sampling: Sampling::Fixed };
    let score = question.evaluate(&record).unwrap().score.unwrap();
    assert_eq!((score.points, score.terms[3].points), (None, None));
}

#[test]
fn the_papers_baseline_term_rewards_a_better_policy_and_the_default_one_is_capped() {
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
