//! Fuzzing of what people write and of what folders contain: settings, models of robots, runs and evidence.

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

use robogate::exit_codes::{INFRASTRUCTURE, PASS};
use robogate_analysis::transfer::RealTrials;
use robogate_campaign::Plan;
use robogate_core::{ParameterSpace, Suite};
use robogate_gate::{Baseline, Requirements};
use robogate_monitor::service::Batch;
use robogate_physics::{Robot, RobotSettings, description::Description};
use robogate_policy::{Profile, Statistics, TaskMap};
use robogate_testing::fuzz::{self, Target, mutate};
use tempfile::TempDir;

use crate::harness::{robogate_in, text, verb};

/// Words with a meaning for TOML and for the settings.
pub(super) const TOML: &[&str] = &[
    "[",
    "]",
    "[[",
    "]]",
    "=",
    "\"",
    "'''",
    "{",
    "}",
    ",",
    "\n",
    "#",
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e308",
    "-1e308",
    "1e-320",
    "9223372036854775807",
    "true",
    "name",
    "low",
    "high",
    "value",
    "kind",
    "levels",
    "integer",
    "categorical",
    "log",
    "at_least",
    "at_most",
];
/// The same for JSON.
pub(super) const JSON: &[&str] = &[
    "{",
    "}",
    "[",
    "]",
    ":",
    ",",
    "null",
    "true",
    "NaN",
    "1e999",
    "-1",
    "0",
    "18446744073709551616",
    "\"\"",
    "\\u0000",
    "\\ud800",
    "[[[[[[[[",
];
/// The same for MJCF and URDF.
const XML: &[&str] = &[
    "<",
    "/>",
    ">",
    "</",
    "\"",
    "<body>",
    "</body>",
    "<joint type=\"free\"/>",
    "<joint type=\"ball\"/>",
    "<geom size=\"0\"/>",
    "nan",
    "1e308",
    "-1",
    "0 0 0",
    "<default class=\"a\">",
    "<site name=\"tcp\"/>",
    "range=\"1 -1\"",
    "<freejoint/>",
    "mass=\"0\"",
    "<compiler angle=\"degree\"/>",
    "<include file=\"model.xml\"/>",
    "<!--",
    "-->",
    "<?xml",
    "name=\"\"",
    "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"0 0 0\"/>",
];

pub(super) fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

