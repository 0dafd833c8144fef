//! A task from a folder.

use std::path::Path;

use anyhow::{Context, bail};
use robogate_dictionary::read_text;
use robogate_tasks::file::{FILE, FileTask};

use crate::cell::listed;

/// Reads the task in a folder.
///
/// # Errors
/// Every problem of its file.
pub fn read(folder: &Path) -> anyhow::Result<FileTask> {
    let path = folder.join(FILE);
    let text = read_text(&path).with_context(|| {
        format!("cannot read {}\nHint: `robogate tasks init {}` writes an example", path.display(), folder.display())
    })?;
    match FileTask::read(&text) {
        Ok(task) => Ok(task),
        Err(problems) => bail!("{}\n{}", path.display(), listed(&problems)),
    }
}
