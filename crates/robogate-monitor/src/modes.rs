//! Failure modes as open words: counts by name, and the list that gives each mode of a recipe a code.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The mode of failures whose mode is unknown, missing, or not in the baseline.
pub const OTHER_MODE: &str = "other";
/// Maximum number of failure modes of one recipe. Failures with further modes count as [`OTHER_MODE`].
pub const MOST_MODES: usize = 32;
/// The modes of files and stores that contain counts without names, in the order of the counts.
const UNNAMED: [&str; 5] = ["grasp_miss", "grip_loss", "collision", "timeout", OTHER_MODE];

/// Failures by mode, serialised as a map from mode to count. Reads the five numbers without names of older versions
/// too.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "Form", into = "BTreeMap<String, u64>")]
pub struct ModeCounts(BTreeMap<String, u64>);

#[derive(Deserialize)]
#[serde(untagged)]
enum Form {
    Named(BTreeMap<String, u64>),
    Unnamed([u64; UNNAMED.len()]),
}

impl From<Form> for ModeCounts {
    fn from(form: Form) -> Self {
        match form {
            Form::Named(counts) => Self(counts),
            Form::Unnamed(counts) => UNNAMED.into_iter().zip(counts).collect(),
        }
    }
}

impl From<ModeCounts> for BTreeMap<String, u64> {
    fn from(counts: ModeCounts) -> Self {
        counts.0
    }
}

impl<S: Into<String>> FromIterator<(S, u64)> for ModeCounts {
    fn from_iter<I: IntoIterator<Item = (S, u64)>>(counts: I) -> Self {
        Self(counts.into_iter().map(|(mode, count)| (mode.into(), count)).collect())
    }
}

impl ModeCounts {
    /// Number of failures with this mode.
    pub fn of(&self, mode: &str) -> u64 {
        self.0.get(mode).copied().unwrap_or(0)
    }

    /// Number of all failures.
    pub fn total(&self) -> u64 {
        self.0.values().sum()
    }

    /// The modes, by name.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }
}

/// The failure modes of one recipe. The index of a mode is its code and never changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct ModeList(Vec<String>);

impl Default for ModeList {
    fn default() -> Self {
        Self(vec![OTHER_MODE.to_owned()])
    }
}

impl ModeList {
    /// The list for a stored recipe that has codes but no list.
    pub(crate) fn unnamed() -> Self {
        Self(UNNAMED.map(str::to_owned).to_vec())
    }

    /// Adds the modes of a baseline.
    pub(crate) fn include(&mut self, counts: Option<&ModeCounts>) {
        counts.into_iter().flat_map(ModeCounts::names).for_each(|mode| self.add(mode));
    }

    /// Adds a mode, unless it is known or the list is full.
    pub(crate) fn add(&mut self, mode: &str) {
        if self.0.len() < MOST_MODES && !self.0.iter().any(|known| known == mode) {
            self.0.push(mode.to_owned());
        }
    }

    /// The code of a mode. A mode that is not in the list has the code of [`OTHER_MODE`].
    pub(crate) fn code(&self, mode: &str) -> u8 {
        let place = |name: &str| self.0.iter().position(|known| known == name);
        // There are at most MOST_MODES codes.
        place(mode).or_else(|| place(OTHER_MODE)).unwrap_or(0) as u8
    }

    /// The mode of a code.
    pub(crate) fn name(&self, code: u8) -> &str {
        self.0.get(usize::from(code)).map_or(OTHER_MODE, String::as_str)
    }

    /// The modes in the order of their codes.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Number of modes.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_without_names_can_be_read() {
        let read = |json: &str| serde_json::from_str::<ModeCounts>(json).unwrap();
        let old = read("[4, 3, 2, 1, 0]");
        assert_eq!(old, read(r#"{"grasp_miss":4,"grip_loss":3,"collision":2,"timeout":1,"other":0}"#));
        assert_eq!((old.of("grip_loss"), old.total()), (3, 10));
        assert!(serde_json::to_string(&old).unwrap().starts_with(r#"{"collision":2"#));
    }

    #[test]
    fn unknown_modes_count_as_other() {
        let mut list = ModeList::default();
        list.include(Some(&ModeCounts::from_iter([("jammed", 3), ("spilled", 1)])));
        assert_eq!(["other", "jammed", "spilled", "burnt"].map(|mode| list.code(mode)), [0, 1, 2, 0]);
        assert_eq!((list.name(2), list.name(9)), ("spilled", OTHER_MODE));
    }

    #[test]
    fn the_list_is_bounded() {
        let mut list = ModeList::default();
        (0..100).for_each(|i| list.add(&format!("mode-{i}")));
        assert_eq!(list.len(), MOST_MODES);
        assert_eq!(list.code("mode-99"), list.code(OTHER_MODE));
    }
}
