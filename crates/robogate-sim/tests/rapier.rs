//! The claims that MuJoCo is held to, held to Rapier.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and its figures are worth reading"
)]

mod common;

use std::sync::Arc;

use common::franka;
use robogate_core::ParameterSpace;
use robogate_sim::claims::{self, Finding};
use robogate_sim::{Engine, MujocoEngine, RapierEngine, built_in_robot, built_in_space};

fn confirm(finding: Result<Finding, String>) {
    let finding = finding.unwrap();
    println!("{}\n  {}", finding.claim, finding.figures.join("\n  "));
    assert!(finding.holds, "{finding:#?}");
}

fn space(name: &str) -> Arc<ParameterSpace> {
    Arc::new(ParameterSpace::from_toml(built_in_space(name).unwrap()).unwrap())
}

#[test]
fn the_robot_has_the_kinematics_that_mujoco_compiles() {
    let ours = RapierEngine::new(built_in_robot("franka").unwrap(), RapierEngine::TIME_STEP_S).unwrap();
    let theirs = MujocoEngine::new(built_in_robot("franka").unwrap(), MujocoEngine::TIME_STEP_S).unwrap();
    for k in 0..50 {
        let joints = theirs.chain().joints.iter().enumerate();
        let q: Vec<f64> = joints
            .map(|(j, joint)| {
                let share = (f64::from(k) * 0.618 + j as f64 * 0.414).fract();
                joint.range[0] + share * (joint.range[1] - joint.range[0])
            })
            .collect();
        for off in [
            ours.chain().tcp_at(&q).inverse() * theirs.chain().tcp_at(&q),
            ours.chain().flange_at(&q).inverse() * theirs.chain().flange_at(&q),
        ] {
            assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-7);
        }
    }
}

#[test]
fn the_lowest_friction_that_holds_is_coulombs() {
    confirm(claims::coulomb(&franka().in_rapier()));
}

#[test]
fn an_object_wider_than_the_opening_is_never_picked() {
    confirm(claims::opening(&franka().in_rapier(), 14));
}

#[test]
fn the_easy_region_is_easy() {
    confirm(claims::easy_region(&franka().in_rapier(), 70));
}

#[test]
fn halving_the_time_step_changes_few_outcomes() {
    confirm(claims::time_step(&franka().in_rapier(), &space("franka"), 50));
}

#[test]
fn an_episode_has_the_same_bits_in_any_order() {
    confirm(claims::repeatable(&franka().in_rapier(), &space("franka"), 20));
}

#[test]
fn joint_limits_are_kept() {
    confirm(claims::joint_limits(&franka().in_rapier(), 14));
}

#[test]
fn a_gripper_without_fingers_is_refused_by_name() {
    let error = RapierEngine::new(built_in_robot("ur5e").unwrap(), RapierEngine::TIME_STEP_S).err().unwrap();
    assert!(error.to_string().contains("suction"), "{error}");
}
