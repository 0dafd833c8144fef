//! Tests that files of RoboGate 0.1 are read correctly.

use std::fs;
use std::path::{Path, PathBuf};

use robogate_dictionary::{
    Dictionary, Entry, Journal, SCHEMA_VERSION, SchemaVersion, export, published, v1, write_parquet,
};

use crate::common::{Folder, PLAN};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/v0.1").join(name)
}

/// The rows. The last one would be an error if the dataset hash differed.
fn entries(dictionary: &Dictionary) -> Vec<Entry> {
    dictionary.entries().collect::<Result<_, _>>().unwrap()
}

fn csv(dictionary: &Dictionary) -> String {
    let mut csv = Vec::new();
    export::csv(dictionary, &mut csv).unwrap();
    String::from_utf8(csv).unwrap()
}

/// The same rows in a file of the current schema.
fn rewritten(old: &Dictionary) -> (SchemaVersion, String) {
    let folder = Folder::new("v0.1");
    let path = folder.join(old.dataset_hash());
    write_parquet(&path, old.provenance(), old.entries()).unwrap();
    let new = Dictionary::open(&path).unwrap();
    (new.schema_version(), new.dataset_hash().to_owned())
}

#[test]
fn recorded_run_is_read() {
    let old = Dictionary::open(&fixture("run/dictionary.parquet")).unwrap();
    assert_eq!(old.schema_version(), SchemaVersion { major: 1, minor: 1 });
    assert_eq!(*old.provenance().task, v1::task());
    assert_eq!(old.provenance().policy, "scripted");
    let rows = entries(&old);
    let outcomes = rows.iter().map(|entry| entry.episode.outcome.as_str());
    assert_eq!(
        outcomes.collect::<std::collections::BTreeSet<_>>(),
        ["collision", "grasp_miss", "grip_loss", "success", "timeout"].into()
    );
    let summary: serde_json::Value = serde_json::from_slice(&fs::read(fixture("run/summary.json")).unwrap()).unwrap();
    assert_eq!((summary["episodes"].as_u64(), summary["dataset_hash"].as_str()), (Some(12), Some(old.dataset_hash())));
    assert_eq!((rows.len(), csv(&old)), (12, fs::read_to_string(fixture("run.csv")).unwrap()));
}

#[test]
fn imported_dictionary_is_read() {
    let old = Dictionary::open(&fixture("published.parquet")).unwrap();
    assert_eq!(*old.provenance().task, v1::task());
    assert_eq!((entries(&old).len(), csv(&old)), (20, fs::read_to_string(fixture("published.csv")).unwrap()));
    let folder = Folder::new("v0.1-import");
    let again = published::import(&fixture("published.json"), &folder.join("d.parquet")).unwrap();
    assert_eq!(again.written.dataset_hash, old.dataset_hash());
}

#[test]
fn rewritten_rows_keep_their_hash() {
    for name in ["run/dictionary.parquet", "published.parquet", "schema-1.0.parquet"] {
        let old = Dictionary::open(&fixture(name)).unwrap();
        assert_eq!(rewritten(&old), (SCHEMA_VERSION, old.dataset_hash().to_owned()), "{name}");
    }
}

/// Recorded before labels existed.
#[test]
fn schema_1_0_has_no_labels() {
    let old = Dictionary::open(&fixture("schema-1.0.parquet")).unwrap();
    assert_eq!(old.schema_version(), SchemaVersion { major: 1, minor: 0 });
    assert!(old.column_names().all(|name| !["case", "category", "group"].contains(&name)));
    let entries = entries(&old);
    assert_eq!(entries.len(), 12);
    assert!(entries.iter().all(|entry| entry.label.is_empty()));
}

#[test]
fn unfinished_0_1_run_is_rejected() {
    let folder = Folder::new("v0.1-journal");
    let path = folder.join("journal.rgj");
    fs::copy(fixture("journal.rgj"), &path).unwrap();
    let error = Journal::open(&path, &PLAN).unwrap_err().to_string();
    assert!(error.contains("started with robogate 0.1") && error.contains("finish it with that version"), "{error}");
    assert!(fs::read(&path).unwrap() == fs::read(fixture("journal.rgj")).unwrap(), "the file is unchanged");
}
