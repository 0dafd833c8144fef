//! End-to-end tests of registration, evidence and its verification, as used on the command line.

use std::fs;
use std::path::Path;
use std::process::Command;

use robogate_campaign::Summary;
use robogate_core::{FailureMode, Fault, FaultKind, Outcome};
use robogate_dictionary::{Dictionary, Entry, write_parquet};
use tempfile::TempDir;

use crate::harness::assert_exit;

#[track_caller]
fn run(arguments: &[&str], code: i32) -> String {
    assert_exit(arguments, code, &[])
}

const SUITE: &str = r#"
schema = 1
name = "one"
version = "1.0.0"
description = "A part that the controller places, and one that no gripper holds."
defaults = { shape = "box", size_m = 0.05, mass_kg = 0.2, friction = 0.8, com_offset = 0.0, placement = "center_0", ik_noise_rad = 0.0, obstacles = 0 }
[[group]]
name = "easy"
category = "nominal"
scenarios = [{ id = "easy-1" }, { id = "hopeless-1", mass_kg = 2.0, friction = 0.05 }]
"#;

fn requirements(at_least: f64) -> String {
    format!(
        "name = \"test\"\nmode = \"confidence\"\nconfidence = 0.75\n[budget]\nrounds = 8\n[[requirement]]\nmetric = \"success\"\nat_least = {at_least}\n"
    )
}

/// The run of a gate that a scripted policy passes with half of its episodes.
struct Gate(TempDir);

