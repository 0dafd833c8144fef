//! Physics claims of stacking for every engine, and its controller on every kind of gripper.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[macro_use]
mod common;

use common::{EngineKind, episodes, let_run, outcome, scenario};
use nalgebra::Isometry3;
use robogate_core::{Assignment, Domain, ParameterSpace, Scenario, Seed, Value};
use robogate_physics::{
    Color, Engine, Fixture, FreeBody, GRAVITY, GripperUnit, MassProperties, Object, Part, Primitive, Scene, Visual,
};
use robogate_tasks::ArmTask;
use robogate_tasks::stacking::Stacking;
use robogate_tasks::stacking::statics::{Level, margin};

/// Edge of the cubes, in metres.
const SIZE: f64 = 0.05;

/// A stack of cubes at these offsets (fractions of the size) with these masses (kg), as a scene.
fn stack(offsets: &[f64], masses: &[f64]) -> Scene {
    let parts = vec![Part { primitive: Primitive::Box { half: [0.5 * SIZE; 3] }, pose: Isometry3::identity() }];
    let body = |level: usize| FreeBody {
        name: format!("cube_{level}"),
        object: Object { mass: MassProperties::homogeneous(&parts, masses[level]), parts: parts.clone() },
        pose: Isometry3::translation(0.55 + offsets[level] * SIZE, 0.2, (level as f64 + 0.5) * SIZE),
        color: Color([90; 3]),
    };
    let bottom = body(0);
    Scene {
        object: bottom.object,
        object_pose: bottom.pose,
        others: (1..offsets.len()).map(body).collect(),
        friction: 0.6,
        table_friction: None,
        arm_stiffness: 1.0,
        gripper: GripperUnit::default(),
        fixtures: vec![Fixture::table()],
        gravity: GRAVITY,
        marker: None,
        visual: Visual::default(),
    }
}

/// Whether a stack stands after 3 s.
fn stands(engine: &mut dyn Engine, scene: &Scene) -> bool {
    let_run(engine, scene, 3.0);
    let at_rest = |(body, (_, start)): (usize, (&Object, &Isometry3<f64>))| {
        (engine.free_body(body).translation.vector - start.translation.vector).norm() < 0.2 * SIZE
    };
    scene.free_bodies().enumerate().all(at_rest)
}

of_every_engine! {
    /// Stacks stand exactly where statics says so, up to 2 % of the size around the limit.
    fn overhang_obeys_statics(on: EngineKind) {
        let mut engine = on.robot("franka").engine();
        let pairs = [0.0, 0.3, 0.45, 0.47, 0.53, 0.6].map(|x| (vec![0.0, x], vec![0.2; 2]));
        let triples = [0.1, 0.25, 0.31, 0.36, 0.45].map(|x| (vec![0.0, x, 2.0 * x], vec![0.2; 3]));
        // From the top, offsets of 1/2 and 1/4 are the limit of equal parts. A counterweight extends the overhang.
        let others = [
            (vec![0.0, 0.23, 0.69], vec![0.2; 3]),
            (vec![0.0, 0.29, 0.77], vec![0.2; 3]),
            (vec![0.0, 0.6, 0.2], vec![0.2; 3]),
            (vec![0.0, 0.6, 0.2], vec![0.2, 0.2, 0.04]),
        ];
        for (offsets, masses) in pairs.into_iter().chain(triples).chain(others) {
            let levels: Vec<Level> = offsets
                .iter()
                .zip(&masses)
                .map(|(x, mass)| Level { at: [x * SIZE, 0.0], mass_kg: *mass })
                .collect();
            let expected = margin(&levels, SIZE) > 0.0;
            assert_eq!(stands(&mut *engine, &stack(&offsets, &masses)), expected, "{offsets:?} {masses:?}");
        }
    }

    fn fingers_stack_nominal_parts(on: EngineKind) {
        let found = episodes(on, &Stacking::DEFAULT, "franka", &[scenario(0, &[]), scenario(1, &[("overhang", 0.2)])]);
        found.iter().for_each(|episode| assert_eq!(outcome(episode), "success", "{episode:#?}"));
    }

    fn cups_stack_nominal_parts(on: EngineKind) {
        for robot in ["ur5e", "ur10e"] {
            let found = episodes(on, &Stacking::DEFAULT, robot, &[scenario(0, &[]), scenario(1, &[("overhang", 0.2)])]);
            found.iter().for_each(|episode| assert_eq!(outcome(episode), "success", "{robot}: {episode:#?}"));
        }
    }

    /// The third part tips the stack over beyond one third.
    fn overhang_topples_the_stack(on: EngineKind) {
        for robot in ["franka", "ur5e"] {
            let found = episodes(on, &Stacking::DEFAULT, robot, &[scenario(0, &[("overhang", 0.42)])]);
            assert_eq!(outcome(&found[0]), "toppled", "{robot}: {:#?}", found[0]);
        }
    }

    fn distant_parts_are_missed(on: EngineKind) {
        let far = [("position_jitter_m", 0.03)];
        let scenarios: Vec<Scenario> = (0..6).map(|index| scenario(index, &far)).collect();
        let found = episodes(on, &Stacking::DEFAULT, "franka", &scenarios);
        let failures = found.iter().filter(|episode| ["missed", "misplaced", "toppled"].contains(&outcome(episode)));
        assert!(failures.count() >= 2, "{:?}", found.iter().map(outcome).collect::<Vec<_>>());
    }

    fn heavy_parts_are_dropped(on: EngineKind) {
        let found = episodes(on, &Stacking::DEFAULT, "franka", &[scenario(0, &[("mass_kg", 3.0), ("friction", 0.08)])]);
        assert_eq!(outcome(&found[0]), "dropped", "{:#?}", found[0]);
    }

    /// Every parameter is read back at both ends of the space, so no episode is invalid.
    fn parameters_are_applied(on: EngineKind) {
        let space = ParameterSpace::from_toml(robogate_tasks::built_in_space(Stacking::DEFAULT.space(&on.robot("franka").robot.settings.gripper)).unwrap()).unwrap();
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
            outcome(&episodes(on, &Stacking::DEFAULT, "franka", &[scenario])[0]);
        }
    }

    fn episodes_repeat_bit_for_bit(on: EngineKind) {
        let parameters = [("position_jitter_m", 0.004), ("yaw_jitter_rad", 0.2), ("encoder_bias_rad", 0.003)];
        let scenarios = [scenario(7, &parameters), scenario(8, &parameters)];
        let hashes = || episodes(on, &Stacking::DEFAULT, "ur5e", &scenarios).into_iter().map(|e| (e.time_s, e.trajectory_hash));
        assert!(hashes().eq(hashes()));
    }
}
