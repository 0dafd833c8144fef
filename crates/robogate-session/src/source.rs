//! Opens the dictionary of a run.

use std::path::Path;

use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::not_in_shards;

use crate::failure::{Failure, OrFailure};

/// Opens a run's folder, a Parquet dictionary or a published JSON dictionary.
///
/// # Errors
/// The problem with the path, with a hint.
pub fn open_source(path: &Path) -> Result<Source, Failure> {
    if path.is_dir() && !path.join(DICTIONARY).exists() {
        not_in_shards(path).or_request()?;
    }
    Source::open(path).or_request()
}
