//! Tests that every row of the parameter table is applied and read back, and that a value without effect is detected.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use common::EngineKind;
use nalgebra::{Isometry3, Vector3};
use robogate_core::{
    Allowed, Assignment, ContactPoint, Environment, Fault, FaultKind, Scenario, Seed, Value, check_applied,
};
use robogate_physics::{
    Chain, Engine, EngineBuild, FixtureKind, JointTargets, Primitive, Readback, Robot, Scene, Touches, Wrench,
};
use robogate_tasks::claims::Workbench;
use robogate_tasks::pick_place::{ActsOn, ParameterRow, PickPlace, parameters};
use robogate_tasks::{ArmTask, Rig};

fn engines() -> Vec<EngineKind> {
    vec![
        #[cfg(feature = "mujoco")]
        EngineKind::Mujoco,
        #[cfg(feature = "rapier")]
        EngineKind::Rapier,
    ]
}

/// A robot with the gripper that the parameter needs.
fn robot_for(row: &ParameterRow) -> &'static str {
    if row.acts_on == ActsOn::Cup { "ur5e" } else { "franka" }
}

/// A value other than the nominal one.
fn unusual(row: &ParameterRow) -> Value {
    let inside = |low: f64, high: f64| low + 0.37 * (high - low);
    match row.allowed() {
        Allowed::Continuous { low, high } => Value::Number(inside(low, high)),
        Allowed::Integer { low, high } => Value::Integer(inside(low as f64, high as f64) as i64),
        Allowed::Categorical { choices, open } => {
            let nominal = row.nominal().unwrap().to_string();
            match choices.into_iter().find(|choice| **choice != *nominal) {
                Some(choice) => Value::Category(choice),
                None => {
                    assert!(open, "{} has only one choice", row.name);
                    Value::Category("#12ab34".into())
                }
            }
        }
    }
}

/// A scenario with this value, and with the other parameters that it needs to take effect.
fn scenario(row: &ParameterRow, value: Value) -> Scenario {
    let mut requested = Assignment::default();
    if row.name.starts_with("disturbance_") {
        requested.set("disturbance_speed_m_s", Value::Number(0.2));
    }
    if row.name == "obstacle_gap_m" {
        requested.set("obstacles", Value::Integer(4));
    }
    requested.set(row.name, value);
    Scenario { index: 3, seed: Seed::campaign(1).episode(3), requested }
}

#[test]
fn rows_are_applied_and_read_back() {
    for on in engines() {
        for row in parameters() {
            let cell = on.robot(robot_for(row));
            let (mut simulator, _) = cell.bench(&cell.setup()).unwrap();
            let value = unusual(row);
            assert_ne!(Some(&value), row.nominal().as_ref(), "{}", row.name);
            let scenario = scenario(row, value.clone());
            let start = simulator.reset(&scenario).unwrap_or_else(|fault| panic!("{on:?} {}: {fault}", row.name));
            check_applied(&scenario.requested, &start.applied).unwrap_or_else(|fault| panic!("{on:?}: {fault}"));
            assert!(start.applied.get(row.name).is_some(), "{}", row.name);
        }
    }
}

/// Tests the readers with the same seed and other values.
#[test]
fn numbers_are_read_over_their_range() {
    let on = engines()[0];
    for row in parameters() {
        let cell = on.robot(robot_for(row));
        let (mut simulator, _) = cell.bench(&cell.setup()).unwrap();
        let Allowed::Continuous { low, high } = row.allowed() else { continue };
        for share in [0.0, 0.11, 0.5, 0.8] {
            let scenario = scenario(row, Value::Number(low + share * (high - low)));
            // Some offsets move the object off the table, and some gaps leave no room.
            let Ok(start) = simulator.reset(&scenario) else { continue };
            check_applied(&scenario.requested, &start.applied).unwrap();
        }
    }
}

/// A modification of a scene.
type Change = fn(&mut Scene);

/// An engine that loads a modified scene.
struct Tampered {
    engine: Box<dyn Engine>,
    change: Change,
}

