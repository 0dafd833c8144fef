//! End-to-end tests of environments in Python: a user's own, and Meta-World. They need a Python with Meta-World, which
//! `scripts/test.sh` installs.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use tungstenite::Message;

use crate::openpi;

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
        if !["evidence ", "verify "].iter().any(|verb| arguments.starts_with(verb)) {
            command.args(["--python".as_ref(), self.python.as_os_str()]);
        }
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

    /// Writes the example of docs/guides/environments.md, with `changes` to its text.
    fn example(&self, name: &str, changes: &[(&str, &str)]) {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guides/environments.md");
        let page = fs::read_to_string(page).unwrap();
        let mut code = page.split("```python\n").nth(1).unwrap().split("```").next().unwrap().to_owned();
        for (from, to) in changes {
            assert!(code.contains(from), "{from:?} is not in the example");
            code = code.replace(from, to);
        }
        fs::write(self.at(name), code).unwrap();
    }
}

#[test]
fn setup_asks_first_for_what_pip_cannot_install() {
    let Some(bench) = Bench::new() else { return };
    let mut command = bench.command("env setup libero");
    let output = command.env_remove("PYTHONPATH").output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("pip cannot install it") && text.contains("export PYTHONPATH=$PWD/LIBERO"), "{text}");
    assert!(!bench.at("cache/environments").exists(), "nothing is created");
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
    bench.robogate("evidence gate evidence --safety-case", 1, &[]);
    bench.robogate("verify evidence", 0, &[]);
    let argument = fs::read_to_string(bench.at("evidence/safety-case.gsn.yaml")).unwrap();
    let of = |name: &str| argument.split(&format!("\n{name}:\n")).nth(1).unwrap().lines().nth(1).unwrap().to_owned();
    assert!(
        of("G-requirements").ends_with("\"not supported\"") && of("CG-other-environment").ends_with("\"open\""),
        "{argument}"
    );
    bench.robogate("run --env reach.py --policy expert -n 30", 2, &["declares no such policy", "steer"]);
    bench.robogate("run --env missing.py -n 30", 2, &["missing.py: no such file"]);
    bench.robogate("run --env nothing:here -n 30", 2, &["no such environment", "metaworld"]);
}

/// A run is bound to all files that its environment imported, and keeps copies of them.
#[test]
fn helpers_of_an_environment_are_part_of_it() {
    let Some(bench) = Bench::new() else { return };
    let (import, gain) = ("import gymnasium,", "0.05 * (4.0 * action");
    bench.example("reach.py", &[(import, "import helper, gymnasium,"), (gain, "0.05 * (helper.GAIN * action")]);
    fs::write(bench.at("helper.py"), "GAIN = 4.0\n").unwrap();
    bench.robogate("run --env reach.py -n 30 --seed 3 --threads 2 --out run", 0, &[]);
    let plan: serde_json::Value = serde_json::from_slice(&fs::read(bench.at("run/plan.json")).unwrap()).unwrap();
    let place = &plan["provenance"]["world"]["place"];
    assert_eq!(place["files"].as_object().unwrap().keys().collect::<Vec<_>>(), ["helper.py", "reach.py"]);
    assert!(place["packages"]["gymnasium"].is_string() && place["packages"]["numpy"].is_string(), "{place}");
    bench.robogate("evidence run evidence --requirements default", 1, &[]);
    assert_eq!(fs::read_to_string(bench.at("evidence/environment/helper.py")).unwrap(), "GAIN = 4.0\n");

    fs::write(bench.at("helper.py"), "GAIN = 0.5\n").unwrap();
    bench.robogate("resume run", 2, &["the environment's file helper.py has changed since the run"]);
    bench.robogate("replay run 7 --env reach.py", 2, &["file helper.py has changed since the run"]);
    // Only the copies are those of the run.
    bench.robogate("replay run 7", 0, &["its copies are used", "identical to the recorded episode"]);
    fs::write(bench.at("run/environment/helper.py"), "GAIN = 0.6\n").unwrap();
    bench.robogate("replay run 7", 2, &["file helper.py has changed since the run"]);
    fs::write(bench.at("evidence/environment/helper.py"), "GAIN = 0.7\n").unwrap();
    bench.robogate("verify evidence", 4, &["helper.py"]);
    fs::write(bench.at("helper.py"), "GAIN = 4.0\n").unwrap();
    bench.robogate("resume run", 0, &[]);
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
    run("hangs", "import time; time.sleep(3600)", &["started again after this failure", "time.sleep(3600)"]);
    run("nan", "self.place[:] = np.nan", &[]);

    bench.example("lacks.py", &[("import gymnasium,", "import no_such_package, gymnasium,")]);
    bench.robogate("run --env lacks.py -n 30", 2, &["the Python package no_such_package is missing"]);
    bench.example("breaks.py", &[("    make=Reach,", "    make=lambda: 1 / 0,")]);
    bench.robogate("run --env breaks.py -n 30", 5, &["does not start", "ZeroDivisionError"]);
}

