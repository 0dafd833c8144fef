//! Whether the gains of a model are those of an arm that holds a part.

use crate::Chain;

/// Force at the tool, in newtons: about the weight of a part of 0.5 kg.
pub(super) const LOAD_N: f64 = 5.0;
/// Under that force the servo of a joint lets the tool give way by at most this, in metres.
pub(super) const GIVES_M: f64 = 5e-3;

/// Which joints have a gain that is too soft, by stiffness (N m/rad) and damping. An arm with such a joint sags under its load and lags behind its
/// path by centimetres. Models whose gains were chosen for learning have them, their robots do not.
pub(super) fn soft(chain: &Chain, home: &[f64], gains: &[Option<[f64; 2]>]) -> Vec<bool> {
    const TURN_RAD: f64 = 1e-3;
    let at_home = chain.tcp_at(home).translation.vector;
    let lever = |joint: usize| {
        let mut turned = home.to_vec();
        turned[joint] += TURN_RAD;
        (chain.tcp_at(&turned).translation.vector - at_home).norm() / TURN_RAD
    };
    let gives = |(joint, gains): (usize, &Option<[f64; 2]>)| {
        gains.is_some_and(|[stiffness, _]| LOAD_N * lever(joint).powi(2) > GIVES_M * stiffness)
    };
    gains.iter().enumerate().map(gives).collect()
}
