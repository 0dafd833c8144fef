//! The way of a tool that moves in small steps, from the plan of an expert.

use nalgebra::Vector3;
use robogate_physics::{Chain, Gripper, GripperCommand};

use crate::arm::{FINELY, FREELY, Stage, Way};

/// A tool with a part goes round a corner that is farther than this from the straight line, in metres.
const CORNER_M: f64 = 0.01;
/// Distance to the place of a part from which the tool goes finely, in metres.
const APPROACH_M: f64 = 0.01;

/// The way of the tool in a plan.
pub(super) fn way(stages: &[Stage], chain: &Chain, gripper: &Gripper) -> Way {
    let at = |joints: &Vec<f64>| chain.tcp_at(joints).translation.vector;
    let mut way = Way::for_square(gripper);
    for (stage, next) in stages.iter().zip(stages.iter().skip(1).map(Some).chain([None])) {
        let (phase, closed) = (stage.phase, stage.gripper == GripperCommand::Close);
        let (Some(from), Some(to)) = (stage.path.first().map(at), stage.path.last().map(at)) else { continue };
        if stage.settles {
            way.grip(phase, closed);
            continue;
        }
        let along = (to - from).try_normalize(1e-6).unwrap_or_else(Vector3::zeros);
        let off = |point: &Vector3<f64>| (point - from - along * (point - from).dot(&along)).norm();
        let corner = stage.path.iter().map(at).max_by(|a, b| off(a).total_cmp(&off(b)));
        if let Some(corner) = corner.filter(|corner| closed && off(corner) > CORNER_M) {
            way.go(phase, corner.into(), &FREELY, closed);
        }
        // The part is put down.
        let puts = closed && next.is_some_and(|next| next.settles && next.gripper == GripperCommand::Open);
        if puts {
            way.go(phase, (to + Vector3::new(0.0, 0.0, APPROACH_M)).into(), &FREELY, closed);
        }
        way.go(phase, to.into(), if puts { &FINELY } else { &FREELY }, closed);
    }
    way
}
