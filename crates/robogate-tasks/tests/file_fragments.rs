//! Tasks with MJCF files: the same physics as bodies that task.toml states itself, and friction and colour of single bodies.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::path::Path;

use robogate_core::{Action, Command, Environment, Outcome, Value, check_applied, rollout};
use robogate_physics::pose;
use robogate_tasks::file::{FILE, FileTask};
use robogate_tasks::{ArmDeclaration, ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, scenario};

fn shipped(task: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks").join(task);
    fs::read_to_string(folder.join(FILE)).unwrap()
}

fn environment(task: &FileTask, engine: EngineKind, robot: &str) -> ArmEnvironment {
    task.on(engine.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

/// The task with its bodies in a file: everything from the first fixture to the point of the part is replaced.
fn with_file(text: &str, part: &str, xml: &'static str) -> FileTask {
    let from = text.find("[[fixture]]").unwrap();
    let to = text.find("[part.points.handle]").unwrap();
    let tables = format!("[[mjcf]]\nfile = \"cabinet.xml\"\n[[part]]\nname = \"{part}\"\ncolor = \"#3a6ea5\"\n");
    let text = format!("{}{tables}{}", &text[..from], &text[to..]);
    FileTask::read_with(&text, &mut |name| {
        assert_eq!(name, "cabinet.xml");
        Ok(xml.as_bytes().to_vec())
    })
    .unwrap()
}

const DRAWER: &str = r#"<mujoco model="drawer">
  <compiler angle="radian"/>
  <default><default class="rail"><joint type="slide" damping="10" frictionloss="4"/></default></default>
  <worldbody>
    <body name="cabinet" pos="0.62 0 0">
      <geom type="box" size="0.13 0.01 0.1" pos="0.13 -0.16 0.1"/>
      <geom type="box" size="0.13 0.01 0.1" pos="0.13 0.16 0.1"/>
      <geom type="box" size="0.13 0.17 0.01" pos="0.13 0 0.21"/>
      <body name="drawer" pos="0 0 0.11">
        <joint name="slide" class="rail" axis="-1 0 0" range="0 0.22"/>
        <geom type="box" size="0.01 0.145 0.08" pos="0.01 0 0" density="957.8544061302682"/>
        <geom type="box" size="0.11 0.005 0.04" pos="0.13 -0.14 -0.04" density="957.8544061302682"/>
        <geom type="box" size="0.11 0.005 0.04" pos="0.13 0.14 -0.04" density="957.8544061302682"/>
        <geom type="box" size="0.11 0.145 0.005" pos="0.13 0 -0.075" density="957.8544061302682"/>
        <body name="handle">
          <geom type="box" size="0.005 0.1 0.025" pos="-0.075 0 0.02" density="957.8544061302682"/>
          <geom type="box" size="0.035 0.005 0.025" pos="-0.035 -0.095 0.02" density="957.8544061302682"/>
          <geom type="box" size="0.035 0.005 0.025" pos="-0.035 0.095 0.02" density="957.8544061302682"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"#;

const DOOR: &str = r#"<mujoco model="door">
  <worldbody>
    <body name="frame" pos="0.62 -0.2 0">
      <geom type="box" size="0.1 0.01 0.1" pos="0.12 -0.02 0.1"/>
      <geom type="box" size="0.1 0.01 0.1" pos="0.12 0.34 0.1"/>
      <body name="door" pos="0 0 0.12">
        <inertial MASS/>
        <joint name="hinge" type="hinge" axis="0 0 1" range="0 100" damping="1" frictionloss="0.5"/>
        <geom type="box" size="0.01 0.16 0.07" pos="0 0.16 0"/>
        <geom type="box" size="0.005 0.06 0.02" pos="-0.075 0.25 0.04"/>
        <geom type="box" size="0.03 0.005 0.02" pos="-0.04 0.195 0.04"/>
        <geom type="box" size="0.03 0.005 0.02" pos="-0.04 0.305 0.04"/>
      </body>
    </body>
  </worldbody>
</mujoco>"#;

/// Poses of the moving part over an episode of the expert, and its measures.
fn followed(task: &FileTask) -> (Vec<[f64; 3]>, Vec<(String, f64)>) {
    let mut environment = environment(task, EngineKind::Mujoco, "franka");
    let mut expert = task.controller(EngineKind::Mujoco.robot("franka").robot, environment.engine().chain().clone());
    environment.record_trajectory(Some(0.1));
    let episode = rollout(&mut environment, &mut *expert, &scenario(3, &[("encoder_bias_rad", 0.002)]));
    assert_eq!(episode.outcome, Outcome::Success);
    let trajectory = environment.take_trajectory().unwrap();
    let body = trajectory.bodies.iter().position(|name| &**name == "object").unwrap();
    let path = trajectory.frames.iter().map(|frame| frame.poses[body].position).collect();
    (path, episode.measures.iter().map(|(name, value)| (name.to_string(), value)).collect())
}

/// A drawer and a door behave as those that task.toml states: within a micrometre along the whole episode.
#[test]
fn cabinets_move_as_those_of_task_toml() {
    let door = shipped("door");
    let written = FileTask::read(&door).unwrap();
    // The inertia that follows from the shapes and 2 kg, as a robot's maker would state it.
    let mut own = environment(&written, EngineKind::Mujoco, "franka");
    own.reset(&scenario(0, &[])).unwrap();
    let centre = own.engine().read_back().unwrap().centre_of_mass;
    let shapes = [[0.01, 0.16, 0.07], [0.005, 0.06, 0.02], [0.03, 0.005, 0.02], [0.03, 0.005, 0.02]];
    let at = [[0.0, 0.16, 0.0], [-0.075, 0.25, 0.04], [-0.04, 0.195, 0.04], [-0.04, 0.305, 0.04]];
    let parts: Vec<_> = shapes
        .iter()
        .zip(at)
        .map(|(half, [x, y, z])| robogate_physics::Part {
            primitive: robogate_physics::Primitive::Box { half: *half },
            pose: nalgebra::Isometry3::translation(x, y, z),
        })
        .collect();
    let mass = robogate_physics::MassProperties::homogeneous(&parts, 2.0);
    assert!((mass.centre - centre).norm() < 1e-9);
    let m = mass.inertia;
    let stated = format!(
        "mass=\"2\" pos=\"{} {} {}\" fullinertia=\"{} {} {} {} {} {}\"",
        mass.centre.x,
        mass.centre.y,
        mass.centre.z,
        m[(0, 0)],
        m[(1, 1)],
        m[(2, 2)],
        m[(0, 1)],
        m[(0, 2)],
        m[(1, 2)]
    );
    let in_file: &'static str = Box::leak(DOOR.replace("MASS", &stated).into_boxed_str());
    for (name, text, part, xml) in [("drawer", shipped("drawer"), "drawer", DRAWER), ("door", door, "door", in_file)] {
        let (path, measures) = followed(&FileTask::read(&text).unwrap());
        let (again, same) = followed(&with_file(&text, part, xml));
        assert_eq!(path.len(), again.len(), "{name}");
        let far = path.iter().zip(&again).map(|(a, b)| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max));
        let far = far.fold(0.0, f64::max);
        println!("{name}: at most {far:.2e} m apart");
        assert!(far < 1e-6, "{name}: {far}");
        for ((measure, value), (_, other)) in measures.iter().zip(&same) {
            assert!((value - other).abs() <= 1e-4 * value.abs().max(1e-3), "{name}: {measure} {value} {other}");
        }
    }
}

/// Two blocks on a slope: friction of a part, of a fixture, and of the scene, by what slides.
const SLOPE: &str = r##"format = "robogate-task/1"
name = "slope"
instruction = "wait"
time_limit = "3 s"
[scene]
friction = 0.2
[[fixture]]
name = "slope"
at = "50, 0, 10 cm"
rotation = "0, 25, 0 deg"
color = "#a05030"
shapes = [{ box = "30, 60, 2 cm" }]
[[part]]
name = "rough"
friction = 0.8
mass = "0.2 kg"
at = "48, -15, 15 cm"
rotation = "0, 25, 0 deg"
shapes = [{ box = "4, 4, 4 cm" }]
[[part]]
name = "smooth"
mass = "0.2 kg"
at = "48, 15, 15 cm"
rotation = "0, 25, 0 deg"
shapes = [{ box = "4, 4, 4 cm" }]
[[parameter]]
name = "rough_friction"
sets = "rough.friction"
range = "0.05, 1"
[[parameter]]
name = "friction"
sets = "scene.friction"
range = "0.05, 1"
[success]
when = "time() > 10 s"
"##;

/// Keeps the posture for some time.
fn wait(environment: &mut ArmEnvironment, posture: &[f64]) {
    for _ in 0..30 {
        let command = Command::JointPosition(posture.to_vec());
        environment.step(&Action { command, gripper: Some(Action::OPEN), phase: None }).unwrap();
    }
}

fn slid(task: &FileTask, engine: EngineKind, values: &[(&str, f64)]) -> [f64; 2] {
    let mut environment = environment(task, engine, "franka");
    let scenario = scenario(0, values);
    let start = environment.reset(&scenario).unwrap();
    check_applied(&scenario.requested, &start.applied).unwrap();
    for (name, value) in values {
        assert_eq!(start.applied.get(name), Some(&Value::Number(*value)), "{engine:?} {name}");
    }
    let places = |environment: &ArmEnvironment| [0, 1].map(|body| pose(&environment.engine().free_body(body)).position);
    let before = places(&environment);
    wait(&mut environment, start.observation.joint_positions());
    let after = places(&environment);
    [0, 1].map(|body| (0..3).map(|i| (after[body][i] - before[body][i]).powi(2)).sum::<f64>().sqrt())
}

/// A block slides where its coefficient is below the slope of 0.47, on both engines, and the coefficient is read back.
#[test]
fn friction_of_single_bodies_acts() {
    let task = FileTask::read(SLOPE).unwrap();
    let rail = FileTask::read(&SLOPE.replace("color = \"#a05030\"", "friction = 0.9")).unwrap();
    for engine in [EngineKind::Mujoco, EngineKind::Rapier] {
        let holds = |slid: f64| slid < 0.02;
        let nominal = slid(&task, engine, &[]);
        assert!(holds(nominal[0]) && !holds(nominal[1]), "{engine:?}: {nominal:?}");
        let smoother = slid(&task, engine, &[("rough_friction", 0.1)]);
        assert!(!holds(smoother[0]) && !holds(smoother[1]), "{engine:?}: {smoother:?}");
        let rougher = slid(&task, engine, &[("friction", 0.8)]);
        assert!(holds(rougher[0]) && holds(rougher[1]), "{engine:?}: {rougher:?}");
        // The larger coefficient of both sides acts.
        let on_rail = slid(&rail, engine, &[("rough_friction", 0.1)]);
        assert!(holds(on_rail[0]) && holds(on_rail[1]), "{engine:?}: {on_rail:?}");
        let mut environment = environment(&rail, engine, "franka");
        environment.reset(&scenario(0, &[])).unwrap();
        let read = environment.engine().read_back().unwrap();
        assert_eq!(read.own_friction, [(0, 0.8)], "{engine:?}");
        let of_fixtures: Vec<_> = read.fixtures.iter().filter_map(|fixture| fixture.friction).collect();
        assert_eq!(of_fixtures, [0.9], "{engine:?}");
        // One coefficient of the pads cannot be a multiple of several ones.
        let pads = environment.reset(&scenario(0, &[("pad_friction_scale", 0.5)])).unwrap_err();
        assert!(pads.to_string().contains("pad_friction_scale needs parts with one friction coefficient"), "{pads}");
    }
}

#[test]
fn wrong_friction_is_a_problem() {
    for (from, to, expected) in [
        ("friction = 0.8\n", "friction = \"0.8 N\"\n", "Expected a number without a unit"),
        ("friction = 0.8\n", "friction = 80\n", "out of range"),
        ("friction = 0.8\n", "", "`rough` has no `friction` of its own"),
        ("#a05030", "brown", "expected #rrggbb"),
        (
            "mass = \"0.2 kg\"\nat = \"48, 15",
            "friction = 0.3\nmass = \"0.2 kg\"\nat = \"48, 15",
            "`scene.friction` has no effect",
        ),
    ] {
        assert!(SLOPE.contains(from), "{from}");
        let problems = FileTask::read(&SLOPE.replacen(from, to, 1)).unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(expected)), "{to}: {problems:?}");
    }
}

