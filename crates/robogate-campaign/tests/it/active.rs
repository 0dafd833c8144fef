//! The active stage: the same files for any number of threads and interruptions, weights, pairs and the early stop.

use std::path::Path;
use std::sync::atomic::Ordering;

use robogate_campaign::{
    ActiveReport, ActiveStage, Completion, Plan, PlanError, Population, RowsError, Stage, check_rows,
};
use robogate_core::{FailureMode, Outcome};
use robogate_dictionary::{Dictionary, DictionaryError, Entry};

use crate::world::{self, Synthetic, plan, provenance, start, stop_after, summary, with_pool};

fn active(total: u64, change: impl FnOnce(&mut ActiveStage)) -> Plan {
    let mut plan = plan(total, 0).with_active();
    change(plan.active.as_mut().unwrap());
    plan
}

fn rows(dir: &Path) -> Vec<Entry> {
    Dictionary::open(&dir.join("dictionary.parquet")).unwrap().entries().map(Result::unwrap).collect()
}

fn report(dir: &Path) -> ActiveReport {
    serde_json::from_slice(&std::fs::read(dir.join("active.json")).unwrap()).unwrap()
}

#[test]
fn threads_and_interruptions_change_nothing() {
    let plan = active(320, |stage| stage.until_rms = Some(0.02));
    let reference = tempfile::tempdir().unwrap();
    start(reference.path(), &plan, &Synthetic::default(), 1).unwrap();
    let expected = world::files(reference.path());
    assert!(expected.contains_key("active.json"));
    let dir = tempfile::tempdir().unwrap();
    start(dir.path(), &plan, &Synthetic::default(), 3).unwrap();
    assert_eq!(world::files(dir.path()), expected);
    // Stops within the first stage, within each round, and between rounds.
    let dir = tempfile::tempdir().unwrap();
    let mut completion = with_pool(&Synthetic::default(), 2, &mut stop_after(37), |pool, events| {
        robogate_campaign::start(dir.path(), &plan, provenance(), pool, events)
    });
    let mut parts = 1;
    while let Completion::Interrupted { .. } = completion.as_ref().unwrap() {
        parts += 1;
        completion = with_pool(&Synthetic::default(), 2, &mut stop_after(43), |pool, events| {
            robogate_campaign::resume(dir.path(), &provenance(), pool, events)
        });
    }
    assert!(parts > 5, "{parts}");
    assert_eq!(world::files(dir.path()), expected);
}

#[test]
fn rows_have_bounded_weights() {
    let dir = tempfile::tempdir().unwrap();
    let plan = active(600, |_| {});
    let done = start(dir.path(), &plan, &Synthetic::default(), 2).unwrap();
    let rows = rows(dir.path());
    assert_eq!(rows.len(), 600);
    assert!(rows[..150].iter().all(|row| row.stage == "uniform" && (row.weight - 1.0).abs() < 1e-12));
    let stage = &rows[150..];
    assert!(stage.iter().all(|row| row.stage == "active" && ["active", "uniform"].contains(&row.design.as_str())));
    assert!(stage.iter().all(|row| row.weight > 0.0 && row.weight <= 2.0 + 1e-9));
    // Half of the stage is a uniform sample.
    let uniform = stage.iter().filter(|row| row.design == "uniform").count();
    assert!((190..=260).contains(&uniform), "{uniform}");
    // The weights vary and have the mean 1.
    let mean = stage.iter().map(|row| row.weight).sum::<f64>() / stage.len() as f64;
    assert!((mean - 1.0).abs() < 0.15, "{mean}");
    assert!(stage.iter().any(|row| row.weight < 0.8) && stage.iter().any(|row| row.weight > 1.4));
    let summary = summary(&done);
    assert_eq!(summary.estimate.stages, [Stage::Uniform, Stage::Active]);
    assert_eq!(summary.estimate.population, Population::OperatingSpace);
    assert_eq!(summary.stages[1].population, Population::FocusedDesign);
    assert_eq!(summary.episodes, 600);
    let report = report(dir.path());
    let episodes: Vec<u64> = report.rounds.iter().map(|round| round.episodes).collect();
    assert_eq!(episodes, [75, 113, 170, 92, 0]);
    assert_eq!(report.rounds[4].trained_on, 600);
    assert!(report.rounds.iter().all(|round| round.model.is_some() && round.certificate.is_none()));
}

