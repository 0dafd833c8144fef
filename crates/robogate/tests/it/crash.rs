//! Stops the command at each of its file operations in turn, and lets each fail, and checks that the next command gives the
//! bytes of an undisturbed one.
//!
//! A small library (`crash/shim.c`) counts writes, renames, syncs and deletions below a folder. It is compiled with the
//! C compiler of this machine. `ROBOGATE_CRASH_POINTS=all` tries every operation; otherwise the tests take at most
//! [`POINTS`] of them for each kind of fault, evenly spread and with the first and the last.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

use crate::harness::verb;

/// Operations that are tried for each kind of fault.
const POINTS: u64 = 6;
/// Commands with at most this number of operations are stopped at each of them.
const FEW: u64 = 12;
const KINDS: [&str; 4] = ["kill", "eio", "enospc", "short"];

/// The compiled library and a folder for the tests.
struct Faults {
    folder: TempDir,
    library: PathBuf,
}

impl Faults {
    fn new() -> Option<Self> {
        let compiler = robogate_testing::program("cc")?;
        let folder = TempDir::new().unwrap();
        let library = folder.path().join("shim.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/crash/shim.c");
        let output = Command::new(compiler)
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .args([&library, &source])
            .arg("-ldl")
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Some(Self { folder, library })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs the command with a fault at operation `at` below `dir` (0: none). Returns its output and the number of
    /// operations, if it was not killed.
    fn run(&self, arguments: &[&str], dir: &Path, kind: &str, at: u64) -> (Output, Option<u64>) {
        let count = self.path("count");
        let _ = fs::remove_file(&count);
        let output = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(arguments)
            .env("LD_PRELOAD", &self.library)
            .env("FAULT_DIR", dir)
            .env("FAULT_KIND", kind)
            .env("FAULT_AT", at.to_string())
            .env("FAULT_COUNT", &count)
            .output()
            .unwrap();
        (output, fs::read_to_string(&count).ok().and_then(|text| text.parse().ok()))
    }

    /// For each kind of fault and operation: runs `first` in a fresh folder with the fault, then `again` until it ends
    /// with the code of the undisturbed command, and compares the folder. After the fault, the files `complete` are
    /// absent or whole, and a folder with one of these names is absent or has all of its files.
    fn everywhere(
        &self,
        complete: &[&str],
        first: &dyn Fn(&Path) -> Vec<String>,
        again: &dyn Fn(&Path) -> Vec<String>,
    ) {
        let words = |words: &[String]| words.iter().map(String::as_str).collect::<Vec<_>>().join(" ");
        let run = |arguments: &[String], dir: &Path, kind: &str, at: u64| {
            self.run(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), dir, kind, at)
        };
        let whole = self.path("whole");
        let (output, operations) = run(&first(&whole), &whole, "none", 0);
        let expected = output.status.code();
        assert!(matches!(expected, Some(0 | 1 | 3)), "{}", String::from_utf8_lossy(&output.stderr));
        let operations = operations.unwrap();
        assert!(operations > 3, "{operations} operations: the library is not loaded");
        let files = files_of(&whole);
        let is_part = |name: &str| {
            complete
                .iter()
                .any(|whole| name.strip_prefix(whole).is_some_and(|rest| rest.is_empty() || rest.starts_with('/')))
        };
        assert!(complete.iter().all(|whole| files.keys().any(|name| name.starts_with(whole))), "{complete:?}");
        let all = std::env::var_os("ROBOGATE_CRASH_POINTS").is_some_and(|points| points == "all");
        let points: Vec<u64> = if all || operations <= FEW {
            (1..=operations).collect()
        } else {
            (0..POINTS).map(|i| 1 + i * (operations - 1) / (POINTS - 1)).collect()
        };
        for kind in KINDS {
            for at in &points {
                let dir = self.path(&format!("{kind}-{at}"));
                let (disturbed, _) = run(&first(&dir), &dir, kind, *at);
                let stderr = String::from_utf8_lossy(&disturbed.stderr).into_owned();
                assert!(!stderr.contains("internal error"), "{kind} at {at}: {stderr}");
                let after = files_of(&dir);
                for whole in complete {
                    let parts = |files: &BTreeMap<String, Vec<u8>>| -> BTreeMap<String, Vec<u8>> {
                        let parts = files.iter().filter(|(name, _)| is_part(name) && name.starts_with(whole));
                        parts.map(|(name, bytes)| (name.clone(), bytes.clone())).collect()
                    };
                    let there = parts(&after);
                    assert!(there.is_empty() || there == parts(&files), "{kind} at {at}: half of {whole} is there");
                }
                if files_of(&dir) != files {
                    // A plan that was never written has to be started again.
                    let begun = dir.join("plan.json").exists();
                    let next = if begun { again(&dir) } else { first(&dir) };
                    let (output, _) = run(&next, &dir, "none", 0);
                    let stderr = String::from_utf8_lossy(&output.stderr);
                    assert_eq!(output.status.code(), expected, "{kind} at {at}, then {}: {stderr}", words(&next));
                }
                let found = files_of(&dir);
                let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
                assert_eq!(names(&found), names(&files), "{kind} at {at}");
                let differing: Vec<_> = files.iter().filter(|(name, bytes)| found[*name] != **bytes).collect();
                assert!(
                    differing.is_empty(),
                    "{kind} at {at}: {:?} differ",
                    differing.iter().map(|(name, _)| name).collect::<Vec<_>>()
                );
                fs::remove_dir_all(&dir).unwrap();
            }
        }
    }
}

