//! The record of a warner that acted in the episodes of a run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What happens at a warning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnWarning {
    /// The warning is recorded, and nothing else changes.
    Record,
    /// The episode ends before the action is executed.
    Stop,
    /// Each later action takes this many control periods.
    Slow(u32),
    /// The episode ends, and a person takes over.
    Handover,
}

/// A warner in the episodes of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WarnerRecord {
    /// What happens at a warning.
    pub on_warning: OnWarning,
    /// SHA-256 (hex) of the file of the detector.
    pub sha256: String,
    /// The file of the detector, as it was.
    pub detector: String,
}