#[test]
fn weighted_rate_agrees_with_uniform_one() {
    let [dir, even] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let done = start(dir.path(), &active(1200, |_| {}), &Synthetic::default(), 2).unwrap();
    let uniform = start(even.path(), &plan(4000, 0), &Synthetic::default(), 2).unwrap();
    let [low, high] = summary(&done).estimate.interval_95;
    let truth = summary(&uniform).estimate.success_rate.unwrap();
    assert!(low <= truth && truth <= high, "{low} to {high}: {truth}");
    // The raw rate of the stage is another one, because its points were chosen.
    let raw = summary(&done).stages[1].success_rate.unwrap();
    assert!((raw - truth).abs() > 0.02, "{raw} {truth}");
}

/// The rows that no model chose are a sample from the operating space, so their plain rate needs no weights.
#[test]
fn uniform_part_is_unbiased() {
    let even = tempfile::tempdir().unwrap();
    let uniform = start(even.path(), &plan(6000, 0), &Synthetic::default(), 2).unwrap();
    let truth = summary(&uniform).estimate.success_rate.unwrap();
    let (mut successes, mut episodes) = (0, 0);
    for seed in 0..8 {
        let dir = tempfile::tempdir().unwrap();
        let plan = Plan { seed, ..active(400, |_| {}) };
        start(dir.path(), &plan, &Synthetic::default(), 2).unwrap();
        for row in rows(dir.path()).iter().filter(|row| row.stage == "active" && row.design == "uniform") {
            episodes += 1;
            successes += u64::from(row.episode.outcome == Outcome::Success);
        }
    }
    let rate = successes as f64 / episodes as f64;
    // About 1,200 episodes: the standard error is 0.014.
    assert!(episodes > 1000 && (rate - truth).abs() < 0.05, "{rate} of {episodes} for {truth}");
}

/// Seeking a mode finds more of its failures, and the weighted rate is that of uniform episodes.
#[test]
fn sought_mode_is_found_more_often() {
    let share = |rows: &[Entry]| {
        let hit = rows.iter().filter(|row| row.episode.outcome == Outcome::Failure(FailureMode::constant("grip_loss")));
        hit.count() as f64 / rows.len() as f64
    };
    let even = tempfile::tempdir().unwrap();
    start(even.path(), &plan(4000, 0), &Synthetic::default(), 2).unwrap();
    let truth = share(&rows(even.path()));
    let dir = tempfile::tempdir().unwrap();
    let mut plan = active(1200, |_| {});
    plan.active = plan.active.map(|stage| ActiveStage { candidates: 64, ..stage.seeking("grip_loss") });
    let done = start(dir.path(), &plan, &Synthetic::default(), 2).unwrap();
    let all = rows(dir.path());
    assert!(share(&all[300..]) > 1.3 * truth, "{} {truth}", share(&all[300..]));
    let sought = summary(&done).sought.clone().unwrap();
    assert_eq!((sought.mode.as_str(), sought.valid), ("grip_loss", 1200));
    let [low, high] = sought.interval_95;
    assert!(low < truth && truth < high, "{sought:?} {truth}");
    assert!(sought.worth_episodes.unwrap() > 600.0, "{sought:?}");
}

#[test]
fn rows_follow_from_earlier_ones() {
    let dir = tempfile::tempdir().unwrap();
    start(dir.path(), &active(200, |stage| stage.until_rms = Some(0.5)), &Synthetic::default(), 2).unwrap();
    let dictionary = Dictionary::open(&dir.path().join("dictionary.parquet")).unwrap();
    let check =
        |rows: &[Entry]| check_rows(dictionary.provenance(), None, rows.iter().cloned().map(Ok::<_, DictionaryError>));
    let rows = rows(dir.path());
    assert_eq!(check(&rows).unwrap(), rows.len() as u64);
    // Other outcomes of the uniform stage give another model, which chooses other points.
    let mut invented = rows.clone();
    invented[..40].iter_mut().for_each(|row| row.episode.outcome = Outcome::Success);
    assert!(matches!(check(&invented), Err(RowsError::Foreign { index: 50.. })));
    assert!(matches!(check(&rows[..rows.len() - 3]), Err(RowsError::Count { .. })));
}