impl Gate {
    fn new() -> Self {
        let gate = Self(TempDir::new().unwrap());
        fs::write(gate.path("suite.toml"), SUITE).unwrap();
        fs::write(gate.path("gate.toml"), requirements(0.1)).unwrap();
        fs::write(gate.path("strict.toml"), requirements(0.85)).unwrap();
        gate
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn run(&self, out: &str, code: i32, more: &[&str]) -> String {
        let (suite, out) = (self.path("suite.toml"), self.path(out));
        let requirements = self.path(if code == 0 { "gate.toml" } else { "strict.toml" });
        let first = ["gate", "--suite", &suite, "--requirements", &requirements, "--seed", "7", "--out", &out];
        run(&[&first[..], more].concat(), code)
    }
}

#[test]
fn registered_runs_are_verified_and_run_again() {
    let gate = Gate::new();
    let key = gate.path("k");
    run(&["keys", "new", &key], 0);
    run(&["keys", "new", &key], 2);
    run(&["keys", "new", &gate.path("no/folder")], 5);
    let public = gate.path("k.pub");
    assert!(gate.run("first", 0, &["--register", &key]).contains("registered as number 1 of key"));
    gate.run("second", 0, &["--register", &key]);
    let evidence = gate.path("evidence");
    run(&["evidence", &gate.path("second"), &evidence, "--key", &key], 0);
    let strict = ["verify", &evidence, "--key", &public, "--require-signed", "--require-registered", "--seed", "7"];
    let printed = run(&[&strict[..], &["--rerun", "3"]].concat(), 0);
    assert!(printed.starts_with("verification passed: verdict pass\n"), "{printed}");
    for part in ["policy: built into robogate", "as number 2 of key", "registration 1:", "rerun: 3 of 4 rows"] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
    let printed = run(&["verify", &evidence, "--rerun", "1000"], 0);
    assert!(printed.contains("rerun: all ") && !printed.contains("chosen at random"), "{printed}");
    // A used folder costs no number.
    assert!(gate.run("second", 2, &["--register", &key]).contains("is not empty"));
    assert_eq!(fs::read_to_string(gate.path("k.registrations")).unwrap().lines().count(), 2);
}

#[test]
fn other_seeds_are_rejected() {
    let gate = Gate::new();
    gate.run("run", 0, &[]);
    let evidence = gate.path("evidence");
    run(&["evidence", &gate.path("run"), &evidence], 0);
    assert!(run(&["verify", &evidence, "--seed", "8"], 4).contains("the campaign has the seed 7. Expected 8"));
    assert!(run(&["verify", &evidence, "--require-signed"], 4).contains("unsigned"));
    assert!(run(&["verify", &evidence, "--require-registered"], 4).contains("was not registered"));
    let printed = run(&["verify", &evidence, "--seed", "7"], 0);
    assert!(printed.contains("not registered before the run"), "{printed}");
}

#[test]
fn reports_and_evidence_leave_each_other_alone() {
    let gate = Gate::new();
    gate.run("run", 0, &[]);
    let (of, evidence, page) = (gate.path("run"), gate.path("evidence"), gate.path("page.md"));
    for within in ["run", "run/evidence", "run/a/../b"] {
        run(&["evidence", &of, &gate.path(within)], 2);
    }
    assert!(!Path::new(&gate.path("run/evidence")).exists());
    run(&["evidence", &of, &evidence], 0);
    let inside = gate.path("evidence/page.md");
    assert!(run(&["report", &evidence], 2).contains("--out"));
    run(&["report", &evidence, "--format", "md", "--no-replay", "--out", &inside], 2);
    run(&["report", &evidence, "--format", "md", "--no-replay", "--out", &page], 0);
    run(&["report", &evidence, "--format", "json", "--out", "-"], 0);
    run(&["verify", &evidence], 0);
}

#[test]
fn printed_commands_name_the_run() {
    let gate = Gate::new();
    let printed = gate.run("my run", 1, &[]);
    let (of, rows) = (gate.path("my run"), gate.path("my run/dictionary.parquet"));
    assert!(printed.contains(&format!("details: robogate report '{of}'")), "{printed}");
    assert!(run(&["gate", "--run", &of], 1).contains(&format!("details: robogate report '{of}'")));
    let strict = gate.path("strict.toml");
    let printed = run(&["gate", "--run", &rows, "--requirements", &strict], 1);
    assert!(printed.contains(&format!("details: robogate report '{rows}'")), "{printed}");
}

#[test]
fn files_that_are_no_keys_are_explained() {
    let gate = Gate::new();
    let printed = run(&["keys", "id", &gate.path("suite.toml")], 2);
    assert!(printed.contains("not SubjectPublicKeyInfo PEM") && printed.contains("Hint: expected"), "{printed}");
    let printed = run(&["verify", &gate.path("nowhere")], 2);
    assert!(printed.contains("nowhere is not a folder"), "{printed}");
}

#[test]
fn easier_requirements_are_reported_first() {
    let gate = Gate::new();
    gate.run("run", 1, &[]);
    let (of, easy) = (gate.path("run"), gate.path("gate.toml"));
    let reasked = ["evidence", &of, &gate.path("e"), "--requirements", &easy];
    assert!(run(&reasked, 2).contains("--reasked"));
    run(&[&reasked[..], &["--reasked"]].concat(), 0);
    let printed = run(&["verify", &gate.path("e")], 0);
    let first = printed.lines().next().unwrap();
    assert!(first.starts_with("verification passed: verdict pass (REASKED: requirements differ"), "{first}");
}

/// Writes the summary of the rows of a run, as a careful forger does.
fn summarise(gate: &Gate) {
    let dictionary = Dictionary::open(Path::new(&gate.path("run/dictionary.parquet"))).unwrap();
    let hash = dictionary.dataset_hash().to_owned();
    let summary = Summary::of_rows(dictionary.provenance(), hash, dictionary.entries()).unwrap();
    fs::write(gate.path("run/summary.json"), serde_json::to_vec(&summary).unwrap()).unwrap();
}

#[test]
fn invented_rows_are_found() {
    let gate = Gate::new();
    gate.run("run", 1, &[]);
    let path = gate.path("run/dictionary.parquet");
    let dictionary = Dictionary::open(Path::new(&path)).unwrap();
    let rows: Vec<Entry> = dictionary.entries().collect::<Result<_, _>>().unwrap();
    let provenance = dictionary.provenance().clone();
    // Each outcome is the opposite of what happened.
    let opposite = |mut row: Entry| {
        row.episode.outcome = match row.episode.outcome {
            Outcome::Success => Outcome::Failure(FailureMode::constant("timeout")),
            _ => Outcome::Success,
        };
        Ok(row)
    };
    write_parquet(Path::new(&path), &provenance, rows.into_iter().map(opposite)).unwrap();
    let evidence = gate.path("evidence");
    let arguments = ["evidence", &gate.path("run"), &evidence];
    assert!(Command::new(env!("CARGO_BIN_EXE_robogate")).args(arguments).output().unwrap().status.code() != Some(2));
    let printed = run(&["verify", &evidence], 4);
    assert!(printed.contains("summary.json: `dataset_hash` is"), "{printed}");
    // With a summary of these rows the folder is consistent, and only the episodes themselves show that it is false.
    summarise(&gate);
    fs::remove_dir_all(&evidence).unwrap();
    assert!(Command::new(env!("CARGO_BIN_EXE_robogate")).args(arguments).output().unwrap().status.code() != Some(2));
    run(&["verify", &evidence], 0);
    let printed = run(&["verify", &evidence, "--rerun", "1"], 4);
    assert!(printed.contains("is not what happens"), "{printed}");
}

/// A failure that is declared invalid does not leave the verification.
#[test]
fn rows_that_were_made_invalid_are_found() {
    let gate = Gate::new();
    gate.run("run", 1, &[]);
    let path = gate.path("run/dictionary.parquet");
    let dictionary = Dictionary::open(Path::new(&path)).unwrap();
    let rows: Vec<Entry> = dictionary.entries().collect::<Result<_, _>>().unwrap();
    let provenance = dictionary.provenance().clone();
    let hidden = |mut row: Entry| {
        row.episode.outcome = Outcome::Invalid(Fault::new(FaultKind::Setup, "the object starts in contact"));
        Ok(row)
    };
    write_parquet(Path::new(&path), &provenance, rows.into_iter().map(hidden)).unwrap();
    summarise(&gate);
    let evidence = gate.path("evidence");
    let arguments = ["evidence", &gate.path("run"), &evidence];
    assert!(Command::new(env!("CARGO_BIN_EXE_robogate")).args(arguments).output().unwrap().status.code() != Some(2));
    let printed = run(&["verify", &evidence, "--rerun", "1"], 4);
    assert!(printed.contains("is not what happens"), "{printed}");
}

/// Another variant of the C library's functions changes last bits, which the command states, and which is not a forgery.
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
#[test]
fn other_mathematical_functions_are_named() {
    if !std::arch::is_x86_feature_detected!("fma") {
        return;
    }
    let gate = Gate::new();
    gate.run("run", 0, &[]);
    let evidence = gate.path("evidence");
    run(&["evidence", &gate.path("run"), &evidence], 0);
    let masked = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        let tunables = "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable";
        let output = command.args(arguments).env("GLIBC_TUNABLES", tunables).output().unwrap();
        (output.status.code(), crate::harness::text(&output))
    };
    let (code, printed) = masked(&["verify", &evidence, "--rerun", "1000"]);
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("the mathematical functions of the C library differ"), "{printed}");
    let (code, printed) = masked(&["replay", &gate.path("run"), "0"]);
    assert_eq!(code, Some(4), "{printed}");
    assert!(printed.contains("the mathematical functions of the C library differ"), "{printed}");
}

