//! The entries of a dictionary, in order of their index.

use std::sync::Arc;

use crate::codec::Interner;
use crate::columns::{Cell, WrongCell};
use crate::{DatasetHash, DictionaryError, Entry, RowPlace};

use super::{Column, Dictionary, damaged};

/// The entries of a dictionary, in order.
#[derive(Debug)]
pub struct Entries<'a> {
    dictionary: &'a Dictionary,
    /// The next row group.
    group: usize,
    /// The columns of the current row group.
    data: Vec<Column>,
    /// The next row within the group.
    at: usize,
    rows_in_group: usize,
    /// The next row in the file.
    row: u64,
    last_index: Option<u64>,
    words: Interner,
    hash: DatasetHash,
    done: bool,
}

impl<'a> Entries<'a> {
    /// All entries of the dictionary, from the first.
    pub(super) fn of(dictionary: &'a Dictionary) -> Self {
        Self {
            dictionary,
            group: 0,
            data: Vec::new(),
            at: 0,
            rows_in_group: 0,
            row: 0,
            last_index: None,
            words: Interner::default(),
            hash: DatasetHash::new(Arc::clone(&dictionary.provenance.task)),
            done: false,
        }
    }
}

impl Entries<'_> {
    fn read(&mut self) -> Result<Option<Entry>, DictionaryError> {
        if self.at == self.rows_in_group {
            if self.group == self.dictionary.metadata.num_row_groups() {
                return self.check_hash().map(|()| None);
            }
            self.data = Vec::new();
            self.data = self.dictionary.read_group(self.group)?;
            self.rows_in_group = self.dictionary.metadata.row_group(self.group).num_rows() as usize;
            self.group += 1;
            self.at = 0;
        }
        let cells: Vec<Cell<'_>> = self.data.iter().map(|column| column.cell(self.at)).collect();
        let entry = self.dictionary.columns.unflatten(&cells, &mut self.words).map_err(|wrong| self.value(wrong))?;
        let index = entry.index();
        if let Some(previous) = self.last_index.filter(|previous| *previous >= index) {
            return Err(DictionaryError::Order { index, previous });
        }
        self.last_index = Some(index);
        self.hash.update(&entry);
        self.at += 1;
        self.row += 1;
        Ok(Some(entry))
    }

    fn check_hash(&mut self) -> Result<(), DictionaryError> {
        let found = self.hash.clone().finish();
        let dictionary = self.dictionary;
        if found == dictionary.dataset_hash {
            return Ok(());
        }
        let reason = format!("its rows have the dataset hash {found}. Expected {}", dictionary.dataset_hash);
        Err(damaged(&dictionary.path, "the dataset", reason))
    }

    fn value(&self, wrong: WrongCell) -> DictionaryError {
        let WrongCell { column, value, reason } = wrong;
        DictionaryError::Value {
            path: self.dictionary.path.clone(),
            place: RowPlace::Row(self.row),
            column,
            value,
            reason,
        }
    }
}

impl Iterator for Entries<'_> {
    type Item = Result<Entry, DictionaryError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let next = self.read().transpose();
        self.done = !matches!(next, Some(Ok(_)));
        next
    }
}
