//! Files of other authors are handled in child processes with limits: models of robots, and environments in
//! the sandbox.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::harness::{assert_exit_in, text};

/// Copies the Franka into a folder, with more elements in its model.
fn robot(folder: &Path, more: &str) {
    fs::create_dir(folder).unwrap();
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/robots/franka");
    fs::copy(assets.join("robot.toml"), folder.join("robot.toml")).unwrap();
    let model = fs::read_to_string(assets.join("franka.xml")).unwrap();
    let (before, after) = model.split_at(model.find("<default>").unwrap());
    fs::write(folder.join("franka.xml"), format!("{before}{more}{after}")).unwrap();
}

/// Each texture is of an accepted size. Together they are 60 GB, which MuJoCo would reserve.
#[test]
fn large_models_end_a_child() {
    let dir = TempDir::new().unwrap();
    let texture = |number: usize| {
        format!("<texture name=\"t{number}\" type=\"2d\" builtin=\"flat\" width=\"8192\" height=\"8192\"/>")
    };
    robot(&dir.path().join("large"), &format!("<asset>{}</asset>", (0..300).map(texture).collect::<String>()));
    // `robots init` would also read a model that is in no robot's folder.
    for line in ["run --robot large -n 1 --out run", "robots init large/franka.xml --force"] {
        let arguments: Vec<&str> = line.split(' ').collect();
        assert_exit_in(dir.path(), &arguments, 2, &["large/", "ould not allocate memory"]);
    }
    assert!(!dir.path().join("run").exists());
}

/// The report of the child is that of this process.
#[test]
fn problems_of_models_are_told_as_ever() {
    let dir = TempDir::new().unwrap();
    robot(&dir.path().join("odd"), "<asset><material name=\"a\" texture=\"none\"/></asset>");
    let arguments = ["run", "--robot", "odd", "-n", "1", "--out", "run"];
    assert_exit_in(dir.path(), &arguments, 2, &["odd", "none", "Hint: "]);
    robot(&dir.path().join("good"), "");
    let arguments = ["run", "--robot", "good", "-n", "1", "--out", "run"];
    assert_exit_in(dir.path(), &arguments, 0, &[]);
}

/// An environment that tries `attempts` while it is imported. A Python with Gymnasium runs it.
struct Bench {
    python: PathBuf,
    dir: TempDir,
}

const ENVIRONMENT: &str = r#"
import gymnasium, numpy as np
from robogate_eval import Environment, Policy, Task

