//! Tests of `robogate rank`: contests round by round, and rankings of finished results.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{kill_after, verb};

const SUITE: &str = r#"
schema = 1
name = "swing"
version = "1.0.0"
description = "Starts from which the controller reaches the top."
defaults = { mass_kg = 0.5, torque_limit_nm = 0.5, start_rad = 0.0 }
[[group]]
name = "starts"
category = "nominal"
scenarios = [{ id = "s-1" }, { id = "s-2", mass_kg = 0.45 }, { id = "s-3", start_rad = 0.1 }, { id = "s-4", start_rad = -0.1 }]
"#;

const CONTEST: &str = "rank scripted random random --task pendulum --suite suite.toml --rounds 12 --seed 3";

fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("suite.toml"), SUITE).unwrap();
    dir
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// The ranking of a contest without the paths of its runs.
fn answer(at: &Path, name: &str) -> Value {
    let mut ranking = json(&at.join(name).join("ranking.json"));
    for policy in ranking["policies"].as_array_mut().unwrap() {
        policy.as_object_mut().unwrap().remove("run");
    }
    ranking
}

#[test]
fn worse_policies_leave_early() {
    let dir = folder();
    let at = dir.path();
    let printed = verb(at, &format!("{CONTEST} --threads 2 --out a"), 0, &["random-2 leaves", "best set"]);
    assert!(printed.lines().count() <= 25 && printed.contains("scripted is the best of 3 policies"), "{printed}");
    let ranking = answer(at, "a");
    assert_eq!((ranking["format"].as_u64(), &ranking["best"]), (Some(1), &serde_json::json!(["scripted"])));
    let rounds = ranking["design"]["rounds"].as_u64().unwrap();
    assert!(rounds < 12, "{ranking:#}");
    for policy in &ranking["policies"].as_array().unwrap()[1..] {
        assert_eq!((policy["dropped"]["by"].as_str(), policy["successes"].as_u64()), (Some("scripted"), Some(0)));
        assert_eq!(policy["valid"].as_u64(), policy["dropped"]["round"].as_u64().map(|round| 4 * round));
    }
    let pairs = ranking["differences"].as_array().unwrap();
    assert!(pairs.len() == 3 && pairs[0]["interval_95"][0].as_f64().unwrap() > 0.0, "{pairs:?}");
    // Each policy has an ordinary run with exactly its rounds.
    let summary = json(&at.join("a/scripted/summary.json"));
    assert_eq!(summary["suite"]["rounds"].as_u64(), Some(rounds));
    verb(at, "compare a/scripted a/random", 0, &["scripted", "random"]);
    // The same command on the finished folder runs nothing and gives the same answer, as do other numbers of threads.
    let bytes = fs::read(at.join("a/scripted/dictionary.parquet")).unwrap();
    verb(at, &format!("{CONTEST} --threads 2 --out a"), 0, &[]);
    assert!(bytes == fs::read(at.join("a/scripted/dictionary.parquet")).unwrap());
    assert_eq!(verb(at, "rank a", 0, &[]), printed);
    verb(at, &format!("{CONTEST} --threads 1 --out b"), 0, &[]);
    assert_eq!((&ranking, &ranking), (&answer(at, "a"), &answer(at, "b")));
    // Another contest does not continue in this folder.
    verb(
        at,
        &format!("{} --out a", CONTEST.replace("seed 3", "seed 4")),
        2,
        &["another plan", "Hint: choose another --out"],
    );
}

#[test]
fn policies_are_ranked_by_the_stages_that_they_reach() {
    let dir = folder();
    let at = dir.path();
    let task = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks/button");
    let contest = format!(
        "rank scripted random --task {} --by stage --rounds 2 --controls 0 --threads 2 --out a",
        task.canonicalize().unwrap().display()
    );
    verb(at, &contest, 0, &["scripted is the best of 2 policies by the stages reached", "stages", "got further"]);
    let ranking = json(&at.join("a/ranking.json"));
    assert_eq!((&ranking["by"], &ranking["policies"][0]["name"]), (&"stage".into(), &"scripted".into()));
    let share = |at: usize| ranking["policies"][at]["stage"].as_f64().unwrap();
    assert!(share(0) > share(1) && share(0) >= ranking["policies"][0]["rate"].as_f64().unwrap(), "{ranking:#}");
    verb(at, contest.replace(" --by stage", "").as_str(), 2, &["by stage instead of success"]);
    verb(at, &format!("{CONTEST} --by stage --out b"), 2, &["the task pendulum declares no stages", "Hint: "]);
}

