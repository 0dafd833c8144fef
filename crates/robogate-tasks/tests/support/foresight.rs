//! The draws and features of insertion and stacking against the state of the simulator.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use robogate_core::{Assignment, Environment, Measures, Outcome, Pose, Scenario, Seed, Step, Value, rollout};
use robogate_physics::{Engine, MujocoEngine, Robot, built_in_robot, isometry};

use super::{ArmEnvironment, ArmTask, Rig};
use crate::file::{FileTask, shipped};
use crate::insertion::{Insertion, parts::DEPTH_M};

fn stacking() -> &'static FileTask {
    shipped().next().unwrap()
}

/// The tolerance of a place in a stack, in metres.
const TOLERANCE_M: f64 = 0.01;

const ROBOTS: [&str; 2] = ["franka", "ur5e"];

fn environment(task: &dyn ArmTask, robot: &Robot) -> ArmEnvironment {
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).unwrap();
    task.on(Box::new(engine), Rig { picture_px: [16; 2], ..Rig::default() }).unwrap()
}

fn scenario(index: u64, values: &[(&str, f64)]) -> Scenario {
    let requested: Assignment = values.iter().map(|(name, value)| ((*name).into(), Value::Number(*value))).collect();
    Scenario { index, seed: Seed::campaign(77).episode(index), requested }
}

fn of(draws: &Measures, name: &str) -> f64 {
    draws.get(name).unwrap_or_else(|| panic!("no draw {name}"))
}

/// The pose in a briefing.
fn place(details: &serde_json::Value) -> Isometry3<f64> {
    let pose: Pose = serde_json::from_value(details.clone()).unwrap();
    isometry(&pose.position, &pose.orientation)
}

fn feature(environment: &ArmEnvironment, scenario: &Scenario, name: &str) -> f64 {
    let foresight = environment.foresight().unwrap();
    let at = foresight.feature_specs().iter().position(|spec| spec.name == name).unwrap();
    foresight.features(scenario).unwrap()[at]
}

/// Runs the scripted controller, and checks the biases and the displacement of the tool at each moment of the plan that has a name:
/// where the gripper changes its command, or the phase becomes the one that `arrives` names. Calls `there` at each.
fn follow(
    task: &dyn ArmTask,
    environment: &mut ArmEnvironment,
    robot: &Robot,
    scenario: &Scenario,
    moments: &[&str],
    arrives: &str,
    mut there: impl FnMut(&dyn Engine, &str),
) -> Option<Step> {
    let draws = environment.foresight().unwrap().draws(scenario).unwrap();
    let start = environment.reset(scenario).unwrap();
    let chain = environment.engine().chain().clone();
    for (joint, (measured, truly)) in
        start.observation.joint_positions().iter().zip(environment.engine().joint_positions()).enumerate()
    {
        let bias = of(&draws, &format!("encoder_bias_{}_rad", joint + 1));
        assert!((measured - truly - bias).abs() < 1e-12, "joint {joint}: {} {bias}", measured - truly);
    }
    let mut policy = task.controller(robot.clone(), chain.clone());
    let spec = Arc::clone(environment.task());
    policy.reset(&spec, &start.instance, scenario.seed).unwrap();
    let (mut observation, mut before, mut moments) = (start.observation, None, moments.iter());
    let mut last = None;
    for _ in 0..900 {
        let action = policy.act(&observation).unwrap();
        let now = (action.gripper, action.phase.is_some_and(|phase| phase.as_str() == arrives));
        if before.replace(now).is_some_and(|before| before != now)
            && let Some(moment) = moments.next()
        {
            let truly = chain.tcp_at(&environment.engine().joint_positions());
            let off = chain.tcp_at(observation.joint_positions()).inverse() * truly;
            for (axis, (found, turned)) in
                ["x", "y", "z"].iter().zip(off.translation.vector.iter().zip(off.rotation.scaled_axis().iter()))
            {
                let [offset, tilt] = [format!("{moment}_offset_{axis}_m"), format!("{moment}_tilt_{axis}_rad")];
                let (predicted, angle) = (of(&draws, &offset), of(&draws, &tilt));
                assert!((found - predicted).abs() < 3e-4, "{}: {offset} is {found}, not {predicted}", robot.name());
                assert!((turned - angle).abs() < 1e-3, "{}: {tilt} is {turned}, not {angle}", robot.name());
            }
            there(environment.engine(), moment);
        }
        let step = environment.step(&action).unwrap();
        observation = step.observation.clone();
        let over = step.ending.is_some();
        last = Some(step);
        if over {
            break;
        }
    }
    assert!(moments.next().is_none(), "{}: the plan was not followed to its end", robot.name());
    last
}

