//! Tests that a robot's folder defines only the robot and not the cell.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Assignment, Outcome, Scenario, Seed, Value, rollout};
use robogate_physics::{Engine, MujocoEngine, Robot};
use robogate_tasks::pick_place::{PickPlace, Scripted};
use robogate_tasks::{ArmTask, Rig};

const MODEL: &str = include_str!("../../../assets/robots/franka/franka.xml");
const SETTINGS: &str = include_str!("../../../assets/robots/franka/robot.toml");

/// A folder with a modified Franka.
fn folder(name: &str, model: &str, settings: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("franka.xml"), model).unwrap();
    fs::write(folder.join("robot.toml"), settings).unwrap();
    folder
}

fn engine(name: &str, model: &str, settings: &str) -> Result<MujocoEngine, String> {
    let robot = Robot::from_folder(&folder(name, model, settings)).map_err(|e| e.to_string())?;
    MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S).map_err(|e| e.to_string())
}

fn outcome(name: &str, model: &str, friction: f64) -> Outcome {
    let engine = engine(name, model, SETTINGS).unwrap();
    let mut policy = Scripted::new(engine.robot().clone(), engine.chain().clone());
    let mut simulator = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let mut requested = Assignment::default();
    requested.set("friction", Value::Number(friction));
    requested.set("mass_kg", Value::Number(1.0));
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
    rollout(&mut simulator, &mut policy, &scenario).outcome
}

#[test]
fn robot_file_does_not_change_world() {
    // 1 kg held with twice 30 N needs a friction coefficient of 0.16.
    assert_ne!(outcome("plain", MODEL, 0.1), Outcome::Success);
    assert_eq!(outcome("plain", MODEL, 0.4), Outcome::Success);
    let sticky = MODEL
        .replace("name=\"left_pad\"", "name=\"left_pad\" friction=\"1.5 0 0\" priority=\"1\"")
        .replace("name=\"right_pad\"", "name=\"right_pad\" friction=\"1.5 0 0\" priority=\"1\"");
    assert_ne!(outcome("sticky", &sticky, 0.1), Outcome::Success, "the friction of the pads took effect");
    for (name, element) in [
        ("weightless", "<option gravity=\"0 0 0\"><flag gravity=\"disable\"/></option>"),
        ("ghostly", "<option><flag contact=\"disable\"/></option>"),
        ("wide", "<default><geom margin=\"0.03\" gap=\"0\"/></default>"),
        ("heavy", "<compiler boundinertia=\"0.01\" boundmass=\"5\"/>"),
        ("small", "<size memory=\"20K\"/>"),
    ] {
        let model = MODEL.replace("<worldbody>", &format!("{element}<worldbody>"));
        assert_ne!(outcome(name, &model, 0.1), Outcome::Success, "{name}");
        assert_eq!(outcome(name, &model, 0.4), Outcome::Success, "{name}");
    }
}
