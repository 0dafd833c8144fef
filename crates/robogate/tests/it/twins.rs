//! End-to-end tests of the control arm: nominal twins of a campaign, of a suite, in shards, and imported.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{kill_after, kill_at_size, run_all_shards, verb};

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Name and number of pairs of a family.
fn named_pairs(family: &Value) -> (&str, u64) {
    (family["family"].as_str().unwrap(), family["pairs"].as_u64().unwrap())
}

const RUN: &str = "run --task pendulum --design two-stage -n 90 --seed 3 --twins";

/// The files that a control arm adds or changes.
const FILES: [&str; 7] = [
    "twins.json",
    "nominal/dictionary.parquet",
    "nominal/plan.json",
    "families/dictionary.parquet",
    "families/plan.json",
    "dictionary.parquet",
    "summary.json",
];

fn same_files(dir: &Path, a: &str, b: &str) {
    for file in FILES {
        let [a, b] = [a, b].map(|name| fs::read(dir.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }
}

#[test]
fn twins_do_not_depend_on_threads_shards_or_interruptions() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, &format!("{RUN} --threads 2 --out a"), 0, &["60 nominal twins", "Control arm", "60 pairs"]);
    verb(at, &format!("{RUN} --threads 1 --out b"), 0, &[]);
    same_files(at, "a", "b");
    let twins = json(&at.join("a/twins.json"));
    assert_eq!((twins["pairs"].as_u64(), twins["unpaired"].as_u64()), (Some(60), Some(0)));
    // Each episode also ran with one of the task's families. The effects of these stand beside that of all together.
    let families: Vec<(&str, u64)> = twins["families"].as_array().unwrap().iter().map(named_pairs).collect();
    let expected = [("all perturbations together", 60), ("pole", 15), ("drive", 15), ("start", 15), ("encoder", 15)];
    assert_eq!((families, twins["one_family"].as_u64()), (expected.to_vec(), Some(60)));
    // The campaign itself is the same with and without a control arm.
    verb(at, "run --task pendulum --design two-stage -n 90 --seed 3 --out plain", 0, &[]);
    let rows = |name: &str| json(&at.join(name).join("summary.json"))["dataset_hash"].clone();
    assert_eq!(rows("a"), rows("plain"));

    // Killed in each arm, then resumed.
    for (cut, arm) in [("cut-nominal", "control arm: "), ("cut-families", "arm of one family each: ")] {
        kill_after(at, &format!("{RUN} --threads 1 --out {cut}"), [cut, "twins.json"], |line| line.contains(arm));
        assert!(!at.join(cut).join("twins.json").exists(), "the arm was not interrupted");
        verb(at, &format!("resume {cut}"), 0, &["Control arm"]);
        same_files(at, "a", cut);
    }

    verb(at, &format!("{RUN} --divide 2 --out run"), 0, &[]);
    run_all_shards(at, "run");
    verb(at, "merge run", 0, &["the control arm is incomplete", "robogate plan run/nominal --next"]);
    run_all_shards(at, "run/nominal");
    verb(at, "merge run", 0, &["Control arm", "the arm of one family each is incomplete"]);
    run_all_shards(at, "run/families");
    verb(at, "merge run", 0, &["Control arm", "encoder"]);
    for file in ["twins.json", "nominal/dictionary.parquet", "families/dictionary.parquet"] {
        let [a, b] = ["a", "run"].map(|name| fs::read(at.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }
    assert!(fs::read_to_string(at.join("run/report.html")).unwrap().contains("Control arm"));
    verb(at, "analyze a", 0, &["Control arm"]);
    let report = verb(at, "report a --format json --out -", 0, &[]);
    assert_eq!(serde_json::from_str::<Value>(&report).unwrap()["twins"], twins);
}

#[test]
fn active_rounds_have_twins() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "run --task pendulum --design active -n 80 --seed 3 --twins --out a", 0, &["80 nominal twins"]);
    let twins = json(&at.join("a/twins.json"));
    // The first 20 episodes, and half of the others: the rest was chosen by a model.
    assert!(twins["pairs"].as_u64() > Some(40) && twins["unpaired"].as_u64() == Some(0), "{twins}");
}

#[test]
fn families_have_effects_of_their_own() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let families = "--family motor=torque_limit_nm --family pole=mass_kg,len*";
    verb(at, &format!("run --task pendulum {families} -n 60 --seed 3 --out f"), 0, &["Control arm", "motor", "pole"]);
    let twins = json(&at.join("f/twins.json"));
    for (family, name) in ["motor", "pole"].iter().enumerate() {
        let of = &twins["families"][family];
        assert_eq!((of["family"].as_str(), of["pairs"].as_u64()), (Some(*name), Some(30)), "{twins}");
    }
    verb(at, "run --task pendulum --family each -n 12 --seed 3 --out e", 0, &["6 scenarios"]);
    verb(at, "run --task pendulum --family declared -n 12 --seed 3 --out d", 0, &["4 scenarios", "encoder"]);
    for (wrong, says) in [
        ("motor=torque", "has no parameter `torque`"),
        ("motor", "expected NAME=PARAMETER"),
        ("a=mass_kg --family b=mass*", "`mass_kg` is in the family a too"),
    ] {
        verb(at, &format!("run --task pendulum --family {wrong} --out x"), 2, &[says]);
    }
}

