//! End-to-end tests of `robogate study`.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

use crate::harness::{path, robogate, runs_until};

const SMALL: [&str; 8] = ["study", "--budget", "6", "--repeats", "2", "--test", "12", "--out"];

fn study(out: &str, more: &[&str]) -> Output {
    robogate(&[&SMALL[..], &[out], more].concat())
}

fn results(out: &str) -> [Vec<u8>; 2] {
    ["result.json", "boundary-focusing.md"].map(|name| fs::read(Path::new(out).join(name)).unwrap())
}

/// The bytes of all files below a folder. A file that is renamed meanwhile may be missing.
fn bytes_of(dir: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(dir) else { return 0 };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    paths.map(|path| if path.is_dir() { bytes_of(&path) } else { path.metadata().map_or(0, |file| file.len()) }).sum()
}

#[test]
fn killed_studies_resume_identically() {
    let dir = TempDir::new().unwrap();
    let (whole, killed) = (path(&dir, "whole"), path(&dir, "killed"));
    let output = study(&whole, &["--json", "--threads", "1"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{stderr}");
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&document["version"], &document["budget"], &document["repeats"]), (&2.into(), &6.into(), &2.into()));
    let recorded = || bytes_of(Path::new(&killed));
    for _ in 0..4 {
        let before = recorded();
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(SMALL)
            .arg(&killed)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        assert!(runs_until(&mut child, || recorded() > before), "the study finished before its kill");
        child.kill().unwrap();
        child.wait().unwrap();
    }
    assert!(!Path::new(&killed).join("result.json").exists(), "the study was not interrupted");
    let output = study(&killed, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("Is boundary focusing worth it?"));
    assert!(results(&whole) == results(&killed), "a killed study differs");

    let other = robogate(&["study", "--budget", "8", "--repeats", "2", "--test", "12", "--out", &whole]);
    let stderr = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(other.status.code() == Some(2) && stderr.contains("budget (6, not 8)"), "{stderr}");
}

#[test]
fn wrong_usage_starts_nothing() {
    let dir = TempDir::new().unwrap();
    let file = |name: &str, text: &str| {
        fs::write(dir.path().join(name), text).unwrap();
        path(&dir, name)
    };
    let out = path(&dir, "out");
    let plan = file("plan.toml", "[uniform]\nepisodes = 10\n[boundary]\nepisodes = 5\n");
    for (more, part) in [
        (["--plan", &plan], "no `fallback` or `restrict`"),
        (["--robot", "r2d2"], "r2d2"),
        (["--space", &plan], "plan.toml"),
        (["--budget", "1"], "1"),
        (["--repeats", "0"], "0"),
    ] {
        let output = robogate(&[&["study", "--out", &out], &more[..]].concat());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && stderr.contains(part), "{more:?}: {stderr}");
    }
    assert!(!Path::new(&out).exists(), "a study was started");
    let output = study(dir.path().to_str().unwrap(), &[]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(2) && stderr.contains("plan.toml") && stderr.contains("not a study"),
        "{stderr}"
    );
}
