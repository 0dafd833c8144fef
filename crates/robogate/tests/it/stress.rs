//! Stress in transit: `--stress` varies what a policy receives and what the robot executes, for any task.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use crate::harness::verb;

#[expect(clippy::unwrap_used, reason = "a test fails by panicking")]
fn rows(at: &Path, run: &str) -> String {
    verb(at, &format!("export {run} {run}.csv"), 0, &[]);
    fs::read_to_string(at.join(format!("{run}.csv"))).unwrap()
}

#[test]
fn every_task_runs_under_stress() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    for task in ["pick_place", "stacking", "pendulum"] {
        let run = |out: &str, threads: u32| {
            let stress = "--stress state_bias,delayed_action --set time_limit_s=3";
            verb(
                at,
                &format!("run --task {task} {stress} -n 4 --design uniform --threads {threads} --out {out}"),
                0,
                &[],
            );
            fs::read(at.join(out).join("dictionary.parquet")).unwrap()
        };
        assert!(run(&format!("{task}1"), 1) == run(&format!("{task}2"), 2), "{task}: threads change the bytes");
        let rows = rows(at, &format!("{task}1"));
        assert!(rows.lines().next().unwrap().contains("transit_delayed_action"), "{task}: {rows}");
        verb(at, &format!("replay {task}1 2"), 0, &["identical to the recorded episode"]);
        verb(at, &format!("resume {task}2"), 0, &[]);
    }
}

/// A policy that sees fails when its images are covered, and not when they have a little noise.
#[test]
#[cfg(feature = "onnx")]
fn learned_policy_fails_behind_a_cover() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let run = |out: &str, low: f64, high: f64| {
        let space = format!(
            "name = \"covered\"\n[[parameter]]\nname = \"transit_brightness\"\nkind = \"continuous\"\nlow = {low:?}\nhigh = {high:?}\n"
        );
        fs::write(at.join("covered.toml"), space).unwrap();
        let policy = format!("--policy {root}/assets/policies/learned.onnx --profile learned --stress brightness");
        verb(at, &format!("run {policy} --space covered.toml -n 6 --design uniform --out {out}"), 0, &[]);
        rows(at, out).matches(",success,").count()
    };
    let (bright, dark) = (run("near", -0.5, 0.5), run("far", -120.0, -119.0));
    assert!(bright >= 4 && dark <= 1, "{bright} of 6 under nominal conditions, {dark} of 6 in the dark");
}

#[test]
fn words_of_stress_are_checked() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let run = "run -n 2 --design uniform --out no";
    verb(at, &format!("{run} --stress images,nose"), 2, &["--stress nose: unknown", "noise"]);
    verb(at, &format!("{run} --wordings words.txt"), 2, &["--wordings has no effect without --stress"]);
    verb(at, &format!("{run} --stress wording"), 2, &["Hint: name a file with --wordings"]);
    verb(at, &format!("{run} --stress language --wordings absent.txt"), 2, &["absent.txt"]);
    fs::write(at.join("words.txt"), "x".repeat(1001)).unwrap();
    verb(at, &format!("{run} --stress language --wordings words.txt"), 2, &["a wording of 1001 characters"]);
    verb(at, "run --suite stacking --task stacking --stress state -n 2 --out no", 2, &[]);
    verb(at, "run --task pendulum --stress images -n 2 --out no", 2, &["no cameras"]);
    let space = "name = \"s\"\n[[parameter]]\nname = \"transit_noise\"\nkind = \"continuous\"\nlow = 0.0\nhigh = 9.0\n";
    fs::write(at.join("s.toml"), space).unwrap();
    verb(at, "run --space s.toml -n 2 --out no", 2, &["needs the option --stress"]);
    verb(at, "run --space s.toml --stress blur_px -n 2 --out no", 2, &["`transit_noise` is not one of --stress"]);
    fs::write(at.join("words.txt"), "put it there\n").unwrap();
    verb(at, &format!("{run} --stress state --wordings words.txt"), 2, &["--wordings has no effect"]);
    // The scenarios of a suite are fixed, for a fleet and a gate too.
    verb(at, "fleet --units 2 --stress state --out no", 2, &["the scenarios of a suite are fixed"]);
    verb(at, "gate --stress state --out no", 2, &["the scenarios of a suite are fixed"]);
    assert!(!at.join("no").exists());
}

/// The units of a fleet have the scenarios of the stress.
#[test]
fn fleets_run_under_stress() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "fleet --units 2 --space cell --stress delayed_action --rounds 1 --out fleet", 0, &[]);
    let plan = fs::read_to_string(at.join("fleet/fleet.json")).unwrap_or_else(|_| {
        let files: Vec<_> = fs::read_dir(at.join("fleet")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        panic!("{files:?}")
    });
    assert!(plan.matches("transit_delayed_action").count() > 20, "scenarios without the parameter");
}
