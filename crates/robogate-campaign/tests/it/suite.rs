//! Tests of campaigns over a suite.

use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::{
    BUILT_IN_SUITES, Completion, Plan, PlanError, Population, Stage, built_in_suite, recorded, resume_in_rounds,
    start_in_rounds, suite_sha256,
};
use robogate_core::Suite;
use robogate_dictionary::{Dictionary, Entry, Provenance};

use crate::world::{Synthetic, files, provenance, stop_after, summary, with_pool};

const SUITE: &str = r#"
    schema = 1
    name = "three"
    version = "1.0.0"
    description = "Three scenarios of the synthetic world."
    defaults = { friction = { low = 0.2, high = 0.9 }, mass_kg = 0.3, size_m = 0.05, obstacles = 0, shape = "box" }
    [[group]]
    name = "plain"
    category = "nominal"
    scenarios = [{ id = "plain-1" }, { id = "plain-2", size_m = 0.04 }]
    [[group]]
    name = "crowd"
    category = "adversarial"
    scenarios = [{ id = "crowd-1", obstacles = 5 }]
"#;

pub(crate) fn suite() -> Suite {
    Suite::from_toml(SUITE).unwrap()
}

pub(crate) fn origin() -> Provenance {
    Provenance { space: suite().space().clone(), ..provenance() }
}

/// Runs the suite and stops after round `last`.
fn run(dir: &Path, rounds: u64, last: u64, threads: usize) -> (Completion, Vec<u64>) {
    let plan = Plan::of_suite(suite(), rounds, 7);
    let mut seen = Vec::new();
    let completion = with_pool(&Synthetic::default(), threads, &mut |_, _| {}, |pool, events| {
        start_in_rounds(dir, &plan, origin(), &[], pool, events, &mut |round| {
            assert_eq!(round.entries.len(), 3);
            seen.push(round.number);
            if round.number == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
    });
    (completion.unwrap(), seen)
}

fn entries(dir: &Path) -> Vec<Entry> {
    Dictionary::open(&dir.join("dictionary.parquet")).unwrap().entries().collect::<Result<_, _>>().unwrap()
}

#[test]
fn rounds_run_every_scenario_once() {
    let base = tempfile::tempdir().unwrap();
    let (done, _) = run(base.path(), 4, u64::MAX, 2);
    let rows = entries(base.path());
    assert_eq!(rows.len(), 12);
    for (i, entry) in rows.iter().enumerate() {
        let case = suite().case(i as u64).clone();
        let label = (entry.label.case.clone(), entry.label.category.clone(), entry.label.group.clone());
        assert_eq!(label, (Some(case.id), Some(case.category), Some(case.group)));
        assert_eq!((entry.stage.as_str(), entry.design.as_str(), entry.weight), ("suite", "suite", 1.0));
    }
    let summary = summary(&done);
    assert_eq!((summary.stages[0].stage, summary.estimate.population), (Stage::Suite, Population::Suite));
    let of = summary.suite.as_ref().unwrap();
    assert_eq!((of.rounds, of.sha256.clone()), (4, suite_sha256(&suite())));
    let counts: Vec<_> = of.groups.iter().map(|g| (g.group.as_str(), g.scenarios, g.outcomes.total())).collect();
    assert_eq!(counts, [("plain", 2, 8), ("crowd", 1, 4)]);
}

#[test]
fn thread_count_does_not_change_files() {
    let base = tempfile::tempdir().unwrap();
    let runs = [1, 2].map(|threads| {
        let dir = base.path().join(threads.to_string());
        run(&dir, 10, u64::MAX, threads);
        files(&dir)
    });
    assert_eq!(runs[0], runs[1]);
}

#[test]
fn early_stop_equals_shorter_plan() {
    let base = tempfile::tempdir().unwrap();
    let [short, stopped] = ["short", "stopped"].map(|name| base.path().join(name));
    run(&short, 3, u64::MAX, 1);
    let (done, seen) = run(&stopped, 100, 2, 2);
    assert_eq!(seen, [0, 1, 2]);
    assert_eq!(summary(&done).suite.as_ref().unwrap().rounds, 3);
    assert_eq!(entries(&short), entries(&stopped));
}

#[test]
fn resume_replays_all_rounds() {
    let base = tempfile::tempdir().unwrap();
    let [whole, pieces] = ["whole", "pieces"].map(|name| base.path().join(name));
    run(&whole, 20, 8, 2);
    let plan = Plan::of_suite(suite(), 20, 7);
    let until_8 = |seen: &mut Vec<u64>, number: u64| {
        seen.push(number);
        if number == 8 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut first = Vec::new();
    let stopped = with_pool(&Synthetic::default(), 2, &mut stop_after(11), |pool, events| {
        start_in_rounds(&pieces, &plan, origin(), &[], pool, events, &mut |round| until_8(&mut first, round.number))
    });
    assert!(matches!(stopped.unwrap(), Completion::Interrupted { .. }));
    assert!(!first.is_empty() && first.len() < 9, "{first:?}");
    assert_eq!(recorded(&pieces, 4).unwrap().label.case.as_deref(), Some("plain-2"));
    let mut again = Vec::new();
    with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| {
        resume_in_rounds(&pieces, &origin(), pool, events, &mut |round| until_8(&mut again, round.number))
    })
    .unwrap();
    assert_eq!(again, (0..=8).collect::<Vec<_>>());
    assert_eq!(files(&pieces), files(&whole));
}

#[test]
fn suite_hash_ignores_formatting() {
    let commented = SUITE.replace("schema = 1", "# A comment.\n    schema   =   1");
    assert_eq!(suite_sha256(&Suite::from_toml(&commented).unwrap()), suite_sha256(&suite()));
    let heavier = SUITE.replace("mass_kg = 0.3", "mass_kg = 0.31");
    assert_ne!(suite_sha256(&Suite::from_toml(&heavier).unwrap()), suite_sha256(&suite()));
}

#[test]
fn contradictory_suite_plan_is_rejected() {
    let plan = Plan::of_suite(suite(), 2, 7);
    assert!(plan.check(suite().space()).is_ok());
    assert!(matches!(plan.check(&crate::world::space()), Err(PlanError::SuiteSpace)));
    let change = |change: &dyn Fn(&mut Plan)| {
        let mut plan = plan.clone();
        change(&mut plan);
        plan.check(suite().space()).unwrap_err()
    };
    assert!(matches!(change(&|p| p.uniform.episodes = 5), PlanError::SuiteAndStages));
    assert!(matches!(change(&|p| p.suite.as_mut().unwrap().rounds = 0), PlanError::NoRounds));
    assert!(matches!(change(&|p| p.suite.as_mut().unwrap().rounds = u64::MAX), PlanError::TooMany { .. }));
    let other = Suite::from_toml(&SUITE.replace("0.3,", "0.4,")).unwrap();
    assert!(matches!(change(&|p| p.suite.as_mut().unwrap().suite = other.clone()), PlanError::SuiteHash { .. }));
}

#[test]
fn built_in_suites_are_valid() {
    for (name, _) in BUILT_IN_SUITES {
        assert_eq!(built_in_suite(name).unwrap().unwrap().name(), name);
    }
    assert!(built_in_suite("industrial-69").is_none());
}