/// Equal seeds give other episodes in another process or order. The verdict says so, and nothing is paired.
#[test]
fn episodes_that_do_not_repeat_are_named() {
    let Some(bench) = Bench::new() else { return };
    let target = "        self.target = self.np_random.uniform(-1.0, 1.0, 2)\n";
    let import = ("import gymnasium,", "import gymnasium, os,");
    let process = target.replace("-1.0, 1.0, 2)", "-1.0, 1.0, 2) + 1e-3 * (os.getpid() % 97)");
    bench.example("process.py", &[(target, &process), import]);
    let cause = "episodes that ran twice had another start";
    // Within one process, the same seed gives the same episode.
    bench.robogate("env inspect process.py", 0, &["deterministic   yes"]);
    bench.robogate("gate --env process.py --rounds 1 --out process", 4, &["INVALID", cause]);
    assert!(!bench.at("process/dictionary.parquet").exists(), "episodes ran that are no evidence");

    let act = "        self.speed += 0.05 * (4.0 * action - self.drag * self.speed)\n";
    let worn = format!("{act}        Reach.worn += 1\n        self.speed *= 1.0 - 1e-9 * Reach.worn\n");
    bench.example("worn.py", &[(act, &worn), ("    drag = 1.0\n", "    drag = 1.0\n    worn = 0\n")]);
    let late = "had the same start and another trajectory. The rate holds if that is noise";
    let text = bench.robogate("gate --env worn.py --rounds 1 --fixed --out worn", 1, &["FAIL"]);
    assert!(text.split_whitespace().collect::<Vec<_>>().join(" ").contains(late), "{text}");
    let judged = fs::read_to_string(bench.at("worn/gate.md")).unwrap();
    assert!(judged.contains(late), "{judged}");
    let refused =
        "the policies cannot be compared episode by episode: in the run of steer, episodes depend on the order";
    bench.robogate("gate --env worn.py --against random", 2, &[refused]);
    bench.robogate("gate --env worn.py --baseline worn", 2, &[refused]);
    bench.robogate("gate --env worn.py --twins", 2, &[refused]);
    for policy in ["steer", "random"] {
        bench.robogate(&format!("run --env worn.py --policy {policy} -n 20 --seed 3 --out worn-{policy}"), 0, &[late]);
    }
    let text = bench.robogate("compare worn-steer worn-random --paired", 2, &["make no pairs: episodes depend on"]);
    assert!(text.contains("without --paired they are compared as independent runs"), "{text}");

    // Every second episode of a process fails, which the observations do not show.
    let reset = "        super().reset(seed=seed)\n";
    let counts = format!("{reset}        Reach.number += 1\n");
    let done = ("\"success\": bool(done)", "\"success\": bool(done) and Reach.number % 2 == 0");
    bench.example("counts.py", &[(reset, &counts), done, ("    drag = 1.0\n", "    drag = 1.0\n    number = 0\n")]);
    let carried = "carries something from one episode to the next";
    let text = bench.robogate("gate --env counts.py --rounds 1 --out counts", 4, &["INVALID", "from the same start"]);
    assert!(text.contains(carried), "{text}");

    // A process wears out long after the episodes that run twice before the gate.
    let done = ("\"success\": bool(done)", "\"success\": bool(done) and Reach.number < 24");
    bench.example("worn_out.py", &[(reset, &counts), done, ("    drag = 1.0\n", "    drag = 1.0\n    number = 0\n")]);
    let text =
        bench.robogate("gate --env worn_out.py --rounds 1 --out worn-out", 4, &["INVALID", "after the last one"]);
    assert!(text.contains(carried), "{text}");
    bench.robogate("gate --run worn-out", 4, &["INVALID", carried]);
    bench.robogate("evidence worn-out worn-evidence", 4, &["invalid: ", carried]);
    bench.robogate("verify worn-evidence", 0, &["verdict invalid", carried]);

    bench.example("reach.py", &[]);
    let text = bench.robogate("gate --env reach.py --rounds 1 --fixed --out same", 1, &["repeating a few episodes"]);
    assert!(!text.contains("Repetition"), "{text}");
    // It has no cameras: the page shows the episodes by their signals.
    let page = fs::read_to_string(bench.at("same/report.html")).unwrap();
    assert!(!page.contains("is not shown:"), "an episode is missing");
}

