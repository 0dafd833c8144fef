//! One dataset of a comparison: its rows, its name, and whether it can be compared.

use std::path::{Path, PathBuf};

use robogate_dictionary::{CellPlace, Place, Provenance, RendererRecord};

use crate::replay::shell_word;
use crate::table::{EpisodeTable, ParameterColumn, Sample};
use crate::weighting::{Counted, Weighting};
use crate::{AnalysisError, ComparisonError, Finding, Population, Source};

/// One dataset of a comparison.
pub(crate) struct Dataset<'a> {
    pub(crate) name: String,
    pub(crate) source: &'a Source,
    pub(crate) path: &'a Path,
    pub(crate) table: EpisodeTable,
    pub(crate) base: Sample,
    pub(crate) population: Population,
    pub(crate) weighting: Option<Finding<Weighting>>,
}

impl<'a> Dataset<'a> {
    pub(crate) fn read(
        source: &'a Source,
        path: &'a Path,
        name: String,
        groups: &[String],
    ) -> Result<Self, AnalysisError> {
        let table = EpisodeTable::read(source.dictionary())?;
        let Counted { mut base, population, weighting } = Counted::of(&table, source.boundary());
        base.depend(&table, population, groups)?;
        Ok(Self { name, source, path, table, base, population, weighting })
    }

    pub(crate) fn provenance(&self) -> &Provenance {
        self.source.dictionary().provenance()
    }

    pub(crate) fn parameter(&self, name: &str) -> Option<&ParameterColumn> {
        self.base.parameter(name)
    }

    /// The command that replays an episode, if the source is a run's folder.
    pub(crate) fn replay(&self, index: u64) -> Option<String> {
        let folder = self.source.folder().filter(|_| self.provenance().source.is_none())?;
        Some(format!("robogate replay {} {index}", shell_word(&folder.display().to_string())))
    }

    /// Why its episodes make no pairs with those of other datasets. `None` if they follow from their seeds, or if this was not tried.
    pub(crate) fn unpaired(&self) -> Option<String> {
        self.provenance().controls()?.repeats?.unpaired()
    }

    /// Why its rate cannot be compared with the others. `None` if it can.
    pub(crate) fn excluded_because(&self) -> Option<&'static str> {
        if self.table.len() == 0 {
            Some("it has no episode")
        } else if self.base.len() == 0 {
            Some("it has no valid episode")
        } else if self.population == Population::FocusedDesign {
            Some("its rows come from a focused design only, which does not estimate the operating space")
        } else {
            None
        }
    }
}

/// Returns an error for a single source, and for duplicate rows.
pub(crate) fn check_distinct(sources: &[(Source, PathBuf)]) -> Result<(), ComparisonError> {
    if sources.len() < 2 {
        return Err(ComparisonError::TooFew { found: sources.len() });
    }
    for (i, (source, path)) in sources.iter().enumerate() {
        for (other, before) in &sources[..i] {
            let (one, two) = (source.dictionary(), other.dictionary());
            // Two policies may have the same outcomes in the same scenarios.
            let same_policy = one.provenance().policy == two.provenance().policy;
            if !one.is_empty() && same_policy && one.dataset_hash() == two.dataset_hash() {
                return Err(ComparisonError::SameTwice { first: before.clone(), second: path.clone() });
            }
        }
    }
    Ok(())
}

/// A name for each dataset: as given, otherwise the first of robot, engine, policy, renderer and file name that differs
/// between all of them.
pub(crate) fn names(sources: &[(Source, PathBuf)], given: &[String]) -> Result<Vec<String>, ComparisonError> {
    if !given.is_empty() {
        if given.len() != sources.len() {
            return Err(ComparisonError::Names { given: given.len(), datasets: sources.len() });
        }
        if let Some(name) = repeated(given) {
            return Err(ComparisonError::NameTwice { name: name.clone() });
        }
        return Ok(given.to_vec());
    }
    let all = |attribute: fn(&Provenance) -> &str| -> Vec<String> {
        sources.iter().map(|(source, _)| attribute(source.dictionary().provenance()).to_owned()).collect()
    };
    let stems: Vec<String> = sources.iter().map(|(_, path)| stem(path)).collect();
    for names in [all(|p| &p.robot.name), all(|p| &p.engine.name), all(|p| &p.policy), all(renderer), stems] {
        let known = names.iter().all(|name| !name.is_empty() && name != "unknown");
        if known && repeated(&names).is_none() {
            return Ok(names);
        }
    }
    Ok(sources.iter().enumerate().map(|(i, (_, path))| format!("{} {}", i + 1, stem(path))).collect())
}

/// The renderer in the provenance of a built-in world. The provenance contains no entry for the embedded one.
fn renderer(provenance: &Provenance) -> &str {
    match provenance.world.as_ref().map(|world| &world.place) {
        Some(Place::Cell(CellPlace { renderer: None, .. })) => "embedded",
        Some(Place::Cell(CellPlace { renderer: Some(RendererRecord::Egl { .. }), .. })) => "egl",
        _ => "unknown",
    }
}

fn repeated(names: &[String]) -> Option<&String> {
    names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)).map(|(_, name)| name)
}

/// The name of the folder, or of the file without its extension. A dictionary in a run's folder has the folder's name.
fn stem(path: &Path) -> String {
    let of = if path.is_dir() { path.file_name() } else { path.file_stem() };
    let name = of.map(|name| name.to_string_lossy().into_owned());
    match name {
        Some(name) if name != "dictionary" => name,
        _ => {
            let full = path.canonicalize().unwrap_or_else(|_| path.to_owned());
            let folder = if full.is_dir() { Some(full.as_path()) } else { full.parent() };
            folder.and_then(Path::file_name).map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into())
        }
    }
}
