//! The crash-safe journal of a running campaign.
//!
//! The file has a header of 48 bytes with the SHA-256 of the campaign's plan, then one [frame](crate::frame) per episode. Each frame is written with one `write`
//! call, so a killed process leaves at most one incomplete frame, at the end. The checksum of the frame's head
//! distinguishes an incomplete frame (valid head, file too short) from a damaged one.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::codec::{self, Interner};
use crate::files::sync_parent;
use crate::frame::{HEAD, encode_frame, parse_head};
use crate::{DictionaryError, Entry, hex};

const MAGIC: [u8; 8] = *b"RGJOURNL";
const VERSION: u32 = 3;
/// The size of the header.
pub(crate) const HEADER: u64 = 48;
/// Bytes that [`Journal::extend`] collects for one `write` call.
const CHUNK: usize = 1 << 20;

/// The SHA-256 of a campaign's plan.
pub type PlanHash = [u8; 32];

/// The repair done when a journal was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recovery {
    /// Bytes of an incomplete last record that were removed. 0 if the journal was intact.
    pub dropped_bytes: u64,
}

/// The append-only journal of a running campaign. It takes 16 bytes of memory per episode, in any order.
///
/// Only one process at a time can open it: the file is locked while the journal is open.
#[derive(Debug)]
pub struct Journal {
    file: File,
    path: PathBuf,
    /// (index, offset of the frame), sorted by index. Episodes arrive nearly in order, so most insertions are at the
    /// end.
    places: Vec<(u64, u64)>,
    /// The plan that the header must name.
    plan: PlanHash,
    /// End of the last complete frame.
    end: u64,
    /// Whether an append failed and could not be undone.
    broken: bool,
    buffer: Vec<u8>,
    words: Interner,
}

impl Journal {
    /// Creates the journal `path` for the campaign with this plan. Returns an error if the file exists.
    pub fn create(path: &Path, plan: &PlanHash) -> Result<Self, DictionaryError> {
        let file = OpenOptions::new()
            .read(true)
            .append(true)
            .create_new(true)
            .open(path)
            .map_err(DictionaryError::io(path, "create"))?;
        let mut journal = Self::over(file, path, plan)?;
        journal.write_header()?;
        // The header reaches the disk before the first record, and the entry of the folder too.
        journal.sync()?;
        sync_parent(path).map_err(DictionaryError::io(path, "flush the folder of"))?;
        Ok(journal)
    }

    /// Opens the journal `path` of the campaign with this plan. An incomplete last record, left by a killed writer, is
    /// removed. The journal of another plan is an error.
    ///
    /// A damaged record before the end is an error with its offset, because skipping it would lose the later episodes
    /// silently. Only bytes that never reached the disk end the journal there.
    pub fn open(path: &Path, plan: &PlanHash) -> Result<(Self, Recovery), DictionaryError> {
        let file = OpenOptions::new().read(true).append(true).open(path).map_err(DictionaryError::io(path, "open"))?;
        let mut journal = Self::over(file, path, plan)?;
        let length = journal.file.metadata().map_err(DictionaryError::io(path, "inspect"))?.len();
        let kept = journal.scan(length)?;
        if kept < length || kept < HEADER {
            journal.file.set_len(kept).map_err(DictionaryError::io(path, "repair"))?;
        }
        if kept < HEADER {
            journal.write_header()?;
            journal.sync()?;
        }
        Ok((journal, Recovery { dropped_bytes: length - kept }))
    }

