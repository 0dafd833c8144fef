//! Reads a dictionary, column by column or entry by entry.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::{Buf, Bytes};
use parquet::column::reader::ColumnReaderImpl;
use parquet::data_type::{ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ParquetMetaData, ParquetMetaDataReader};
use parquet::file::reader::{ChunkReader, Length};

use robogate_core::budget::Budget;

use crate::columns::{ColumnSpec, Columns, Kind};
use crate::decode::placeholder;
use crate::pages::{Allowance, check_footer, page_reader};
use crate::{DictionaryError, Provenance, SCHEMA_VERSION, SchemaVersion};

use super::{
    Column, Entries, KEY_CHECKSUMS, KEY_DATASET, KEY_PROVENANCE, KEY_VERSION, byte_range, damaged, guarded, hex_crc,
    physical,
};

/// Maximum rows of a row group that is read, which bounds memory for any file.
const MOST_ROWS_PER_GROUP: usize = 1 << 20;

/// Values that a row group may have in memory, in addition to [`CELLS_PER_BYTE`] for each byte of the file.
const MOST_CELLS_PER_GROUP: u64 = 1 << 22;
const CELLS_PER_BYTE: u64 = 64;

/// Largest column chunk that is read, in bytes. Chunks of this tool have at most some hundred kilobytes.
const MOST_CHUNK: usize = 256 << 20;

/// Maximum number of columns.
const MOST_COLUMNS: usize = 1 << 13;

/// A dictionary on disk.
///
/// Opening it reads the footer. Rows are read on demand, with one row group in memory.
#[derive(Debug)]
pub struct Dictionary {
    file: File,
    pub(super) path: PathBuf,
    pub(super) metadata: ParquetMetaData,
    pub(super) columns: Columns,
    /// The position of each column in the file.
    leaves: Vec<usize>,
    version: SchemaVersion,
    pub(super) provenance: Provenance,
    pub(super) dataset_hash: String,
    /// CRC-32 of each column chunk, group by group.
    checksums: Vec<u32>,
    rows: u64,
}

impl Dictionary {
    /// Opens a dictionary. It reads and checks the schema and provenance, but no rows.
    pub fn open(path: &Path) -> Result<Self, DictionaryError> {
        let mut file = File::open(path).map_err(DictionaryError::io(path, "open"))?;
        check_ends(&mut file, path)?;
        check_footer(&mut file).map_err(|reason| damaged(path, "the footer", reason))?;
        let length = file.metadata().map_err(DictionaryError::io(path, "inspect"))?.len();
        let metadata = guarded(|| ParquetMetaDataReader::new().parse_and_finish(&file))
            .map_err(|reason| damaged(path, "the footer", reason))?;
        let value = |key: &str| {
            let pairs = metadata.file_metadata().key_value_metadata()?;
            pairs.iter().find(|pair| pair.key == key)?.value.as_deref()
        };
        let Some(version) = value(KEY_VERSION) else {
            return Err(DictionaryError::not_a_dictionary(
                path,
                format!(
                    "it is a Parquet file without `{KEY_VERSION}`. Expected one that `robogate run` or `robogate import` wrote"
                ),
            ));
        };
        let version: SchemaVersion = version.parse().map_err(|reason| damaged(path, "the schema version", reason))?;
        if !version.is_readable() {
            return Err(DictionaryError::OtherSchema { path: path.to_owned(), found: version });
        }
        let json = value(KEY_PROVENANCE).unwrap_or_default();
        let mut checksums = value(KEY_CHECKSUMS).unwrap_or_default().split(' ');
        if checksums.next() != Some(&hex_crc(json.as_bytes())) {
            return Err(damaged(path, "the provenance", "it does not match its checksum".to_owned()));
        }
        let provenance: Provenance =
            Budget::FILE.json(json.as_bytes()).map_err(|e| damaged(path, "the provenance", e.to_string()))?;
        let columns = Columns::of_provenance(&provenance)?;
        let leaves = find_leaves(&metadata, &columns, path)?;
        let checksums = checksums
            .map(|crc| u32::from_str_radix(crc, 16))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| damaged(path, "the list of checksums", e.to_string()))?;
        let dataset_hash = value(KEY_DATASET).unwrap_or_default().to_owned();
        let rows = count_rows(&metadata, checksums.len(), length).map_err(|e| damaged(path, "the footer", e))?;
        Ok(Self {
            file,
            path: path.to_owned(),
            metadata,
            columns,
            leaves,
            version,
            provenance,
            dataset_hash,
            checksums,
            rows,
        })
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The provenance.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The schema version of the file.
    pub fn schema_version(&self) -> SchemaVersion {
        self.version
    }

