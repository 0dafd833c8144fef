//! Tests of the physics claims for every engine, with few episodes. `robogate check physics` runs them at full length.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking, and prints its figures")]

#[macro_use]
mod common;

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::sync::Arc;

use common::EngineKind;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::{Assignment, FailureMode, Outcome, ParameterSpace, Scenario, Seed, Suite, Value, rollout};
use robogate_physics::{FixtureKind, Gripper, JointTargets, Scene, built_in_robot};
use robogate_tasks::ArmDeclaration;
use robogate_tasks::claims::{Setup, Workbench};
use robogate_tasks::pick_place::{self, PickPlace, Placement, SceneParameters, Shape, built_in_space};

fn space(name: &str) -> Arc<ParameterSpace> {
    Arc::new(ParameterSpace::from_toml(built_in_space(name).unwrap()).unwrap())
}

fn scenario(parameters: &[(&str, Value)]) -> Scenario {
    let requested: Assignment = parameters.iter().map(|(name, value)| ((*name).into(), value.clone())).collect();
    Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested }
}

fn scene(on: EngineKind, robot: &str, parameters: &[(&str, Value)]) -> Scene {
    let gripper = &on.robot(robot).robot.settings.gripper;
    let parameters = SceneParameters::from_assignment(&scenario(parameters).requested, gripper).unwrap();
    let placement = Placement::from_name(&parameters.placement).unwrap();
    pick_place::scene(&parameters, &placement, 1.0, &mut Seed::campaign(1).episode(0).stream("obstacles")).unwrap()
}

fn assert_same(a: &Isometry3<f64>, b: &Isometry3<f64>) {
    let off = a.inverse() * b;
    assert!(off.translation.vector.norm() < 1e-6, "{} m apart", off.translation.vector.norm());
    assert!(off.rotation.angle() < 1e-6, "{} rad apart", off.rotation.angle());
}

fn turned(axis: &nalgebra::Unit<Vector3<f64>>, angle: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(axis, angle))
}

/// The flange by modified (Craig) parameters (a, alpha, d) of joints 1 to 7 and the flange: Franka Control Interface
/// documentation, "Denavit-Hartenberg parameters". T = Rx(alpha) Tx(a) Rz(theta) Tz(d).
fn franka_flange(q: &[f64]) -> Isometry3<f64> {
    let rows = [
        (0.0, 0.0, 0.333),
        (0.0, -FRAC_PI_2, 0.0),
        (0.0, FRAC_PI_2, 0.316),
        (0.0825, FRAC_PI_2, 0.0),
        (-0.0825, -FRAC_PI_2, 0.384),
        (0.0, FRAC_PI_2, 0.0),
        (0.088, FRAC_PI_2, 0.0),
        (0.0, 0.0, 0.107),
    ];
    rows.into_iter().zip(q.iter().copied().chain([0.0])).fold(Isometry3::identity(), |frame, ((a, alpha, d), theta)| {
        frame
            * turned(&Vector3::x_axis(), alpha)
            * Isometry3::translation(a, 0.0, 0.0)
            * turned(&Vector3::z_axis(), theta)
            * Isometry3::translation(0.0, 0.0, d)
    })
}

/// The flange by standard parameters (a, alpha, d): Universal Robots, "DH parameters for calculations of kinematics and
/// dynamics", UR5e, with the base rotated by half a turn as in the ROS description. T = Rz(theta) Tz(d) Tx(a)
/// Rx(alpha).
fn ur5e_flange(q: &[f64]) -> Isometry3<f64> {
    let rows = [
        (0.0, FRAC_PI_2, 0.1625),
        (-0.425, 0.0, 0.0),
        (-0.3922, 0.0, 0.0),
        (0.0, FRAC_PI_2, 0.1333),
        (0.0, -FRAC_PI_2, 0.0997),
        (0.0, 0.0, 0.0996),
    ];
    let base = turned(&Vector3::z_axis(), std::f64::consts::PI);
    rows.into_iter().zip(q).fold(base, |frame, ((a, alpha, d), theta)| {
        frame
            * turned(&Vector3::z_axis(), *theta)
            * Isometry3::translation(a, 0.0, d)
            * turned(&Vector3::x_axis(), alpha)
    })
}

