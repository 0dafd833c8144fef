//! Requalification of a run after an upgrade of a package, with wheels of a stand-in. No index is asked.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{stderr, stdout, text};

const PACKAGE: &str = include_str!("requalify/standin.py");
const CELL: &str = include_str!("requalify/cell.py");
const SPACE: &str =
    "name = \"masses\"\n[[parameter]]\nname = \"mass_block\"\nkind = \"continuous\"\nlow = 0.2\nhigh = 0.4\n";

/// Makes a wheel without a build tool, and prints its path.
const WHEEL: &str = r#"
import sys, zipfile
folder, version, code = sys.argv[1], sys.argv[2], open(sys.argv[3]).read().replace('BEHAVIOUR = "base"', f'BEHAVIOUR = "{sys.argv[4]}"')
path, info = f"{folder}/standin-{version}-py3-none-any.whl", f"standin-{version}.dist-info"
with zipfile.ZipFile(path, "w") as wheel:
    wheel.writestr("standin.py", code)
    wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: standin\nVersion: {version}\n")
    wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
    wheel.writestr(f"{info}/RECORD", f"standin.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")
print(path)
"#;

/// A run in a Python environment of its own.
struct Bench {
    dir: TempDir,
    python: PathBuf,
}

fn done(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", text(&output));
    stdout(&output)
}

