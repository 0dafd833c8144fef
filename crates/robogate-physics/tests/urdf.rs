//! Tests of arms as URDF: grippers with light fingers, openings, continuous joints, links without mass, and mesh files.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{Gripper, Inspection, ParallelJaw, Problem, Robot, draft, inspect};

/// Offset, axis and range (rad) of each joint of an arm that reaches 0.75 m.
const JOINTS: [(f64, &str, f64); 6] = [
    (0.12, "0 0 1", 2.9),
    (0.06, "0 1 0", 2.0),
    (0.36, "0 1 0", 2.6),
    (0.30, "0 0 1", 2.9),
    (0.03, "0 1 0", 2.2),
    (0.06, "0 0 1", 2.9),
];
/// Mass (kg), shape (centre above the link's frame, radius, length in m) of each link, from the base.
const LINKS: [(f64, f64, f64, f64); 7] = [
    (2.0, 0.04, 0.06, 0.08),
    (3.0, 0.0, 0.05, 0.06),
    (3.0, 0.17, 0.04, 0.24),
    (2.0, 0.16, 0.035, 0.2),
    (1.0, 0.0, 0.03, 0.02),
    (1.0, 0.05, 0.03, 0.02),
    (0.5, 0.04, 0.03, 0.01),
];

fn link(name: &str, mass: f64, inertia: f64, geometry: &str, z: f64) -> String {
    format!(
        "<link name=\"{name}\"><inertial><mass value=\"{mass}\"/><inertia ixx=\"{inertia}\" ixy=\"0\" ixz=\"0\" iyy=\"{inertia}\" \
         iyz=\"0\" izz=\"{inertia}\"/></inertial><collision><origin xyz=\"0 0 {z}\"/><geometry>{geometry}</geometry></collision></link>"
    )
}

fn joint(name: &str, kind: &str, [parent, child]: [&str; 2], at: &str, rest: &str) -> String {
    format!(
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/><origin xyz=\"{at}\"/>{rest}</joint>"
    )
}

/// The arm with these further elements.
fn arm(rest: &str) -> String {
    let mut text = "<robot name=\"arm\">".to_owned();
    for (i, (mass, z, radius, length)) in LINKS.into_iter().enumerate() {
        let shape = format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>");
        text += &link(&format!("l{i}"), mass, 0.01 * mass, &shape, z);
    }
    for (i, (z, axis, range)) in JOINTS.into_iter().enumerate() {
        let limits = format!(
            "<axis xyz=\"{axis}\"/><limit lower=\"-{range}\" upper=\"{range}\" effort=\"{}\" velocity=\"2.5\"/>",
            if i < 3 { 150 } else { 30 }
        );
        let _ = write!(
            text,
            "{}",
            joint(
                &format!("j{}", i + 1),
                "revolute",
                [&format!("l{i}"), &format!("l{}", i + 1)],
                &format!("0 0 {z}"),
                &limits
            )
        );
    }
    text + rest + "</robot>"
}

/// A hand with two sliding fingers of this mass (kg).
fn slides(mass: f64) -> String {
    let finger = |name: &str| link(name, mass, 1e-4 * mass, "<box size=\"0.02 0.01 0.05\"/>", 0.035);
    let slide = |name: &str, side: &str, sign: &str, rest: &str| {
        let rest = format!(
            "<axis xyz=\"0 {sign}1 0\"/><limit lower=\"0\" upper=\"0.04\" effort=\"100\" velocity=\"0.2\"/>{rest}"
        );
        joint(name, "prismatic", ["hand", side], &format!("0 {sign}0.005 0.07"), &rest)
    };
    hand()
        + &finger("right")
        + &finger("left")
        + &slide("drive", "right", "-", "")
        + &slide("follower", "left", "", "<mimic joint=\"drive\"/>")
}

fn hand() -> String {
    link("hand", 0.5, 0.005, "<box size=\"0.04 0.1 0.02\"/>", 0.06) + &joint("jh", "fixed", ["l6", "hand"], "0 0 0", "")
}

fn folder(name: &str, model: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("urdf").join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("arm.urdf"), model).unwrap();
    folder
}

fn drafted(folder: &Path) -> Result<String, Vec<Problem>> {
    let text = draft(&folder.join("arm.urdf"), "arm")?.text;
    fs::write(folder.join("robot.toml"), &text).unwrap();
    Ok(text)
}

fn checked(name: &str, model: &str) -> Inspection {
    let folder = folder(name, model);
    drafted(&folder).unwrap();
    inspect(folder.to_str().unwrap(), 1.0, &[])
}

fn passes(name: &str, model: &str) -> Inspection {
    let inspection = checked(name, model);
    assert_eq!(inspection.problems, [], "{name}");
    inspection
}

