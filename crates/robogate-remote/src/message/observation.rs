//! Observations on the wire.

use std::collections::BTreeMap;

use robogate_core::{Observation, TaskSpec, vectors};
use serde::{Deserialize, Serialize};

/// An observation without images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObservationMessage {
    /// Simulated time since the start of the episode, in seconds.
    pub time_s: f64,
    /// The vectors that the task declares, by name.
    pub vectors: BTreeMap<String, Vec<f64>>,
}

impl From<&Observation> for ObservationMessage {
    fn from(observation: &Observation) -> Self {
        let vectors = observation.vectors.iter().map(|(name, numbers)| (name.to_string(), numbers.clone()));
        Self { time_s: observation.time_s, vectors: vectors.collect() }
    }
}

impl ObservationMessage {
    /// Check the vectors and the time, and convert to an observation.
    pub(crate) fn checked(mut self, task: &TaskSpec, time_s: f64) -> Result<Observation, String> {
        if (self.time_s - time_s).abs() > 1e-6 {
            return Err(format!("the observation has the time {} s; expected {time_s} s", self.time_s));
        }
        let declared = task.observation.vectors.iter();
        let vectors: Vec<_> =
            declared.filter_map(|spec| Some((spec.name, self.vectors.remove(spec.name.as_str())?))).collect();
        if let Some(name) = self.vectors.keys().next() {
            return Err(format!("the observation has a vector `{name}`, which the task does not declare"));
        }
        let observation = Observation { time_s, vectors, images: Vec::new() };
        task.check_observation(&observation)?;
        if let Some(&[.., w, x, y, z]) = observation.vector(vectors::TOOL_POSE.as_str()) {
            let squared = w * w + x * x + y * y + z * z;
            if (squared - 1.0).abs() > 2e-6 {
                return Err(format!(
                    "the orientation in tool_pose is {:?}, which is not a unit quaternion",
                    [w, x, y, z]
                ));
            }
        }
        Ok(observation)
    }
}
