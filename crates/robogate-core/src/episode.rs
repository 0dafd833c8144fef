//! The record of one closed-loop episode.

use serde::{Deserialize, Serialize};

use crate::{Assignment, Measures, Outcome, Scenario, Word};

/// A contact between the robot and another body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The robot's body.
    pub robot_body: String,
    /// The other body.
    pub other_body: String,
    /// Largest normal force in newtons, within the control period of the first touch.
    pub force_n: f64,
}

/// The record of one closed-loop episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// The requested scenario.
    pub scenario: Scenario,
    /// The parameters read back from the environment. Empty if the reset failed.
    pub applied: Assignment,
    /// How the episode ended.
    pub outcome: Outcome,
    /// Simulated time of the decisive event, in seconds from the start.
    pub time_s: f64,
    /// The phase that the policy reported at that time.
    pub phase: Option<Word>,
    /// The contact that decided the outcome, if there was one.
    pub contact: Option<Contact>,
    /// The measured values.
    pub measures: Measures,
    /// The hidden draws, where the task knows them.
    pub draws: Measures,
    /// The number of control periods that ran.
    pub ticks: u32,
    /// Hash over the environment's state at every control period. Equal hashes mean equal trajectories.
    pub trajectory_hash: u64,
}
