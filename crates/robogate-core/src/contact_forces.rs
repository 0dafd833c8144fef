//! Contact forces by region of the robot, and the measures that record them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Measures, Word};

/// A region of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// The links of the arm, up to the one that the last joint moves.
    Arm,
    /// The parts after the last joint of the arm, without the fingers. A suction cup belongs to it.
    Hand,
    /// Everything that a joint of the gripper moves.
    Fingers,
}

/// What a region of the robot touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Touched {
    /// A body that moves freely or on a joint.
    Part,
    /// The table, an obstacle, another fixture, or the robot itself.
    Surroundings,
}

impl Region {
    /// All regions, from the base to the tool.
    pub const ALL: [Self; 3] = [Self::Arm, Self::Hand, Self::Fingers];

    /// The name in files and measures.
    pub fn as_str(self) -> &'static str {
        ["arm", "hand", "fingers"][self as usize]
    }
}

impl Touched {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Part, Self::Surroundings];

    /// The name in files and measures.
    pub fn as_str(self) -> &'static str {
        ["part", "surroundings"][self as usize]
    }
}

/// The largest normal force (N) of each region on one thing: the sum of its bodies as a vector, or the force of one of them if that is
/// larger. `None` without a contact.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RegionForces([[Option<f64>; 2]; 3]);

impl RegionForces {
    /// The force of a region on what it touches.
    pub fn get(&self, region: Region, touched: Touched) -> Option<f64> {
        self.0[region as usize][touched as usize]
    }

    /// Raises a force to `force`, if that is larger.
    pub fn raise(&mut self, region: Region, touched: Touched, force: f64) {
        let known = &mut self.0[region as usize][touched as usize];
        *known = Some(known.map_or(force, |known| known.max(force)));
    }
}

/// The largest contact force on the robot, in newtons.
pub const PEAK_CONTACT_FORCE: Word = Word::constant("peak_contact_force_n");
/// Duration that separates both kinds of contact, in seconds.
pub const QUASI_STATIC_S: f64 = 0.5;

/// How long a contact force acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Contacting {
    /// An impact: the largest force at any time.
    Transient,
    /// Clamping or pressing: the largest mean force over [`QUASI_STATIC_S`].
    QuasiStatic,
}

impl Contacting {
    /// Both of them.
    pub const ALL: [Self; 2] = [Self::Transient, Self::QuasiStatic];

    /// The name in texts.
    pub fn as_str(self) -> &'static str {
        ["transient", "quasi-static"][self as usize]
    }

    /// The measure of a region's force on what it touches, in newtons.
    pub const fn measure(self, region: Region, touched: Touched) -> Word {
        MEASURES[self as usize][region as usize][touched as usize]
    }

    /// The force (N) of a region on what it touches in an episode. `None` if they did not touch, or the environment does not
    /// record it.
    pub fn force(self, measures: &Measures, region: Region, touched: Touched) -> Option<f64> {
        measures.get(self.measure(region, touched).as_str()).filter(|force| force.is_finite())
    }
}

/// Every region with everything that it may touch.
pub fn region_pairs() -> impl Iterator<Item = (Region, Touched)> {
    Region::ALL.into_iter().flat_map(|region| Touched::ALL.map(|touched| (region, touched)))
}

/// The measures by kind of contact, region and what is touched.
const MEASURES: [[[Word; 2]; 3]; 2] = [
    [
        [Word::constant("peak_force_arm_part_n"), Word::constant("peak_force_arm_surroundings_n")],
        [Word::constant("peak_force_hand_part_n"), Word::constant("peak_force_hand_surroundings_n")],
        [Word::constant("peak_force_fingers_part_n"), Word::constant("peak_force_fingers_surroundings_n")],
    ],
    [
        [Word::constant("held_force_arm_part_n"), Word::constant("held_force_arm_surroundings_n")],
        [Word::constant("held_force_hand_part_n"), Word::constant("held_force_hand_surroundings_n")],
        [Word::constant("held_force_fingers_part_n"), Word::constant("held_force_fingers_surroundings_n")],
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measures_are_named_by_region() {
        for (region, touched) in region_pairs() {
            for (kind, word) in Contacting::ALL.into_iter().zip(["peak", "held"]) {
                let name = format!("{word}_force_{}_{}_n", region.as_str(), touched.as_str());
                assert_eq!(kind.measure(region, touched).as_str(), name);
            }
        }
    }

    #[test]
    fn the_larger_force_is_kept() {
        let mut forces = RegionForces::default();
        forces.raise(Region::Hand, Touched::Part, 3.0);
        forces.raise(Region::Hand, Touched::Part, 2.0);
        assert_eq!(forces.get(Region::Hand, Touched::Part), Some(3.0));
        assert_eq!(forces.get(Region::Arm, Touched::Part), None);
    }
}
