//! Tests with robots of users: one in the style of MuJoCo Menagerie, and one as URDF.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use robogate_camera::{Cameras, Pinhole, Posture};
use robogate_core::{Assignment, Environment, Image, Outcome, Scenario, Seed, rollout};
use robogate_physics::{Engine, MujocoEngine, Robot, built_in_robot, built_in_robots};
use robogate_tasks::pick_place::{Inspection, PickPlace, Placement, SceneParameters, Scripted, inspect, scene};
use robogate_tasks::{ArmTask, Rig};

const MODEL: &str = include_str!("../../../assets/robots/franka/franka.xml");
const SETTINGS: &str = include_str!("../../../assets/robots/franka/robot.toml");
const UR5E_SETTINGS: &str = include_str!("../../../assets/robots/ur5e/robot.toml");

/// A box of 5 x 5 x 8 cm, as Wavefront OBJ.
const MESH: &str = "v -0.025 -0.025 0.02\nv 0.025 -0.025 0.02\nv 0.025 0.025 0.02\nv -0.025 0.025 0.02\n\
    v -0.025 -0.025 0.1\nv 0.025 -0.025 0.1\nv 0.025 0.025 0.1\nv -0.025 0.025 0.1\n\
    f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8\n";

fn folder(name: &str, files: &[(&str, &str)]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("own").join(name);
    let _ = fs::remove_dir_all(&folder);
    for (file, content) in files {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
    folder
}

fn look(folder: &Path) -> Inspection {
    inspect(folder.to_str().unwrap())
}

/// Replaces `from`, which must occur in the text.
fn change(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from}");
    text.replace(from, to)
}

/// The Panda in the style of MuJoCo Menagerie: meshes in a separate folder, visual and collision classes, general
/// actuators, fingers coupled by an equality and driven through a tendon, an exclusion and a keyframe, but no site at
/// flange or tool.
fn menagerie() -> (String, String) {
    let mut model = change(MODEL, "<compiler angle=\"radian\"/>", "<compiler angle=\"radian\" meshdir=\"assets\"/>");
    model = change(
        &model,
        "<default class=\"finger\">",
        "<default class=\"visual\"><geom type=\"mesh\" contype=\"0\" conaffinity=\"0\" group=\"2\" mass=\"0\"/></default>
         <default class=\"collision\"><geom type=\"mesh\" group=\"3\"/></default>
         <default class=\"finger\">",
    );
    model = change(&model, "<worldbody>", "<asset><mesh name=\"wrist\" file=\"wrist.obj\"/></asset><worldbody>");
    model = change(
        &model,
        "<geom name=\"link7\" type=\"cylinder\" fromto=\"0 0 0.01 0 0 0.107\" size=\"0.045\"/>",
        "<geom mesh=\"wrist\" class=\"visual\"/><geom mesh=\"wrist\" class=\"collision\"/>",
    );
    model = change(&model, "<site name=\"flange\" pos=\"0 0 0.107\"/>", "");
    model = change(&model, "<site name=\"tcp\" pos=\"0 0 0.1034\"/>", "");
    let arm: String = (1..=7)
        .map(|i| {
            format!("<general name=\"actuator{i}\" joint=\"joint{i}\" gainprm=\"4500\" biasprm=\"0 -4500 -450\"/>")
        })
        .collect();
    let tail = format!(
        "<tendon><fixed name=\"split\"><joint joint=\"finger_joint1\" coef=\"0.5\"/><joint joint=\"finger_joint2\" coef=\"0.5\"/></fixed></tendon>
         <actuator>{arm}<general name=\"actuator8\" tendon=\"split\" ctrlrange=\"0 255\" gainprm=\"0.01568627451\" biasprm=\"0 -100 -10\"/></actuator>
         <contact><exclude body1=\"link5\" body2=\"link7\"/></contact>
         <keyframe><key name=\"home\" qpos=\"0 0 0 -1.57079 0 1.57079 -0.7853 0.04 0.04\" ctrl=\"0 0 0 -1.57079 0 1.57079 -0.7853 255\"/></keyframe>
         </mujoco>"
    );
    let settings = format!(
        "{SETTINGS}\n[[site]]\nname = \"flange\"\nbody = \"link7\"\nposition_m = [0.0, 0.0, 0.107]\n\n\
         [[site]]\nname = \"tcp\"\nbody = \"hand\"\nposition_m = [0.0, 0.0, 0.1034]\n"
    );
    (change(&model, "</mujoco>", &tail), settings)
}

