//! Tests of fingers that drives move through a linkage or a tendon.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{FingerMotion, Grasp, Robot, draft, inspect};

const LINKAGE: &str = include_str!("robots/linkage.xml");
const TENDON: &str = include_str!("robots/tendon.xml");

/// A robot's folder with this model and its drafted settings.
fn drafted(name: &str, model: &str, change: impl Fn(String) -> String) -> (PathBuf, String) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("grippers").join(name);
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("model.xml");
    fs::write(&file, model).unwrap();
    let text = change(draft(&file, name).unwrap().text);
    fs::write(folder.join("robot.toml"), &text).unwrap();
    (folder, text)
}

fn grasp(folder: &Path, text: &str) -> Grasp {
    let inspection = inspect(folder.to_str().unwrap(), &[]);
    assert_eq!(inspection.problems, [], "{text}");
    inspection.measured.unwrap().grasp.unwrap()
}

#[test]
fn linkage_grasps_with_its_stated_force() {
    let (folder, text) = drafted("linkage", LINKAGE, |text| text);
    // The crank's pivot is 30 mm off the middle, it moves by 30 mm, and the pad's face is 20 mm inside of its end.
    let motion = FingerMotion::of(&Robot::from_folder(&folder).unwrap()).unwrap().unwrap();
    for (opening, crank) in [(0.08, 0.0), (0.0, 0.844_8)] {
        let joints = motion.joints_at(opening);
        let at = motion.joints.iter().position(|name| name == "right_driver").unwrap();
        assert!((joints[at] - crank).abs() < 5e-3, "{opening}: {joints:?}");
    }
    for k in 1..8 {
        // Half of the opening: 10 mm + 50 mm cos(crank + atan(4 / 3)), independent of the measurement.
        let opening = 0.01 * f64::from(k);
        let crank = ((0.5 * opening - 0.01) / 0.05).acos() - (4.0_f64 / 3.0).atan();
        let at = motion.joints.iter().position(|name| name == "left_driver").unwrap();
        assert!((motion.joints_at(opening)[at] - crank).abs() < 5e-3, "{opening}");
    }
    let grasp = grasp(&folder, &text);
    assert!((grasp.opening_m.unwrap() - 0.08).abs() < 1e-3, "{grasp:?}");
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 1.5 && grasp.slip_m < 1e-3, "{grasp:?}");
}

#[test]
fn tendon_grasps_with_its_stated_force() {
    let (folder, text) = drafted("tendon", TENDON, |text| text);
    assert!(text.contains("moves = \"cable\"") && !text.contains("finger_joints"), "{text}");
    let grasp = grasp(&folder, &text);
    assert!((grasp.opening_m.unwrap() - 0.086).abs() < 1e-3, "{grasp:?}");
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 1.5 && grasp.slip_m < 1e-3, "{grasp:?}");
}

#[test]
fn two_drives_share_the_force() {
    let model = TENDON.replace(
        "<joint joint1=\"right_finger\" joint2=\"left_finger\" polycoef=\"0 -1 0 0 0\" solref=\"0.005 1\"/>",
        "",
    );
    let servo = |side: &str, range: &str| {
        format!("<position name=\"{side}\" joint=\"{side}_finger\" kp=\"500\" ctrlrange=\"{range}\"/>")
    };
    let servos = servo("left", "-0.04 0.005") + &servo("right", "-0.005 0.04");
    let start = model.find("<general name=\"grip\"").unwrap();
    let end = start + model[start..].find("/>").unwrap() + 2;
    let model = format!("{}{servos}{}", &model[..start], &model[end..]);
    let (folder, text) = drafted("pair", &model, |text| text);
    assert!(text.contains("moves = \"left_finger\"") && text.contains("moves = \"right_finger\""), "{text}");
    let grasp = grasp(&folder, &text);
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 1.5 && grasp.slip_m < 1e-3, "{grasp:?}");
}

#[test]
fn opening_is_read_from_the_pads() {
    let (folder, _) = drafted("thick", LINKAGE, |text| text);
    let thick = LINKAGE
        .replace("<geom type=\"box\" size=\"0.011 0.005 0.02\"/>", "<geom type=\"box\" size=\"0.011 0.009 0.02\"/>");
    fs::write(folder.join("model.xml"), thick).unwrap();
    let inspection = inspect(folder.to_str().unwrap(), &[]);
    assert!(inspection.problems[0].what.contains("the pads are 0.0720 m apart"), "{:?}", inspection.problems);
}

#[test]
fn wrong_drives_are_reported() {
    let drive = |from: &'static str, to: &'static str| {
        move |text: String| {
            assert!(text.contains(from), "{text}");
            text.replace(from, to)
        }
    };
    for (name, from, to, part) in [
        ("no-joint", "moves = \"right_driver\"", "moves = \"crank\"", "no joint or tendon `crank`"),
        ("still", "closed = 0.88", "closed = 0.0", "open = 0 and closed = 0 must differ"),
        ("short", "tip_m = ", "tip_m = 0.001 #", "gripper.tip_m = 0.001"),
        ("both", "[[gripper.drive]]", "finger_joints = [\"a\", \"b\"]\n[[gripper.drive]]", "either finger_joints"),
    ] {
        let (folder, text) = drafted(name, LINKAGE, drive(from, to));
        let inspection = inspect(folder.to_str().unwrap(), &[]);
        let found = inspection.problems.iter().any(|problem| problem.what.contains(part) && !problem.hint.is_empty());
        assert!(found, "{name}: {:#?}\n{text}", inspection.problems);
    }
}
