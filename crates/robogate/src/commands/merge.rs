//! `robogate merge`: merges the shards of a campaign.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use robogate_campaign::Event;
use robogate_stats::format::counted;

use crate::arguments::TrustArguments;
use crate::commands::matrix;
use crate::commands::shard::{merge, open};
use crate::exit::{Exit, OrExit};
use crate::place;
use crate::progress::Progress;
use crate::terminal::note;
use robogate_session::Reopening;

/// Merge the shards of a campaign to the files of a run on one machine: dictionary, boundary, summary and report. The
/// files are byte-identical to those of such a run. For a gate, also evaluate the verdict; its exit codes are those of
/// `robogate gate`.
#[derive(Debug, Args)]
pub(crate) struct Merge {
    /// Folder of the campaign or the sweep
    dir: PathBuf,
    /// Write the files to this folder; default: the same folder
    #[arg(long, value_name = "FOLDER", value_parser = place::local())]
    out: Option<PathBuf>,
    #[command(flatten)]
    trust: TrustArguments,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl Merge {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        if let Some(plan) = matrix::open(&self.dir)? {
            return match &self.out {
                None => matrix::merge(&self.dir, &plan, self.trust.choice(), self.json),
                Some(_) => Err(anyhow!("--out: a sweep is merged in its own folder")).or_usage(),
            };
        }
        let campaign = open(&self.dir)?;
        let shards = campaign.shards();
        if self.out.is_none() && place::is_remote(&self.dir) {
            return Err(anyhow!("--out is missing: the files of {} are written to a folder", self.dir.display()))
                .or_usage();
        }
        let out = self.out.as_ref().unwrap_or(&self.dir);
        let episodes = shards.settings().plan.episodes();
        let (episodes, shards) = (counted(episodes, "episode"), counted(shards.shards().into(), "shard"));
        note(format_args!("{episodes} in {shards}, into {}", out.display()));
        let mut progress = Progress::new();
        let mut show = |event: &Event| match event {
            Event::Finished { already: true, .. } => note("the shards are merged already"),
            // All episodes are recorded when the run starts that finishes the merge.
            Event::Started { .. } => {}
            event => progress.hear(event),
        };
        merge(campaign, out, &mut show, &Reopening::trusting(self.trust.choice()), self.json)
    }
}
