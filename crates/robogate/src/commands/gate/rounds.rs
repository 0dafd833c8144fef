//! The rounds of a gate: the other policy runs the scenarios after this one, and then the question is asked.

use std::ops::ControlFlow;
use std::path::Path;

use robogate_campaign::{Completion, Round, Settings};
use robogate_gate::{Asked, AskedAgainst, GateError, Record};

use super::question::{compared_with, refused, write_question};
use super::verdict::{finish, ruled_out};
use crate::commands::run::How;
use crate::exit::Exit;
use robogate_session::{Arms, Look, Reopening, Rival, Subject, Workers, begun};

/// A gate between its rounds.
pub(super) struct Rounds<'a> {
    pub(super) dir: &'a Path,
    pub(super) asked: Asked,
    /// The policy of `--against`, and its non-inferiority margin.
    pub(super) rival: Option<(Rival, f64)>,
    /// The finished run that the gate compares with.
    pub(super) other: Option<Record>,
    pub(super) record: Record,
    pub(super) trouble: Option<GateError>,
    pub(super) broken: Option<Exit>,
}

impl Rounds<'_> {
    /// Whether another round follows.
    pub(super) fn after(&mut self, round: &Round<'_>) -> ControlFlow<()> {
        if let Some((rival, _)) = &mut self.rival
            && let Err(error) = rival.run(self.dir, round)
        {
            self.broken = Some(error.into());
            return ControlFlow::Break(());
        }
        let other = self.rival.as_ref().map(|(rival, _)| rival.record()).or(self.other.as_ref());
        Look { asked: &self.asked, other, record: &mut self.record, trouble: &mut self.trouble }.after(round)
    }

    /// The arms that run after this gate: none if a pass is ruled out.
    pub(super) fn worthwhile(&self, arms: Arms, completion: &Completion) -> Arms {
        if arms.is_empty() || self.broken.is_some() || !matches!(completion, Completion::Finished { .. }) {
            return arms;
        }
        let other = self.rival.as_ref().map(|(rival, _)| rival.record()).or(self.other.as_ref());
        // The end of the gate reports an error.
        if ruled_out(self.dir, &self.asked, other).unwrap_or(false) { arms.left_out() } else { arms }
    }

    /// Writes and prints the verdict.
    pub(super) fn end(mut self, completion: Completion, subject: &Subject, json: bool) -> Result<u8, Exit> {
        if let Some(error) = self.broken {
            return Err(error);
        }
        if let (Some((rival, margin)), Completion::Finished { .. }) = (self.rival, &completion) {
            self.other = Some(finish_rival(rival, self.dir, &mut self.asked, margin)?);
        }
        finish(self.dir, &self.asked, self.other.as_ref(), self.trouble, completion, Some(subject), json)
    }
}

/// Writes the rows of the policy of --against, and names them in the question.
fn finish_rival(rival: Rival, dir: &Path, asked: &mut Asked, margin: f64) -> Result<Record, Exit> {
    let (path, record) = rival.write(dir)?;
    let dataset_sha256 = record.dataset_sha256.clone();
    asked.against = Some(AskedAgainst { path, dataset_sha256, margin });
    write_question(dir, asked);
    rival.clean(dir);
    Ok(record)
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
    let running = asked.against.as_ref().filter(|against| against.dataset_sha256.is_empty()).map(|a| a.margin);
    let rival = match running {
        Some(margin) => {
            let threads = Workers::for_rival(how.threads);
            Some((Rival::resume(dir, opening, &settings.provenance, threads)?, margin))
        }
        None => None,
    };
    let other = match rival {
        Some(_) => None,
        None => compared_with(&asked)?.map(|(_, record)| record),
    };
    let record = begun(&settings.provenance, &asked).map_err(refused)?;
    let arms = Arms::of(dir, &settings.plan, &settings.provenance.space, subject)?;
    let provenance = subject.provenance(settings.provenance.space)?;
    let mut rounds = Rounds { dir, asked, rival, other, record, trouble: None, broken: None };
    let completion = how.carry(subject, |executor, events| {
        let mut after = |round: &Round<'_>| rounds.after(round);
        let completion = robogate_campaign::resume_in_rounds(dir, &provenance, executor, events, &mut after)?;
        rounds.worthwhile(arms, &completion).after(completion, executor, events)
    })?;
    rounds.end(completion, subject, how.json)
}
