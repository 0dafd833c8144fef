//! Arm commands as ways of the tool.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use robogate_core::{
    Action, ArmCommand, Assignment, FaultKind, GripperCommand, Observation, Scenario, Seed, Simulator,
};
use robogate_sim::{MujocoEngine, PickPlace};

fn world() -> (PickPlace<MujocoEngine>, Observation) {
    let engine = MujocoEngine::new(common::On::Mujoco.franka().robot, MujocoEngine::TIME_STEP_S).unwrap();
    let mut world = PickPlace::new(engine, None).unwrap();
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() };
    let start = world.reset(&scenario).unwrap();
    (world, start.observation)
}

fn way(translation_m: [f64; 3], rotation_rad: [f64; 3]) -> Action {
    let arm = ArmCommand::ToolDelta { translation_m, rotation_rad };
    Action { arm, gripper: GripperCommand::Open, phase: None }
}

fn go(world: &mut PickPlace<MujocoEngine>, action: &Action, ticks: usize) -> Observation {
    (0..ticks).map(|_| world.step(action).unwrap().observation).last().unwrap()
}

#[test]
fn ways_of_the_tool_add_up_along_the_base_frames_axes() {
    for axis in 0..3 {
        let (mut world, start) = world();
        let mut translation = [0.0; 3];
        translation[axis] = if axis == 2 { 0.005 } else { -0.005 };
        go(&mut world, &way(translation, [0.0; 3]), 20);
        let end = go(&mut world, &way([0.0; 3], [0.0; 3]), 20);
        for (k, step) in translation.iter().enumerate() {
            let moved = end.tool_pose.position[k] - start.tool_pose.position[k];
            assert!((moved - 20.0 * step).abs() < 1e-3, "axis {axis}: {moved} along {k}");
        }
    }
}

#[test]
fn a_turn_about_the_vertical_turns_the_tool_on_its_spot() {
    let (mut world, start) = world();
    go(&mut world, &way([0.0; 3], [0.0, 0.0, 0.02]), 20);
    let end = go(&mut world, &way([0.0; 3], [0.0; 3]), 20);
    let q = |o: &Observation| {
        let [w, x, y, z] = o.tool_pose.orientation;
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
    };
    let turn = (q(&end) * q(&start).inverse()).scaled_axis();
    assert!((turn - nalgebra::Vector3::new(0.0, 0.0, 0.4)).norm() < 5e-3, "{turn}");
    for k in 0..3 {
        assert!((end.tool_pose.position[k] - start.tool_pose.position[k]).abs() < 1e-3);
    }
}

#[test]
fn out_of_reach_the_tool_stays_and_a_way_that_is_no_number_is_a_bad_action() {
    let (mut world, start) = world();
    let end = go(&mut world, &way([3.0, 0.0, 0.0], [0.0; 3]), 10);
    for k in 0..3 {
        assert!((end.tool_pose.position[k] - start.tool_pose.position[k]).abs() < 1e-3);
    }
    let fault = world.step(&way([f64::NAN, 0.0, 0.0], [0.0; 3])).unwrap_err();
    assert_eq!(fault.kind, FaultKind::BadAction);
}
