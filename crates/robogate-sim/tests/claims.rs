//! The physics claims, with as many episodes as a test run has patience for; `robogate check physics`
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and its figures are worth reading"
)]
//! runs the same ones at full length.

mod common;

use std::sync::Arc;

use common::{franka, with_cup};
use robogate_core::ParameterSpace;
use robogate_sim::built_in_space;
use robogate_sim::claims::{self, Finding};

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
    confirm(claims::vacuum_limit(&with_cup()));
}

#[test]
fn doubling_the_cups_area_doubles_the_mass_it_holds() {
    confirm(claims::cup_area(&with_cup()));
}

#[test]
fn doubling_gravity_halves_the_mass_a_cup_holds_but_for_the_lifts_own_acceleration() {
    confirm(claims::gravity(&with_cup()));
}

#[test]
fn a_surface_gripper_never_reports_grip_loss() {
    confirm(claims::surface_keeps(&with_cup(), &space("ur"), 80));
}

#[test]
fn an_object_off_its_placement_is_picked_less_often() {
    confirm(claims::position_jitter(&franka(), 28));
    confirm(claims::position_jitter(&with_cup(), 28));
}

#[test]
fn the_easy_region_is_easy_for_a_cup() {
    confirm(claims::easy_region(&with_cup(), 56));
}

#[test]
fn a_cups_episode_has_the_same_bits_in_any_order() {
    confirm(claims::repeatable(&with_cup(), &space("ur-wide"), 30));
}