    /// The number of rows.
    pub fn len(&self) -> u64 {
        self.rows
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// The stored content hash. [`Self::entries`] verifies it.
    pub fn dataset_hash(&self) -> &str {
        &self.dataset_hash
    }

    /// The column names, in order.
    pub fn column_names(&self) -> impl Iterator<Item = &str> {
        self.columns.specs().iter().map(|spec| spec.name.as_str())
    }

    pub(crate) fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Reads every entry in order, with one row group in memory.
    ///
    /// After the last entry, an error follows if the rows do not match the stored dataset hash.
    pub fn entries(&self) -> Entries<'_> {
        Entries::of(self)
    }

    /// Reads one whole column into memory.
    pub fn column(&self, name: &str) -> Result<Column, DictionaryError> {
        let Some(at) = self.columns.specs().iter().position(|spec| spec.name == name) else {
            let names: Vec<&str> = self.column_names().collect();
            return Err(DictionaryError::NoSuchColumn {
                path: self.path.clone(),
                column: name.to_owned(),
                columns: names.join(", "),
            });
        };
        let mut column = Column::of(self.columns.specs()[at].kind);
        let mut places = HashMap::new();
        for group in 0..self.metadata.num_row_groups() {
            self.read_chunk(group, at, &mut column, &mut places)?;
        }
        Ok(column)
    }

    /// Reads one whole column as real numbers. Integers are converted; words are an error.
    pub fn numbers(&self, name: &str) -> Result<Vec<Option<f64>>, DictionaryError> {
        match self.column(name)? {
            Column::Numbers(values) => Ok(values),
            Column::Integers(values) => Ok(values.into_iter().map(|n| n.map(|n| n as f64)).collect()),
            Column::Counts(values) => Ok(values.into_iter().map(|n| n.map(|n| n as f64)).collect()),
            Column::Categories { .. } => Err(DictionaryError::ColumnKind {
                path: self.path.clone(),
                column: name.to_owned(),
                found: "words",
                wanted: "numbers",
            }),
        }
    }

    pub(super) fn read_group(&self, group: usize) -> Result<Vec<Column>, DictionaryError> {
        let specs = self.columns.specs().iter().enumerate();
        specs
            .map(|(at, spec)| {
                let mut column = Column::of(spec.kind);
                self.read_chunk(group, at, &mut column, &mut HashMap::new())?;
                Ok(column)
            })
            .collect()
    }

