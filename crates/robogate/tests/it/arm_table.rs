//! The table of verbs and built-in tasks for an arm. Every cell of it works.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::bridge::Server;
use crate::controls::idle;
use crate::harness::{robogate_in, text, verb};

/// One round of one scenario.
const REQUIREMENTS: &str = r#"
name = "easy"
mode = "point"
[budget]
rounds = 1
[[requirement]]
metric = "success"
at_least = 0.5
"#;

const SUITE: &str = r#"
schema = 1
name = "one"
version = "1.0.0"
description = "One scenario."
defaults = { mass_kg = 0.2 }
[[group]]
name = "nominal"
category = "nominal"
description = "Nothing but nominal values."
scenarios = [{ id = "nominal-1" }]
"#;

/// A task in a folder.
struct Row {
    dir: TempDir,
    task: &'static str,
}

impl Row {
    fn new(task: &'static str) -> Self {
        let dir = TempDir::new().unwrap();
        for (name, text) in [("requirements.toml", REQUIREMENTS), ("suite.toml", SUITE)] {
            fs::write(dir.path().join(name), text).unwrap();
        }
        Self { dir, task }
    }

    fn at(&self) -> &Path {
        self.dir.path()
    }

    /// Runs a line of arguments, in which `TASK` is the option of the task. Returns stdout.
    #[track_caller]
    fn verb(&self, line: &str, parts: &[&str]) -> String {
        verb(self.at(), &line.replace("TASK", &format!("--task {}", self.task)), 0, parts)
    }

    fn bytes(&self, file: &str) -> Vec<u8> {
        fs::read(self.at().join(file)).unwrap()
    }

    fn json(&self, file: &str) -> Value {
        serde_json::from_slice(&self.bytes(file)).unwrap()
    }

    /// The rows of a run as CSV.
    fn rows(&self, run: &str) -> String {
        self.verb(&format!("export {run} {run}.csv"), &[]);
        String::from_utf8(self.bytes(&format!("{run}.csv"))).unwrap()
    }
}

/// The verbs on one run: resume, replay, report, view, and the same rows for any number of threads.
fn run(row: &Row) {
    row.verb("run TASK -n 4 --seed 3 --threads 2 --out a", &[row.task]);
    row.verb("run TASK -n 4 --seed 3 --threads 1 --out b", &[]);
    assert_eq!(row.bytes("a/dictionary.parquet"), row.bytes("b/dictionary.parquet"));
    row.verb("resume a", &[]);
    row.verb("replay a 3", &["identical to the recorded episode"]);
    row.verb("analyze a", &["failure report: Franka"]);
    row.verb("report a --out page.html", &[]);
    row.verb("view a --export view.html", &[]);
    assert!(fs::read_to_string(row.at().join("page.html")).unwrap().contains(row.task));
    assert!(row.bytes("view.html").len() > 100_000);
}

/// Latency, and the control arm of nominal twins.
fn options(row: &Row) {
    row.verb("run TASK -n 2 --latency gamma:80ms,20ms --design uniform --out late", &["inference latency gamma"]);
    row.verb("replay late 1", &["identical to the recorded episode"]);
    row.verb("run TASK -n 3 --seed 3 --twins --design uniform --out twins", &["3 nominal twins", "Control arm"]);
    assert_eq!(row.json("twins/twins.json")["pairs"], 3);
}

fn gate(row: &Row) {
    let gate = "gate TASK --requirements requirements.toml --suite suite.toml";
    row.verb(&format!("{gate} --out gate"), &["PASS"]);
    row.verb("evidence gate proof", &[]);
    row.verb("verify proof --rerun 1", &[]);
    row.verb(
        "fleet TASK --units 1 --rounds 1 --fixed --requirements requirements.toml --suite suite.toml --out fleet",
        &[],
    );
    let fleet = row.json("fleet/fleet-result.json").to_string();
    assert!(fleet.contains("unit_bias_1_rad") && fleet.contains("grip_force_scale"));
    // The expert and random actions act through the profile of a model that commands the tool.
    let policy = idle();
    let line = format!("{gate} --policy {policy} --profile pi0-libero --controls 1 --out controls --task {}", row.task);
    let output = robogate_in(row.at(), &line.replace("TASK ", "").split(' ').collect::<Vec<_>>());
    let controls = &row.json("controls/gate.json")["controls"];
    for (control, successes) in [("expert", 1), ("positive", 1), ("negative", 0)] {
        assert_eq!(controls[control]["successes"], successes, "{control}: {controls}\n{}", text(&output));
    }
}

fn demos(row: &Row) {
    row.verb("demos TASK -n 2 --size 16 --all --out demos", &["2 episodes"]);
}

