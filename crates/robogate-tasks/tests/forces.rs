//! Contact forces by region of the robot, and the sensor at the wrist.
#![cfg(any(feature = "mujoco", feature = "rapier"))]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[macro_use]
mod common;

use common::{EngineKind, scenario};
use robogate_core::{Episode, Outcome, rollout, rollout_with, vectors};
use robogate_physics::GRAVITY;
use robogate_tasks::claims::{Bench, Setup, Workbench};

/// The bench of a robot with a sensor at its wrist.
fn with_sensor(on: EngineKind, robot: &str) -> Result<Bench, String> {
    let cell = on.robot(robot);
    let settings = [("wrist_sensor".into(), robogate_core::Value::Category("on".into()))].into_iter().collect();
    cell.bench(&Setup { settings, ..cell.setup() })
}

/// The observed wrench of each control period in which the part is in the air, and the episode.
fn carried((environment, policy): &mut Bench, mass_kg: f64) -> (Vec<[f64; 6]>, Episode) {
    let mut wrenches = Vec::new();
    let mut lifted = false;
    let scenario = scenario(0, &[("mass_kg", mass_kg), ("friction", 0.9)]);
    let episode = rollout_with(&mut **environment, &mut **policy, &scenario, &mut |tick| {
        let wrench: [f64; 6] = tick.observation.vector(vectors::WRIST_WRENCH.as_str()).unwrap().try_into().unwrap();
        if lifted && tick.action.phase.is_some_and(|phase| phase == "MOVE_TO_TARGET") {
            wrenches.push(wrench);
        }
        lifted |= tick.step.events.iter().any(|event| event == "object off the table");
    });
    (wrenches, episode)
}

of_every_engine! {
    /// The mean over half a second of a steady grip is the grip force.
    fn grip_is_held_by_the_fingers(on: EngineKind) {
        let cell = on.franka();
        let (mut environment, mut policy) = cell.bench(&cell.setup()).unwrap();
        let episode = rollout(&mut *environment, &mut *policy, &scenario(0, &[]));
        assert_eq!(episode.outcome, Outcome::Success);
        let measured = |name: &str| episode.measures.get(name);
        let held = measured("held_force_fingers_part_n").unwrap();
        assert!((28.0..40.0).contains(&held), "{held}");
        assert!(measured("peak_force_fingers_part_n").unwrap() >= held);
        assert_eq!(measured("peak_force_arm_part_n"), None);
        assert_eq!(measured("contact_over_limit_s"), Some(0.0));
    }

    /// A suction cup belongs to the hand.
    fn robots_with_a_cup_have_no_fingers(on: EngineKind) {
        let cell = on.ur5e();
        let (environment, _) = cell.bench(&cell.setup()).unwrap();
        assert!(environment.task().measure("peak_force_fingers_part_n").is_none());
        assert!(environment.task().measure("peak_force_hand_part_n").is_some());
    }
}

/// The force at the wrist is the weight of the part, with fingers and with a cup.
#[test]
#[cfg(feature = "mujoco")]
fn wrist_carries_the_part() {
    for robot in ["franka", "ur5e"] {
        let mass_kg = 0.4;
        let (wrenches, episode) = carried(&mut with_sensor(EngineKind::Mujoco, robot).unwrap(), mass_kg);
        assert_eq!(episode.outcome, Outcome::Success, "{robot}");
        let mut forces: Vec<f64> = wrenches.iter().map(|[x, y, z, ..]| x.hypot(*y).hypot(*z)).collect();
        forces.sort_by(f64::total_cmp);
        let median = forces[forces.len() / 2];
        assert!((median / (mass_kg * GRAVITY) - 1.0).abs() < 0.1, "{robot}: {median} N of {forces:?}");
        // The tool points down, so its z axis is that of the weight.
        let middle = wrenches[wrenches.len() / 2];
        assert!(middle[2] > 0.8 * median, "{robot}: {middle:?}");
    }
}

/// An engine that does not report the force at the wrist refuses the sensor.
#[test]
#[cfg(feature = "rapier")]
fn rapier_has_no_wrist_sensor() {
    let error = with_sensor(EngineKind::Rapier, "franka").err().unwrap();
    assert!(error.contains("--engine mujoco"), "{error}");
}

/// Without the setting, policies see no force.
#[test]
fn sensors_are_off_by_default() {
    #[cfg(feature = "mujoco")]
    {
        let cell = EngineKind::Mujoco.franka();
        let (environment, _) = cell.bench(&cell.setup()).unwrap();
        assert!(environment.task().observation.vectors.iter().all(|vector| vector.name != vectors::WRIST_WRENCH));
    }
}
