//! Reads and writes the dictionary as Parquet.
//!
//! The file has row groups of 16,384 rows, snappy compression, no page index, and a `created_by` with the
//! version of this tool: the same provenance and entries give the same bytes. The footer contains the schema version,
//! the provenance, the dataset hash and a CRC-32 for each column chunk. A chunk is decoded only if its bytes match the
//! CRC. Damage is reported with its position and never returned as data.

mod column;
mod entries;
mod reader;
mod writer;

use std::path::Path;

use parquet::basic::Type as Physical;
use parquet::errors::ParquetError;
use parquet::file::metadata::ColumnChunkMetaData;

use crate::DictionaryError;
use crate::columns::Kind;

pub use column::Column;
pub use entries::Entries;
pub use reader::Dictionary;
pub use writer::{DictionaryWriter, Written, write_parquet};

// Keys of the footer.
const KEY_VERSION: &str = "robogate.schema_version";
const KEY_PROVENANCE: &str = "robogate.provenance";
const KEY_DATASET: &str = "robogate.dataset_hash";
const KEY_CHECKSUMS: &str = "robogate.checksums";

fn physical(kind: Kind) -> Physical {
    match kind {
        Kind::Number => Physical::DOUBLE,
        Kind::Integer | Kind::Count => Physical::INT64,
        Kind::Text => Physical::BYTE_ARRAY,
    }
}

fn hex_crc(bytes: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(bytes))
}

/// Start and length of a column chunk in its file, if they are not negative.
fn byte_range(column: &ColumnChunkMetaData) -> Option<(u64, usize)> {
    let start = column.dictionary_page_offset().unwrap_or_else(|| column.data_page_offset());
    Some((u64::try_from(start).ok()?, usize::try_from(column.compressed_size()).ok()?))
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
