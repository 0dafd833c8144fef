//! `robogate warn`: warnings within an episode, before a failure.

mod check;
mod recorded;
mod show;
mod train;
mod watch;

use std::path::Path;

use anyhow::Context;
use clap::{Args, Subcommand};
use robogate_dictionary::files;
use robogate_monitor::warn::WarnFile;

use crate::exit::{Exit, OrExit};

/// Train and check a detector that warns within an episode, before it fails.
#[derive(Debug, Args)]
pub(crate) struct Warn {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Train a detector with the episodes of a run, and calibrate its threshold
    Train(train::TrainOn),
    /// Measure a detector on the episodes of another run, and calibrate it again with --out
    Check(check::CheckOn),
    /// Warn in episodes that run now: read their control periods as JSON Lines, and write warnings
    Watch(watch::Watch),
}

impl Warn {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.verb {
            Verb::Train(train) => train.execute(),
            Verb::Check(check) => check.execute(),
            Verb::Watch(watch) => watch.execute(),
        }
    }
}

/// Reads a detector.
fn read(path: &Path) -> Result<WarnFile, Exit> {
    Ok(robogate_session::read_detector(path)?.0)
}

/// Writes a detector.
fn write(path: &Path, file: &WarnFile) -> Result<(), Exit> {
    let mut text = serde_json::to_string(file).or_broken()?;
    text.push('\n');
    files::write(path, text).with_context(|| format!("cannot write {}", path.display())).or_unwritable()
}