/// The rate of the environment as its author made it stands beside the varied one.
#[test]
fn nominal_rate_is_stated() {
    let Some(bench) = Bench::new() else { return };
    let slow = ("\"drag\": (0.0, 4.0), \"action_delay\": (0, 12)", "\"action_delay\": (8, 12)");
    bench.example("slow.py", &[slow]);
    let nominal = "With nothing varied, success is 100.0 % (10 of 10 episodes";
    let text = bench.robogate("run --env slow.py -n 100 --seed 3 --threads 2 --out run", 0, &[nominal]);
    assert!(text.contains("success  0.0 %  over the operating space"), "{text}");
    assert!(fs::read_to_string(bench.at("run/report.html")).unwrap().contains("With nothing varied, success is"));
    fs::remove_dir_all(bench.at("run/unvaried")).unwrap();
    bench.robogate("resume run", 0, &[]);
    assert!(bench.at("run/unvaried/dictionary.parquet").is_file());
    let text = bench.robogate("run --env slow.py -n 40 --seed 3 --nominal-episodes 0 --out none", 0, &[]);
    assert!(!text.contains("With nothing varied"), "{text}");
    bench.robogate("run --env slow.py --nominal -n 12 --seed 3 --out only", 0, &["100.0 %", "12 of 12"]);
    let nominal = "With nothing varied, success is 100.0 % (20 of 20 episodes";
    bench.robogate("gate --env slow.py --seed 4 --out varied", 1, &["FAIL", nominal]);
    for file in ["gate.md", "gate.json"] {
        let text = fs::read_to_string(bench.at("varied").join(file)).unwrap();
        assert!(text.contains("With nothing varied") || text.contains("\"nominal\": {"), "{file}: {text}");
    }
    bench.robogate("gate --env slow.py --seed 4 --nominal --out same", 0, &["PASS", "reach-nominal"]);
    bench.robogate("gate --run varied --nominal", 2, &["needs the control arm", "Hint: "]);
}

/// A policy in the process of the environment is asked by the start of some episodes.
#[test]
fn policy_in_the_environment_has_a_fingerprint() {
    let Some(bench) = Bench::new() else { return };
    let own = "    policies={\"steer\": Policy(steer, \"A proportional controller with damping.\")},\n";
    let two = "    policies={\"steer\": Policy(steer, \"A controller.\"), \"half\": Policy(lambda env: lambda o: 0.5 * steer(env)(o), \"Weaker.\")},\n";
    bench.example("two.py", &[(own, two)]);
    let gate = "gate --env two.py --seed 4 --policy steer --rounds 1 --controls 0";
    for threads in [1, 2] {
        let line = format!("{gate} --threads {threads} --out g{threads}");
        bench.command(&line).output().unwrap();
    }
    let bytes = |run: &str| fs::read(bench.at(run).join("fingerprint.msgpack")).unwrap();
    assert!(bytes("g1") == bytes("g2"), "the fingerprint depends on threads");
    bench.robogate("admit g1 --policy steer", 0, &["ADMITTED: steer answers as the judged policy", "8 requests"]);
    bench.robogate("admit g1 --policy half", 1, &["NOT ADMITTED: half"]);
    bench.robogate("admit g1 --policy ws://127.0.0.1:1", 2, &["runs in the process of its environment", "Hint: "]);
    bench.robogate("admit g1/fingerprint.msgpack --policy steer", 2, &["need the folder of the gate"]);
}

