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

/// A scenario of the campaign with the default seed.
#[cfg(feature = "mujoco")]
fn recorded(index: u64, parameters: &[(&str, f64)]) -> Scenario {
    Scenario { seed: Seed::campaign(2026).episode(index), ..scenario(index, parameters) }
}

/// The peg catches on the edge of the hole and turns in the hand, which then comes down on the block or releases it there.
#[test]
#[cfg(feature = "mujoco")]
fn pegs_that_turn_in_the_hand_slipped() {
    let scenarios = [
        recorded(
            11,
            &[
                ("clearance_m", 0.0005206880085498602),
                ("chamfer_m", 0.0005610787488520146),
                ("mass_kg", 0.3811566665324597),
                ("friction", 0.45831672843545673),
                ("arm_stiffness", 0.22315522097473492),
                ("hole_jitter_m", 0.0020953113406896595),
                ("hole_tilt_rad", 0.0022879666462540626),
                ("peg_jitter_m", 0.003060715386271477),
                ("encoder_bias_rad", 0.0002569933265447617),
            ],
        ),
        recorded(
            15,
            &[
                ("clearance_m", 0.00022903896223170226),
                ("chamfer_m", 0.0025365339808166025),
                ("mass_kg", 0.21922783295021708),
                ("friction", 0.5672663581743836),
                ("arm_stiffness", 0.19163697737950489),
                ("hole_jitter_m", 0.003190589240193367),
                ("hole_tilt_rad", 0.0004547053053975105),
                ("peg_jitter_m", 0.0021967329174280167),
                ("encoder_bias_rad", 0.0012084374219179152),
            ],
        ),
    ];
    for episode in episodes(EngineKind::Mujoco, &Insertion::DEFAULT, "franka", &scenarios) {
        assert_eq!(outcome(&episode), "slipped", "{episode:#?}");
        assert!(episode.measures.get("slip_m").unwrap() > 0.02);
    }
}

/// The peg creeps at 0.26 mm/s until the hand slides down along it.
#[test]
#[cfg(feature = "mujoco")]
fn creeping_pegs_are_stuck() {
    let scenario = recorded(
        20,
        &[
            ("clearance_m", 0.00045123256799680137),
            ("chamfer_m", 0.0017842889674007892),
            ("mass_kg", 0.40669774485821947),
            ("friction", 0.5313498634472489),
            ("arm_stiffness", 0.7558498487620895),
            ("hole_jitter_m", 6.712994277477265e-5),
            ("hole_tilt_rad", 0.004393254585564136),
            ("peg_jitter_m", 0.0015464752048254013),
            ("encoder_bias_rad", 0.002092231920361519),
        ],
    );
    let episode = &episodes(EngineKind::Mujoco, &Insertion::DEFAULT, "franka", &[scenario])[0];
    assert_eq!(outcome(episode), "jam", "{episode:#?}");
    assert!((8.0..13.0).contains(&episode.time_s), "{}", episode.time_s);
}