impl Bench {
    /// `None` without a Python that has MuJoCo.
    fn new() -> Option<Self> {
        let base = robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with MuJoCo, pyzmq and msgpack")?;
        let dir = TempDir::new().unwrap();
        let own = dir.path().join("python");
        done(Command::new(&base).args(["-m", "venv", "--without-pip"]).arg(&own));
        let bench = Self { python: own.join("bin/python"), dir };
        let site = "import sysconfig; print(sysconfig.get_paths()['purelib'])";
        let [first, packages] =
            [&bench.python, &base].map(|python| done(Command::new(python).args(["-c", site])).trim().to_owned());
        fs::write(Path::new(&first).join("base.pth"), format!("import site; site.addsitedir({packages:?})\n")).unwrap();
        fs::write(bench.at("standin.py"), PACKAGE).unwrap();
        let wheel = bench.wheel("1.0", "base");
        let unpack = "import sys, zipfile; zipfile.ZipFile(sys.argv[1]).extractall(sys.argv[2])";
        done(Command::new(&base).args(["-c", unpack, &wheel, &first]));
        fs::remove_file(bench.at("standin.py")).unwrap();
        fs::write(bench.at("cell.py"), CELL).unwrap();
        fs::write(bench.at("masses.toml"), SPACE).unwrap();
        fs::write(bench.at("plan.toml"), "[uniform]\nepisodes = 60\n").unwrap();
        let python = bench.python.display().to_string();
        let line =
            ["run", "--env", "cell.py", "--space", "masses.toml", "--plan", "plan.toml", "--nominal-episodes", "0"];
        let output = bench.robogate(&[&line[..], &["--python", &python, "--out", "run"]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output));
        Some(bench)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// A wheel of a version with this behaviour.
    fn wheel(&self, version: &str, behaviour: &str) -> String {
        let code = self.at("code.py");
        fs::write(&code, PACKAGE).unwrap();
        let make = Command::new(&self.python)
            .args(["-c", WHEEL])
            .arg(self.dir.path())
            .args([version])
            .arg(&code)
            .arg(behaviour)
            .output();
        let made = make.unwrap();
        assert!(made.status.success(), "{}", text(&made));
        stdout(&made).trim().to_owned()
    }

    fn robogate(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(arguments)
            .current_dir(&self.dir)
            .env("ROBOGATE_CACHE_DIR", self.at("cache"))
            .env("ROBOGATE_STATE_DIR", self.at("state"))
            .env("PIP_NO_INDEX", "1")
            .env("PIP_FIND_LINKS", self.dir.path())
            .output()
            .unwrap()
    }

    /// Requalifies for these arguments, and returns the document.
    #[track_caller]
    fn requalify(&self, arguments: &[&str], code: i32, answer: &str) -> Value {
        let output = self.robogate(&[&["requalify", "run", "--json"][..], arguments].concat());
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", text(&output));
        let document: Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert_eq!(document["answer"], answer, "{arguments:?}: {document:#}");
        document
    }
}

/// Each answer, and none.
#[test]
fn upgrades_get_their_answer() {
    let Some(bench) = Bench::new() else { return };
    let answers = [
        ("2.0", "rounding", 0, "no_relevant_change"),
        ("2.1", "meaning", 1, "meaning_changed"),
        ("2.2", "starts", 1, "starts_changed"),
        ("2.3", "success", 1, "success_changed"),
        ("2.4", "broken", 1, "cannot_run"),
        ("2.5", "raises", 1, "cannot_run"),
        ("2.6", "seeds", 4, "not_paired"),
        ("2.7", "solver", 1, "solver_worse"),
    ];
    for (version, behaviour, code, answer) in answers {
        let wheel = bench.wheel(version, behaviour);
        // All pairs show the region.
        let all = (behaviour == "success").then_some("--all");
        let arguments: Vec<&str> = ["--env-with", &wheel].into_iter().chain(all).collect();
        let found = bench.requalify(&arguments, code, answer);
        let changes = found["changes"].to_string();
        let part = match behaviour {
            "meaning" => "motion of block 0.0 %, 100.0 % before",
            "starts" => "horizontal position of block: +15 mm",
            "success" => "success where mass_block",
            "broken" => "eq_data has 12 numbers",
            "raises" => "the joint has no such type",
            "solver" => "solver iterations",
            _ => "",
        };
        assert!(changes.contains(part), "{behaviour}: {found:#}");
        assert_eq!(found["packages"][0]["package"], "standin", "{found:#}");
        // The environment before the upgrade repeats the run: the probe changes nothing.
        if found["pairs"][0] != 0 {
            assert_eq!(found["repeats_run"][0], found["repeats_run"][1], "{found:#}");
        }
    }
}

/// The environment of the run is its copy in the run's folder; the other one is the user's file as it is now.
#[test]
fn another_version_of_the_environment_is_an_upgrade() {
    let Some(bench) = Bench::new() else { return };
    let edited = |text: &str| fs::write(bench.at("cell.py"), text).unwrap();
    edited(&format!("# No change.\n{CELL}"));
    let found = bench.requalify(&["--env", "cell.py"], 0, "no_relevant_change");
    assert_eq!(found["identical"], found["pairs"][0], "{found:#}");
    assert_eq!(found["repeats_run"][0], found["repeats_run"][1], "{found:#}");
    edited(&CELL.replace("lambda observation: np.array([1.0])", "lambda observation: np.array([-1.0])"));
    let found = bench.requalify(&["--env", "cell.py"], 1, "success_changed");
    assert_eq!(found["upgrade"], "environment cell.py");
    edited("raise RuntimeError('half edited')\n");
    let found = bench.requalify(&["--env", "cell.py"], 1, "cannot_run");
    assert!(found["changes"].to_string().contains("half edited"), "{found:#}");
}

#[test]
fn bisection_finds_the_first_changed_version() {
    let Some(bench) = Bench::new() else { return };
    for (version, behaviour) in [("1.1", "rounding"), ("1.2", "base"), ("1.10", "starts"), ("2.0", "starts")] {
        bench.wheel(version, behaviour);
    }
    let found = bench.requalify(&["--env-with", "standin==2.0", "--bisect", "--out", "page.html"], 1, "starts_changed");
    assert_eq!(found["first_changed"], "1.10", "{found:#}");
    let page = fs::read_to_string(bench.at("page.html")).unwrap();
    for part in ["standin==2.0", "Initial states", "position of block", "1.10"] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn impossible_upgrades_are_refused() {
    let Some(bench) = Bench::new() else { return };
    let refused = [
        (&["--env-with", "standin"][..], "expected PACKAGE==VERSION"),
        (&["--env-with", "standin==9.9"], "No matching distribution"),
        (&["--engine", "rapier"], "--env, --env-with or --policy"),
        (&["--env", "gone.py"], "gone.py: no such file"),
        (&["--env-with", "a==1", "b==2", "--bisect"], "needs one package"),
        (&["--env-with", "standin==2.0", "--margin", "2"], "between 0 and 1"),
    ];
    for (arguments, part) in refused {
        let output = bench.robogate(&[&["requalify", "run"][..], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output));
        assert!(stderr(&output).contains(part), "{arguments:?}: {}", stderr(&output));
    }
}

/// The built-in cell: another engine, and another policy.
#[cfg(all(feature = "mujoco", feature = "rapier"))]
#[test]
fn built_in_cell_is_requalified() {
    let dir = TempDir::new().unwrap();
    let run = |arguments: &str, code: i32| {
        let output = crate::harness::robogate_in(dir.path(), &arguments.split(' ').collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(code), "{arguments}: {}", text(&output));
        stdout(&output)
    };
    run("run -n 24 --out run", 0);
    let policy = run("requalify run --policy random --json", 1);
    let policy: Value = serde_json::from_str(&policy).unwrap();
    assert_eq!(policy["answer"], "success_changed", "{policy:#}");
    let same = run("requalify run --engine mujoco --json --margin 0.3", 0);
    let same: Value = serde_json::from_str(&same).unwrap();
    assert_eq!((&same["answer"], &same["identical"]), (&"no_relevant_change".into(), &same["pairs"][0]), "{same:#}");
    run("requalify run --env-with mujoco==3.9.0", 2);
}