/// The first episodes fail in the same way. A script is warned and goes on.
#[test]
fn hopeless_run_is_named() {
    let Some(bench) = Bench::new() else { return };
    bench.example("far.py", &[("np.clip(3.0 * (o[4:] - o[:2]) - 1.5 * o[2:4], -1.0, 1.0)", "99.0 * np.ones(2)")]);
    let clipped = "the first 20 episodes have no success, and 100.0 % of the actions were outside of their range";
    bench.robogate("run --env far.py -n 30 --threads 2 --out far", 0, &["warning: ", clipped]);
    let text = bench.robogate("run --env far.py -n 30 --threads 2 --continue --out on", 0, &[]);
    assert!(!text.contains(clipped), "{text}");
    assert!(bench.rows("far") == bench.rows("on"), "rows depend on the warning");
    bench.robogate("run --env far.py -n 30 --policy sb3:none.zip", 2, &["--policy sb3:none.zip", "No such file"]);
    bench.robogate("run --env far.py -n 30 --policy lerobot:.", 2, &["not a checkpoint of LeRobot"]);
}

/// Most scenarios break the environment. The gate stops as soon as no result of the other rounds could pass.
#[test]
fn mostly_invalid_gate_stops_early() {
    let Some(bench) = Bench::new() else { return };
    let act = "        self.speed += 0.05 * (4.0 * action - self.drag * self.speed)\n";
    let breaks = |unless: &str| format!("{act}        if not {unless}:\n            self.place[:] = np.nan\n");
    let only_drag = ("\"drag\": (0.0, 4.0), \"action_delay\": (0, 12)", "\"drag\": (0.0, 4.0)");
    bench.example("mostly.py", &[(act, &breaks("0.7 < self.drag < 1.3")), only_drag]);
    let parts = [
        "INCONCLUSIVE  ",
        "episodes are invalid: no result of the other",
        "Most frequent cause, in ",
        "Fix the cause, and start a new gate",
        // "all 20", or "13 of 20": which episodes end first depends on the threads.
        "20 episodes so far are invalid",
    ];
    let gate = "gate --env mostly.py --seed 4";
    let text = bench.robogate(&format!("{gate} --threads 2 --out two"), 3, &parts);
    let [verdict, cause, table] =
        ["INCONCLUSIVE", "Most frequent cause", "requirement "].map(|part| text.find(part).unwrap());
    assert!(verdict < cause && cause < table, "the reason is not in the first lines: {text}");
    let text = bench.robogate(&format!("{gate} --threads 1 --out one"), 3, &parts);
    assert!(text.contains("of 20 episodes so far are invalid"), "{text}");
    assert!(bench.rows("two") == bench.rows("one"), "rows depend on the number of servers");
    let read = |run: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(bench.at(run).join("gate.json")).unwrap()).unwrap()
    };
    let found = read("two");
    let episodes = found["counts"]["episodes"].as_u64().unwrap();
    assert!((64..=256).contains(&episodes) && episodes.is_multiple_of(64), "{episodes}");
    assert_eq!(found["ruled_out"]["requirement"], "success");
    bench.robogate("resume two", 3, &["no result of the other"]);
    bench.robogate("gate --run two", 3, &["no result of the other"]);

    let text = bench.robogate(&format!("{gate} --twins --out twins"), 3, &["the control arm does not run"]);
    assert!(!bench.at("twins/nominal").exists(), "{text}");
    let verb = |arguments: &[&str], code: i32| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        let output = command.args(arguments).current_dir(&bench.dir).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(
            output.status.code(),
            Some(code),
            "{arguments:?}: {text}{}",
            String::from_utf8_lossy(&output.stderr)
        );
        text
    };
    // The plan of a run with twins says so: the rows alone are compared.
    let table = |run: &str| {
        verb(&["export", run, &format!("{run}.csv")], 0);
        fs::read(bench.at(&format!("{run}.csv"))).unwrap()
    };
    assert!(table("twins") == table("two"), "rows depend on the control arm");
    bench.robogate("resume twins", 3, &["no result of the other"]);
    assert!(!bench.at("twins/nominal").exists());

    bench.robogate(&format!("{gate} --fixed --out fixed"), 3, &parts);
    assert!(read("fixed")["counts"]["episodes"].as_u64().unwrap() <= 256);
    bench.robogate(&format!("{gate} --against random --out against"), 3, &["no result of the other"]);

    bench.robogate(&format!("{gate} --divide 2 --out shards"), 0, &[]);
    loop {
        let next = verb(&["plan", "shards", "--next"], 0);
        if next.is_empty() {
            break;
        }
        for command in next.lines() {
            bench.robogate(command.strip_prefix("robogate ").unwrap(), 0, &[]);
        }
    }
    verb(&["merge", "shards"], 3);
    assert!(bench.rows("shards") == bench.rows("two"), "shards give other rows");

    bench.example("never.py", &[(act, &breaks("self.drag == 1.0")), only_drag]);
    let parts = ["INVALID  ", "all 64 episodes are invalid; the other", "planned episodes did not run"];
    bench.robogate("gate --env never.py --seed 4 --out never", 4, &parts);
}