const SUITE: &str = r#"
schema = 1
name = "benches"
version = "1.0.0"
description = "Pendulums with a weak motor, and with a slightly heavier pole."
nominal = true
defaults = { mass_kg = 0.5, torque_limit_nm = 0.5, start_rad = 0.0 }
[[group]]
name = "usual"
category = "nominal"
scenarios = [{ id = "usual-1" }]
[[group]]
name = "weak_motor"
category = "motor"
scenarios = [{ id = "weak-1", torque_limit_nm = 0.05 }, { id = "weak-2", torque_limit_nm = 0.06 }, { id = "weak-3", torque_limit_nm = 0.07 }]
[[group]]
name = "heavier"
category = "pole"
scenarios = [{ id = "heavier-1", mass_kg = 0.51 }]
"#;

const REQUIREMENTS: &str = r#"
name = "test"
mode = "confidence"
confidence = 0.75
[budget]
rounds = 40
[[requirement]]
metric = "success"
at_least = 0.9
"#;

#[test]
fn gate_states_the_effect_of_each_group() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("suite.toml"), SUITE).unwrap();
    fs::write(at.join("gate.toml"), REQUIREMENTS).unwrap();
    verb(
        at,
        "gate --task pendulum --suite suite.toml --rounds 12 --fixed --requirements gate.toml --out g",
        1,
        &["Control arm", "motor/weak_motor"],
    );
    let verdict = json(&at.join("g/gate.json"));
    let twins = &verdict["twins"];
    assert_eq!((twins["pairs"].as_u64(), twins["unperturbed"].as_u64()), (Some(48), Some(12)));
    let effect = |family: &str| {
        let families = twins["families"].as_array().unwrap();
        families.iter().find(|of| of["family"] == family).unwrap()["effect"].clone()
    };
    assert_eq!(effect("motor/weak_motor"), "harmful");
    assert_eq!(effect("pole/heavier"), "not_significant");
    assert!(fs::read_to_string(at.join("g/gate.md")).unwrap().contains("Control arm"));
    // The verdict and its evidence do not depend on the arm.
    verb(at, "gate --run g", 1, &["Control arm"]);
    verb(at, "evidence g evidence", 1, &[]);
    verb(at, "verify evidence", 0, &[]);
}

#[test]
fn gate_judges_families_one_at_a_time() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("gate.toml"), REQUIREMENTS).unwrap();
    let gate = "gate --task pendulum --requirements gate.toml --fixed --rounds 1";
    // About 64 scenarios: 16 for each of the four declared families.
    verb(at, &format!("{gate} --family declared --out g"), 1, &["Control arm", "pole", "encoder"]);
    let twins = json(&at.join("g/gate.json"))["twins"].clone();
    let families: Vec<(&str, u64)> = twins["families"].as_array().unwrap().iter().map(named_pairs).collect();
    assert_eq!(families, [("pole", 16), ("drive", 16), ("start", 16), ("encoder", 16)]);
    // A suite that is sampled from the space perturbs all families at once. Each scenario also runs with one of them.
    verb(at, &format!("{gate} --twins --out t"), 1, &["Control arm", "all perturbations together", "encoder"]);
    let twins = json(&at.join("t/gate.json"))["twins"].clone();
    let families: Vec<(&str, u64)> = twins["families"].as_array().unwrap().iter().map(named_pairs).collect();
    let expected = [("all perturbations together", 64), ("pole", 16), ("drive", 16), ("start", 16), ("encoder", 16)];
    assert_eq!(families, expected);
    verb(at, &format!("{gate} --family each --suite suite.toml --out x"), 2, &["--family", "--suite"]);
    verb(at, &format!("{gate} --family motor=torque --out x"), 2, &["has no parameter `torque`"]);
}

#[test]
fn interrupted_comparison_resumes_identically() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("suite.toml"), SUITE.replace("nominal = true\n", "")).unwrap();
    fs::write(at.join("gate.toml"), REQUIREMENTS).unwrap();
    let gate = |out: &str| {
        format!(
            "gate --task pendulum --suite suite.toml --rounds 40 --fixed --requirements gate.toml --against random --threads 1 --out {out}"
        )
    };
    let output = |out: &str| verb(at, &gate(out), 1, &["not worse than random"]);
    output("whole");
    // Both policies have episodes.
    kill_at_size(at, &gate("cut"), ["cut", "against.parquet"], "against.rgj", 2_000);
    let journal = at.join("cut/against.rgj");
    assert!(journal.exists() && !at.join("cut/against.parquet").exists(), "the gate was not interrupted");
    verb(at, "resume cut", 1, &["not worse than random"]);
    assert!(!journal.exists() && !at.join("cut/against.json").exists());
    for file in ["against.parquet", "dictionary.parquet"] {
        let [a, b] = ["whole", "cut"].map(|name| fs::read(at.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }
    // The finished gate is evaluated again from its files.
    verb(at, "gate --run cut", 1, &["not worse than random"]);
}

#[test]
fn imported_arms_are_paired() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let mut rows = "task,seed,perturbation,success\n".to_owned();
    for seed in 0..40 {
        let camera = u8::from(seed % 2 == 0);
        rows += &format!("lift,{seed},none,1\nlift,{seed},camera,{camera}\nlift,{seed},light,1\n");
    }
    fs::write(at.join("results.csv"), rows).unwrap();
    verb(
        at,
        "import results.csv results.parquet --map case=task,seed=seed,category=perturbation --stopping fixed",
        0,
        &[],
    );
    verb(
        at,
        "analyze results.parquet --nominal category=none",
        0,
        &["Shown to lower the success rate: camera.", "20 fail with it only"],
    );
    verb(at, "analyze results.parquet --nominal category=other", 2, &["no row has `category` = `other`"]);
}
