//! Joints of parts on every engine: each follows its law, each parameter acts, and the experts of shipped tasks succeed.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::path::Path;
use std::sync::Arc;

use robogate_core::{Allowed, Environment, Outcome, Value, check_applied, rollout};
use robogate_tasks::file::{FILE, FileTask};
use robogate_tasks::{ArmDeclaration, ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, Idle, scenario};

const ENGINES: &[EngineKind] = &[
    EngineKind::Mujoco,
    #[cfg(feature = "rapier")]
    EngineKind::Rapier,
];

fn on(task: &FileTask, engine: EngineKind, robot: &str) -> ArmEnvironment {
    task.on(engine.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

fn shipped(task: &str) -> FileTask {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks").join(task);
    FileTask::read(&fs::read_to_string(folder.join(FILE)).unwrap()).unwrap()
}

/// A part on a joint, away from the robot and the others.
fn part(name: &str, y_cm: i32, mass: &str, shape: &str, joint: &str) -> String {
    format!(
        "[[part]]\nname = '{name}'\nat = '70, {y_cm}, 40 cm'\nmass = '{mass}'\nshapes = [{{ {shape} }}]\n[part.joint]\n{joint}\n"
    )
}

/// Gravity moves parts of 1 kg on joints. Each number follows from the law of its joint.
#[test]
fn joints_follow_their_laws() {
    const G: f64 = 9.81;
    let cube = "box = '2, 2, 2 cm'";
    let slide = |law: &str| format!("kind = 'slide'\naxis = '-z'\nrange = '-9, 9 m'\n{law}");
    let parts = [
        part("spring", 50, "1 kg", cube, &slide("stiffness = '200 N/m'\nrest = '1 cm'\ndamping = '20 N s/m'")),
        part("damped", 40, "1 kg", cube, &slide("damping = '20 N s/m'")),
        part("held", 30, "1 kg", cube, &slide("friction = '12 N'")),
        part("sliding", -30, "1 kg", cube, &slide("friction = '4.905 N'")),
        part("falling", -40, "1 kg", cube, &slide("")),
        part(
            "pendulum",
            -50,
            "1 kg",
            "box = '2, 2, 2 cm', at = '10, 0, 0 cm'",
            "kind = 'hinge'\naxis = 'y'\nrange = '-180, 180 deg'",
        ),
        part(
            "stopped",
            -60,
            "1 kg",
            "box = '2, 2, 2 cm', at = '10, 0, 0 cm'",
            "kind = 'hinge'\naxis = 'y'\nrange = '0, 60 deg'\ndamping = '0.2 N m s/rad'",
        ),
        part(
            "screw",
            60,
            "1 kg",
            "box = '4, 4, 4 cm'",
            "kind = 'screw'\naxis = '-z'\npitch = '2 cm'\nrange = '0, 5000 deg'",
        ),
    ];
    // A pendulum from the horizontal: the moment of inertia of a cube of edge a at l is m (l^2 + a^2 / 6).
    let swing = (2.0 * G * 0.1 / (0.01 + 4e-4 / 6.0)).sqrt();
    // A screw with the lead c in m/rad: m g c = (I + m c^2) alpha.
    let lead = 0.02 / std::f64::consts::TAU;
    let alpha = G * lead / (0.0016 / 6.0 + lead * lead);
    let wanted = [
        ("spring_m", "final joint(spring)", 0.01 + G / 200.0),
        ("damped_m_s", "max speed(damped)", G / 20.0),
        ("held_m", "max joint(held)", 0.0),
        ("sliding_m_s", "max speed(sliding) when time() < 0.5 s", 0.5 * (G - 4.905)),
        ("falling_m", "max joint(falling) when time() < 0.5 s", 0.125 * G),
        ("swing_rad_s", "max speed(pendulum) when time() < 0.5 s", swing),
        ("stopped_rad", "final joint(stopped)", std::f64::consts::FRAC_PI_3),
        ("turned_rad", "max joint(screw) when time() < 0.5 s", 0.125 * alpha),
        ("sunk_m", "max moved(screw) when time() < 0.5 s", 0.125 * alpha * lead),
    ];
    let measures: String =
        wanted.iter().map(|(name, value, _)| format!("[[measure]]\nname = '{name}'\nvalue = '{value}'\n")).collect();
    let text = format!(
        "format = 'robogate-task/1'\nname = 'laws'\ninstruction = 'wait'\ntime_limit = '3 s'\n{}{measures}[success]\nwhen = 'time() > 2 s'\n",
        parts.concat()
    );
    let task = FileTask::read(&text).unwrap_or_else(|problems| panic!("{problems:#?}"));
    for engine in ENGINES {
        let episode = rollout(&mut on(&task, *engine, "franka"), &mut Idle::default(), &scenario(0, &[]));
        assert_eq!(episode.outcome, Outcome::Success, "{engine:?}");
        for (name, _, expected) in wanted {
            let found = episode.measures.get(name).unwrap();
            let off = (found - expected).abs();
            assert!(off <= 0.02 * expected.abs() + 2e-4, "{engine:?}: {name} is {found}, expected {expected}");
        }
    }
}

/// Every parameter of tasks with joints is set to both ends of its range and read back.
#[test]
fn parameters_of_joints_act() {
    for (task, engine) in ["drawer", "button", "door", "screw_start", "peg_board"]
        .into_iter()
        .flat_map(|task| ENGINES.iter().map(move |engine| (task, engine)))
    {
        let declared = shipped(task);
        let mut environment = on(&declared, *engine, "franka");
        let spec = Arc::clone(environment.task());
        let space = declared.brought_space().unwrap();
        for parameter in spec.parameters.iter().filter(|parameter| space.position(&parameter.name).is_some()) {
            let Allowed::Continuous { low, high } = parameter.allowed else { panic!("{}", parameter.name) };
            for value in [low, high] {
                let scenario = scenario(3, &[(&*parameter.name, value)]);
                let start = environment.reset(&scenario).unwrap();
                check_applied(&scenario.requested, &start.applied).unwrap();
                let applied = start.applied.get(&parameter.name);
                assert_eq!(applied, Some(&Value::Number(value)), "{engine:?}: {task}: {}", parameter.name);
            }
        }
    }
}

/// The experts open, press, turn, insert and screw. In Rapier, pegs and screws slip in fingers; a cup holds the screw.
#[test]
fn experts_move_joints() {
    for (task, stages) in [("drawer", 2.0), ("button", 3.0), ("door", 2.0), ("peg_board", 3.0), ("screw_start", 2.0)] {
        for engine in ENGINES.iter().filter(|engine| task != "peg_board" || **engine == EngineKind::Mujoco) {
            let robot = if task == "screw_start" { "ur5e" } else { "franka" };
            let declared = shipped(task);
            let mut environment = on(&declared, *engine, robot);
            let mut expert = declared.controller(engine.robot(robot).robot, environment.engine().chain().clone());
            let episode = rollout(&mut environment, &mut *expert, &scenario(0, &[]));
            assert_eq!(
                (&episode.outcome, episode.measures.get("stages")),
                (&Outcome::Success, Some(stages)),
                "{engine:?}: {task}"
            );
        }
    }
}