/// An environment that hangs before its first episode is ended after the timeout of the call, and the call is named.
#[test]
fn hanging_starts_are_ended() {
    let Some(bench) = Bench::new() else { return };
    let hang = |name: &str, before: &str, call: &str, timeout: &str| {
        let line = "import time; time.sleep(3600)  # it hangs";
        bench.example(&format!("{name}.py"), &[(before, &format!("{before}        {line}\n"))]);
        let late = format!("{call} in the check before the first episode did not end within");
        let parts = ["does not start", &*late, "--simulator-timeout", line];
        let began = Instant::now();
        bench.robogate(&format!("run --env {name}.py -n 30 --simulator-timeout {timeout}"), 5, &parts);
        assert!(began.elapsed() < Duration::from_secs(60), "{:?}", began.elapsed());
        let left = || {
            let processes = fs::read_dir("/proc").unwrap();
            let mut commands = processes.filter_map(|entry| fs::read(entry.ok()?.path().join("cmdline")).ok());
            commands.any(|command| String::from_utf8_lossy(&command).contains(name))
        };
        while left() {
            assert!(began.elapsed() < Duration::from_secs(90), "a process is left");
            sleep(Duration::from_millis(20));
        }
    };
    hang("hangs_in_step", "    def step(self, action):\n", "`step`", "1");
    hang("hangs_in_reset", "        super().reset(seed=seed)\n", "`reset`", "0.5");
    // The hint names an argument that `env inspect` has as well.
    bench.robogate(
        "env inspect hangs_in_reset.py --simulator-timeout 0.5",
        5,
        &["did not end within 2 s", "--simulator-timeout"],
    );
}

/// A profile of a policy that knows nothing of the environment: a state of six numbers in another order and unit, an
/// image, and an action of three numbers.
const STEERING: &str = r#"
name = "steering"
model = "A proportional controller behind a server"
[dialect]
name = "openpi"
[[camera]]
from = "front"
key = "image"
width = 8
height = 8
[[state]]
key = "state"
vectors = ["goal", "place", "speed"]
[action]
size = 3
arm = "vector"
[chunk]
length = 1
execute = 1
[server]
attempts = 1
"#;

