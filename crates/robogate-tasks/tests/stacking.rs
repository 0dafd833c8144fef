//! Physics claims of stacking for every engine, and its controller on every kind of gripper.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[macro_use]
mod common;

use common::{EngineKind, episodes, outcome, scenario, stacking};
use robogate_core::{Assignment, Domain, ParameterSpace, Scenario, Seed, Value};
use robogate_tasks::ArmDeclaration;

of_every_engine! {
    /// The arm builds the stacks of the second claim.
    fn overhang_obeys_statics(on: EngineKind) {
        on.franka().with(stacking()).confirm("statics", 0);
        on.franka().with(stacking()).confirm("overhang", 0);
        on.ur5e().with(stacking()).confirm("overhang", 0);
    }

    fn easy_region_is_easy(on: EngineKind) {
        for robot in ["franka", "ur5e"] {
            on.robot(robot).with(stacking()).confirm("easy_region", on.episodes(12));
            on.robot(robot).with(stacking()).confirm("joint_limits", on.episodes(4));
        }
    }

    fn fingers_stack_nominal_parts(on: EngineKind) {
        let found = episodes(on, stacking(), "franka", &[scenario(0, &[]), scenario(1, &[("overhang", 0.2)])]);
        found.iter().for_each(|episode| assert_eq!(outcome(episode), "success", "{episode:#?}"));
    }

    fn cups_stack_nominal_parts(on: EngineKind) {
        for robot in ["ur5e", "ur10e"] {
            let found = episodes(on, stacking(), robot, &[scenario(0, &[]), scenario(1, &[("overhang", 0.2)])]);
            found.iter().for_each(|episode| assert_eq!(outcome(episode), "success", "{robot}: {episode:#?}"));
        }
    }

    /// The third part tips the stack over beyond one third.
    fn overhang_topples_the_stack(on: EngineKind) {
        for robot in ["franka", "ur5e"] {
            let found = episodes(on, stacking(), robot, &[scenario(0, &[("overhang", 0.42)])]);
            assert_eq!(outcome(&found[0]), "toppled", "{robot}: {:#?}", found[0]);
        }
    }

    fn distant_parts_are_missed(on: EngineKind) {
        let far = [("position_jitter_m", 0.03)];
        let scenarios: Vec<Scenario> = (0..6).map(|index| scenario(index, &far)).collect();
        let found = episodes(on, stacking(), "franka", &scenarios);
        let failures = found.iter().filter(|episode| ["missed", "misplaced", "toppled"].contains(&outcome(episode)));
        assert!(failures.count() >= 2, "{:?}", found.iter().map(outcome).collect::<Vec<_>>());
    }

    fn heavy_parts_are_dropped(on: EngineKind) {
        let found = episodes(on, stacking(), "franka", &[scenario(0, &[("mass_kg", 3.0), ("friction", 0.08)])]);
        assert_eq!(outcome(&found[0]), "dropped", "{:#?}", found[0]);
    }

    /// Every parameter is read back at both ends of the space, so no episode is invalid.
    fn parameters_are_applied(on: EngineKind) {
        let space = ParameterSpace::from_toml(robogate_tasks::built_in_space(stacking().space(&on.robot("franka").robot.settings.gripper)).unwrap()).unwrap();
        for end in [0, 1] {
            let mut requested = Assignment::default();
            for parameter in space.parameters() {
                let value = match &parameter.domain {
                    Domain::Continuous { low, high, .. } => Value::Number([*low, *high][end]),
                    other => other.extremes()[end].clone(),
                };
                requested.set(&*parameter.name, value);
            }
            requested.set("gravity_scale", Value::Number([0.9, 1.2][end]));
            requested.set("lighting_lux", Value::Integer(700));
            let scenario = Scenario { index: 3, seed: Seed::campaign(5).episode(3), requested };
            outcome(&episodes(on, stacking(), "franka", &[scenario])[0]);
        }
    }

    fn episodes_repeat_bit_for_bit(on: EngineKind) {
        let parameters = [("position_jitter_m", 0.004), ("yaw_jitter_rad", 0.2), ("encoder_bias_rad", 0.003)];
        let scenarios = [scenario(7, &parameters), scenario(8, &parameters)];
        let hashes = || episodes(on, stacking(), "ur5e", &scenarios).into_iter().map(|e| (e.time_s, e.trajectory_hash));
        assert!(hashes().eq(hashes()));
    }
}