/// The files of a folder of the repository that end like this.
fn files(folder: &str, end: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(repository(folder)).unwrap().map(|file| file.unwrap().path()).collect();
    paths.retain(|path| path.to_string_lossy().ends_with(end));
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// Tries a reader of texts with damaged ones.
pub(super) fn texts(name: &str, valid: &[Vec<u8>], words: &[&str], read: impl Fn(&str) -> bool) {
    assert!(!valid.is_empty());
    Target { name, valid, kept: &[], words, inputs: 300 }.run(|bytes| std::str::from_utf8(bytes).is_ok_and(&read));
}

#[test]
fn fuzzed_spaces_are_read_or_refused() {
    texts("space", &files("assets/spaces", ".toml"), TOML, |text| ParameterSpace::from_toml(text).is_ok());
}

#[test]
fn fuzzed_suites_are_read_or_refused() {
    texts("suite", &files("assets/suites", ".toml"), TOML, |text| Suite::from_toml(text).is_ok());
}

#[test]
fn fuzzed_plans_are_read_or_refused() {
    let valid = files("assets/presets", ".toml");
    texts("plan", &valid, TOML, |text| Plan::from_toml(text).is_ok());
}

#[test]
fn fuzzed_requirements_are_read_or_refused() {
    texts("requirements", &files("assets/gates", ".toml"), TOML, |text| Requirements::from_toml(text).is_ok());
}

#[test]
fn fuzzed_baselines_are_read_or_refused() {
    texts("baseline", &files("assets/baselines", ".json"), JSON, |text| Baseline::from_json(text).is_ok());
}

#[test]
fn fuzzed_profiles_are_read_or_refused() {
    let names = ["learned", "droid-roboarena", "smolvla-vla-eval"];
    let valid = names.map(|name| Profile::built_in(name).unwrap().as_bytes().to_vec());
    texts("profile", &valid, TOML, |text| Profile::from_toml(text).is_ok());
}

#[test]
fn fuzzed_maps_are_read_or_refused() {
    let valid = b"[vectors]\neef_pos = \"observation[0:3]\"\ngripper_qpos = [{ from = \"observation[3]\", scale = 0.04, offset = 1 }, 0]\n\
                  [cameras]\nfront = \"corner2\"\nwrist = { from = \"hand\", orientation = \"flipped\" }\n\
                  [action]\nx = { from = \"x\", scale = -100 }\ngripper = 1.0\n";
    texts("map", &[valid.to_vec()], TOML, |text| TaskMap::from_toml(text).is_ok());
}

#[test]
fn fuzzed_statistics_are_read_or_refused() {
    let together =
        br#"{"norm_stats": {"state": {"min": [0, -1.5], "max": [1, 2], "mean": [0.5, 0], "std": [0.1, 1]}}}"#;
    let named = br#"{"libero": {"proprio": {"mean": [0.1, 0.2], "std": [1, 1], "q01": [-1, -1], "q99": [1, 1]}}}"#;
    let groups = [None, Some("libero"), Some("state")];
    texts("statistics", &[together.to_vec(), named.to_vec()], JSON, |text| {
        groups.iter().filter(|group| Statistics::from_json(text, **group).is_ok()).count() > 0
    });
}

#[test]
fn fuzzed_trials_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("trials.csv");
    let space = fs::read_to_string(repository("assets/spaces/franka.toml")).unwrap();
    let space = ParameterSpace::from_toml(&space).unwrap();
    let valid = b"success,mass_kg,friction,operator\n1,0.5,0.4,anna\n0,1.5,0.2,ben\n".to_vec();
    texts(
        "trials",
        &[valid],
        &["\"", ",", ";", "\n", "nan", "inf", "1e400", "-1", "success", "failure_mode", "\u{feff}"],
        |text| {
            fs::write(&path, text).unwrap();
            RealTrials::open(&path, &space, &[], "scripted").is_ok()
        },
    );
}

#[test]
fn fuzzed_cycles_are_read_or_refused() {
    let line = br#"{"id": "a-1", "recipe": "bin", "robot": "r1", "time_s": 12.5, "success": false, "failure_mode": "slip", "cycle_time_s": 3.5, "parameters": {"mass_kg": 0.4}}"#;
    let valid = [line.to_vec(), [&line[..], b"\n\n", line, b"\n"].concat()];
    texts("cycles", &valid, JSON, |text| {
        // A batch with malformed lines only is accepted too, but none of its cycles was read.
        Batch::parse(text.as_bytes()).is_ok_and(|batch| format!("{batch:?}").contains("cycle_time_s"))
    });
}

#[test]
fn fuzzed_robot_settings_are_read_or_refused() {
    let valid: Vec<Vec<u8>> =
        ["franka", "ur5e"].iter().flat_map(|robot| files(&format!("assets/robots/{robot}"), "robot.toml")).collect();
    texts("robot.toml", &valid, TOML, |text| RobotSettings::from_toml(text, Path::new("robot.toml")).is_ok());
}

#[test]
fn fuzzed_tasks_are_read_or_refused() {
    let valid: Vec<Vec<u8>> = ["drawer", "lid", "palletising"]
        .iter()
        .flat_map(|task| files(&format!("assets/tasks/{task}"), "task.toml"))
        .collect();
    texts("task.toml", &valid, TOML, |text| robogate_tasks::file::FileTask::read(text).is_ok());
}

/// A folder with a copy of the robot `name`, and the name of its model.
fn robot(name: &str) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let mut model = None;
    for file in fs::read_dir(repository(&format!("assets/robots/{name}"))).unwrap() {
        let path = file.unwrap().path();
        let copy = dir.path().join(path.file_name().unwrap());
        fs::copy(&path, &copy).unwrap();
        if copy.extension().is_some_and(|end| end == "xml") {
            model = Some(copy);
        }
    }
    (dir, model.unwrap())
}

