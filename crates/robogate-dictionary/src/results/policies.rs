//! The policies of a table: a dictionary has the rows of one, so that its rate is that of a policy.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Format, Input, Mapping, Role, exported};
use crate::DictionaryError;
use crate::raw::{RawRow, Scalar};

/// More values are not policies.
const MOST_POLICIES: usize = 100;

/// The column of the policy, and the number of rows of each.
#[derive(Debug, Default)]
pub(super) struct Policies {
    column: Option<String>,
    rows: BTreeMap<String, u64>,
}

/// The policies whose rows a file contains, sorted. Empty if no column names the policy.
///
/// # Errors
/// If the file cannot be read, has too many policies, or only some of its rows name one.
pub fn policies(path: &Path, format: Option<Format>, mapping: &Mapping) -> Result<Vec<String>, DictionaryError> {
    let input = Input::new(path, format)?;
    if input.format == Format::Published || exported::is_export(path, input.format) {
        return Ok(Vec::new());
    }
    let columns = input.columns();
    let mapping = mapping.over(&input.format.mapping()).found_in(&columns);
    Ok(Policies::of(&input, &mapping, &columns)?.rows.into_keys().collect())
}

impl Policies {
    pub(super) fn of(input: &Input<'_>, mapping: &Mapping, columns: &[String]) -> Result<Self, DictionaryError> {
        let path = input.path;
        let column = mapping.column(Role::Policy);
        if mapping.names_parameter(column) || mapping.ignores(column) || !columns.iter().any(|name| name == column) {
            return Ok(Self::default());
        }
        let mut found = Self { column: Some(column.to_owned()), rows: BTreeMap::new() };
        let mut unnamed: Option<DictionaryError> = None;
        input.read(&mut |row| {
            let name = found.name_of(row);
            if name.trim().is_empty() {
                unnamed.get_or_insert_with(|| {
                    let reason = format!(
                        "names no policy, although other rows name one\nHint: fill it in, or leave the column out with \
                         --map ignore={column}"
                    );
                    row.wrong(path, column, reason)
                });
                return Ok(());
            }
            *found.rows.entry(name).or_insert(0) += 1;
            if found.rows.len() > MOST_POLICIES {
                let reason = format!(
                    "column `{column}` has more than {MOST_POLICIES} values, which are not policies\nHint: give it another role, for \
                     example with --map parameter.{column}={column}"
                );
                return Err(DictionaryError::results(path, reason));
            }
            Ok(())
        })?;
        match unnamed {
            Some(error) if !found.rows.is_empty() => Err(error),
            // A column without any value names no policy.
            _ => Ok(found),
        }
    }

    fn name_of(&self, row: &RawRow) -> String {
        match self.column.as_ref().and_then(|column| row.get(column)) {
            None | Some(Scalar::Null) => String::new(),
            Some(Scalar::Text(name)) => name.clone(),
            Some(value) => value.show(),
        }
    }

    /// The only policy.
    pub(super) fn only(&self) -> Option<String> {
        self.rows.keys().next().filter(|_| self.rows.len() == 1).cloned()
    }

    /// The policy whose rows are imported. `None` for all rows, if the file has one policy at most.
    pub(super) fn chosen<'a>(&self, path: &Path, wanted: Option<&'a str>) -> Result<Option<&'a str>, DictionaryError> {
        let several = self.rows.len() > 1;
        match wanted {
            Some(name) if several && self.rows.contains_key(name) => Ok(Some(name)),
            _ if several => {
                let names: Vec<String> = self.rows.keys().map(|name| format!("`{}`", name.escape_debug())).collect();
                let lacks = wanted.map_or_else(String::new, |name| format!(", and not `{}`", name.escape_debug()));
                let reason = format!(
                    "column `{}` names {} policies: {}{lacks}. A dictionary has the rows of one\nHint: import each with --policy NAME",
                    self.column.as_deref().unwrap_or_default(),
                    names.len(),
                    names.join(", ")
                );
                Err(DictionaryError::results(path, reason))
            }
            _ => Ok(None),
        }
    }

    /// Whether a row is imported.
    pub(super) fn keeps(&self, chosen: Option<&str>, row: &RawRow) -> bool {
        chosen.is_none_or(|name| self.name_of(row) == name)
    }

    /// What was left out, as a sentence.
    pub(super) fn note(&self, chosen: Option<&str>) -> Option<String> {
        let name = chosen?;
        let (all, kept) = (self.rows.values().sum::<u64>(), self.rows.get(name).copied().unwrap_or(0));
        Some(format!("Rows of the policy `{name}`: {kept} of {all}. Those of the other policies are left out."))
    }
}
