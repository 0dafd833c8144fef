//! Recorded episodes, recomputed on demand.

use std::path::PathBuf;
use std::sync::Arc;

use robogate_dictionary::{Entry, Provenance};
use robogate_replay::Clip;

use crate::remote::Simulators;
use crate::subject::Subject;
use crate::watch::{self, Again};

/// Records episodes of the runs again.
pub(super) struct Clips {
    simulators: Simulators,
    /// Environment and policy of each run that an episode was recorded of.
    subjects: Vec<(usize, Result<Subject, String>)>,
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
    pub(super) fn new(simulators: Simulators) -> Self {
        Self { simulators, subjects: Vec::new() }
    }

    /// Records an episode. The error says in words why it cannot be shown.
    pub(super) fn clip(&mut self, origin: &Origin, entry: &Entry) -> Result<Clip, String> {
        if !self.subjects.iter().any(|(run, _)| *run == origin.run) {
            let subject = Subject::recorded(&origin.provenance, &self.simulators);
            self.subjects.push((origin.run, subject.map_err(|exit| exit.to_string())));
        }
        let subject = self.subjects.iter().find(|(run, _)| *run == origin.run).map(|(_, subject)| subject);
        let subject = match subject {
            Some(Ok(subject)) => subject,
            Some(Err(because)) => return Err(because.clone()),
            None => return Err("the run is not known".to_owned()),
        };
        let again = Again::of(subject, &entry.episode, false).map_err(|error| format!("{error:#}"))?.ok_or(
            "The replay differs from the record: the tool, the engine, the platform or the policy is another one, or the \
             policy is not deterministic.",
        )?;
        let title = if origin.named {
            format!("{}, episode {}", origin.name, entry.index())
        } else {
            format!("Episode {}", entry.index())
        };
        Ok(again.labelled(title, watch::command(&origin.path, entry.index())))
    }
}
