//! Reads the pages of Parquet columns within limits.
//!
//! A page header states how large its page is once it is unpacked and how many values it has, and the Parquet library
//! reserves what a header states. A few bytes could therefore request gigabytes. The library is told here that pages are
//! not compressed; they are decompressed and checked before it sees them. zstd is decompressed in Rust, because the library
//! would need a C compiler for it.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ::parquet::basic::{Compression, Encoding, Type as Physical};
use ::parquet::column::page::{Page, PageMetadata, PageReader};
use ::parquet::errors::{ParquetError, Result};
use ::parquet::file::metadata::ColumnChunkMetaData;
use ::parquet::file::reader::ChunkReader;
use ::parquet::file::serialized_reader::SerializedPageReader;
use ruzstd::decoding::StreamingDecoder;

use crate::delta;

/// Largest footer, in bytes. The footer of 30 million episodes with 60 columns has about this size.
const MOST_FOOTER: u64 = 16 << 20;

/// Largest page once it is unpacked, in bytes. Writers use about one megabyte.
const MOST_PAGE: u64 = 64 << 20;

/// Most bytes of unpacked pages that the columns of a file hold at one time.
const MOST_HELD: u64 = 256 << 20;

/// Bytes that a file may unpack to, in addition to [`UNPACKED_PER_BYTE`] for each of its bytes.
const UNPACKED: u64 = 256 << 20;
const UNPACKED_PER_BYTE: u64 = 1024;

/// Cells that a file may have, in addition to [`CELLS_PER_BYTE`] for each of its bytes. Run-length encoding stores any number
/// of equal values in a few bytes.
const CELLS: u64 = 1 << 24;
const CELLS_PER_BYTE: u64 = 64;

/// Snappy copies at most 64 bytes per instruction of two bytes.
const SNAPPY_RATIO: u64 = 32;

/// What the pages of one file may still cost. All columns of the file share it.
#[derive(Debug)]
pub(crate) struct Allowance {
    file_bytes: u64,
    /// Bytes that may still be unpacked.
    unpacked: AtomicU64,
    /// Bytes of the pages that are held now.
    held: AtomicU64,
}

impl Allowance {
    /// The allowance of a file of this size.
    pub(crate) fn of(file_bytes: u64) -> Arc<Self> {
        let unpacked = UNPACKED.saturating_add(file_bytes.saturating_mul(UNPACKED_PER_BYTE));
        Arc::new(Self { file_bytes, unpacked: AtomicU64::new(unpacked), held: AtomicU64::new(0) })
    }

    /// Checks the number of cells in a file.
    pub(crate) fn check_cells(&self, rows: u64, columns: usize) -> std::result::Result<(), String> {
        let most = CELLS.saturating_add(self.file_bytes.saturating_mul(CELLS_PER_BYTE));
        match rows.checked_mul(columns as u64) {
            Some(cells) if cells <= most => Ok(()),
            _ => Err(format!(
                "it declares {rows} rows of {columns} columns in {} bytes. A file of this size may have {most} values",
                self.file_bytes
            )),
        }
    }

    fn charge(&self, bytes: u64) -> Result<()> {
        let charged = self.unpacked.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes));
        charged.map(drop).map_err(|_| {
            general(format!("its pages unpack to more than {UNPACKED_PER_BYTE} times the size of the file"))
        })
    }
}

pub(crate) fn general(what: String) -> ParquetError {
    ParquetError::General(what)
}

/// Checks that the footer of a Parquet file has a limited size, before the library reads it.
pub(crate) fn check_footer(file: &mut File) -> std::result::Result<(), String> {
    let mut tail = [0; 8];
    let mut read = |file: &mut File| -> io::Result<()> {
        file.seek(SeekFrom::End(-8))?;
        file.read_exact(&mut tail)
    };
    read(file).map_err(|_| "it is too short for a Parquet file".to_owned())?;
    let [a, b, c, d, ..] = tail;
    match u64::from(u32::from_le_bytes([a, b, c, d])) {
        length if length > MOST_FOOTER => {
            Err(format!("its footer has {length} bytes. At most {MOST_FOOTER} are accepted"))
        }
        _ => Ok(()),
    }
}

