//! Reads a journal while another process writes it.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::codec::{self, Interner};
use crate::frame::{HEAD, parse_head};
use crate::journal::{HEADER, check_header};
use crate::{DictionaryError, Entry, PlanHash};

/// Follows a journal that another process may write. It takes no lock and changes nothing.
///
/// An incomplete record at the end is not an error: it may be in the process of being written. The next call reads it.
#[derive(Debug)]
pub struct JournalTail {
    path: PathBuf,
    plan: PlanHash,
    /// Where the next record starts. 0 before the header was read.
    end: u64,
    /// The offset of each episode, by index.
    places: HashMap<u64, u64>,
    words: Interner,
    buffer: Vec<u8>,
}

impl JournalTail {
    /// Follows the journal `path` of the campaign with this plan. The file need not exist yet.
    pub fn new(path: &Path, plan: &PlanHash) -> Self {
        Self {
            path: path.to_owned(),
            plan: *plan,
            end: 0,
            places: HashMap::new(),
            words: Interner::default(),
            buffer: Vec::new(),
        }
    }

    /// The number of episodes read so far.
    pub fn len(&self) -> u64 {
        self.places.len() as u64
    }

    /// Whether no episode was read so far.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Passes the entries that were appended since the last call to `sink`, in the order of the file.
    ///
    /// # Errors
    /// The file cannot be read, is the journal of another plan, has a damaged record, or is shorter than what was read
    /// before: its writer started again. A file that does not exist is empty.
    pub fn read(&mut self, sink: &mut dyn FnMut(&Entry)) -> Result<(), DictionaryError> {
        let file = match File::open(&self.path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            file => file.map_err(DictionaryError::io(&self.path, "open"))?,
        };
        let length = file.metadata().map_err(DictionaryError::io(&self.path, "inspect"))?.len();
        if length < self.end {
            return Err(self.damaged(length, "the file is shorter than before"));
        }
        let mut reader = BufReader::with_capacity(1 << 16, file);
        if self.end == 0 {
            let mut found = Vec::new();
            reader.by_ref().take(64).read_to_end(&mut found).map_err(DictionaryError::io(&self.path, "read"))?;
            if !check_header(&self.path, &found, &self.plan)? {
                return Ok(());
            }
            self.end = HEADER;
        }
        reader.seek(SeekFrom::Start(self.end)).map_err(DictionaryError::io(&self.path, "read"))?;
        while let Some(entry) = self.next(&mut reader, length)? {
            sink(&entry);
        }
        Ok(())
    }

    /// Reads the record at `self.end`. `None` if it is incomplete.
    fn next(&mut self, reader: &mut impl Read, length: u64) -> Result<Option<Entry>, DictionaryError> {
        let Some(rest) = length.saturating_sub(self.end).checked_sub(HEAD as u64) else { return Ok(None) };
        let mut head = [0; HEAD];
        reader.read_exact(&mut head).map_err(DictionaryError::io(&self.path, "read"))?;
        let Some((size, crc)) = parse_head(&head) else {
            // The length of a file can be visible before its last bytes.
            let unwritten = head.iter().all(|byte| *byte == 0);
            return if unwritten {
                Ok(None)
            } else {
                Err(self.damaged(self.end, "its head does not match its checksum"))
            };
        };
        if u64::from(size) > rest {
            return Ok(None);
        }
        self.buffer.resize(size as usize, 0);
        reader.read_exact(&mut self.buffer).map_err(DictionaryError::io(&self.path, "read"))?;
        if crc32fast::hash(&self.buffer) != crc {
            let last = u64::from(size) == rest;
            return if last {
                Ok(None)
            } else {
                Err(self.damaged(self.end, "its content does not match its checksum"))
            };
        }
        let entry = codec::decode(&self.buffer, &mut self.words).map_err(|reason| self.damaged(self.end, &reason))?;
        self.places.insert(entry.index(), self.end);
        self.end += HEAD as u64 + u64::from(size);
        Ok(Some(entry))
    }

    /// Reads the entry of an episode again. `None` if it was not read before.
    ///
    /// # Errors
    /// The file cannot be read, or has changed.
    pub fn entry(&mut self, index: u64) -> Result<Option<Entry>, DictionaryError> {
        let Some(offset) = self.places.get(&index).copied() else { return Ok(None) };
        let mut file = File::open(&self.path).map_err(DictionaryError::io(&self.path, "open"))?;
        file.seek(SeekFrom::Start(offset)).map_err(DictionaryError::io(&self.path, "read"))?;
        let mut head = [0; HEAD];
        file.read_exact(&mut head).map_err(DictionaryError::io(&self.path, "read"))?;
        let Some((size, crc)) = parse_head(&head).filter(|(size, _)| offset + u64::from(*size) <= self.end) else {
            return Err(self.damaged(offset, "its head does not match its checksum"));
        };
        self.buffer.resize(size as usize, 0);
        file.read_exact(&mut self.buffer).map_err(DictionaryError::io(&self.path, "read"))?;
        if crc32fast::hash(&self.buffer) != crc {
            return Err(self.damaged(offset, "its content does not match its checksum"));
        }
        codec::decode(&self.buffer, &mut self.words).map(Some).map_err(|reason| self.damaged(offset, &reason))
    }

    fn damaged(&self, offset: u64, reason: &str) -> DictionaryError {
        DictionaryError::DamagedJournal {
            path: self.path.clone(),
            offset,
            intact: self.len(),
            reason: reason.to_owned(),
        }
    }
}
