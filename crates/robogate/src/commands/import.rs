//! `robogate import`: a published JSON dictionary as Parquet.

use std::path::PathBuf;

use clap::Args;

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{grouped, note};

/// Read a published JSON dictionary into Parquet.
#[derive(Debug, Args)]
pub(crate) struct Import {
    /// The published JSON
    json: PathBuf,
    /// The dictionary to write (Parquet)
    out: PathBuf,
}

impl Import {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let imported = robogate_dictionary::published::import(&self.json, &self.out).or_usage()?;
        note(format_args!("{}: {} rows", self.out.display(), grouped(imported.written.rows)));
        imported
            .provenance
            .source
            .iter()
            .flat_map(|source| &source.notes)
            .for_each(|remark| note(format_args!("  {remark}")));
        Ok(DONE)
    }
}
