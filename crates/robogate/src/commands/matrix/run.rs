//! Runs the campaigns of a sweep, each in a process of its own, so that one that fails does not end the others.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Context, anyhow};
use robogate_campaign::folder::{JOURNAL, PLAN, SUMMARY};
use robogate_campaign::shards::{RoundState, ShardStatus};
use serde_json::{Value, json};

use super::sweep::{SweepPlan, SweepRun};
use crate::commands::plan::{NextShard, next_shards};
use crate::commands::shard;
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INTERRUPTED, INVALID, OrExit};
use crate::terminal::{bold, grouped, line, note};
use robogate_session::Trust;
use robogate_session::text::quoted;

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

/// The environment variable that makes a campaign end with the process of its sweep.
pub(crate) const CHILD: &str = "ROBOGATE_CHILD_OF_SWEEP";

/// Lets the system interrupt this process when the process of its sweep ends in any way, if it belongs to a sweep.
pub(crate) fn end_with_parent() {
    #[cfg(target_os = "linux")]
    if std::env::var_os(CHILD).is_some() {
        // Without it, a sweep that was killed leaves a campaign, which runs to its end.
        let _ = nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGTERM);
    }
}

/// `robogate` with these arguments. stderr stays on the terminal.
fn robogate(arguments: &[String]) -> Result<Command, Exit> {
    let program = std::env::current_exe().context("cannot find this program").or_broken()?;
    let mut command = Command::new(program);
    command.args(arguments).env(CHILD, "1").stdin(Stdio::null()).stdout(Stdio::null());
    Ok(command)
}

/// The error of a command that cannot start.
fn cannot_start(command: &Command) -> String {
    format!("cannot start {}", command.get_program().display())
}

/// The exit code of a campaign. `None` if it crashed or the system killed it.
fn code(status: ExitStatus) -> Option<u8> {
    match status.code() {
        _ if is_interrupted(status) => Some(INTERRUPTED),
        code => code.and_then(|code| u8::try_from(code).ok()),
    }
}

/// Whether a signal interrupted a process that did not handle it.
#[cfg(unix)]
fn is_interrupted(status: ExitStatus) -> bool {
    use std::os::unix::process::ExitStatusExt;

    use nix::sys::signal::Signal;

    [Signal::SIGINT, Signal::SIGTERM].iter().any(|signal| status.signal() == Some(*signal as i32))
}

/// Whether Ctrl-C ended a process that did not handle it.
#[cfg(not(unix))]
fn is_interrupted(status: ExitStatus) -> bool {
    /// STATUS_CONTROL_C_EXIT.
    const CONTROL_C: i32 = -1_073_741_510;
    status.code() == Some(CONTROL_C)
}

/// Passes signals to this process on to the campaign that runs.
#[derive(Debug, Clone, Default)]
struct Signals(Arc<Mutex<Running>>);

/// What a signal has to know.
#[derive(Debug, Default)]
struct Running {
    /// Whether there was a signal.
    stopped: bool,
    /// The process of the campaign that runs.
    campaign: Option<u32>,
}

impl Signals {
    /// Handles Ctrl-C and SIGTERM from now on.
    fn handle() -> Result<Self, Exit> {
        let signals = Self::default();
        let handler = signals.clone();
        ctrlc::set_handler(move || {
            let mut running = handler.running();
            running.stopped = true;
            running.campaign.into_iter().for_each(interrupt);
        })
        .or_broken()?;
        Ok(signals)
    }

    fn running(&self) -> MutexGuard<'_, Running> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn stopped(&self) -> bool {
        self.running().stopped
    }

    /// Runs a campaign to its end. `None` if there was a signal before it started.
    fn run(&self, command: &mut Command) -> Result<Option<ExitStatus>, Exit> {
        let mut child = {
            let mut running = self.running();
            if running.stopped {
                return Ok(None);
            }
            let child = alone(command).spawn().with_context(|| cannot_start(command)).or_broken()?;
            running.campaign = Some(child.id());
            child
        };
        let status = child.wait();
        self.running().campaign = None;
        status.context("cannot wait for a campaign").or_broken().map(Some)
    }
}

/// Lets a campaign get the signals of this process only, because a second signal would end it at once.
#[cfg(unix)]
fn alone(command: &mut Command) -> &mut Command {
    use std::os::unix::process::CommandExt;

    command.process_group(0)
}

/// Ctrl-C goes to all processes of the console.
#[cfg(not(unix))]
fn alone(command: &mut Command) -> &mut Command {
    command
}

/// Interrupts the process of a campaign: it stops after its current episodes, and at once after a second signal.
#[cfg(unix)]
fn interrupt(process: u32) {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    if let Ok(process) = i32::try_from(process) {
        // It may have ended.
        let _ = kill(Pid::from_raw(process), Signal::SIGTERM);
    }
}

/// Ctrl-C goes to all processes of the console.
#[cfg(not(unix))]
fn interrupt(_: u32) {}

/// Runs all campaigns that are not finished. Returns the names of those that failed, or the exit code of an interrupted
/// one, after which none is started.
pub(super) fn all(
    dir: &Path,
    plan: &SweepPlan,
    threads: Option<NonZeroUsize>,
) -> Result<Result<Vec<String>, u8>, Exit> {
    let signals = Signals::handle()?;
    let interrupted = || {
        note(format_args!("next: the same command continues the sweep in {}", dir.display()));
        Ok(Err(INTERRUPTED))
    };
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
        let Some(status) = signals.run(&mut robogate(&arguments)?)? else { return interrupted() };
        match code(status) {
            // Without a valid episode, the page says so.
            Some(DONE | INVALID) => {}
            Some(INTERRUPTED) => return interrupted(),
            _ if signals.stopped() => return interrupted(),
            code => {
                let how = code.map_or_else(|| format!("({status})"), |code| format!("with exit code {code}"));
                note(format_args!("{} failed {how}; the sweep continues", run.name));
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
        let mut command = robogate(&arguments)?;
        let status = command.status().with_context(|| cannot_start(&command)).or_broken()?;
        let code = code(status).unwrap_or(INFRASTRUCTURE);
        if code != DONE {
            return Err(Exit { code, error: anyhow!("{}: the run cannot be divided into shards", run.name) });
        }
    }
    if as_json {
        let episodes = shards_of(dir, plan)?.iter().map(|(_, status)| status.episodes).sum::<u64>();
        line(json!({ "version": 1, "dir": dir, "shards": shards, "episodes": episodes, "runs": plan.runs.len() }));
    }
    note(format_args!("next: robogate plan {} --next", quoted(dir)));
    Ok(DONE)
}

/// Prints the next shards of all runs of a sweep.
pub(crate) fn next(dir: &Path, plan: &SweepPlan, trust: Trust, as_json: bool) -> Result<u8, Exit> {
    let mut items = Vec::new();
    for run in &plan.runs {
        for mut item in next_shards(&run.dir(dir), trust)?.items {
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
        0 => note(format_args!("all runs are complete\nnext: robogate merge {}", quoted(dir))),
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

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn only_interrupts_end_a_sweep() {
        // SIGINT, SIGTERM, SIGKILL and SIGSEGV.
        let signalled = [2, 15, 9, 11].map(|signal| code(ExitStatus::from_raw(signal)));
        assert_eq!(signalled, [Some(INTERRUPTED), Some(INTERRUPTED), None, None]);
        // A wait status has the exit code in its second byte.
        assert_eq!([0, 5, 130].map(|number| code(ExitStatus::from_raw(number << 8))), [Some(0), Some(5), Some(130)]);
    }
}
