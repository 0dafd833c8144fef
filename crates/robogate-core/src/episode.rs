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

impl Episode {
    /// Whether this episode is the recorded one, bit for bit. Draws that the record lacks are not compared: an earlier
    /// version may not have declared them.
    pub fn repeats(&self, recorded: &Self) -> bool {
        let same_draws = recorded.draws.iter().all(|(name, value)| self.draws.get(name.as_str()) == Some(value));
        same_draws && *self == Self { draws: self.draws.clone(), ..recorded.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    #[test]
    fn draws_that_a_record_lacks_are_not_compared() {
        let episode = |draws: &[(Word, f64)]| Episode {
            scenario: Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() },
            applied: Assignment::default(),
            outcome: Outcome::Success,
            time_s: 1.0,
            phase: None,
            contact: None,
            measures: Measures::default(),
            draws: draws.iter().map(|(name, value)| (*name, Some(*value))).collect(),
            ticks: 20,
            trajectory_hash: 5,
        };
        let (bias, latency) = (Word::constant("bias"), Word::constant("latency"));
        let now = episode(&[(bias, 0.5), (latency, 0.1)]);
        for recorded in [episode(&[]), episode(&[(bias, 0.5)]), now.clone()] {
            assert!(now.repeats(&recorded), "{recorded:?}");
        }
        assert!(!now.repeats(&episode(&[(bias, 0.4)])));
        assert!(!episode(&[(bias, 0.5)]).repeats(&now));
        assert!(!now.repeats(&Episode { trajectory_hash: 6, ..now.clone() }));
    }
}
