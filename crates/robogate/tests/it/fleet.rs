//! End-to-end tests of `robogate fleet`: units with constant deviations, the same bytes for any threads and any
//! interruption, and the share of units that meet the requirements.

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{kill_after, verb};

/// The encoder bias decides whether a unit holds the pole upright; damping has no effect in this range.
const UNITS: &str = r#"
name = "pendulum-units"
[[parameter]]
name = "angle_bias_rad"
kind = "continuous"
low = -0.4
high = 0.4
[[parameter]]
name = "damping_nms_rad"
kind = "continuous"
low = 0.008
high = 0.012
"#;

/// Poles that the controller holds upright.
pub(crate) const SUITE: &str = r#"
schema = 1
name = "upright"
version = "1.0.0"
description = "Poles that the controller holds upright."
defaults = { mass_kg = 0.2, start_rad = { low = -0.2, high = 0.2 } }
[[group]]
name = "poles"
category = "nominal"
scenarios = [{ id = "a" }, { id = "b", mass_kg = 0.25 }, { id = "c", mass_kg = 0.3 }, { id = "d", mass_kg = 0.22 }]
"#;

const REQUIREMENTS: &str = r#"
name = "most"
mode = "confidence"
[budget]
rounds = 12
[[requirement]]
metric = "success"
at_least = 0.6
"#;

fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    for (name, text) in [("units.toml", UNITS), ("suite.toml", SUITE), ("most.toml", REQUIREMENTS)] {
        fs::write(dir.path().join(name), text).unwrap();
    }
    dir
}

const FLEET: &str =
    "fleet --task pendulum --suite suite.toml --unit-space units.toml --requirements most.toml --seed 5 --units 12";

#[test]
fn fleet_names_what_distinguishes_worse_units() {
    let dir = folder();
    let at = dir.path();
    let text = verb(at, &format!("{FLEET} --threads 2 --out a"), 0, &["of 12 units meet", "`angle_bias_rad`"]);
    assert!(!text.contains("`damping_nms_rad`:"), "{text}");
    verb(at, &format!("{FLEET} --threads 1 --out b"), 0, &[]);
    let read = |name: &str| fs::read(at.join(name)).unwrap();
    for file in ["fleet.json", "fleet-result.json", "fleet.md", "fleet.html", "unit-003/dictionary.parquet"] {
        assert!(read(&format!("a/{file}")) == read(&format!("b/{file}")), "{file} depends on the number of threads");
    }
    // The same command, and `resume`, continue a finished fleet.
    verb(at, &format!("{FLEET} --out a"), 0, &["of 12 units meet"]);
    verb(at, "resume b", 0, &["of 12 units meet"]);
    verb(at, &format!("{FLEET} --share 0.5 --out a"), 2, &["another fleet"]);

    let fleet: Value = serde_json::from_slice(&read("a/fleet-result.json")).unwrap();
    let units = fleet["units"].as_array().unwrap();
    assert_eq!(units.len(), 12);
    // A unit keeps its parameters over all of its episodes.
    let bias = units[2]["parameters"]["angle_bias_rad"].as_f64().unwrap();
    let rows = verb(at, "export a/unit-003 -", 0, &[]);
    let mut lines = rows.lines();
    let column = lines.next().unwrap().split(',').position(|name| name == "angle_bias_rad").unwrap();
    let values: Vec<f64> = lines.filter_map(|line| line.split(',').nth(column)?.parse().ok()).collect();
    assert!(values.len() >= 4 && values.iter().all(|value| (value - bias).abs() < 1e-12), "{bias}: {values:?}");
    // Each unit is a complete gate.
    let verdict = units[2]["verdict"].as_str().unwrap().to_uppercase();
    let code = if verdict == "PASS" {
        0
    } else if verdict == "FAIL" {
        1
    } else {
        3
    };
    verb(at, "gate --run a/unit-003", code, &[&verdict]);
    let [low, high] = [0, 1].map(|end| fleet["share"]["interval_95"][end].as_f64().unwrap());
    assert!(low < high && high < 1.0);
}