/// The map of the example environment, with a camera, to that profile. The goal is in centimetres.
const MAP: &str = r#"
[vectors]
goal = { from = "state[4:6]", scale = 100.0 }
place = { from = "state[:2]", scale = 100.0 }
speed = ["state[2]", "state[3]"]
[cameras]
front = { from = "view", orientation = "flipped" }
[action]
action_0 = "action[2]"
action_1 = { from = "action[1]", scale = -1.0 }
"#;

/// The example environment with a Dict observation that contains an image, without its own policy.
fn with_view(bench: &Bench) {
    bench.example(
        "view.py",
        &[
            (
                "gymnasium.spaces.Box(-10.0, 10.0, (6,))",
                "gymnasium.spaces.Dict(state=gymnasium.spaces.Box(-10.0, 10.0, (6,)), view=gymnasium.spaces.Box(0, 255, (8, 8, 3), np.uint8))",
            ),
            (
                "return np.concatenate([self.place, self.speed, self.target])",
                "image = np.zeros((8, 8, 3), np.uint8)\n        image[0] = 200\n        \
                 return {'state': np.concatenate([self.place, self.speed, self.target]), 'view': image}",
            ),
            ("t.observation[4:] - t.observation[:2]", "t.observation['state'][4:] - t.observation['state'][:2]"),
            ("    policies={\"steer\": Policy(steer, \"A proportional controller with damping.\")},\n", ""),
        ],
    );
}

/// Serves a policy in openpi's dialect. It gets a function that returns the bytes of an input by its name, and answers with
/// one action.
fn served<const N: usize>(policy: impl Fn(&dyn Fn(&str) -> Vec<u8>) -> [f64; N] + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    openpi::serve(listener, move |_, socket| {
        while let Ok(message) = socket.read() {
            if !message.is_binary() {
                continue;
            }
            let request = rmpv::decode::read_value(&mut &*message.into_data()).unwrap();
            let field = |array: &rmpv::Value, name: &str| {
                let map = array.as_map().unwrap();
                let same = |key: &rmpv::Value| key.as_str() == Some(name) || key.as_slice() == Some(name.as_bytes());
                map.iter().find(|(key, _)| same(key)).unwrap().1.clone()
            };
            let action = policy(&|name| field(&field(&request, name), "data").as_slice().unwrap().to_vec());
            if socket.send(Message::binary(openpi::actions(1, N, |_, number| action[number]))).is_err() {
                break;
            }
        }
        ControlFlow::Continue(())
    });
    url
}

/// The numbers of an array of double precision.
fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks::<8>().0.iter().map(|number| f64::from_le_bytes(*number)).collect()
}

/// Serves the controller of the example to that profile, and checks what it receives.
fn steering() -> String {
    served(|input| {
        // The bright row of the flipped image is the last one.
        let image = input("image");
        assert!(image[..24] == [0; 24] && image[7 * 24..] == [200; 24]);
        let state = doubles(&input("state"));
        let [goal_x, goal_y, x, y, dx, dy] = *state else { panic!("{state:?}") };
        let (x, y) = (0.03 * (goal_x - x) - 1.5 * dx, 0.03 * (goal_y - y) - 1.5 * dy);
        [0.7, -y, x]
    })
}

