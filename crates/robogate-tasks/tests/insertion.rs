//! Physics claims of insertion for every engine, and its controller on every kind of gripper.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[macro_use]
mod common;

use common::{EngineKind, episodes, let_run, outcome, scenario};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Assignment, Episode, ParameterSpace, Scenario, Seed, Value};
use robogate_physics::{Engine, Fixture, GRAVITY, GripperUnit, Scene, Visual};
use robogate_tasks::ArmTask;
use robogate_tasks::insertion::{Insertion, parts, whitney};

/// Width of the peg and clearance of the claims, in metres.
const WIDTH: f64 = 0.03;
const CLEARANCE: f64 = 2e-4;

/// A peg that leans in the hole at this depth (m), with its weight `lever` metres from the hole's axis.
fn leaning(depth: f64, lever: f64, friction: f64) -> Scene {
    let mouth = Isometry3::translation(0.55, 0.2, parts::DEPTH_M);
    let tilt = 0.98 * CLEARANCE / depth;
    let upright = parts::peg(WIDTH, 0.2, 0.0);
    // The tip leans to one wall, the shaft to the opposite edge of the mouth.
    let tip = -0.49 * CLEARANCE;
    let offset = lever - tip - upright.mass.centre.z * tilt;
    let pose = Isometry3::from_parts(
        Translation3::new(0.55 + tip, 0.2, parts::DEPTH_M - depth),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt),
    );
    let mut fixtures = vec![Fixture::table()];
    fixtures.extend(parts::block(&mouth, WIDTH + CLEARANCE, 0.0));
    Scene {
        object: parts::peg(WIDTH, 0.2, offset),
        object_pose: pose,
        others: Vec::new(),
        friction: 0.8,
        table_friction: Some(friction),
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures,
        // The analysis is quasi-static: with a small weight the peg is slow while the contact forces build up.
        gravity: 0.01 * GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}

/// The distance in metres by which a free peg sinks within this time in seconds.
fn sinks(engine: &mut dyn Engine, scene: &Scene, seconds: f64) -> f64 {
    let_run(engine, scene, seconds);
    scene.object_pose.translation.z - engine.object().translation.z
}

of_every_engine! {
    /// An upright peg with a centred weight falls to the bottom.
    fn ideal_peg_inserts(on: EngineKind) {
        let mut engine = on.robot("franka").engine();
        for friction in [0.1, 0.6] {
            let mut scene = leaning(0.005, 0.0, friction);
            scene.object = parts::peg(WIDTH, 0.2, 0.0);
            scene.gravity = GRAVITY;
            scene.object_pose = Isometry3::translation(0.55, 0.2, parts::DEPTH_M - 0.005);
            let sunk = sinks(&mut *engine, &scene, 1.0);
            assert!((sunk - (parts::DEPTH_M - 0.005)).abs() < 1e-3, "friction {friction}: {sunk} m");
        }
    }

    /// A load at the peg's edge holds the peg where it can wedge, and pushes it in where it cannot.
    fn wedging_obeys_whitney(on: EngineKind) {
        let mut engine = on.robot("franka").engine();
        for friction in [0.3, 0.4, 0.6] {
            for share in [0.75, 1.25] {
                let depth = share * friction * WIDTH;
                let sunk = sinks(&mut *engine, &leaning(depth, 0.5 * WIDTH, friction), 2.0);
                let wedged = whitney::can_wedge(depth, WIDTH, friction);
                let agrees = if wedged { sunk < 1e-3 } else { sunk > 5e-3 };
                assert!(agrees, "friction {friction}, {share} of the limit: sinks {:.2} mm", 1e3 * sunk);
            }
        }
    }

    /// The lever of the load decides whether it jams the peg.
    fn jamming_obeys_whitney(on: EngineKind) {
        let mut engine = on.robot("franka").engine();
        for (friction, lever) in [(0.4, 0.012), (0.6, 0.008), (0.8, 0.007)] {
            for share in [0.75, 1.25] {
                let depth = share * 2.0 * friction * lever;
                let sunk = sinks(&mut *engine, &leaning(depth, lever, friction), 2.0);
                let jammed = whitney::jams(depth, lever, friction);
                let agrees = if jammed { sunk < 1e-3 } else { sunk > 5e-3 };
                assert!(agrees, "friction {friction}, lever {lever} m, {share}: sinks {:.2} mm", 1e3 * sunk);
            }
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
