//! Opens the dictionary of a run, for all verbs that read one.

use std::path::Path;

use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::not_in_shards;

use crate::exit::{Exit, OrExit};

/// Opens a run's folder, a Parquet dictionary or a published JSON dictionary.
pub(crate) fn open_source(path: &Path) -> Result<Source, Exit> {
    if path.is_dir() && !path.join(DICTIONARY).exists() {
        not_in_shards(path).or_usage()?;
    }
    Source::open(path).or_usage()
}
