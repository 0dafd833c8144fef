//! Remote simulators on the command line: `robogate serve`, `--simulator`, `robogate check bridge`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::harness::{assert_exit, text};

/// A `robogate serve` that ends with the test.
pub(crate) struct Server {
    child: Child,
    pub(crate) address: String,
}

impl Server {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(["serve", "--bind", "tcp://127.0.0.1:*"])
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let line: serde_json::Value = serde_json::from_str(&line).unwrap();
        Self { child, address: line["listening"].as_str().unwrap().to_owned() }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// The rows of a run as CSV.
fn rows(dir: &Path) -> String {
    let out = dir.join("rows.csv");
    assert_exit(&["export", dir.to_str().unwrap(), out.to_str().unwrap()], 0, &[]);
    fs::read_to_string(out).unwrap()
}

#[test]
fn remote_and_local_rows_are_equal() {
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name);
    let run = |name: &str, more: &[&str]| {
        let out = at(name);
        let arguments = [&["run", "-n", "6", "--seed", "5", "--out", out.to_str().unwrap()], more].concat();
        assert_exit(&arguments, 0, &[]);
        rows(&out)
    };
    let local = run("local", &[]);
    for (name, more) in [("scored", &[][..]), ("physics", &["--physics-only"])] {
        let (one, other) = (Server::start(more), Server::start(more));
        let pool = format!("{},{}", one.address, other.address);
        assert_eq!(run(name, &["--simulator", &pool]), local, "{name}");
        let folder = at(name).to_str().unwrap().to_owned();
        assert_exit(&["replay", &folder, "3", "--simulator", &one.address], 0, &["identical to the recorded episode"]);
        assert_exit(&["replay", &folder, "3"], 2, &["--simulator"]);
        assert_exit(&["check", "bridge", &one.address], 0, &["pass", "median"]);
    }
    let folder = at("local").to_str().unwrap().to_owned();
    let server = Server::start(&[]);
    assert_exit(&["replay", &folder, "3", "--simulator", &server.address], 2, &["without --simulator"]);
}

#[test]
fn python_script_drives_the_cell() {
    let wanted = "a Python with pyzmq and msgpack";
    let Some(python) = robogate_testing::path("ROBOGATE_BRIDGE_PYTHON", wanted) else { return };
    let server = Server::start(&[]);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let output = Command::new(python)
        .arg(root.join("bridges/examples/drive.py"))
        .args([&server.address, "-n", "2"])
        .env("PYTHONPATH", root.join("bridges/common"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output));
    assert_eq!(String::from_utf8_lossy(&output.stdout), "episode 0: success\nepisode 1: success\n");
}

#[test]
fn wrong_usage_starts_nothing() {
    assert_exit(&["serve", "--bind", "tcp://0.0.0.0:*"], 2, &["other machines", "--allow-remote"]);
    assert_exit(&["serve", "--bind", "127.0.0.1:1"], 2, &["tcp://127.0.0.1:5570"]);
    assert_exit(&["run", "--simulator", "tcp://127.0.0.1:1"], 5, &["cannot reach tcp://127.0.0.1:1"]);
    assert_exit(&["check", "bridge", "tcp://127.0.0.1:1"], 5, &["cannot reach"]);
    let server = Server::start(&["--robot", "ur5e"]);
    let address = server.address.as_str();
    assert_exit(&["run", "--simulator", address, "--robot", "franka"], 2, &["another robot", "--robot"]);
    assert_exit(&["run", "--simulator", address, "--engine", "mujoco"], 2, &["cannot be used with"]);
    let twice = format!("{address},{address}");
    assert_exit(&["run", "--robot", "ur5e", "--simulator", &twice], 2, &["twice"]);
}
