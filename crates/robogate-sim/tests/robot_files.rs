//! A robot's folder says what the robot is, and nothing about the cell.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_core::{Assignment, Outcome, Scenario, Seed, Value, rollout};
use robogate_sim::{Engine, MujocoEngine, PickPlace, Robot, Scripted};

const MODEL: &str = include_str!("../../../assets/robots/franka/franka.xml");
const SETTINGS: &str = include_str!("../../../assets/robots/franka/robot.toml");

/// A folder with the Franka, changed.
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
    let mut simulator = PickPlace::new(engine, None).unwrap();
    let mut requested = Assignment::default();
    requested.set("friction", Value::Number(friction));
    requested.set("mass_kg", Value::Number(1.0));
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
    rollout(&mut simulator, &mut policy, &scenario).outcome
}

fn assert_refused(name: &str, model: &str, settings: &str, parts: &[&str]) {
    let error = engine(name, model, settings).err().unwrap();
    for part in parts {
        assert!(error.contains(part), "{name} does not say {part:?}: {error}");
    }
}

#[test]
fn what_a_robots_file_says_about_the_world_does_not_reach_the_cell() {
    // 1 kg held with twice 30 N needs a friction of 0.16.
    assert_ne!(outcome("plain", MODEL, 0.1), Outcome::Success);
    assert_eq!(outcome("plain", MODEL, 0.4), Outcome::Success);
    let sticky = MODEL
        .replace("name=\"left_pad\"", "name=\"left_pad\" friction=\"1.5 0 0\" priority=\"1\"")
        .replace("name=\"right_pad\"", "name=\"right_pad\" friction=\"1.5 0 0\" priority=\"1\"");
    assert_ne!(outcome("sticky", &sticky, 0.1), Outcome::Success, "the pads' own friction won");
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

#[test]
fn a_robot_that_cannot_be_is_refused_by_name() {
    let floor = MODEL.replace("<worldbody>", "<worldbody><geom name=\"floor\" type=\"plane\" size=\"1 1 1\"/>");
    assert_refused("floor", &floor, SETTINGS, &["floor", "no scene"]);
    let change = |from: &str, to: &str| {
        assert!(SETTINGS.contains(from), "{from}");
        SETTINGS.replace(from, to)
    };
    assert_refused("home", MODEL, &change("-2.356194", "2.356194"), &["joint4", "home_rad", "2.356194"]);
    assert_refused("opening", MODEL, &change("opening_m = 0.08", "opening_m = 0.5"), &["opening_m", "0.5", "0.08"]);
    let twins = change("[\"left_finger\", \"right_finger\"]", "[\"left_finger\", \"left_finger\"]");
    assert_refused("twins", MODEL, &twins, &["one and the same"]);
    let misspelt = change("[\"left_finger\", \"right_finger\"]", "[\"left_fingr\", \"right_finger\"]");
    assert_refused("misspelt", MODEL, &misspelt, &["body", "left_fingr"]);
    assert_refused("site", MODEL, &change("tcp_site = \"tcp\"", "tcp_site = \"tip\""), &["site", "tip"]);
    let six = change("\"joint6\", \"joint7\"]", "\"joint6\"]");
    assert_refused("six", MODEL, &six, &["home_rad", "7", "6"]);
    let limitless = MODEL.replace("name=\"joint3\" range=\"-2.8973 2.8973\"", "name=\"joint3\"");
    assert_refused("limitless", &limitless, SETTINGS, &["joint3", "no limits"]);
    assert_refused(
        "outside",
        MODEL,
        &change("model = \"franka.xml\"", "model = \"../franka.xml\""),
        &["../franka.xml"],
    );
    let still = change("[15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]", "[15.0, 1e-9, 10.0, 12.5, 15.0, 20.0, 20.0]");
    assert_refused("still", MODEL, &still, &["acceleration_limit_rad_s2", "0.001"]);
}
