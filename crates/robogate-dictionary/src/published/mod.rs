//! The JSON of the dictionaries released with the paper.
//!
//! One object: `metadata`, `summary`, and `experiments`, an array of flat rows (appendix A of the paper).
//! Their field names carry no units; ours do, so that `mass` there is `mass_kg` here. Both directions are
//! streams: a row is in memory one at a time, however large the file.
//!
//! What the published rows do not have (applied parameters, contacts, phases, ticks, trajectory hashes)
//! is missing after an import. What we do not measure (`zone` and `fail_prob`, which come from an
//! analytic formula and not from episodes) is neither imported nor invented in an export.

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

/// What stands before the name of a published parameter that is the name of another column here.
const PREFIX: &str = "published_";

/// Fields of a published row that an analytic formula gave, and no episode.
const ANALYTIC: [&str; 2] = ["zone", "fail_prob"];

/// Failure modes that have a flag of their own in a published row, and the flag's name.
pub(crate) const FLAGS: [(FailureMode, &str); 3] = [
    (FailureMode::constant("collision"), "collision"),
    (FailureMode::constant("grip_loss"), "drop"),
    (FailureMode::constant("grasp_miss"), "grasp_miss"),
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
