//! What every task for an arm has: early endings, parameters of a unit, feasibility.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use robogate_core::{FailureMode, Outcome, check_applied, rollout};
use robogate_tasks::{ArmEnvironment, ArmTask, Rig};

use common::{EngineKind, Idle, arm_tasks, scenario};

fn environment(task: &dyn ArmTask, robot: &str) -> ArmEnvironment {
    task.on(EngineKind::Mujoco.robot(robot).engine(), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

#[test]
fn giving_up_ends_an_episode_early() {
    for task in arm_tasks() {
        let mut environment = environment(task, "franka");
        let episode = rollout(&mut environment, &mut Idle { gives_up: true, ..Idle::default() }, &scenario(0, &[]));
        let limit_s = robogate_core::Environment::task(&environment).time_limit_s;
        assert_eq!(episode.outcome, Outcome::Failure(FailureMode::TIMEOUT), "{}", task.name());
        assert!((episode.time_s - limit_s).abs() < 1e-9, "{}: {} s", task.name(), episode.time_s);
        assert!(f64::from(episode.ticks) * 0.05 < 0.25 * limit_s, "{}: {} ticks", task.name(), episode.ticks);
        assert_eq!(episode.measures.get("feasible"), Some(1.0));
    }
}

/// The expert that moves the tool in small steps succeeds where everything is nominal.
#[test]
fn tool_experts_succeed() {
    for task in arm_tasks() {
        for robot in ["franka", "ur5e", "ur3e"] {
            // The short arm does not carry over the pile in small steps within the time limit.
            if (task.name(), robot) == ("stacking", "ur3e") {
                continue;
            }
            let mut environment = environment(task, robot);
            let mut expert =
                task.tool_expert(EngineKind::Mujoco.robot(robot).robot, environment.engine().chain().clone()).unwrap();
            expert.check(robogate_core::Environment::task(&environment)).unwrap();
            for index in 0..2 {
                let episode = rollout(&mut environment, &mut *expert, &scenario(index, &[]));
                assert_eq!(episode.outcome, Outcome::Success, "{} on {robot}: {episode:#?}", task.name());
            }
        }
    }
}

#[test]
fn unit_parameters_are_applied() {
    let fingers = [
        ("unit_bias_1_rad", 0.004),
        ("unit_bias_4_rad", -0.01),
        ("grip_force_scale", 0.7),
        ("pad_friction_scale", 0.6),
        ("camera_roll_rad", 0.02),
        ("camera_pitch_rad", -0.01),
    ];
    for task in arm_tasks() {
        for (robot, parameters) in [("franka", fingers.to_vec()), ("ur5e", fingers[..3].to_vec())] {
            let mut environment = environment(task, robot);
            let scenario = scenario(3, &parameters);
            let start = robogate_core::Environment::reset(&mut environment, &scenario).unwrap();
            check_applied(&scenario.requested, &start.applied).unwrap();
        }
    }
}

#[test]
fn a_joint_that_the_arm_lacks_has_no_bias() {
    for task in arm_tasks() {
        let scenario = scenario(3, &[("unit_bias_7_rad", 0.01)]);
        let fault = robogate_core::Environment::reset(&mut environment(task, "ur5e"), &scenario).unwrap_err();
        assert!(fault.detail.contains("unit_bias_7_rad"), "{}: {fault}", task.name());
    }
}

#[test]
fn impossible_scenarios_are_known() {
    let impossible: [&[(&str, f64)]; 3] = [
        &[("friction", 0.2), ("mass_kg", 1.3)],
        &[("friction", 0.05), ("mass_kg", 2.0)],
        // The vacuum of the cup carries 7.6 kg; a unit may have much less.
        &[("mass_kg", 2.0), ("grip_force_scale", 0.05)],
    ];
    for (task, (robot, values)) in arm_tasks().into_iter().zip(["franka", "franka", "ur5e"].into_iter().zip(impossible))
    {
        let environment = environment(task, robot);
        let known = |values| robogate_core::Environment::infeasibility(&environment, &scenario(0, values).requested);
        assert!(known(values).is_some_and(|why| why.condition.contains("heavier")), "{}", task.name());
        assert_eq!(known(&[]), None, "{}", task.name());
    }
}