#[test]
fn insertion_is_foreseen() {
    for name in ROBOTS {
        let robot = built_in_robot(name).unwrap();
        let mut environment = environment(&Insertion::DEFAULT, &robot);
        for index in 0..4 {
            let scenario = scenario(
                index,
                &[
                    ("encoder_bias_rad", 0.003),
                    ("hole_jitter_m", 0.003),
                    ("hole_tilt_rad", 0.02),
                    ("peg_jitter_m", 0.004),
                    ("chamfer_m", 0.002),
                    ("arm_stiffness", 1.0),
                ],
            );
            let draws = environment.foresight().unwrap().draws(&scenario).unwrap();
            let start = environment.reset(&scenario).unwrap();
            let [peg, hole] = ["peg", "hole"].map(|part| place(&start.instance.details[part]));
            let shifted = |part: &str| {
                Isometry3::translation(
                    of(&draws, &format!("{part}_shift_x_m")),
                    of(&draws, &format!("{part}_shift_y_m")),
                    0.0,
                )
            };
            let turn = Vector3::new(of(&draws, "hole_turn_x_rad"), of(&draws, "hole_turn_y_rad"), 0.0);
            let mouth = shifted("hole") * hole * Isometry3::rotation(turn);
            let entry = feature(&environment, &scenario, "entry_offset_m");
            let tilt = feature(&environment, &scenario, "relative_tilt_rad");
            let read = environment.engine().read_back().unwrap();
            let off = read.object.translation.vector - (shifted("peg") * peg).translation.vector;
            assert!(off.norm() < 1e-6, "{name}: the peg is off by {off}");
            // The four lower parts of the walls stand around the axis of the hole.
            let walls: Vec<_> = read.fixtures.iter().filter(|read| read.fixture > 0 && read.fixture % 3 == 1).collect();
            assert_eq!(walls.len(), 4);
            let middle = walls.iter().map(|wall| wall.pose.translation.vector).sum::<Vector3<f64>>() / 4.0;
            let expected = mouth * Point3::new(0.0, 0.0, -0.002 - 0.5 * (DEPTH_M - 0.002));
            assert!((middle - expected.coords).norm() < 1e-6, "{name}: {middle} {expected}");
            follow(
                &Insertion::DEFAULT,
                &mut environment,
                &robot,
                &scenario,
                &["grasp", "arrival"],
                "touch",
                |engine, moment| {
                    if moment == "arrival" {
                        let at = mouth.inverse() * engine.object();
                        let axis = at.rotation * Vector3::z();
                        // The tip is still above the mouth.
                        let sideways = at.translation.vector.xy() - axis.xy() / axis.z * at.translation.z;
                        let (found, leans) = (sideways.norm(), axis.xy().norm());
                        assert!((found - entry).abs() < 1e-3, "{name} {index}: the tip is off by {found}, not {entry}");
                        assert!((leans - tilt).abs() < 0.012, "{name} {index}: the peg leans by {leans}, not {tilt}");
                    }
                },
            );
        }
    }
}

#[test]
fn stacking_is_foreseen() {
    for name in ROBOTS {
        let robot = built_in_robot(name).unwrap();
        let mut environment = environment(stacking(), &robot);
        let mut compared = 0;
        for index in 0..4 {
            let values = [
                ("encoder_bias_rad", 0.003),
                ("position_jitter_m", 0.004),
                ("yaw_jitter_rad", 0.1),
                ("overhang", 0.1),
                ("size_m", 0.052),
            ];
            let scenario = scenario(index, &values);
            let draws = environment.foresight().unwrap().draws(&scenario).unwrap();
            let margin = feature(&environment, &scenario, "place_margin_m");
            let details = environment.reset(&scenario).unwrap().instance.details;
            for (body, part) in ["a", "b", "c"].iter().enumerate() {
                let (at, [x, y, _]): (_, [f64; 3]) = (
                    environment.engine().free_body(body),
                    place(&details["parts"][format!("part_{part}")]).translation.vector.into(),
                );
                let found = [at.translation.x - x, at.translation.y - y, at.rotation.euler_angles().2];
                for (suffix, found) in ["shift_x_m", "shift_y_m", "turn_rad"].iter().zip(found) {
                    let draw = of(&draws, &format!("part_{part}_{suffix}"));
                    assert!((found - draw).abs() < 1e-6, "{name}: {suffix} of {part} is {found}, not {draw}");
                }
            }
            let moments = ["grasp_second", "place_second", "grasp_third", "place_third"];
            let last = follow(stacking(), &mut environment, &robot, &scenario, &moments, "", |_, _| {}).unwrap();
            if last.ending.is_some_and(|ending| ending.failure.is_none()) {
                let offset = last.measures.get("stack_offset_m").unwrap();
                let predicted = TOLERANCE_M - margin;
                assert!((offset - predicted).abs() < 2e-3, "{name} {index}: offset {offset}, predicted {predicted}");
                compared += 1;
            }
        }
        assert!(compared >= 2, "{name}: {compared} stacks were completed");
    }
}

