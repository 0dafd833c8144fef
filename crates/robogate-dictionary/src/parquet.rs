//! Reads and writes the dictionary as Parquet.
//!
//! The file has row groups of [`ROWS_PER_GROUP`] rows, snappy compression, no page index, and a `created_by` with the
//! version of this tool: the same provenance and entries give the same bytes. The footer contains the schema version,
//! the provenance, the dataset hash and a CRC-32 for each column chunk. A chunk is decoded only if its bytes match the
//! CRC. Damage is reported with its position and never returned as data.

use std::collections::HashMap;
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::{Buf, Bytes};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::column::reader::ColumnReaderImpl;
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ColumnChunkMetaData, KeyValue, ParquetMetaData, ParquetMetaDataReader};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, Type};

use robogate_core::budget::Budget;

use crate::atomic::AtomicFile;
use crate::codec::Interner;
use crate::columns::{Cell, ColumnSpec, Columns, Kind, WrongCell};
use crate::pages::{Allowance, check_footer, page_reader};
use crate::{DatasetHash, DictionaryError, Entry, Fidelity, Provenance, Row, SCHEMA_VERSION, SchemaVersion};

/// Rows of a row group. A reader or writer keeps one group in memory, a few megabytes.
const ROWS_PER_GROUP: usize = 1 << 14;

/// Maximum rows of a row group that is read, which bounds memory for any file.
const MOST_ROWS_PER_GROUP: usize = 1 << 20;

/// Values that a row group may have in memory, in addition to [`CELLS_PER_BYTE`] for each byte of the file.
const MOST_CELLS_PER_GROUP: u64 = 1 << 22;
const CELLS_PER_BYTE: u64 = 64;

/// Largest column chunk that is read, in bytes. Chunks of this tool have at most some hundred kilobytes.
const MOST_CHUNK: usize = 256 << 20;

/// Maximum number of columns.
const MOST_COLUMNS: usize = 1 << 13;

const KEY_VERSION: &str = "robogate.schema_version";
const KEY_PROVENANCE: &str = "robogate.provenance";
const KEY_DATASET: &str = "robogate.dataset_hash";
const KEY_CHECKSUMS: &str = "robogate.checksums";

/// The result of writing a dictionary.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The number of rows.
    pub rows: u64,
    /// The content hash of the rows ([`crate::dataset_hash`]), which is also in the file.
    pub dataset_hash: String,
}

/// Writes the dictionary `path` from entries in increasing order of index.
pub fn write_parquet(
    path: &Path,
    provenance: &Provenance,
    entries: impl Iterator<Item = Result<Entry, DictionaryError>>,
) -> Result<Written, DictionaryError> {
    let mut writer = DictionaryWriter::create(path, provenance)?;
    for entry in entries {
        writer.push(&entry?)?;
    }
    writer.finish()
}

/// Writes a dictionary row by row. Memory is bounded by one row group, and the file appears at `path` only once it is
/// complete. A writer that is dropped before [`Self::finish`] leaves no file.
pub struct DictionaryWriter {
    writer: SerializedFileWriter<Sink>,
    path: PathBuf,
    columns: Columns,
    chunks: Vec<Chunk>,
    seed: u64,
    fidelity: Fidelity,
    rows_in_group: usize,
    rows: u64,
    last_index: Option<u64>,
    hash: DatasetHash,
    /// CRC-32 of the provenance, then of each column chunk, in hexadecimal.
    checksums: Vec<String>,
}

impl fmt::Debug for DictionaryWriter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DictionaryWriter").field("path", &self.path).field("rows", &self.rows).finish_non_exhaustive()
    }
}

impl DictionaryWriter {
    /// Starts a dictionary at `path`, in this crate's schema version.
    pub fn create(path: &Path, provenance: &Provenance) -> Result<Self, DictionaryError> {
        let columns = Columns::of_provenance(provenance, SCHEMA_VERSION)?;
        let provenance = Provenance { schema_version: SCHEMA_VERSION, ..provenance.clone() };
        let json = provenance.to_json();
        let checksums = vec![hex_crc(json.as_bytes())];
        let sink = Sink { file: Some(AtomicFile::create(path)?), written: 0, recent: Vec::new() };
        let writer = schema(&columns)
            .and_then(|schema| SerializedFileWriter::new(sink, Arc::new(schema), Arc::new(properties(&columns, json))))
            .map_err(|e| write_error(path, e))?;
        let chunks = columns.specs().iter().map(|spec| Chunk::of(spec.kind)).collect();
        Ok(Self {
            writer,
            path: path.to_owned(),
            columns,
            chunks,
            seed: provenance.seed,
            fidelity: provenance.fidelity,
            rows_in_group: 0,
            rows: 0,
            last_index: None,
            hash: DatasetHash::new(Arc::clone(&provenance.task)),
            checksums,
        })
    }

