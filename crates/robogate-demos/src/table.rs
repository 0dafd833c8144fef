//! Parquet tables with the column types of LeRobot: numbers, lists of numbers or words, and images.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

/// A column of one row group.
#[derive(Debug, Clone)]
pub(crate) enum Column {
    Longs(Vec<i64>),
    Floats(Vec<f32>),
    Texts(Vec<String>),
    /// Each row is a list with this number of values.
    FloatLists(usize, Vec<f32>),
    /// Each row is a list of one text.
    TextLists(Vec<String>),
    /// Each row is a struct of the image bytes and a null path.
    Images(Vec<Vec<u8>>),
}

/// A Parquet file that is being written. All row groups have the columns of the first one.
pub(crate) struct Table {
    writer: SerializedFileWriter<File>,
}

impl Table {
    /// Creates a file with columns like these.
    pub(crate) fn create(
        path: &Path,
        like: &[(String, Column)],
        metadata: Vec<KeyValue>,
    ) -> Result<Self, ParquetError> {
        let fields = like.iter().map(|(name, column)| column.field(name)).collect::<Result<_, _>>()?;
        let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
        let properties = WriterProperties::builder()
            .set_created_by(format!("robogate version {}", env!("CARGO_PKG_VERSION")))
            .set_compression(Compression::SNAPPY)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_offset_index_disabled(true)
            .set_dictionary_enabled(false)
            .set_key_value_metadata(Some(metadata))
            .build();
        let file = File::create(path).map_err(|e| ParquetError::External(Box::new(e)))?;
        Ok(Self { writer: SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))? })
    }

    /// Adds a row group. Returns the number of bytes written so far.
    pub(crate) fn push(&mut self, columns: &[(String, Column)]) -> Result<usize, ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for (_, column) in columns {
            column.write(&mut group)?;
        }
        group.close()?;
        Ok(self.writer.bytes_written())
    }

    /// Completes the file.
    pub(crate) fn finish(mut self) -> Result<(), ParquetError> {
        self.writer.finish()?;
        let file = self.writer.inner_mut();
        file.flush().and_then(|()| file.sync_all()).map_err(|e| ParquetError::External(Box::new(e)))
    }
}

fn leaf(name: &str, physical: Physical, is_text: bool) -> Result<TypePtr, ParquetError> {
    Type::primitive_type_builder(name, physical)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(is_text.then_some(LogicalType::String))
        .build()
        .map(Arc::new)
}

/// The three schema levels of a list.
fn list(name: &str, element: TypePtr) -> Result<TypePtr, ParquetError> {
    let repeated = Type::group_type_builder("list").with_repetition(Repetition::REPEATED).with_fields(vec![element]);
    Type::group_type_builder(name)
        .with_repetition(Repetition::OPTIONAL)
        .with_logical_type(Some(LogicalType::List))
        .with_fields(vec![Arc::new(repeated.build()?)])
        .build()
        .map(Arc::new)
}

/// Definition levels at which a value is present: in a flat column, an image and a list.
const FLAT: i16 = 1;
const MEMBER: i16 = 2;
const ELEMENT: i16 = 3;

fn bytes<T: AsRef<[u8]>>(values: &[T]) -> Vec<ByteArray> {
    values.iter().map(|value| ByteArray::from(value.as_ref().to_vec())).collect()
}

impl Column {
    fn field(&self, name: &str) -> Result<TypePtr, ParquetError> {
        match self {
            Self::Longs(_) => leaf(name, Physical::INT64, false),
            Self::Floats(_) => leaf(name, Physical::FLOAT, false),
            Self::Texts(_) => leaf(name, Physical::BYTE_ARRAY, true),
            Self::FloatLists(..) => list(name, leaf("element", Physical::FLOAT, false)?),
            Self::TextLists(_) => list(name, leaf("element", Physical::BYTE_ARRAY, true)?),
            Self::Images(_) => Type::group_type_builder(name)
                .with_repetition(Repetition::OPTIONAL)
                .with_fields(vec![
                    leaf("bytes", Physical::BYTE_ARRAY, false)?,
                    leaf("path", Physical::BYTE_ARRAY, true)?,
                ])
                .build()
                .map(Arc::new),
        }
    }

    fn write(&self, group: &mut SerializedRowGroupWriter<'_, File>) -> Result<(), ParquetError> {
        let too_few = || ParquetError::General("the table has fewer columns than the row group".to_owned());
        let mut next = group.next_column()?.ok_or_else(too_few)?;
        match self {
            Self::Longs(values) => {
                next.typed::<Int64Type>().write_batch(values, Some(&vec![FLAT; values.len()]), None)?;
            }
            Self::Floats(values) => {
                next.typed::<FloatType>().write_batch(values, Some(&vec![FLAT; values.len()]), None)?;
            }
            Self::Texts(values) => {
                let there = vec![FLAT; values.len()];
                next.typed::<ByteArrayType>().write_batch(&bytes(values), Some(&there), None)?;
            }
            Self::FloatLists(length, values) => {
                let repeats: Vec<i16> = (0..values.len()).map(|i| i16::from(i % length != 0)).collect();
                let there = vec![ELEMENT; values.len()];
                next.typed::<FloatType>().write_batch(values, Some(&there), Some(&repeats))?;
            }
            Self::TextLists(values) => {
                let (there, repeats) = (vec![ELEMENT; values.len()], vec![0; values.len()]);
                next.typed::<ByteArrayType>().write_batch(&bytes(values), Some(&there), Some(&repeats))?;
            }
            Self::Images(values) => {
                let there = vec![MEMBER; values.len()];
                next.typed::<ByteArrayType>().write_batch(&bytes(values), Some(&there), None)?;
                next.close()?;
                next = group.next_column()?.ok_or_else(too_few)?;
                let absent = vec![FLAT; values.len()];
                next.typed::<ByteArrayType>().write_batch(&[], Some(&absent), None)?;
            }
        }
        next.close()
    }
}
