//! What identifies the scenario of an imported row: its case and seed, otherwise all of its parameters.

use std::collections::BTreeSet;

use robogate_dictionary::results::{SOURCE_ROW, names_scenario};

use crate::comparison::dataset::Dataset;
use crate::table::{ParameterColumn, words};

/// The key of each row of two datasets, and the columns that it consists of.
pub(super) struct Keys {
    pub(super) by: Vec<String>,
    pub(super) of: [Vec<Vec<String>>; 2],
}

/// The shortest key that occurs once in each dataset. `None` if the rows of neither key are unique.
pub(super) fn common(one: &Dataset<'_>, rows: &[usize], two: &Dataset<'_>, others: &[usize]) -> Option<Keys> {
    let named = |dataset: &Dataset<'_>, name: &str| columns(dataset).any(|column| column.name == name);
    let shared: Vec<&str> = columns(one)
        .map(|column| column.name.as_str())
        .filter(|name| *name != SOURCE_ROW && named(two, name))
        .collect();
    let all_shared = [one, two]
        .iter()
        .all(|dataset| dataset.table.parameters.iter().all(|parameter| shared.contains(&parameter.name.as_str())));
    let labels: Vec<&str> = ["category", "group", "case"]
        .into_iter()
        .filter(|name| {
            [one, two].iter().all(|dataset| words(dataset.source.dictionary(), name).is_ok_and(|w| w.is_some()))
        })
        .collect();
    let identifying: Vec<&str> = shared.iter().copied().filter(|name| names_scenario(name)).collect();
    for by in [identifying, if all_shared { shared } else { Vec::new() }] {
        if by.is_empty() && labels.is_empty() {
            continue;
        }
        let of = [keys(one, rows, &labels, &by)?, keys(two, others, &labels, &by)?];
        if of.iter().all(|keys| keys.iter().collect::<BTreeSet<_>>().len() == keys.len()) {
            return Some(Keys { by: labels.iter().chain(&by).map(|name| (*name).to_owned()).collect(), of });
        }
    }
    None
}

fn columns<'a>(dataset: &'a Dataset<'_>) -> impl Iterator<Item = &'a ParameterColumn> {
    dataset.table.identifiers.iter().chain(&dataset.table.parameters)
}

fn keys(dataset: &Dataset<'_>, rows: &[usize], labels: &[&str], by: &[&str]) -> Option<Vec<Vec<String>>> {
    let labels: Vec<Vec<String>> =
        labels.iter().filter_map(|name| words(dataset.source.dictionary(), name).ok().flatten()).collect();
    let by: Vec<&ParameterColumn> =
        by.iter().map(|name| columns(dataset).find(|column| column.name == *name)).collect::<Option<_>>()?;
    let key = |row: &usize| {
        let labels = labels.iter().map(|words| words[*row].clone());
        labels.chain(by.iter().map(|column| column.exactly(column.values[*row]))).collect()
    };
    Some(rows.iter().map(key).collect())
}
