//! Tests that tool deltas move the tool along the axes of the base frame.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use nalgebra::Isometry3;
use robogate_core::{Command, Fault, FaultKind};
use robogate_physics::{
    Engine, Fixture, GRAVITY, GripperCommand, GripperUnit, MassProperties, MujocoEngine, Object, Part, Plant,
    Primitive, Scene, Steering, Visual, built_in_robot,
};

/// A Franka at home beside a table with a small box.
struct World {
    plant: Plant<MujocoEngine>,
    steering: Steering,
}

impl World {
    fn new() -> (Self, Isometry3<f64>) {
        let engine = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
        let mut plant = Plant::new(engine, 0.05, None).unwrap();
        let parts = vec![Part { primitive: Primitive::Box { half: [0.025; 3] }, pose: Isometry3::identity() }];
        let scene = Scene {
            object: Object { mass: MassProperties::homogeneous(&parts, 0.3), parts, joint: None, friction: None },
            object_pose: Isometry3::translation(0.5, 0.3, 0.025),
            others: Vec::new(),
            friction: 0.8,
            table_friction: None,
            arm_stiffness: 1.0,
            gripper: GripperUnit::default(),
            fixtures: vec![Fixture::table()],
            gravity: GRAVITY,
            marker: None,
            visual: Visual::default(),
        };
        plant.load(&scene, 0.01).unwrap();
        let world = Self { plant, steering: Steering::default() };
        let start = world.tool();
        (world, start)
    }

    fn tool(&self) -> Isometry3<f64> {
        self.plant.engine.tcp()
    }

    fn step(&mut self, command: &Command) -> Result<(), Fault> {
        let engine = &self.plant.engine;
        let (measured, home) = (engine.joint_positions(), &engine.robot().settings.arm.home_rad);
        let joints = self.steering.joints(command, &measured, engine.chain(), home)?;
        self.plant.run(&joints, GripperCommand::Open, &mut |_, _| {})
    }

    fn go(&mut self, command: &Command, ticks: usize) -> Isometry3<f64> {
        (0..ticks).for_each(|_| self.step(command).unwrap());
        self.tool()
    }
}

fn delta(translation_m: [f64; 3], rotation_rad: [f64; 3]) -> Command {
    Command::ToolDelta { translation_m, rotation_rad }
}

const STAY: Command = Command::ToolDelta { translation_m: [0.0; 3], rotation_rad: [0.0; 3] };

#[test]
fn tool_deltas_add_up() {
    for axis in 0..3 {
        let (mut world, start) = World::new();
        let mut translation = [0.0; 3];
        translation[axis] = if axis == 2 { 0.005 } else { -0.005 };
        world.go(&delta(translation, [0.0; 3]), 20);
        let moved = world.go(&STAY, 20).translation.vector - start.translation.vector;
        for (k, step) in translation.iter().enumerate() {
            assert!((moved[k] - 20.0 * step).abs() < 1e-3, "axis {axis}: {moved} along {k}");
        }
    }
}

#[test]
fn rotation_keeps_tool_position() {
    let (mut world, start) = World::new();
    world.go(&delta([0.0; 3], [0.0, 0.0, 0.02]), 20);
    let end = world.go(&STAY, 20);
    let rotation = (end.rotation * start.rotation.inverse()).scaled_axis();
    assert!((rotation - nalgebra::Vector3::new(0.0, 0.0, 0.4)).norm() < 5e-3, "{rotation}");
    assert!((end.translation.vector - start.translation.vector).amax() < 1e-3);
}

#[test]
fn unreachable_delta_keeps_command() {
    let (mut world, start) = World::new();
    let end = world.go(&delta([3.0, 0.0, 0.0], [0.0; 3]), 10);
    assert!((end.translation.vector - start.translation.vector).amax() < 1e-3);
}

#[test]
fn non_finite_delta_is_bad_action() {
    let (mut world, _) = World::new();
    let fault = world.step(&delta([f64::NAN, 0.0, 0.0], [0.0; 3])).unwrap_err();
    assert_eq!(fault.kind, FaultKind::BadAction);
}
