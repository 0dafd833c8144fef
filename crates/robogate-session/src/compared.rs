//! What a gate compares with: the run of another policy, and the figures of a baseline.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use robogate_analysis::Source;
use robogate_dictionary::Dictionary;
use robogate_gate::{Asked, Baseline, GateError, Record};

use crate::failure::{Failure, OrFailure};
use crate::source::open_source;

/// The built-in baselines.
const BASELINES: [&str; 1] = [include_str!("../../../assets/baselines/franka-industrial-68.json")];

/// Finds the built-in baseline for these scenarios and this robot.
pub fn built_in_baseline(record: &Record) -> Option<Baseline> {
    BASELINES
        .iter()
        .filter_map(|text| Baseline::from_json(text).ok())
        .find(|baseline| baseline.population.is_that_of(&record.population) && baseline.robot == record.robot)
}

/// Opens the run that a gate compares with.
///
/// # Errors
/// A run that has changed since the gate started.
pub fn compared_with(asked: &Asked) -> Result<Option<(PathBuf, Record)>, Failure> {
    let Some(against) = &asked.against else { return Ok(None) };
    let path = PathBuf::from(&against.path);
    let record = Record::of(open_source(&path)?.dictionary())?;
    if record.dataset_sha256 != against.dataset_sha256 {
        return Err(anyhow!(
            "{} has changed since this gate started. Expected the dataset that it was compared with",
            against.path
        ))
        .or_request();
    }
    Ok(Some((path, record)))
}

/// The episodes of a run or an import, with what its folder says about faults.
///
/// # Errors
/// Rows that cannot be judged.
pub fn record_of(source: &Source) -> Result<Record, GateError> {
    let record = Record::of(source.dictionary())?;
    match source.folder() {
        Some(folder) => record.with_faults_in(folder),
        None => Ok(record),
    }
}

/// The episodes of the run in `folder`, with the trials of the real robot that its gate was asked about.
///
/// # Errors
/// Rows that cannot be judged.
pub fn judged(folder: &Path, dictionary: &Dictionary, asked: &Asked) -> Result<Record, Failure> {
    Ok(Record { real: asked.real.clone(), ..Record::of(dictionary)?.with_faults_in(folder)? })
}