    /// Adds the next entry. Its index must be larger than the previous one, and its seed must be that of the
    /// provenance.
    pub fn push(&mut self, entry: &Entry) -> Result<(), DictionaryError> {
        let index = entry.index();
        if let Some(previous) = self.last_index.filter(|previous| *previous >= index) {
            return Err(DictionaryError::Order { index, previous });
        }
        let found = entry.episode.scenario.seed.campaign_number();
        if found != self.seed {
            return Err(DictionaryError::ForeignCampaign { index, found, expected: self.seed });
        }
        same_fidelity(entry, self.fidelity)?;
        let mut cells = Vec::with_capacity(self.chunks.len());
        self.columns.flatten(entry, &mut cells)?;
        for (chunk, cell) in self.chunks.iter_mut().zip(&cells) {
            chunk.push(cell);
        }
        self.hash.update(entry);
        self.last_index = Some(index);
        self.rows += 1;
        self.rows_in_group += 1;
        if self.rows_in_group == ROWS_PER_GROUP {
            self.write_group().map_err(|e| write_error(&self.path, e))?;
        }
        Ok(())
    }

    /// Completes the file and renames it to its final path.
    pub fn finish(mut self) -> Result<Written, DictionaryError> {
        let dataset_hash = self.hash.clone().finish();
        self.close(&dataset_hash).map_err(|e| write_error(&self.path, e))?;
        if let Some(file) = self.writer.inner_mut().file.take() {
            file.commit()?;
        }
        Ok(Written { rows: self.rows, dataset_hash })
    }

    fn close(&mut self, dataset_hash: &str) -> Result<(), ParquetError> {
        if self.rows_in_group > 0 {
            self.write_group()?;
        }
        for (key, value) in [(KEY_DATASET, dataset_hash.to_owned()), (KEY_CHECKSUMS, self.checksums.join(" "))] {
            self.writer.append_key_value_metadata(KeyValue::new(key.to_owned(), value));
        }
        self.writer.finish()?;
        Ok(())
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        let base = self.writer.inner().written - self.writer.inner().recent.len() as u64;
        let mut group = self.writer.next_row_group()?;
        for chunk in &mut self.chunks {
            let Some(mut column) = group.next_column()? else {
                return Err(ParquetError::General("the schema has too few columns".to_owned()));
            };
            let present = &chunk.present;
            match &chunk.values {
                Values::Numbers(x) => column.typed::<DoubleType>().write_batch(x, Some(present), None)?,
                Values::Longs(n) => column.typed::<Int64Type>().write_batch(n, Some(present), None)?,
                Values::Texts(text) => column.typed::<ByteArrayType>().write_batch(text, Some(present), None)?,
            };
            column.close()?;
            chunk.clear();
        }
        let metadata = group.close()?;
        self.writer.flush()?;
        let sink = self.writer.inner_mut();
        for column in metadata.columns() {
            let bytes = byte_range(column)
                .and_then(|(start, length)| {
                    let start = usize::try_from(start.checked_sub(base)?).ok()?;
                    sink.recent.get(start..start.checked_add(length)?)
                })
                .ok_or_else(|| {
                    ParquetError::General("a column chunk is not at the position in its metadata".to_owned())
                })?;
            self.checksums.push(hex_crc(bytes));
        }
        sink.recent.clear();
        self.rows_in_group = 0;
        Ok(())
    }
}

/// Rejects an episode of another fidelity than its dictionary.
fn same_fidelity(entry: &Entry, expected: Fidelity) -> Result<(), DictionaryError> {
    match entry.fidelity {
        found if found == expected => Ok(()),
        found => Err(DictionaryError::ForeignFidelity { index: entry.index(), found, expected }),
    }
}

/// The destination of the Parquet writer. It keeps the bytes of the current row group for their checksum.
struct Sink {
    /// `None` once the file is complete.
    file: Option<AtomicFile>,
    written: u64,
    recent: Vec<u8>,
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.file.as_mut().map_or(Ok(0), |file| file.write(bytes))?;
        self.recent.extend_from_slice(&bytes[..n]);
        self.written += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

/// The values of one column in the current row group.
struct Chunk {
    /// Parquet's definition level per row: 1 for a value, 0 for a missing value.
    present: Vec<i16>,
    values: Values,
}

enum Values {
    Numbers(Vec<f64>),
    Longs(Vec<i64>),
    Texts(Vec<ByteArray>),
}

impl Chunk {
    fn of(kind: Kind) -> Self {
        let values = match kind {
            Kind::Number => Values::Numbers(Vec::new()),
            Kind::Integer | Kind::Count => Values::Longs(Vec::new()),
            Kind::Text => Values::Texts(Vec::new()),
        };
        Self { present: Vec::new(), values }
    }

