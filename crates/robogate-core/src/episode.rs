//! The record of one closed-loop run.

use serde::{Deserialize, Serialize};

use crate::{Assignment, Measures, Outcome, Scenario, Word};

/// A contact between two bodies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// The robot's body.
    pub robot_body: String,
    /// The other body.
    pub other_body: String,
    /// Largest normal force within the control period of first touch, in newtons.
    pub force_n: f64,
}

/// One closed-loop run.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// The requested scenario.
    pub scenario: Scenario,
    /// The parameters read back from the environment; empty where the reset failed.
    pub applied: Assignment,
    /// How it ended.
    pub outcome: Outcome,
    /// When it was decided, in simulated seconds from the start.
    pub time_s: f64,
    /// The phase that the policy reported then.
    pub phase: Option<Word>,
    /// The contact that decided it.
    pub contact: Option<Contact>,
    /// What was measured.
    pub measures: Measures,
    /// Control ticks run.
    pub ticks: u32,
    /// Hash over the environment's state at every control tick: equal hashes, equal trajectories.
    pub trajectory_hash: u64,
}