    /// Appends column `at` of one row group to `column`.
    fn read_chunk(
        &self,
        group: usize,
        at: usize,
        column: &mut Column,
        places: &mut HashMap<Box<[u8]>, u32>,
    ) -> Result<(), DictionaryError> {
        let spec = &self.columns.specs()[at];
        let leaf = self.leaves[at];
        let wrong = |reason: String| {
            let first: i64 = self.metadata.row_groups()[..group].iter().map(|group| group.num_rows()).sum();
            let last = first + self.metadata.row_group(group).num_rows() - 1;
            damaged(&self.path, &format!("column `{}`, rows {first} to {last},", spec.name), reason)
        };
        let group_metadata = self.metadata.row_group(group);
        let rows = group_metadata.num_rows() as usize;
        let metadata = group_metadata.column(leaf);
        let (start, length) = byte_range(metadata).ok_or_else(|| wrong("its position is negative".to_owned()))?;
        let length_of_file = self.file.metadata().map_err(DictionaryError::io(&self.path, "inspect"))?.len();
        if start.checked_add(length as u64).is_none_or(|end| end > length_of_file) {
            return Err(wrong(format!("bytes {start} to {start}+{length} are beyond the file's end")));
        }
        if length > MOST_CHUNK {
            return Err(wrong(format!("it has {length} bytes. At most {MOST_CHUNK} are accepted")));
        }
        let mut bytes = vec![0; length];
        (&self.file)
            .seek(SeekFrom::Start(start))
            .and_then(|_| (&self.file).read_exact(&mut bytes))
            .map_err(DictionaryError::io(&self.path, "read"))?;
        let expected = self.checksums.get(group * group_metadata.num_columns() + leaf);
        if expected != Some(&crc32fast::hash(&bytes)) {
            return Err(wrong(format!("the {length} bytes from byte {start} on do not match their checksum")));
        }
        let chunk = ChunkBytes { start, bytes: bytes.into() };
        let read = guarded(|| {
            let descriptor = metadata.column_descr_ptr();
            let optional = descriptor.max_def_level() > 0;
            let pages = page_reader(Arc::new(chunk), metadata, rows, &Allowance::of(length as u64))?;
            match spec.kind {
                Kind::Number => {
                    let (present, values) =
                        records::<DoubleType>(ColumnReaderImpl::new(descriptor, pages), rows, optional)?;
                    column.extend_numbers(&present, values);
                }
                Kind::Integer | Kind::Count => {
                    let (present, values) =
                        records::<Int64Type>(ColumnReaderImpl::new(descriptor, pages), rows, optional)?;
                    column.extend_longs(&present, values);
                }
                Kind::Text => {
                    let (present, values) =
                        records::<ByteArrayType>(ColumnReaderImpl::new(descriptor, pages), rows, optional)?;
                    column.extend_texts(&present, &values, places)?;
                }
            }
            Ok(())
        });
        read.map_err(wrong)
    }
}

