//! Checks the dependencies between crates (the table in ARCHITECTURE.md), and where names of one task may appear.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// For each crate of the workspace, the crates that it may use. `None` allows all.
const MAY_USE: &[(&str, Option<&[&str]>)] = &[
    ("robogate-maths", Some(&[])),
    ("robogate-core", Some(&["robogate-maths"])),
    ("robogate-physics", Some(&["robogate-core", "mujoco-loader"])),
    ("robogate-camera", Some(&["robogate-core", "robogate-physics"])),
    ("robogate-tasks", Some(&["robogate-core", "robogate-physics", "robogate-camera"])),
    ("robogate-zmtp", Some(&[])),
    ("robogate-policy", Some(&["robogate-core", "robogate-zmtp"])),
    ("robogate-remote", Some(&["robogate-core", "robogate-zmtp"])),
    ("robogate-demos", Some(&["robogate-core", "robogate-dictionary", "robogate-physics", "robogate-tasks"])),
    ("robogate-dictionary", Some(&["robogate-core"])),
    ("robogate-stats", Some(&["robogate-maths"])),
    ("robogate-risk", Some(&["robogate-core", "robogate-stats"])),
    ("robogate-campaign", Some(&["robogate-core", "robogate-dictionary", "robogate-stats", "robogate-risk"])),
    ("robogate-gate", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    ("robogate-analysis", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    ("robogate-replay", Some(&["robogate-core"])),
    ("robogate-report", Some(&["robogate-stats", "robogate-replay", "robogate-analysis", "robogate-gate"])),
    ("robogate-monitor", Some(&["robogate-core", "robogate-maths", "robogate-stats"])),
    ("robogate-trial", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    (
        "robogate-session",
        Some(&[
            "robogate-analysis",
            "robogate-camera",
            "robogate-campaign",
            "robogate-core",
            "robogate-demos",
            "robogate-dictionary",
            "robogate-gate",
            "robogate-monitor",
            "robogate-physics",
            "robogate-policy",
            "robogate-remote",
            "robogate-risk",
            "robogate-stats",
            "robogate-tasks",
            "robogate-zmtp",
        ]),
    ),
    ("robogate-testing", Some(&[])),
    ("mujoco-loader", Some(&[])),
    ("robogate", None),
];

#[test]
fn crates_use_allowed_crates() {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages: BTreeMap<&str, &serde_json::Value> = metadata["packages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|package| (package["name"].as_str().unwrap(), package))
        .collect();
    for (name, package) in &packages {
        let (_, allowed) = MAY_USE
            .iter()
            .find(|(known, _)| known == name)
            .unwrap_or_else(|| panic!("crate {name} is not in the table: add it here and in ARCHITECTURE.md"));
        let Some(allowed) = allowed else { continue };
        let used: BTreeSet<&str> = package["dependencies"]
            .as_array()
            .unwrap()
            .iter()
            // Dev-dependencies are not part of the product.
            .filter(|dependency| dependency["kind"] != "dev")
            .map(|dependency| dependency["name"].as_str().unwrap())
            .filter(|dependency| packages.contains_key(dependency))
            .collect();
        for dependency in used {
            assert!(allowed.contains(&dependency), "{name} must not use {dependency}");
        }
    }
}

#[test]
fn architecture_table_matches() {
    let page = include_str!("../../../../ARCHITECTURE.md");
    for (name, allowed) in MAY_USE {
        let row = page
            .lines()
            .find(|line| line.starts_with(&format!("| `{name}` |")))
            .unwrap_or_else(|| panic!("ARCHITECTURE.md has no row for {name}"));
        let uses = row.split('|').nth(3).unwrap().trim();
        let expected = match allowed {
            None => "all".to_owned(),
            Some([]) => "-".to_owned(),
            Some(allowed) => {
                let short: Vec<&str> =
                    allowed.iter().map(|name| name.strip_prefix("robogate-").unwrap_or(name)).collect();
                short.join(", ")
            }
        };
        assert_eq!(uses, expected, "row of {name}");
    }
}

/// Names that only pick and place uses.
const PICK_AND_PLACE: &[&str] = &[
    "grasp_miss",
    "grip_loss",
    "collision",
    "slip_m",
    "min_clearance_m",
    "target_distance_m",
    "APPROACH_ABOVE",
    "DESCEND",
    "MOVE_TO_TARGET",
    "friction",
    "placement",
    "com_offset",
    "ik_noise_rad",
    "grip_threshold_m",
    "approach_speed_m_s",
];

/// The folders where these names may appear.
const MAY_NAME_THEM: &[&str] = &[
    // The task, its analysis, and the code that only serves it. Other tasks have friction and collisions too.
    "robogate-tasks/src/pick_place",
    "robogate-tasks/src/insertion",
    "robogate-tasks/src/file",
    "robogate-analysis/src/pick_place",
    "robogate-physics/src",
    "robogate-camera/src",
    "robogate-demos/src",
    // File formats that are older than task specifications.
    "robogate-dictionary/src/published",
    "robogate-dictionary/src/v1",
    "robogate-gate/src/metric.rs",
    // Names in cycle records and stores that are older than task specifications.
    "robogate-monitor/src/events.rs",
    "robogate-monitor/src/modes.rs",
];

#[test]
fn task_vocabulary_stays_in_its_folder() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut files = Vec::new();
    for entry in fs::read_dir(&crates).unwrap() {
        sources(&entry.unwrap().path().join("src"), &mut files);
    }
    assert!(files.len() > 100, "{} files", files.len());
    let mut found = Vec::new();
    for file in files {
        let name = file.strip_prefix(&crates).unwrap().to_str().unwrap().to_owned();
        if MAY_NAME_THEM.iter().any(|place| name.starts_with(place)) {
            continue;
        }
        let text = fs::read_to_string(&file).unwrap();
        let product = text.split("#[cfg(test)]\nmod ").next().unwrap();
        for (number, line) in product.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with("//")) {
            for word in PICK_AND_PLACE.iter().filter(|word| line.contains(&format!("\"{word}\""))) {
                found.push(format!("{name}:{}: {word}", number + 1));
            }
        }
    }
    assert!(found.is_empty(), "{found:#?}");
}

fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            sources(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}
