//! The rounds of a gate: the other policy runs the scenarios after this one, and then the question is asked.

use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::{Completion, Round, Settings};
use robogate_gate::{Asked, GateError, Record};

use super::question::{compared_with, refused};
use super::verdict::{finish, ruled_out};
use crate::commands::run::How;
use crate::exit::Exit;
use robogate_session::{Arms, Look, Reopening, Rival, Subject, begun};

/// A gate between its rounds.
pub(super) struct Rounds<'a> {
    pub(super) dir: &'a Path,
    pub(super) asked: Asked,
    /// The policy of `--against`.
    pub(super) rival: Option<Rival>,
    /// The finished run that the gate compares with.
    pub(super) other: Option<Record>,
    pub(super) record: Record,
    pub(super) trouble: Option<GateError>,
    pub(super) broken: Option<Exit>,
}

impl Rounds<'_> {
    /// Whether another round follows.
    pub(super) fn after(&mut self, round: &Round<'_>) -> ControlFlow<()> {
        if let Some(rival) = &mut self.rival
            && let Err(error) = rival.run(self.dir, round)
        {
            self.broken = Some(error.into());
            return ControlFlow::Break(());
        }
        let other = self.rival.as_ref().map(Rival::record).or(self.other.as_ref());
        Look { asked: &self.asked, other, record: &mut self.record, trouble: &mut self.trouble }.after(round)
    }

    /// The arms that run after this gate: none if a pass is ruled out.
    pub(super) fn worthwhile(&self, arms: Arms, completion: &Completion) -> Arms {
        if arms.is_empty() || self.broken.is_some() || !matches!(completion, Completion::Finished { .. }) {
            return arms;
        }
        let other = self.rival.as_ref().map(Rival::record).or(self.other.as_ref());
        // The end of the gate reports an error.
        if ruled_out(self.dir, &self.asked, other).unwrap_or(false) { arms.left_out() } else { arms }
    }

    /// Writes and prints the verdict.
    pub(super) fn end(mut self, completion: Completion, subject: &Subject, json: bool) -> Result<u8, Exit> {
        if let Some(error) = self.broken {
            return Err(error);
        }
        if let (Some(rival), Completion::Finished { .. }) = (self.rival, &completion) {
            self.other = Some(rival.finish(self.dir, &mut self.asked)?);
        }
        finish(self.dir, &self.asked, self.other.as_ref(), self.trouble, completion, Some(subject), json)
    }
}

/// Resumes an interrupted gate.
pub(crate) fn resume(
    dir: &Path,
    asked: Asked,
    subject: &Subject,
    settings: Settings,
    opening: &Reopening,
    how: &How,
) -> Result<u8, Exit> {
    // The rows of a policy that runs beside this one do not exist before the end.
    let running = asked.against.as_ref().is_some_and(|against| against.dataset_sha256.is_empty());
    let rival = match running {
        true => Some(Rival::resume(dir, opening, &settings.provenance, how.threads)?),
        false => None,
    };
    let other = match rival {
        Some(_) => None,
        None => compared_with(&asked)?.map(|(_, record)| record),
    };
    let record = begun(&settings.provenance, &asked).map_err(refused)?;
    let arms = Arms::of(dir, &settings.plan, &settings.provenance.space, subject)?;
    let provenance = subject.provenance(settings.provenance.space)?;
    let mut rounds = Rounds { dir, asked, rival, other, record, trouble: None, broken: None };
    let completion = how.carry(dir, subject, |executor, events| {
        let mut after = |round: &Round<'_>| rounds.after(round);
        let completion = robogate_campaign::resume_in_rounds(dir, &provenance, executor, events, &mut after)?;
        rounds.worthwhile(arms, &completion).after(completion, executor, events)
    })?;
    rounds.end(completion, subject, how.json)
}
