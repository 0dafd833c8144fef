//! The physics claims, with as many episodes as a test run has patience for; `robogate check physics`
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and its figures are worth reading"
)]
//! runs the same ones at full length.

mod common;

use std::sync::Arc;

use common::{franka, robot};
use robogate_core::{Assignment, FailureMode, Outcome, ParameterSpace, Scenario, Seed, Value, rollout};
use robogate_sim::built_in_space;
use robogate_sim::claims::{self, Finding, Workbench};
use robogate_sim::{Placement, SceneParameters};

fn confirm(finding: Result<Finding, String>) {
    let finding = finding.unwrap();
    println!("{}\n  {}", finding.claim, finding.figures.join("\n  "));
    assert!(finding.holds, "{finding:#?}");
}

fn space(name: &str) -> Arc<ParameterSpace> {
    Arc::new(ParameterSpace::from_toml(built_in_space(name).unwrap()).unwrap())
}

#[test]
fn the_lowest_friction_that_holds_is_coulombs() {
    confirm(claims::coulomb(&franka()));
}

#[test]
fn an_object_wider_than_the_opening_is_never_picked() {
    confirm(claims::opening(&franka(), 28));
}

#[test]
fn the_easy_region_is_easy() {
    confirm(claims::easy_region(&franka(), 140));
}

#[test]
fn halving_the_time_step_changes_few_outcomes() {
    confirm(claims::time_step(&franka(), &space("franka"), 500));
}

#[test]
fn an_episode_has_the_same_bits_in_any_order() {
    confirm(claims::repeatable(&franka(), &space("franka"), 40));
}

#[test]
fn joint_limits_are_kept() {
    confirm(claims::joint_limits(&franka(), 28));
}

#[test]
fn a_vacuum_cup_lifts_what_its_pressure_and_area_allow() {
    confirm(claims::vacuum_limit(&robot("ur5e")));
}

#[test]
fn doubling_the_cups_area_doubles_the_mass_it_holds() {
    confirm(claims::cup_area(&robot("ur5e")));
}

#[test]
fn doubling_gravity_halves_the_mass_a_cup_holds_but_for_the_lifts_own_acceleration() {
    confirm(claims::gravity(&robot("ur5e")));
}

#[test]
fn a_surface_gripper_never_reports_grip_loss() {
    confirm(claims::surface_keeps(&robot("ur5e"), &space("ur"), 80));
}

#[test]
fn an_object_off_its_placement_is_picked_less_often() {
    confirm(claims::position_jitter(&franka(), 28));
    confirm(claims::position_jitter(&robot("ur5e"), 28));
}

#[test]
fn the_easy_region_is_easy_for_a_cup() {
    confirm(claims::easy_region(&robot("ur5e"), 56));
}

#[test]
fn a_cups_episode_has_the_same_bits_in_any_order() {
    confirm(claims::repeatable(&robot("ur5e"), &space("ur-wide"), 30));
}

/// The target and every placement but those on the near side lie beyond a UR3e's half metre.
#[test]
fn a_ur3e_cannot_reach_what_lies_beyond_its_reach() {
    let workbench = robot("ur3e");
    let (mut simulator, mut policy) = workbench.bench(&workbench.setup()).unwrap();
    let reach = workbench.setup().robot.settings.arm.reach_m;
    for name in ["edge_0", "edge_90", "left_0"] {
        let [x, y] = Placement::from_name(name).unwrap().position;
        assert!(x.hypot(y) > reach, "{name}");
        let mut requested = Assignment::default();
        requested.set("placement", Value::Category(name.into()));
        let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
        let episode = rollout(&mut *simulator, &mut *policy, &scenario);
        assert_eq!(episode.outcome, Outcome::Failure(FailureMode::Timeout), "{name}");
        assert_eq!(episode.measures.slip_m, None, "{name} was held");
    }
}

#[test]
fn a_parameter_that_the_gripper_does_not_have_is_refused_by_name() {
    let gripper = |workbench: common::InMujoco| workbench.setup().robot.settings.gripper;
    SceneParameters::check_space(&space("ur-wide"), Some(&gripper(robot("ur5e")))).unwrap();
    let error = SceneParameters::check_space(&space("ur"), Some(&gripper(franka()))).unwrap_err().to_string();
    assert!(error.contains("grip_threshold_m") && error.contains("parallel jaw"), "{error}");
}

/// A table that is slippery while the pads are not changes nothing but how the object stands; gravity, friction
/// and position come back from the engine as asked.
#[test]
fn what_was_asked_of_gravity_table_and_position_is_what_the_engine_holds() {
    let workbench = robot("ur5e");
    let (mut simulator, _) = workbench.bench(&workbench.setup()).unwrap();
    let mut requested = Assignment::default();
    for (name, value) in
        [("gravity_scale", 0.38), ("table_friction", 0.2), ("friction", 0.9), ("position_jitter_m", 0.03)]
    {
        requested.set(name, Value::Number(value));
    }
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
    let start = simulator.reset(&scenario).unwrap();
    for (name, wanted) in scenario.requested.iter() {
        let (Some(wanted), Some(got)) = (scenario.requested.number(name), start.applied.number(name)) else {
            panic!("{name} = {wanted} is not applied");
        };
        assert!((wanted - got).abs() < 1e-9, "{name}: {wanted} became {got}");
    }
}
