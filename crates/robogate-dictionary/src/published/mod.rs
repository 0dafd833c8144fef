//! The JSON of the dictionaries released with the paper.
//!
//! The file is one object with `metadata`, `summary`, and `experiments`, an array of flat rows (appendix A of the
//! paper). Published field names have no units: `mass` there is `mass_kg` here. Import and export are streams with one
//! row in memory.
//!
//! The published rows have no applied parameters, contacts, phases, ticks or trajectory hashes. These are missing after
//! an import. `zone` and `fail_prob` come from an analytic formula, not from episodes, and are neither imported nor
//! exported.

mod export;
mod import;
mod rows;

pub use export::export;
pub use import::{Imported, import};
use robogate_core::{FailureMode, Word};

/// Published parameter names and the corresponding names in RoboGate, if different.
const NAMES: [(&str, &str); 6] = [
    ("mass", "mass_kg"),
    ("size", "size_m"),
    ("ik_noise", "ik_noise_rad"),
    ("grip_threshold", "grip_threshold_m"),
    ("approach_speed", "approach_speed_m_s"),
    ("position_jitter", "position_jitter_m"),
];

/// Prefix for a published parameter whose name equals that of another column.
const PREFIX: &str = "published_";

/// Fields of a published row that come from an analytic formula.
const ANALYTIC: [&str; 2] = ["zone", "fail_prob"];

/// A column of a published row that indicates one failure mode.
#[derive(Debug)]
pub(crate) struct Flag {
    /// The failure mode.
    pub(crate) mode: FailureMode,
    /// The column.
    pub(crate) column: &'static str,
    /// Whether an episode can have the flag and still succeed, for example if a second grasp follows a missed one.
    pub(crate) tolerated: bool,
}

/// The flags of a published row. Tables of other tools also use these names.
pub(crate) const FLAGS: [Flag; 3] = [
    Flag { mode: FailureMode::constant("collision"), column: "collision", tolerated: false },
    Flag { mode: FailureMode::constant("grip_loss"), column: "drop", tolerated: false },
    Flag { mode: FailureMode::constant("grasp_miss"), column: "grasp_miss", tolerated: true },
];

/// The RoboGate name of the measure [`TARGET_DISTANCE`].
const TARGET_DISTANCE_HERE: Word = Word::constant("target_distance_m");

const SUCCESS: &str = "success";
const FAILURE_TYPE: &str = "failure_type";
const CYCLE_TIME: &str = "cycle_time";
const TARGET_DISTANCE: &str = "dist_to_target";
const SAMPLE: &str = "sample_idx";

/// The RoboGate name of a published parameter.
fn name_here(published: &str) -> &str {
    NAMES.iter().find(|(there, _)| *there == published).map_or(published, |(_, here)| here)
}

/// The published name of a RoboGate parameter.
fn name_there(ours: &str) -> &str {
    let plain = ours.strip_prefix(PREFIX).unwrap_or(ours);
    NAMES.iter().find(|(_, here)| *here == plain).map_or(plain, |(there, _)| there)
}
