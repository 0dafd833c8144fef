//! Tests of the checks of a robot's folder.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{MujocoEngine, Robot};

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

fn assert_refused(name: &str, model: &str, settings: &str, parts: &[&str]) {
    let error = engine(name, model, settings).err().unwrap();
    for part in parts {
        assert!(error.contains(part), "{name} does not report {part:?}: {error}");
    }
}

#[test]
fn invalid_robot_is_rejected() {
    let floor = MODEL.replace("<worldbody>", "<worldbody><geom name=\"floor\" type=\"plane\" size=\"1 1 1\"/>");
    assert_refused("floor", &floor, SETTINGS, &["floor", "must not contain a scene"]);
    let change = |from: &str, to: &str| {
        assert!(SETTINGS.contains(from), "{from}");
        SETTINGS.replace(from, to)
    };
    assert_refused("home", MODEL, &change("-2.356194", "2.356194"), &["joint4", "home_rad", "2.356194"]);
    assert_refused("opening", MODEL, &change("opening_m = 0.08", "opening_m = 0.5"), &["opening_m", "0.5", "0.08"]);
    let twins = change("[\"left_finger\", \"right_finger\"]", "[\"left_finger\", \"left_finger\"]");
    assert_refused("twins", MODEL, &twins, &["same name"]);
    let misspelt = change("[\"left_finger\", \"right_finger\"]", "[\"left_fingr\", \"right_finger\"]");
    assert_refused("misspelt", MODEL, &misspelt, &["body", "left_fingr"]);
    assert_refused("site", MODEL, &change("tcp_site = \"tcp\"", "tcp_site = \"tip\""), &["site", "tip"]);
    let six = change("\"joint6\", \"joint7\"]", "\"joint6\"]");
    assert_refused("six", MODEL, &six, &["home_rad", "7", "6"]);
    assert_refused(
        "outside",
        MODEL,
        &change("model = \"franka.xml\"", "model = \"../franka.xml\""),
        &["../franka.xml"],
    );
    let still = change("[15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]", "[15.0, 1e-9, 10.0, 12.5, 15.0, 20.0, 20.0]");
    assert_refused("still", MODEL, &still, &["acceleration_limit_rad_s2", "0.001"]);
}