/// Colours of fixtures are in pictures and pages.
#[test]
fn colours_are_drawn() {
    let task = FileTask::read(SLOPE).unwrap();
    let mut environment = environment(&task, EngineKind::Mujoco, "franka");
    environment.record_trajectory(Some(0.5));
    let start = environment.reset(&scenario(0, &[])).unwrap();
    wait(&mut environment, start.observation.joint_positions());
    let trajectory = environment.take_trajectory().unwrap();
    let slope = trajectory.bodies.iter().position(|name| &**name == "slope").unwrap();
    let solid = trajectory.solids.iter().find(|solid| solid.body == slope).unwrap();
    assert_eq!(solid.color, [160, 80, 48]);
}

/// Masses and inertia that a task states, and capsules.
#[test]
fn stated_inertia_acts() {
    let with = |keys: &str| {
        FileTask::read(&SLOPE.replacen("mass = \"0.2 kg\"\nat = \"48, -15", &format!("{keys}\nat = \"48, -15"), 1))
    };
    let task =
        with("mass = \"0.2 kg\"\ncentre = \"1, 0, 0 cm\"\ninertia = \"1e-4, 2e-4, 2e-4, 0, 0, 0 kg m^2\"").unwrap();
    for engine in [EngineKind::Mujoco, EngineKind::Rapier] {
        let mut environment = environment(&task, engine, "franka");
        environment.reset(&scenario(0, &[])).unwrap();
        let read = environment.engine().read_back().unwrap();
        assert!((read.centre_of_mass.x - 0.01).abs() < 1e-9 && (read.mass_kg - 0.2).abs() < 1e-9, "{engine:?}");
    }
    for (keys, expected) in [
        ("mass = \"0.2 kg\"\ncentre = \"1, 0, 0 cm\"", "`centre` needs `inertia`"),
        ("mass = \"0.2 kg\"\ninertia = \"1, 1, 9, 0, 0, 0 kg m^2\"", "no body has the moments of inertia"),
        ("mass = \"0.2 kg\"\ninertia = \"1, 1, 1 kg m^2\"", "has 3 numbers. Expected 6"),
        ("mass = \"0.2 kg\"\ninertia = \"1, 1, 1, 0, 0, 0 kg\"", "does not fit"),
    ] {
        let problems = with(keys).unwrap_err();
        assert!(problems.iter().any(|problem| problem.what.contains(expected)), "{keys}: {problems:?}");
    }
}