#[test]
fn draws_are_declared_and_features_are_finite() {
    fn check(of: &dyn ArmTask, robot: &Robot, values: &[(&str, f64)]) {
        let mut environment = environment(of, robot);
        let task = Arc::clone(environment.task());
        assert!(task.check().is_ok());
        let mut policy = of.controller(robot.clone(), environment.engine().chain().clone());
        let foresight = environment.foresight().unwrap();
        for index in 0..6 {
            let scenario = scenario(index, values);
            let row = foresight.features(&scenario).unwrap();
            assert_eq!(row.len(), foresight.feature_specs().len());
            assert!(row.iter().all(|x| x.is_finite()), "{}: {row:?}", robot.name());
            let draws = foresight.draws(&scenario).unwrap();
            assert_eq!(draws.len(), task.draws.len());
            assert!(draws.iter().zip(&task.draws).all(|((name, _), spec)| spec.name == name));
        }
        let episode = rollout(&mut environment, &mut *policy, &scenario(1, values));
        assert!(!matches!(episode.outcome, Outcome::Invalid(_)), "{:?}", episode.outcome);
        assert_eq!(episode.draws.len(), task.draws.len());
    }
    for name in ROBOTS {
        let robot = built_in_robot(name).unwrap();
        check(
            &Insertion::DEFAULT,
            &robot,
            &[("encoder_bias_rad", 0.004), ("hole_jitter_m", 0.004), ("clearance_m", 0.0003)],
        );
        check(stacking(), &robot, &[("encoder_bias_rad", 0.01), ("yaw_jitter_rad", 0.3), ("overhang", 0.4)]);
    }
}

/// The signs of the features agree with what they claim.
#[test]
fn features_follow_the_parameters() {
    let robot = built_in_robot("franka").unwrap();
    let insertion = environment(&Insertion::DEFAULT, &robot);
    let with = |more: &[(&'static str, f64)]| {
        let mut values = vec![("encoder_bias_rad", 0.003), ("hole_jitter_m", 0.01), ("hole_tilt_rad", 0.05)];
        values.extend_from_slice(more);
        scenario(3, &values)
    };
    let of = |name: &str, more: &[(&'static str, f64)]| feature(&insertion, &with(more), name);
    assert!(of("search_time_s", &[("chamfer_m", 0.0)]) > of("search_time_s", &[("chamfer_m", 0.003)]));
    assert!(of("fit_margin_m", &[("clearance_m", 3e-4)]) < of("fit_margin_m", &[("clearance_m", 3e-3)]));
    let stiff = |stiffness| of("binding_margin", &[("clearance_m", 3e-4), ("arm_stiffness", stiffness)]);
    assert!(stiff(1.0) < stiff(0.1));
    assert!(of("grip_margin", &[("mass_kg", 2.0)]) < of("grip_margin", &[]));
    let stacking = environment(stacking(), &robot);
    let of = |name: &str, values: &[(&str, f64)]| feature(&stacking, &scenario(3, values), name);
    assert!((of("stability_margin_m", &[("overhang", 0.0)]) - 0.025).abs() < 1e-9);
    assert!(of("stability_margin_m", &[("overhang", 0.4)]) < 0.0, "three cubes stand up to an offset of a third");
    assert!((of("place_margin_m", &[]) - TOLERANCE_M).abs() < 1e-9);
    assert!(of("place_margin_m", &[("position_jitter_m", 0.01)]) < TOLERANCE_M);
}