    fn over(file: File, path: &Path, plan: &PlanHash) -> Result<Self, DictionaryError> {
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(DictionaryError::Locked { path: path.to_owned() }),
            // Some network file systems have no locks. The journal works without them.
            Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(e)) => return Err(DictionaryError::io(path, "lock")(e)),
        }
        Ok(Self {
            file,
            path: path.to_owned(),
            places: Vec::new(),
            plan: *plan,
            end: 0,
            broken: false,
            buffer: Vec::new(),
            words: Interner::default(),
        })
    }

    fn write_header(&mut self) -> Result<(), DictionaryError> {
        let header = header_of(&self.plan);
        self.file.write_all(&header).map_err(DictionaryError::io(&self.path, "write"))?;
        self.end = HEADER;
        Ok(())
    }

    /// Reads every frame once. Returns the end of the last complete one.
    fn scan(&mut self, length: u64) -> Result<u64, DictionaryError> {
        let file = self.file.try_clone().map_err(DictionaryError::io(&self.path, "read"))?;
        let mut reader = BufReader::with_capacity(1 << 16, file);
        if !self.scan_header(&mut reader)? {
            return Ok(0);
        }
        self.end = HEADER;
        while self.end < length {
            match self.scan_frame(&mut reader, length - self.end)? {
                Some(size) => self.end += size,
                None => break,
            }
        }
        match self.sort_places() {
            Some((index, offset)) => {
                Err(self.damaged(offset, &format!("the journal already contains episode {index}")))
            }
            None => Ok(self.end),
        }
    }

    /// Checks the header. Returns `false` if the file ends inside it, because its writer was killed while creating it.
    fn scan_header(&mut self, reader: &mut impl Read) -> Result<bool, DictionaryError> {
        let mut found = Vec::new();
        reader.take(HEADER).read_to_end(&mut found).map_err(DictionaryError::io(&self.path, "read"))?;
        check_header(&self.path, &found, &self.plan)
    }

    /// The size of the frame at `self.end`, with `left` bytes remaining in the file. `None` if the frame is incomplete.
    fn scan_frame(&mut self, reader: &mut impl Read, left: u64) -> Result<Option<u64>, DictionaryError> {
        let Some(rest) = left.checked_sub(HEAD as u64) else {
            return Ok(None);
        };
        let mut bytes = [0; HEAD];
        reader.read_exact(&mut bytes).map_err(DictionaryError::io(&self.path, "read"))?;
        let Some((size, crc)) = parse_head(&bytes) else {
            if unwritten(&bytes) {
                return Ok(None);
            }
            return Err(self.damaged(self.end, "its head does not match its checksum"));
        };
        if u64::from(size) > rest {
            return Ok(None);
        }
        self.buffer.resize(size as usize, 0);
        reader.read_exact(&mut self.buffer).map_err(DictionaryError::io(&self.path, "read"))?;
        if crc32fast::hash(&self.buffer) != crc {
            // A hole ends with a page. A record that only ends with zeros is followed by the head of the next one.
            let mut next = Vec::new();
            reader.take(4).read_to_end(&mut next).map_err(DictionaryError::io(&self.path, "read"))?;
            let is_hole = unwritten(&self.buffer) && next.iter().all(|byte| *byte == 0);
            if u64::from(size) == rest || is_hole {
                // The last frame has its full length but wrong content. It counts as incomplete, and its episode runs
                // again.
                return Ok(None);
            }
            return Err(self.damaged(self.end, "its content does not match its checksum"));
        }
        let Some(index) = codec::decode_index(&self.buffer) else {
            return Err(self.damaged(self.end, "it is too short for an episode"));
        };
        self.places.push((index, self.end));
        Ok(Some(HEAD as u64 + u64::from(size)))
    }

    fn damaged(&self, offset: u64, reason: &str) -> DictionaryError {
        let intact = self.places.iter().filter(|(_, place)| *place < offset).count() as u64;
        DictionaryError::DamagedJournal { path: self.path.clone(), offset, intact, reason: reason.to_owned() }
    }

    /// Sorts the positions by index. Returns the second position of an episode that has two.
    fn sort_places(&mut self) -> Option<(u64, u64)> {
        self.places.sort_unstable();
        self.places.windows(2).find(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1])
    }

    /// Records the position of episode `index`, which has none yet.
    fn place(&mut self, index: u64, offset: u64) {
        let at = self.places.partition_point(|(known, _)| *known < index);
        self.places.insert(at, (index, offset));
    }

    /// Appends one entry with one `write` call. A process that is killed loses at most this entry.
    ///
    /// An error (a full disk) leaves the journal unchanged: its episodes stay readable, and an append succeeds once
    /// there is disk space.
    pub fn append(&mut self, entry: &Entry) -> Result<(), DictionaryError> {
        let index = entry.index();
        if self.broken {
            return Err(DictionaryError::Broken { path: self.path.clone() });
        }
        if self.contains(index) {
            return Err(DictionaryError::Duplicate { path: self.path.clone(), index });
        }
        self.buffer.clear();
        encode_frame(entry, &mut self.buffer)?;
        if let Err(error) = self.file.write_all(&self.buffer) {
            // A part of the frame may be in the file. The next frame must not follow it.
            self.broken = self.file.set_len(self.end).is_err();
            return Err(DictionaryError::io(&self.path, "append to")(error));
        }
        self.place(index, self.end);
        self.end += self.buffer.len() as u64;
        Ok(())
    }

    /// Appends many entries, in any order of index. This is much faster than [`Self::append`] for each of them, because
    /// it writes large blocks and sorts once.
    ///
    /// An error, also one of `entries`, leaves the journal unchanged. A process that is killed loses at most the
    /// entries of this call.
    pub fn extend<E: From<DictionaryError>>(
        &mut self,
        entries: impl IntoIterator<Item = Result<Entry, E>>,
    ) -> Result<(), E> {
        if self.broken {
            return Err(DictionaryError::Broken { path: self.path.clone() }.into());
        }
        let start = self.end;
        let extended = self.extend_unchecked(entries).and_then(|()| match self.sort_places() {
            Some((index, _)) => Err(DictionaryError::Duplicate { path: self.path.clone(), index }.into()),
            None => Ok(()),
        });
        if extended.is_err() {
            self.places.retain(|(_, offset)| *offset < start);
            self.end = start;
            self.broken = self.file.set_len(start).is_err();
        }
        extended
    }

    fn extend_unchecked<E: From<DictionaryError>>(
        &mut self,
        entries: impl IntoIterator<Item = Result<Entry, E>>,
    ) -> Result<(), E> {
        self.buffer.clear();
        for entry in entries {
            let entry = entry?;
            self.places.push((entry.index(), self.end + self.buffer.len() as u64));
            encode_frame(&entry, &mut self.buffer)?;
            if self.buffer.len() >= CHUNK {
                self.write_buffer()?;
            }
        }
        Ok(self.write_buffer()?)
    }

    /// Appends the buffer to the file and empties it.
    fn write_buffer(&mut self) -> Result<(), DictionaryError> {
        self.file.write_all(&self.buffer).map_err(DictionaryError::io(&self.path, "append to"))?;
        self.end += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Flushes appended entries to disk. Called at the end of a stage, to survive a power failure.
    pub fn sync(&mut self) -> Result<(), DictionaryError> {
        self.file.sync_data().map_err(DictionaryError::io(&self.path, "flush"))
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The number of episodes.
    pub fn len(&self) -> u64 {
        self.places.len() as u64
    }

    /// Whether the journal has no episodes.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Whether the journal contains episode `index`.
    pub fn contains(&self, index: u64) -> bool {
        self.offset(index).is_some()
    }

    /// The indices of the episodes, in increasing order.
    pub fn indices(&self) -> impl Iterator<Item = u64> {
        self.places.iter().map(|(index, _)| *index)
    }

    /// Reads the entry of episode `index`, if it is in the journal.
    pub fn read(&mut self, index: u64) -> Result<Option<Entry>, DictionaryError> {
        self.offset(index).map(|offset| self.read_at(offset)).transpose()
    }

    /// Reads every entry in increasing order of index, with one in memory at a time.
    pub fn ordered(&mut self) -> impl Iterator<Item = Result<Entry, DictionaryError>> {
        (0..self.places.len()).map(|i| self.read_at(self.places[i].1))
    }

    fn offset(&self, index: u64) -> Option<u64> {
        let at = self.places.binary_search_by_key(&index, |(i, _)| *i).ok()?;
        Some(self.places[at].1)
    }

    fn read_at(&mut self, offset: u64) -> Result<Entry, DictionaryError> {
        let mut bytes = [0; HEAD];
        self.file.seek(SeekFrom::Start(offset)).map_err(DictionaryError::io(&self.path, "read"))?;
        self.file.read_exact(&mut bytes).map_err(DictionaryError::io(&self.path, "read"))?;
        // The head was checked on opening. It is checked again because the disk may have failed since.
        let Some((size, crc)) = parse_head(&bytes).filter(|(size, _)| offset + u64::from(*size) <= self.end) else {
            return Err(self.damaged(offset, "its head does not match its checksum"));
        };
        self.buffer.resize(size as usize, 0);
        self.file.read_exact(&mut self.buffer).map_err(DictionaryError::io(&self.path, "read"))?;
        if crc32fast::hash(&self.buffer) != crc {
            return Err(self.damaged(offset, "its content does not match its checksum"));
        }
        codec::decode(&self.buffer, &mut self.words).map_err(|reason| self.damaged(offset, &reason))
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        // Closing alone would keep the lock while a forked child process that has not yet called exec holds a copy of
        // the handle.
        let _ = self.file.unlock();
    }
}

/// Checks the header that `found`, the first bytes of a journal, contains. `false` if the file ends inside it.
pub(crate) fn check_header(path: &Path, found: &[u8], plan: &PlanHash) -> Result<bool, DictionaryError> {
    let refuse = |reason: String| Err(DictionaryError::NotAJournal { path: path.to_owned(), reason });
    let found = found.get(..HEADER as usize).unwrap_or(found);
    let expected = header_of(plan);
    if found == expected {
        return Ok(true);
    }
    // Before the plan's hash, a header of another plan is the same.
    if expected.starts_with(found) {
        return Ok(false);
    }
    let version = found.get(8..12).and_then(|bytes| bytes.first_chunk()).map(|bytes| u32::from_le_bytes(*bytes));
    match (found.first_chunk(), version) {
        (Some(&MAGIC), Some(version)) if version > VERSION => {
            refuse(format!("its version is {version}. Expected {VERSION}\nHint: upgrade robogate"))
        }
        (Some(&MAGIC), Some(version)) if version < VERSION => refuse(format!(
            "its version is {version}. Expected {VERSION}\nHint: finish the run with the version of robogate that started it, or start it again"
        )),
        (Some(&MAGIC), _) => match found.get(12..44).and_then(|bytes| bytes.first_chunk()) {
            Some(named) if found == header_of(named) => {
                let [found, expected] = [named, plan].map(|plan| hex(plan));
                Err(DictionaryError::OtherPlan { path: path.to_owned(), found, expected })
            }
            _ => refuse("its header is damaged".to_owned()),
        },
        _ => refuse("it does not start with the header of a journal\nHint: check the path".to_owned()),
    }
}

/// The header of a journal for this plan: magic, version, plan, and the CRC-32 of these.
fn header_of(plan: &PlanHash) -> [u8; HEADER as usize] {
    let mut header = [0; HEADER as usize];
    header[..8].copy_from_slice(&MAGIC);
    header[8..12].copy_from_slice(&VERSION.to_le_bytes());
    header[12..44].copy_from_slice(plan);
    let crc = crc32fast::hash(&header[..44]);
    header[44..].copy_from_slice(&crc.to_le_bytes());
    header
}

/// Whether these bytes of a record may not have been written: they are zeros, all or at the end. After a power failure a file may be
/// longer than the data that reached the disk, and later data may have reached it alone. Those episodes run again.
fn unwritten(bytes: &[u8]) -> bool {
    const ZEROS: usize = 32;
    bytes.iter().rev().take(ZEROS).all(|byte| *byte == 0) && !bytes.is_empty()
}
