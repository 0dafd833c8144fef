//! Recorded episodes, recomputed on demand.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::anyhow;
use robogate_dictionary::{Entry, Provenance};
use robogate_replay::Clip;

use crate::exit::{Exit, INVALID, OrExit};
use crate::watch::{self, Again};
use robogate_session::{Reopening, Subject};

/// Records episodes of the runs again.
pub(super) struct Clips {
    opening: Reopening,
    /// Environment and policy of each run that an episode was recorded of.
    subjects: Vec<(usize, Result<Subject, Exit>)>,
}

/// The run that an episode belongs to.
pub(super) struct Origin {
    pub(super) run: usize,
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) provenance: Arc<Provenance>,
    /// Whether the page shows several runs.
    pub(super) named: bool,
}

impl Clips {
    pub(super) fn new(opening: Reopening) -> Self {
        Self { opening, subjects: Vec::new() }
    }

    /// Records an episode. The error says in words why it cannot be shown.
    pub(super) fn clip(&mut self, origin: &Origin, entry: &Entry) -> Result<Clip, Exit> {
        if !self.subjects.iter().any(|(run, _)| *run == origin.run) {
            self.subjects.push((
                origin.run,
                Subject::recorded(&origin.provenance, Some(&origin.path), &self.opening).map_err(Exit::from),
            ));
        }
        let subject = self.subjects.iter().find(|(run, _)| *run == origin.run).map(|(_, subject)| subject);
        let subject = match subject {
            Some(Ok(subject)) => subject,
            Some(Err(exit)) => return Err(Exit { code: exit.code, error: anyhow!("{exit}") }),
            None => return Err(anyhow!("the run is not known")).or_broken(),
        };
        let again = Again::of(subject, &entry.episode, false).or_broken()?.ok_or_else(|| Exit {
            code: INVALID,
            error: anyhow!(
                "The replay differs from the record: the tool, the engine, the platform or the policy is another one, or \
                 the policy is not deterministic."
            ),
        })?;
        let title = if origin.named {
            format!("{}, episode {}", origin.name, entry.index())
        } else {
            format!("Episode {}", entry.index())
        };
        Ok(again.labelled(title, watch::command(&origin.path, entry.index())))
    }
}
