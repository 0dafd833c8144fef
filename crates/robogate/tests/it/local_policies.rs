//! End-to-end tests of policies other than the scripted controller: networks in files, the random policy, and
//! demonstrations of failed episodes.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{assert_done, assert_exit_in, robogate_in, stdout};

const PLAN: &str = "seed = 5\n[uniform]\nepisodes = 6\n";
const ONE_EPISODE: &str = "seed = 5\n[uniform]\nepisodes = 1\n";

fn networks() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/tests/networks")
}

/// Creates a folder with the plan and the small network.
fn folder_with_network() -> TempDir {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("plan.toml"), PLAN).unwrap();
    for file in ["small.onnx", "small.toml"] {
        fs::copy(networks().join(file), dir.path().join(file)).unwrap();
    }
    dir
}

const RUN: [&str; 6] = ["run", "--space", "learned", "--plan", "plan.toml", "--json"];

/// Reads a run's summary.
fn run(dir: &Path, more: &[&str]) -> Value {
    let output = robogate_in(dir, &[&RUN, more].concat());
    assert_done(&output);
    serde_json::from_str::<Value>(&stdout(&output)).unwrap()["summary"].take()
}

#[test]
fn moved_policy_runs_shards() {
    let dir = folder_with_network();
    fs::write(dir.path().join("plan.toml"), ONE_EPISODE).unwrap();
    let run =
        |more: &[&str], code, parts: &[&str]| assert_exit_in(dir.path(), &[&RUN[..5], more].concat(), code, parts);
    run(&["--policy", "small.onnx", "--profile", "small.toml", "--divide", "1", "--out", "r"], 0, &[]);
    fs::rename(dir.path().join("small.onnx"), dir.path().join("moved.onnx")).unwrap();
    let shard = ["run", "--shard", "0/1", "--out", "r"];
    assert_exit_in(dir.path(), &shard, 2, &["small.onnx"]);
    assert_exit_in(dir.path(), &[&shard[..], &["--policy-at", "moved.onnx"]].concat(), 0, &["shard 0/1"]);
    assert_exit_in(dir.path(), &["merge", "r"], 0, &["dataset"]);
    let plan = fs::read_to_string(dir.path().join("r/plan.json")).unwrap();
    assert!(plan.contains("small.onnx") && !plan.contains("moved.onnx"));
}

#[test]
fn replay_works_from_another_folder() {
    let dir = folder_with_network();
    fs::write(dir.path().join("plan.toml"), ONE_EPISODE).unwrap();
    run(dir.path(), &["--policy", "small.onnx", "--profile", "small.toml", "--out", "r"]);
    let elsewhere = TempDir::new().unwrap();
    let r = dir.path().join("r");
    assert_exit_in(
        elsewhere.path(),
        &["replay", r.to_str().unwrap(), "0"],
        0,
        &["identical to the recorded episode, bit for bit"],
    );
}

#[test]
fn random_policy_ignores_thread_count() {
    let dir = folder_with_network();
    let one = run(dir.path(), &["--policy", "random", "--threads", "1", "--out", "one"]);
    let two = run(dir.path(), &["--policy", "random", "--threads", "2", "--out", "two"]);
    let hash = |summary: &Value| summary["dataset_hash"].as_str().map(str::to_owned);
    assert!(hash(&one).is_some(), "{one}");
    assert_eq!(hash(&one), hash(&two));
    assert_exit_in(dir.path(), &["replay", "one", "3"], 0, &["identical to the recorded episode, bit for bit"]);
}

