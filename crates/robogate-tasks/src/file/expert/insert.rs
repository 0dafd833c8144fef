//! Insertion by touch.

use nalgebra::{Isometry3, Translation3, Vector3};
use robogate_core::Word;
use robogate_physics::Unreachable;

use super::{Place, Plan, Value, heights};
use crate::arm::Fit;

/// Largest force of the search for a hole, in newtons.
const SEARCH_N: f64 = 5.0;
/// The range within which a hole catches a part, in metres, if the file states none.
const CATCH_M: f64 = 1e-3;

impl Plan<'_> {
    /// Brings the part in the hand by touch into a hole, without turning it.
    pub(super) fn insert(
        &mut self,
        phase: Word,
        place: &Place,
        [depth, force]: [f64; 2],
        catch: Option<&Value>,
    ) -> Result<(), Unreachable> {
        let end = self.cell.at(place, &self.frame(place.on)).translation.vector;
        let down = self.tool().rotation;
        let (offset, low) = self.in_hand.map_or((Vector3::zeros(), 0.0), |(of, in_tool)| {
            (down * in_tool.translation.vector, heights(self.cell.numbers.parts[of].shapes.iter())[0])
        });
        let goal = end - offset;
        let fit = Fit {
            clearance_m: catch.map_or(CATCH_M, |catch| self.number(catch)),
            chamfer_m: 0.0,
            hole: Vector3::new(goal.x, goal.y, end.z + low + depth),
            depth_m: depth,
            tool_m: goal.z - end.z - low,
            down,
            search_n: force.min(SEARCH_N),
            insert_n: force,
            stiffness: 1.0,
            coupled: true,
            slips: true,
        };
        let pose = Isometry3::from_parts(Translation3::from(goal), down);
        self.planner.feel(phase, pose, self.careful(None), self.gripper, fit)
    }
}
