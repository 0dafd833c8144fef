//! `robogate init` from the starting points of three users: an environment with a network, a robot as URDF, and evidence.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::harness::{text, verb};

/// A file of the examples: an environment in 40 lines with a network of three layers, and an arm as URDF.
fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples").join(file)
}

fn robogate(dir: &Path, arguments: &str, code: i32, parts: &[&str]) -> Option<String> {
    let python = robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with gymnasium, pyzmq and msgpack")?;
    let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
    command.args(arguments.split(' ')).current_dir(dir).env("ROBOGATE_CACHE_DIR", dir.join("cache"));
    if arguments.starts_with("init") {
        command.args(["--python".as_ref(), python.as_os_str()]);
    }
    let output = command.output().unwrap();
    let all = text(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments}: {all}");
    for part in parts {
        assert!(all.contains(part), "{arguments} does not say {part:?}: {all}");
    }
    Some(all)
}

fn read(dir: &Path, file: &str) -> String {
    fs::read_to_string(dir.join(file)).unwrap()
}

/// The network and the environment fit by shape, its outputs are scaled to the bounds, and the project file serves the other verbs.
#[test]
fn environment_and_network_become_a_project() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    let networks = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/tests/networks");
    let point = fs::read_to_string(example("point/env.py")).unwrap();
    fs::copy(example("point/policy.onnx"), at.join("steering.onnx")).unwrap();
    fs::write(at.join("env.py"), &point).unwrap();
    let init = "init env.py steering.onnx --success 80% --cycle-time 6s";
    let found = ["takes obs [?, 6] F32; returns action [?, 2] F32", "ends with Tanh", "success after", "robogate gate"];
    if robogate(at, init, 0, &found).is_none() {
        return;
    }
    let (profile, map) = (read(at, "profile.toml"), read(at, "map.toml"));
    assert!(
        profile.contains("key = \"obs\"\nvectors = [\"observation\"]") && map.contains("scale = 2.0"),
        "{profile}{map}"
    );
    let requirements = read(at, "requirements.toml");
    assert!(requirements.contains("at_least = 0.8") && requirements.contains("at_most = 6.0"), "{requirements}");
    assert!(read(at, "space.toml").contains("drag") && at.join("runs/nominal/report.html").is_file());
    assert!(read(at, ".github/workflows/robogate.yml").contains("pip install \"$ROBOGATE_WHEEL\" gymnasium"));
    let check = robogate(at, "policy check steering.onnx --requests 2", 0, &["no problems found"]).unwrap();
    assert!(check.contains("robogate.toml: --env=env.py"), "{check}");
    // Nothing is replaced without --force, and nothing is started before that is known.
    robogate(at, init, 2, &["robogate.toml, requirements.toml", "--force"]);
    // The other verbs find all of it in the project file.
    robogate(at, "run -n 8 --threads 1 --out r", 0, &["steering policy", "8 episodes"]);
    // Each episode in progress has a process of its own.
    robogate(
        at,
        "run -n 6 --in-flight 3 --out flight",
        0,
        &["6 episodes", "the network answers one request at a time"],
    );
    let plan: serde_json::Value = serde_json::from_str(&read(at, "r/plan.json")).unwrap();
    let space = plan["provenance"]["space"].to_string();
    assert!(space.contains("drag") && !space.contains("noise"), "{space}");

    // A network of other sizes, and a file that is none.
    fs::copy(networks.join("small.onnx"), at.join("small.onnx")).unwrap();
    robogate(at, "init env.py small.onnx --force", 2, &["takes the image front", "has no camera"]);
    fs::write(at.join("text.onnx"), "not a network").unwrap();
    robogate(at, "init env.py text.onnx --force", 2, &["it is a text file. Expected an ONNX model"]);
    // A network of integers cannot take the real numbers of this environment, which its first request shows.
    fs::copy(networks.join("integers.onnx"), at.join("integers.onnx")).unwrap();
    let typed = ["`obs` has the type I64, but the profile sends [", "Expected integers of at most 32 bits"];
    robogate(at, "init env.py integers.onnx --force", 2, &typed);
    assert!(!at.join("runs/nominal-2").exists());
    for line in ["policy check integers.onnx", "run -n 3 --out typed", "gate --out typed"] {
        robogate(at, line, 2, &typed);
    }
    // A failed episode gets a tested diagnosis: it succeeds if it may take longer.
    fs::write(at.join("env.py"), point.replace("time_limit_s=8.0", "time_limit_s=0.6")).unwrap();
    let again = format!("{init} --force");
    robogate(
        at,
        &again,
        1,
        &["timeout after 0.6 s", "diagnosis", "ended at its time limit of 0.6 s", "no requirement on the cycle time"],
    );
    let silent = point.replace("{\"success\": bool(done)}", "{}");
    fs::write(at.join("env.py"), silent).unwrap();
    robogate(at, &again, 2, &["reports no success", "neither `success` nor `is_success`"]);
}

/// A URDF of an arm with two fingers becomes a robot that carries the payload, and a first episode in the built-in cell.
#[cfg(feature = "mujoco")]
#[test]
fn urdf_becomes_a_robot_with_a_first_episode() {
    let dir = TempDir::new().unwrap();
    fs::create_dir(dir.path().join("arm")).unwrap();
    // An arm of six joints that reaches 0.75 m, with a hand of two sliding fingers.
    fs::copy(example("arm/arm.urdf"), dir.path().join("arm/arm.urdf")).unwrap();
    let line = "init arm/arm.urdf --payload 0.6 --success 90% --collisions-per-thousand 1";
    let parts =
        ["the model of a robot", "can be used", "3,000 episodes without one", "episode", "runs/nominal/report.html"];
    let all = verb(dir.path(), line, 0, &parts);
    assert!(all.contains("Guessed, because the model does not state it"), "{all}");
    assert!(read(dir.path(), "arm/robot.toml").contains("payload_kg = 0.6"));
    assert!(read(dir.path(), "robogate.toml").contains("robot = \"arm\""));
    assert!(read(dir.path(), "requirements.toml").contains("failure:collision"));
    verb(dir.path(), "gate --plan", 0, &["success rate at least 90.00 %", "rate of collision at most 0.10 %"]);
}

/// Evidence is described without a check, with the command that checks it. Results and runs get their next command too.
#[test]
fn evidence_and_results_get_their_next_command() {
    let dir = TempDir::new().unwrap();
    let at = dir.path();
    verb(at, "run --task pendulum -n 40 --seed 3 --design uniform --out r", 0, &[]);
    verb(at, "init r", 0, &["a run of the policy", "robogate gate --run r"]);
    verb(at, "evidence r evidence --requirements default", 1, &[]);
    verb(at, "init evidence", 0, &["evidence of a gate", "FAIL", "nothing yet", "robogate verify evidence"]);
    assert!(!at.join("robogate.toml").exists(), "evidence needs no project");
    fs::write(at.join("evidence/manifest.json"), "{}").unwrap();
    verb(at, "init evidence", 2, &["not a manifest of evidence"]);
    verb(at, "export r rows.csv", 0, &[]);
    verb(
        at,
        "init rows.csv --success 90%",
        0,
        &["one row for each episode", "robogate gate --run rows.dictionary.parquet"],
    );
    verb(at, "gate --run rows.dictionary.parquet --requirements requirements.toml", 1, &["FAIL"]);
    // Without an argument, the files of the folder are suggested. No question is asked of a script.
    verb(at, "init", 2, &["name what you have", "Hint: robogate init rows.csv"]);
    verb(at, "init nothing.py", 2, &["no such file or folder", "Expected an environment"]);
}
