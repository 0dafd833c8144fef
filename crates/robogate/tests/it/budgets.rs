//! Drives the readers of docs/reference/untrusted-input.md that no other test with counted memory covers
//! beyond their limits: each refuses its input, names the limit, and reserves no more memory than a fixed
//! bound. Parquet, CSV and archives are in `robogate-dictionary/tests/it/bombs.rs`, messages of policy
//! servers and ONNX in the tests of `robogate-policy`.

use std::fs;
use std::path::Path;

use robogate_campaign::Plan;
use robogate_core::budget::Budget;
use robogate_core::{ParameterSpace, Suite};
use robogate_gate::evidence::{PublicKey, verify};
use robogate_gate::{Baseline, Requirements};
use robogate_monitor::service::{Batch, MOST_LINES};
use robogate_physics::{Robot, RobotSettings};
use robogate_policy::{Profile, Statistics, TaskMap};
use robogate_testing::peak_memory;
use serde_json::Value;
use tempfile::TempDir;

/// Most memory that the refusal of an input may need, in bytes, in addition to twice the input.
const MOST: usize = 8 << 20;

/// Checks that a reader refuses an input of this size with a message that contains `part`, within the bound
/// on memory.
#[track_caller]
fn refused<T>(reader: &str, part: &str, bytes: usize, read: impl FnOnce() -> Result<T, String>) {
    let (result, peak) = peak_memory(|| read().map(drop));
    let why = result.expect_err(reader);
    assert!(why.contains(part), "{reader} does not say {part:?}: {why:.2000}");
    assert!(peak <= MOST + 2 * bytes, "{reader} needs {} MiB for {} KiB", peak >> 20, bytes >> 10);
}

fn text<T>(result: Result<T, impl std::fmt::Display>) -> Result<T, String> {
    result.map_err(|why| why.to_string())
}

#[test]
fn settings_have_budgets() {
    // More than 4,194,304 values, and more than 80 levels.
    let many = format!("a = [{}]", "0,".repeat(4_200_000));
    let deep = format!("a = {}{}", "[".repeat(1_000), "]".repeat(1_000));
    for (input, part) in [(&many, "t most"), (&deep, "recurs")] {
        let bytes = input.len();
        refused("a plan", part, bytes, || text(Plan::from_toml(input)));
        refused("a suite", part, bytes, || text(Suite::from_toml(input)));
        refused("a space", part, bytes, || text(ParameterSpace::from_toml(input)));
        refused("requirements", part, bytes, || text(Requirements::from_toml(input)));
        refused("a profile", part, bytes, || text(Profile::from_toml(input)));
        refused("a map", part, bytes, || text(TaskMap::from_toml(input)));
        refused("robot.toml", part, bytes, || text(RobotSettings::from_toml(input, Path::new("robot.toml"))));
    }
}

#[test]
fn documents_have_budgets() {
    let dir = TempDir::new().unwrap();
    let many = format!("[{}0]", "0,".repeat(4_200_000));
    let deep = "[".repeat(1_000);
    for input in [&many, &deep] {
        let (path, bytes) = (dir.path().join("input.json"), input.len());
        fs::write(&path, input).unwrap();
        refused("JSON", "t most", bytes, || text(Budget::FILE.json::<Value>(input.as_bytes())));
        refused("a baseline", "t most", bytes, || text(Baseline::open(&path)));
        refused("statistics", "t most", bytes, || text(Statistics::from_json(input, None)));
        refused("a key", "", bytes, || text(PublicKey::read(&path)));
    }
}

#[test]
fn robots_have_budgets() {
    let dir = TempDir::new().unwrap();
    let franka = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/robots/franka");
    fs::copy(franka.join("robot.toml"), dir.path().join("robot.toml")).unwrap();
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    png.extend([30_000_u32.to_be_bytes(), 30_000_u32.to_be_bytes()].concat());
    let model = |inner: &str| format!("<mujoco>{inner}</mujoco>").into_bytes();
    for (part, file, content) in [
        ("500000 elements", "franka.xml", model(&"<geom/>".repeat(500_001))),
        ("500000 elements", "franka.xml", model("<replicate count=\"1000000000\"><geom/></replicate>")),
        ("nested more than 200", "franka.xml", model(&"<body>".repeat(100_000))),
        ("nuser_body", "franka.xml", model("<size nuser_body=\"1000000000\"/>")),
        ("values", "franka.xml", model("<texture width=\"99999\" height=\"99999\"/>")),
        ("pixels", "skin.png", png),
    ] {
        fs::copy(franka.join("franka.xml"), dir.path().join("franka.xml")).unwrap();
        if file != "franka.xml" {
            // Files that the model does not name are not read.
            fs::write(dir.path().join("franka.xml"), model(&format!("<texture file=\"{file}\"/>"))).unwrap();
        }
        fs::write(dir.path().join(file), &content).unwrap();
        refused("a robot", part, content.len(), || text(Robot::from_folder(dir.path())));
        fs::remove_file(dir.path().join(file)).unwrap();
    }
}

#[test]
fn evidence_has_budgets() {
    let dir = TempDir::new().unwrap();
    let long = vec![b'['; 17 << 20];
    fs::write(dir.path().join("manifest.json"), &long).unwrap();
    let problems = || verify(dir.path(), None).map_err(|problems| problems[0].reason.clone());
    refused("a long manifest", "too large", 0, problems);
    fs::write(dir.path().join("manifest.json"), &long[..1 << 20]).unwrap();
    refused("a deep manifest", "t most", 1 << 20, problems);
}

#[test]
fn cycles_have_budgets() {
    let lines = b"x\n".repeat(MOST_LINES + 1);
    refused("a batch", "lines", lines.len(), || text(Batch::parse(&lines)));
    // Malformed lines are counted, and neither read nor kept.
    let lines = format!("{}\n", "[".repeat(300)).repeat(40_000);
    let (batch, peak) = peak_memory(|| Batch::parse(lines.as_bytes()).unwrap());
    assert!(peak < MOST, "{} MiB for a batch of {} malformed bytes", peak >> 20, lines.len());
    drop(batch);
}
