//! Tests of the audit, on files in the layouts of LeRobot, vla-eval, robosuite and Isaac Lab-Arena.

use std::fs;
use std::path::Path;

use robogate_dictionary::results::audit::{Audit, Check, CheckResult, Problem, audit};
use robogate_dictionary::results::{Mapping, import};
use robogate_dictionary::{Dictionary, export};

use crate::common::Folder;

fn of_fixture(name: &str) -> Audit {
    audit(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/results").join(name), None, &Mapping::default()).unwrap()
}

fn of_text(name: &str, text: &str) -> Audit {
    let folder = Folder::new(&format!("audit-{name}"));
    let path = folder.join("t");
    fs::write(&path, text).unwrap();
    audit(&path, None, &Mapping::default()).unwrap()
}

fn result(audit: &Audit, check: Check) -> &CheckResult {
    &audit.checks.iter().find(|checked| checked.check == check).unwrap().result
}

fn problems(audit: &Audit, check: Check) -> &[Problem] {
    match result(audit, check) {
        CheckResult::Found { problems, .. } => problems,
        CheckResult::Clear { .. } | CheckResult::NotPossible { .. } => &[],
    }
}

#[test]
fn lerobot_batches_with_equal_seeds_are_found() {
    let audit = of_fixture("lerobot_repeated_seeds.json");
    let repeated = &problems(&audit, Check::RepeatedSeeds)[0];
    // Row 5 of the evaluation is missing, so episodes 6 and 7 are rows 5 and 6.
    assert_eq!((repeated.count, repeated.rows.as_slice()), (3, &[4, 5, 6][..]));
    let missing = &problems(&audit, Check::MissingRows)[0];
    assert!(missing.what.contains("1 episode numbers have no row, first 5"), "{missing:?}");
}

#[test]
fn vla_eval_errors_are_found() {
    let audit = of_fixture("vla_eval.json");
    let errors = &problems(&audit, Check::InfrastructureErrors)[0];
    assert_eq!(errors.rows, [2]);
    assert!(errors.what.contains("connection_closed"), "{errors:?}");
}

#[test]
fn robosuite_repeats_are_found() {
    let audit = of_fixture("robosuite_rollouts.jsonl");
    let states = &problems(&audit, Check::DuplicateInitialStates)[0];
    assert_eq!((states.count, states.rows.as_slice()), (2, &[8, 9][..]));
    assert_eq!((audit.successes, audit.failures), (6, 4));
}

#[test]
fn arena_environments_are_found() {
    let audit = of_fixture("isaac_lab_arena.jsonl");
    assert_eq!(problems(&audit, Check::SuccessAtFirstStep)[0].count, 3);
    assert!(problems(&audit, Check::BatchArtefacts)[0].what.starts_with("The 4 environments have 4 to 12 episodes"));
    assert!(problems(&audit, Check::RepeatedSeeds)[0].what.starts_with("All 24 rows have the same seed"));
}

#[test]
fn missing_columns_are_reported() {
    let audit = of_text("bare", "success,mass\n1,1\n0,2\n");
    assert_eq!(audit.found(), 0);
    let impossible = audit.checks.iter().filter(|c| matches!(c.result, CheckResult::NotPossible { .. })).count();
    assert_eq!(impossible, Check::ALL.len(), "{:?}", audit.checks);
}

#[test]
fn sound_file_is_clear() {
    let rows: String = (0..60)
        .map(|i| {
            let success = (i * 7 + i / 3) % 3 % 2;
            let reason = if success == 1 { "done" } else { "slipped" };
            format!("{i},{},{success},0.{i:03}1,{},{reason},False,{}\n", 100 + i, 50 + i, i % 4)
        })
        .collect();
    let header = "episode,seed,success,friction,steps,reason,truncated,env_id";
    let audit = of_text("sound", &format!("{header}\n{rows}"));
    assert_eq!(audit.found(), 0, "{:?}", audit.checks);
    assert!(audit.checks.iter().all(|c| matches!(c.result, CheckResult::Clear { .. })), "{:?}", audit.checks);
}

#[test]
fn duplicate_rows_and_period_are_found() {
    let mut rows: String = (0..80).map(|i| format!("{i},{},0.{:03}1,{}\n", u8::from(i % 4 != 0), i, 50 + i)).collect();
    rows.push_str("79,1,0.0791,129\n");
    let audit = of_text("period", &format!("episode,success,friction,steps\n{rows}"));
    assert_eq!(problems(&audit, Check::DuplicateRows)[0].rows, [80]);
    assert!(problems(&audit, Check::BatchArtefacts)[0].what.contains("batch of"), "{:?}", audit.checks);
}

#[test]
fn failure_that_never_ran_is_found() {
    let audit = of_text("never", "success,steps,status\n1,30,done\n0,0,done\n0,12,CUDA out of memory\n0,400,timeout\n");
    let found = problems(&audit, Check::InfrastructureErrors);
    assert_eq!(found.iter().map(|problem| problem.rows.clone()).collect::<Vec<_>>(), [[2], [1]]);
}

#[test]
fn file_without_outcomes_is_refused() {
    let folder = Folder::new("audit-no-outcome");
    let path = folder.join("t");
    for text in ["foo,bar\n1,2\n", "success,mass\nmaybe,1\n"] {
        fs::write(&path, text).unwrap();
        let error = audit(&path, None, &Mapping::default()).unwrap_err().to_string();
        assert!(error.contains("no row reports success or failure") && error.contains("--map success="), "{error}");
    }
}

/// Export and dictionary have the campaign's seed in each row, and their outcome in `outcome`.
#[test]
fn own_files_are_recognised() {
    let folder = Folder::new("audit-own");
    let (table, dictionary, exported) = (folder.join("t"), folder.join("d.parquet"), folder.join("e.csv"));
    fs::write(&table, "success,mass\n1,0.5\n0,0.25\nerror,0.75\n").unwrap();
    import(&table, &dictionary, None, &Mapping::default()).unwrap();
    let rows = Dictionary::open(&dictionary).unwrap();
    export::csv(&rows, &mut fs::File::create(&exported).unwrap()).unwrap();
    for file in [dictionary, exported] {
        let audit = audit(&file, None, &Mapping::default()).unwrap();
        assert_eq!((audit.rows, audit.successes, audit.failures, audit.found()), (3, 1, 1, 0), "{:?}", audit.checks);
    }
}

/// Both arms of a paired comparison have the same tasks and seeds.
#[test]
fn control_arm_repeats_seeds_on_purpose() {
    let rows: String = ["none", "light"]
        .iter()
        .flat_map(|arm| (0..30).map(move |seed| format!("lift,{seed},{arm},{}\n", u8::from(seed % 3 > 0))))
        .collect();
    let folder = Folder::new("audit-arms");
    let path = folder.join("t");
    fs::write(&path, format!("task,seed,perturbation,success\n{rows}")).unwrap();
    let mut mapping = Mapping::default();
    assert_eq!(audit(&path, None, &mapping).unwrap().found(), 2, "no column names the arm");
    mapping.add("case=task,seed=seed,category=perturbation", "--map").unwrap();
    let checked = audit(&path, None, &mapping).unwrap();
    assert_eq!(checked.found(), 0, "{:?}", checked.checks);
}

#[test]
fn tiny_environments_do_not_hide_a_dependence() {
    // Of four environments with 100 episodes each, one fails more often. A fifth has two episodes.
    let rate = |env: u64| if env == 3 { 25 } else { 75 };
    let row = |i: u64, env: u64| format!("{env},{i},{}\n", u8::from(mixed(i) % 100 < rate(env)));
    let rows: String = (0..400).map(|i| row(i, i % 4)).chain((400..402).map(|i| row(i, 9))).collect();
    let audit = of_text("tiny", &format!("env_id,seed,success\n{rows}"));
    let found = problems(&audit, Check::BatchArtefacts);
    assert!(found.iter().any(|problem| problem.what.starts_with("Success depends on the environment")), "{found:?}");
    // Nothing is left if all are tiny.
    let rows: String = (0..12).map(|i| row(i, i % 6)).collect();
    let audit = of_text("all-tiny", &format!("env_id,seed,success\n{rows}"));
    let left = result(&audit, Check::BatchArtefacts);
    assert!(matches!(left, CheckResult::NotPossible { .. }), "{left:?}");
}

/// A number without a pattern.
fn mixed(i: u64) -> u64 {
    let step = |x: u64| (x ^ (x >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    step(step(step((i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)))) >> 33
}

/// Three policies on the same scenarios with the same five seeds. Scenarios and policies have their own rates.
fn benchmark(scenario: impl Fn(u64) -> String) -> String {
    let mut text = String::from("policy_id,scenario_id,mass,seed,success\n");
    for (at, policy) in ["act", "pi0", "smolvla"].iter().enumerate() {
        for i in 0..40_u64 {
            for seed in 0..5_u64 {
                let success = mixed((at as u64 * 40 + i) * 5 + seed) % 100 < 20 + 25 * at as u64 + 3 * (i % 10);
                text += &format!("{policy},{},{}.5,{seed},{}\n", scenario(i), i % 8, u8::from(success));
            }
        }
    }
    text
}

#[test]
fn designs_are_no_artefacts() {
    // Scenarios in cycles of eight: a position in a batch of eight rows is one of them.
    for scenario in [|i: u64| format!("s{i}"), |i: u64| format!("{}", i % 8)] {
        let audit = of_text("design", &benchmark(scenario));
        assert!(problems(&audit, Check::BatchArtefacts).is_empty(), "{:?}", result(&audit, Check::BatchArtefacts));
    }
    let audit = of_text("design-seeds", &benchmark(|i| format!("s{i}")));
    for check in [Check::RepeatedSeeds, Check::DuplicateInitialStates, Check::DuplicateRows] {
        assert!(matches!(result(&audit, check), CheckResult::Clear { .. }), "{:?}", result(&audit, check));
    }
    // The same rows once more are still found.
    let text = benchmark(|i| format!("s{i}"));
    let (head, rows) = text.split_once('\n').unwrap();
    let twice = of_text("design-twice", &format!("{head}\n{rows}{rows}"));
    assert_eq!(problems(&twice, Check::RepeatedSeeds)[0].count, 600);
    assert_eq!(problems(&twice, Check::DuplicateRows)[0].count, 600);
}

#[test]
fn batch_effects_are_found_within_scenarios() {
    // Every fourth position fails more often, in each of 50 scenarios.
    let rows: String = (0..400_u64)
        .map(|i| {
            let rate = if i % 4 == 3 { 25 } else { 75 };
            format!("s{},{},{}\n", i / 8, i, u8::from(mixed(i) % 100 < rate))
        })
        .collect();
    let audit = of_text("within", &format!("scenario,seed,success\n{rows}"));
    let found = problems(&audit, Check::BatchArtefacts);
    assert!(found[0].what.contains("position in a batch of 4 rows"), "{found:?}");
}