/// A server and a network that know nothing of an environment drive it through a map.
#[test]
fn maps_connect_any_policy() {
    let Some(bench) = Bench::new() else { return };
    with_view(&bench);
    fs::write(bench.at("profile.toml"), STEERING).unwrap();
    fs::write(bench.at("map.toml"), MAP).unwrap();
    let url = steering();
    let check = format!("policy check {url} --profile profile.toml --env view.py --requests 2");
    let parts = ["state (6)", "view (8 x 8)", "action_0 (-1 to 1), action_1 (-1 to 1)", "problem:", "Hint: --map FILE"];
    bench.robogate(&check, 1, &parts);
    let parts = [
        "state[0:2]    goal",
        "100 state[4:6]",
        "view, 8 x 8, flipped",
        "action_1 = -action[1] (-1 to 1)",
        "not used",
        "environment repeats    yes",
        // The first number has no effect.
        "number 0 of the action changes no observation",
    ];
    bench.robogate(&format!("{check} --map map.toml"), 1, &parts);
    let run = format!("run --env view.py --policy {url} --profile profile.toml -n 20 --seed 3 --threads 2");
    bench.robogate(
        &run,
        2,
        &["cannot drive this environment", "uses the camera `front`", "the task has view", "--map"],
    );
    fs::write(bench.at("wrong.toml"), MAP.replace("state[4:6]", "state[4:9]")).unwrap();
    bench.robogate(
        &format!("{run} --map wrong.toml"),
        2,
        &["vectors.goal: `state[4:9]`: out of range, because `state` has 6 numbers"],
    );
    let text = bench.robogate(&format!("{run} --map map.toml --out mapped"), 0, &["steering policy"]);
    assert!(!text.contains("invalid"), "{text}");
    let summary = fs::read_to_string(bench.at("mapped/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert!(summary["estimate"]["success_rate"].as_f64().unwrap() > 0.2, "{text}");
    // The map is part of the record.
    bench.robogate("replay mapped 7", 0, &["identical to the recorded episode"]);
    bench.robogate("run --env view.py --policy random --map map.toml -n 20", 2, &["--profile"]);
}

/// A model that moves the tool 20 times per second with seven numbers, as models for LIBERO do. Each number is of 40 mm.
const TOOL_MOTION: &str = r#"
name = "tool-motion"
model = "A controller of drawers that moves the tool"
[dialect]
name = "openpi"
[[state]]
key = "state"
parts = ["tool_position", "gripper_opening"]
vectors = ["handle"]
[action]
size = 7
arm = "tool_delta"
rotation = "axis_angle"
position_scale_m = 0.04
rotation_scale_rad = 0.5
clip = 1.0
control_hz = 20.0
gripper_threshold = 0.0
gripper_open = "below"
[chunk]
length = 1
execute = 1
"#;

/// The map of Meta-World to it, with 80 actions per second of up to 10 mm.
const SAWYER: &str = r#"
[vectors]
tool_pose = ["observation[0:3]", 0, 1, 0, 0]
gripper_opening = { from = "observation[3]", scale = 0.1 }
handle = "observation[4:7]"
[action]
x = { from = "x", scale = 100.0 }
y = { from = "y", scale = 100.0 }
z = { from = "z", scale = 100.0 }
gripper = "gripper"
"#;

/// Opens the drawer: above the handle, down to it, and back.
fn opening_drawers() -> String {
    served(|input| {
        let state = doubles(&input("state"));
        let [x, y, z, _, handle_x, handle_y, handle_z] = *state else { panic!("{state:?}") };
        let handle_z = handle_z - 0.02;
        let ([away_y, up_z], gain) = if (x - handle_x).hypot(y - handle_y) > 0.06 {
            ([0.0, 0.3], 4.0)
        } else if (z - handle_z).abs() > 0.04 {
            ([0.0, 0.0], 4.0)
        } else {
            ([-0.06, 0.0], 50.0)
        };
        let motion =
            [handle_x - x, handle_y + away_y - y, handle_z + up_z - z].map(|error| (gain * error).clamp(-1.0, 1.0));
        [motion[0], motion[1], motion[2], 0.0, 0.0, 0.0, -1.0]
    })
}

/// Seven numbers of a model that moves the tool become the four of Meta-World. The controls of a gate act in the same way.
#[test]
fn tool_motions_drive_meta_world() {
    let Some(bench) = Bench::new() else { return };
    fs::write(bench.at("profile.toml"), TOOL_MOTION).unwrap();
    fs::write(bench.at("map.toml"), SAWYER).unwrap();
    let suite = "schema = 1\nname = \"two\"\nversion = \"1.0.0\"\ndescription = \"Two.\"\ndefaults = { action_delay = 0 }\n\
                 [[group]]\nname = \"plain\"\ncategory = \"nominal\"\nscenarios = [{ id = \"a\" }, { id = \"b\", action_delay = 2 }]\n";
    fs::write(bench.at("suite.toml"), suite).unwrap();
    let requirements = "name = \"half\"\nmode = \"point\"\n[[requirement]]\nmetric = \"success\"\nat_least = 0.5\n";
    fs::write(bench.at("requirements.toml"), requirements).unwrap();
    let policy =
        format!("--env metaworld:drawer-open-v3 --policy {} --profile profile.toml --map map.toml", opening_drawers());
    let gate = format!(
        "gate {policy} --suite suite.toml --requirements requirements.toml --rounds 3 --controls 4 --threads 1 --out gate"
    );
    let text = bench.robogate(&gate, 0, &["PASS"]);
    let evaluation: serde_json::Value = serde_json::from_slice(&fs::read(bench.at("gate/gate.json")).unwrap()).unwrap();
    let control = |name: &str| evaluation["controls"][name]["successes"].as_u64();
    assert_eq!([control("expert"), control("positive"), control("negative")], [Some(4), Some(4), Some(0)], "{text}");
    assert_eq!(evaluation["results"][0]["figure"]["estimate"].as_f64().unwrap_or(1.0), 1.0, "{evaluation}");
    bench.robogate("replay gate 3", 0, &["identical to the recorded episode"]);
    // With the wrong sign of one axis the expert fails through the profile, and the policy is not judged.
    fs::write(
        bench.at("map.toml"),
        SAWYER.replace("x = { from = \"x\", scale = 100.0 }", "x = { from = \"y\", scale = 100.0 }"),
    )
    .unwrap();
    let broken = gate.replace("--out gate", "--out broken");
    bench.robogate(&broken, 4, &["INVALID"]);
}

/// A network that sees a camera of Meta-World's model, and eight numbers of the observation.
const LOOKING: &str = r#"
name = "looking"
model = "A network of one layer, for tests"
[dialect]
name = "onnx"
[[camera]]
from = "front"
key = "front"
width = 8
height = 8
fit = "stretch"
[[state]]
key = "state"
vectors = ["pose"]
type = "<f4"
[action]
size = 8
arm = "vector"
[chunk]
length = 2
execute = 2
"#;

/// A network in a file sees the environment and drives it. Rendering takes most of the time, so the camera is the plain one.
#[test]
fn networks_with_cameras_drive_meta_world() {
    let Some(bench) = Bench::new() else { return };
    let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robogate-policy/tests/networks/small.onnx");
    fs::copy(network, bench.at("small.onnx")).unwrap();
    fs::write(bench.at("profile.toml"), LOOKING).unwrap();
    let map = "[vectors]\npose = \"observation[0:8]\"\n[cameras]\nfront = { from = \"corner2.plain\", orientation = \"rotated\" }\n\
               [action]\nx = \"action[0]\"\ny = \"action[1]\"\nz = \"action[2]\"\ngripper = \"action[7]\"\n";
    fs::write(bench.at("map.toml"), map).unwrap();
    // Short episodes: Meta-World's take 500 control periods.
    let task = "import dataclasses\nfrom robogate_eval.environments import find\ndef environment():\n    drawer = find('metaworld:drawer-open-v3')\n    \
                return dataclasses.replace(drawer, task=dataclasses.replace(drawer.task, time_limit_s=0.5))\n";
    fs::write(bench.at("short.py"), task).unwrap();
    bench.robogate("env inspect short.py", 0, &["corner2.plain"]);
    fs::write(bench.at("plan.toml"), "[uniform]\nepisodes = 3\n[boundary]\nepisodes = 0\n").unwrap();
    let run = "run --env short.py --policy small.onnx --profile profile.toml --map map.toml --plan plan.toml --seed 3";
    let text = bench.robogate(&format!("{run} --threads 2 --out two"), 0, &["looking policy"]);
    assert!(!text.contains("invalid"), "{text}");
    bench.robogate(&format!("{run} --threads 1 --out one"), 0, &[]);
    assert!(bench.rows("two") == bench.rows("one"), "rows depend on the number of servers");
    bench.robogate("replay two 2", 0, &["identical to the recorded episode"]);
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
        assert!(began.elapsed() < Duration::from_secs(60), "a server is left");
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
