//! The JSON of the dictionaries released with the paper.
//!
//! One object: `metadata`, `summary`, and `experiments`, an array of flat rows (appendix A of the paper).
//! Their field names have no units and ours do: `mass` there is `mass_kg` here. Both directions are streams that hold
//! one row at a time.
//!
//! The published rows have no applied parameters, contacts, phases, ticks and trajectory hashes. These are missing after
//! an import. `zone` and `fail_prob` come from an analytic formula and not from episodes: they are neither imported nor
//! exported.

mod export;
mod import;
mod rows;

pub use export::export;
pub use import::{Imported, import};
use robogate_core::{FailureMode, Word};

/// Published names of parameters and our names for them, where they differ.
const NAMES: [(&str, &str); 6] = [
    ("mass", "mass_kg"),
    ("size", "size_m"),
    ("ik_noise", "ik_noise_rad"),
    ("grip_threshold", "grip_threshold_m"),
    ("approach_speed", "approach_speed_m_s"),
    ("position_jitter", "position_jitter_m"),
];

/// Prefix of a published parameter whose name is that of another column here.
const PREFIX: &str = "published_";

/// Fields of a published row that come from an analytic formula.
const ANALYTIC: [&str; 2] = ["zone", "fail_prob"];

/// A column of a published row: whether one failure mode happened.
#[derive(Debug)]
pub(crate) struct Flag {
    /// The failure mode.
    pub(crate) mode: FailureMode,
    /// The column.
    pub(crate) column: &'static str,
    /// Whether an episode can have it and succeed all the same: a second grasp makes up for one that missed.
    pub(crate) tolerated: bool,
}

/// The flags of a published row. Tables of other tools use these names, too.
pub(crate) const FLAGS: [Flag; 3] = [
    Flag { mode: FailureMode::constant("collision"), column: "collision", tolerated: false },
    Flag { mode: FailureMode::constant("grip_loss"), column: "drop", tolerated: false },
    Flag { mode: FailureMode::constant("grasp_miss"), column: "grasp_miss", tolerated: true },
];

/// Our name of the measure that is called [`TARGET_DISTANCE`] there.
const TARGET_DISTANCE_HERE: Word = Word::constant("target_distance_m");

const SUCCESS: &str = "success";
const FAILURE_TYPE: &str = "failure_type";
const CYCLE_TIME: &str = "cycle_time";
const TARGET_DISTANCE: &str = "dist_to_target";
const SAMPLE: &str = "sample_idx";

/// Our name of a published parameter.
fn name_here(published: &str) -> &str {
    NAMES.iter().find(|(there, _)| *there == published).map_or(published, |(_, here)| here)
}

/// The published name of our parameter.
fn name_there(ours: &str) -> &str {
    let plain = ours.strip_prefix(PREFIX).unwrap_or(ours);
    NAMES.iter().find(|(_, here)| *here == plain).map_or(plain, |(there, _)| there)
}
