//! End-to-end tests of `run --prior`: a campaign that starts from the risk model of an earlier one.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{kill_at_size, run_all_shards, verb};

/// The campaign whose model is the prior.
const OLD: &str = "run --task pendulum -n 160 --seed 3 --out old";
/// The campaign that starts from it.
const NEW: &str = "run --task pendulum -n 80 --seed 4 --prior old";
/// What depends on the prior.
const FILES: [&str; 5] = ["dictionary.parquet", "active.json", "prior.json", "plan.json", "summary.json"];

#[track_caller]
fn same_files(dir: &Path, a: &str, b: &str) {
    for file in FILES {
        let [a, b] = [a, b].map(|name| fs::read(dir.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }
}

/// A copy of the files of a folder.
fn copy(dir: &Path, from: &str, to: &str) {
    fs::create_dir(dir.join(to)).unwrap();
    for entry in fs::read_dir(dir.join(from)).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_file() {
            fs::copy(entry.path(), dir.join(to).join(entry.file_name())).unwrap();
        }
    }
}

#[test]
fn prior_gives_the_same_bytes_for_any_execution() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, OLD, 0, &[]);
    verb(at, &format!("{NEW} --threads 2 --out a"), 0, &["prior: scripted policy on", "the prior"]);
    verb(at, &format!("{NEW} --threads 1 --out b"), 0, &[]);
    same_files(at, "a", "b");
    // The prior matters: without it, other points are chosen.
    verb(at, &format!("{} --out without", NEW.replace(" --prior old", "")), 0, &[]);
    let [with, without] = ["a", "without"].map(|name| fs::read(at.join(name).join("dictionary.parquet")).unwrap());
    assert!(with != without);

    // Killed, and resumed without the folder of the earlier run.
    kill_at_size(at, &format!("{NEW} --threads 1 --out cut"), ["cut", "dictionary.parquet"], "journal.rgj", 6_000);
    assert!(at.join("cut/journal.rgj").exists(), "the campaign was not interrupted");
    copy(at, "cut", "changed");
    verb(at, &format!("{NEW} --divide 2 --out run"), 0, &[]);
    fs::rename(at.join("old"), at.join("gone")).unwrap();
    verb(at, "resume cut", 0, &[]);
    same_files(at, "a", "cut");

    // In shards. The files are those of one machine.
    run_all_shards(at, "run");
    verb(at, "merge run", 0, &["the prior"]);
    for file in ["dictionary.parquet", "active.json"] {
        let [a, b] = ["a", "run"].map(|name| fs::read(at.join(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }

    // A changed prior is refused.
    let path = at.join("changed/prior.json");
    let mut prior: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    prior["seed"] = 99.into();
    fs::write(&path, serde_json::to_vec(&prior).unwrap()).unwrap();
    verb(at, "resume changed", 2, &["another prior"]);
}

/// A space of two of the pendulum's parameters.
const SMALL: &str = r#"
name = "small"
[[parameter]]
name = "torque_limit_nm"
kind = "continuous"
low = 0.1
high = 1.0
[[parameter]]
name = "mass_kg"
kind = "continuous"
low = 0.2
high = 1.2
"#;

#[test]
fn unusable_priors_are_refused() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("small.toml"), SMALL).unwrap();
    verb(at, OLD, 0, &[]);
    let refused = |line: &str, parts: &[&str]| {
        verb(at, line, 2, parts);
        assert!(!at.join("x").exists(), "{line} wrote files");
    };
    // The new space needs all parameters of the prior. The other way round, the prior knows less than the new campaign.
    refused(
        "run --task pendulum --space small.toml -n 80 --prior old --out x",
        &["--prior old", "which is not a parameter of this run", "hint"],
    );
    verb(at, "run --task pendulum --space small.toml -n 80 --seed 5 --out less", 0, &[]);
    verb(at, "run --task pendulum -n 80 --seed 4 --prior less --out more", 0, &["the prior"]);
    refused("run --task stacking -n 80 --prior old --out x", &["its task is pendulum. Expected stacking"]);
    refused(
        "run --task pendulum --design uniform -n 80 --prior old --out x",
        &["--prior applies to the active design"],
    );
    verb(at, "run --task pendulum -n 8 --seed 5 --out few", 0, &[]);
    refused("run --task pendulum -n 80 --prior few --out x", &["--prior few", "Expected at least"]);
    fs::write(at.join("rows.csv"), "mass_kg,success\n0.5,1\n0.6,0\n").unwrap();
    verb(at, "import rows.csv rows.parquet", 0, &[]);
    refused("run --task pendulum -n 80 --prior rows.parquet --out x", &["its episodes were imported", "hint"]);
    refused("run --task pendulum -n 80 --prior nothing --out x", &["nothing"]);
    // Another policy may start from it, and the run says whose model it is.
    verb(
        at,
        "run --task pendulum --policy random -n 40 --seed 4 --prior old --out random",
        0,
        &["prior: scripted policy on", "the prior"],
    );
}