class Line(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    dt = 0.05
    max_episode_steps = 20
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = float(self.np_random.uniform(0.3, 1.2)), 0
        return np.array([self.x]), {}
    def step(self, action):
        self.x -= 0.05 * float(action[0])
        self.t += 1
        return np.array([self.x]), 0.0, False, self.t >= 20, {"success": self.x < 0.02}

go = Policy(lambda env: (lambda observation: np.array([1.0])), "go")
environment = Environment(make=Line, task=Task(name="line", control_period_s=0.05, time_limit_s=1.0), policies={"go": go})
"#;

impl Bench {
    fn new() -> Option<Self> {
        let python =
            robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with Meta-World, pyzmq and msgpack")?;
        let bench = Self { python, dir: TempDir::new().unwrap() };
        for folder in ["home", "state", "world", "elsewhere"] {
            fs::create_dir(bench.at(folder)).unwrap();
        }
        fs::write(bench.at("state/gate.key"), "a secret\n").unwrap();
        Some(bench)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Runs the command for a user with this state folder, and checks its exit code and parts of the output.
    #[track_caller]
    fn expect(&self, state: &str, line: &str, code: i32, parts: &[&str]) -> String {
        let mut command = Command::new(env!("CARGO_BIN_EXE_robogate"));
        command.args(line.split(' ')).current_dir(&self.dir).env_remove("PYTHONPATH");
        command.env("ROBOGATE_CACHE_DIR", self.at("cache")).env("ROBOGATE_STATE_DIR", self.at(state));
        let output =
            command.env("HOME", self.at("home")).env("SECRET_TOKEN", "a secret of the shell").output().unwrap();
        let printed = text(&output);
        assert_eq!(output.status.code(), Some(code), "{line}: {printed}");
        for part in parts {
            assert!(printed.contains(part), "{line} does not say {part:?}: {printed}");
        }
        printed
    }
}

#[test]
fn refused_attempts_are_named() {
    let Some(bench) = Bench::new() else { return };
    let (key, mark) = (bench.at("state/gate.key"), bench.at("home/mark"));
    // The same again without Python's functions, which tell what is refused.
    let attempts = format!(
        r#"
import ctypes, os, socket, sys, tempfile
key, mark = {key:?}, {mark:?}
def tries(what):
    try:
        return what()
    except OSError as error:
        return type(error).__name__
said = [
    tries(lambda: open(key).read()),
    tries(lambda: open(mark, "w").write("x")),
    tries(lambda: socket.socket().fileno()),
    tries(lambda: os.fork()),
    tries(lambda: os.chmod(key, 0o777)),
    tries(lambda: os.listdir(os.path.dirname(key))),
    tries(lambda: os.kill(os.getppid(), 0)),
    tries(lambda: open("/proc/%d/environ" % os.getppid()).read()),
]
library = ctypes.CDLL(None, use_errno=True)
said += [
    library.open(key.encode(), 0),
    library.open(mark.encode(), 0o101, 0o600),
    library.socket(2, 1, 0),
    library.fork(),
    library.chmod(key.encode(), 0o777),
    library.syscall(425, 8, 0),
    library.shmget(0, 4096, 0o600),
    library.setpriority(0, os.getppid(), 19),
]
tempfile.TemporaryFile().write(b"x")
print("SAID", said, os.environ.get("SECRET_TOKEN"), file=sys.stderr)
raise RuntimeError("the end of the attempts")
"#,
        key = key.display().to_string(),
        mark = mark.display().to_string()
    );
    fs::write(bench.at("world/attempts.py"), attempts + ENVIRONMENT).unwrap();
    let refused = "'PermissionError'";
    let said = format!("SAID [{}, -1, -1, -1, -1, -1, -1, -1, -1] None", [refused; 8].join(", "));
    let line = format!("run --env world/attempts.py:environment --python {} -n 1 --out run", bench.python.display());
    let told = [
        format!("refused to read {}", key.display()),
        format!("refused to write {}", mark.display()),
        "refused to open a socket".to_owned(),
        "refused to start a process".to_owned(),
        format!("refused to change the permissions of {}", key.display()),
        format!("refused to read {}", bench.at("state").display()),
        "the end of the attempts".to_owned(),
        said.clone(),
    ];
    let told: Vec<&str> = told.iter().map(String::as_str).collect();
    let printed = bench.expect("state", &format!("{line} --sandbox"), 5, &told);
    assert!(!mark.exists() && !printed.contains("a secret\\n"), "{printed}");
    assert!(!printed.contains("a secret of the shell"), "{printed}");
    // Without the sandbox, the user's own environment does all of that.
    let printed = bench.expect("state", &format!("{line} --sandbox=off"), 5, &["the end of the attempts"]);
    assert!(mark.exists() && printed.contains("SAID ['a secret\\n', 1, "), "{printed}");
}

#[test]
fn sandbox_changes_no_episode() {
    let Some(bench) = Bench::new() else { return };
    fs::write(bench.at("world/line.py"), ENVIRONMENT).unwrap();
    // Meta-World imports libraries for graphics, whose search starts processes outside of the sandbox.
    for (at, (environment, episodes)) in
        [("world/line.py:environment", 40), ("metaworld:drawer-open-v3", 2)].into_iter().enumerate()
    {
        let line = format!(
            "run --env {environment} --python {} -n {episodes} --design uniform --seed 3 --out",
            bench.python.display()
        );
        bench.expect("state", &format!("{line} plain-{at}"), 0, &[]);
        bench.expect("state", &format!("{line} closed-{at} --sandbox"), 0, &["in the sandbox"]);
        let rows = |run: &str| fs::read(bench.at(&format!("{run}-{at}")).join("dictionary.parquet")).unwrap();
        assert!(rows("plain") == rows("closed"), "{environment}");
    }
    // Nothing is left of the folders for temporary files.
    let left = fs::read_dir(std::env::temp_dir()).unwrap().filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().starts_with(&format!("robogate-sandbox-{}-", std::process::id()))
    });
    assert_eq!(left.count(), 0);
}

