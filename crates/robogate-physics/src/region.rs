//! The region of the robot to which a body belongs.

use robogate_core::Region;

use crate::Gripper;

/// The region of a body of `link`, a set of bodies that do not move relative to each other. `last` is the link that the last joint
/// of the arm moves, and `parent` returns the link that carries another one. `is_wrist`: the body is the link's own, and carries
/// others that are the hand.
pub(crate) fn region(
    link: usize,
    is_wrist: bool,
    last: usize,
    parent: impl Fn(usize) -> Option<usize>,
    gripper: &Gripper,
) -> Region {
    if link == last {
        return if is_wrist { Region::Arm } else { Region::Hand };
    }
    let behind = std::iter::successors(parent(link), |link| parent(*link)).any(|link| link == last);
    match (behind, gripper) {
        (true, Gripper::ParallelJaw(_)) => Region::Fingers,
        (true, Gripper::Suction(_)) => Region::Hand,
        (false, _) => Region::Arm,
    }
}
