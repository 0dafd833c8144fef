//! The record of one closed-loop run.

use serde::{Deserialize, Serialize};

use crate::{Assignment, Outcome, Phase, Scenario};

/// A touch between two bodies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The robot's body.
    pub robot_body: String,
    /// What it touched.
    pub other_body: String,
    /// Largest normal force within the control period of first touch, in newtons.
    pub force_n: f64,
}

/// Running measurements of an episode. `None` means that there was nothing to measure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Largest normal force between a body of the robot and anything, in newtons.
    pub peak_contact_force_n: Option<f64>,
    /// Largest displacement of the object relative to the hand since it was held, in metres.
    pub slip_m: Option<f64>,
    /// Smallest distance between the robot and anything that is not the object, in metres.
    pub min_clearance_m: Option<f64>,
    /// Horizontal distance of the object from its target, in metres.
    pub target_distance_m: Option<f64>,
}

/// One closed-loop run.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// What was asked for.
    pub scenario: Scenario,
    /// The parameters read back from the simulator; empty where it never got so far.
    pub applied: Assignment,
    /// How it went.
    pub outcome: Outcome,
    /// When it was decided, in simulated seconds from the start.
    pub time_s: f64,
    /// What the policy said it was doing then.
    pub phase: Option<Phase>,
    /// The contact that decided it.
    pub contact: Option<Contact>,
    /// What was measured on the way.
    pub measures: Measures,
    /// Control ticks run.
    pub ticks: u32,
    /// Hash over the simulator's state at every control tick: equal hashes, equal trajectories.
    pub trajectory_hash: u64,
}