/// The pages of one column chunk, decompressed and checked. `rows` is the number of rows in the row group.
pub(crate) fn page_reader<R: ChunkReader + 'static>(
    chunk: Arc<R>,
    column: &ColumnChunkMetaData,
    rows: usize,
    allowance: &Arc<Allowance>,
) -> Result<Box<dyn PageReader>> {
    let codec = column.compression();
    if !matches!(codec, Compression::UNCOMPRESSED | Compression::SNAPPY | Compression::ZSTD(_)) {
        return Err(general(format!("the compression {codec} is not supported")));
    }
    let plain = column.clone().into_builder().set_compression(Compression::UNCOMPRESSED).build()?;
    Ok(Box::new(Pages {
        inner: SerializedPageReader::new(chunk, &plain, rows, None)?,
        codec,
        physical: column.column_type(),
        optional: column.column_descr().max_def_level() > 0,
        values_left: rows,
        dictionary: 0,
        page: 0,
        allowance: Arc::clone(allowance),
    }))
}

struct Pages<R: ChunkReader> {
    inner: SerializedPageReader<R>,
    codec: Compression,
    physical: Physical,
    /// Whether the pages contain definition levels.
    optional: bool,
    /// Values that the data pages may still have. The columns are flat: one value per row.
    values_left: usize,
    /// Bytes of the dictionary page and of the current data page.
    dictionary: u64,
    page: u64,
    allowance: Arc<Allowance>,
}

impl<R: ChunkReader> Drop for Pages<R> {
    fn drop(&mut self) {
        self.allowance.held.fetch_sub(self.dictionary + self.page, Ordering::Relaxed);
    }
}

impl<R: ChunkReader> Pages<R> {
    fn unpack(&self, packed: &[u8]) -> Result<Vec<u8>> {
        if packed.is_empty() {
            return Ok(Vec::new());
        }
        let unpacked = match self.codec {
            Compression::SNAPPY => unsnap(packed)?,
            _ => unzstd(packed)?,
        };
        self.allowance.charge(unpacked.len() as u64)?;
        Ok(unpacked)
    }

    /// The page with its values decompressed. The levels of a page of version 2 are never compressed.
    fn decompressed(&self, mut page: Page) -> Result<Page> {
        if self.codec == Compression::UNCOMPRESSED {
            return Ok(page);
        }
        match &mut page {
            Page::DataPage { buf, .. } | Page::DictionaryPage { buf, .. } => *buf = self.unpack(buf)?.into(),
            Page::DataPageV2 { buf, def_levels_byte_len, rep_levels_byte_len, is_compressed, .. } => {
                let (levels, values) = split_levels(buf, *def_levels_byte_len, *rep_levels_byte_len)?;
                if std::mem::replace(is_compressed, false) {
                    *buf = [levels, &self.unpack(values)?].concat().into();
                }
            }
        }
        Ok(page)
    }

    /// Checks what the library would believe.
    fn check(&mut self, page: &Page) -> Result<()> {
        let size = page.buffer().len() as u64;
        if size > MOST_PAGE {
            return Err(general(format!("a page has {size} bytes. At most {MOST_PAGE} are accepted")));
        }
        let values = page.num_values() as usize;
        let encoding = page.encoding();
        if let Page::DictionaryPage { .. } = page {
            if !matches!(encoding, Encoding::PLAIN | Encoding::PLAIN_DICTIONARY) {
                return Err(general(format!("a dictionary page has the encoding {encoding}")));
            }
            let most = match self.physical {
                Physical::BOOLEAN => size * 8,
                Physical::INT64 | Physical::DOUBLE => size / 8,
                _ => size / 4,
            };
            if values as u64 > most {
                return Err(general(format!("a dictionary page of {size} bytes declares {values} values")));
            }
        } else {
            self.values_left = self
                .values_left
                .checked_sub(values)
                .ok_or_else(|| general("its pages have more values than its row group has rows".to_owned()))?;
            match encoding {
                Encoding::PLAIN
                | Encoding::PLAIN_DICTIONARY
                | Encoding::RLE_DICTIONARY
                | Encoding::RLE
                | Encoding::BYTE_STREAM_SPLIT => {}
                Encoding::DELTA_BINARY_PACKED | Encoding::DELTA_LENGTH_BYTE_ARRAY => {
                    check_count(self.encoded(page)?, values)?;
                }
                // It repeats the start of the previous value: n bytes can become n values of n bytes.
                Encoding::DELTA_BYTE_ARRAY => self.allowance.charge(size_of_texts(self.encoded(page)?, values)?)?,
                _ => return Err(general(format!("the encoding {encoding} is not supported"))),
            }
        }
        let held = if matches!(page, Page::DictionaryPage { .. }) { &mut self.dictionary } else { &mut self.page };
        let before = std::mem::replace(held, size);
        let all = self.allowance.held.fetch_add(size, Ordering::Relaxed) + size - before;
        self.allowance.held.fetch_sub(before, Ordering::Relaxed);
        if all > MOST_HELD {
            return Err(general(format!("the pages of its columns need more than {MOST_HELD} bytes at one time")));
        }
        Ok(())
    }