/// A claim of the task itself.
fn check_physics(row: &Row) {
    let claim = match row.task {
        "pick_place" => "cup_area --robot ur5e",
        "stacking" => "overhang",
        _ => "ideal_peg",
    };
    row.verb(&format!("check physics TASK {claim}"), &["holds"]);
}

/// A server that scores itself, and one that only computes physics, give the rows of the built-in engine.
fn serve(row: &Row) {
    for robot in ["franka", "ur5e"] {
        let run = format!("run TASK --robot {robot} -n 2 --seed 5 --design uniform");
        row.verb(&format!("{run} --out local-{robot}"), &[]);
        let local = row.rows(&format!("local-{robot}"));
        for (name, more) in [("scored", &[][..]), ("physics", &["--physics-only"])] {
            let arguments = [&["--task", row.task, "--robot", robot], more].concat();
            let server = Server::start(&arguments);
            let (address, run_name) = (&server.address, format!("{name}-{robot}"));
            let task = if name == "physics" { run.clone() } else { run.replace(&format!("TASK --robot {robot} "), "") };
            row.verb(&format!("{task} --simulator {address} --out {run_name}"), &[]);
            assert_eq!(row.rows(&run_name), local, "{run_name}");
            let cell = if name == "physics" { format!(" TASK --robot {robot}") } else { String::new() };
            row.verb(&format!("check bridge {address}{cell}"), &["pass"]);
        }
    }
}

fn cameras(row: &Row) {
    row.verb("replay TASK --scenario 0 --size 32 --out pictures", &["front"]);
    let line = format!("run --task {} --renderer egl -n 1 --out egl", row.task);
    let output = robogate_in(row.at(), &line.split(' ').collect::<Vec<_>>());
    let printed = text(&output);
    if output.status.code() != Some(0) && printed.contains("EGL") {
        return robogate_testing::skip("egl", &printed);
    }
    assert_eq!(output.status.code(), Some(0), "{printed}");
    row.verb("replay egl 0", &["identical to the recorded episode"]);
}

/// Newton in its own process.
struct Newton {
    child: Child,
    address: String,
}

impl Newton {
    fn start(python: &Path) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        // The environment of the interpreter, in which bridges/newton/test.sh keeps compiled kernels.
        let kernels = python.ancestors().nth(2).map_or_else(PathBuf::new, |venv| venv.join("kernels"));
        let mut child = Command::new(python)
            .args(["-m", "robogate_newton", "--port", "0"])
            .env(
                "PYTHONPATH",
                std::env::join_paths(["bridges/newton", "bridges/common"].map(|at| root.join(at))).unwrap(),
            )
            .env("WARP_CACHE_PATH", kernels)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
        let listening = lines.find(|line| line.contains("listening")).unwrap_or_default();
        let address = serde_json::from_str::<Value>(&listening).unwrap()["listening"].as_str().unwrap().to_owned();
        Self { child, address }
    }
}

impl Drop for Newton {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// The controller succeeds in Newton where everything is nominal.
fn newton(row: &Row) {
    let wanted = "the Python of bridges/newton";
    let Some(python) = robogate_testing::path("ROBOGATE_NEWTON_PYTHON", wanted) else { return };
    let newton = Newton::start(&python);
    let gate =
        format!("--simulator {} --requirements requirements.toml --suite suite.toml --out newton", newton.address);
    row.verb(&format!("gate TASK {gate}"), &["PASS", "newton"]);
}

fn every_verb(task: &'static str) {
    let row = Row::new(task);
    for cell in [run, options, gate, demos, check_physics, serve, cameras] {
        cell(&row);
    }
}

#[test]
fn pick_and_place_has_every_verb() {
    every_verb("pick_place");
}

#[test]
fn stacking_has_every_verb() {
    every_verb("stacking");
}

#[test]
fn insertion_has_every_verb() {
    every_verb("insertion");
}

/// A task is chosen for a server that computes physics, and not for one that has its own.
#[test]
fn servers_with_a_task_keep_it() {
    let dir = TempDir::new().unwrap();
    let scored = Server::start(&["--task", "stacking"]);
    let line = |address: &str, task: &str| format!("run --task {task} --simulator {address} -n 2 --out x");
    verb(dir.path(), &line(&scored.address, "insertion"), 2, &["--task insertion", "its own task, stacking"]);
    let physics = Server::start(&["--physics-only"]);
    verb(dir.path(), &line(&physics.address, "pendulum"), 2, &["--simulator cannot be used with pendulum"]);
    assert!(!dir.path().join("x").exists());
}

#[test]
fn newton_runs_every_task() {
    for task in ["pick_place", "stacking", "insertion"] {
        newton(&Row::new(task));
    }
}
