//! `robogate run --shard`: runs shards of a campaign.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, anyhow};
use robogate_campaign::shards::{
    Assignment, Commit, Shard, ShardEnd, ShardError, ShardResult, ShardRound, ShardSet, ShardTask, Shards,
};
use robogate_campaign::{Event, Executor, OutcomeCounts, Plan};
use robogate_dictionary::Provenance;
use robogate_stats::format::counted;
use serde_json::json;

use crate::commands::gate;
use crate::commands::report::PAGE;
use crate::commands::run::{How, conclude, introduce, shown, write_report};
use crate::exit::{DONE, Exit, INTERRUPTED, OrExit};
use crate::terminal::{grouped, line, note};
use robogate_session::text::quoted;
use robogate_session::{Reopening, ShardedCampaign, Subject, create_store, open_store};

/// Runs `shards` of the open round of the campaign in `dir`, and commits each at its end.
pub(crate) fn run(
    dir: &Path,
    shards: &ShardSet,
    subject: &Subject,
    plan: &Plan,
    provenance: Provenance,
    how: &How,
) -> Result<u8, Exit> {
    introduce(&provenance, plan.seed);
    let campaign = ShardedCampaign::of(begin(dir, shards.of(), plan, provenance, &[])?)?;
    let mut worker = Worker { dir, campaign, shards: shards.iter(), round: None, subject, json: how.json };
    worker.choose()?;
    // Servers start only if an episode has to run.
    let Some(first) = worker.next()? else {
        return Ok(DONE);
    };
    how.with_workers(|workers| {
        workers.with_pool(subject, |pool| {
            let mut next = Some(first);
            while let Some((shard, task)) = next {
                let Some(result) = finish(&task, pool)? else {
                    return Ok(INTERRUPTED);
                };
                worker.commit(shard, &result)?;
                next = worker.next()?;
            }
            Ok(DONE)
        })
    })
}

/// Works on the shards of one command, one after the other.
struct Worker<'a, I> {
    dir: &'a Path,
    campaign: ShardedCampaign,
    /// The shards that are left.
    shards: I,
    /// The round of these shards: the one that is open when the command starts.
    round: Option<ShardRound>,
    subject: &'a Subject,
    json: bool,
}

impl<I: Iterator<Item = Shard>> Worker<'_, I> {
    /// Chooses the points of the next round, if it can be chosen now.
    fn choose(&self) -> Result<(), Exit> {
        Ok(self.campaign.choose(&|| self.subject.foresight())?)
    }

    /// The next shard whose episodes have to run.
    fn next(&mut self) -> Result<Option<(Shard, Box<ShardTask>)>, Exit> {
        while let Some(shard) = self.shards.next() {
            let assignment = self.campaign.assign(shard.index()).inspect_err(|failure| {
                if let Some(ShardError::Contradicted { .. }) = failure.error.downcast_ref() {
                    self.report(shard, "conflict", self.round, None);
                }
            })?;
            let open = match &assignment {
                Assignment::Run(task) => Some(task.round()),
                Assignment::Committed { round } | Assignment::Choose { round } => Some(*round),
                Assignment::Complete => None,
            };
            // A shard of another round than that of the first one is not run: its own round is complete.
            if let (Some(round), true) = (self.round, self.round != open) {
                self.committed_already(shard, round);
                continue;
            }
            self.round = open;
            match assignment {
                Assignment::Choose { round } => {
                    return Err(ShardError::NotChosen { dir: self.dir.to_owned(), round }.into());
                }
                Assignment::Complete => {
                    note("nothing to do: all rounds are complete");
                    note(format_args!("next: robogate merge {}", quoted(self.dir)));
                    self.report(shard, "complete", None, None);
                }
                Assignment::Committed { round } => self.committed_already(shard, round),
                Assignment::Run(task) => {
                    let (episodes, dir) = (counted(task.episodes(), "episode"), self.dir.display());
                    note(format_args!("shard {shard} of round {}: {episodes}, into {dir}", task.round()));
                    return Ok(Some((shard, task)));
                }
            }
        }
        Ok(None)
    }

    fn committed_already(&self, shard: Shard, round: ShardRound) {
        note(format_args!("nothing to do: shard {shard} of round {round} is committed already"));
        self.report(shard, "already_committed", Some(round), None);
    }

    /// Commits a shard.
    fn commit(&self, shard: Shard, result: &ShardResult) -> Result<(), Exit> {
        let state = match self.campaign.shards().commit(result) {
            Ok(Commit::First) => "committed",
            Ok(Commit::Duplicate) => {
                note("another process has committed the same episodes already");
                "duplicate"
            }
            Err(error) => {
                if let ShardError::Conflict { .. } = error {
                    // A scheduler must not run the shard again: it would find the committed one.
                    self.report(shard, "conflict", Some(result.round()), Some(result.outcomes()));
                }
                return Err(error.into());
            }
        };
        self.report(shard, state, Some(result.round()), Some(result.outcomes()));
        // The last shard of a round chooses the points of the next one, so that the others need not wait for it.
        self.choose()
    }

    /// Prints the document of a shard.
    fn report(&self, shard: Shard, state: &str, round: Option<ShardRound>, outcomes: Option<&OutcomeCounts>) {
        if self.json {
            let (dir, shard) = (self.dir, shard.to_string());
            line(
                json!({ "version": 1, "dir": dir, "shard": shard, "round": round, "state": state, "outcomes": outcomes }),
            );
        }
    }
}

