//! Tests that rendered images match the state of the engine.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::Point3;
use robogate_camera::{Cameras, Posture};
use robogate_core::{Assignment, Environment, Image, Scenario, Seed, Value};
use robogate_physics::{MujocoEngine, RapierEngine, Robot, built_in_robot, built_in_robots};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

fn scenario(settings: &[(&str, Value)]) -> Scenario {
    let mut requested = Assignment::default();
    for (name, value) in settings {
        requested.set(*name, value.clone());
    }
    Scenario { index: 0, seed: Seed::campaign(5).episode(0), requested }
}

fn mujoco(robot: Robot) -> ArmEnvironment {
    PickPlace::default()
        .on(Box::new(MujocoEngine::new(robot, MujocoEngine::TIME_STEP_S).unwrap()), Rig::default())
        .unwrap()
}

#[test]
fn engines_give_the_same_image() {
    let scenario = scenario(&[("obstacles", Value::Integer(3)), ("shape", Value::Category("L_shape".into()))]);
    let mut one = mujoco(built_in_robot("franka").unwrap());
    one.reset(&scenario).unwrap();
    let engine = RapierEngine::new(built_in_robot("franka").unwrap(), RapierEngine::TIME_STEP_S).unwrap();
    let mut other = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    other.reset(&scenario).unwrap();
    let (one, other) = (one.render().unwrap(), other.render().unwrap());
    // Engines differ in the last bits of a pose.
    let off = |a: &Image, b: &Image| a.rgb.iter().zip(&b.rgb).filter(|(a, b)| a.abs_diff(**b) > 1).count();
    for (a, b) in one.iter().zip(&other) {
        assert!(off(a, b) * 1000 < a.rgb.len(), "{} bytes differ", off(a, b));
    }
}

#[test]
fn rendering_needs_a_scenario() {
    let fault = mujoco(built_in_robot("franka").unwrap()).render().unwrap_err();
    assert!(fault.to_string().contains("no scenario is set up"), "{fault}");
}

#[test]
fn wrist_camera_moves_with_the_tool() {
    for name in built_in_robots() {
        let robot = built_in_robot(name).unwrap();
        let mut cell = mujoco(robot.clone());
        cell.reset(&scenario(&[])).unwrap();
        let engine = cell.engine();
        let posture = Posture {
            joints: engine.joint_positions(),
            opening_m: engine.opening(),
            cup_travel_m: engine.cup_travel(),
            object: engine.object(),
            others: Vec::new(),
            fixtures: Vec::new(),
        };
        let [_, wrist] = Cameras::new(&robot).unwrap().pinholes(&posture);
        // The tool centre point is slightly below the centre of the wrist camera's image.
        let tcp = Point3::from(engine.tcp().translation.vector);
        let [u, v, depth] = wrist.project(&tcp).unwrap();
        assert!((u - 128.0).abs() < 1e-6 && (128.0..200.0).contains(&v) && depth < 0.2, "{name}: {u} {v} {depth}");
    }
}
