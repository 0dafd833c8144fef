//! Whether the gains of a model are those of an arm that holds a part.

use mujoco_rs::prelude::*;

use crate::Chain;

/// Force at the tool, in newtons: about the weight of a part of 0.5 kg.
const LOAD_N: f64 = 5.0;
/// Speed of a joint on its path, in rad/s.
const SPEED_RAD_S: f64 = 0.5;
/// The tool gives way by at most this, in metres ...
pub(super) const GIVES_M: f64 = 5e-3;
/// ... and a joint by this, in radians.
const GIVES_RAD: f64 = 0.02;

/// Torque that moves a joint alone at its usual speed and this acceleration (rad/s^2), in N m: dry friction, damping, and the inertia of its motor.
pub(super) fn drag(model: &MjModel, joint: usize, acceleration: f64) -> f64 {
    let dof = model.jnt_dofadr()[joint] as usize;
    model.dof_frictionloss()[dof] + SPEED_RAD_S * model.dof_damping()[dof] + acceleration * model.dof_armature()[dof]
}

/// Which joints have a gain that is too soft, by stiffness (N m/rad) and damping, and by their drag (N m). An arm with such a joint sags under its
/// load and lags behind its path by centimetres. Models whose gains were chosen for learning have them, their robots do not.
pub(super) fn soft(chain: &Chain, home: &[f64], gains: &[Option<[f64; 2]>], drags: &[f64]) -> Vec<bool> {
    const TURN_RAD: f64 = 1e-3;
    let at_home = chain.tcp_at(home).translation.vector;
    let lever = |joint: usize| {
        let mut turned = home.to_vec();
        turned[joint] += TURN_RAD;
        (chain.tcp_at(&turned).translation.vector - at_home).norm() / TURN_RAD
    };
    let gives = |(joint, (gains, drag)): (usize, (&Option<[f64; 2]>, &f64))| {
        let lever = lever(joint);
        gains.is_some_and(|[stiffness, _]| {
            let off = (LOAD_N * lever + drag) / stiffness;
            off > GIVES_RAD || off * lever > GIVES_M
        })
    };
    gains.iter().zip(drags).enumerate().map(gives).collect()
}
