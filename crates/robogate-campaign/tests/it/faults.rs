//! Tests that a fault makes only the affected episodes invalid.

use robogate_campaign::{Completion, Event, ExecuteError, RunError, Warning, recorded, start as start_run};
use robogate_core::{FaultKind, Outcome};

use crate::world::{Synthetic, Trouble, files, plan, provenance, resume, start, stop_after, summary, with_pool};

fn some_panic(index: u64) -> Trouble {
    if index % 10 == 3 { Trouble::Panic } else { Trouble::None }
}

#[test]
fn panics_make_episodes_invalid() {
    let base = tempfile::tempdir().unwrap();
    let factory = Synthetic { trouble: some_panic, ..Synthetic::default() };
    let done = start(&base.path().join("1"), &plan(100, 50), &factory, 1).unwrap();
    let (uniform, boundary) = (&summary(&done).stages[0], &summary(&done).stages[1]);
    assert_eq!((uniform.episodes, uniform.valid, uniform.invalid), (100, 90, 10));
    assert_eq!((boundary.episodes, boundary.valid, boundary.invalid), (50, 45, 5));
    assert_eq!((uniform.faults[0].fault.as_str(), uniform.faults[0].episodes), ("unavailable", 10));
    // One worker per stage, and one per panic.
    assert_eq!(factory.workers.into_inner(), 2 + 15);
    // The rate is over the valid episodes only.
    assert_eq!(uniform.success_rate, Some(uniform.successes as f64 / 90.0));
    let entry = recorded(&base.path().join("1"), 13).unwrap();
    let Outcome::Invalid(fault) = &entry.episode.outcome else { panic!("{entry:?}") };
    assert_eq!(fault.kind, FaultKind::Unavailable);
    assert!(fault.detail.ends_with("panicked: simulator crash in episode 13"), "{fault}");
    // Episodes after a panic are the same as without it.
    let calm = base.path().join("calm");
    start(&calm, &plan(100, 0), &Synthetic::default(), 1).unwrap();
    assert_eq!(recorded(&base.path().join("1"), 14).unwrap(), recorded(&calm, 14).unwrap());
    start(&base.path().join("2"), &plan(100, 50), &Synthetic { trouble: some_panic, ..Synthetic::default() }, 2)
        .unwrap();
    assert_eq!(files(&base.path().join("1")), files(&base.path().join("2")));
}

#[test]
fn missing_worker_leaves_run_resumable() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("run");
    let none = Synthetic { most_workers: 0, ..Synthetic::default() };
    let error = start(&dir, &plan(40, 20), &none, 2).unwrap_err();
    assert!(
        matches!(&error, RunError::Execute(ExecuteError::Worker(fault)) if fault.detail == "no more workers"),
        "{error}"
    );
    resume(&dir, &Synthetic::default(), 1).unwrap();
    start(&base.path().join("undisturbed"), &plan(40, 20), &Synthetic::default(), 1).unwrap();
    assert_eq!(files(&dir), files(&base.path().join("undisturbed")));
}

#[test]
fn lost_worker_keeps_episodes() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("run");
    let one = Synthetic { trouble: some_panic, most_workers: 1, ..Synthetic::default() };
    assert!(matches!(start(&dir, &plan(40, 20), &one, 1), Err(RunError::Execute(ExecuteError::Worker(_)))));
    // Episodes 0 to 2 succeeded; episode 3 panicked and is recorded.
    assert!(matches!(recorded(&dir, 3).unwrap().episode.outcome, Outcome::Invalid(_)));
    assert!(matches!(recorded(&dir, 4), Err(RunError::NoSuchEpisode { index: 4, .. })));
}

fn all_invalid(_: u64) -> Trouble {
    Trouble::Invalid
}

#[test]
fn all_invalid_campaign_warns_and_continues() {
    let base = tempfile::tempdir().unwrap();
    let factory = Synthetic { trouble: all_invalid, ..Synthetic::default() };
    let mut warnings = Vec::new();
    let mut watch = |event: &Event, _: &_| {
        if let Event::Warning { warning, message } = event {
            assert_eq!(*message, warning.to_string());
            warnings.push(warning.clone());
        }
    };
    let done = with_pool(&factory, 1, &mut watch, |pool, events| {
        start_run(base.path(), &plan(120, 20), provenance(), pool, events)
    })
    .unwrap();
    let first = "setup: episode 0 cannot be set up".to_owned();
    assert_eq!(warnings, [Warning::AllInvalid { episodes: 20, first }, Warning::NoEvidence]);
    let summary = summary(&done);
    assert_eq!((summary.estimate.success_rate, summary.estimate.interval_95), (None, [0.0, 1.0]));
    assert_eq!((summary.stages[0].invalid, summary.stages[0].faults[0].fault.as_str()), (120, "setup"));
    assert!(summary.stages[0].failure_modes.iter().all(|mode| mode.share_of_failures.is_none()));
}

#[test]
fn small_all_invalid_campaign_warns() {
    let base = tempfile::tempdir().unwrap();
    let factory = Synthetic { trouble: all_invalid, ..Synthetic::default() };
    let mut warnings = 0;
    let mut watch = |event: &Event, _: &_| {
        warnings += u32::from(matches!(event, Event::Warning { warning: Warning::AllInvalid { episodes: 5, .. }, .. }));
    };
    with_pool(&factory, 2, &mut watch, |pool, events| start_run(base.path(), &plan(5, 0), provenance(), pool, events))
        .unwrap();
    assert_eq!(warnings, 1);
}

