//! Opens a dictionary in any supported format.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use robogate_dictionary::{Dictionary, DictionaryError, published, read_text, results};
use serde::Deserialize;

use crate::AnalysisError;

/// The file name of the dictionary in a run's folder.
const DICTIONARY: &str = "dictionary.parquet";
/// The file name of the boundary report in a run's folder.
const BOUNDARY: &str = "boundary.json";

/// An open dictionary, with the boundary report of its run.
#[derive(Debug)]
pub struct Source {
    dictionary: Dictionary,
    folder: Option<PathBuf>,
    boundary: Option<BoundaryFile>,
    /// The scratch file of an import. It is removed when the source is dropped.
    _scratch: Option<Scratch>,
}

/// The part of a run's `boundary.json` that is used: the ranges of the second stage.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct BoundaryFile {
    pub(crate) parameters: Vec<BoundarySpan>,
    pub(crate) volume: BoundaryRegion,
    #[serde(default)]
    pub(crate) emphasis: Option<BoundaryEmphasis>,
}

/// The range of one parameter in the second stage.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct BoundarySpan {
    pub(crate) parameter: String,
    pub(crate) drawn: [f64; 2],
    pub(crate) drawn_from: String,
}

/// A sampled region of the second stage: its points, and its share of the operating distribution.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct BoundaryRegion {
    #[serde(default)]
    pub(crate) episodes: u64,
    pub(crate) share_of_operating_space: f64,
}

/// The emphasis of the second stage. Its points come first.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct BoundaryEmphasis {
    pub(crate) region: BoundaryRegion,
}

impl Source {
    /// Opens a run's folder, a Parquet dictionary, a published JSON dictionary, or an exported CSV or JSON Lines file. The
    /// last three are imported into a scratch file.
    ///
    /// # Errors
    /// The problem with the path, with a hint.
    pub fn open(path: &Path) -> Result<Self, AnalysisError> {
        if path.is_dir() {
            let file = path.join(DICTIONARY);
            if !file.exists() {
                if !path.join("plan.json").exists() {
                    let reason = "the folder is not that of a run".to_owned();
                    return Err(AnalysisError::NotADictionary { path: path.to_owned(), reason });
                }
                return Err(AnalysisError::NoDictionaryInFolder { path: path.to_owned() });
            }
            let report = path.join(BOUNDARY);
            let boundary = match read_text(&report) {
                // Without a boundary report, or with one of another version, one table is missing from the page.
                Ok(text) => serde_json::from_str(&text).ok(),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
                Err(error) => return Err(DictionaryError::io(&report, "read")(error).into()),
            };
            let dictionary = Dictionary::open(&file)?;
            return Ok(Self { dictionary, folder: Some(path.to_owned()), boundary, _scratch: None });
        }
        let start = start(path)?;
        match start.first() {
            Some(b'P') => {
                Ok(Self { dictionary: Dictionary::open(path)?, folder: None, boundary: None, _scratch: None })
            }
            Some(_) => {
                let scratch = Scratch::new();
                if !results::import_export(path, &scratch.0)? {
                    if !is_published(&start) {
                        let reason = "it is not a dictionary; convert results of other tools with `robogate import`";
                        return Err(AnalysisError::NotADictionary { path: path.to_owned(), reason: reason.to_owned() });
                    }
                    published::import(path, &scratch.0)?;
                }
                let dictionary = Dictionary::open(&scratch.0)?;
                Ok(Self { dictionary, folder: None, boundary: None, _scratch: Some(scratch) })
            }
            None => {
                Err(AnalysisError::NotADictionary { path: path.to_owned(), reason: "the file is empty".to_owned() })
            }
        }
    }

    /// Imports results of another tool into a scratch file.
    ///
    /// # Errors
    /// Results that cannot be read, or that name several policies if the mapping does not choose one.
    pub fn import(path: &Path, mapping: &results::Mapping) -> Result<Self, AnalysisError> {
        let scratch = Scratch::new();
        results::import(path, &scratch.0, None, mapping)?;
        let dictionary = Dictionary::open(&scratch.0)?;
        Ok(Self { dictionary, folder: None, boundary: None, _scratch: Some(scratch) })
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// The run's folder, if the path was one.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    pub(crate) fn boundary(&self) -> Option<&BoundaryFile> {
        self.boundary.as_ref()
    }
}

/// The start of a file, with the keys of a published dictionary.
fn start(path: &Path) -> Result<Vec<u8>, AnalysisError> {
    const BYTES: u64 = 1 << 16;
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(BYTES).read_to_end(&mut start));
    read.map_err(AnalysisError::io(path, "read"))?;
    Ok(start)
}

/// Whether a file that starts in this way is a published dictionary.
fn is_published(start: &[u8]) -> bool {
    let text = String::from_utf8_lossy(start);
    let text = text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']);
    text.starts_with('{') && ["\"metadata\"", "\"experiments\"", "\"summary\""].iter().any(|key| text.contains(key))
}

/// A file in the system's temporary folder, removed on drop.
#[derive(Debug)]
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("robogate-analysis-{}-{number}.parquet", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // If this fails, the system cleans its temporary folder.
        let _ = fs::remove_file(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_other_tools_are_told_to_be_imported() {
        let folder = tempfile::tempdir().unwrap();
        for text in ["{\"success\": true}\n{\"success\": false}\n", "{\"eval_info\": {\"mean\": NaN}}", "a;b\n1;2\n"] {
            let file = folder.path().join("results");
            fs::write(&file, text).unwrap();
            let error = Source::open(&file).unwrap_err().to_string();
            assert!(error.contains("convert results of other tools with `robogate import`"), "{text}: {error}");
        }
        for text in ["\u{feff} {\n\"metadata\": {}", "{\"summary\": {}}"] {
            assert!(is_published(text.as_bytes()), "{text}");
        }
    }
}
