//! Tests of drafted settings: a model alone becomes a robot that passes the check, and other machines are rejected.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use robogate_physics::{draft, inspect};

const FRANKA: &str = include_str!("../../../assets/robots/franka/franka.xml");

fn folder(name: &str, files: &[(&str, &[u8])]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("draft").join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    for (file, bytes) in files {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder
}

/// An arm of six hinges on the world, 0.9 m long, from `base`.
fn arm(prefix: &str, base: &str) -> String {
    let mut text = format!("<body name=\"{prefix}base\" pos=\"{base}\">");
    for (i, (axis, length)) in
        ["0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0"].iter().zip([0.2, 0.3, 0.25, 0.1, 0.08, 0.06]).enumerate()
    {
        let _ = write!(
            text,
            "<body name=\"{prefix}link{i}\" pos=\"0 0 {}\"><joint name=\"{prefix}j{i}\" axis=\"{axis}\" range=\"-3 3\" armature=\"0.1\"/>\
             <geom type=\"capsule\" size=\"0.03\" fromto=\"0 0 0 0 0 {length}\" mass=\"1\"/>",
            if i == 0 { 0.1 } else { [0.2, 0.3, 0.25, 0.1, 0.08][i - 1] }
        );
    }
    text + &"</body>".repeat(7)
}

fn model(bodies: &str) -> String {
    format!("<mujoco><compiler angle=\"radian\"/><worldbody>{bodies}</worldbody></mujoco>")
}

fn rejected(name: &str, bodies: &str, parts: &[&str]) {
    let folder = folder(name, &[("robot.xml", model(bodies).as_bytes())]);
    let problems = draft(&folder.join("robot.xml"), name).unwrap_err();
    for part in parts {
        assert!(problems[0].what.contains(part), "{name}: {problems:?}");
    }
}

#[test]
fn drafted_robot_passes_the_check() {
    let folder = folder("arm", &[("franka.xml", FRANKA.as_bytes())]);
    let draft = draft(&folder.join("franka.xml"), "drafted").unwrap();
    assert!(draft.text.contains("joint7") && draft.text.contains("parallel_jaw"), "{}", draft.text);
    for guess in ["home_rad", "acceleration_limit_rad_s2", "payload_kg"] {
        assert!(draft.guesses.iter().any(|known| known.contains(guess)), "{guess}: {:?}", draft.guesses);
        assert!(draft.text.contains(guess));
    }
    fs::write(folder.join("robot.toml"), &draft.text).unwrap();
    let inspection = inspect(folder.to_str().unwrap(), 1.0, &[]);
    assert_eq!(inspection.problems, [], "{}", draft.text);
    let grasp = inspection.measured.unwrap().grasp.unwrap();
    assert!(grasp.held && (grasp.opening_m.unwrap() - 0.08).abs() < 1e-3, "{grasp:?}");
}

#[test]
fn other_machines_are_rejected() {
    rejected("two-arms", &(arm("a", "0 0.3 0") + &arm("b", "0 -0.3 0")), &["2 arms"]);
    let free = format!("<body name=\"car\"><freejoint name=\"drive\"/><geom size=\"0.1\"/>{}</body>", arm("", "0 0 0"));
    rejected("free", &free, &["`drive`", "mobile robots"]);
    let wheel = |name: &str| format!("<body name=\"{name}\"><joint name=\"{name}\"/><geom size=\"0.1\"/></body>");
    rejected("wheels", &format!("{}{}{}", arm("", "0 0 0"), wheel("left"), wheel("right")), &["mobile robots"]);
    rejected("short", &wheel("only"), &["not an arm"]);
    let rail = format!(
        "<body name=\"rail\"><joint name=\"rail\" type=\"slide\"/><geom size=\"0.1\"/>{}</body>",
        arm("", "0 0 0")
    );
    rejected("rail", &rail, &["`rail` slides"]);
}

/// A cube of 2 cm as a binary STL.
fn cube() -> Vec<u8> {
    let corner = |i: usize| [i & 1, (i >> 1) & 1, (i >> 2) & 1].map(|bit| if bit == 1 { 0.01_f32 } else { -0.01 });
    let faces = [
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ];
    let mut bytes = vec![0; 80];
    bytes.extend(u32::try_from(faces.len()).unwrap().to_le_bytes());
    for face in faces {
        bytes.extend([0.0_f32; 3].iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend(face.iter().flat_map(|i| corner(*i)).flat_map(f32::to_le_bytes));
        bytes.extend([0, 0]);
    }
    bytes
}

/// A URDF of an arm without a gripper, whose first link has its shape in a package.
fn urdf(mesh: &str) -> String {
    let mut text = "<robot name=\"six\"><link name=\"base\"/>".to_owned();
    let lengths = [0.2, 0.3, 0.25, 0.1, 0.08, 0.06];
    for (i, axis) in ["0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0"].iter().enumerate() {
        let parent = if i == 0 { "base".to_owned() } else { format!("link{}", i - 1) };
        let (up, length) = (if i == 0 { 0.1 } else { lengths[i - 1] }, lengths[i]);
        let shape = if i == 0 {
            format!("<mesh filename=\"{mesh}\"/>")
        } else {
            format!("<cylinder radius=\"0.03\" length=\"{length}\"/>")
        };
        let middle = 0.5 * length;
        let _ = write!(
            text,
            "<link name=\"link{i}\"><inertial><origin xyz=\"0 0 {middle}\"/><mass value=\"1\"/><inertia ixx=\"0.01\" iyy=\"0.01\" izz=\"0.01\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>\
             <collision><origin xyz=\"0 0 {middle}\"/><geometry>{shape}</geometry></collision></link>\
             <joint name=\"j{i}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"link{i}\"/><origin xyz=\"0 0 {up}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-3\" upper=\"3\" velocity=\"{}\" effort=\"80\"/></joint>",
            1.0 + i as f64
        );
    }
    text + "</robot>"
}

#[test]
fn package_addresses_are_resolved() {
    let address = "package://six_description/meshes/link0.stl";
    let (text, cube) = (urdf(address), cube());
    for file in ["six_description/meshes/link0.stl", "meshes/link0.stl", "link0.stl"] {
        let folder = folder("package", &[("six.urdf", text.as_bytes()), (file, &cube)]);
        let draft = draft(&folder.join("six.urdf"), "six").unwrap();
        assert!(draft.text.contains("velocity_limit_rad_s = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]"), "{}", draft.text);
        assert!(draft.text.contains("torque_limit_nm = [80.0") && draft.text.contains("suction"), "{}", draft.text);
    }
    let folder = folder("nowhere", &[("six.urdf", text.as_bytes())]);
    let problems = draft(&folder.join("six.urdf"), "six").unwrap_err();
    assert!(problems[0].what.contains("link0.stl"), "{problems:?}");
}
