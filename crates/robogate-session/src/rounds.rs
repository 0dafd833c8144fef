//! The rounds of a gate: the other policy runs the scenarios after this one, and then the question is asked.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::{Completion, Event, Executor, Plan, Round, RunError, Settings};
use robogate_dictionary::{Dictionary, Provenance};
use robogate_gate::{Asked, GateError, Record};

use crate::arms::Arms;
use crate::compared::{compared_with, judged};
use crate::failure::{Failure, OrFailure};
use crate::gate::{Look, begun, question};
use crate::reopening::Reopening;
use crate::rival::Rival;

/// A gate between its rounds.
pub struct Rounds<'a> {
    dir: &'a Path,
    asked: Asked,
    /// The policy that runs beside this one.
    rival: Option<Rival>,
    /// The finished run that the gate compares with.
    other: Option<Record>,
    record: Record,
    trouble: Option<GateError>,
    broken: Option<Failure>,
}

impl<'a> Rounds<'a> {
    /// A gate before its first round. `record` has no episodes. The gate compares with a policy that runs beside this one, or with
    /// a finished run, or with nothing.
    pub fn new(dir: &'a Path, asked: Asked, rival: Option<Rival>, other: Option<Record>, record: Record) -> Self {
        Self { dir, asked, rival, other, record, trouble: None, broken: None }
    }

    /// An interrupted gate.
    ///
    /// # Errors
    /// A run that the gate compares with and that has changed, or another policy that cannot be prepared again.
    pub fn resumed(
        dir: &'a Path,
        asked: Asked,
        settings: &Settings,
        opening: &Reopening,
        threads: Option<NonZeroUsize>,
    ) -> Result<Self, Failure> {
        // The rows of a policy that runs beside this one do not exist before the end.
        let running = asked.against.as_ref().is_some_and(|against| against.dataset_sha256.is_empty());
        let (rival, other) = if running {
            (Some(Rival::resume(dir, opening, &settings.provenance, threads)?), None)
        } else {
            (None, compared_with(&asked)?.map(|(_, record)| record))
        };
        let record = begun(&settings.provenance, &asked)?;
        Ok(Self::new(dir, asked, rival, other, record))
    }

    /// Runs the rounds in a new folder, and then the arms. The folder has these documents and the question before the plan.
    ///
    /// # Errors
    /// The error of the campaign.
    pub fn run(
        &mut self,
        plan: &Plan,
        provenance: Provenance,
        arms: Arms,
        executor: &dyn Executor,
        documents: &[(&str, &[u8])],
        events: &mut dyn FnMut(&Event),
    ) -> Result<Completion, RunError> {
        let (dir, question) = (self.dir, self.asked.to_json());
        let documents: Vec<_> = documents.iter().copied().chain([(Asked::FILE, question.as_bytes())]).collect();
        let mut after = |round: &Round<'_>| self.after(round);
        let completion =
            robogate_campaign::start_in_rounds(dir, plan, provenance, &documents, executor, events, &mut after)?;
        self.worthwhile(arms, &completion).after(completion, executor, events)
    }

    /// Runs the rounds and arms that an interrupted gate lacks.
    ///
    /// # Errors
    /// The error of the campaign.
    pub fn resume(
        &mut self,
        provenance: &Provenance,
        arms: Arms,
        executor: &dyn Executor,
        events: &mut dyn FnMut(&Event),
    ) -> Result<Completion, RunError> {
        let dir = self.dir;
        let mut after = |round: &Round<'_>| self.after(round);
        let completion = robogate_campaign::resume_in_rounds(dir, provenance, executor, events, &mut after)?;
        self.worthwhile(arms, &completion).after(completion, executor, events)
    }

    /// Whether another round follows.
    fn after(&mut self, round: &Round<'_>) -> ControlFlow<()> {
        if let Some(rival) = &mut self.rival
            && let Err(error) = rival.run(self.dir, round)
        {
            self.broken = Some(error);
            return ControlFlow::Break(());
        }
        let other = self.rival.as_ref().map(Rival::record).or(self.other.as_ref());
        Look { asked: &self.asked, other, record: &mut self.record, trouble: &mut self.trouble }.after(round)
    }

    /// The arms that run after this gate: none if a pass is ruled out.
    fn worthwhile(&self, arms: Arms, completion: &Completion) -> Arms {
        if arms.is_empty() || self.broken.is_some() || !matches!(completion, Completion::Finished { .. }) {
            return arms;
        }
        let other = self.rival.as_ref().map(Rival::record).or(self.other.as_ref());
        // The end of the gate reports an error.
        if ruled_out(self.dir, &self.asked, other).unwrap_or(false) { arms.left_out() } else { arms }
    }

    /// The end of the rounds: the question, and the record of what it compares with. Writes the dictionary of a policy that ran
    /// beside this one.
    ///
    /// # Errors
    /// The error that ended the rounds.
    pub fn end(mut self, completion: &Completion) -> Result<(Asked, Option<Record>), Failure> {
        if let Some(error) = self.broken {
            return Err(error);
        }
        if let Completion::Finished { .. } = completion {
            if let Some(rival) = self.rival {
                self.other = Some(rival.finish(self.dir, &mut self.asked)?);
            }
            if let Some(error) = self.trouble {
                return Err(error.into());
            }
        }
        Ok((self.asked, self.other))
    }
}

/// Whether the finished gate in `dir` stopped because a pass is ruled out. Its arms do not run.
///
/// # Errors
/// Rows that cannot be read or judged.
pub fn ruled_out(dir: &Path, asked: &Asked, other: Option<&Record>) -> Result<bool, Failure> {
    let record = judged(dir, &Dictionary::open(&dir.join(robogate_campaign::folder::DICTIONARY)).or_broken()?, asked)?;
    Ok(question(asked, other).evaluate(&record)?.ruled_out.is_some())
}