#[test]
fn recurrent_policies_ignore_thread_count() {
    let dir = folder_with_network();
    fs::write(dir.path().join("plan.toml"), "seed = 5\n[uniform]\nepisodes = 3\n").unwrap();
    for name in ["gru", "history"] {
        for kind in ["onnx", "toml"] {
            let file = format!("{name}.{kind}");
            fs::copy(networks().join(&file), dir.path().join(file)).unwrap();
        }
        let (network, profile) = (format!("{name}.onnx"), format!("{name}.toml"));
        let hash = |threads: &str| {
            let out = format!("{name}-{threads}");
            let more = ["--policy", &network, "--profile", &profile, "--threads", threads, "--out", &out];
            run(dir.path(), &more)["dataset_hash"].as_str().map(str::to_owned)
        };
        let one = hash("1");
        assert!(one.is_some());
        assert_eq!(one, hash("3"), "{name}");
        let recorded = format!("{name}-3");
        assert_exit_in(dir.path(), &["replay", &recorded, "2"], 0, &["identical to the recorded episode, bit for bit"]);
    }
    let check = ["policy", "check", "gru.onnx", "--profile", "gru.toml", "--requests", "3"];
    assert_exit_in(dir.path(), &check, 0, &["h0 is fed by h1", "zero at the start of each episode"]);
    let check = ["policy", "check", "history.onnx", "--profile", "history.toml", "--requests", "3"];
    assert_exit_in(dir.path(), &check, 0, &["front: -1, 0; state: -2, -1, 0"]);
}

/// The statistics of a checkpoint make a run count the states outside of their range.
#[test]
fn states_outside_ranges_are_counted() {
    let dir = folder_with_network();
    fs::write(dir.path().join("plan.toml"), "seed = 5\n[uniform]\nepisodes = 2\n").unwrap();
    let (low, high) = (vec![-0.01; 8], vec![0.01; 8]);
    let statistics = serde_json::json!({"observation.state": {"min": low, "max": high}}).to_string();
    fs::write(dir.path().join("stats.json"), statistics).unwrap();
    let policy = ["--policy", "small.onnx", "--profile", "small.toml"];
    let ranged = [&policy[..], &["--statistics", "stats.json"]].concat();
    let hash = |threads: &str| {
        let summary = run(dir.path(), &[&ranged[..], &["--threads", threads, "--out", threads]].concat());
        let outside = &summary["outside_range"];
        assert_eq!((&outside["episodes"], &outside["of"]), (&2.into(), &2.into()), "{summary}");
        assert!(outside["numbers"][0]["number"].as_str().unwrap().contains("state."), "{summary}");
        summary["dataset_hash"].clone()
    };
    assert_eq!(hash("1"), hash("3"));
    assert_exit_in(dir.path(), &["replay", "3", "1"], 0, &["identical to the recorded episode, bit for bit"]);
    let analysis = stdout(&robogate_in(dir.path(), &["analyze", "3", "--json"]));
    assert!(analysis.contains("outside_range.") && analysis.contains("\"of\": 2"), "{analysis}");
    let report = ["report", "3"];
    assert_exit_in(dir.path(), &report, 0, &[]);
    let page = fs::read_to_string(dir.path().join("3/report.html")).unwrap();
    assert!(page.contains("outside of the published range of the checkpoint in 2 of 2 episodes"));
    let wrong = [&RUN[..], &["--policy", "random", "--statistics", "stats.json"]].concat();
    assert_exit_in(dir.path(), &wrong, 2, &["--statistics applies to a policy server or an ONNX file"]);
}

const ONE_SCENARIO: &str = r#"
schema = 1
name = "one"
version = "1.0.0"
description = "One box."
defaults = { shape = "box", size_m = 0.05, mass_kg = 0.3 }
[[group]]
name = "nominal"
category = "nominal"
scenarios = [{ id = "nominal-1" }]
"#;

