//! `robogate warn`: record, train, check.

use std::fs;

use tempfile::TempDir;

use crate::harness::{robogate_in, text, verb};

/// Episodes whose speed decides: a heavy load at high speed is lost.
const SPACE: &str = r#"
name = "grip"
[[parameter]]
name = "mass_kg"
kind = "continuous"
low = 0.1
high = 1.5
"#;

#[test]
fn detector_is_trained_checked_and_calibrated_again() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::write(at.join("grip.toml"), SPACE).unwrap();
    let run = |seed: u64, more: &str| {
        let line = format!(
            "run --space grip.toml --design uniform -n 180 --seed {seed} --nominal-episodes 0 --out r{seed} -q{more}"
        );
        let output = robogate_in(at, &line.split_whitespace().collect::<Vec<_>>());
        assert!(output.status.success(), "{}", text(&output));
    };
    run(1, " --record-signals --threads 2");
    run(2, "");
    assert!(!at.join("r2/signals.rgs").exists());

    // Recorded while the episodes run, and by a replay, is the same.
    let recorded = fs::read(at.join("r1/signals.rgs")).unwrap();
    let answer = verb(at, "warn train r1 --out w.json --json", 0, &["\"calibration\""]);
    fs::remove_file(at.join("r1/signals.rgs")).unwrap();
    assert_eq!(verb(at, "warn train r1 --out again.json --json --threads 1", 0, &[]), answer);
    assert_eq!(fs::read(at.join("r1/signals.rgs")).unwrap(), recorded);
    assert_eq!(fs::read(at.join("w.json")).unwrap(), fs::read(at.join("again.json")).unwrap());
    let document: serde_json::Value = serde_json::from_str(&answer).unwrap();
    let (rank, n) = (&document["calibration"]["rank"], document["calibration"]["successes"].as_u64().unwrap());
    assert!(n >= 59 && rank.as_u64().unwrap() <= n, "{answer}");

    let checked = robogate_in(at, &["warn", "check", "w.json", "r2"]);
    assert!(matches!(checked.status.code(), Some(0 | 3)), "{}", text(&checked));
    assert!(text(&checked).contains("independent successes warned"), "{}", text(&checked));
    verb(at, "warn check w.json r2 --out c.json", 0, &["at most 5.0 % of successful episodes"]);
    let file: serde_json::Value = serde_json::from_slice(&fs::read(at.join("c.json")).unwrap()).unwrap();
    assert!(file["calibration"]["successes"].as_u64().unwrap() > n, "{file}");

    // Errors of the user.
    verb(at, "warn train r1 --out w.json --parameters mass", 2, &["mass_kg"]);
    verb(at, "warn train r1 --out w.json --event jam", 2, &["MODE=MEASURE>LIMIT"]);
    fs::write(at.join("empty.json"), "{}").unwrap();
    verb(at, "warn check empty.json r2", 2, &["not a detector", "Hint: "]);
    let line = "run --nominal -n 20 --out few -q";
    robogate_in(at, &line.split_whitespace().collect::<Vec<_>>());
    verb(at, "warn train few --out few.json", 2, &["successes", "needed"]);
    fs::write(at.join("r2/signals.rgs"), "no signals").unwrap();
    verb(at, "warn check w.json r2", 2, &["not a file of signals", "Hint: "]);
}