fn every_third_valid(index: u64) -> Trouble {
    if index.is_multiple_of(3) { Trouble::None } else { Trouble::Invalid }
}

#[test]
fn mostly_invalid_campaign_warns_once() {
    let base = tempfile::tempdir().unwrap();
    let factory = Synthetic { trouble: every_third_valid, ..Synthetic::default() };
    let mut warnings = Vec::new();
    let mut watch = |event: &Event, _: &_| {
        if let Event::Warning { warning, .. } = event {
            warnings.push(warning.clone());
        }
    };
    with_pool(&factory, 1, &mut watch, |pool, events| start_run(base.path(), &plan(60, 0), provenance(), pool, events))
        .unwrap();
    let first = "setup: episode 1 cannot be set up".to_owned();
    assert_eq!(warnings, [Warning::MostlyInvalid { episodes: 20, invalid: 13, first }]);
}

#[test]
fn stop_is_kept_at_both_ends() {
    let base = tempfile::tempdir().unwrap();
    for episodes in [0, 7] {
        let dir = base.path().join(episodes.to_string());
        let mut last = None;
        let mut stop = stop_after(episodes);
        let mut watch = |event: &Event, flag: &_| {
            stop(event, flag);
            last = Some(event.clone());
        };
        let done = with_pool(&Synthetic::default(), 1, &mut watch, |pool, events| {
            start_run(&dir, &plan(20, 10), provenance(), pool, events)
        });
        let Completion::Interrupted { done, episodes: 30 } = done.unwrap() else { panic!() };
        assert_eq!(last, Some(Event::Interrupted { done, episodes: 30 }));
        // In addition to the observed episodes: one running, one passed on, one waiting.
        assert!((episodes..=episodes + 3 * episodes.min(1)).contains(&done), "{done} for {episodes}");
    }
    let mut stop = stop_after(30);
    let done = with_pool(&Synthetic::default(), 1, &mut stop, |pool, events| {
        start_run(&base.path().join("30"), &plan(20, 10), provenance(), pool, events)
    });
    assert!(matches!(done.unwrap(), Completion::Finished { .. }));
}

#[test]
fn event_stream_is_complete_and_ordered() {
    let base = tempfile::tempdir().unwrap();
    let mut seen = Vec::new();
    let mut stop = stop_after(25);
    let mut watch = |event: &Event, flag: &_| {
        stop(event, flag);
        seen.push(event.clone());
    };
    let plan = plan(20, 10);
    with_pool(&Synthetic::default(), 1, &mut watch, |pool, events| {
        start_run(base.path(), &plan, provenance(), pool, events)
    })
    .unwrap();
    with_pool(&Synthetic::default(), 1, &mut |event, _| seen.push(event.clone()), |pool, events| {
        robogate_campaign::resume(base.path(), &provenance(), pool, events)
    })
    .unwrap();
    let json: Vec<serde_json::Value> = seen.iter().map(|event| serde_json::to_value(event).unwrap()).collect();
    let mut words: Vec<&str> = json.iter().map(|event| event["event"].as_str().unwrap()).collect();
    words.dedup();
    let first = [
        "started",
        "stage_started",
        "episode",
        "stage_finished",
        "boundary_found",
        "stage_started",
        "episode",
        "interrupted",
    ];
    let second = [
        "started",
        "stage_started",
        "stage_finished",
        "boundary_found",
        "stage_started",
        "episode",
        "stage_finished",
        "finished",
    ];
    assert_eq!(words, [&first[..], &second[..]].concat());
    let back: Vec<Event> = json.into_iter().map(|event| serde_json::from_value(event).unwrap()).collect();
    assert_eq!(back, seen);
    // The boundary does not change during the run.
    let found: Vec<&Event> = seen.iter().filter(|event| matches!(event, Event::BoundaryFound { .. })).collect();
    assert_eq!(found[0], found[1]);
}

#[test]
fn summary_names_each_population() {
    let base = tempfile::tempdir().unwrap();
    let done = start(base.path(), &plan(200, 100), &Synthetic::default(), 2).unwrap();
    let summary = summary(&done);
    let json = serde_json::to_value(summary).unwrap();
    assert_eq!(json["estimate"]["population"], "operating_space");
    assert_eq!(json["estimate"]["stages"], serde_json::json!(["uniform"]));
    assert_eq!(json["stages"][1]["population"], "focused_design");
    assert!(json["stages"][1]["note"].as_str().unwrap().contains("not the operating space"));
    let [uniform, boundary] = &summary.stages[..] else { panic!() };
    assert_eq!(summary.estimate.success_rate, uniform.success_rate);
    assert_eq!(uniform.valid, uniform.successes + uniform.failure_modes.iter().map(|m| m.episodes).sum::<u64>());
    let names: Vec<&str> = uniform.marginal_effects.iter().map(|effect| effect.parameter.as_str()).collect();
    assert_eq!(names, ["friction", "mass_kg", "size_m"]);
    for effect in &uniform.marginal_effects {
        assert_eq!(effect.bins.len(), 10);
        assert_eq!(effect.bins.iter().map(|bin| bin.valid).sum::<u64>(), uniform.valid);
        assert_eq!(effect.bins.iter().map(|bin| bin.successes).sum::<u64>(), uniform.successes);
    }
    assert!(boundary.marginal_effects.is_empty());
    let file: robogate_campaign::Summary =
        serde_json::from_slice(&std::fs::read(base.path().join("summary.json")).unwrap()).unwrap();
    assert_eq!(file, *summary);
}
