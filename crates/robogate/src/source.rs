//! Opens the dictionary of a run, for all verbs that read one.

use std::path::Path;

use robogate_analysis::Source;
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::not_in_shards;
use robogate_dictionary::SCHEMA_VERSION;

use crate::exit::{Exit, OrExit};
use crate::terminal::note;

/// Opens a run's folder, a Parquet dictionary or a published JSON dictionary. Prints a note if the file has the names of
/// an older version.
pub(crate) fn open_source(path: &Path) -> Result<Source, Exit> {
    if path.is_dir() && !path.join(DICTIONARY).exists() {
        not_in_shards(path).or_usage()?;
    }
    let source = Source::open(path).or_usage()?;
    let version = source.dictionary().schema_version();
    if version.major < SCHEMA_VERSION.major {
        note(format_args!(
            "note: {}: a dictionary of schema {version}; its old names are read as those of schema {SCHEMA_VERSION}, and its task as `{}`",
            path.display(),
            source.dictionary().provenance().task.name
        ));
    }
    Ok(source)
}
