//! Writes a dictionary, one row group at a time.

use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, Type};

use crate::atomic::AtomicFile;
use crate::columns::{Cell, Columns, Kind};
use crate::{DatasetHash, DictionaryError, Entry, Provenance, SCHEMA_VERSION};

use super::{KEY_CHECKSUMS, KEY_DATASET, KEY_PROVENANCE, KEY_VERSION, byte_range, hex_crc, physical};

/// Rows of a row group. A reader or writer keeps one group in memory, a few megabytes.
const ROWS_PER_GROUP: usize = 1 << 14;

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
        let columns = Columns::of_provenance(provenance)?;
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
