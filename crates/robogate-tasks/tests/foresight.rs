//! Checks the hidden draws of pick and place against the state of the simulator.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use common::EngineKind;
use robogate_core::{Assignment, Environment, Measures, Policy, Scenario, Seed, Value, rollout};
use robogate_physics::Engine;
#[cfg(feature = "mujoco")]
use robogate_physics::MujocoEngine;
#[cfg(feature = "rapier")]
use robogate_physics::RapierEngine;
use robogate_tasks::claims::Workbench;
use robogate_tasks::pick_place::spec::phases;
use robogate_tasks::pick_place::{PickPlace, Placement, Scripted};
use robogate_tasks::{ArmTask, Rig};

fn engines() -> Vec<EngineKind> {
    vec![
        #[cfg(feature = "mujoco")]
        EngineKind::Mujoco,
        #[cfg(feature = "rapier")]
        EngineKind::Rapier,
    ]
}

fn scenario(index: u64) -> Scenario {
    let values: Assignment = [
        ("friction", Value::Number(0.9)),
        ("mass_kg", Value::Number(0.1)),
        ("size_m", Value::Number(0.031)),
        ("ik_noise_rad", Value::Number(0.01)),
        ("position_jitter_m", Value::Number(0.004)),
        ("obstacles", Value::Integer(3)),
        ("shape", Value::Category("box".into())),
        ("placement", Value::Category(Placement::NAMES[index as usize % 14].into())),
    ]
    .into_iter()
    .map(|(name, value)| (name.into(), value))
    .collect();
    Scenario { index, seed: Seed::campaign(2026).episode(index), requested: values }
}

fn numbers(draws: &Measures, names: &[&str]) -> Vec<f64> {
    names.iter().map(|name| draws.get(name).unwrap_or_else(|| panic!("no draw {name}"))).collect()
}

fn check_draws<E: Engine + 'static>(engine: E, on: EngineKind, index: u64) {
    let cell = on.franka();
    let chain = engine.chain().clone();
    let mut policy = Scripted::new(cell.robot.clone(), chain.clone());
    let mut simulator = PickPlace::default().on(Box::new(engine), Rig::default()).unwrap();
    let scenario = scenario(index);
    let draws = simulator.foresight().unwrap().draws(&scenario).unwrap();
    let start = simulator.reset(&scenario).unwrap();
    // The encoders are off by their biases.
    let truly = simulator.engine().joint_positions();
    for (joint, (measured, truly)) in start.observation.joint_positions().iter().zip(&truly).enumerate() {
        let bias = draws.get(&format!("encoder_bias_{}_rad", joint + 1)).unwrap();
        assert!((measured - truly - bias).abs() < 1e-12, "{on:?} joint {joint}: {} {bias}", measured - truly);
    }
    // Obstacles and object stand where the draws say.
    let read = simulator.engine().read_back().unwrap();
    let obstacles = read.fixtures.iter().filter(|read| (1..=3).contains(&read.fixture));
    assert_eq!(obstacles.clone().count(), 3);
    for fixture in obstacles {
        let name = |axis: &str| format!("obstacle_{}_{axis}_m", fixture.fixture);
        let at = numbers(&draws, &[&name("x"), &name("y")]);
        let there = fixture.pose.translation;
        assert!((there.x - at[0]).abs() < 1e-6 && (there.y - at[1]).abs() < 1e-6, "{on:?} {}", name("x"));
    }
    assert_eq!(draws.get("obstacle_4_x_m"), None);
    let placement = Placement::from_name(Placement::NAMES[index as usize]).unwrap();
    let jitter = numbers(&draws, &["jitter_x_m", "jitter_y_m"]);
    for axis in 0..2 {
        let off = read.object.translation.vector[axis] - placement.position[axis];
        assert!((off - jitter[axis]).abs() < 1e-6, "{on:?} jitter {off} {jitter:?}");
    }
    // When the fingers start to close, the tool is displaced as predicted.
    let task = std::sync::Arc::clone(simulator.task());
    policy.reset(&task, &start.instance, scenario.seed).unwrap();
    let mut observation = start.observation;
    let mut closed = false;
    for _ in 0..200 {
        let action = policy.act(&observation).unwrap();
        if action.phase == Some(phases::GRASP) {
            let truly = chain.tcp_at(&simulator.engine().joint_positions());
            let off = chain.tcp_at(observation.joint_positions()).inverse() * truly;
            let predicted = numbers(&draws, &["tool_offset_x_m", "tool_offset_y_m", "tool_offset_z_m"]);
            for (off, predicted) in off.translation.vector.iter().zip(&predicted) {
                assert!((off - predicted).abs() < 3e-4, "{on:?} {index}: tool offset {off}, predicted {predicted}");
            }
            closed = true;
            break;
        }
        let step = simulator.step(&action).unwrap();
        if step.ending.is_some() {
            break;
        }
        observation = step.observation;
    }
    assert!(closed, "{on:?} {index}: the fingers never closed");
}

#[test]
fn draws_equal_the_simulator_state() {
    for on in engines() {
        for index in 0..4 {
            let robot = on.franka().robot;
            match on {
                #[cfg(feature = "mujoco")]
                EngineKind::Mujoco => check_draws(MujocoEngine::new(robot, on.time_step()).unwrap(), on, index),
                #[cfg(feature = "rapier")]
                EngineKind::Rapier => check_draws(RapierEngine::new(robot, on.time_step()).unwrap(), on, index),
            }
        }
    }
}

#[test]
fn episodes_record_declared_draws() {
    let on = engines()[0];
    let cell = on.franka();
    let (mut simulator, mut policy) = cell.bench(&cell.setup()).unwrap();
    let episode = rollout(&mut *simulator, &mut *policy, &scenario(5));
    let declared = &simulator.task().draws;
    assert!(episode.draws.len() >= 7 + 6 + 2 + 2 + 6, "{:?}", episode.draws);
    for (name, value) in episode.draws.iter() {
        assert!(declared.iter().any(|draw| draw.name == name) && value.is_finite(), "{name} = {value}");
    }
    assert!(simulator.task().check().is_ok());
}

#[test]
fn features_match_their_specifications() {
    for robot in ["franka", "ur5e"] {
        let cell = engines()[0].robot(robot);
        let (simulator, _) = cell.bench(&cell.setup()).unwrap();
        let foresight = simulator.foresight().unwrap();
        for index in 0..14 {
            let mut scenario = scenario(index);
            let features = foresight.features(&scenario).unwrap();
            assert_eq!(features.len(), foresight.feature_specs().len());
            assert!(features.iter().all(|x| x.is_finite()), "{robot} {features:?}");
            // A heavier object has smaller margins of grip and torque.
            let heavier: Assignment = scenario
                .requested
                .iter()
                .map(|(name, value)| (name.into(), if name == "mass_kg" { Value::Number(1.5) } else { value.clone() }))
                .collect();
            scenario.requested = heavier;
            let heavy = foresight.features(&scenario).unwrap();
            assert!(heavy[0] < features[0] && heavy[1] < features[1], "{robot} {features:?} {heavy:?}");
        }
    }
}
