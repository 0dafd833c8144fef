//! Tests of grippers with one moving jaw.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{Engine, Gripper, MujocoEngine, ParallelJaw, Robot, draft, inspect};

/// A table-top arm with five joints, 0.35 m long: pan, lift, elbow, wrist and roll. `jaw` is what its last link carries.
fn arm(jaw: &str) -> String {
    let link = |name: &str, at: &str, axis: &str, range: &str, length: f64, rest: &str| {
        format!(
            "<body name=\"{name}\" pos=\"{at}\"><joint name=\"{name}\" axis=\"{axis}\" range=\"{range}\" armature=\"0.02\" damping=\"0.5\" \
             actuatorfrcrange=\"-6 6\"/><geom type=\"capsule\" size=\"0.012\" fromto=\"0 0 0 0 0 {length}\" mass=\"0.1\"/>{rest}</body>"
        )
    };
    let roll = link("roll", "0 0 0.05", "0 0 1", "-2.7 2.7", 0.02, jaw);
    let wrist = link("wrist", "0 0 0.135", "0 1 0", "-1.7 1.7", 0.03, &roll);
    let elbow = link("elbow", "0 0 0.116", "0 1 0", "-0.2 2.9", 0.1, &wrist);
    let lift = link("lift", "0 0 0.06", "0 1 0", "-1.8 1.8", 0.09, &elbow);
    let pan = link("pan", "0 0 0.05", "0 0 1", "-1.9 1.9", 0.04, &lift);
    format!(
        "<mujoco><compiler angle=\"radian\"/><worldbody><body name=\"base\"><geom type=\"cylinder\" size=\"0.04 0.02\" pos=\"0 0 0.02\"/>{pan}\
         </body></worldbody><contact><exclude body1=\"base\" body2=\"pan\"/></contact></mujoco>"
    )
}

/// A fixed jaw, 0.1 m long, and one on a hinge beside its root that meets it at 0 and opens to `open` radians about `axis`.
fn hinged(axis: &str, range: &str) -> String {
    format!(
        "<geom name=\"fixed\" type=\"box\" size=\"0.008 0.002 0.035\" pos=\"0 -0.012 0.065\" mass=\"0.03\"/>\
         <body name=\"moving\" pos=\"0 0.012 0.03\"><joint name=\"gripper\" axis=\"{axis}\" range=\"{range}\" armature=\"0.005\"/>\
         <geom type=\"box\" size=\"0.008 0.002 0.035\" pos=\"0 -0.011 0.035\" euler=\"0.32 0 0\" mass=\"0.02\"/></body>"
    )
}

fn folder(name: &str, model: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("one-jaw").join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("arm.xml"), model).unwrap();
    folder
}

/// The gripper of a drafted robot, and its folder.
fn drafted(name: &str, model: &str) -> (ParallelJaw, PathBuf) {
    let folder = folder(name, model);
    let text = draft(&folder.join("arm.xml"), name).unwrap().text;
    fs::write(folder.join("robot.toml"), &text).unwrap();
    let settings = Robot::from_folder(&folder).unwrap().settings;
    assert_eq!(settings.arm.joints, ["pan", "lift", "elbow", "wrist", "roll"], "{text}");
    match settings.gripper {
        Gripper::ParallelJaw(jaw) => (jaw, folder),
        Gripper::Suction(_) => panic!("a jaw was expected: {text}"),
    }
}

#[test]
fn jaw_is_found_in_either_direction() {
    // The jaw may open in either direction of its joint.
    for (name, axis, range) in [("up", "-1 0 0", "-0.1 1.6"), ("down", "1 0 0", "-1.6 0.1")] {
        let (jaw, _) = drafted(name, &arm(&hinged(axis, range)));
        assert_eq!(jaw.finger_bodies, ["roll", "moving"]);
        let drive = &jaw.drives[0];
        assert!(drive.moves == "gripper" && (drive.open - drive.closed).abs() < 1.0, "{jaw:?}");
        assert!(jaw.opening_m > 0.03 && jaw.fixed_jaw_m.is_some(), "{jaw:?}");
    }
}