fn jaw(folder: &Path) -> ParallelJaw {
    match Robot::from_folder(folder).unwrap().settings.gripper {
        Gripper::ParallelJaw(jaw) => jaw,
        Gripper::Suction(_) => panic!("a jaw was expected"),
    }
}

#[test]
fn grasp_does_not_depend_on_the_mass_of_fingers() {
    for mass in [0.005, 0.029, 0.1, 0.5] {
        let inspection = passes(&format!("fingers-{mass}"), &arm(&slides(mass)));
        let measured = inspection.measured.unwrap();
        let grasp = measured.grasp.unwrap();
        assert!((grasp.force_n.unwrap() - 30.0).abs() < 1.0 && grasp.slip_m < 5e-4, "{mass}: {grasp:?}");
        assert!((grasp.opening_m.unwrap() - 0.08).abs() < 1e-4, "{mass}: {grasp:?}");
        // Small and large, light and heavy parts.
        let ends: Vec<(f64, f64)> = measured.grasps_at_ends.iter().map(|grasp| (grasp.part_m, grasp.mass_kg)).collect();
        let expected = [(0.012, 0.02), (0.012, 1.0), (0.068, 0.02), (0.068, 1.0)];
        assert!(ends.iter().zip(expected).all(|(a, b)| (a.0 - b.0).abs() < 1e-9 && a.1 == b.1), "{ends:?}");
        assert!(measured.grasps_at_ends.iter().all(|grasp| grasp.held), "{mass}: {:?}", measured.grasps_at_ends);
    }
}

#[test]
fn fingers_that_turn_are_measured_where_zero_is_not_open() {
    // Each finger turns about a pivot 12 mm off the middle. Its box is 8 mm thick and starts 10 mm from the pivot, so at a turn q the
    // inner corners at its base are 2 (0.012 - 0.004 cos q + 0.01 sin q) apart.
    let finger = |name: &str| link(name, 0.1, 1e-3, "<box size=\"0.02 0.008 0.07\"/>", 0.045);
    let turn = |name: &str, side: &str, y: &str, range: &str, rest: &str| {
        let rest = format!("<axis xyz=\"1 0 0\"/><limit {range} effort=\"50\" velocity=\"2\"/>{rest}");
        joint(name, "revolute", ["hand", side], &format!("0 {y} 0.08"), &rest)
    };
    let model = arm(&(hand()
        + &finger("right")
        + &finger("left")
        + &turn("drive", "right", "-0.012", "lower=\"-0.06\" upper=\"0.7\"", "")
        + &turn(
            "follower",
            "left",
            "0.012",
            "lower=\"-0.7\" upper=\"0.06\"",
            "<mimic joint=\"drive\" multiplier=\"-1\"/>",
        )));
    let folder = folder("open-not-zero", &model);
    drafted(&folder).unwrap();
    let jaw = jaw(&folder);
    let open = 2.0 * (0.012 - 0.004 * 0.7_f64.cos() + 0.01 * 0.7_f64.sin());
    assert!((jaw.opening_m - open).abs() < 2e-4, "{} {open}", jaw.opening_m);
    assert_eq!((jaw.drives.len(), jaw.drives[0].open, jaw.drives[0].closed), (1, 0.7, -0.06));
    assert!(robogate_physics::FingerMotion::of(&Robot::from_folder(&folder).unwrap()).unwrap().is_some());
}

#[test]
fn slides_that_close_upwards_become_drives() {
    let model = arm(&slides(0.1).replace("0 -0.005 0.07", "0 -0.045 0.07").replace("0 0.005 0.07", "0 0.045 0.07"))
        .replace("<axis xyz=\"0 -1 0\"/>", "<axis xyz=\"0 +1 0\"/>")
        .replace(
            "<axis xyz=\"0 1 0\"/><limit lower=\"0\" upper=\"0.04\"",
            "<axis xyz=\"0 -1 0\"/><limit lower=\"0\" upper=\"0.04\"",
        )
        .replace("0 +1 0", "0 1 0");
    let folder = folder("closes-upwards", &model);
    drafted(&folder).unwrap();
    let jaw = jaw(&folder);
    assert!(jaw.finger_joints.is_none(), "{jaw:?}");
    assert!(jaw.drives.iter().all(|drive| drive.open == 0.0 && drive.closed == 0.04), "{jaw:?}");
    assert_eq!(inspect(folder.to_str().unwrap(), 1.0, &[]).problems, []);
}

#[test]
fn continuous_joints_turn_by_a_full_turn() {
    let continuous = |text: String, name: &str| {
        text.replace(
            &format!("<joint name=\"{name}\" type=\"revolute\">"),
            &format!("<joint name=\"{name}\" type=\"continuous\">"),
        )
    };
    let model = ["j1", "j4", "j6"].into_iter().fold(arm(&slides(0.1)), continuous);
    passes("continuous", &model);
}

