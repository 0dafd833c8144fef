//! Seeks a home posture for a drafted robot: the tool points down over the workspace, and the elbow is up.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robogate_core::Seed;

use super::{HOME_MARGIN, SHOULDER};
use crate::{Chain, RobotSettings};

/// Random postures among which a home posture is sought.
const POSTURES: usize = 20_000;
/// Rotations of a model about the vertical, among which a home posture is sought, in radians.
pub(super) const BASE_YAWS: [f64; 4] =
    [0.0, std::f64::consts::PI, std::f64::consts::FRAC_PI_2, -std::f64::consts::FRAC_PI_2];
/// Where the tool of a short arm waits, as shares of distance and height of that place: wrists with small ranges point down near the
/// table and the base only.
const NEARER_HOMES: [[f64; 2]; 6] = [[1.0, 1.0], [1.0, 0.75], [1.0, 0.5], [0.75, 0.75], [0.75, 0.5], [0.6, 0.4]];
/// Where the tool waits at home, in metres from the base: over the middle of the workspace.
const HOME_TOOL: [f64; 3] = [0.45, 0.0, 0.30];
/// Reach of an arm with which the tool waits there, in metres. Shorter arms wait nearer to the base.
const FULL_REACH: f64 = 0.75;
/// At home the tool may point this far off straight down, in radians.
const HOME_TILT: f64 = 0.3;

/// The first home posture over the workspace that is accepted. Short arms wait nearer to the base.
pub(super) fn home_of(
    chain: &Chain,
    stated: Option<&[f64]>,
    accepted: &mut dyn FnMut(&[f64]) -> bool,
) -> Option<Vec<f64>> {
    let near = (crate::inspect::reach(chain)[0] / FULL_REACH).min(1.0);
    let mut at = |scale: f64, [far, high]: [f64; 2]| {
        let [x, y, z] = HOME_TOOL.map(|x| scale * x);
        let tool = [far * x, y, high * z];
        let turned = stated.and_then(|home| turned_home(chain, home, tool)).filter(|home| accepted(home));
        turned.or_else(|| sought_home(chain, tool, accepted))
    };
    let full = at(1.0, [1.0; 2]);
    if full.is_some() || near >= 1.0 {
        return full;
    }
    NEARER_HOMES.into_iter().find_map(|share| at(near, share))
}

/// Whether the first joint turns by a full rotation.
pub(super) fn turns_fully(chain: &Chain) -> bool {
    chain.joints.first().is_none_or(|first| first.range[1] - first.range[0] >= std::f64::consts::TAU)
}

/// Whether the tool points down, in front of the base.
pub(super) fn is_over_workspace(chain: &Chain, home: &[f64]) -> bool {
    let tcp = chain.tcp_at(home);
    let at = tcp.translation;
    (tcp.rotation * Vector3::z()).z < -HOME_TILT.cos() && at.x > at.y.abs()
}

/// Pose of a tool that waits over the workspace, with its x axis nearest to that of `tcp`.
fn waiting(tcp: &Isometry3<f64>, tool: [f64; 3]) -> Isometry3<f64> {
    let x = tcp.rotation * Vector3::x();
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), x.y.atan2(x.x));
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Translation3::from(Vector3::from(tool)), yaw * down)
}

/// Whether these positions keep a distance from the ends of the ranges.
fn is_inside(chain: &Chain, home: &[f64]) -> bool {
    let inside = |(q, joint): (&f64, &crate::ChainJoint)| {
        (joint.range[0] + HOME_MARGIN..=joint.range[1] - HOME_MARGIN).contains(q)
    };
    home.iter().zip(&chain.joints).all(inside)
}

/// A posture like the model's, with the first joint turned so that the tool is over the workspace.
fn turned_home(chain: &Chain, stated: &[f64], tool: [f64; 3]) -> Option<Vec<f64>> {
    let mut turned = stated.to_vec();
    let at = chain.tcp_at(stated).translation;
    let first = chain.joints.first()?;
    let turn = at.y.atan2(at.x) * (first.placement.rotation * first.axis).z.signum();
    let turns = [0.0, -std::f64::consts::TAU, std::f64::consts::TAU].map(|whole| stated[0] - turn + whole);
    turned[0] = turns.into_iter().min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let home = chain.reach(&waiting(&chain.tcp_at(&turned), tool), &turned).ok()?;
    is_inside(chain, &home).then_some(home)
}

/// Rotates a model whose first joint is far from the middle of its range at home by quarters, so that the arm reaches as far to both sides.
pub(super) fn face_the_table(chain: &Chain, settings: &mut RobotSettings) {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    let Some(first) = chain.joints.first() else { return };
    let upwards = (first.placement.rotation * first.axis).z;
    let [low, high] = first.range;
    let turn = (settings.arm.home_rad[0] - 0.5 * (low + high)) * upwards.signum();
    if upwards.abs() > HOME_TILT.cos() && !turns_fully(chain) && turn.abs() > FRAC_PI_4 {
        let yaw = (turn / FRAC_PI_2).round() * FRAC_PI_2;
        settings.arm.base_yaw_rad += yaw;
        settings.arm.home_rad[0] -= yaw * upwards.signum();
    }
}

/// Height of the lowest joint behind the shoulder, in metres.
fn lowest_m(chain: &Chain, positions: &[f64]) -> f64 {
    let mut at = Isometry3::identity();
    let mut lowest = f64::INFINITY;
    for (i, (joint, q)) in chain.joints.iter().zip(positions).enumerate() {
        at *= joint.placement;
        if i >= SHOULDER {
            lowest = lowest.min(at.translation.z);
        }
        at *= UnitQuaternion::from_axis_angle(&joint.axis, *q);
    }
    lowest
}

/// A posture with the tool pointing down over the workspace, the elbow up, away from the ends of the ranges.
fn sought_home(chain: &Chain, tool: [f64; 3], accepted: &mut dyn FnMut(&[f64]) -> bool) -> Option<Vec<f64>> {
    let mut stream = Seed::campaign(0).stream("home posture");
    let goal = Vector3::from(tool);
    let mut best: Vec<(f64, Vec<f64>)> = Vec::new();
    for _ in 0..POSTURES {
        let q: Vec<f64> = chain.joints.iter().map(|joint| stream.between(joint.range[0], joint.range[1])).collect();
        let tcp = chain.tcp_at(&q);
        let down = 1.0 + (tcp.rotation * Vector3::z()).z;
        let turn: f64 = q.iter().map(|q| q.abs()).sum();
        let sunk = (goal.z - lowest_m(chain, &q)).max(0.0);
        let score = (tcp.translation.vector - goal).norm() + 0.3 * down + 0.02 * turn + sunk;
        if best.len() < 40 || best.last().is_some_and(|(worst, _)| score < *worst) {
            best.push((score, q));
            best.sort_by(|a, b| a.0.total_cmp(&b.0));
            best.truncate(40);
        }
    }
    best.into_iter().find_map(|(_, q)| {
        let home = chain.reach(&waiting(&chain.tcp_at(&q), tool), &q).ok()?;
        (is_inside(chain, &home) && accepted(&home)).then_some(home)
    })
}
