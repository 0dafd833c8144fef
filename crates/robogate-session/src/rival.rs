//! The other policy of `robogate gate --against`: it runs the scenarios of each round after this policy did.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, anyhow};
use robogate_campaign::folder::PLAN;
use robogate_campaign::{Executor, Round, ThreadPool};
use robogate_dictionary::{Dictionary, Entry, Journal, PlanHash, Provenance, files, write_parquet};
use robogate_gate::{Asked, Record, Trial};
use robogate_risk::all_processors;
use sha2::{Digest, Sha256};

use crate::failure::{Failure, OrFailure};
use crate::gate::write_question;
use crate::notice::warning;
use crate::reopening::Reopening;
use crate::subject::Subject;

/// The dictionary of the other policy in the folder of the gate.
const FILE: &str = "against.parquet";
/// Its origin, from which an interrupted gate prepares it again.
const ORIGIN: &str = "against.json";
/// Its episodes so far.
const JOURNAL: &str = "against.rgj";

/// The other policy with its episodes so far.
pub struct Rival {
    subject: Subject,
    threads: NonZeroUsize,
    provenance: Provenance,
    record: Record,
    entries: BTreeMap<u64, Entry>,
    journal: Option<Journal>,
}

impl Rival {
    /// Prepares the other policy for the plan of this gate. It runs in `threads` threads, or one for each processor, if the policy
    /// does not limit them.
    pub fn new(subject: Subject, planned: &Provenance, threads: Option<NonZeroUsize>) -> Result<Self, Failure> {
        let own = subject.provenance(planned.space.clone())?;
        let provenance = Provenance { plan: planned.plan.clone(), seed: planned.seed, ..own };
        let record = Record::begun(&provenance)?;
        let threads = threads.unwrap_or_else(all_processors);
        let threads = subject.at_most().map_or(threads, |most| most.min(threads));
        Ok(Self { subject, threads, provenance, record, entries: BTreeMap::new(), journal: None })
    }

    /// Prepares the other policy of an interrupted gate. Its recorded episodes do not run again.
    pub fn resume(
        dir: &Path,
        opening: &Reopening,
        planned: &Provenance,
        threads: Option<NonZeroUsize>,
    ) -> Result<Self, Failure> {
        let path = dir.join(ORIGIN);
        let text = fs::read(&path)
            .with_context(|| format!("cannot read {}, which describes the policy of --against", path.display()))
            .or_request()?;
        let recorded: Provenance = serde_json::from_slice(&text)
            .with_context(|| format!("{}: robogate writes this file, and it must not be edited", path.display()))
            .or_request()?;
        let subject = Subject::recorded(&recorded, Some(dir), &opening.without_policy())?;
        let mut rival = Self::new(subject, planned, threads)?;
        if rival.provenance.policy != recorded.policy {
            return Err(anyhow!(
                "the gate was started against {}; the policy is now {}",
                recorded.policy,
                rival.provenance.policy
            ))
            .or_request();
        }
        rival.open(dir)?;
        Ok(rival)
    }

    /// Starts or continues the record of its episodes in the folder of the gate, which contains the plan.
    pub fn open(&mut self, dir: &Path) -> Result<(), Failure> {
        if self.journal.is_some() {
            return Ok(());
        }
        let origin = dir.join(ORIGIN);
        if !origin.exists() {
            self.subject.register(dir, &self.provenance);
            let text = serde_json::to_string_pretty(&self.provenance).or_broken()?;
            files::write(&origin, text).with_context(|| format!("cannot write {}", origin.display())).or_broken()?;
        }
        let plan = dir.join(PLAN);
        let plan = fs::read(&plan).with_context(|| format!("cannot read {}", plan.display())).or_broken()?;
        let hash: PlanHash = Sha256::digest(plan).into();
        let path = dir.join(JOURNAL);
        let mut journal = if path.exists() {
            Journal::open(&path, &hash).or_broken()?.0
        } else {
            Journal::create(&path, &hash).or_broken()?
        };
        for entry in journal.ordered() {
            let entry = entry.or_broken()?;
            self.entries.insert(entry.index(), entry);
        }
        self.journal = Some(journal);
        Ok(())
    }

    /// The policy's name.
    pub fn name(&self) -> &str {
        self.subject.policy_name()
    }

    /// The path of its dictionary in the folder of the gate.
    pub fn file(&self, dir: &Path) -> String {
        let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
        full.join(FILE).to_string_lossy().into_owned()
    }

    /// Its episodes of the rounds so far.
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// Runs the scenarios of a round that are not recorded yet.
    pub fn run(&mut self, dir: &Path, round: &Round<'_>) -> Result<(), Failure> {
        self.open(dir)?;
        if round.number == 0 {
            self.record.trials.clear();
        }
        let never = AtomicBool::new(false);
        let pool = ThreadPool { factory: &self.subject, threads: self.threads, stop: &never };
        let due: Vec<&Entry> =
            round.entries.iter().filter(|entry| !self.entries.contains_key(&entry.index())).collect();
        let (journal, entries) = (&mut self.journal, &mut self.entries);
        let mut problem = None;
        pool.execute(&|at| due.get(at).map(|entry| entry.episode.scenario.clone()), &mut |episode| {
            let Some(own) = due.iter().find(|entry| entry.index() == episode.scenario.index) else {
                return ControlFlow::Continue(());
            };
            let entry = Entry { episode, ..(*own).clone() };
            match journal.as_mut().map_or(Ok(()), |journal| journal.append(&entry)) {
                Ok(()) => {
                    entries.insert(entry.index(), entry);
                    ControlFlow::Continue(())
                }
                Err(error) => {
                    problem = Some(error);
                    ControlFlow::Break(())
                }
            }
        })
        .or_broken()?;
        if let Some(error) = problem {
            return Err(error).or_broken();
        }
        for own in round.entries {
            let entry = self
                .entries
                .get(&own.index())
                .ok_or_else(|| anyhow!("the policy of --against did not finish episode {}", own.index()))
                .or_broken()?;
            // The same settings give the same scenarios. Otherwise the record belongs to another gate.
            if entry.episode.scenario != own.episode.scenario {
                let path = dir.join(JOURNAL);
                return Err(anyhow!("{}: episode {} is that of another gate", path.display(), own.index()))
                    .or_request();
            }
            self.record.trials.push(Trial::from(entry));
        }
        Ok(())
    }

    /// Writes its dictionary, names it in the question, and removes the files of an unfinished gate. Returns the record of its
    /// rows.
    ///
    /// # Errors
    /// A dictionary that cannot be written.
    pub fn finish(self, dir: &Path, asked: &mut Asked) -> Result<Record, Failure> {
        let path = dir.join(FILE);
        write_parquet(&path, &self.provenance, self.entries.values().cloned().map(Ok)).or_broken()?;
        let record = Record::of(&Dictionary::open(&path).or_broken()?)?;
        if let Some(against) = &mut asked.against {
            (against.path, against.dataset_sha256) = (self.file(dir), record.dataset_sha256.clone());
        }
        write_question(dir, asked);
        self.clean(dir);
        Ok(record)
    }

    /// Removes the files of an unfinished gate, after its question names the dictionary.
    fn clean(self, dir: &Path) {
        drop(self.journal);
        for name in [JOURNAL, ORIGIN] {
            let path = dir.join(name);
            if let Err(error) = fs::remove_file(&path)
                && error.kind() != ErrorKind::NotFound
            {
                warning(format_args!("cannot remove {}: {error}", path.display()));
            }
        }
    }
}
