//! What documents of a folder of evidence are about.

use std::path::Path;

use robogate_core::budget::Budget;
use robogate_dictionary::{Dictionary, Place, PolicyRecord, Provenance, read_regular_text};
use serde_json::Value;

use super::{
    Covered, EvidenceError, FileRecord, Problem, QuestionBinding, Registered, Role, coverage, question, registration,
};
use crate::{Evaluation, GateError};

/// What documents of a folder of evidence are about: the files that the verdict depends on, and the facts that follow from them.
#[derive(Debug)]
pub struct Judged<'a> {
    /// The evaluation of the rows.
    pub evaluation: &'a Evaluation,
    /// The rows.
    pub dictionary: &'a Dictionary,
    /// The files, without documents that follow from them and without the key of the signer.
    pub files: Vec<FileRecord>,
    /// How the judged question relates to the one that the gate was asked.
    pub question: QuestionBinding,
    /// The registration of the run before its first episode.
    pub registration: Option<Registered>,
    folder: &'a Path,
}

impl<'a> Judged<'a> {
    /// What a folder with these files is about. `margin` is that of its comparison.
    ///
    /// # Errors
    /// If a file contradicts the rows or cannot be read.
    pub fn of(
        folder: &'a Path,
        evaluation: &'a Evaluation,
        dictionary: &'a Dictionary,
        files: &[FileRecord],
        margin: Option<f64>,
    ) -> Result<Self, EvidenceError> {
        let derived = |file: &&FileRecord| !matches!(file.role, Role::Compliance | Role::PublicKey);
        let files: Vec<FileRecord> = files.iter().filter(derived).cloned().collect();
        let provenance = dictionary.provenance();
        Ok(Self {
            question: question::binding(folder, &files, provenance, evaluation.sampling, margin)?,
            registration: registration::check(folder, &files, provenance).map_err(EvidenceError::Contradicts)?,
            evaluation,
            dictionary,
            files,
            folder,
        })
    }

    /// The record of how the rows were made.
    pub fn provenance(&self) -> &Provenance {
        self.dictionary.provenance()
    }

    /// The files with this role.
    pub fn with_role(&self, role: Role) -> impl Iterator<Item = &FileRecord> {
        self.files.iter().filter(move |file| file.role == role)
    }

    /// Whether the policy is not a part of RoboGate or of the environment, so that its connection can be wrong.
    pub fn policy_is_connected(&self) -> bool {
        let policy = self.provenance().world.as_ref().and_then(|world| world.policy.as_ref());
        matches!(policy, Some(PolicyRecord::External(_) | PolicyRecord::Hosted { from: Some(_), .. }))
    }

    /// Whether the environment is not built into RoboGate.
    pub fn environment_is_foreign(&self) -> bool {
        let place = self.provenance().world.as_ref().map(|world| &world.place);
        matches!(place, Some(Place::Python(_) | Place::Servers { .. }))
    }

    /// What the valid episodes cover of each operating range.
    ///
    /// # Errors
    /// If a row cannot be read.
    pub fn coverage(&self) -> Result<Vec<Covered>, GateError> {
        coverage::of(self)
    }

    /// The content of a file as JSON.
    ///
    /// # Errors
    /// If it is not JSON, or not within the budget for files.
    pub fn json(&self, file: &FileRecord) -> Result<Value, Problem> {
        json(self.folder, file)
    }
}

/// The content of a file of the folder as JSON.
pub(super) fn json(folder: &Path, file: &FileRecord) -> Result<Value, Problem> {
    let wrong = |reason: String| Problem::new(file.path.as_str(), reason);
    let text =
        read_regular_text(&folder.join(&file.path)).map_err(|error| wrong(format!("cannot be read: {error}")))?;
    Budget::FILE.json(text.as_bytes()).map_err(|error| wrong(format!("not JSON: {error}")))
}
