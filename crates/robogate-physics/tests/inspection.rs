//! Tests of the inspection of robots, with every problem that it detects.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{Inspection, Problem, built_in_robots, inspect};

const MODEL: &str = include_str!("../../../assets/robots/franka/franka.xml");
const SETTINGS: &str = include_str!("../../../assets/robots/franka/robot.toml");

fn folder(name: &str, files: &[(&str, &str)]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("inspection").join(name);
    let _ = fs::remove_dir_all(&folder);
    for (file, content) in files {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
    folder
}

fn look(folder: &Path) -> Inspection {
    inspect(folder.to_str().unwrap(), 1.0, &[])
}

/// Replaces `from`, which must occur in the text.
fn change(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from}");
    text.replace(from, to)
}

#[test]
fn built_in_robots_pass_inspection() {
    for name in built_in_robots() {
        let inspection = inspect(name, 1.0, &[[0.4, 0.0], [3.0, 0.0]]);
        assert!(inspection.problems.is_empty(), "{name}: {:#?}", inspection.problems);
        let measured = inspection.measured.unwrap();
        assert_eq!(measured.reaches, [true, false], "{name}");
        assert!(measured.tracking_error_rad.unwrap() < 0.01 && measured.workspace_share > 0.2, "{name}: {measured:?}");
    }
}

/// Asserts that the inspection reports each of these problems, each with a hint.
fn assert_says(name: &str, model: &str, settings: &str, parts: &[&str]) {
    let inspection = look(&folder(name, &[("franka.xml", model), ("robot.toml", settings)]));
    for part in parts {
        let found = inspection.problems.iter().find(|problem| problem.what.contains(part));
        let found = found.unwrap_or_else(|| panic!("{name} does not report {part:?}: {:#?}", inspection.problems));
        assert!(!found.hint.is_empty(), "{name}: no hint for {part:?}");
    }
    assert_eq!(inspection.problems.len(), parts.len(), "{name}: {:#?}", inspection.problems);
}

#[test]
fn robot_without_collision_shapes_is_rejected() {
    let untouchable =
        change(MODEL, "<default class=\"arm\">", "<default class=\"arm\"><geom contype=\"0\" conaffinity=\"0\"/>");
    let untouchable = change(&untouchable, "<geom rgba=\"0.93 0.93 0.95 1\"/>", "");
    let untouchable = change(
        &untouchable,
        "<geom rgba=\"0.35 0.35 0.38 1\"/>",
        "<geom rgba=\"0.35 0.35 0.38 1\" contype=\"0\" conaffinity=\"0\"/>",
    );
    assert_says("untouchable", &untouchable, SETTINGS, &["pass through everything"]);
    let bare = change(
        MODEL,
        "<geom rgba=\"0.35 0.35 0.38 1\"/>",
        "<geom rgba=\"0.35 0.35 0.38 1\" contype=\"0\" conaffinity=\"0\"/>",
    );
    assert_says("bare-fingers", &bare, SETTINGS, &["`left_finger`", "`right_finger`"]);
}

#[test]
fn built_in_name_ignores_folders() {
    assert!(!robogate_physics::is_folder("ur5e"));
    assert!(robogate_physics::is_folder(&std::env::temp_dir().to_string_lossy()));
}

#[test]
fn all_problems_are_reported_at_once() {
    let mut model = change(
        MODEL,
        "<worldbody>",
        "<asset><mesh name=\"a\" file=\"a.stl\"/><mesh name=\"b\" file=\"b.stl\"/></asset><worldbody>",
    );
    model = change(
        &model,
        "<geom name=\"link4\" type=\"capsule\" fromto=\"0 0 -0.05 0 0 0.05\" size=\"0.055\"/>",
        "<geom type=\"mesh\" mesh=\"a\"/>",
    );
    let mut settings = change(SETTINGS, "[87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]", "[87.0, 87.0]");
    settings = change(&settings, "tcp_site = \"tcp\"", "tcp_site = \"tip\"");
    settings = change(&settings, "1.570796, 0.785398]", "9.0, 0.785398]");
    settings = change(&settings, "opening_m = 0.08", "opening_m = 0.5");
    settings = change(&settings, "payload_kg = 3.0", "payload_kg = 0.0");
    assert_says(
        "wrong",
        &model,
        &settings,
        &[
            "arm.torque_limit_nm has 2 entries, arm.joints has 7",
            "arm.payload_kg = 0",
            "the model has no site `tip`",
            "mesh `a`: the file ",
            "mesh `b`: the file ",
            "joint `joint6`: arm.home_rad has 9",
            "gripper.opening_m = 0.5",
        ],
    );
}