#[test]
fn menagerie_robot_picks_and_places() {
    let (model, settings) = menagerie();
    let own = folder("menagerie", &[("franka.xml", &model), ("robot.toml", &settings), ("assets/wrist.obj", MESH)]);
    let inspection = look(&own);
    assert!(inspection.problems.is_empty(), "{:#?}", inspection.problems);

    let engine = MujocoEngine::new(Robot::from_folder(&own).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    let built_in = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    assert_eq!(engine.chain(), built_in.chain());
    let mut policy = Scripted::new(engine.robot().clone(), engine.chain().clone());
    let mut simulator = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() };
    assert_eq!(rollout(&mut simulator, &mut policy, &scenario).outcome, Outcome::Success);
    assert_eq!(simulator.render().unwrap().len(), 2);

    // The visual mesh is rendered; the collision shapes in group 3 are not.
    let without = change(&model, "<geom mesh=\"wrist\" class=\"visual\"/>", "");
    let files = [("franka.xml", without.as_str()), ("robot.toml", &settings), ("assets/wrist.obj", MESH)];
    let bare = Robot::from_folder(&folder("menagerie-bare", &files)).unwrap();
    let [with, without] = [Robot::from_folder(&own).unwrap(), bare].map(|robot| wrist_from_the_side(&robot));
    let changed = with.rgb.chunks_exact(3).zip(without.rgb.chunks_exact(3)).filter(|(a, b)| a != b).count();
    assert!(changed > 100, "{changed} pixels");
}

/// An image of the last link at home, from 35 cm beside it.
fn wrist_from_the_side(robot: &Robot) -> Image {
    let parameters = SceneParameters::nominal();
    let placement = Placement::from_name(&parameters.placement).unwrap();
    let scene = scene(&parameters, &placement, 1.0, &mut Seed::campaign(1).stream("obstacles")).unwrap();
    let mut cameras = Cameras::new(robot).unwrap();
    cameras.set_up(&scene);
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    let joints = robot.settings.arm.home_rad.clone();
    let flange = Point3::from(engine.chain().flange_at(&joints).translation.vector) + Vector3::z() * 0.05;
    let pose = Pinhole::looking(flange + Vector3::y() * 0.35, flange, &Vector3::z());
    let fixtures = scene.fixtures.iter().map(|fixture| fixture.part.pose).collect();
    let (object, others) = (scene.object_pose, Vec::new());
    let posture = Posture { joints, opening_m: Some(0.08), cup_travel_m: 0.0, object, others, fixtures };
    cameras.view(&Pinhole { pose, field_of_view_rad: 0.6, width: 64, height: 64 }, &posture).unwrap()
}

/// The UR5e's rows (d, a, alpha), standard Denavit-Hartenberg.
const UR5E: [(f64, f64, f64); 6] = [
    (0.1625, 0.0, std::f64::consts::FRAC_PI_2),
    (0.0, -0.425, 0.0),
    (0.0, -0.3922, 0.0),
    (0.1333, 0.0, std::f64::consts::FRAC_PI_2),
    (0.0997, 0.0, -std::f64::consts::FRAC_PI_2),
    (0.0996, 0.0, 0.0),
];

