//! Settings of a task are data: `--set` sets them in every verb, records contain them, and `robogate list` prints them.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::bridge::Server;
use crate::harness::verb;

#[expect(clippy::unwrap_used, reason = "a test fails by panicking")]
fn recorded(folder: &Path, name: &str) -> Value {
    let plan: Value = serde_json::from_str(&fs::read_to_string(folder.join("plan.json")).unwrap()).unwrap();
    let settings = plan["provenance"]["task"]["settings"].as_array().unwrap().clone();
    settings.into_iter().find(|setting| setting["name"] == name).map_or(Value::Null, |setting| setting["value"].clone())
}

#[test]
fn every_task_has_settings_that_change_it() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    // In one control period, no episode can end by an event.
    for (task, period) in [("pick_place", "0.05"), ("stacking", "0.05s"), ("insertion", "50ms"), ("pendulum", "20ms")] {
        verb(at, &format!("run --task {task} --set time_limit_s={period} -n 3 --design uniform --out {task}"), 0, &[]);
        let value = recorded(&at.join(task), "time_limit_s");
        assert_eq!(value, if task == "pendulum" { 0.02 } else { 0.05 }, "{task}");
        verb(at, &format!("export {task} {task}.csv"), 0, &[]);
        let csv = fs::read_to_string(at.join(format!("{task}.csv"))).unwrap();
        assert_eq!(csv.matches(",timeout,timeout,").count(), 3, "{task}: {csv}");
        verb(at, &format!("replay {task} 1"), 0, &["identical to the recorded episode"]);
        verb(at, &format!("resume {task}"), 0, &[]);
        verb(at, "list", 0, &[&format!("{task} time_limit_s: ")]);
    }
}

#[test]
fn settings_of_a_server_are_set_there() {
    let dir = TempDir::new().unwrap();
    let server = Server::start(&["--task", "pendulum", "--set", "time_limit_s=0.04"]);
    let run = format!("run --simulator {} -n 2 --policy random", server.address);
    verb(dir.path(), &format!("{run} --out served"), 0, &[]);
    assert_eq!(recorded(&dir.path().join("served"), "time_limit_s"), 0.04);
    verb(dir.path(), &format!("{run} --set time_limit_s=1 --out no"), 2, &["robogate serve --set time_limit_s=VALUE"]);
    assert!(!dir.path().join("no").exists());
}

/// The settings of the paper belong to its preset, and a user's choice comes before them.
#[test]
fn paper_preset_sets_settings() {
    let dir = TempDir::new().unwrap();
    let run = |out: &str, more: &str| {
        verb(dir.path(), &format!("run --robot ur5e --preset paper -n 3 --out {out}{more}"), 0, &[]);
        ["suction", "failure_modes", "workspace"].map(|name| recorded(&dir.path().join(out), name))
    };
    assert_eq!(run("paper", ""), ["surface", "paper", "paper"].map(Value::from));
    assert_eq!(run("own", " --set suction=vacuum"), ["vacuum", "paper", "paper"].map(Value::from));
}