#[test]
fn trial_reports_dynamic_problems() {
    let into_table = change(
        SETTINGS,
        "[0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]",
        "[0.0, 0.9, 0.0, -1.9, 0.0, 2.8, 0.785398]",
    );
    let inspection = look(&folder("table", &[("franka.xml", MODEL), ("robot.toml", &into_table)]));
    assert!(inspection.problems.iter().any(|p| p.what.contains("touches the table")), "{:#?}", inspection.problems);
    let thick = change(MODEL, "size=\"0.035\"", "size=\"0.12\"");
    let inspection = look(&folder("thick", &[("franka.xml", &thick), ("robot.toml", SETTINGS)]));
    let deep = |p: &Problem| p.what.contains("`link5` and `link7`") && p.what.contains("penetrate each other");
    assert!(inspection.problems.iter().any(deep), "{:#?}", inspection.problems);
    let over = change(
        MODEL,
        "<site name=\"tcp\" pos=\"0 0 0.1034\"/>",
        "<site name=\"tcp\" pos=\"0 0 0.1034\" euler=\"3.141593 0 0\"/>",
    );
    assert_says("over", &over, SETTINGS, &["points from the tool back to the flange", "180 degrees off straight down"]);
    assert_says("far", MODEL, &change(SETTINGS, "reach_m = 0.855", "reach_m = 85.5"), &["arm.reach_m = 85.5"]);
    let weak = change(SETTINGS, "torque_limit_nm = [87.0,", "torque_limit_nm = [0.01,");
    assert_says("weak", MODEL, &weak, &["joint `joint1` is up to"]);
}

#[test]
fn spring_of_a_cup_is_checked() {
    const CUP: &str = include_str!("../../../assets/robots/ur5e/ur5e.xml");
    const CUP_SETTINGS: &str = include_str!("../../../assets/robots/ur5e/robot.toml");
    let reported = |name: &str, model: &str, settings: &str| {
        let inspection = look(&folder(name, &[("ur5e.xml", model), ("robot.toml", settings)]));
        assert_eq!(inspection.problems.len(), 1, "{name}: {:#?}", inspection.problems);
        inspection.problems[0].what.clone()
    };
    let elsewhere = change(CUP_SETTINGS, "tcp_site = \"tcp\"", "tcp_site = \"lip\"");
    let elsewhere =
        format!("{elsewhere}\n[[site]]\nname = \"lip\"\nbody = \"suction_tool\"\nposition_m = [0.0, 0.0, 0.12]\n");
    assert!(reported("spring-site", CUP, &elsewhere).contains("site `lip` is not on the body `suction_cup`"));
    let jointed = change(
        CUP,
        "<body name=\"suction_cup\" pos=\"0 0 0.1\">",
        "<body name=\"suction_cup\" pos=\"0 0 0.1\"><joint name=\"own\" class=\"turn\"/>",
    );
    let inspection = look(&folder("spring-joint", &[("ur5e.xml", &jointed), ("robot.toml", CUP_SETTINGS)]));
    assert!(
        inspection.problems.iter().any(|p| p.what.contains("`suction_cup` has a joint of its own")),
        "{:#?}",
        inspection.problems
    );
    let short = change(CUP_SETTINGS, "stroke_m = 0.01", "stroke_m = 0.0");
    assert!(reported("spring-stroke", CUP, &short).contains("gripper.bellows.stroke_m = 0"));
}

#[test]
fn incomplete_folder_names_missing_files() {
    for (name, files, part) in [
        ("empty", vec![("readme.txt", "")], "robot.toml"),
        ("no-model", vec![("robot.toml", SETTINGS)], "franka.xml"),
        ("no-toml", vec![("robot.toml", "name = ")], "robot.toml"),
        ("no-xml", vec![("robot.toml", SETTINGS), ("franka.xml", "<mujoco>")], ""),
    ] {
        let inspection = look(&folder(name, &files));
        assert_eq!(inspection.problems.len(), 1, "{name}: {:#?}", inspection.problems);
        assert!(inspection.problems[0].what.contains(part) || name == "no-toml", "{:#?}", inspection.problems);
    }
    assert!(inspect("no such robot", 1.0, &[]).problems[0].what.contains("unknown robot `no such robot`"));
}
