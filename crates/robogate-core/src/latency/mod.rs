//! Inference latency: what the robot does while a policy computes.
//!
//! Without this module the world waits for the policy, so a policy that takes one second is as good as one that takes
//! one millisecond. [`with_latency`] puts a latency between observation and actions, for any policy and any environment. Delays are
//! control periods of simulated time: a latency of 80 ms in control periods of 50 ms takes two of them. They come from
//! the seed of the episode and never from a clock, so episodes stay reproducible. Sampled latencies are hidden draws of the
//! episode.

mod adapter;
mod distribution;
mod draws;
mod queue;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Allowed, ParameterSpec, Value, Word};

pub(crate) use adapter::Hold;
#[cfg(test)]
pub(crate) use adapter::tests::task as number_task;
pub use adapter::{with_declarations, with_latency};
pub use distribution::{Latency, LatencyError};

/// The parameter of a scenario that sets the latency of all requests of the episode, in seconds.
pub const LATENCY_PARAMETER: &str = "inference_latency_s";

/// Largest latency of a request, in seconds.
pub const MOST_LATENCY_S: f64 = 10.0;

/// How actions are executed while the policy computes the next ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExecutionMode {
    /// The robot holds its position while the policy computes, then executes the first actions of the new chunk.
    #[default]
    Hold,
    /// A queue of actions, as in the asynchronous inference of LeRobot (0.4): the next request starts when at most half
    /// of the last chunk is left. Actions for the same time are averaged, 30 % old and 70 % new. If the queue runs empty,
    /// the robot holds its position.
    Queue,
    /// Overlapping chunks, after real-time chunking (Black, Galliker and Levine 2025, arXiv:2506.07339): the next request
    /// starts after the executed part of a chunk, while the rest of the chunk continues. The new chunk continues at the
    /// action of the present time, and takes over with the soft mask of their equation 5. That method applies the mask
    /// inside the denoising of the model; from outside it can only be applied to the actions.
    Overlap,
}

/// The latency of a policy and the execution of its actions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Execution {
    /// The latency of each request.
    pub latency: Latency,
    /// What the robot does meanwhile.
    pub mode: ExecutionMode,
}

/// The declaration of [`LATENCY_PARAMETER`].
pub fn latency_parameter() -> ParameterSpec {
    ParameterSpec {
        name: LATENCY_PARAMETER.into(),
        unit: "s".to_owned(),
        meaning: "time from an observation to the actions that the policy computes from it".to_owned(),
        allowed: Allowed::Continuous { low: 0.0, high: MOST_LATENCY_S },
        nominal: Some(Value::Number(0.0)),
        read_from: "the delay of the policy adapter".to_owned(),
        family: Some(Word::constant("latency")),
    }
}
