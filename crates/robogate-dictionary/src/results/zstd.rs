//! Reads Parquet columns that are compressed with zstd.
//!
//! The library would need a C compiler for zstd. Its page reader is told that the pages are not compressed, and its
//! pages are decompressed here in Rust.

use std::fs::File;
use std::io::Read;
use std::sync::Arc;

use ::parquet::basic::Compression;
use ::parquet::column::page::{Page, PageMetadata, PageReader};
use ::parquet::column::reader::{ColumnReader, get_column_reader};
use ::parquet::errors::{ParquetError, Result};
use ::parquet::file::metadata::ColumnChunkMetaData;
use ::parquet::file::serialized_reader::SerializedPageReader;
use bytes::Bytes;
use ruzstd::decoding::StreamingDecoder;

/// Maximum unpacked size of one page, in bytes. Writers use about one megabyte.
const MOST_PAGE: u64 = 256 << 20;

/// A reader of one column chunk with zstd pages.
pub(super) fn column_reader(file: &Arc<File>, column: &ColumnChunkMetaData, rows: usize) -> Result<ColumnReader> {
    let plain = column.clone().into_builder().set_compression(Compression::UNCOMPRESSED).build()?;
    let pages = SerializedPageReader::new(Arc::clone(file), &plain, rows, None)?;
    Ok(get_column_reader(column.column_descr_ptr(), Box::new(ZstdPages(pages))))
}

/// Pages, decompressed.
struct ZstdPages(SerializedPageReader<File>);

fn unpack(packed: &[u8]) -> Result<Vec<u8>> {
    let wrong = |what: String| ParquetError::General(format!("a zstd page is damaged: {what}"));
    let mut decoder = StreamingDecoder::new(packed).map_err(|error| wrong(error.to_string()))?;
    let mut unpacked = Vec::new();
    let n = decoder.by_ref().take(MOST_PAGE).read_to_end(&mut unpacked).map_err(|error| wrong(error.to_string()))?;
    if n as u64 == MOST_PAGE { Err(wrong(format!("it has more than {MOST_PAGE} bytes"))) } else { Ok(unpacked) }
}

/// The page with its values decompressed. The levels of a page of version 2 are never compressed.
fn decompressed(page: Page) -> Result<Page> {
    Ok(match page {
        Page::DataPage { buf, num_values, encoding, def_level_encoding, rep_level_encoding, statistics } => {
            Page::DataPage {
                buf: unpack(&buf)?.into(),
                num_values,
                encoding,
                def_level_encoding,
                rep_level_encoding,
                statistics,
            }
        }
        Page::DictionaryPage { buf, num_values, encoding, is_sorted } => {
            Page::DictionaryPage { buf: unpack(&buf)?.into(), num_values, encoding, is_sorted }
        }
        Page::DataPageV2 {
            buf,
            num_values,
            encoding,
            num_nulls,
            num_rows,
            def_levels_byte_len,
            rep_levels_byte_len,
            is_compressed,
            statistics,
        } => {
            let levels = def_levels_byte_len as usize + rep_levels_byte_len as usize;
            let (levels, values) = buf
                .split_at_checked(levels)
                .ok_or_else(|| ParquetError::General("a page is shorter than its levels".to_owned()))?;
            let buf = if is_compressed && !values.is_empty() {
                let mut whole = levels.to_vec();
                whole.extend(unpack(values)?);
                Bytes::from(whole)
            } else {
                buf
            };
            Page::DataPageV2 {
                buf,
                num_values,
                encoding,
                num_nulls,
                num_rows,
                def_levels_byte_len,
                rep_levels_byte_len,
                is_compressed: false,
                statistics,
            }
        }
    })
}

impl Iterator for ZstdPages {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for ZstdPages {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        self.0.get_next_page()?.map(decompressed).transpose()
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        self.0.peek_next_page()
    }

    fn skip_next_page(&mut self) -> Result<()> {
        self.0.skip_next_page()
    }
}
