//! Binds evidence to the question that the gate was asked before its first episode.

use std::fmt;
use std::path::Path;

use robogate_dictionary::{Provenance, read_regular_text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{BASELINE, EvidenceError, FileRecord, Problem, REQUIREMENTS};
use crate::{Asked, Baseline, RealEvidence, Requirements, Sampling};

/// How the judged question relates to the one that the gate was asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum QuestionBinding {
    /// The same question. The rows name its hash.
    AsAsked,
    /// Another question than that of the gate.
    Reasked {
        /// The parts that differ: `requirements`, `baseline`, `margin`, `real trials`, `sampling`.
        changed: Vec<String>,
    },
    /// The rows name no question: no gate started the run. The question may have been chosen after
    /// the results were known.
    Afterwards,
}

impl fmt::Display for QuestionBinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AsAsked => f.write_str("the question that the gate was asked before its first episode"),
            Self::Reasked { changed } => {
                write!(f, "REASKED: {} differ from those that the gate was asked", changed.join(", "))
            }
            Self::Afterwards => f.write_str("the rows do not name a question: it may have been chosen after the run"),
        }
    }
}

/// Compares the question in the folder with the one that the rows name.
pub(super) fn binding(
    folder: &Path,
    files: &[FileRecord],
    provenance: &Provenance,
    sampling: Sampling,
    margin: Option<f64>,
) -> Result<QuestionBinding, EvidenceError> {
    let wrong = |reason: &str| Err(EvidenceError::Contradicts(Problem::new(Asked::FILE, reason)));
    let asked = listed(folder, files, Asked::FILE)?;
    let asked = asked.map(|text| Asked::from_json(Path::new(Asked::FILE), &text)).transpose()?;
    let asked = match (&provenance.question_sha256, asked) {
        (None, None) => return Ok(QuestionBinding::Afterwards),
        (Some(_), None) => {
            return wrong("missing: a gate started this run, and the evidence must contain its question");
        }
        (Some(recorded), Some(asked)) if asked.sha256() != *recorded => {
            return wrong("not the question that the gate was asked: the rows name another one");
        }
        (_, Some(asked)) => asked,
    };
    let path = folder.join(REQUIREMENTS);
    let text = read_regular_text(&path).map_err(EvidenceError::io(&path, "read"))?;
    let requirements = Requirements::from_toml(&text)?;
    let baseline = listed(folder, files, BASELINE)?.map(|text| Baseline::from_json(&text)).transpose()?;
    let real = listed(folder, files, RealEvidence::FILE)?;
    let real = real.map(|text| RealEvidence::from_json(Path::new(RealEvidence::FILE), &text)).transpose()?;
    let changed: Vec<String> = [
        ("requirements", requirements != asked.requirements),
        ("baseline", baseline != asked.baseline),
        ("margin", margin != asked.against.as_ref().map(|against| against.margin)),
        ("real trials", real != asked.real),
        // A stricter test than the one asked for changes nothing in favour of the policy.
        ("sampling", asked.sampling == Sampling::Sequential && sampling == Sampling::Fixed),
    ]
    .into_iter()
    .filter(|(_, differs)| *differs)
    .map(|(name, _)| name.to_owned())
    .collect();
    Ok(match provenance.question_sha256 {
        _ if !changed.is_empty() => QuestionBinding::Reasked { changed },
        Some(_) => QuestionBinding::AsAsked,
        None => QuestionBinding::Afterwards,
    })
}

/// The content of a file that the evidence may leave out. `None` if its list does not contain it.
fn listed(folder: &Path, files: &[FileRecord], name: &str) -> Result<Option<String>, EvidenceError> {
    if !files.iter().any(|file| file.path == name) {
        return Ok(None);
    }
    let path = folder.join(name);
    read_regular_text(&path).map(Some).map_err(EvidenceError::io(&path, "read"))
}