/// Evidence of another user runs in the sandbox, unless the user switches it off.
#[test]
fn evidence_of_others_runs_in_the_sandbox() {
    let Some(bench) = Bench::new() else { return };
    fs::write(bench.at("world/line.py"), ENVIRONMENT).unwrap();
    let python = bench.python.display().to_string();
    let run = format!("run --env world/line.py:environment --python {python} -n 40 --seed 3 --out run");
    bench.expect("state", &run, 0, &[]);
    bench.expect("state", "evidence run proof --requirements default", 1, &[]);
    let verify = format!("verify proof --rerun 5 --env world/line.py:environment --python {python}");
    let printed = bench.expect("elsewhere", &verify, 0, &["in the sandbox", "rerun: 5 of 40 rows"]);
    assert!(printed.contains("with the same outcome, measures and trajectory"), "{printed}");
    let printed = bench.expect("elsewhere", &format!("{verify} --sandbox=off"), 0, &["rerun: 5 of 40 rows"]);
    assert!(!printed.contains("in the sandbox"), "{printed}");
    // A kernel without the sandbox, as a filter of system calls shows it to the command: nothing is started.
    const WITHOUT_LANDLOCK: &str = r#"
import ctypes, os, struct, sys
rules = [(0x20, 0, 0, 0), (0x15, 0, 1, 444), (0x06, 0, 0, 0x50000 | 38), (0x06, 0, 0, 0x7FFF0000)]
code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *rule) for rule in rules))
class Program(ctypes.Structure):
    _fields_ = [("rules", ctypes.c_ushort), ("code", ctypes.c_void_p)]
libc = ctypes.CDLL(None, use_errno=True)
assert libc.prctl(38, 1, 0, 0, 0) == 0
assert libc.prctl(22, 2, ctypes.byref(Program(len(rules), ctypes.addressof(code))), 0, 0) == 0
os.execv(sys.argv[1], sys.argv[1:])
"#;
    let without = |line: &str| {
        let mut command = Command::new("python3");
        command.args(["-c", WITHOUT_LANDLOCK, env!("CARGO_BIN_EXE_robogate")]).args(line.split(' '));
        command.current_dir(&bench.dir).env_remove("PYTHONPATH").env("HOME", bench.at("home"));
        command.env("ROBOGATE_CACHE_DIR", bench.at("cache")).env("ROBOGATE_STATE_DIR", bench.at("elsewhere"));
        let output = command.output().unwrap();
        (output.status.code(), text(&output))
    };
    let (code, printed) = without(&verify);
    assert!(code == Some(2) && printed.contains("this kernel has no sandbox"), "{printed}");
    assert!(printed.contains("--sandbox=off") && !printed.contains("starting "), "{printed}");
    let (code, printed) = without(&format!("{verify} --sandbox=off"));
    assert_eq!(code, Some(0), "{printed}");
    // The folder of the environment must not contain the user's home.
    fs::copy(bench.at("world/line.py"), bench.at("line.py")).unwrap();
    let line = format!("run --env line.py:environment --python {python} -n 1 --out other --sandbox");
    bench.expect("state", &line, 2, &["contains your home folder or your keys", "a folder of their own"]);
}

/// A run is bound to the files that its environment opens and to the modules that it imports until the end of
/// an episode.
#[test]
fn opened_files_are_part_of_an_environment() {
    let Some(bench) = Bench::new() else { return };
    let late = "        if self.t >= 20:\n            import late\n        return np.array([self.x]), 0.0";
    let code = ENVIRONMENT.replace("        return np.array([self.x]), 0.0", late);
    assert_ne!(code, ENVIRONMENT);
    let opens = r#"
import json, os, mujoco
here = os.path.dirname(os.path.abspath(__file__))
json.load(open(os.path.join(here, "data/settings.json")))
mujoco.MjModel.from_xml_path(os.path.join(here, "model/world.xml"))
open(os.path.join(here, "data/log.txt"), "a").write("started\n")
open(os.path.join(here, "data/log.txt")).read()
"#;
    for folder in ["world/data", "world/model"] {
        fs::create_dir(bench.at(folder)).unwrap();
    }
    fs::write(bench.at("world/line.py"), opens.to_owned() + &code).unwrap();
    fs::write(bench.at("world/late.py"), "\n").unwrap();
    fs::write(bench.at("world/data/settings.json"), "{}\n").unwrap();
    fs::write(bench.at("world/data/unused.json"), "{}\n").unwrap();
    fs::write(bench.at("world/model/world.xml"), "<mujoco><include file=\"parts.xml\"/></mujoco>\n").unwrap();
    let parts = "<mujoco><worldbody><geom size=\"1\"/></worldbody></mujoco>\n";
    fs::write(bench.at("world/model/parts.xml"), parts).unwrap();
    let python = bench.python.display().to_string();
    let run = format!("run --env world/line.py:environment --python {python} -n 8 --seed 3 --threads 2 --out run");
    bench.expect("state", &run, 0, &[]);
    let plan: serde_json::Value = serde_json::from_slice(&fs::read(bench.at("run/plan.json")).unwrap()).unwrap();
    let files = plan["provenance"]["world"]["place"]["files"].as_object().unwrap();
    let used = ["data/settings.json", "late.py", "line.py", "model/parts.xml", "model/world.xml"];
    assert_eq!(files.keys().collect::<Vec<_>>(), used);
    assert_eq!(fs::read_to_string(bench.at("run/environment/model/parts.xml")).unwrap(), parts);
    for name in ["data/settings.json", "late.py", "model/parts.xml"] {
        let file = bench.at("world").join(name);
        let before = fs::read_to_string(&file).unwrap();
        fs::write(&file, before.clone() + "\n").unwrap();
        let reason = format!("the environment's file {name} has changed since the run");
        bench.expect("state", &format!("resume run --python {python}"), 2, &[&reason]);
        bench.expect(
            "elsewhere",
            &format!("replay run 3 --env world/line.py:environment --python {python}"),
            2,
            &[&reason],
        );
        fs::write(&file, before).unwrap();
    }
    fs::write(bench.at("world/data/unused.json"), "[]\n").unwrap();
    bench.expect("state", &format!("replay run 3 --python {python}"), 0, &["identical to the recorded episode"]);
}

