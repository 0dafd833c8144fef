//! `robogate plan`: prints the next shards of a campaign.

use std::path::PathBuf;

use clap::Args;
use robogate_campaign::shards::{OpenRound, Shard, ShardRound};
use serde_json::{Value, json};

use crate::commands::shard::{exit, open, quoted};
use crate::exit::{DONE, Exit};
use crate::terminal::{line, note};

/// Print the next shards of a campaign that several machines run, as commands: one per line, for the missing shards of
/// the open round. Prints nothing when all rounds are complete.
#[derive(Debug, Args)]
pub(crate) struct Plan {
    /// Folder of the campaign
    dir: PathBuf,
    /// Print the shards that can run now
    #[arg(long, required = true)]
    next: bool,
    /// Print the shards as one JSON document
    #[arg(long)]
    json: bool,
}

impl Plan {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let shards = open(&self.dir)?;
        let round = shards.open_round(None).map_err(exit)?;
        if let Some(OpenRound { round: ShardRound::Boundary, .. }) = round {
            // The first worker would compute it as well. Here it is computed once.
            shards.boundary().map_err(exit)?;
        }
        let missing = round.as_ref().map_or(&[][..], |open| &open.missing);
        let names = missing.iter().map(|index| Shard::new(*index, shards.shards()).map_err(|error| exit(error.into())));
        let names = names.collect::<Result<Vec<Shard>, Exit>>()?;
        if self.json {
            let item = |shard: &Shard| {
                let episodes = round.as_ref().map(|open| shards.episodes_of(open.round, *shard));
                let name = shard.to_string();
                let command = json!(["robogate", "run", "--shard", name, "--out", self.dir]);
                json!({ "shard": name, "episodes": episodes, "command": command })
            };
            let items: Vec<Value> = names.iter().map(item).collect();
            let round = round.as_ref().map(|open| open.round);
            let (dir, shards) = (&self.dir, shards.shards());
            line(json!({ "version": 1, "dir": dir, "shards": shards, "round": round, "items": items }));
        } else {
            names.iter().for_each(|shard| {
                line(format_args!("robogate run --shard {shard} --out {}", quoted(&self.dir)));
            });
        }
        match &round {
            Some(open) => note(format_args!(
                "round {}: {} of {} shards are missing",
                open.round,
                open.missing.len(),
                shards.shards()
            )),
            None => note(format_args!("all rounds are complete\nnext: robogate merge {}", quoted(&self.dir))),
        }
        Ok(DONE)
    }
}
