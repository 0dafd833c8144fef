//! Physics claims of insertion for every engine, and its controller on every kind of gripper.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[macro_use]
mod common;

use common::{EngineKind, episodes, outcome, scenario};
use robogate_core::{Assignment, Episode, ParameterSpace, Scenario, Seed, Value};
use robogate_tasks::ArmDeclaration;
use robogate_tasks::insertion::Insertion;

of_every_engine! {
    fn pegs_obey_whitney(on: EngineKind) {
        for claim in ["ideal_peg", "wedging", "jamming"] {
            on.franka().with(&Insertion::DEFAULT).confirm(claim, 0);
        }
    }

    fn easy_region_is_easy(on: EngineKind) {
        for robot in ["franka", "ur5e"] {
            on.robot(robot).with(&Insertion::DEFAULT).confirm("easy_region", on.episodes(12));
            on.robot(robot).with(&Insertion::DEFAULT).confirm("joint_limits", on.episodes(4));
        }
    }

    fn controller_inserts_nominal_pegs(on: EngineKind) {
        for robot in ["franka", "ur5e"] {
            let scenarios = [
                scenario(0, &[]),
                scenario(1, &[("hole_jitter_m", 0.002)]),
                scenario(2, &[("clearance_m", 0.0005), ("hole_jitter_m", 0.001)]),
            ];
            let found: Vec<Episode> = episodes(on, &Insertion::DEFAULT, robot, &scenarios);
            found.iter().for_each(|episode| assert_eq!(outcome(episode), "success", "{robot}: {episode:#?}"));
        }
    }

    fn distant_pegs_are_missed(on: EngineKind) {
        let scenarios: Vec<Scenario> = (0..4).map(|index| scenario(index, &[("peg_jitter_m", 0.03)])).collect();
        let found = episodes(on, &Insertion::DEFAULT, "ur5e", &scenarios);
        let failures = found.iter().filter(|episode| ["missed", "dropped"].contains(&outcome(episode)));
        assert!(failures.count() > 0, "{:?}", found.iter().map(outcome).collect::<Vec<_>>());
    }

    /// Every parameter is read back at both ends of the space, so no episode is invalid.
    fn parameters_are_applied(on: EngineKind) {
        let space = ParameterSpace::from_toml(robogate_tasks::built_in_space(Insertion::DEFAULT.space(&on.robot("franka").robot.settings.gripper)).unwrap()).unwrap();
        for end in [0, 1] {
            let mut requested = Assignment::default();
            for parameter in space.parameters() {
                requested.set(&*parameter.name, parameter.domain.extremes()[end].clone());
            }
            requested.set("lighting_lux", Value::Integer(700));
            let scenario = Scenario { index: 3, seed: Seed::campaign(5).episode(3), requested };
            outcome(&episodes(on, &Insertion::DEFAULT, "franka", &[scenario])[0]);
        }
    }

    fn episodes_repeat_bit_for_bit(on: EngineKind) {
        let parameters = [("hole_jitter_m", 0.002), ("peg_jitter_m", 0.002), ("encoder_bias_rad", 0.001)];
        let scenarios = [scenario(7, &parameters)];
        let hashes = || episodes(on, &Insertion::DEFAULT, "ur5e", &scenarios).into_iter().map(|e| (e.time_s, e.trajectory_hash));
        assert!(hashes().eq(hashes()));
    }
}
