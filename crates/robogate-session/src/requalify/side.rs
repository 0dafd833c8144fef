//! One side of an upgrade: the episodes with their physics.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

use anyhow::{Context, anyhow};
use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::rollout_with;
use robogate_dictionary::Entry;
use robogate_gate::{Ending, Seen, Trace};
use robogate_risk::all_processors;

use super::planned_episode;
use crate::environments::cache;
use crate::failure::{Failure, OrFailure};
use crate::notice::note;
use crate::subject::Subject;

/// The episodes of one side.
pub(super) struct Side {
    pub(super) subject: Subject,
    /// The folder in which the processes of an environment write the physics of its episodes.
    probe: PathBuf,
    /// Episodes that ran, for another upgrade of the same run.
    seen: BTreeMap<u64, Seen>,
}

impl Drop for Side {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.probe);
    }
}

impl Side {
    /// Creates a side whose processes write to the folder that `subject` gets.
    pub(super) fn new(subject: impl FnOnce(&Path) -> Result<Subject, Failure>) -> Result<Self, Failure> {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let name = format!("probe-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let probe = cache().or_broken()?.join("requalify").join(name);
        fs::create_dir_all(&probe).with_context(|| format!("cannot create {}", probe.display())).or_broken()?;
        match subject(&probe) {
            Ok(subject) => Ok(Self { subject, probe, seen: BTreeMap::new() }),
            Err(failure) => {
                let _ = fs::remove_dir_all(&probe);
                Err(failure)
            }
        }
    }

    /// The episodes of these scenarios. Those that ran already do not run again.
    pub(super) fn run(&mut self, due: &[Entry], threads: Option<NonZeroUsize>) -> Result<Vec<Seen>, Failure> {
        let open: Vec<&Entry> = due.iter().filter(|entry| !self.seen.contains_key(&entry.index())).collect();
        let wanted = threads.or_else(|| self.subject.servers()).unwrap_or_else(all_processors);
        let most = NonZeroUsize::new(open.len()).unwrap_or(NonZeroUsize::MIN);
        let threads = self.subject.at_most().map_or(wanted, |limit| limit.min(wanted)).min(most);
        if !open.is_empty() {
            self.subject.start_servers(threads)?;
        }
        let (next, found) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        let work = || -> Result<(), Failure> {
            let mut worker = self.subject.worker().or_broken()?;
            while let Some(entry) = open.get(next.fetch_add(1, Ordering::Relaxed)) {
                let seen = self.episode(&mut worker, entry);
                found.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(seen);
            }
            Ok(())
        };
        if !open.is_empty() {
            thread::scope(|scope| {
                let threads: Vec<_> = (0..threads.get()).map(|_| scope.spawn(work)).collect();
                let panicked = |_| Err(anyhow!("a thread that runs episodes panicked")).or_broken();
                threads.into_iter().try_for_each(|thread| thread.join().unwrap_or_else(panicked))
            })?;
        }
        let found = found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        self.seen.extend(found.into_iter().map(|seen| (seen.index, seen)));
        Ok(due.iter().filter_map(|entry| self.seen.get(&entry.index()).cloned()).collect())
    }

    fn episode(&self, worker: &mut Worker, entry: &Entry) -> Seen {
        let file = self.probe.join(format!("{}.probe", entry.index()));
        let _ = fs::remove_file(&file);
        // The processes of an environment write more than a recorded motion has.
        let records = !self.subject.is_launched();
        worker.environment.record_trajectory(records.then_some(self.subject.task().control_period_s));
        let mut start = None;
        let episode =
            rollout_with(&mut *worker.environment, &mut *worker.policy, &entry.episode.scenario, &mut |tick| {
                start.get_or_insert_with(|| {
                    tick.observation.vectors.iter().flat_map(|(_, values)| values).copied().collect::<Vec<f64>>()
                });
            });
        let trace = if records {
            worker
                .environment
                .take_trajectory()
                .filter(|motion| !motion.frames.is_empty())
                .as_ref()
                .map(Trace::of_motion)
        } else {
            fs::read(&file).ok().and_then(|bytes| match Trace::read(&bytes) {
                Ok(trace) => Some(trace),
                Err(why) => {
                    note(format_args!("note: the physics of episode {} cannot be read: {why}", entry.index()));
                    None
                }
            })
        };
        let _ = fs::remove_file(&file);
        Seen {
            ending: Ending::from(&episode.outcome),
            ticks: episode.ticks,
            hash: episode.trajectory_hash,
            start: start.unwrap_or_default(),
            trace: trace.map(Arc::new),
            ..planned_episode(entry)
        }
    }
}
