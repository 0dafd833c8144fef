//! End-to-end tests of `robogate study`.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use crate::harness::{path, robogate};

const SMALL: [&str; 8] = ["study", "--budget", "12", "--repeats", "2", "--test", "24", "--out"];

fn study(out: &str, more: &[&str]) -> Output {
    robogate(&[&SMALL[..], &[out], more].concat())
}

fn results(out: &str) -> [Vec<u8>; 2] {
    ["result.json", "boundary-focusing.md"].map(|name| fs::read(Path::new(out).join(name)).unwrap())
}

#[test]
fn killed_studies_resume_identically() {
    let dir = TempDir::new().unwrap();
    let (whole, killed) = (path(&dir, "whole"), path(&dir, "killed"));
    let output = study(&whole, &["--json", "--threads", "1"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{stderr}");
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&document["version"], &document["budget"], &document["repeats"]), (&2.into(), &12.into(), &2.into()));
    let mut kills = 0;
    for delay in [300, 500, 700, 900, 1100] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(SMALL)
            .arg(&killed)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(delay));
        if child.try_wait().unwrap().is_some() {
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        kills += 1;
    }
    assert!(kills > 0, "the study finished before the first kill");
    let output = study(&killed, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("Is boundary focusing worth it?"));
    assert!(results(&whole) == results(&killed), "a killed study differs");

    let other = robogate(&["study", "--budget", "14", "--repeats", "2", "--test", "24", "--out", &whole]);
    let stderr = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(other.status.code() == Some(2) && stderr.contains("budget (12, not 14)"), "{stderr}");
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