    /// The encoded values of a data page, without its levels.
    fn encoded<'a>(&self, page: &'a Page) -> Result<&'a [u8]> {
        let bytes: &[u8] = page.buffer();
        match page {
            Page::DataPageV2 { def_levels_byte_len, rep_levels_byte_len, .. } => {
                Ok(split_levels(bytes, *def_levels_byte_len, *rep_levels_byte_len)?.1)
            }
            // The levels of version 1 start with their length.
            _ if self.optional => {
                let (length, rest) = bytes.split_first_chunk::<4>().ok_or_else(delta::short)?;
                rest.get(u32::from_le_bytes(*length) as usize..).ok_or_else(delta::short)
            }
            _ => Ok(bytes),
        }
    }
}

/// Checks the number of values in the header of a delta encoding.
fn check_count(encoded: &[u8], values: usize) -> Result<()> {
    match encoded {
        [] => Ok(()),
        _ => delta::Header::read(encoded, values).map(drop),
    }
}

/// The bytes of all texts of a page in the encoding `DELTA_BYTE_ARRAY`: the lengths of the repeated starts, then the lengths of the
/// rests, then the rests.
fn size_of_texts(encoded: &[u8], values: usize) -> Result<u64> {
    if encoded.is_empty() {
        return Ok(0);
    }
    let (repeated, rest) = delta::sum(encoded, values)?;
    let (own, _) = delta::sum(rest, values)?;
    match repeated.checked_add(own) {
        Some(size) if size <= MOST_PAGE => Ok(size),
        _ => Err(general(format!("the texts of a page have more than {MOST_PAGE} bytes"))),
    }
}

/// Splits a page of version 2 into levels and values.
fn split_levels(page: &[u8], definition: u32, repetition: u32) -> Result<(&[u8], &[u8])> {
    let levels = definition as usize + repetition as usize;
    page.split_at_checked(levels).ok_or_else(|| general("a page is shorter than its levels".to_owned()))
}

fn unsnap(packed: &[u8]) -> Result<Vec<u8>> {
    let wrong = |error: snap::Error| general(format!("a snappy page is damaged: {error}"));
    let size = snap::raw::decompress_len(packed).map_err(wrong)? as u64;
    if size > MOST_PAGE || size > SNAPPY_RATIO * packed.len() as u64 {
        return Err(general(format!("a snappy page of {} bytes declares {size} bytes", packed.len())));
    }
    snap::raw::Decoder::new().decompress_vec(packed).map_err(wrong)
}

fn unzstd(packed: &[u8]) -> Result<Vec<u8>> {
    let wrong = |what: String| general(format!("a zstd page is damaged: {what}"));
    let decoder = StreamingDecoder::new(packed).map_err(|error| wrong(error.to_string()))?;
    let mut unpacked = Vec::new();
    let n = decoder.take(MOST_PAGE + 1).read_to_end(&mut unpacked).map_err(|error| wrong(error.to_string()))?;
    if n as u64 > MOST_PAGE { Err(wrong(format!("it has more than {MOST_PAGE} bytes"))) } else { Ok(unpacked) }
}

impl<R: ChunkReader> Iterator for Pages<R> {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl<R: ChunkReader> PageReader for Pages<R> {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        let Some(page) = self.inner.get_next_page()? else { return Ok(None) };
        let page = self.decompressed(page)?;
        self.check(&page)?;
        Ok(Some(page))
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        self.inner.peek_next_page()
    }

    fn skip_next_page(&mut self) -> Result<()> {
        self.inner.skip_next_page()
    }
}