/// A user opens folders elsewhere to the sandbox, for a dataset or a cache.
#[test]
fn named_folders_are_open() {
    let Some(bench) = Bench::new() else { return };
    for folder in ["data", "cached"] {
        fs::create_dir(bench.at(folder)).unwrap();
        fs::write(bench.at(folder).join("x.txt"), "1\n").unwrap();
    }
    let (data, cached) = (bench.at("data"), bench.at("cached"));
    let uses = format!(
        "open({:?}).read()\nopen({:?}, \"w\").write(\"2\")\n",
        data.join("x.txt").display().to_string(),
        cached.join("x.txt").display().to_string()
    );
    fs::write(bench.at("world/line.py"), uses + ENVIRONMENT).unwrap();
    let line = format!(
        "run --env world/line.py:environment --python {} -n 1 --design uniform --nominal-episodes 0 --out",
        bench.python.display()
    );
    let refused = |path: &Path, how: &str| format!("refused to {how} {}", path.join("x.txt").display());
    let (read, write) = (refused(&data, "read"), refused(&cached, "write"));
    let hint = "Hint: --sandbox-read FOLDER opens a folder";
    bench.expect("state", &format!("{line} none --sandbox"), 5, &[&read, hint, "--sandbox-write FOLDER"]);
    // Opened to read only, no file can be changed.
    let reads = format!("{line} reads --sandbox-read {},{}", data.display(), cached.display());
    let printed = bench.expect("state", &reads, 5, &["in the sandbox", &write, hint]);
    assert!(!printed.contains(&read), "{printed}");
    assert_eq!(fs::read_to_string(cached.join("x.txt")).unwrap(), "1\n");
    let both = format!("{line} both --sandbox-read data --sandbox-write cached");
    let printed = bench.expect("state", &both, 0, &["in the sandbox"]);
    assert!(!printed.contains("refused"), "{printed}");
    assert_eq!(fs::read_to_string(cached.join("x.txt")).unwrap(), "2");
    // Neither the user's keys, nor a folder that is missing, nor a sandbox that is off.
    bench.expect("state", &format!("{line} x --sandbox-read state"), 2, &["contains your home folder or your keys"]);
    bench.expect("state", &format!("{line} x --sandbox-write ."), 2, &["contains your home folder or your keys"]);
    bench.expect(
        "state",
        &format!("{line} x --sandbox-read none"),
        2,
        &["--sandbox-read none: cannot be opened", "Hint:"],
    );
    bench.expect(
        "state",
        &format!("{line} x --sandbox=off --sandbox-read data"),
        2,
        &["cannot be used with --sandbox=off"],
    );
}