    fn push(&mut self, cell: &Cell<'_>) {
        match (&mut self.values, cell) {
            (Values::Numbers(values), Cell::Number(x)) => values.push(*x),
            (Values::Longs(values), Cell::Integer(n)) => values.push(*n),
            // Parquet stores unsigned numbers as signed numbers with the same bits.
            (Values::Longs(values), Cell::Count(n)) => values.push(n.cast_signed()),
            (Values::Texts(values), Cell::Text(text)) => values.push(ByteArray::from(text.as_bytes().to_vec())),
            _ => return self.present.push(0),
        }
        self.present.push(1);
    }

    fn clear(&mut self) {
        self.present.clear();
        match &mut self.values {
            Values::Numbers(values) => values.clear(),
            Values::Longs(values) => values.clear(),
            Values::Texts(values) => values.clear(),
        }
    }
}

fn schema(columns: &Columns) -> Result<Type, ParquetError> {
    let fields = columns.specs().iter().map(|spec| {
        let repetition = if spec.required { Repetition::REQUIRED } else { Repetition::OPTIONAL };
        let logical = match spec.kind {
            Kind::Number | Kind::Integer => None,
            Kind::Count => Some(LogicalType::integer(64, false)),
            Kind::Text => Some(LogicalType::String),
        };
        let field = Type::primitive_type_builder(&spec.name, physical(spec.kind))
            .with_repetition(repetition)
            .with_logical_type(logical)
            .build()?;
        Ok(Arc::new(field))
    });
    Type::group_type_builder("dictionary").with_fields(fields.collect::<Result<_, ParquetError>>()?).build()
}

fn physical(kind: Kind) -> Physical {
    match kind {
        Kind::Number => Physical::DOUBLE,
        Kind::Integer | Kind::Count => Physical::INT64,
        Kind::Text => Physical::BYTE_ARRAY,
    }
}

fn properties(columns: &Columns, provenance: String) -> WriterProperties {
    let metadata = vec![
        KeyValue::new(KEY_VERSION.to_owned(), SCHEMA_VERSION.to_string()),
        KeyValue::new(KEY_PROVENANCE.to_owned(), provenance),
    ];
    let builder = WriterProperties::builder()
        .set_created_by(format!("robogate version {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_dictionary_enabled(false)
        .set_key_value_metadata(Some(metadata));
    let repeating = columns.specs().iter().filter(|spec| spec.repeats);
    repeating
        .fold(builder, |builder, spec| {
            builder.set_column_dictionary_enabled(ColumnPath::from(spec.name.as_str()), true)
        })
        .build()
}

fn hex_crc(bytes: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(bytes))
}

/// Start and length of a column chunk in its file, if they are not negative.
fn byte_range(column: &ColumnChunkMetaData) -> Option<(u64, usize)> {
    let start = column.dictionary_page_offset().unwrap_or_else(|| column.data_page_offset());
    Some((u64::try_from(start).ok()?, usize::try_from(column.compressed_size()).ok()?))
}

fn write_error(path: &Path, error: ParquetError) -> DictionaryError {
    let source = match error {
        ParquetError::External(inner) => match inner.downcast::<io::Error>() {
            Ok(io) => *io,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    };
    DictionaryError::io(path, "write")(source)
}

/// A dictionary on disk.
///
/// Opening it reads the footer. Rows are read on demand, with one row group in memory.
#[derive(Debug)]
pub struct Dictionary {
    file: File,
    path: PathBuf,
    metadata: ParquetMetaData,
    columns: Columns,
    /// The position of each column in the file.
    leaves: Vec<usize>,
    version: SchemaVersion,
    provenance: Provenance,
    dataset_hash: String,
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
        if version.major > SCHEMA_VERSION.major {
            return Err(DictionaryError::NewerSchema { path: path.to_owned(), found: version });
        }
        if !version.is_readable() {
            let reason = format!("its schema version {version} was never released");
            return Err(DictionaryError::not_a_dictionary(path, reason));
        }
        let json = value(KEY_PROVENANCE).unwrap_or_default();
        let mut checksums = value(KEY_CHECKSUMS).unwrap_or_default().split(' ');
        if checksums.next() != Some(&hex_crc(json.as_bytes())) {
            return Err(damaged(path, "the provenance", "it does not match its checksum".to_owned()));
        }
        let provenance: Provenance =
            Budget::FILE.json(json.as_bytes()).map_err(|e| damaged(path, "the provenance", e.to_string()))?;
        let columns = Columns::of_provenance(&provenance, version)?;
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
        Entries {
            dictionary: self,
            group: 0,
            data: Vec::new(),
            at: 0,
            rows_in_group: 0,
            row: 0,
            last_index: None,
            words: Interner::default(),
            hash: DatasetHash::new(Arc::clone(&self.provenance.task)),
            done: false,
        }
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

    fn read_group(&self, group: usize) -> Result<Vec<Column>, DictionaryError> {
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
    let length = file.metadata().map_err(DictionaryError::io(path, "inspect"))?.len();
    if length < 12 {
        let reason = format!("it has {length} bytes, too few for a Parquet file");
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    if read(file, SeekFrom::Start(0)).map_err(DictionaryError::io(path, "read"))? != *b"PAR1" {
        let reason = "it is not a Parquet file\nhint: read results of other tools with `robogate import`";
        return Err(DictionaryError::not_a_dictionary(path, reason));
    }
    if read(file, SeekFrom::End(-4)).map_err(DictionaryError::io(path, "read"))? != *b"PAR1" {
        let reason = format!(
            "it starts as a Parquet file but ends at byte {length} without a footer: it is truncated\nhint: restore it from a backup, or run its campaign again"
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

fn damaged(path: &Path, place: &str, reason: String) -> DictionaryError {
    DictionaryError::Damaged { path: path.to_owned(), place: place.to_owned(), reason }
}

/// Runs the Parquet library on a file and converts a panic into an error for that file.
pub(crate) fn guarded<T>(read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, String> {
    match robogate_core::guard::guarded(read) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(error.to_string()),
        Err(why) => Err(format!("the Parquet library panicked on this file: {why}")),
    }
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

/// A column in memory. `None` is a missing value.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Real numbers.
    Numbers(Vec<Option<f64>>),
    /// Signed integers.
    Integers(Vec<Option<i64>>),
    /// Integers of at least 0.
    Counts(Vec<Option<u64>>),
    /// Words. Each row has the index of its word in `words`, which are in order of appearance.
    Categories {
        /// The distinct words.
        words: Vec<String>,
        /// The index of the word of each row.
        codes: Vec<Option<u32>>,
    },
}

impl Column {
    fn of(kind: Kind) -> Self {
        match kind {
            Kind::Number => Self::Numbers(Vec::new()),
            Kind::Integer => Self::Integers(Vec::new()),
            Kind::Count => Self::Counts(Vec::new()),
            Kind::Text => Self::Categories { words: Vec::new(), codes: Vec::new() },
        }
    }

    /// The number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Counts(values) => values.len(),
            Self::Categories { codes, .. } => codes.len(),
        }
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn extend_numbers(&mut self, present: &[i16], values: Vec<f64>) {
        if let Self::Numbers(column) = self {
            spread(column, present, values.into_iter());
        }
    }

    fn extend_longs(&mut self, present: &[i16], values: Vec<i64>) {
        match self {
            Self::Integers(column) => spread(column, present, values.into_iter()),
            Self::Counts(column) => spread(column, present, values.into_iter().map(i64::cast_unsigned)),
            Self::Numbers(_) | Self::Categories { .. } => {}
        }
    }

    fn extend_texts(
        &mut self,
        present: &[i16],
        values: &[ByteArray],
        places: &mut HashMap<Box<[u8]>, u32>,
    ) -> Result<(), ParquetError> {
        let Self::Categories { words, codes } = self else {
            return Ok(());
        };
        let mut of_values = Vec::with_capacity(values.len());
        for value in values {
            let code = match places.get(value.data()) {
                Some(code) => *code,
                None => {
                    let code = u32::try_from(words.len())
                        .map_err(|_| ParquetError::General("it has more than 2^32 distinct texts".to_owned()))?;
                    words.push(value.as_utf8()?.to_owned());
                    places.insert(value.data().into(), code);
                    code
                }
            };
            of_values.push(code);
        }
        spread(codes, present, of_values.into_iter());
        Ok(())
    }

    fn cell(&self, row: usize) -> Cell<'_> {
        let cell = match self {
            Self::Numbers(values) => values.get(row).copied().flatten().map(Cell::Number),
            Self::Integers(values) => values.get(row).copied().flatten().map(Cell::Integer),
            Self::Counts(values) => values.get(row).copied().flatten().map(Cell::Count),
            Self::Categories { words, codes } => {
                let word = codes.get(row).copied().flatten().and_then(|code| words.get(code as usize));
                word.map(|word| Cell::Text(word.as_str().into()))
            }
        };
        cell.unwrap_or(Cell::Null)
    }
}

/// Distributes the values to the rows that have one. Without levels every row has one.
fn spread<T>(column: &mut Vec<Option<T>>, present: &[i16], mut values: impl Iterator<Item = T>) {
    if present.is_empty() {
        column.extend(values.map(Some));
    } else {
        column.extend(present.iter().map(|level| if *level == 0 { None } else { values.next() }));
    }
}

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
        same_fidelity(&entry, self.dictionary.provenance.fidelity)?;
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
        DictionaryError::Value { path: self.dictionary.path.clone(), row: Row(self.row), column, value, reason }
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
