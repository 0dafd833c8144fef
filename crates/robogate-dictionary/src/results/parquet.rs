//! Reads a flat Parquet file of another tool.

use std::io;
use std::path::Path;
use std::sync::Arc;

use ::parquet::basic::{ConvertedType, Type as Physical};
use ::parquet::column::reader::{ColumnReader, get_column_reader};
use ::parquet::errors::ParquetError;
use ::parquet::file::reader::{FileReader, SerializedFileReader};

use super::{Frame, Sink};
use crate::DictionaryError;
use crate::pages::{Allowance, check_footer, page_reader};
use crate::parquet::guarded;
use crate::raw::{MOST_FIELDS, Metered, RawRow, Scalar};

/// Number of rows decoded at a time.
const BATCH: usize = 4096;

/// Maximum unpacked size of a column in one row group, in bytes.
const MOST_COLUMN: i64 = 1 << 30;

/// Maximum bytes of the texts in one batch of rows. A text of a dictionary page may be repeated in every row.
const MOST_TEXT: usize = 64 << 20;

pub(super) fn read(path: &Path, sink: Sink<'_>) -> Result<Frame, DictionaryError> {
    let refuse = |reason: String| {
        DictionaryError::results(
            path,
            format!(
                "{reason}. Expected flat columns, uncompressed, snappy or zstd\nHint: write it again with compression=\"zstd\""
            ),
        )
    };
    let mut hashed = Metered::open(path, u64::MAX)?;
    io::copy(&mut hashed, &mut io::sink()).map_err(DictionaryError::io(path, "read"))?;
    let mut file = std::fs::File::open(path).map_err(DictionaryError::io(path, "open"))?;
    check_footer(&mut file).map_err(refuse)?;
    let length = file.metadata().map_err(DictionaryError::io(path, "inspect"))?.len();
    let file = Arc::new(file);
    let reader = guarded(|| SerializedFileReader::new(Arc::clone(&file).as_ref().try_clone()?)).map_err(refuse)?;
    let metadata = reader.metadata();
    let schema = metadata.file_metadata().schema_descr();
    if schema.num_columns() > MOST_FIELDS {
        return Err(refuse(format!("it has {} columns, more than the limit of {MOST_FIELDS}", schema.num_columns())));
    }
    let mut frame = Frame { sha256: hashed.sha256(), ..Frame::default() };
    let mut columns: Vec<(usize, Arc<str>)> = Vec::new();
    let mut unsigned: Vec<bool> = Vec::new();
    for (i, column) in schema.columns().iter().enumerate() {
        let name = column.path().string();
        let plain = column.max_rep_level() == 0 && column.max_def_level() <= 1 && column.path().parts().len() == 1;
        if plain && !matches!(column.physical_type(), Physical::INT96 | Physical::FIXED_LEN_BYTE_ARRAY) {
            columns.push((i, name.into()));
            unsigned.push(matches!(column.converted_type(), ConvertedType::UINT_32 | ConvertedType::UINT_64));
        } else {
            frame
                .notes
                .push(format!("Column `{name}` is ignored: it does not contain plain numbers, truth values or texts."));
        }
    }
    let allowance = Allowance::of(length);
    let mut row = RawRow::default();
    let all_rows = metadata.row_groups().iter().map(|group| group.num_rows().unsigned_abs());
    let all_rows = all_rows.fold(0, u64::saturating_add);
    allowance.check_cells(all_rows, columns.len().max(1)).map_err(refuse)?;
    for (at, group) in metadata.row_groups().iter().enumerate() {
        let rows = usize::try_from(group.num_rows())
            .map_err(|_| refuse(format!("row group {at} has {} rows", group.num_rows())))?;
        for (leaf, name) in &columns {
            let Some(column) = group.columns().get(*leaf) else {
                return Err(refuse(format!("row group {at} has no column `{name}`")));
            };
            let packed = u64::try_from(column.compressed_size()).ok().filter(|size| *size <= length);
            if packed.is_none() || !(0..=MOST_COLUMN).contains(&column.uncompressed_size()) {
                let (packed, whole) = (column.compressed_size(), column.uncompressed_size());
                return Err(refuse(format!(
                    "column `{name}` of row group {at} declares {packed} bytes packed and {whole} unpacked"
                )));
            }
        }
        let mut readers = guarded(|| {
            let open = |(leaf, _): &(usize, Arc<str>)| {
                let column = group.column(*leaf);
                let pages = page_reader(Arc::clone(&file), column, rows, &allowance)?;
                Ok(get_column_reader(column.column_descr_ptr(), pages))
            };
            columns.iter().map(open).collect::<Result<Vec<_>, ParquetError>>()
        })
        .map_err(refuse)?;
        let mut left = rows;
        while left > 0 {
            let n = left.min(BATCH);
            let mut text = MOST_TEXT;
            let batch = guarded(|| {
                readers
                    .iter_mut()
                    .zip(&unsigned)
                    .map(|(reader, unsigned)| values(reader, n, *unsigned, &mut text))
                    .collect::<Result<Vec<_>, _>>()
            })
            .map_err(refuse)?;
            let mut batch: Vec<_> = batch.into_iter().map(Vec::into_iter).collect();
            for _ in 0..n {
                row.fields.clear();
                for ((_, name), values) in columns.iter().zip(&mut batch) {
                    row.fields.push((Arc::clone(name), values.next().unwrap_or(Scalar::Null)));
                }
                sink(&row)?;
                row.number += 1;
            }
            left -= n;
        }
    }
    Ok(frame)
}

