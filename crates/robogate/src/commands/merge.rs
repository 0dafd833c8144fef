//! `robogate merge`: merges the shards of a campaign.

use std::path::PathBuf;

use clap::Args;
use robogate_campaign::Event;

use crate::commands::run::conclude;
use crate::commands::shard::{exit, open};
use crate::exit::Exit;
use crate::terminal::{grouped, note};

/// Merge the shards of a campaign to the files of a run on one machine: dictionary, boundary, summary and report. The
/// files are byte-identical to those of such a run.
#[derive(Debug, Args)]
pub(crate) struct Merge {
    /// Folder of the campaign
    dir: PathBuf,
    /// Write the files to this folder; default: the folder of the campaign
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl Merge {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let shards = open(&self.dir)?;
        let out = self.out.as_ref().unwrap_or(&self.dir);
        let episodes = shards.settings().plan.episodes();
        note(format_args!("{} episodes in {} shards, into {}", grouped(episodes), shards.shards(), out.display()));
        let mut show = |event: &Event| match event {
            Event::Warning { message, .. } => note(format_args!("warning: {message}")),
            Event::Finished { already: true, .. } => note("the shards are merged already"),
            _ => {}
        };
        let completion = shards.merge(out, &mut show, None).map_err(exit)?;
        conclude(out, &completion, self.json)
    }
}
