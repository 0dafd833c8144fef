//! Recognises rows that are averages over several episodes. A rate of 1 would be taken for one success.

use std::collections::BTreeMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::Path;

use super::names;
use crate::raw::{RawRow, Scalar};
use crate::{DictionaryError, RowPlace};

/// Names of columns that count the episodes of a row, in the form of [`names::plain`].
const COUNTS: [&str; 16] = [
    "n_episodes",
    "num_episodes",
    "episodes",
    "episode_count",
    "n_eval_episodes",
    "num_eval_episodes",
    "n_rollouts",
    "num_rollouts",
    "rollouts",
    "n_trials",
    "num_trials",
    "trials",
    "n_runs",
    "num_runs",
    "attempts",
    "count",
];

/// Words of columns that name a task.
const TASKS: [&str; 6] = ["task", "case", "suite", "env", "environment", "scenario"];

/// The rows of one task.
#[derive(Debug, Default)]
struct OfTask {
    rows: u64,
    /// The most episodes that a row counts, with the row.
    most: u64,
    at: RowPlace,
}

/// What the rows say about the number of their episodes.
#[derive(Debug)]
pub(super) struct Aggregates {
    /// The column of success, if its name says that it is a rate and no mapping names it.
    rate: Option<String>,
    /// The column that counts episodes.
    counted: Option<String>,
    /// Whether a column identifies single episodes.
    single: bool,
    tasks: BTreeMap<u64, OfTask>,
    named: bool,
}

impl Aggregates {
    /// Looks at files whose success is in the column `success`. `mapped`: a mapping names this column.
    pub(super) fn new(success: &str, mapped: bool) -> Self {
        let says_rate =
            names::plain(success).split('_').any(|word| ["rate", "percent", "pct", "mean", "avg"].contains(&word));
        let rate = (says_rate && !mapped).then(|| success.to_owned());
        Self { rate, counted: None, single: false, tasks: BTreeMap::new(), named: false }
    }

    pub(super) fn take(&mut self, row: &RawRow) {
        if self.single {
            return;
        }
        let mut task = DefaultHasher::new();
        let mut count = 0;
        for (name, value) in &row.fields {
            let plain = names::plain(name);
            let n = match value {
                Scalar::Null => continue,
                Scalar::Integer(n) => u64::try_from(*n).unwrap_or(0),
                Scalar::Number(x) if x.fract().abs() <= 0.0 && *x > 0.0 => *x as u64,
                _ => 0,
            };
            let words: Vec<&str> = plain.split('_').collect();
            if COUNTS.contains(&plain.as_str()) {
                count = n;
                self.counted.get_or_insert_with(|| name.to_string());
            } else if words.contains(&"seed")
                || words.iter().any(|w| ["episode", "rollout", "trial", "ep"].contains(w)) && !words.contains(&"length")
            {
                self.single = true;
            } else if words.iter().any(|word| TASKS.contains(word)) && !words.contains(&"success") {
                self.named = true;
                value.show().hash(&mut task);
            }
        }
        let task = self.tasks.entry(task.finish()).or_default();
        task.rows += 1;
        if count > task.most {
            (task.most, task.at) = (count, row.place());
        }
    }

    /// Returns an error if the rows are averages.
    pub(super) fn check(&self, path: &Path) -> Result<(), DictionaryError> {
        if self.single {
            return Ok(());
        }
        let refuse = |reason: String| {
            Err(DictionaryError::results(
                path,
                format!(
                    "{reason}. Expected one row per episode\nHint: write one row for each episode, with true or false"
                ),
            ))
        };
        // A setting that every episode repeats is at most the number of the rows.
        if let Some(column) = &self.counted
            && let Some(task) =
                self.tasks.values().filter(|task| task.most > task.rows.max(1)).min_by_key(|task| task.at)
        {
            return refuse(format!(
                "{}: `{column}` is {}, but the number of rows of its task is {}: the rows are averages over episodes",
                task.at, task.most, task.rows
            ));
        }
        if let Some(column) = &self.rate
            && self.named
            && self.tasks.len() > 1
            && self.tasks.values().all(|task| task.rows == 1)
        {
            return refuse(format!(
                "`{column}` names a rate, and each of the {} rows has its own task: the rows can be averages over \
                 episodes. If each row is one episode, say so with --map success={column}",
                self.tasks.len()
            ));
        }
        Ok(())
    }
}
