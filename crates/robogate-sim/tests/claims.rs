//! The physics claims, with as many episodes as a test run has patience for; `robogate check physics`
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and its figures are worth reading"
)]
//! runs the same ones at full length.

mod common;

use std::sync::Arc;

use common::franka;
use robogate_core::ParameterSpace;
use robogate_sim::FRANKA_SPACE;
use robogate_sim::claims::{self, Finding};

fn confirm(finding: Result<Finding, String>) {
    let finding = finding.unwrap();
    println!("{}\n  {}", finding.claim, finding.figures.join("\n  "));
    assert!(finding.holds, "{finding:#?}");
}

fn space() -> Arc<ParameterSpace> {
    Arc::new(ParameterSpace::from_toml(FRANKA_SPACE).unwrap())
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
    confirm(claims::time_step(&franka(), &space(), 500));
}

#[test]
fn an_episode_has_the_same_bits_in_any_order() {
    confirm(claims::repeatable(&franka(), &space(), 40));
}

#[test]
fn joint_limits_are_kept() {
    confirm(claims::joint_limits(&franka(), 28));
}
