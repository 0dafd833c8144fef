//! Synthetic dictionaries on disk for comparisons. The tests of `robogate-report` use this file too.

use std::path::PathBuf;

use robogate_analysis::Source;
use robogate_core::{Outcome, ParameterSpace};
use robogate_dictionary::{DictionaryError, Dimensions, Entry, write_parquet};
use tempfile::TempDir;

use crate::synthetic::{entry, outcome, point, provenance, space};

pub(crate) fn boxes() -> ParameterSpace {
    space(&["box", "sphere"])
}

/// Writes a dictionary with a robot of this name.
pub(crate) fn saved(dir: &TempDir, robot: &str, space: &ParameterSpace, entries: Vec<Entry>) -> (Source, PathBuf) {
    let path = dir.path().join(format!("{robot}.parquet"));
    let mut provenance = provenance(space.clone());
    provenance.robot.name = robot.to_owned();
    provenance.robot.dimensions = Some(Dimensions { reach_m: 1.0, payload_kg: 3.0, workspace_m: 0.5 });
    write_parquet(&path, &provenance, entries.into_iter().map(Ok::<_, DictionaryError>)).unwrap();
    (Source::open(&path).unwrap(), path)
}

/// The same points, with outcomes that `went` chooses from the index and the outcome of the law.
pub(crate) fn changed(space: &ParameterSpace, n: u64, went: impl Fn(u64, Outcome) -> Outcome) -> Vec<Entry> {
    (0..n)
        .map(|i| {
            let requested = point(space, i);
            let by_law = outcome(i, &requested);
            entry(i, requested, went(i, by_law))
        })
        .collect()
}