#[test]
fn fuzzed_robot_models_are_read_or_refused() {
    let (dir, model) = robot("ur5e");
    texts("mjcf", &[fs::read(&model).unwrap()], XML, |text| {
        fs::write(&model, text).unwrap();
        Robot::from_folder(dir.path()).is_ok_and(|robot| Description::read(&robot).is_ok())
    });
}

/// Runs these commands in a folder of which one file is damaged, the next input another one. They end with a documented code, and
/// none of them panics.
pub(super) fn damaged(name: &str, folder: &Path, names: &[String], commands: &[&str]) {
    let whole: Vec<(PathBuf, Vec<u8>)> =
        names.iter().map(|name| (folder.join(name), fs::read(folder.join(name)).unwrap())).collect();
    let which = Cell::new(0);
    let damage = |draw: &mut fuzz::Draw| {
        let at = draw.below(whole.len());
        which.set(at);
        mutate(&[whole[at].1.clone()], JSON, draw)
    };
    let counts = fuzz::run(name, 30, damage, |bytes| {
        let (path, sound) = &whole[which.get()];
        fs::write(path, bytes).unwrap();
        let ends = commands.iter().map(|command| {
            let output = robogate_in(folder, &command.split(' ').collect::<Vec<_>>());
            (command, output.status.code(), text(&output))
        });
        let ends: Vec<_> = ends.collect();
        fs::write(path, sound).unwrap();
        for (command, code, printed) in &ends {
            let known = code.is_some_and(|code| (i32::from(PASS)..=i32::from(INFRASTRUCTURE)).contains(&code));
            assert!(known && !printed.contains("internal error"), "{}: {command}: {code:?}: {printed}", path.display());
        }
        ends.iter().all(|(_, code, _)| *code == Some(i32::from(PASS)))
    });
    assert!(counts.refused > 0, "{counts:?}");
}

/// The files of a folder in `dir`, relative to `dir`, in order.
pub(super) fn names_in(dir: &Path, folder: &str) -> Vec<String> {
    let files = fs::read_dir(dir.join(folder)).unwrap();
    let mut names: Vec<String> =
        files.map(|file| format!("{folder}/{}", file.unwrap().file_name().to_string_lossy())).collect();
    names.sort();
    names
}

#[test]
fn fuzzed_runs_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "run --task pendulum -n 40 --out run", 0, &[]);
    let names = ["run/plan.json", "run/summary.json", "run/dictionary.parquet"].map(str::to_owned);
    damaged(
        "run",
        dir.path(),
        &names,
        &["analyze run", "report run --out page.html --no-replay", "resume run", "replay run 3"],
    );
}

#[test]
fn fuzzed_shards_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    for shard in 0..2 {
        verb(dir.path(), &format!("run --task pendulum --design uniform -n 20 --shard {shard}/2 --out run"), 0, &[]);
    }
    let mut names = names_in(dir.path(), "run/shards");
    names.push("run/plan.json".to_owned());
    damaged("shards", dir.path(), &names, &["plan run", "plan run --next", "merge run --out merged"]);
}

#[test]
fn fuzzed_evidence_is_verified_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "gate --task pendulum --out gate", 1, &[]);
    verb(dir.path(), "evidence gate evidence", 1, &[]);
    damaged("evidence", dir.path(), &names_in(dir.path(), "evidence"), &["verify evidence"]);
}

/// Models of arms with grippers that people draft a robot from.
#[cfg(feature = "mujoco")]
#[test]
fn fuzzed_models_are_drafted_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let valid = files("crates/robogate-physics/tests/robots", ".xml");
    let path = dir.path().join("model.xml");
    let kept = fuzz::corpus(&repository("crates/robogate/tests/corpus/draft"));
    Target { name: "draft", valid: &valid, kept: &kept, words: XML, inputs: 30 }.run(|bytes| {
        fs::write(&path, bytes).unwrap();
        robogate_physics::draft(&path, "arm").is_ok()
    });
}
