//! Regression tests against recorded episodes, which must stay identical unless a change of results is intended.
//!
//! Each file under `tests/it/numerics` contains outcome, time and trajectory hash of the episodes of one run. If a change
//! of results is intended, write the files again with `ROBOGATE_WRITE_NUMERICS=1` and document the change in the
//! changelog, under "Numerics".

use std::fs;
use std::path::Path;

use robogate_dictionary::Platform;
use tempfile::TempDir;

use crate::harness::{assert_done, robogate_in};

/// The columns that are compared.
const COLUMNS: [&str; 5] = ["index", "outcome", "cycle_time_s", "ticks", "trajectory_hash"];

fn robogate(arguments: &[&str]) {
    // Policy files are named relative to the repository's root.
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    assert_done(&robogate_in(&root, arguments));
}

/// The cell of the paper: its space and its tolerance, without a limit of contact forces.
const FRANKA: [&str; 6] = ["--space", "franka", "--set", "tolerance_m=0.03", "--set", "contact_force_limit_n=1000000"];
const UR: [&str; 6] = ["--space", "ur", "--set", "tolerance_m=0.03", "--set", "contact_force_limit_n=1000000"];

/// Runs `run` with these arguments and compares its rows with the recorded ones.
fn compare(name: &str, arguments: &[&str]) {
    let dir = TempDir::new().unwrap();
    let [run, csv] = ["run", "rows.csv"].map(|file| dir.path().join(file).to_str().unwrap().to_owned());
    // A suite has no design.
    let design: &[&str] = if arguments.contains(&"--suite") { &[] } else { &["--design", "two-stage"] };
    robogate(&[&["run", "--out", &run], design, arguments].concat());
    robogate(&["export", &run, &csv]);
    let rows = select(&fs::read_to_string(csv).unwrap());
    let recorded = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/numerics").join(format!("{name}.csv"));
    if std::env::var_os("ROBOGATE_WRITE_NUMERICS").is_some() {
        fs::create_dir_all(recorded.parent().unwrap()).unwrap();
        fs::write(recorded, rows).unwrap();
        return;
    }
    let recorded = fs::read_to_string(recorded).unwrap();
    assert_eq!(rows.lines().count(), recorded.lines().count(), "{name}");
    for (now, then) in rows.lines().zip(recorded.lines()) {
        assert_eq!(now, then, "{name}");
    }
}

/// The compared columns of a CSV file. They are never quoted, and quoted columns contain no line breaks.
fn select(csv: &str) -> String {
    let mut lines = csv.lines().map(|line| line.trim_end_matches('\r'));
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places = COLUMNS.map(|column| header.iter().position(|name| *name == column).unwrap());
    let mut selected = COLUMNS.join(",") + "\n";
    for line in lines {
        let cells: Vec<&str> = cells(line);
        selected += &(places.map(|place| cells[place]).join(",") + "\n");
    }
    selected
}

/// The cells of a line. A comma between quotes is not a separator.
fn cells(line: &str) -> Vec<&str> {
    let mut quoted = false;
    line.split(|c| {
        quoted ^= c == '"';
        c == ',' && !quoted
    })
    .collect()
}

#[test]
fn the_papers_cell() {
    compare("franka", &[&["-n", "300"], &FRANKA[..]].concat());
}

#[test]
fn default_cell() {
    compare("cell", &["-n", "60"]);
    compare("cup-cell", &["-n", "60", "--robot", "ur5e"]);
}

#[test]
fn industrial_suite() {
    compare("industrial-68", &["--suite", "industrial-68"]);
}

#[test]
fn three_universal_robots() {
    for robot in ["ur3e", "ur5e", "ur10e"] {
        compare(robot, &[&["-n", "30", "--robot", robot], &UR[..]].concat());
    }
}

#[test]
fn paper_suction_law() {
    compare("ur5e-surface", &[&["-n", "15", "--robot", "ur5e", "--set", "suction=surface"], &UR[..]].concat());
}

#[test]
fn rapier_engine() {
    compare("rapier", &[&["-n", "30", "--engine", "rapier"], &FRANKA[..]].concat());
}

#[test]
fn random_policy() {
    compare("random", &[&["-n", "12", "--policy", "random"], &FRANKA[..]].concat());
}

/// The library of networks has wider vectors with AVX-512, which change the order of its sums.
#[test]
fn network_with_cameras() {
    let network = ["--space", "learned", "--policy", "assets/policies/learned.onnx", "--profile", "learned"];
    let network = [&network[..], &FRANKA[2..]].concat();
    let wide = Platform::here().with_networks() != Platform::here();
    compare(if wide { "learned" } else { "learned-avx2" }, &[&["-n", "12"], &network[..]].concat());
}
