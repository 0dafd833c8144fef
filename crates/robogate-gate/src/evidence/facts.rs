//! Facts that are computed from the files of a folder, both when evidence is written and when it is verified.

use std::io;
use std::path::Path;

use robogate_dictionary::{Dictionary, TaskIdentity, Tool, file_digest, hex, read_regular_text};
use sha2::{Digest, Sha256};

use super::{
    AGAINST, BASELINE, DICTIONARY, EnvironmentBinding, EvidenceError, FileRecord, Manifest, PolicyBinding, Problem,
    REQUIREMENTS, afterwards, origin, question, registration,
};
use crate::{Against, Baseline, Evaluation, Question, RealEvidence, Record, Requirements, Sampling};

/// Computes the evaluation from the rows and requirements in the folder.
pub(super) fn evaluate(folder: &Path, sampling: Sampling, margin: Option<f64>) -> Result<Evaluation, EvidenceError> {
    let path = folder.join(REQUIREMENTS);
    let text = read_regular_text(&path).map_err(EvidenceError::io(&path, "read"))?;
    let requirements = Requirements::from_toml(&text)?;
    let path = folder.join(BASELINE);
    let baseline = if path.exists() {
        let text = read_regular_text(&path).map_err(EvidenceError::io(&path, "read"))?;
        Some(Baseline::from_json(&text)?)
    } else {
        None
    };
    let mut record = Record::of(&Dictionary::open(&folder.join(DICTIONARY))?)?.with_faults_in(folder)?;
    let path = folder.join(RealEvidence::FILE);
    if path.exists() {
        let text = read_regular_text(&path).map_err(EvidenceError::io(&path, "read"))?;
        record.real = Some(RealEvidence::from_json(&path, &text)?);
    }
    let other = match margin {
        Some(margin) => Some((Record::of(&Dictionary::open(&folder.join(AGAINST))?)?, margin)),
        None => None,
    };
    let against = other.as_ref().map(|(record, margin)| Against { record, margin: *margin });
    let question = Question { requirements: &requirements, baseline: baseline.as_ref(), against, sampling };
    Ok(question.evaluate(&record)?)
}

/// Contradictions between the files and the provenance of the rows.
pub(super) fn origin(folder: &Path, files: &[FileRecord]) -> Result<Vec<Problem>, EvidenceError> {
    let dictionary = Dictionary::open(&folder.join(DICTIONARY))?;
    let mut problems = origin::problems(folder, files, dictionary.provenance());
    problems.extend(afterwards::problems(folder, files, dictionary.provenance(), dictionary.dataset_hash()));
    Ok(problems)
}

/// Creates the manifest of these files and this evaluation.
pub(super) fn manifest(
    folder: &Path,
    tool: Tool,
    evaluation: &Evaluation,
    margin: Option<f64>,
    signer: Option<String>,
    files: Vec<FileRecord>,
) -> Result<Manifest, EvidenceError> {
    let dictionary = Dictionary::open(&folder.join(DICTIONARY))?;
    let provenance = dictionary.provenance();
    let question = question::binding(folder, &files, provenance, evaluation.sampling, margin)?;
    let registration = registration::check(folder, &files, provenance).map_err(EvidenceError::Contradicts)?;
    Ok(Manifest {
        format: Manifest::FORMAT,
        tool,
        verdict: evaluation.verdict,
        because: evaluation.because.clone(),
        counts: evaluation.counts,
        population: evaluation.population.clone(),
        sampling: evaluation.sampling,
        margin,
        dataset_sha256: dictionary.dataset_hash().to_owned(),
        seed: provenance.seed,
        policy: provenance.policy.clone(),
        policy_binding: PolicyBinding::of(provenance),
        question,
        registration,
        environment: EnvironmentBinding::of(provenance),
        task: TaskIdentity::of(&provenance.task),
        robot: provenance.robot.clone(),
        engine: provenance.engine.clone(),
        platform: provenance.platform.clone(),
        source: provenance.source.clone(),
        measured_by: provenance.tool.clone(),
        build: provenance.build.clone(),
        signer,
        files,
    })
}

/// Size and SHA-256 of a regular file.
pub(super) fn digest(path: &Path) -> io::Result<(u64, String)> {
    file_digest(path, u64::MAX, &mut |_| Ok(()))
}

pub(super) fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}
