//! Tests that every row of the parameter table is applied and read back, and that a value without effect is detected.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::sync::Arc;

use common::{EngineKind, arm_tasks};
use nalgebra::{Isometry3, Vector3};
use robogate_core::{
    Allowed, Assignment, ContactPoint, Environment, Fault, FaultKind, ParameterSpec, Scenario, Seed, Value,
    check_applied,
};
use robogate_physics::{
    Chain, Engine, EngineBuild, FixtureKind, JointTargets, Motion, Primitive, Readback, Robot, Scene, Side, Touches,
    Wrench,
};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

fn engines() -> Vec<EngineKind> {
    vec![
        #[cfg(feature = "mujoco")]
        EngineKind::Mujoco,
        #[cfg(feature = "rapier")]
        EngineKind::Rapier,
    ]
}

/// Robots with every kind of gripper.
const ROBOTS: [&str; 2] = ["franka", "ur5e"];

fn environment(on: EngineKind, task: &dyn ArmTask, robot: &str) -> ArmEnvironment {
    task.on(on.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

/// A value other than the nominal one.
fn unusual(row: &ParameterSpec) -> Value {
    let inside = |low: f64, high: f64| low + 0.37 * (high - low);
    match row.allowed.clone() {
        Allowed::Continuous { low, high } => Value::Number(inside(low, high)),
        Allowed::Integer { low, high } => Value::Integer(inside(low as f64, high as f64) as i64),
        Allowed::Categorical { choices, open } => {
            let nominal = row.nominal.clone().unwrap().to_string();
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
fn scenario(name: &str, value: Value) -> Scenario {
    let mut requested = Assignment::default();
    if name.starts_with("disturbance_") {
        requested.set("disturbance_speed_m_s", Value::Number(0.2));
    }
    if name == "obstacle_gap_m" {
        requested.set("obstacles", Value::Integer(4));
    }
    requested.set(name, value);
    Scenario { index: 3, seed: Seed::campaign(1).episode(3), requested }
}

#[test]
fn rows_are_applied_and_read_back() {
    for (on, (task, robot)) in engines().into_iter().flat_map(|on| pairs().map(move |pair| (on, pair))) {
        let mut simulator = environment(on, task, robot);
        for row in Arc::clone(simulator.task()).parameters.iter().filter(|row| fits(row, robot)) {
            let value = unusual(row);
            assert_ne!(Some(&value), row.nominal.as_ref(), "{}", row.name);
            let scenario = scenario(&row.name, value.clone());
            let what = format!("{on:?} {} {robot} {}", task.name(), row.name);
            let start = simulator.reset(&scenario).unwrap_or_else(|fault| panic!("{what}: {fault}"));
            check_applied(&scenario.requested, &start.applied).unwrap_or_else(|fault| panic!("{what}: {fault}"));
            assert!(start.applied.get(&row.name).is_some(), "{what}");
        }
    }
}

fn pairs() -> impl Iterator<Item = (&'static dyn ArmTask, &'static str)> {
    arm_tasks().into_iter().flat_map(|task| ROBOTS.map(|robot| (task, robot)))
}

/// A UR has no seventh joint.
fn fits(row: &ParameterSpec, robot: &str) -> bool {
    robot == "franka" || &*row.name != "unit_bias_7_rad"
}

/// Tests the readers with the same seed and other values.
#[test]
fn numbers_are_read_over_their_range() {
    for (task, robot) in pairs() {
        let mut simulator = environment(engines()[0], task, robot);
        for row in Arc::clone(simulator.task()).parameters.iter().filter(|row| fits(row, robot)) {
            let Allowed::Continuous { low, high } = row.allowed else { continue };
            for share in [0.0, 0.11, 0.5, 0.8] {
                let scenario = scenario(&row.name, Value::Number(low + share * (high - low)));
                // Some offsets move the object off the table, some gaps leave no room, and some forces are too large.
                let Ok(start) = simulator.reset(&scenario) else { continue };
                check_applied(&scenario.requested, &start.applied).unwrap();
            }
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

    fn force_between(&self, one: Side, other: Side) -> Option<f64> {
        self.engine.force_between(one, other)
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
            let motion = scene.fixtures.last_mut().unwrap().motion.as_mut();
            let Some(Motion::Straight { starts_s, .. }) = motion else { panic!("{motion:?}") };
            *starts_s += 0.1;
        }),
    ];
    for on in engines() {
        for (name, value, change) in &cases {
            let scenario = scenario(name, value.clone());
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
    let pages = [
        include_str!("../../../docs/reference/parameters.md"),
        include_str!("../../../docs/reference/stacking.md"),
        include_str!("../../../docs/reference/insertion.md"),
    ];
    for (task, page) in arm_tasks().into_iter().zip(pages) {
        for robot in ROBOTS {
            for row in &environment(engines()[0], task, robot).task().parameters {
                let known = |page: &str| page.contains(&format!("`{}`", row.name));
                // Those of every task are described with those of pick and place.
                assert!(known(page) || known(pages[0]), "no page describes {} of {}", row.name, task.name());
            }
        }
    }
}