#[test]
fn interrupted_contest_continues() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{CONTEST} --out whole"), 0, &[]);
    let contest = format!("{CONTEST} --threads 1 --out cut");
    kill_after(at, &contest, ["cut", "ranking.json"], |line| line.starts_with("round 1:"));
    assert!(at.join("cut/scripted/plan.json").exists());
    verb(at, &format!("{CONTEST} --out cut"), 0, &["scripted is the best"]);
    assert_eq!(answer(at, "whole"), answer(at, "cut"));
}

#[test]
fn equal_policies_are_not_distinguished() {
    let dir = folder();
    let line =
        "rank random random --task pendulum --suite suite.toml --rounds 3 --names A,B --guarantee no-false-elimination";
    let printed = verb(dir.path(), &format!("{line} --out a --json"), 3, &[]);
    let ranking: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(ranking["best"], serde_json::json!(["A", "B"]));
    assert_eq!((ranking["guarantee"].as_str(), ranking["error"].as_f64()), (Some("no_false_elimination"), Some(0.05)));
}

#[test]
fn another_question_is_refused() {
    let dir = folder();
    let at = dir.path();
    let contest = "rank random random --task pendulum --suite suite.toml --rounds 2 --out a";
    verb(at, &format!("{contest} --names A,B"), 3, &[]);
    let question = json(&at.join("a/question.json"));
    assert_eq!((&question["policies"], question["error"].as_f64()), (&serde_json::json!(["A", "B"]), Some(0.05)));
    assert_eq!(question["guarantee"].as_str(), Some("best_stays"));
    let before = fs::read(at.join("a/ranking.json")).unwrap();
    for (options, part) in [
        ("--names B,A", "policies A,B instead of B,A"),
        ("--names A,B --error 0.1", "error 0.05 instead of 0.1"),
        ("--names A,B --guarantee no-false-elimination", "guarantee best-stays instead of no-false-elimination"),
    ] {
        verb(at, &format!("{contest} {options}"), 2, &["another question", part, "Hint: choose another --out"]);
    }
    fs::remove_file(at.join("a/question.json")).unwrap();
    verb(at, &format!("{contest} --names A,B"), 2, &["the question of their contest is missing"]);
    assert!(before == fs::read(at.join("a/ranking.json")).unwrap());
}

#[test]
fn options_without_effect_are_refused() {
    let dir = folder();
    let at = dir.path();
    results(at, 4, |_, _, _| false);
    let contest = "rank random random --task pendulum --suite suite.toml --rounds 1 --out a";
    verb(at, contest, 3, &[]);
    for options in ["--out b", "--plan", "--suite suite.toml", "--rounds 3", "--seed 4", "--env x:y", "--continue"] {
        let option = options.split(' ').next().unwrap();
        verb(at, &format!("rank results.csv {options}"), 2, &[option, "no effect on finished results", "Hint"]);
    }
    for options in ["--error 0.1", "--guarantee best-stays", "--names A,B", "--out b", "--html x.html"] {
        let option = options.split(' ').next().unwrap();
        verb(at, &format!("rank a {options}"), 2, &[option, "no effect on the answer of a finished contest"]);
    }
    verb(at, &format!("{contest} --continue"), 2, &["--continue has no effect"]);
    verb(at, &format!("{contest} --profile net.onnx=droid"), 2, &["net.onnx is not one of the policies", "Hint"]);
    verb(at, "rank a --json", 3, &["invalid_episodes"]);
}

#[test]
fn words_for_policies_come_before_files() {
    let dir = folder();
    fs::create_dir(dir.path().join("scripted")).unwrap();
    verb(dir.path(), &format!("{CONTEST} --plan"), 0, &["3 policies"]);
}