/// A gate names the states outside of the range on its page, in its Markdown, and in the evidence.
#[test]
fn outside_ranges_reach_the_evidence() {
    let dir = folder_with_network();
    let at = |name: &str| dir.path().join(name);
    let statistics = serde_json::json!({"observation.state": {"min": vec![-0.01; 8], "max": vec![0.01; 8]}});
    fs::write(at("stats.json"), statistics.to_string()).unwrap();
    fs::write(at("suite.toml"), ONE_SCENARIO).unwrap();
    let requirements = "name = \"one\"\nmode = \"point\"\n[budget]\nrounds = 2\n[[requirement]]\nmetric = \"success\"\nat_least = 0.9\n";
    fs::write(at("gate.toml"), requirements).unwrap();
    let gate = "gate --policy small.onnx --profile small.toml --statistics stats.json --controls 0 --suite suite.toml --requirements \
                gate.toml --seed 7 --out gate";
    let sentence = "outside of the published range of the checkpoint in 2 of 2 episodes";
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let printed = assert_exit_in(dir.path(), &gate.split(' ').collect::<Vec<_>>(), 1, &[]);
    assert!(words(&printed).contains(sentence), "{printed}");
    for file in ["gate/gate.md", "gate/report.html"] {
        let page = fs::read_to_string(at(file)).unwrap();
        assert!(words(&page).contains(sentence), "{file}: {page}");
    }
    let evaluation = |file: &str| -> Value { serde_json::from_slice(&fs::read(at(file)).unwrap()).unwrap() };
    let outside = evaluation("gate/gate.json")["outside_range"].take();
    assert_eq!((&outside["episodes"], &outside["of"]), (&2.into(), &2.into()), "{outside}");
    assert_exit_in(dir.path(), &["evidence", "gate", "evidence", "--compliance"], 1, &[]);
    assert_eq!(evaluation("evidence/evaluation.json")["outside_range"], outside);
    let filed = words(&fs::read_to_string(at("evidence/compliance/verdict.html")).unwrap());
    assert!(filed.contains(sentence), "{filed}");
    // Another number of episodes is not that of the rows.
    assert_exit_in(dir.path(), &["verify", "evidence"], 0, &[]);
    let file = at("evidence/evaluation.json");
    let forged = fs::read_to_string(&file).unwrap().replacen("\"outside_range\"", "\"inside_range\"", 1);
    fs::write(&file, forged).unwrap();
    assert_exit_in(dir.path(), &["verify", "evidence"], 4, &["evaluation.json"]);
}

#[test]
fn wrong_policies_are_explained() {
    let dir = folder_with_network();
    let bad: [(&[&str], &[&str]); 8] = [
        (&["--policy", "small.onnx"], &["--profile is missing", "robogate list profiles"]),
        (&["--policy", "octo"], &["octo: not a policy", "an ONNX file, `random` or `scripted`"]),
        (&["--policy", "missing.onnx"], &["missing.onnx: no such file"]),
        (&["--policy", "scripted", "--profile", "learned"], &["--profile cannot be used with --policy scripted"]),
        (&["--policy", "small.onnx", "--profile", "octo"], &["--profile octo: unknown profile", "octo-small"]),
        (&["--policy", "random", "--profile", "learned"], &["--profile cannot be used with --policy random"]),
        (&["--policy", "missing.onnx", "--profile", "small.toml"], &["missing.onnx", "cannot be read"]),
        (
            &["--policy", "plan.toml", "--profile", "small.toml"],
            &["plan.toml: it is a text file. Expected an ONNX model"],
        ),
    ];
    for (more, parts) in bad {
        assert_exit_in(dir.path(), &[&RUN, more].concat(), 2, parts);
    }
}

#[test]
fn failed_episodes_are_demonstrated() {
    let dir = folder_with_network();
    run(dir.path(), &["--policy", "random", "--out", "r"]);
    let demos = ["demos", "--failed-in", "r", "-n", "8", "--size", "16", "--push", "0", "--out", "d", "--json"];
    let output: Value = serde_json::from_str(&stdout(&robogate_in(dir.path(), &demos))).unwrap();
    // The run has six failures, so the first two are demonstrated twice.
    assert_eq!((&output["episodes"], &output["failed"]), (&8.into(), &0.into()), "{output}");
    assert_exit_in(
        dir.path(),
        &["demos", "--failed-in", "plan.toml", "--out", "e"],
        2,
        &["plan.toml: not a finished run"],
    );
    assert!(!dir.path().join("e").exists());
    run(dir.path(), &["--out", "good"]);
    assert_exit_in(
        dir.path(),
        &["demos", "--failed-in", "good", "--out", "e"],
        2,
        &["good: the run has no failed episode"],
    );
    assert!(!dir.path().join("e").exists());
}

#[test]
fn shipped_networks_pick_and_place() {
    let dir = folder_with_network();
    let policies = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/policies");
    for name in ["learned", "learned-wide"] {
        let file = policies.join(format!("{name}.onnx"));
        let summary = run(dir.path(), &["--policy", file.to_str().unwrap(), "--profile", "learned", "--out", name]);
        let succeeded = summary["stages"][0]["successes"].as_u64();
        assert!(succeeded.is_some_and(|n| n >= 5), "{name}: {succeeded:?} of 6: {summary}");
    }
}
