//! The workers that run the episodes of a subject.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::anyhow;
use robogate_campaign::{BatchPool, Completion, Event, Executor, RunError};
use robogate_core::{Episode, Scenario};
use robogate_risk::all_processors;

use crate::failure::{Failure, OrFailure};
use crate::lost_episodes::{Outage, RunsLostAgain};
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::signals::SIGNALS;
use crate::subject::Subject;

/// The workers of a campaign.
#[derive(Debug, Clone, Copy)]
pub struct Workers<'a> {
    /// How many episodes run at once. `None` for a number that fits the machine, the servers and the policy.
    pub threads: Option<NonZeroUsize>,
    /// How many episodes are in progress at once. `None` for one in each thread, or as many as fit a simulator of many worlds.
    pub in_flight: Option<NonZeroUsize>,
    /// Stops the campaign when another thread sets it. The episodes that run are finished.
    pub stop: &'a AtomicBool,
}

impl Workers<'_> {
    /// Calls `work` with a pool of workers for this subject.
    ///
    /// # Errors
    /// Servers that cannot be started, or the error of `work`.
    pub fn with_pool<T, E: From<Failure>>(
        &self,
        subject: &Subject,
        work: impl FnOnce(&BatchPool<'_>) -> Result<T, E>,
    ) -> Result<T, E> {
        let cores = all_processors();
        let given = self.threads.or(self.in_flight).or_else(|| subject.servers());
        let measured =
            if given.is_none() && subject.at_most().is_none() { subject.measured_in_flight(cores) } else { None };
        let wanted = measured.or(self.threads).or_else(|| subject.servers()).unwrap_or(cores);
        let threads = subject.at_most().map_or(wanted, |limit| limit.min(wanted));
        if self.threads.is_some() && threads < wanted {
            note(format_args!("{threads} thread: the policy server keeps one state for all clients"));
        }
        // A worker that waits for a server or for a process of the environment costs no processor time, so each episode has its own.
        let waits = subject.waits_for_servers() || subject.is_launched();
        let threads = match self.in_flight {
            Some(in_flight) if waits => in_flight,
            Some(in_flight) => in_flight.min(threads),
            None => threads,
        };
        self.check_in_flight(subject)?;
        subject.start_servers(threads)?;
        // Each simulator in another process has room for one episode.
        let single = waits || subject.servers().is_some() || subject.at_most().is_some();
        let slots = match (self.in_flight, subject.slots(threads)?) {
            _ if single => None,
            (Some(in_flight), _) => NonZeroUsize::new(in_flight.get().div_ceil(threads.get())),
            (None, many) => many,
        };
        if self.in_flight.is_some() && subject.policy_source().is_some_and(PolicySource::is_network) {
            note("the network answers one request at a time: in a batch its answers would differ in their last bits");
        }
        let slots = slots.unwrap_or(NonZeroUsize::MIN);
        let (began, before) = (Instant::now(), subject.usage().unwrap_or_default());
        let done = work(&BatchPool { factory: subject, threads, slots, stop: self.stop });
        let used = subject.usage().unwrap_or_default().since(before);
        if let Some(limit) = subject.limit_of_speed(threads, began.elapsed(), used) {
            note(limit);
        }
        done
    }

    /// Rejects more episodes at once than a policy can drive.
    fn check_in_flight(&self, subject: &Subject) -> Result<(), Failure> {
        match (self.in_flight, subject.at_most()) {
            (Some(in_flight), Some(limit)) if in_flight > limit => Err(anyhow!(
                "--in-flight {in_flight}: the policy server keeps one state for all clients, so one episode runs at once\nHint: leave \
                 it out"
            ))
            .or_request(),
            _ => Ok(()),
        }
    }

    /// Runs these recorded episodes again and records their signals in the folder of the run. Returns how many ran.
    ///
    /// # Errors
    /// Servers that cannot be started, or a file that cannot be written. The unfinished file is removed.
    pub fn record_signals(
        &self,
        run: &Path,
        subject: &Subject,
        scenarios: &[Scenario],
        receive: &mut dyn FnMut(&Episode) -> ControlFlow<()>,
    ) -> Result<usize, Failure> {
        subject.begin_signals(run, true)?;
        let mut done = 0;
        let ran = self.with_pool(subject, |pool| {
            pool.execute(&|at| scenarios.get(at).cloned(), &mut |episode| {
                done += 1;
                receive(&episode)
            })
            .or_broken()
        });
        let ended = ran.and_then(|()| subject.end_signals(run));
        if ended.is_err() || done < scenarios.len() {
            // The error that ended the episodes is reported.
            let _ = std::fs::remove_file(run.join(SIGNALS));
        }
        ended.map(|()| done)
    }

    /// Runs a campaign in the folder `dir` with `work`. Episodes that an unavailable server lost run again.
    ///
    /// # Errors
    /// The error of the campaign, or servers that stay unavailable: the recorded episodes are kept.
    pub fn carry(
        &self,
        dir: &Path,
        subject: &Subject,
        events: &mut dyn FnMut(&Event),
        work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<Completion, RunError>,
    ) -> Result<Completion, Failure> {
        let (mut keeping, mut signals) = (true, Ok(()));
        let mut events = |event: &Event| {
            match event {
                // The folder exists, and no episode has run yet.
                Event::Started { .. } if std::mem::take(&mut keeping) => {
                    subject.keep_files(dir);
                    signals = subject.begin_signals(dir, false);
                    if signals.is_err() {
                        // The user wants them of all episodes. `robogate resume` tries again.
                        self.stop.store(true, Ordering::Relaxed);
                    }
                }
                Event::StageFinished { .. } => subject.sync_signals(),
                // Arms may follow, whose episodes have the same indices.
                Event::Finished { .. } if signals.is_ok() => signals = subject.end_signals(dir),
                _ => {}
            }
            events(event);
        };
        let ran = self.with_pool(subject, |pool| guarded(pool, u64::MAX, &mut events, work))?;
        subject.end_signals(dir).and(signals)?;
        match ran {
            (Completion::Interrupted { .. }, Some(outage)) => {
                let network = subject.policy_source().is_some_and(PolicySource::is_network);
                let until = if network { "once the cause is corrected" } else { "once the server is available again" };
                Err(anyhow!(
                    "stopped: {outage}\nHint: the recorded episodes are kept; `robogate resume` runs the others {until}"
                ))
                .or_broken()
            }
            (completion, _) => {
                if let Completion::Finished { .. } = completion {
                    subject.repeat_first_episodes(dir)?;
                }
                Ok(completion)
            }
        }
    }
}

/// Runs at most `episodes` episodes with `work`. Episodes that an unavailable server lost run again. Also returns the outage that
/// has stopped the execution, if there was one.
///
/// # Errors
/// The error of the campaign.
pub fn guarded<T>(
    pool: &dyn Executor,
    episodes: u64,
    events: &mut dyn FnMut(&Event),
    work: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> Result<T, RunError>,
) -> Result<(T, Option<Outage>), Failure> {
    let executor = RunsLostAgain::new(pool, episodes);
    let done = work(&executor, events)?;
    Ok((done, executor.outage()))
}