/// The files in a folder and their contents.
fn files_of(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let Ok(entries) = fs::read_dir(dir) else { return BTreeMap::new() };
    let mut files = BTreeMap::new();
    for entry in entries {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            files.extend(files_of(&path).into_iter().map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)));
        } else {
            files.insert(name, fs::read(&path).unwrap());
        }
    }
    files
}

fn owned(words: &[&str], dir: &Path) -> Vec<String> {
    words
        .iter()
        .map(|word| if *word == "DIR" { dir.to_str().unwrap().to_owned() } else { (*word).to_owned() })
        .collect()
}

#[test]
fn runs_survive_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let first = ["run", "--task", "pendulum", "-n", "6", "--seed", "3", "--threads", "1", "--out", "DIR"];
    let complete = ["plan.json", "dictionary.parquet", "report.html"];
    faults.everywhere(&complete, &|dir| owned(&first, dir), &|dir| owned(&["resume", "DIR", "--threads", "1"], dir));
}

#[test]
fn merges_survive_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let shards = faults.path("shards");
    let run = |words: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_robogate")).args(owned(words, &shards)).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    run(&["run", "--task", "pendulum", "-n", "6", "--seed", "3", "--divide", "2", "--out", "DIR"]);
    for _ in 0..2 {
        run(&["run", "--shard", "0/2", "--out", "DIR"]);
        run(&["run", "--shard", "1/2", "--out", "DIR"]);
    }
    let from = shards.to_str().unwrap();
    let merge = |dir: &Path| owned(&["merge", from, "--out", "DIR"], dir);
    faults.everywhere(&["dictionary.parquet"], &merge, &merge);
}

#[test]
fn evidence_survives_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let of = faults.path("run");
    let words = ["run", "--task", "pendulum", "-n", "40", "--seed", "3", "--out", "DIR"];
    let output = Command::new(env!("CARGO_BIN_EXE_robogate")).args(owned(&words, &of)).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let write = |dir: &Path| {
        // Beside it is the unfinished folder, whose operations count as well.
        let to = dir.join("evidence").to_str().unwrap().to_owned();
        ["evidence", of.to_str().unwrap(), &to, "--requirements", "default"].map(str::to_owned).to_vec()
    };
    faults.everywhere(&["evidence"], &write, &write);
}

/// A run, and a function that names a file in a folder after creating the folder.
fn recorded(faults: &Faults) -> (String, impl Fn(&Path, &str) -> String) {
    let run = faults.path("run");
    let words = ["run", "--task", "pendulum", "-n", "40", "--seed", "3", "--out", "DIR"];
    let output = Command::new(env!("CARGO_BIN_EXE_robogate")).args(owned(&words, &run)).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let inside = |dir: &Path, name: &str| {
        fs::create_dir_all(dir).unwrap();
        dir.join(name).to_str().unwrap().to_owned()
    };
    (run.to_str().unwrap().to_owned(), inside)
}

#[test]
fn exports_survive_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let (run, inside) = recorded(&faults);
    for name in ["rows.csv", "rows.jsonl", "rows.parquet"] {
        let export = |dir: &Path| ["export", run.as_str(), &inside(dir, name)].map(str::to_owned).to_vec();
        faults.everywhere(&[name], &export, &export);
        fs::remove_dir_all(faults.path("whole")).unwrap();
    }
}

#[test]
fn imports_survive_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let (run, inside) = recorded(&faults);
    let table = faults.path("rows.jsonl").to_str().unwrap().to_owned();
    let output = Command::new(env!("CARGO_BIN_EXE_robogate")).args(["export", &run, &table]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let plain = faults.path("plain.csv");
    let rows: String = (0..200).map(|i| format!("{},0.{i:03},{}\n", i % 3 == 0, i % 7)).collect();
    fs::write(&plain, format!("success,mass_kg,obstacles\n{rows}")).unwrap();
    let plain = plain.to_str().unwrap().to_owned();
    for from in [&table, &plain] {
        let import = |dir: &Path| ["import", from, &inside(dir, "imported.parquet")].map(str::to_owned).to_vec();
        faults.everywhere(&["imported.parquet"], &import, &import);
        fs::remove_dir_all(faults.path("whole")).unwrap();
    }
}

/// Pages, figures and references are absent or whole under their names.
#[test]
fn pages_survive_any_fault() {
    let Some(faults) = Faults::new() else { return };
    let (run, inside) = recorded(&faults);
    for (name, words) in [
        ("page.html", ["report", &run, "--no-replay", "--out"].as_slice()),
        ("a.svg", &["figure", &run, "marginal-effects-torque-limit", "--svg"]),
        ("m.json", &["monitor", "reference", &run, "--learn-baseline", "--out"]),
    ] {
        let write = |dir: &Path| {
            let out = inside(dir, name);
            words.iter().map(|word| (*word).to_owned()).chain([out]).collect()
        };
        faults.everywhere(&[name], &write, &write);
        fs::remove_dir_all(faults.path("whole")).unwrap();
    }
}

#[test]
fn resumed_gate_keeps_its_answer() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "gate --task pendulum --threads 2 --out gate", 1, &[]);
    let before = files_of(at);
    assert!(String::from_utf8_lossy(&before["gate/gate.md"]).contains("Episodes worth watching"));
    verb(at, "resume gate", 1, &[]);
    assert!(files_of(at) == before);
    // What a process left that was killed before it wrote its answer.
    fs::remove_file(at.join("gate/gate.md")).unwrap();
    verb(at, "resume gate", 1, &[]);
    assert!(files_of(at) == before);
}
