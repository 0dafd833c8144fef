//! Runs the campaigns of a sweep, each in a process of its own, so that one that fails does not end the others.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow};
use robogate_campaign::folder::{JOURNAL, PLAN, SUMMARY};
use robogate_campaign::shards::{RoundState, ShardStatus};
use serde_json::{Value, json};

use super::sweep::{SweepPlan, SweepRun};
use crate::commands::plan::{NextShard, next_shards};
use crate::commands::shard;
use crate::exit::{DONE, Exit, INTERRUPTED, INVALID, OrExit};
use crate::terminal::{bold, grouped, line, note};

impl SweepRun {
    /// The arguments of `robogate run`.
    pub(super) fn arguments(&self) -> Vec<String> {
        let mut arguments = self.options.clone();
        arguments.extend(self.simulator_arguments());
        arguments
    }

    /// The arguments that name the simulators, which the plan of a run does not contain.
    pub(super) fn simulator_arguments(&self) -> Vec<String> {
        let addresses = self.simulators.join(",");
        if addresses.is_empty() { Vec::new() } else { vec!["--simulator".to_owned(), addresses] }
    }

    pub(super) fn dir(&self, sweep: &Path) -> PathBuf {
        sweep.join(&self.folder)
    }
}

/// Runs `robogate` with these arguments. stderr stays on the terminal. Returns the exit code.
fn robogate(arguments: &[String]) -> Result<u8, Exit> {
    let program = std::env::current_exe().context("cannot find this program").or_broken()?;
    let status = Command::new(&program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status()
        .with_context(|| format!("cannot start {}", program.display()))
        .or_broken()?;
    // A process that a signal ended has no code.
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(INTERRUPTED))
}

/// Runs all campaigns that are not finished. Returns the names of those that failed, or the exit code of an interrupted
/// one, after which none is started.
pub(super) fn all(
    dir: &Path,
    plan: &SweepPlan,
    threads: Option<NonZeroUsize>,
) -> Result<Result<Vec<String>, u8>, Exit> {
    // Ctrl-C goes to all processes of the terminal. The campaign stops after its current episodes, and then this process.
    ctrlc::set_handler(|| {}).or_broken()?;
    let mut failed = Vec::new();
    for (i, run) in plan.runs.iter().enumerate() {
        let folder = run.dir(dir);
        note(format_args!("{} of {}: {}", i + 1, plan.runs.len(), bold(&run.name)));
        if folder.join(SUMMARY).is_file() && !folder.join(JOURNAL).exists() {
            note("finished already");
            continue;
        }
        let path = folder.display().to_string();
        let mut arguments = if folder.join(PLAN).is_file() {
            let mut resume = vec!["resume".to_owned(), path];
            resume.extend(run.simulator_arguments());
            resume
        } else {
            let mut start = vec!["run".to_owned()];
            start.extend(run.arguments());
            start.extend(["--out".to_owned(), path]);
            start
        };
        if let Some(threads) = threads {
            arguments.extend(["--threads".to_owned(), threads.to_string()]);
        }
        match robogate(&arguments)? {
            // Without a valid episode, the page says so.
            DONE | INVALID => {}
            INTERRUPTED => {
                note(format_args!("next: the same command continues the sweep in {}", dir.display()));
                return Ok(Err(INTERRUPTED));
            }
            code => {
                note(format_args!("{} failed with exit code {code}; the sweep continues", run.name));
                failed.push(run.name.clone());
            }
        }
    }
    Ok(Ok(failed))
}

/// Divides all campaigns into shards.
pub(super) fn divide(dir: &Path, plan: &SweepPlan, as_json: bool) -> Result<u8, Exit> {
    let shards = plan.shards.unwrap_or(1);
    for run in &plan.runs {
        let mut arguments = vec!["run".to_owned(), "--divide".to_owned(), shards.to_string()];
        arguments.extend(run.arguments());
        arguments.extend(["--out".to_owned(), run.dir(dir).display().to_string()]);
        let code = robogate(&arguments)?;
        if code != DONE {
            return Err(Exit { code, error: anyhow!("{}: the run cannot be divided into shards", run.name) });
        }
    }
    if as_json {
        let episodes = shards_of(dir, plan)?.iter().map(|(_, status)| status.episodes).sum::<u64>();
        line(json!({ "version": 1, "dir": dir, "shards": shards, "episodes": episodes, "runs": plan.runs.len() }));
    }
    note(format_args!("next: robogate plan {} --next", shard::quoted(dir)));
    Ok(DONE)
}

/// Prints the next shards of all runs of a sweep.
pub(crate) fn next(dir: &Path, plan: &SweepPlan, as_json: bool) -> Result<u8, Exit> {
    let mut items = Vec::new();
    for run in &plan.runs {
        for mut item in next_shards(&run.dir(dir))?.items {
            item.command.extend(run.simulator_arguments());
            items.push(item);
        }
    }
    if as_json {
        let round = if items.is_empty() { None } else { Some("sweep") };
        let items: Vec<Value> = items.iter().map(NextShard::json).collect();
        line(json!({ "version": 1, "dir": dir, "shards": plan.shards, "round": round, "items": items }));
    } else {
        items.iter().for_each(|item| line(item.line()));
    }
    match items.len() {
        0 => note(format_args!("all runs are complete\nnext: robogate merge {}", shard::quoted(dir))),
        missing => note(format_args!("{missing} shards of the open rounds are missing")),
    }
    Ok(DONE)
}

/// Prints the progress of the runs of a sweep.
pub(crate) fn status(dir: &Path, plan: &SweepPlan, as_json: bool) -> Result<u8, Exit> {
    let runs = shards_of(dir, plan)?;
    let sum = |of: fn(&ShardStatus) -> u64| runs.iter().map(|(_, status)| of(status)).sum::<u64>();
    let (episodes, done) = (sum(|status| status.episodes), sum(|status| status.done));
    if as_json {
        let complete = runs.iter().all(|(_, status)| status.complete);
        let runs: Vec<Value> = runs.iter().map(|(run, status)| json!({ "run": run.name, "status": status })).collect();
        line(json!({ "version": 1, "episodes": episodes, "done": done, "complete": complete, "runs": runs }));
        return Ok(DONE);
    }
    line(format_args!("{} of {} episodes in committed shards", grouped(done), grouped(episodes)));
    for (run, status) in &runs {
        let open = status.rounds.iter().find(|round| round.state == RoundState::Open);
        let state = open.map_or_else(
            || "complete".to_owned(),
            |round| format!("{} {} of {} shards", round.round, round.committed, status.shards),
        );
        line(format_args!(
            "  {:<40} {:>9} of {:>9}  {state}",
            run.name,
            grouped(status.done),
            grouped(status.episodes)
        ));
    }
    Ok(DONE)
}

fn shards_of<'a>(dir: &Path, plan: &'a SweepPlan) -> Result<Vec<(&'a SweepRun, ShardStatus)>, Exit> {
    plan.runs.iter().map(|run| Ok((run, shard::open(&run.dir(dir))?.status()?))).collect()
}