/// Files that a C library opens are part of an environment too, also where a link in its folder leads elsewhere.
#[test]
fn files_opened_in_c_are_part_of_an_environment() {
    let Some(bench) = Bench::new() else { return };
    let opens = r#"
import ctypes, os, mujoco
here = os.path.dirname(os.path.abspath(__file__))
def read(name):
    library = ctypes.CDLL(None)
    file = library.open(os.path.join(here, name).encode(), os.O_RDONLY)
    assert file >= 0 and library.read(file, ctypes.create_string_buffer(64), 64) > 0
    library.close(file)
for name in ["scene/grasps.h5", "shared/table.bin", "one.bin"]:
    read(name)
mujoco.MjModel.from_xml_path(os.path.join(here, "scene/world.xml"))
library = ctypes.CDLL(None)
log = library.open(os.path.join(here, "scene/log.bin").encode(), os.O_RDWR | os.O_CREAT, 0o600)
library.write(log, b"started", 7)
"#;
    for folder in ["world/scene", "elsewhere/shared", "elsewhere/single"] {
        fs::create_dir(bench.at(folder)).unwrap();
    }
    fs::write(bench.at("world/line.py"), opens.to_owned() + ENVIRONMENT).unwrap();
    for (name, content) in [
        ("world/scene/grasps.h5", "grasps"),
        ("world/scene/unused.h5", "unused"),
        ("elsewhere/shared/table.bin", "table"),
        ("elsewhere/single/one.bin", "one"),
        ("elsewhere/single/unused.bin", "unused"),
        ("world/scene/tetra.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"),
    ] {
        fs::write(bench.at(name), content).unwrap();
    }
    let mesh = "<mujoco><asset><mesh name=\"t\" file=\"tetra.obj\"/></asset>\
                <worldbody><geom type=\"mesh\" mesh=\"t\"/></worldbody></mujoco>";
    fs::write(bench.at("world/scene/world.xml"), mesh).unwrap();
    std::os::unix::fs::symlink(bench.at("elsewhere/shared"), bench.at("world/shared")).unwrap();
    std::os::unix::fs::symlink(bench.at("elsewhere/single/one.bin"), bench.at("world/one.bin")).unwrap();
    let python = bench.python.display().to_string();
    let run = format!("run --env world/line.py:environment --python {python} -n 8 --seed 3 --threads 2 --out run");
    bench.expect("state", &run, 0, &[]);
    let plan: serde_json::Value = serde_json::from_slice(&fs::read(bench.at("run/plan.json")).unwrap()).unwrap();
    let files = plan["provenance"]["world"]["place"]["files"].as_object().unwrap();
    let used = ["line.py", "one.bin", "scene/grasps.h5", "scene/tetra.obj", "scene/world.xml", "shared/table.bin"];
    assert_eq!(files.keys().collect::<Vec<_>>(), used);
    assert_eq!(fs::read_to_string(bench.at("run/environment/shared/table.bin")).unwrap(), "table");
    bench.expect("state", "evidence run proof --requirements default", 1, &[]);
    let replay = format!("replay run 3 --env world/line.py:environment --python {python}");
    let verify = format!("verify proof --rerun 2 --env world/line.py:environment --python {python} --sandbox=off");
    for name in ["one.bin", "scene/grasps.h5", "scene/tetra.obj", "shared/table.bin"] {
        let file = bench.at("world").join(name);
        let before = fs::read_to_string(&file).unwrap();
        fs::write(&file, before.clone() + "\n").unwrap();
        let reason = format!("the environment's file {name} has changed since the run");
        bench.expect("state", &format!("resume run --python {python}"), 2, &[&reason]);
        bench.expect("elsewhere", &replay, 2, &[&reason]);
        bench.expect("elsewhere", &verify, 2, &[&reason]);
        fs::write(&file, before).unwrap();
    }
    fs::write(bench.at("world/scene/unused.h5"), "other").unwrap();
    bench.expect("elsewhere", &replay, 0, &["identical to the recorded episode"]);
    bench.expect("elsewhere", &verify, 0, &["rerun: 2 of 8 rows"]);
    // In the sandbox too, where the environment cannot write its log.
    let open = format!("--sandbox-read {0}/shared,{0}/single", bench.at("elsewhere").display());
    let printed = bench.expect("elsewhere", &verify.replace("--sandbox=off", &open), 0, &["rerun: 2 of 8 rows"]);
    assert!(printed.contains("in the sandbox"), "{printed}");
}

/// A killed process leaves files under temporary names. The next command that works in the folder removes
/// them.
#[test]
fn unfinished_files_are_removed() {
    let dir = TempDir::new().unwrap();
    let run = ["run", "--task", "pendulum", "-n", "20", "--design", "uniform", "--seed", "3", "--out", "run"];
    assert_exit_in(dir.path(), &run, 0, &[]);
    let at = |name: &str| dir.path().join("run").join(name);
    for name in [".dictionary.parquet.part", ".summary.json.part", "notes.part", ".notes"] {
        fs::write(at(name), "cut").unwrap();
    }
    assert_exit_in(dir.path(), &["resume", "run"], 0, &[]);
    let left = |name: &str| at(name).exists();
    assert!(!left(".dictionary.parquet.part") && !left(".summary.json.part"));
    // Files of others stay.
    assert!(left("notes.part") && left(".notes"));
}
