//! End-to-end tests of environments in Python: a user's own, and Meta-World. They need a Python with Meta-World, which
//! `scripts/test.sh` installs.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// A Python with Meta-World, and a folder for the test.
struct Bench {
    python: PathBuf,
    dir: TempDir,
}

impl Bench {
    /// `None` if there is no such Python.
    fn new() -> Option<Self> {
        let python =
            robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with Meta-World, pyzmq and msgpack")?;
        Some(Self { python, dir: TempDir::new().unwrap() })
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        command.args(arguments.split(' ')).current_dir(&self.dir).env("ROBOGATE_CACHE_DIR", self.at("cache"));
        command.args(["--python".as_ref(), self.python.as_os_str()]);
        command
    }

    /// Runs the command and checks its exit code and output. Returns all of its output.
    fn robogate(&self, arguments: &str, code: i32, parts: &[&str]) -> String {
        let output = self.command(arguments).output().unwrap();
        let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "{arguments}: {text}");
        for part in parts {
            assert!(text.contains(part), "{arguments} does not say {part:?}: {text}");
        }
        text
    }

    fn rows(&self, run: &str) -> Vec<u8> {
        fs::read(self.at(run).join("dictionary.parquet")).unwrap()
    }

    /// Writes the example of docs/environments.md, with `changes` to its text.
    fn example(&self, name: &str, changes: &[(&str, &str)]) {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/environments.md");
        let page = fs::read_to_string(page).unwrap();
        let mut code = page.split("```python\n").nth(1).unwrap().split("```").next().unwrap().to_owned();
        for (from, to) in changes {
            assert!(code.contains(from), "{from:?} is not in the example");
            code = code.replace(from, to);
        }
        fs::write(self.at(name), code).unwrap();
    }
}

/// The example of the documentation passes through all verbs.
#[test]
fn own_environment_runs_from_one_file() {
    let Some(bench) = Bench::new() else { return };
    bench.example("reach.py", &[]);
    bench.robogate(
        "env inspect reach.py --space space.toml",
        0,
        &["drag", "action_delay", "steer", "deterministic   yes"],
    );
    bench.robogate("run --env reach.py -n 60 --seed 3 --threads 2 --out two", 0, &["reach", "steer policy"]);
    bench.robogate("run --env reach.py -n 60 --seed 3 --threads 1 --out one", 0, &[]);
    assert!(bench.rows("two") == bench.rows("one"), "rows depend on the number of servers");
    bench.robogate("replay two 7", 0, &["identical to the recorded episode", "distance_m"]);
    bench.robogate("resume two", 0, &[]);
    bench.robogate("run --env reach.py --space space.toml --policy random -n 30 --out random", 0, &["random policy"]);
    bench.robogate("gate --env reach.py --out gate --threads 2", 1, &["FAIL"]);
    bench.robogate("run --env reach.py --policy expert -n 30", 2, &["declares no such policy", "steer"]);
    bench.robogate("run --env missing.py -n 30", 2, &["missing.py: no such file"]);
    bench.robogate("run --env nothing:here -n 30", 2, &["no such environment", "metaworld"]);
}

#[test]
fn expert_opens_the_drawer() {
    let Some(bench) = Bench::new() else { return };
    let parts = ["expert", "friction_drawer_link", "final_distance_m", "deterministic   yes"];
    bench.robogate("env inspect metaworld:drawer-open-v3", 0, &parts);
    bench.robogate(
        "run --env metaworld:drawer-open-v3 -n 8 --seed 5 --threads 2 --out run",
        0,
        &["expert policy", "mujoco/metaworld"],
    );
    bench.robogate("replay run 2", 0, &["identical to the recorded episode"]);
    bench.robogate("run --env metaworld:fly-v3 -n 8", 2, &["fly-v3: unknown task", "drawer-open-v3"]);
}

/// What an environment does wrong makes single episodes invalid. The server is started again, and its output is shown.
#[test]
fn faults_are_shown_and_survived() {
    let Some(bench) = Bench::new() else { return };
    let act = "        self.speed += 0.05 * (4.0 * action - self.drag * self.speed)\n";
    let when = |what: &str| format!("        if 2.0 < self.drag < 2.5:\n            {what}\n{act}");
    let run = |name: &str, what: &str, parts: &[&str]| {
        bench.example(&format!("{name}.py"), &[(act, &when(what))]);
        let arguments = format!("run --env {name}.py -n 30 --seed 3 --threads 2 --simulator-timeout 3 --out {name}");
        let text = bench.robogate(&arguments, 0, parts);
        assert!(text.contains("invalid"), "{text}");
    };
    run("raises", "raise RuntimeError('the gripper is stuck')", &["the gripper is stuck"]);
    run("killed", "import os; print('last words', flush=True); os.kill(os.getpid(), 9)", &["last words", "signal: 9"]);
    run("hangs", "import time; time.sleep(3600)", &["started again after this failure"]);
    run("nan", "self.place[:] = np.nan", &[]);

    bench.example("lacks.py", &[("import gymnasium,", "import no_such_package, gymnasium,")]);
    bench.robogate("run --env lacks.py -n 30", 2, &["the Python package no_such_package is missing"]);
    bench.example("breaks.py", &[("    make=Reach,", "    make=lambda: 1 / 0,")]);
    bench.robogate("run --env breaks.py -n 30", 5, &["does not start", "ZeroDivisionError"]);
}

/// No process is left behind when the command is killed.
#[test]
fn servers_end_with_the_command() {
    let Some(bench) = Bench::new() else { return };
    bench.example("reach.py", &[]);
    let mut child =
        bench.command("run --env reach.py -n 1500 --threads 2 --out run").stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().starts_with("uniform")), "no progress was reported");
    let servers = children(child.id());
    assert_eq!(servers.len(), 2);
    child.kill().unwrap();
    child.wait().unwrap();
    let began = Instant::now();
    while servers.iter().any(|server| running(*server)) {
        assert!(began.elapsed() < Duration::from_secs(20), "a server is left");
        sleep(Duration::from_millis(20));
    }
}

/// The child processes of a process.
fn children(parent: u32) -> Vec<u32> {
    let mut found = Vec::new();
    for entry in fs::read_dir("/proc").unwrap() {
        let Some(process) = entry.unwrap().file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        // The parent is the second field after the name, which is in parentheses.
        let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        let fields = stat.rsplit(')').next().unwrap_or_default();
        if fields.split_whitespace().nth(1) == Some(&parent.to_string()) {
            found.push(process);
        }
    }
    found
}

fn running(process: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let state = stat.rsplit(')').next().unwrap_or_default().split_whitespace().next().unwrap_or("X").to_owned();
    !matches!(&*state, "X" | "Z")
}