/// Checks both ends of a Parquet file, which detects other formats and truncated files before parsing.
fn check_ends(file: &mut File, path: &Path) -> Result<(), DictionaryError> {
    let read = |file: &mut File, from| -> io::Result<[u8; 4]> {
        let mut magic = [0; 4];
        file.seek(from)?;
        file.read_exact(&mut magic)?;
        Ok(magic)
    };
    if let Some(reason) = placeholder(path) {
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    let length = file.metadata().map_err(DictionaryError::io(path, "inspect"))?.len();
    if length < 12 {
        let reason = format!("it has {length} bytes, too few for a Parquet file");
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    if read(file, SeekFrom::Start(0)).map_err(DictionaryError::io(path, "read"))? != *b"PAR1" {
        let reason = "it is not a Parquet file\nHint: read results of other tools with `robogate import`";
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    if read(file, SeekFrom::End(-4)).map_err(DictionaryError::io(path, "read"))? != *b"PAR1" {
        let reason = format!(
            "it starts as a Parquet file but ends at byte {length} without a footer: it is truncated\nHint: restore it from a backup, or run its campaign again"
        );
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    Ok(())
}

fn find_leaves(metadata: &ParquetMetaData, columns: &Columns, path: &Path) -> Result<Vec<usize>, DictionaryError> {
    let descriptor = metadata.file_metadata().schema_descr();
    if descriptor.num_columns() > MOST_COLUMNS {
        let found = descriptor.num_columns();
        return Err(damaged(
            path,
            "the schema",
            format!("it has {found} columns. At most {MOST_COLUMNS} are accepted"),
        ));
    }
    let mut by_name = HashMap::new();
    for leaf in 0..descriptor.num_columns() {
        let column = descriptor.column(leaf);
        if let [name] = column.path().parts() {
            by_name.entry(name.clone()).or_insert(leaf);
        }
    }
    let find = |spec: &ColumnSpec| {
        let refuse = |what: &str| {
            damaged(path, "the schema", format!("column `{}` of the schema {SCHEMA_VERSION} {what}", spec.name))
        };
        let leaf = by_name.get(spec.name.as_str()).copied().ok_or_else(|| refuse("is missing"))?;
        let column = descriptor.column(leaf);
        if column.physical_type() != physical(spec.kind) || column.max_rep_level() > 0 || column.max_def_level() > 1 {
            return Err(refuse("has another type"));
        }
        Ok(leaf)
    };
    columns.specs().iter().map(find).collect()
}

/// Counts the rows and checks that their number, and that of the columns, is plausible for a file of `length` bytes.
fn count_rows(metadata: &ParquetMetaData, checksums: usize, length: u64) -> Result<u64, String> {
    let columns = metadata.file_metadata().schema_descr().num_columns();
    let most = MOST_CELLS_PER_GROUP.saturating_add(length.saturating_mul(CELLS_PER_BYTE));
    let mut rows = 0;
    for (i, group) in metadata.row_groups().iter().enumerate() {
        match usize::try_from(group.num_rows()) {
            Ok(n) if (1..=MOST_ROWS_PER_GROUP).contains(&n) => rows += n as u64,
            _ => return Err(format!("row group {i} declares {} rows", group.num_rows())),
        }
        if group.num_rows().unsigned_abs().saturating_mul(columns as u64) > most {
            let rows = group.num_rows();
            return Err(format!("row group {i} declares {rows} rows of {columns} columns in a file of {length} bytes"));
        }
    }
    Allowance::of(length).check_cells(rows, columns)?;
    if u64::try_from(metadata.file_metadata().num_rows()) != Ok(rows) {
        let claimed = metadata.file_metadata().num_rows();
        return Err(format!("its footer declares {claimed} rows, but its row groups have {rows}"));
    }
    let chunks: usize = metadata.row_groups().iter().map(|group| group.num_columns()).sum();
    if chunks != checksums {
        return Err(format!(
            "expected {chunks} checksums, one per column chunk, got {checksums}: another program rewrote the file"
        ));
    }
    Ok(rows)
}

/// Definition levels (empty if every row has a value) and values of one column chunk.
fn records<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    rows: usize,
    optional: bool,
) -> Result<(Vec<i16>, Vec<T::T>), ParquetError> {
    let (mut present, mut values) = (Vec::new(), Vec::new());
    let levels = optional.then_some(&mut present);
    let (found, _, _) = reader.read_records(rows, levels, None, &mut values)?;
    if found != rows {
        return Err(ParquetError::General(format!("it contains {found} of {rows} rows")));
    }
    Ok((present, values))
}

/// A column chunk in memory, with its position in the file.
struct ChunkBytes {
    start: u64,
    bytes: Bytes,
}

impl Length for ChunkBytes {
    fn len(&self) -> u64 {
        self.start + self.bytes.len() as u64
    }
}

impl ChunkReader for ChunkBytes {
    type T = bytes::buf::Reader<Bytes>;

    fn get_read(&self, start: u64) -> Result<Self::T, ParquetError> {
        let left = self.len().saturating_sub(start);
        Ok(self.get_bytes(start, usize::try_from(left).unwrap_or(usize::MAX))?.reader())
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        let outside = || ParquetError::EOF(format!("a page of {length} bytes from byte {start} on"));
        let from = start.checked_sub(self.start).and_then(|from| usize::try_from(from).ok()).ok_or_else(outside)?;
        let to = from.checked_add(length).filter(|to| *to <= self.bytes.len()).ok_or_else(outside)?;
        Ok(self.bytes.slice(from..to))
    }
}