/// The next `n` values of a column, whose integers may be unsigned. Texts are charged to `text`, a number of bytes.
fn values(reader: &mut ColumnReader, n: usize, unsigned: bool, text: &mut usize) -> Result<Vec<Scalar>, ParquetError> {
    macro_rules! read {
        ($reader:expr, $scalar:expr) => {{
            let (mut present, mut values) = (Vec::new(), Vec::new());
            let (found, _, _) = $reader.read_records(n, Some(&mut present), None, &mut values)?;
            if found != n {
                return Err(ParquetError::General(format!("a column ends {} rows early", n - found)));
            }
            let mut values = values.into_iter().map($scalar);
            if present.is_empty() {
                values.collect()
            } else {
                present
                    .into_iter()
                    .map(
                        |level: i16| {
                            if level == 0 { Ok(Scalar::Null) } else { values.next().unwrap_or(Ok(Scalar::Null)) }
                        },
                    )
                    .collect()
            }
        }};
    }
    match reader {
        ColumnReader::BoolColumnReader(reader) => read!(reader, |truth| Ok(Scalar::Bool(truth))),
        ColumnReader::Int32ColumnReader(reader) if unsigned => {
            read!(reader, |n: i32| Ok(Scalar::Integer(n.cast_unsigned().into())))
        }
        ColumnReader::Int64ColumnReader(reader) if unsigned => {
            read!(reader, |n: i64| Ok(Scalar::unsigned(n.cast_unsigned())))
        }
        ColumnReader::Int32ColumnReader(reader) => read!(reader, |n| Ok(Scalar::Integer(n.into()))),
        ColumnReader::Int64ColumnReader(reader) => read!(reader, |n| Ok(Scalar::Integer(n))),
        ColumnReader::FloatColumnReader(reader) => read!(reader, |x| Ok(number(x.into()))),
        ColumnReader::DoubleColumnReader(reader) => read!(reader, |x| Ok(number(x))),
        ColumnReader::ByteArrayColumnReader(reader) => {
            read!(reader, |value: ::parquet::data_type::ByteArray| {
                *text = text.checked_sub(value.len()).ok_or_else(|| {
                    ParquetError::General(format!("its texts have more than {MOST_TEXT} bytes in {BATCH} rows"))
                })?;
                Ok(Scalar::Text(value.as_utf8()?.to_owned()))
            })
        }
        ColumnReader::Int96ColumnReader(_) | ColumnReader::FixedLenByteArrayColumnReader(_) => {
            Err(ParquetError::General("a column has an unsupported type".to_owned()))
        }
    }
}

/// Data frames store a missing value as NaN. A parameter cannot be infinite.
fn number(x: f64) -> Scalar {
    if x.is_nan() {
        Scalar::Null
    } else if x.is_finite() {
        Scalar::Number(x)
    } else {
        Scalar::Text(x.to_string())
    }
}
