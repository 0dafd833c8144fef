//! Whether datasets can be compared at all: one task, and one space or the shared part of several.

use robogate_core::Domain;

use super::dataset::Dataset;
use crate::table::{ParameterColumn, ParameterKind};
use crate::{ComparisonError, Population};

/// Rejects datasets of different tasks. The task of an import is known only if the user named it.
pub(super) fn check_tasks(datasets: &[Dataset<'_>]) -> Result<(), ComparisonError> {
    let named = |dataset: &&Dataset<'_>| dataset.provenance().task.name != "imported";
    let mut known = datasets.iter().filter(named);
    let Some(first) = known.next() else { return Ok(()) };
    let task = &first.provenance().task.name;
    match known.find(|dataset| dataset.provenance().task.name != *task) {
        None => Ok(()),
        Some(second) => Err(ComparisonError::DifferentTasks {
            first: first.name.clone(),
            task: task.to_string(),
            second: second.name.clone(),
            other: second.provenance().task.name.to_string(),
        }),
    }
}

/// Restricts the rows to the values that all compared datasets can have. Returns sentences on what was restricted.
///
/// # Errors
/// If the spaces differ and `common` is false, or if a dataset has no row in the shared part.
pub(super) fn restrict(datasets: &mut [Dataset<'_>], common: bool) -> Result<Vec<String>, ComparisonError> {
    let compared: Vec<usize> = (0..datasets.len()).filter(|at| datasets[*at].excluded_because().is_none()).collect();
    let mut different: Vec<(usize, String)> = Vec::new();
    for (place, at) in compared.iter().enumerate().skip(1) {
        let found = differences(&datasets[compared[0]], &datasets[*at]);
        if !found.is_empty() {
            different.push((place, found.join("; ")));
        }
    }
    let Some((place, difference)) = different.first().cloned() else { return Ok(Vec::new()) };
    if !common {
        let (first, second) = (datasets[compared[0]].name.clone(), datasets[compared[place]].name.clone());
        return Err(ComparisonError::DifferentSpaces { first, second, difference });
    }
    let shared = shared(datasets, &compared);
    let mut sentences = Vec::new();
    for at in &compared {
        let dataset = &mut datasets[*at];
        let before = dataset.base.len();
        let tests: Vec<(usize, &Shared)> = shared
            .iter()
            .filter_map(|of| Some((dataset.base.parameters.iter().position(|p| p.name == of.name())?, of)))
            .collect();
        let kept: Vec<bool> = (0..before)
            .map(|row| tests.iter().all(|(place, of)| of.holds(&dataset.base.parameters[*place], row)))
            .collect();
        dataset.base = dataset.base.restricted(&kept);
        if dataset.base.len() == 0 {
            return Err(ComparisonError::NothingShared { name: dataset.name.clone() });
        }
        sentences.push(format!("{}: {} of {before} rows are in the shared ranges.", dataset.name, dataset.base.len()));
    }
    Ok(sentences)
}

/// How the spaces of two datasets differ. The ranges of imported rows are observed ones, so they are not compared.
fn differences(first: &Dataset<'_>, second: &Dataset<'_>) -> Vec<String> {
    let imported = [first, second].iter().any(|dataset| dataset.population == Population::AsImported);
    let (one, two) = (&first.provenance().space, &second.provenance().space);
    let lacks = |name: &str, of: &Dataset<'_>| format!("`{name}` is missing in {}", of.name);
    let known = |dataset: &Dataset<'_>, name: &str| dataset.parameter(name).is_some();
    let mut found = Vec::new();
    for parameter in one.parameters().iter().filter(|p| known(first, &p.name)) {
        match two.parameters().iter().find(|other| other.name == parameter.name) {
            None => found.push(lacks(&parameter.name, second)),
            Some(other) if !imported && other.domain != parameter.domain => {
                found.push(format!("`{}` is {} and {}", parameter.name, show(&parameter.domain), show(&other.domain)));
            }
            Some(_) => {}
        }
    }
    let extra = two.parameters().iter().filter(|p| known(second, &p.name) && one.position(&p.name).is_none());
    found.extend(extra.map(|parameter| lacks(&parameter.name, first)));
    found
}

fn show(domain: &Domain) -> String {
    match domain {
        Domain::Continuous { low, high, .. } => format!("{low} to {high}"),
        Domain::Integer { low, high } => format!("{low} to {high}"),
        Domain::Categorical { choices } => choices.iter().map(|c| c.to_string()).collect::<Vec<_>>().join("/"),
    }
}

/// The values of a parameter that all datasets with this parameter can have.
enum Shared {
    Range { name: String, low: f64, high: f64 },
    Levels { name: String, levels: Vec<String> },
}

impl Shared {
    fn name(&self) -> &str {
        match self {
            Self::Range { name, .. } | Self::Levels { name, .. } => name,
        }
    }

    fn holds(&self, column: &ParameterColumn, row: usize) -> bool {
        let value = column.values[row];
        match (self, &column.kind) {
            (Self::Levels { levels, .. }, ParameterKind::Categorical { levels: all }) => {
                all.get(value as usize).is_some_and(|level| levels.contains(level))
            }
            (Self::Range { low, high, .. }, _) => (*low..=*high).contains(&value),
            (Self::Levels { .. }, _) => true,
        }
    }
}

fn shared(datasets: &[Dataset<'_>], compared: &[usize]) -> Vec<Shared> {
    let all: Vec<&Dataset<'_>> = compared.iter().map(|at| &datasets[*at]).collect();
    let Some(first) = all.first() else { return Vec::new() };
    let mut found = Vec::new();
    for column in &first.base.parameters {
        let columns: Vec<&ParameterColumn> = all.iter().filter_map(|dataset| dataset.parameter(&column.name)).collect();
        if columns.len() < all.len() || columns.iter().any(|other| other.is_numeric() != column.is_numeric()) {
            continue;
        }
        let name = column.name.clone();
        found.push(if let ParameterKind::Categorical { levels } = &column.kind {
            let everywhere = |level: &&String| {
                columns
                    .iter()
                    .all(|other| matches!(&other.kind, ParameterKind::Categorical { levels } if levels.contains(level)))
            };
            Shared::Levels { name, levels: levels.iter().filter(everywhere).cloned().collect() }
        } else {
            let ends = |other: &&ParameterColumn| match other.kind {
                ParameterKind::Continuous { low, high, .. } => [low, high],
                ParameterKind::Integer { low, high } => [low as f64, high as f64],
                ParameterKind::Categorical { .. } => [f64::NEG_INFINITY, f64::INFINITY],
            };
            let low = columns.iter().map(|c| ends(c)[0]).fold(f64::NEG_INFINITY, f64::max);
            let high = columns.iter().map(|c| ends(c)[1]).fold(f64::INFINITY, f64::min);
            Shared::Range { name, low, high }
        });
    }
    found
}
