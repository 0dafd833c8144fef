//! `robogate plan`: the progress of a campaign in shards, and the next ones.

use std::path::{Path, PathBuf};

use clap::Args;
use robogate_campaign::shards::{OpenRound, Shard, ShardError, ShardRound};
use serde_json::{Value, json};

use crate::arguments::TrustArguments;
use crate::commands::shard::open;
use crate::commands::{matrix, status};
use crate::exit::{DONE, Exit};
use crate::terminal::{line, note};
use robogate_session::text::quoted;
use robogate_session::{Trust, programs};

/// Show which shards of a campaign are committed, and their outcomes so far; or print the next ones as commands.
#[derive(Debug, Args)]
pub(crate) struct Plan {
    /// Folder of the campaign or the sweep
    dir: PathBuf,
    /// Print the commands that run the missing shards of the open round, one per line; nothing if all rounds are complete
    #[arg(long)]
    next: bool,
    #[command(flatten)]
    trust: TrustArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// The next shards of a campaign.
pub(crate) struct NextShards {
    shards: u32,
    round: Option<ShardRound>,
    pub(crate) items: Vec<NextShard>,
}

/// A shard that can run now.
pub(crate) struct NextShard {
    shard: Shard,
    round: ShardRound,
    episodes: u64,
    dir: PathBuf,
    /// The command that runs it.
    pub(crate) command: Vec<String>,
}

impl NextShard {
    /// The command as one line of a shell.
    pub(crate) fn line(&self) -> String {
        self.command.iter().map(|word| quoted(Path::new(word))).collect::<Vec<_>>().join(" ")
    }

    /// The shard as an element of a document.
    pub(crate) fn json(&self) -> Value {
        let Self { shard, round, episodes, dir, command } = self;
        let shard = shard.to_string();
        json!({ "shard": shard, "round": round, "episodes": episodes, "dir": dir, "command": command })
    }
}

/// Finds the missing shards of the open round of the campaign in `dir`.
pub(crate) fn next_shards(dir: &Path, trust: Trust) -> Result<NextShards, Exit> {
    let mut campaign = open(dir)?;
    let open = campaign.open_round()?;
    let shards = campaign.shards();
    let mut items = Vec::new();
    if let Some(OpenRound { round, missing }) = &open {
        if *round == ShardRound::Boundary {
            // The first worker would compute it as well. Here it is computed once.
            shards.boundary()?;
        }
        // The user of this call lets other machines start what the plan names.
        let provenance = &shards.settings().provenance;
        let trusted = !programs(provenance)?.is_empty() && trust.covers(dir, provenance);
        for index in missing {
            let shard = Shard::new(*index, shards.shards()).map_err(ShardError::from)?;
            let (name, out) = (shard.to_string(), dir.display().to_string());
            let mut command = ["robogate", "run", "--shard", &name, "--out", &out].map(str::to_owned).to_vec();
            if trusted {
                command.push("--trust".to_owned());
            }
            let episodes = shards.episodes_of(*round, shard);
            items.push(NextShard { shard, round: *round, episodes, dir: dir.to_owned(), command });
        }
    }
    Ok(NextShards { shards: shards.shards(), round: open.map(|open| open.round), items })
}

impl Plan {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match matrix::open(&self.dir)? {
            Some(plan) if self.next => return matrix::next(&self.dir, &plan, self.trust.choice(), self.json),
            Some(plan) => return matrix::status(&self.dir, &plan, self.json),
            None if !self.next => return status::print(&self.dir, self.json),
            None => {}
        }
        let NextShards { shards, round, items } = next_shards(&self.dir, self.trust.choice())?;
        if self.json {
            let items: Vec<Value> = items.iter().map(NextShard::json).collect();
            line(json!({ "version": 1, "dir": self.dir, "shards": shards, "round": round, "items": items }));
        } else {
            items.iter().for_each(|item| line(item.line()));
        }
        match &round {
            Some(round) => note(format_args!("round {round}: {} of {shards} shards are missing", items.len())),
            None => note(format_args!("all rounds are complete\nnext: robogate merge {}", quoted(&self.dir))),
        }
        Ok(DONE)
    }
}
