//! Robots of MuJoCo Menagerie through its Python package, of which this test has a small copy.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use crate::harness::{assert_done, stderr, stdout};

/// A package with the functions of `mujoco-menagerie` that are used, and one robot.
const PACKAGE: &str = r#"
import pathlib
__version__ = "2026.1.2"
class MenagerieError(Exception): pass
class Entry:
    name, file = "panda", "panda.xml"
class Robot:
    default_model, oid, sha256, license = "panda", "0123456789abcdef", "ab" * 32, "Apache-2.0"
    def entry(self, name):
        if name != "panda": raise MenagerieError(f"no model {name!r}")
        return Entry
    def path(self, progress=None): return pathlib.Path(__file__).parent / "arm"
    def files(self, name): return [self.path() / "panda.xml"]
def get(name):
    if name != "arm": raise MenagerieError(f"unknown robot {name!r}")
    return Robot()
class Cache:
    root = None
    def is_cached(self, robot): return not (robot.path() / "absent").exists()
    def verify(self, robot): return ["panda.xml"] if (robot.path() / "changed").exists() else []
"#;

fn robogate(at: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args(arguments)
        .current_dir(at)
        .env("PYTHONPATH", at.join("packages"))
        .env("ROBOGATE_CACHE_DIR", at.join("cache"))
        .output()
        .unwrap()
}

#[test]
fn menagerie_robots_are_drafted_and_pinned() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    let package = at.join("packages/mujoco_menagerie");
    fs::create_dir_all(package.join("arm")).unwrap();
    fs::write(package.join("__init__.py"), PACKAGE).unwrap();
    fs::write(package.join("arm/panda.xml"), include_str!("../../../../assets/robots/franka/franka.xml")).unwrap();
    fs::write(package.join("arm/LICENSE"), "text").unwrap();

    let refused = |arguments: &[&str], parts: &[&str]| {
        let output = robogate(at, arguments);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        for part in parts {
            assert!(stderr(&output).contains(part), "{part}: {}", stderr(&output));
        }
    };
    refused(&["robots", "check", "menagerie:other"], &["unknown robot 'other'", "Hint:"]);
    refused(&["robots", "check", "menagerie:arm/hand"], &["no model 'hand'"]);
    refused(&["run", "--robot", "menagerie:../x", "-n", "1"], &["not a name of a robot"]);
    fs::write(package.join("arm/absent"), "").unwrap();
    refused(&["robots", "check", "menagerie:arm"], &["not on this machine", "mujoco_menagerie prefetch arm"]);
    fs::remove_file(package.join("arm/absent")).unwrap();
    fs::write(package.join("arm/changed"), "").unwrap();
    refused(&["robots", "check", "menagerie:arm"], &["not those of the package: panda.xml"]);
    fs::remove_file(package.join("arm/changed")).unwrap();

    let run = robogate(at, &["run", "--robot", "menagerie:arm", "-n", "1", "--out", "run"]);
    assert_done(&run);
    let folders: Vec<_> = fs::read_dir(at.join("cache/robots/menagerie")).unwrap().flatten().collect();
    let [folder] = &folders[..] else { panic!("{folders:?}") };
    let source = fs::read_to_string(folder.path().join("menagerie.json")).unwrap();
    assert!(source.contains("2026.1.2") && source.contains("0123456789abcdef"), "{source}");
    assert!(folder.path().join("LICENSE").is_file() && folder.path().join("robot.toml").is_file());
    let plan = fs::read_to_string(at.join("run/plan.json")).unwrap();
    assert!(plan.contains(&*folder.path().to_string_lossy()), "{plan}");
    // A later change of the draft is used.
    let settings = fs::read_to_string(folder.path().join("robot.toml")).unwrap();
    fs::write(folder.path().join("robot.toml"), settings.replace("name = \"arm\"", "name = \"own\"")).unwrap();
    let check = robogate(at, &["robots", "check", "menagerie:arm", "--json"]);
    assert!(
        stdout(&check).contains("\"name\":\"own\"") || stdout(&check).contains("\"name\": \"own\""),
        "{}",
        stdout(&check)
    );
}
