//! Which crate may use which. ARCHITECTURE.md has the same table.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// For each crate of the workspace, what it may use of the others. `None`: everything.
const MAY_USE: &[(&str, Option<&[&str]>)] = &[
    ("robogate-maths", Some(&[])),
    ("robogate-core", Some(&["robogate-maths"])),
    ("robogate-physics", Some(&["robogate-core", "mujoco-provision"])),
    ("robogate-camera", Some(&["robogate-core", "robogate-physics", "mujoco-provision"])),
    ("robogate-tasks", Some(&["robogate-core", "robogate-physics", "robogate-camera", "mujoco-provision"])),
    ("robogate-zmtp", Some(&[])),
    ("robogate-policy", Some(&["robogate-core", "robogate-zmtp"])),
    ("robogate-remote", Some(&["robogate-core", "robogate-zmtp"])),
    ("robogate-demos", Some(&["robogate-core", "robogate-physics", "robogate-tasks", "mujoco-provision"])),
    ("robogate-dictionary", Some(&["robogate-core"])),
    ("robogate-stats", Some(&["robogate-maths"])),
    ("robogate-campaign", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    ("robogate-gate", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    ("robogate-analysis", Some(&["robogate-core", "robogate-dictionary", "robogate-stats"])),
    ("robogate-report", Some(&["robogate-stats", "robogate-analysis", "robogate-gate"])),
    ("robogate-monitor", Some(&["robogate-core", "robogate-stats"])),
    ("robogate-testing", Some(&[])),
    ("mujoco-provision", Some(&[])),
    ("robogate", None),
];

#[test]
fn crates_use_what_they_may() {
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
            // A dependency of tests alone is not one of the product.
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
fn the_table_in_the_architecture_page_is_this_one() {
    let page = include_str!("../../../ARCHITECTURE.md");
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
