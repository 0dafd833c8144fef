//! The memory of a recurrent network.

use serde::{Deserialize, Serialize};

/// An output of a network that is its input at the next request of the same episode, such as the hidden state of a
/// recurrent layer. It is zero at the first request of each episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Name of the input.
    pub input: String,
    /// Name of the output. It has the shape and the type of the input.
    pub output: String,
}
