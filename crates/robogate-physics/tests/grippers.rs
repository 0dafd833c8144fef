//! Tests of fingers that drives move through a linkage or a tendon.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::FRAC_PI_2;
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
    let inspection = inspect(folder.to_str().unwrap(), 1.0, &[]);
    assert_eq!(inspection.problems, [], "{text}");
    inspection.measured.unwrap().grasp.unwrap()
}

/// The measured motion of the linkage is that of its geometry, which springs, friction and motors do not change.
fn crank_follows_its_formula(folder: &Path) {
    let motion = FingerMotion::of(&Robot::from_folder(folder).unwrap()).unwrap().unwrap();
    let at = motion.joints.iter().position(|name| name == "left_driver").unwrap();
    for k in 1..8 {
        // Half of the opening: 10 mm + 50 mm cos(crank + atan(4 / 3)), independent of the measurement.
        let opening = 0.01 * f64::from(k);
        let crank = ((0.5 * opening - 0.01) / 0.05).acos() - (4.0_f64 / 3.0).atan();
        assert!(
            (motion.joints_at(opening)[at] - crank).abs() < 5e-3,
            "{opening}: {} {crank}",
            motion.joints_at(opening)[at]
        );
    }
}

/// The linkage with another text in each place.
fn changed(changes: &[(&str, &str)]) -> String {
    changes.iter().fold(LINKAGE.to_owned(), |model, (from, to)| {
        assert!(model.contains(from), "{from}");
        model.replace(from, to)
    })
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
    crank_follows_its_formula(&folder);
    let grasp = grasp(&folder, &text);
    assert!((grasp.opening_m.unwrap() - 0.08).abs() < 1e-3, "{grasp:?}");
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 1.5 && grasp.slip_m < 1e-3, "{grasp:?}");
}

#[test]
fn sprung_pads_are_measured_at_rest() {
    // A spring holds each heavy pad against the end of its range, as in fingers that adapt to a part. While the fingers are
    // measured, the arm's servos pull towards zero: if that moved the arm, the pads would swing.
    let tilt = |side: &str| {
        format!(
            "<body name=\"{side}_pad\" pos=\"0 -0.015 0.04\"><joint name=\"{side}_tilt\" pos=\"0 0 -0.02\" axis=\"1 0 0\" \
             range=\"-0.5 0\" stiffness=\"0.02\" springref=\"2.6\" damping=\"0.001\" armature=\"0.001\" \
             solreflimit=\"0.004 1\" solimplimit=\"0.99 0.999 0.0001\"/>"
        )
    };
    let sides = ["right", "left"].map(|side| (format!("<body name=\"{side}_pad\" pos=\"0 -0.015 0.04\">"), tilt(side)));
    let mut changes: Vec<(&str, &str)> = sides.iter().map(|(from, to)| (from.as_str(), to.as_str())).collect();
    changes.push(("mass=\"0.01\" pos=\"0 0 0\"", "mass=\"0.1\" pos=\"0 0 0\""));
    let (folder, text) = drafted("sprung", &changed(&changes), |text| text);
    crank_follows_its_formula(&folder);
    assert!(text.contains("home_rad") && !text.contains("home_rad = [0.0, 0.0"), "{text}");
}

#[test]
fn friction_does_not_weaken_the_grasp() {
    let stiff = "range=\"-1 1\" armature=\"0.02\" frictionloss=\"1\"/>";
    let model = changed(&[
        ("range=\"-1 1\"/>", stiff),
        ("range=\"-0.2 1\"/>", "range=\"-0.2 1\" armature=\"0.02\" frictionloss=\"1\"/>"),
    ]);
    let (folder, text) = drafted("friction", &model, |text| text);
    crank_follows_its_formula(&folder);
    let grasp = grasp(&folder, &text);
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 4.0 && grasp.slip_m < 1e-3, "{grasp:?}");
}

/// The linkage on an arm whose joints have no inertia of motors.
fn light() -> String {
    changed(&[("armature=\"0.1\" damping=\"1\"", "damping=\"1\"")])
}

#[test]
fn light_arm_holds_a_part() {
    // The drafted damping of the last servo stops thousands of times the inertia that it moves in a time step. If the contacts
    // did not know of that damping, the part would slip.
    let (folder, text) = drafted("light", &light(), |text| text);
    let grasp = grasp(&folder, &text);
    assert!(grasp.held && (grasp.force_n.unwrap() - 30.0).abs() < 3.0 && grasp.slip_m < 1e-3, "{grasp:?}");
}

#[test]
fn motors_give_torque_limits() {
    let motor = "<motor joint=\"elbow\" gear=\"2\" ctrllimited=\"true\" ctrlrange=\"-75 75\"/></actuator>";
    let (_, text) = drafted("motor", &changed(&[("</actuator>", motor)]), |text| text);
    assert!(text.contains("torque_limit_nm = [100.0, 100.0, 150.0, 100.0, 100.0, 100.0]"), "{text}");
    assert!(
        text.contains("torque_limit_nm = 100 for shoulder_pan, shoulder_lift, wrist_1, wrist_2, wrist_3"),
        "{text}"
    );
}

#[test]
fn loose_joints_are_named() {
    // Only a weak spring holds the left finger on its crank, so it swings when the arm moves.
    let model = changed(&[
        ("<connect body1=\"left_finger\" body2=\"left_inner\" anchor=\"0 -0.015 0.015\" solref=\"0.005 1\"/>", ""),
        (
            "<joint name=\"left_finger\" axis=\"1 0 0\" range=\"-1 1\"/>",
            "<joint name=\"left_finger\" axis=\"1 0 0\" range=\"-1 1\" stiffness=\"0.001\"/>",
        ),
    ]);
    let (folder, text) = drafted("loose", &model, |text| text);
    let problems = inspect(folder.to_str().unwrap(), 1.0, &[]).problems;
    let named = |what: &str| what.contains("joint `left_finger` is at") || what.contains("joint `left_inner` is at");
    let found = problems.iter().find(|problem| named(&problem.what));
    assert!(found.is_some_and(|problem| problem.hint.contains("couple it to the drive")), "{problems:#?}\n{text}");
}

#[test]
fn actuator_gives_a_missing_range() {
    let model = changed(&[("range=\"0 0.88\" armature", "armature")]);
    let (folder, text) = drafted("unlimited", &model, |text| text);
    assert!(text.contains("closed = 0.88") && text.contains("open = 0.0"), "{text}");
    crank_follows_its_formula(&folder);
}

#[test]
fn home_is_turned_over_the_workspace() {
    // The tool of this keyframe waits beside the base, with the elbow up.
    let key = "<keyframe><key name=\"home\" qpos=\"1.5708 -1.5708 1.5708 -1.5708 -1.5708 0 0 0 0 0 0 0\"/></keyframe></mujoco>";
    let (folder, text) = drafted("beside", &changed(&[("</mujoco>", key)]), |text| text);
    let home = Robot::from_folder(&folder).unwrap().settings.arm.home_rad;
    assert!(home[0].abs() < 0.5 && (home[2] - FRAC_PI_2).abs() < 0.5, "{text}");
    grasp(&folder, &text);
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
    let inspection = inspect(folder.to_str().unwrap(), 1.0, &[]);
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
        let inspection = inspect(folder.to_str().unwrap(), 1.0, &[]);
        let found = inspection.problems.iter().any(|problem| problem.what.contains(part) && !problem.hint.is_empty());
        assert!(found, "{name}: {:#?}\n{text}", inspection.problems);
    }
}