#[test]
fn required_share_decides_exit_code() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{FLEET} --share 0.05 --out few"), 0, &["At least 5.0 % of the units"]);
    verb(at, &format!("{FLEET} --share 0.99 --out most"), 1, &["Fewer than 99.0 % of the units"]);
    verb(at, &format!("{FLEET} --share 1.5 --out none"), 2, &["a fraction from 0 to 1"]);
}

#[test]
fn requirements_on_the_real_robot_are_refused() {
    let dir = folder();
    let at = dir.path();
    let real = format!("{REQUIREMENTS}[[requirement]]\nmetric = \"real:success\"\nat_least = 0.6\n");
    fs::write(at.join("real.toml"), real).unwrap();
    let fleet = FLEET.replace("most.toml", "real.toml");
    verb(at, &format!("{fleet} --out a"), 2, &["--requirements real.toml", "`real:success`", "Hint: leave"]);
    assert!(!at.join("a").exists());
}

#[test]
fn interrupted_fleet_resumes_identically() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{FLEET} --out whole"), 0, &[]);
    kill_after(at, &format!("{FLEET} --out cut"), ["cut", "fleet-result.json"], |line| {
        line.starts_with("unit 2 of 12")
    });
    verb(at, "resume cut", 0, &[]);
    for file in ["fleet-result.json", "unit-003/dictionary.parquet", "unit-012/gate.json"] {
        assert!(
            fs::read(at.join("whole").join(file)).unwrap() == fs::read(at.join("cut").join(file)).unwrap(),
            "{file}"
        );
    }
}

#[test]
fn parameter_belongs_to_scenarios_or_unit() {
    let dir = folder();
    let at = dir.path();
    let both = SUITE.replace("mass_kg = 0.2, ", "mass_kg = 0.2, angle_bias_rad = { low = 0.0, high = 0.1 }, ");
    fs::write(at.join("both.toml"), both).unwrap();
    let fleet = FLEET.replace("suite.toml", "both.toml");
    verb(at, &format!("{fleet} --out a"), 2, &["`angle_bias_rad` varies over the scenarios", "Hint: leave"]);
    let without = FLEET.replace(" --unit-space units.toml", "");
    verb(at, &format!("{without} --out b"), 2, &["--unit-space FILE"]);
    assert!(!at.join("a").exists() && !at.join("b").exists());
}

/// The commands of docs/guides/fleet.md. A folder that belongs to something else stops them after all units have been checked.
#[test]
fn default_units_fit_default_suite() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    fs::create_dir(at.join("taken")).unwrap();
    fs::write(at.join("taken/notes.txt"), "").unwrap();
    let list: Value = serde_json::from_str(&verb(at, "list --json", 0, &[])).unwrap();
    let robots = list["robots"].as_array().unwrap();
    assert!(robots.len() >= 4, "{robots:?}");
    let left_out = "left out of the units, because the scenarios of industrial-68 vary them: camera_roll_rad";
    for robot in robots {
        let fleet = format!("fleet --units 20 --robot {} --out taken", robot.as_str().unwrap());
        verb(at, &fleet, 2, &[left_out, "is not a fleet"]);
    }
    // A robot of the user with six joints and a gripper has no seventh one.
    let examples = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/arm");
    fs::create_dir(at.join("own")).unwrap();
    for file in fs::read_dir(examples).unwrap().map(Result::unwrap).filter(|file| file.path().is_file()) {
        fs::copy(file.path(), at.join("own").join(file.file_name())).unwrap();
    }
    verb(at, "init own/arm.urdf --no-episode", 0, &[]);
    verb(at, "fleet --units 20 --robot own --out taken", 2, &["is not a fleet"]);
    // A space that the user chose is not changed.
    verb(at, "fleet --unit-space franka-units --out taken", 2, &["`camera_roll_rad` varies", "Hint: leave"]);
}
