//! Conditions that every policy needs: necessary conditions of geometry and statics, never those of one controller.

use robogate_core::Infeasibility;
use robogate_physics::{GRAVITY, Gripper, Robot, SuctionLaw};

/// What a gripper must carry.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Load {
    /// Smallest distance between two contacts that can hold the part, in metres. `None` without a useful bound.
    pub(crate) width_m: Option<f64>,
    /// Friction coefficient against the pads, if the part has vertical faces only. `None` if it may rest on the pads.
    pub(crate) friction: Option<f64>,
    /// Weight, in newtons.
    pub(crate) weight_n: f64,
    /// Force of the gripper as a multiple of the robot's setting.
    pub(crate) force_scale: f64,
}

fn reason(condition: &str, limit: String) -> Infeasibility {
    Infeasibility { condition: condition.to_owned(), limit }
}

/// The reason why the arm cannot bring its tool over this point (x, y, in metres), if it is farther from the base than the
/// arm's reach. A tool that points down is below the wrist.
pub(crate) fn out_of_reach(robot: &Robot, what: &str, [x, y]: [f64; 2], nearer_m: f64) -> Option<Infeasibility> {
    let reach_m = robot.settings.arm.reach_m;
    let far = x.hypot(y) - nearer_m > reach_m;
    far.then(|| reason(&format!("the {what} is out of the arm's reach"), format!("{reach_m:.2} m")))
}

/// The reason why the robot cannot carry this load. The pads of its hand press with `grip_force_n` each.
pub(crate) fn cannot_carry(
    robot: &Robot,
    load: &Load,
    grip_force_n: f64,
    suction: SuctionLaw,
) -> Option<Infeasibility> {
    let Load { width_m, friction, weight_n, force_scale } = *load;
    let payload_kg = robot.settings.arm.payload_kg;
    if weight_n > payload_kg * GRAVITY {
        return Some(reason("the part is heavier than the arm's payload", format!("{payload_kg} kg")));
    }
    match &robot.settings.gripper {
        Gripper::ParallelJaw(jaw) if width_m.is_some_and(|width| width > jaw.opening_m) => {
            Some(reason("the part is wider than the gripper opening", format!("{:.0} mm", 1e3 * jaw.opening_m)))
        }
        // Pads that press with F each on vertical faces carry at most 2 mu F (Coulomb).
        Gripper::ParallelJaw(_) => {
            let force_n = grip_force_n * force_scale;
            friction
                .is_some_and(|friction| weight_n > 2.0 * friction * force_n)
                .then(|| reason("the part is heavier than friction can carry", format!("{force_n:.0} N for each pad")))
        }
        // The vacuum of a cup carries at most its pressure times its area.
        Gripper::Suction(cup) => {
            let force_n = cup.force_n() * force_scale;
            (suction == SuctionLaw::Vacuum && weight_n > force_n)
                .then(|| reason("the part is heavier than the vacuum can carry", format!("{force_n:.0} N")))
        }
    }
}
