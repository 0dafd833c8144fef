//! The list of runs below a folder.

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{assert_done, robogate_in, stdout};

#[test]
fn runs_are_listed_with_rate_and_verdict() {
    let dir = TempDir::new().unwrap();
    let robogate = |arguments: &[&str]| robogate_in(dir.path(), arguments);
    assert!(stdout(&robogate(&["runs"])).is_empty());
    assert_done(&robogate(&["run", "--task", "pendulum", "-n", "20", "--twins", "--out", "deep/er/one"]));
    let gate = robogate(&["gate", "--task", "pendulum", "--fixed", "--rounds", "5", "--out", "two"]);
    std::fs::create_dir_all(dir.path().join("three")).unwrap();
    std::fs::copy(dir.path().join("two/plan.json"), dir.path().join("three/plan.json")).unwrap();
    let text = stdout(&robogate(&["runs"]));
    // The control arm is a part of its run.
    assert_eq!(text.lines().count(), 3, "{text}");
    for part in ["deep/er/one", "pendulum, scripted", "unfinished"] {
        assert!(text.contains(part), "{text}");
    }
    let document: Value = serde_json::from_str(&stdout(&robogate(&["runs", "--json"]))).unwrap();
    let run = |name: &str| {
        let runs = document["runs"].as_array().unwrap();
        runs.iter().find(|run| run["folder"].as_str().unwrap().ends_with(name)).unwrap().clone()
    };
    assert_eq!((&run("one")["episodes"], &run("one")["verdict"]), (&Value::from(20), &Value::Null));
    let judged: Value = serde_json::from_slice(&std::fs::read(dir.path().join("two/gate.json")).unwrap()).unwrap();
    assert_eq!(run("two")["verdict"], judged["verdict"]);
    assert!(gate.status.code().is_some_and(|code| code <= 3));
    assert_eq!(run("three")["finished"], Value::Bool(false));
}