#[test]
fn copies_of_a_run_have_identical_pages() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    run(&["run", "--task", "pendulum", "-n", "60", "--seed", "3", "--out", &at("first-folder")], 0);
    let copy = at("a much longer name, with spaces");
    fs::create_dir(&copy).unwrap();
    for entry in fs::read_dir(at("first-folder")).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, Path::new(&copy).join(path.file_name().unwrap())).unwrap();
    }
    for format in ["html", "md"] {
        let pages = [at("first-folder"), copy.clone()].map(|of| {
            let page = at(&format!("page.{format}"));
            run(&["report", &of, "--format", format, "--out", &page], 0);
            fs::read_to_string(page).unwrap()
        });
        assert!(pages[0] == pages[1], "the {format} pages differ");
        assert!(!pages[0].contains("first-folder"));
    }
}

#[test]
fn wrong_library_is_an_infrastructure_error() {
    let cache = TempDir::new().unwrap();
    let library = cache.path().join(format!("mujoco-3.17.0-{}", std::env::consts::ARCH));
    fs::create_dir_all(&library).unwrap();
    fs::write(library.join("libmujoco.so.3.17.0"), "not MuJoCo").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(["run", "-n", "3", "--out"])
        .arg(cache.path().join("run"))
        .env("ROBOGATE_CACHE_DIR", cache.path())
        .env_remove("ROBOGATE_MUJOCO_LIB")
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(5), "{printed}");
    assert!(printed.contains("SHA-256 digest"), "{printed}");
}
