//! `robogate export`: writes a dictionary in another format.

use std::io;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use robogate_dictionary::export::{Format, write_file, write_to};
use robogate_dictionary::{Dictionary, DictionaryError};

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{grouped, note};

/// Write a failure dictionary as CSV, JSON Lines or the published JSON.
#[derive(Debug, Args)]
pub(crate) struct Export {
    /// Folder of a run, or a dictionary (Parquet)
    dictionary: PathBuf,
    /// File to write; its extension selects the format unless --format is given. `-` writes to standard output (CSV by
    /// default)
    out: PathBuf,
    /// Choose the format
    #[arg(long)]
    format: Option<To>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum To {
    /// RFC 4180 (.csv)
    Csv,
    /// One object per row (.jsonl, .ndjson)
    Jsonl,
    /// The schema of the dictionaries released with the paper (.json)
    Published,
}

impl Export {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let standard_output = self.out.as_os_str() == "-";
        let to = match self.format.or_else(|| by_ending(&self.out)) {
            None if standard_output => To::Csv,
            Some(to) => to,
            None => {
                let why = anyhow::anyhow!(
                    "{}: unknown file extension. Expected .csv, .jsonl or .json, or choose the format with --format",
                    self.out.display()
                );
                return Err(why).or_usage();
            }
        };
        if !standard_output {
            require_absent(&self.out)?;
        }
        let dictionary = open(&self.dictionary)?;
        let format = match to {
            To::Csv => Format::Csv,
            To::Jsonl => Format::JsonLines,
            To::Published => Format::Published,
        };
        if standard_output {
            return match write_to(&dictionary, format, io::stdout().lock()) {
                // The reader, for example `head`, has seen enough.
                Err(DictionaryError::Io { source, .. }) if source.kind() == io::ErrorKind::BrokenPipe => Ok(DONE),
                written => written.map(|_| DONE).or_broken(),
            };
        }
        let rows = write_file(&dictionary, format, &self.out).or_broken()?;
        note(format_args!("{}: {} rows", self.out.display(), grouped(rows)));
        Ok(DONE)
    }
}

/// Returns an error if the path exists: the file may be the source of the rows.
pub(crate) fn require_absent(out: &Path) -> Result<(), Exit> {
    if out.symlink_metadata().is_err() {
        return Ok(());
    }
    let why = anyhow::anyhow!(
        "{}: already exists, and is not overwritten\nhint: choose another name, or remove it",
        out.display()
    );
    Err(why).or_usage()
}

fn by_ending(path: &Path) -> Option<To> {
    match path.extension()?.to_str()? {
        "csv" => Some(To::Csv),
        "jsonl" | "ndjson" => Some(To::Jsonl),
        "json" => Some(To::Published),
        _ => None,
    }
}

/// Opens the dictionary of a run's folder, or a dictionary file.
fn open(path: &Path) -> Result<Dictionary, Exit> {
    let file = if path.is_dir() { path.join(robogate_campaign::folder::DICTIONARY) } else { path.to_owned() };
    if path.is_dir() && !file.exists() && robogate_campaign::settings(path).is_ok() {
        let why = anyhow::anyhow!("{}: the run is not finished\nhint: robogate resume {0}", path.display());
        return Err(why).or_usage();
    }
    Dictionary::open(&file).or_usage()
}