impl Engine for Tampered {
    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        let mut scene = scene.clone();
        (self.change)(&mut scene);
        self.engine.load(&scene, joints)
    }

    fn build(&self) -> EngineBuild {
        self.engine.build()
    }

    fn robot(&self) -> &Robot {
        self.engine.robot()
    }

    fn chain(&self) -> &Chain {
        self.engine.chain()
    }

    fn time_step(&self) -> f64 {
        self.engine.time_step()
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        self.engine.read_back()
    }

    fn advance(&mut self, targets: &JointTargets) {
        self.engine.advance(targets);
    }

    fn health(&self) -> Result<(), Fault> {
        self.engine.health()
    }

    fn joint_positions(&self) -> Vec<f64> {
        self.engine.joint_positions()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        self.engine.joint_velocities()
    }

    fn opening(&self) -> Option<f64> {
        self.engine.opening()
    }

    fn select(&mut self, body: usize) {
        self.engine.select(body);
    }

    fn free_body(&self, body: usize) -> Isometry3<f64> {
        self.engine.free_body(body)
    }

    fn free_body_velocity(&self, body: usize) -> (Vector3<f64>, Vector3<f64>) {
        self.engine.free_body_velocity(body)
    }

    fn attach(&mut self) {
        self.engine.attach();
    }

    fn detach(&mut self) {
        self.engine.detach();
    }

    fn cup_load(&self) -> Option<Wrench> {
        self.engine.cup_load()
    }

    fn tcp(&self) -> Isometry3<f64> {
        self.engine.tcp()
    }

    fn object(&self) -> Isometry3<f64> {
        self.engine.object()
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        self.engine.fixture(fixture)
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        self.engine.object_velocity()
    }

    fn touches(&self) -> &Touches {
        self.engine.touches()
    }

    fn support(&self) -> Wrench {
        self.engine.support()
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        self.engine.contact_points()
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        self.engine.clearance_below(bound)
    }

    fn robot_body(&self, body: usize) -> String {
        self.engine.robot_body(body)
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        self.engine.state_bits(sink);
    }
}

#[test]
fn tampered_scene_is_not_applied() {
    let cases: [(&str, Value, Change); 12] = [
        ("friction", Value::Number(0.6), |scene| scene.friction *= 1.01),
        ("table_friction", Value::Number(0.3), |scene| scene.table_friction = None),
        ("mass_kg", Value::Number(0.5), |scene| scene.object.mass.mass_kg += 0.01),
        ("com_offset", Value::Number(0.2), |scene| scene.object.mass.centre.x += 1e-4),
        ("gravity_scale", Value::Number(0.9), |scene| scene.gravity = 9.81),
        ("offset_x_m", Value::Number(0.05), |scene| scene.object_pose.translation.x -= 1e-4),
        ("position_jitter_m", Value::Number(0.03), |scene| scene.object_pose.translation.y += 1e-4),
        ("placement", Value::Category("left_45".into()), |scene| scene.object_pose.translation.x += 1e-4),
        ("size_m", Value::Number(0.06), |scene| {
            scene.object.parts[0].primitive = Primitive::Box { half: [0.0301, 0.03, 0.03] };
        }),
        ("obstacles", Value::Integer(3), |scene| {
            let last = scene.fixtures.iter().rposition(|fixture| fixture.kind == FixtureKind::Obstacle).unwrap();
            scene.fixtures.remove(last);
        }),
        ("obstacle_gap_m", Value::Number(0.05), |scene| {
            let obstacle = scene.fixtures.iter_mut().find(|fixture| fixture.kind == FixtureKind::Obstacle).unwrap();
            let [x, y] = [scene.object_pose.translation.x, scene.object_pose.translation.y];
            (obstacle.part.pose.translation.x, obstacle.part.pose.translation.y) = (x + 0.08, y);
        }),
        ("disturbance_start_s", Value::Number(0.5), |scene| {
            scene.fixtures.last_mut().unwrap().motion.as_mut().unwrap().starts_s += 0.1;
        }),
    ];
    for on in engines() {
        for (name, value, change) in &cases {
            let row = parameters().iter().find(|row| row.name == *name).unwrap();
            let scenario = scenario(row, value.clone());
            let engine = Tampered { engine: on.franka().engine(), change: *change };
            let mut simulator = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
            let start = simulator.reset(&scenario).unwrap();
            let requested: Assignment = [((*name).into(), value.clone())].into_iter().collect();
            let checked = check_applied(&requested, &start.applied);
            let fault = checked.expect_err(&format!("{on:?} reports {name} as applied in a tampered scene"));
            assert_eq!(fault.kind, FaultKind::NotApplied, "{on:?} {name}: {fault}");
        }
    }
}

#[test]
fn every_parameter_is_documented() {
    let page = include_str!("../../../docs/parameters.md");
    for row in parameters() {
        assert!(page.contains(&format!("`{}`", row.name)), "docs/parameters.md does not describe {}", row.name);
    }
}