#[test]
fn links_without_mass_are_frames() {
    let model = arm(&slides(0.1))
        .replace("<parent link=\"l5\"/><child link=\"l6\"/>", "<parent link=\"aux\"/><child link=\"l6\"/>")
        .replace("</robot>", "<link name=\"aux\"/></robot>")
        .replace(
            "</robot>",
            &(joint(
                "ja",
                "revolute",
                ["l5", "aux"],
                "0 0 0",
                "<axis xyz=\"1 0 0\"/><limit lower=\"-2\" upper=\"2\" effort=\"30\" velocity=\"2\"/>",
            ) + "</robot>"),
        );
    passes("massless", &model);
}

#[test]
fn cup_of_a_bare_flange_is_at_its_end() {
    let folder = folder("bare", &arm(""));
    let text = drafted(&folder).unwrap();
    // The last link's shape ends 45 mm beyond its frame.
    assert!(text.contains("position_m = [0.0, 0.0, 0.045]"), "{text}");
    assert_eq!(inspect(folder.to_str().unwrap(), 1.0, &[]).problems, []);
}

#[test]
fn three_fingers_are_refused() {
    let third = link("thumb", 0.1, 1e-4, "<box size=\"0.02 0.01 0.05\"/>", 0.035)
        + &joint(
            "third",
            "prismatic",
            ["hand", "thumb"],
            "0.03 0 0.07",
            "<axis xyz=\"1 0 0\"/><limit lower=\"0\" upper=\"0.04\" effort=\"100\" velocity=\"0.2\"/><mimic joint=\"drive\"/>",
        );
    let folder = folder("three", &arm(&(slides(0.1) + &third)));
    let problems = drafted(&folder).unwrap_err();
    assert!(problems[0].what.contains("three fingers") && problems[0].what.contains("`thumb`"), "{problems:?}");
}

/// A tetrahedron as an OBJ file.
const TETRAHEDRON: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// The arm whose base is a mesh at this address, with `<mujoco>` as given.
fn meshed(address: &str, mujoco: &str) -> String {
    arm(&slides(0.1))
        .replace("<cylinder radius=\"0.06\" length=\"0.08\"/>", &format!("<mesh filename=\"{address}\"/>"))
        .replace("<robot name=\"arm\">", &format!("<robot name=\"arm\">{mujoco}"))
}

#[test]
fn packages_are_found_with_settings_of_the_compiler() {
    for (i, mujoco) in [
        "",
        "<mujoco><option integrator=\"implicitfast\"/></mujoco>",
        "<mujoco/>",
        "<!-- <mujoco><compiler/></mujoco> -->",
        "<mujoco><compiler balanceinertia=\"true\"/></mujoco>",
        "<mujoco><compiler meshdir=\"meshes\" strippath=\"true\"/></mujoco>",
    ]
    .iter()
    .enumerate()
    {
        for address in ["package://my_arm/meshes/base.obj", "meshes/base.obj"] {
            let folder = folder(&format!("package-{i}"), &meshed(address, mujoco));
            fs::create_dir_all(folder.join("meshes")).unwrap();
            fs::write(folder.join("meshes/base.obj"), TETRAHEDRON).unwrap();
            let drafted = drafted(&folder);
            assert!(drafted.is_ok(), "{mujoco} {address}: {drafted:?}");
        }
    }
}

#[test]
fn collada_is_refused_with_a_way_out() {
    let folder = folder("collada", &meshed("base.dae", ""));
    fs::write(folder.join("base.dae"), "<COLLADA/>").unwrap();
    let problems = drafted(&folder).unwrap_err();
    assert!(problems[0].what.contains("base.dae") && problems[0].hint.contains("STL or OBJ"), "{problems:?}");
}

#[test]
fn excluded_pairs_of_a_urdf_do_not_touch() {
    // A shield around the elbow reaches to the hand at home.
    let shield = |mujoco: &str| {
        arm(&slides(0.1))
            .replace("<cylinder radius=\"0.035\" length=\"0.2\"/>", "<sphere radius=\"0.3\"/>")
            .replace("<robot name=\"arm\">", &format!("<robot name=\"arm\">{mujoco}"))
    };
    let touching = checked("shield", &shield(""));
    let pair = |problem: &&Problem| problem.what.contains("`l3`") && problem.what.contains("`l5`");
    assert!(touching.problems.iter().any(|problem| pair(&problem)), "{:?}", touching.problems);
    let exclude = "<mujoco><contact><exclude body1=\"l3\" body2=\"l5\"/></contact></mujoco>";
    let apart = checked("shield-excluded", &shield(exclude));
    assert!(!apart.problems.iter().any(|problem| pair(&problem)), "{:?}", apart.problems);
}