/// Checks the engine's chain, and its loaded scene, at random joint positions.
fn moves_as(on: EngineKind, robot: &str, flange: fn(&[f64]) -> Isometry3<f64>, tool: Isometry3<f64>) {
    let mut engine = on.robot(robot).engine();
    let scene = scene(on, robot, &[]);
    for index in 0..1000 {
        let mut stream = Seed::campaign(11).episode(index).stream("joints");
        let joints = &engine.chain().joints;
        let q: Vec<f64> = joints.iter().map(|joint| stream.between(joint.range[0], joint.range[1])).collect();
        assert_same(&engine.chain().flange_at(&q), &flange(&q));
        assert_same(&engine.chain().tcp_at(&q), &(flange(&q) * tool));
        if index < 50 {
            engine.load(&scene, &q).unwrap();
            assert_same(&engine.tcp(), &(flange(&q) * tool));
            assert!(engine.joint_positions().iter().zip(&q).all(|(there, q)| (there - q).abs() < 1e-9));
        }
    }
}

/// A box that crosses the workspace and stops in its middle.
fn crossing() -> [(&'static str, Value); 6] {
    [
        ("disturbance_speed_m_s", Value::Number(0.2)),
        ("disturbance_start_s", Value::Number(0.5)),
        ("disturbance_x_m", Value::Number(0.5)),
        ("disturbance_y_m", Value::Number(-0.4)),
        ("disturbance_heading_rad", Value::Number(FRAC_PI_2)),
        ("disturbance_travel_m", Value::Number(0.5)),
    ]
}

/// Checks that the engine returns the requested values.
fn is_read_back(on: EngineKind, robot: &str, parameters: &[(&str, Value)]) {
    let cell = on.robot(robot);
    let (mut simulator, _) = cell.bench(&cell.setup()).unwrap();
    let start = simulator.reset(&scenario(parameters)).unwrap();
    for (name, asked) in parameters {
        match (asked, start.applied.number(name)) {
            (Value::Number(asked), Some(got)) => assert!((asked - got).abs() < 1e-9, "{name}: {asked} became {got}"),
            _ => {
                let got = start.applied.iter().find(|(there, _)| **there == **name).map(|(_, value)| value.clone());
                assert_eq!(got.as_ref(), Some(asked), "{name}");
            }
        }
    }
}

of_every_engine! {
    fn franka_kinematics_match_data_sheet(on: EngineKind) {
        // The hand is rotated by -45 degrees about the flange's z axis; the tool centre point is 0.1034 m beyond it.
        let hand = Isometry3::translation(0.0, 0.0, 0.1034) * turned(&Vector3::z_axis(), -FRAC_PI_4);
        moves_as(on, "franka", franka_flange, hand);
    }

    fn ur5e_kinematics_match_data_sheet(on: EngineKind) {
        moves_as(on, "ur5e", ur5e_flange, Isometry3::translation(0.0, 0.0, 0.12));
    }

    fn holding_friction_follows_coulombs_law(on: EngineKind) {
        on.franka().confirm("coulomb", 36);
    }

    fn wide_object_is_never_picked(on: EngineKind) {
        on.franka().confirm("opening", on.episodes(28));
    }

    fn easy_region_is_easy(on: EngineKind) {
        on.franka().confirm("easy_region", on.episodes(140));
    }

    fn round_objects_stay_in_the_hand(on: EngineKind) {
        on.franka().confirm("no_creep", on.episodes(56));
    }

    fn half_time_step_changes_few_outcomes(on: EngineKind) {
        on.franka().confirm("time_step", on.episodes(200));
    }

    fn episodes_do_not_depend_on_order(on: EngineKind) {
        on.franka().confirm("repeatable", on.episodes(40));
    }

    fn joint_limits_are_kept(on: EngineKind) {
        on.franka().confirm("joint_limits", on.episodes(28));
    }

    fn position_jitter_reduces_success(on: EngineKind) {
        on.franka().confirm("position_jitter", on.episodes(28));
        on.ur5e().confirm("position_jitter", on.episodes(28));
    }

    /// Checks that an object at rest loads the cup with its weight m g, and bends the lip by m g times the lateral
    /// offset of its centre of mass. Lifted with acceleration a it pulls with m (g + a).
    fn cup_load_equals_object_weight(on: EngineKind) {
        let mut engine = on.ur5e().engine();
        for (mass, com_offset) in [(0.4, 0.0), (1.3, 0.0), (1.3, 0.3), (3.0, 0.2)] {
            let size = 0.06;
            let scene = scene(on, "ur5e", &[
                ("mass_kg", Value::Number(mass)),
                ("size_m", Value::Number(size)),
                ("com_offset", Value::Number(com_offset)),
                ("shape", Value::Category("box".into())),
            ]);
            let home = engine.robot().settings.arm.home_rad.clone();
            let mut at = engine.chain().tcp_at(&home);
            at.translation.vector = scene.object_pose.translation.vector + Vector3::new(0.0, 0.0, 0.5 * size + 0.001);
            let mut joints = engine.chain().inverse(&at, &home, &home).unwrap();
            engine.load(&scene, &joints).unwrap();
            engine.attach();
            // Half a second of rest, half a second of constant acceleration, half a second of braking, and rest.
            let acceleration = 0.8;
            let dt = engine.time_step();
            let height = |t: f64| {
                let (up, down) = (t.clamp(0.0, 0.5), (t - 0.5).clamp(0.0, 0.5));
                0.5 * acceleration * (up * up - down * down) + acceleration * 0.5 * down
            };
            let mut pulls = Vec::new();
            for k in 1..=(3.0 / dt).round() as usize {
                let time = k as f64 * dt;
                let mut goal = at;
                goal.translation.vector.z += height(time - 0.5);
                let next = engine.chain().inverse(&goal, &joints, &home).unwrap();
                let velocities = next.iter().zip(&joints).map(|(next, last)| (next - last) / dt).collect();
                joints.clone_from(&next);
                engine.advance(&JointTargets { positions: next, velocities, finger: 0.0 });
                pulls.push((time, engine.cup_load().unwrap()));
            }
            engine.health().unwrap();
            let mean = |from: f64, to: f64| {
                let of: Vec<_> = pulls.iter().filter(|(time, _)| (from..to).contains(time)).map(|(_, load)| load).collect();
                let n = of.len() as f64;
                (of.iter().map(|load| load.force).sum::<Vector3<f64>>() / n,
                 of.iter().map(|load| load.torque).sum::<Vector3<f64>>() / n)
            };
            let (still, bent) = mean(2.5, 3.0);
            let (lifted, _) = mean(0.65, 0.95);
            let [weight, heavier] = [mass * 9.81, mass * (9.81 + acceleration)];
            let lever = (engine.object().rotation * scene.object.mass.centre).xy().norm();
            println!("{on:?} {mass} kg: still {:.4} of m g, lifted {:.4} of m (g + a), bent by {:.4} N m of {:.4}",
                -still.z / weight, -lifted.z / heavier, bent.norm(), weight * lever);
            assert!((-still.z / weight - 1.0).abs() < 0.002 && still.xy().norm() < 0.01 * weight, "{still}");
            assert!((-lifted.z / heavier - 1.0).abs() < 0.01, "{lifted}");
            assert!((bent.norm() - weight * lever).abs() < 0.01 * weight * size, "{bent}");
        }
    }

    /// Presses the cup on a heavy box, from the relaxed cup to beyond its stroke. Checks that the force of the contact is
    /// stiffness x travel within the stroke, with the travel measured between arm and lip, and that the cup is rigid beyond.
    fn cup_presses_with_spring_force(on: EngineKind) {
        let cell = on.ur5e();
        let bellows = cell.robot.settings.gripper.cup().and_then(|cup| cup.bellows).unwrap();
        let full = bellows.stiffness_n_m * bellows.stroke_m;
        let mut engine = cell.engine();
        let size = 0.06;
        let values = [("mass_kg", 3.0), ("size_m", size)].map(|(name, value)| (name, Value::Number(value)));
        let scene = scene(on, "ur5e", &[values.to_vec(), vec![("shape", Value::Category("box".into()))]].concat());
        let home = engine.robot().settings.arm.home_rad.clone();
        let mut top = engine.chain().tcp_at(&home);
        top.translation.vector = scene.object_pose.translation.vector + Vector3::new(0.0, 0.0, 0.5 * size);
        let above = engine.chain().inverse(&(Translation3::new(0.0, 0.0, 0.005) * top), &home, &home).unwrap();
        engine.load(&scene, &above).unwrap();
        let dt = engine.time_step();
        let mut joints = above;
        // Way of the tool beyond the first contact, from -5 mm, at 10 mm/s.
        let mut measured = Vec::new();
        for k in 0..=(0.022 / 0.01 / dt) as usize {
            let deep = -0.005 + 0.01 * k as f64 * dt;
            let next = engine.chain().inverse(&(Translation3::new(0.0, 0.0, -deep) * top), &joints, &home).unwrap();
            let velocities = next.iter().zip(&joints).map(|(next, last)| (next - last) / dt).collect();
            joints.clone_from(&next);
            engine.advance(&JointTargets { positions: next, velocities, finger: 0.0 });
            let relaxed = engine.chain().tcp_at(&engine.joint_positions());
            let travel = (relaxed.inverse() * engine.tcp()).translation.vector;
            // MuJoCo's poses are those of the beginning of its last step.
            assert!(travel.xy().norm() < 5e-5 && (travel.z + engine.cup_travel()).abs() < 5e-5, "{travel}");
            measured.push((deep, -travel.z, engine.touches().peak_force.unwrap_or(0.0)));
        }
        engine.health().unwrap();
        let of = |from: f64, to: f64| measured.iter().filter(move |(_, travel, _)| (from..to).contains(travel));
        for percent in [20, 40, 60, 80] {
            let at = bellows.stroke_m * f64::from(percent) / 100.0;
            let near: Vec<_> = of(at - 2e-4, at + 2e-4).collect();
            let mean = |value: fn(&(f64, f64, f64)) -> f64| near.iter().map(|m| value(m)).sum::<f64>() / near.len() as f64;
            let (travel, force) = (mean(|m| m.1), mean(|m| m.2));
            println!("{on:?} {percent} %: {:.3} mm, {force:.2} N of {:.2} N", 1e3 * travel, bellows.stiffness_n_m * travel);
            assert!((force / (bellows.stiffness_n_m * travel) - 1.0).abs() < 0.05, "{on:?} {percent} %: {force} N");
        }
        let (deep, travel, force) = measured[measured.len() - 1];
        println!("{on:?} {:.1} mm deep: {:.3} mm, {force:.1} N", 1e3 * deep, 1e3 * travel);
        assert!(travel < bellows.stroke_m + 2e-4 && force > 1.5 * full, "{on:?}: {travel} m, {force} N");
        let free = measured.iter().filter(|(deep, ..)| *deep < -1e-3);
        assert!(free.clone().count() > 100 && free.clone().all(|(_, travel, force)| *travel < 1e-4 && *force <= 0.0));
    }

    /// Pressed down by a tool that is too low, the cup presses with its spring instead of the arm's servos.
    fn low_tool_presses_with_the_spring(on: EngineKind) {
        let cell = on.ur5e();
        let rigid = |setup: Setup| {
            let mut setup = setup;
            if let Gripper::Suction(cup) = &mut setup.robot.settings.gripper {
                cup.bellows = None;
            }
            setup
        };
        let press = |setup: Setup| {
            let (mut simulator, mut policy) = cell.bench(&setup).unwrap();
            let mut peaks = Vec::new();
            for index in 0..on.episodes(24) as u64 {
                let values = [("ik_noise_rad", Value::Number(0.012)), ("size_m", Value::Number(0.05))];
                let scenario = Scenario { index, seed: Seed::campaign(1).episode(index), ..scenario(&values) };
                let episode = rollout(&mut *simulator, &mut *policy, &scenario);
                peaks.push(episode.measures.get("peak_contact_force_n").unwrap_or(0.0));
            }
            peaks.sort_by(f64::total_cmp);
            peaks
        };
        let (soft, hard) = (press(cell.setup()), press(rigid(cell.setup())));
        println!("{on:?} peak forces with spring {soft:.0?} N, without {hard:.0?} N");
        let largest = |forces: &[f64]| forces.last().copied().unwrap_or_default();
        assert!(largest(&soft) < 0.5 * largest(&hard));
    }

    fn vacuum_cup_lifts_up_to_its_force(on: EngineKind) {
        on.ur5e().confirm("vacuum_limit", 0);
    }

    fn lifted_mass_grows_with_cup_area(on: EngineKind) {
        on.ur5e().confirm("cup_area", 0);
    }

    fn lifted_mass_falls_with_gravity(on: EngineKind) {
        on.ur5e().confirm("gravity", 0);
    }

    fn surface_gripper_never_reports_grip_loss(on: EngineKind) {
        on.ur5e().confirm("surface_keeps", on.episodes(80));
    }

    fn easy_region_is_easy_for_cup(on: EngineKind) {
        on.ur5e().confirm("easy_region", on.episodes(56));
    }

    fn cup_episodes_do_not_depend_on_order(on: EngineKind) {
        on.ur5e().confirm("repeatable", on.episodes(30));
    }

    fn ur3e_reaches_its_own_workspace(on: EngineKind) {
        let cell = on.robot("ur3e");
        let (mut simulator, mut policy) = cell.bench(&cell.setup()).unwrap();
        for (i, name) in Placement::NAMES.iter().enumerate().take(on.episodes(14)) {
            let values = [("placement", Value::Category((*name).into())), ("obstacles", Value::Integer(i as i64 % 4))];
            let episode = rollout(&mut *simulator, &mut *policy, &scenario(&values));
            assert_eq!(episode.outcome, Outcome::Success, "{name}");
            assert_eq!(episode.applied, episode.scenario.requested, "{name}");
        }
    }

    /// In the paper's workspace, the target and all placements except the near ones are beyond the reach of a UR3e, 0.5 m.
    fn ur3e_times_out_beyond_reach(on: EngineKind) {
        let cell = on.robot("ur3e");
        let setup = Setup { settings: [("workspace".into(), Value::Category("paper".into()))].into_iter().collect(), ..cell.setup() };
        let (mut simulator, mut policy) = cell.bench(&setup).unwrap();
        for name in ["edge_0", "edge_90", "left_0"] {
            let [x, y] = Placement::from_name(name).unwrap().position;
            assert!(x.hypot(y) > cell.robot.settings.arm.reach_m, "{name}");
            let scenario = scenario(&[("placement", Value::Category(name.into()))]);
            let episode = rollout(&mut *simulator, &mut *policy, &scenario);
            assert_eq!(episode.outcome, Outcome::Failure(FailureMode::TIMEOUT), "{name}");
            assert_eq!(episode.measures.get("slip_m"), None, "{name} was held");
        }
    }

    fn requested_values_are_read_back(on: EngineKind) {
        for shape in Shape::ALL {
            is_read_back(on, "franka", &[
                ("friction", Value::Number(0.7)),
                ("mass_kg", Value::Number(0.9)),
                ("com_offset", Value::Number(0.2)),
                ("size_m", Value::Number(0.045)),
                ("shape", Value::Category(shape.as_str().into())),
                ("obstacles", Value::Integer(4)),
                ("occluders", Value::Integer(2)),
                ("placement", Value::Category("left_45".into())),
            ]);
        }
        let parameters = [("gravity_scale", 0.38), ("table_friction", 0.2), ("friction", 0.9), ("position_jitter_m", 0.03)];
        is_read_back(on, "ur5e", &parameters.map(|(name, value)| (name, Value::Number(value))));
        is_read_back(on, "franka", &crossing());
    }

    fn moving_fixture_follows_path(on: EngineKind) {
        let mut engine = on.franka().engine();
        let scene = scene(on, "franka", &crossing());
        let home = engine.robot().settings.arm.home_rad.clone();
        engine.load(&scene, &home).unwrap();
        let moving = engine.read_back().unwrap().fixtures.iter().filter(|fixture| fixture.motion.is_some()).count();
        assert_eq!(moving, 1);
        let targets = JointTargets { positions: home.clone(), velocities: vec![0.0; home.len()], finger: 0.04 };
        let mover = scene.fixtures.iter().position(|fixture| fixture.kind == FixtureKind::Disturbance).unwrap();
        let start = engine.object().translation.vector;
        let mut pushed_at = None;
        let dt = engine.time_step();
        for step in 1..=(4.0 / dt).round() as usize {
            engine.advance(&targets);
            let time = step as f64 * dt;
            let path = 0.2 * (time.clamp(0.5, 3.0) - 0.5);
            let at = engine.fixture(mover).translation.vector;
            assert!((at.xy() - Vector3::new(0.5, -0.4 + path, 0.0).xy()).norm() < 1e-9, "{time}: {at}");
            if (engine.object().translation.vector - start).norm() > 1e-3 {
                pushed_at.get_or_insert(time);
            }
        }
        // Faces meet when the box has moved 0.4 m less half of each box: 0.345 m, 1.725 s after the start at 0.5 s.
        let pushed_at = pushed_at.unwrap();
        assert!((2.2..2.3).contains(&pushed_at), "{pushed_at}");
        // When it stops, its face is at y = 0.13, and the object's centre is half its edge beyond.
        let end = engine.object().translation.vector;
        assert!((end.y - 0.155).abs() < 0.004 && (end.x - start.x).abs() < 0.01, "{end}");
        engine.health().unwrap();
    }

    /// Checks that a box sliding on the table after a push decelerates by mu g, with the table's coefficient mu.
    fn table_friction_stops_object(on: EngineKind) {
        for (friction, table_friction) in [(0.9, 0.2), (0.1, 0.2)] {
            let mut engine = on.franka().engine();
            let mut parameters = crossing().to_vec();
            parameters[0].1 = Value::Number(0.8);
            parameters.push(("friction", Value::Number(friction)));
            parameters.push(("table_friction", Value::Number(table_friction)));
            let scene = scene(on, "franka", &parameters);
            let home = engine.robot().settings.arm.home_rad.clone();
            engine.load(&scene, &home).unwrap();
            let targets = JointTargets { positions: home.clone(), velocities: vec![0.0; home.len()], finger: 0.04 };
            let dt = engine.time_step();
            let mut sliding = Vec::new();
            for step in 1..=(4.0 / dt).round() as usize {
                engine.advance(&targets);
                // The pusher stops after 0.5 s of waiting and a path of 0.5 m.
                let (time, speed) = (step as f64 * dt, engine.object_velocity().0.norm());
                if time > 0.5 + 0.5 / 0.8 + 0.01 && speed > 0.1 {
                    sliding.push((time, speed));
                }
            }
            let [(t1, v1), (t2, v2)] = [sliding[0], sliding[sliding.len() - 1]];
            let (deceleration, law) = ((v1 - v2) / (t2 - t1), table_friction * 9.81);
            println!("{on:?} {friction}, {table_friction} on the table: {deceleration:.3} m/s^2 of {law:.3} m/s^2");
            assert!((deceleration / law - 1.0).abs() < 0.03, "{on:?}: {deceleration} of {law} m/s^2");
        }
    }

    /// One round of the 68 scenarios.
    fn industrial_suite_is_solved(on: EngineKind) {
        let suite = Suite::from_toml(include_str!("../../../assets/suites/industrial-68.toml")).unwrap();
        let cell = on.franka();
        let (mut simulator, mut policy) = cell.bench(&cell.setup()).unwrap();
        let failed: Vec<_> = (0..68)
            .map(|i| rollout(&mut *simulator, &mut *policy, &suite.scenario(Seed::campaign(2026), i)))
            .filter(|episode| episode.outcome != Outcome::Success)
            .map(|e| (suite.case(e.scenario.index).id.clone(), e.outcome, e.phase, e.time_s, e.contact))
            .collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }
}

#[test]
fn parameter_of_other_gripper_is_rejected() {
    let gripper = |robot| built_in_robot(robot).unwrap().settings.gripper;
    PickPlace::DEFAULT.parameters().check_space(&space("ur-wide"), Some(&gripper("ur5e"))).unwrap();
    let error = PickPlace::DEFAULT.parameters().check_space(&space("ur"), Some(&gripper("franka"))).unwrap_err();
    assert!(error.contains("grip_threshold_m") && error.contains("parallel jaw"), "{error}");
}