/// A URDF with the UR5e's kinematics and a fixed cup. Each link except the last is a small ball.
fn urdf() -> String {
    let names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let link = |name: &str, shape: &str| {
        format!(
            "<link name=\"{name}\"><inertial><mass value=\"1\"/><inertia ixx=\"0.01\" iyy=\"0.01\" izz=\"0.01\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>\
             <collision>{shape}</collision></link>"
        )
    };
    let ball = "<geometry><sphere radius=\"0.03\"/></geometry>";
    let mut text = format!("<robot name=\"own\">{}", link("base_link", ball));
    let mut origin = (0.0, 0.0, 0.0, std::f64::consts::PI);
    for (i, (name, (d, a, alpha))) in names.iter().zip(UR5E).enumerate() {
        let (x, z, roll, yaw) = origin;
        let parent = if i == 0 { "base_link".to_owned() } else { format!("link{i}") };
        let limit = if i == 2 { std::f64::consts::PI } else { std::f64::consts::TAU };
        let _ = write!(
            text,
            "{}<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"link{}\"/>\
             <origin xyz=\"{x} 0 {z}\" rpy=\"{roll} 0 {yaw}\"/><axis xyz=\"0 0 1\"/>\
             <limit lower=\"-{limit}\" upper=\"{limit}\" effort=\"100\" velocity=\"3\"/></joint>",
            link(&format!("link{}", i + 1), ball),
            i + 1,
        );
        origin = (a, d, alpha, 0.0);
    }
    let cup = "<origin xyz=\"0 0 0.11\"/><geometry><cylinder radius=\"0.02\" length=\"0.02\"/></geometry>";
    let (_, z, ..) = origin;
    text + &link("suction_cup", cup)
        + &format!(
            "<joint name=\"mount\" type=\"fixed\"><parent link=\"link6\"/><child link=\"suction_cup\"/><origin xyz=\"0 0 {z}\"/></joint></robot>"
        )
}

#[test]
fn urdf_matches_kinematic_table() {
    let settings = change(UR5E_SETTINGS, "ur5e.xml", "own.urdf")
        + "\n[[site]]\nname = \"flange\"\nbody = \"suction_cup\"\n\n[[site]]\nname = \"tcp\"\nbody = \"suction_cup\"\nposition_m = [0.0, 0.0, 0.12]\n";
    let own = folder("urdf", &[("own.urdf", &urdf()), ("robot.toml", &settings)]);
    let inspection = look(&own);
    assert!(inspection.problems.is_empty(), "{:#?}", inspection.problems);

    let engine = MujocoEngine::new(Robot::from_folder(&own).unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    for index in 0..100 {
        let mut stream = Seed::campaign(15).episode(index).stream("joints");
        let q: Vec<f64> = (0..6).map(|_| stream.between(-3.0, 3.0)).collect();
        let rotation = |axis: &nalgebra::Unit<Vector3<f64>>, angle| {
            Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(axis, angle))
        };
        let base = rotation(&Vector3::z_axis(), std::f64::consts::PI);
        let flange = UR5E.iter().zip(&q).fold(base, |frame, ((d, a, alpha), theta)| {
            frame
                * rotation(&Vector3::z_axis(), *theta)
                * Isometry3::translation(*a, 0.0, *d)
                * rotation(&Vector3::x_axis(), *alpha)
        });
        let off = (flange * Isometry3::translation(0.0, 0.0, 0.12)).inverse() * engine.chain().tcp_at(&q);
        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6);
    }
    // MuJoCo converts the URDF for the cameras.
    let mut simulator = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() };
    simulator.reset(&scenario).unwrap();
    assert!(!simulator.render().unwrap().is_empty());
}

#[test]
fn every_arm_reaches_its_target() {
    for name in built_in_robots() {
        let inspection = inspect(name);
        assert!(inspection.problems.is_empty(), "{name}: {:#?}", inspection.problems);
        assert!(inspection.measured.unwrap().reaches_target, "{name}");
    }
}

/// Models, servos and grasps that are sound do not make a robot that can do the task.
#[test]
fn failed_trials_are_problems() {
    let limit = "velocity_limit_rad_s = [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]";
    for (name, from, to, mode, hint) in [
        ("slow", limit, "velocity_limit_rad_s = [0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2]", "timeout", "--set time_limit_s"),
        ("high", "tip_m = 0.008", "tip_m = 0.06", "grasp_miss", "gripper.tip_m"),
    ] {
        let settings = change(SETTINGS, from, to);
        let robot = folder(name, &[("robot.toml", &settings), ("franka.xml", MODEL)]);
        let inspection = look(&robot);
        let [problem] = &inspection.problems[..] else { panic!("{name}: {:#?}", inspection.problems) };
        assert!(problem.what.contains(&format!("fails with `{mode}`")), "{}", problem.what);
        assert!(problem.hint.contains(hint) && problem.hint.contains("-n 1"), "{}", problem.hint);
        let episode = inspection.measured.unwrap().episode.unwrap();
        assert_eq!(episode.failure.unwrap().as_str(), mode);
    }
}