#[test]
fn plan_states_power_and_error() {
    let dir = folder();
    verb(dir.path(), &format!("{CONTEST} --plan --out x"), 2, &["--plan writes nothing", "Hint: "]);
    let document = verb(dir.path(), &format!("{CONTEST} --plan --json"), 0, &["\"best_dropped\""]);
    let document: serde_json::Value = serde_json::from_str(&document[document.find('{').unwrap()..]).unwrap();
    assert_eq!((document["policies"].as_u64(), document["at"][0]["best"].as_f64()), (Some(3), Some(0.9)));
    let printed = verb(dir.path(), &format!("{CONTEST} --plan"), 0, &["3 policies, at most 12 rounds of 4 scenarios"]);
    assert!(printed.contains("best dropped") && printed.contains("90.0 % and 2 of 60.0 %"), "{printed}");
    assert!(!dir.path().join("runs").exists());
}

#[test]
fn unusable_contests_are_refused() {
    let dir = folder();
    let at = dir.path();
    for (line, parts) in [
        ("rank scripted --task pendulum", ["one policy has no rank", "Hint"]),
        ("rank scripted random --task pendulum --names A", ["--names", "2 policies"]),
        ("rank scripted random --task pendulum --names ..,A", ["\"..\" cannot be the name of a policy", "Hint"]),
        ("rank scripted random --task pendulum --names A,question.json", ["\"question.json\" cannot be", "--names"]),
        ("rank scripted suite.toml --task pendulum", ["scripted is not a run or a results file", "Hint"]),
        ("rank scripted random --task pendulum --error 0.7", ["error probability of 0.7", "0.5"]),
        ("rank scripted random --task pendulum --html x.html", ["--html", "finished results"]),
    ] {
        verb(at, line, 2, &parts);
    }
}

/// A results file of three policies: scenarios with five seeds each. `fails` says whether an episode fails.
fn results(at: &Path, scenarios: u64, fails: impl Fn(&str, u64, u64) -> bool) {
    let mut rows = "policy_id,scenario,seed,success\n".to_owned();
    for policy in ["good", "other", "poor"] {
        for scenario in 0..scenarios {
            for seed in 0..5 {
                let _ = writeln!(rows, "{policy},s{scenario},{seed},{}", u8::from(!fails(policy, scenario, seed)));
            }
        }
    }
    fs::write(at.join("results.csv"), rows).unwrap();
}

#[test]
fn results_file_with_three_policies_is_ranked() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    results(at, 40, |policy, scenario, seed| match policy {
        "poor" => (scenario + seed) % 3 == 0,
        "good" => (scenario * 7 + seed * 3) % 29 == 0,
        _ => (scenario * 5 + seed * 11) % 31 == 0,
    });
    let printed = verb(at, "rank results.csv --html page.html", 3, &["2 of 3 policies", "paired by scenario and seed"]);
    let poor = printed.lines().find(|line| line.contains("poor ")).unwrap();
    assert!(poor.contains("is better") && printed.lines().count() <= 25, "{printed}");
    assert!(fs::read_to_string(at.join("page.html")).unwrap().contains("poor"));
    // The same rows as dictionaries.
    verb(at, "import results.csv all.parquet", 0, &["3 policies"]);
    let again = verb(at, "rank all-good.parquet all-other.parquet all-poor.parquet --json", 3, &[]);
    let best = serde_json::from_str::<Value>(&again).unwrap()["best"].clone();
    assert!(best.as_array().unwrap().len() == 2 && !best.to_string().contains("poor"), "{again}");
}

// A policy that fails in two of eight scenarios, with every seed: ten of forty pairs, but two of eight clusters.
#[test]
fn seeds_of_one_scenario_count_once() {
    let dir = TempDir::new().unwrap();
    results(dir.path(), 8, |policy, scenario, _| policy == "poor" && scenario < 2);
    verb(dir.path(), "rank results.csv", 3, &["3 of 3 policies cannot be distinguished", "8 clusters"]);
}