/// Writes the plan of a campaign in `shards` shards, and `documents` (names and contents) beside it.
pub(crate) fn divide(
    dir: &Path,
    shards: u32,
    plan: &Plan,
    provenance: Provenance,
    documents: &[(&str, &[u8])],
    json: bool,
) -> Result<u8, Exit> {
    introduce(&provenance, plan.seed);
    let shards = begin(dir, shards, plan, provenance, documents)?;
    let (shards, episodes) = (shards.shards(), shards.settings().plan.episodes());
    let (all, parts) = (counted(episodes, "episode"), counted(shards.into(), "shard"));
    note(format_args!("{all} in {parts}, into {}", dir.display()));
    note(format_args!("next: robogate plan {} --next", quoted(dir)));
    if json {
        line(json!({ "version": 1, "dir": dir, "shards": shards, "episodes": episodes }));
    }
    Ok(DONE)
}

/// Starts or joins a campaign in shards in `dir`.
fn begin(
    dir: &Path,
    shards: u32,
    plan: &Plan,
    provenance: Provenance,
    documents: &[(&str, &[u8])],
) -> Result<Shards, Exit> {
    Shards::begin_with(create_store(dir)?, shards, plan, provenance, documents).map_err(Exit::from)
}

/// Runs the episodes of a shard. `None` if the user stopped it.
fn finish(task: &ShardTask, pool: &dyn Executor) -> Result<Option<ShardResult>, Exit> {
    // A shard with few episodes is lost if the server was unavailable in all of them.
    let (end, outage) = shown(pool, task.episodes(), |executor, events| task.run(executor, events))?;
    let hint = "Hint: the shard is not committed; run it again once the server is available";
    match (end, outage) {
        (_, Some(outage)) => Err(anyhow!("stopped: {outage}\n  {hint}")).or_broken(),
        (ShardEnd::Complete(result), None) => Ok(Some(result)),
        (ShardEnd::Interrupted { done, episodes }, None) => {
            note(format_args!(
                "{} of {} episodes ran. The shard is not committed; the same command runs it again from its start.",
                grouped(done),
                grouped(episodes)
            ));
            Ok(None)
        }
    }
}

/// Opens the campaign in shards in `dir`.
pub(crate) fn open(dir: &Path) -> Result<ShardedCampaign, Exit> {
    Ok(ShardedCampaign::of(Shards::open(open_store(dir)?)?)?)
}

/// Merges a campaign in shards into `out`, with the pages of the run and its arms.
pub(crate) fn merge(
    mut campaign: ShardedCampaign,
    out: &Path,
    events: &mut dyn FnMut(&Event),
    opening: &Reopening,
    json: bool,
) -> Result<u8, Exit> {
    let completion = campaign.merge(out, events, opening)?;
    for arm in campaign.merge_arms(out, &completion, opening)? {
        write_report(&arm, None, None);
        // The page of an earlier merge lacks this arm.
        let page = out.join(PAGE);
        match std::fs::remove_file(&page) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot replace {}", page.display())).or_broken();
            }
            _ => {}
        }
    }
    match campaign.question(out) {
        Some((asked, other)) => gate::finish(out, asked, other, completion, None, None, json),
        None => conclude(out, &completion, None, json),
    }
}