#[test]
fn certificate_stops_early() {
    let dir = tempfile::tempdir().unwrap();
    // Any model has this error at most, so the first pairs show it.
    let plan = active(2000, |stage| stage.until_rms = Some(0.5));
    let done = start(dir.path(), &plan, &Synthetic::default(), 2).unwrap();
    let report = report(dir.path());
    let last = report.rounds.last().unwrap();
    let certificate = last.certificate.unwrap();
    assert!(certificate.reached && certificate.rms_bound <= 0.5 && last.episodes == 0);
    let rows = rows(dir.path());
    assert!((500..2000).contains(&rows.len()), "{}", rows.len());
    assert_eq!(summary(&done).episodes, rows.len() as u64);
    // Both episodes of a pair have the same parameters and weight 1, and no pair was used for training.
    let pairs: Vec<&Entry> = rows.iter().filter(|row| row.design == "pair").collect();
    assert_eq!(pairs.len() as u64, 2 * certificate.pairs);
    for pair in pairs.chunks(2) {
        let [a, b] = [pair[0], pair[1]].map(|row| &row.episode.scenario);
        assert_eq!((&a.requested, a.index + 1), (&b.requested, b.index));
        assert!((pair[0].weight - 1.0).abs() < 1e-12);
    }
    assert_eq!(last.trained_on as usize, rows.len() - pairs.len());
}

#[test]
fn invalid_episodes_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let factory = Synthetic {
        trouble: |index| if index % 10 == 3 { world::Trouble::Invalid } else { world::Trouble::None },
        ..Synthetic::default()
    };
    start(dir.path(), &active(300, |_| {}), &factory, 2).unwrap();
    assert_eq!(report(dir.path()).rounds.last().unwrap().trained_on, 270);
    assert!(factory.workers.load(Ordering::Relaxed) >= 3);
}

#[test]
fn rounds_are_uniform_without_failures() {
    let dir = tempfile::tempdir().unwrap();
    // A quarter of 24 episodes has fewer than ten of one outcome.
    start(dir.path(), &active(24, |_| {}), &Synthetic::default(), 1).unwrap();
    assert!(rows(dir.path())[6..9].iter().all(|row| (row.weight - 1.0).abs() < 1e-12));
    assert_eq!(report(dir.path()).rounds[0].model, None);
}

#[test]
fn contradicting_plans_are_rejected() {
    let mut both = plan(100, 50);
    both.active = Some(ActiveStage::new(10));
    assert!(matches!(both.check(&world::space()), Err(PlanError::ActiveAndBoundary)));
    let alone = Plan { uniform: robogate_campaign::UniformStage { episodes: 0 }, ..active(100, |_| {}) };
    assert!(matches!(alone.check(&world::space()), Err(PlanError::ActiveAlone)));
    let both = active(100, |stage| (stage.seek, stage.until_rms) = (Some("collision".to_owned()), Some(0.2)));
    assert!(matches!(both.check(&world::space()), Err(PlanError::SeekUntilRms)));
    let bad = active(100, |stage| stage.growth = 0.0);
    assert!(bad.check(&world::space()).unwrap_err().to_string().contains("active.growth"));
}

#[test]
fn totals_keep_the_design() {
    let plan = active(100, |stage| stage.growth = 2.0).with_total(1001);
    let active = plan.active.clone().unwrap();
    assert_eq!((plan.uniform.episodes, active.episodes, plan.episodes()), (251, 750, 1001));
    assert!((active.growth - 2.0).abs() < 1e-12);
    let two = plan.with_two_stages();
    assert_eq!((two.uniform.episodes, two.boundary.episodes, two.active), (668, 333, None));
}