#[test]
fn one_sliding_finger_is_a_jaw() {
    let slide = "<geom type=\"box\" size=\"0.008 0.002 0.035\" pos=\"0 -0.012 0.065\" mass=\"0.03\"/>\
                 <body name=\"moving\" pos=\"0 -0.008 0.03\"><joint name=\"gripper\" type=\"slide\" axis=\"0 1 0\" range=\"0 0.04\" armature=\"0.2\"/>\
                 <geom type=\"box\" size=\"0.008 0.002 0.035\" pos=\"0 0 0.035\" mass=\"0.02\"/></body>";
    let (jaw, _) = drafted("slide", &arm(slide));
    // The faces touch at 0.
    assert!((jaw.opening_m - 0.04).abs() < 1e-3, "{jaw:?}");
    assert!((jaw.drives[0].open - 0.04).abs() < 1e-6 && jaw.drives[0].closed.abs() < 1e-6, "{jaw:?}");
}

/// A tool on the last of five joints is not taken for a jaw, because nothing is beside it.
#[test]
fn last_joint_of_the_arm_is_no_jaw() {
    let folder = folder("bare", &arm(""));
    let text = draft(&folder.join("arm.xml"), "bare").unwrap().text;
    assert!(text.contains("suction") && text.contains("\"roll\"]"), "{text}");
    let alone = "<body name=\"moving\" pos=\"0 0 0.03\"><joint name=\"jaw\" axis=\"1 0 0\" range=\"-1 1\"/>\
                 <geom type=\"box\" size=\"0.008 0.002 0.035\" pos=\"0 0 0.035\" mass=\"0.02\"/></body>";
    let problems = draft(&self::folder("alone", &arm(alone)).join("arm.xml"), "alone").unwrap_err();
    assert!(problems[0].what.contains("`jaw` is the only finger that moves"), "{problems:?}");
}

#[test]
fn fixed_jaw_must_be_where_it_is_stated() {
    let (jaw, folder) = drafted("stated", &arm(&hinged("-1 0 0", "-0.1 1.6")));
    let text = fs::read_to_string(folder.join("robot.toml")).unwrap();
    let stated = format!("fixed_jaw_m = {}", jaw.fixed_jaw_m.unwrap());
    assert!(text.contains(&stated[..20]), "{text}");
    let wrong = text.replace("fixed_jaw_m = ", "fixed_jaw_m = 0.005 # ");
    fs::write(folder.join("robot.toml"), wrong).unwrap();
    let problems = inspect(folder.to_str().unwrap(), 0.35, &[]).problems;
    assert!(problems[0].what.contains("gripper.fixed_jaw_m = 0.005"), "{problems:?}");
}

/// Five joints reach every position and yaw of a tool that points down.
#[test]
fn five_joints_reach_position_and_yaw() {
    use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
    let (_, folder) = drafted("reach", &arm(&hinged("-1 0 0", "-0.1 1.6")));
    let engine = MujocoEngine::new(Robot::from_folder(&folder).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    let (chain, home) = (engine.chain(), &engine.robot().settings.arm.home_rad);
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    for (x, y, yaw) in [(0.15, 0.0, 0.3), (0.14, 0.08, -0.9), (0.16, -0.06, 1.2)] {
        // The roll does not turn fully, so the other way round counts too.
        let reached = [0.0, std::f64::consts::PI].iter().find_map(|turn| {
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw + turn);
            let goal = Isometry3::from_parts(Translation3::new(x, y, 0.03), yaw * down);
            chain.reach(&goal, home).map(|q| goal.inverse() * chain.tcp_at(&q)).ok()
        });
        let reached = reached.unwrap();
        assert!(reached.translation.vector.norm() < 1e-5 && reached.rotation.angle() < 1e-3, "{reached}");
    }
    // It cannot tilt the tool to the side.
    let tilted = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.4) * down;
    assert!(chain.reach(&Isometry3::from_parts(Translation3::new(0.15, 0.0, 0.05), tilted), home).is_err());
}
