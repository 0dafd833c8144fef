//! Messages of `render` and `hash`.

use serde::{Deserialize, Serialize};

/// Request to render cameras.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RenderRequest {
    /// Names of the cameras. Default: all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<Vec<String>>,
}

/// Reply to `render`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RenderReply {
    /// Number of control periods run so far.
    pub tick: u64,
    /// Images.
    pub images: Vec<ImageInfo>,
}

/// Size of an image, and the frame that holds its bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageInfo {
    /// Name of the camera.
    pub camera: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Index of the frame, from 1.
    pub frame: usize,
}

/// Reply to `hash`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HashReply {
    /// Number of control periods run so far.
    pub tick: u64,
    /// State hash of the last step. It may be nil before the first step.
    pub state_hash: Option<u64>,
}
