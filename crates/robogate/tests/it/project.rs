//! The project file.

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{robogate_in, stderr, stdout, verb};

#[test]
fn settings_of_the_project_file_are_arguments() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let write = |text: &str| fs::write(at.join("robogate.toml"), text).unwrap();
    write(
        "task = 'pendulum'\nseed = 5\nset = ['time_limit_s=3']\n[run]\nn = 12\ntwins = true\nseed = 6\n[gate]\nrounds = 1\n",
    );
    verb(at, "run --out one", 0, &["12 episodes"]);
    let plan: Value = serde_json::from_slice(&fs::read(at.join("one/plan.json")).unwrap()).unwrap();
    assert_eq!((&plan["plan"]["seed"], &plan["plan"]["twins"]), (&Value::from(6), &Value::Bool(true)));
    assert_eq!(plan["provenance"]["task"]["time_limit_s"], Value::from(3.0));
    // The command line comes first.
    verb(at, "run -n 8 --seed 1 --set time_limit_s=4 --out two", 0, &["8 episodes"]);
    let plan: Value = serde_json::from_slice(&fs::read(at.join("two/plan.json")).unwrap()).unwrap();
    assert_eq!(plan["provenance"]["task"]["time_limit_s"], Value::from(4.0));
    let shown = stdout(&robogate_in(at, &["config", "show"]));
    for part in ["pendulum", "robogate.toml [run]", "robogate.toml top", "default"] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    // A file of somebody else starts nothing where a run is only read.
    write("env = 'evil.py:Env'\n");
    verb(at, "report one --format json", 0, &[]);
    verb(at, "replay one 0", 0, &[]);
}

#[test]
fn wrong_keys_are_named() {
    let dir = TempDir::new().unwrap();
    let write = |text: &str| fs::write(dir.path().join("robogate.toml"), text).unwrap();
    for (text, why) in [
        ("requirments = 'x'", "Did you mean `requirements`?"),
        ("[gate]\ntwins = 3", "`twins` is true or false"),
        ("task = ", "robogate.toml"),
        ("[run]\nrequirements = 'x'", "`requirements` is not an option of run"),
        ("n = 'many'", "robogate.toml: `n` (top) has this value"),
        ("[run]\ndesign = 'spiral'", "robogate.toml: `design` ([run]) has this value"),
    ] {
        write(text);
        let output = robogate_in(dir.path(), &["run", "--task", "pendulum"]);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(stderr(&output).contains(why), "{text}: {}", stderr(&output));
    }
    // A key that contradicts the command line is left out, whichever of the two options declares it.
    write("[run]\nn = 8\npreset = 'quick'\ntask = 'pendulum'\n[gate]\nsuite = 'stacking-40'\nseed = 3\n");
    verb(dir.path(), "run -qn 4 --out c", 0, &["4 episodes"]);
    fs::write(dir.path().join("plan.toml"), "[uniform]\nepisodes = 5\n").unwrap();
    verb(dir.path(), "run --plan plan.toml --out d", 0, &["8 episodes"]);
    verb(dir.path(), "gate --run c --requirements paper", 2, &["pick_place"]);
    // `twins` of another verb does not matter here.
    write("[gate]\nrounds = 2\n");
    verb(dir.path(), "run --task pendulum -n 4 --out a", 0, &[]);
}
