//! The other policy of `robogate gate --against`: it runs the scenarios of each round after this policy did.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::anyhow;
use robogate_campaign::{Executor, Round, ThreadPool};
use robogate_core::{Episode, Scenario};
use robogate_dictionary::{Dictionary, Entry, Provenance, write_parquet};
use robogate_gate::{Record, Trial};

use crate::commands::gate::refused;
use crate::exit::{Exit, OrExit};
use crate::subject::Subject;

/// The dictionary of the other policy in the folder of the gate.
const FILE: &str = "against.parquet";

/// The other policy with its episodes so far.
pub(crate) struct Rival {
    subject: Subject,
    threads: NonZeroUsize,
    provenance: Provenance,
    record: Record,
    entries: Vec<Entry>,
}

impl Rival {
    /// Prepares the other policy for the plan of this gate.
    pub(crate) fn new(subject: Subject, planned: &Provenance, threads: NonZeroUsize) -> Result<Self, Exit> {
        let own = subject.provenance(planned.space.clone())?;
        let provenance = Provenance { plan: planned.plan.clone(), seed: planned.seed, ..own };
        let record = Record::begun(&provenance).map_err(refused)?;
        let threads = subject.at_most().map_or(threads, |most| most.min(threads));
        Ok(Self { subject, threads, provenance, record, entries: Vec::new() })
    }

    /// The policy's name.
    pub(crate) fn name(&self) -> &str {
        self.subject.policy_name()
    }

    /// The path of its dictionary in the folder of the gate.
    pub(crate) fn file(&self, dir: &Path) -> String {
        let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
        full.join(FILE).to_string_lossy().into_owned()
    }

    /// Its episodes so far.
    pub(crate) fn record(&self) -> &Record {
        &self.record
    }

    /// Runs the scenarios of a round.
    pub(crate) fn run(&mut self, round: &Round<'_>) -> Result<(), Exit> {
        let never = AtomicBool::new(false);
        let pool = ThreadPool { factory: &self.subject, threads: self.threads, stop: &never };
        let scenarios: Vec<Scenario> = round.entries.iter().map(|entry| entry.episode.scenario.clone()).collect();
        let mut found: BTreeMap<u64, Episode> = BTreeMap::new();
        pool.execute(&|at| scenarios.get(at).cloned(), &mut |episode| {
            found.insert(episode.scenario.index, episode);
            ControlFlow::Continue(())
        })
        .or_broken()?;
        for entry in round.entries {
            let episode = found
                .remove(&entry.index())
                .ok_or_else(|| anyhow!("the policy of --against did not finish episode {}", entry.index()))
                .or_broken()?;
            let entry = Entry { episode, ..entry.clone() };
            self.record.trials.push(Trial::from(&entry));
            self.entries.push(entry);
        }
        Ok(())
    }

    /// Writes its dictionary. Returns the path and the record of its rows.
    pub(crate) fn write(self, dir: &Path) -> Result<(String, Record), Exit> {
        let path = dir.join(FILE);
        let text = self.file(dir);
        write_parquet(&path, &self.provenance, self.entries.into_iter().map(Ok)).or_broken()?;
        let record = Record::of(&Dictionary::open(&path).or_broken()?).map_err(refused)?;
        Ok((text, record))
    }
}
