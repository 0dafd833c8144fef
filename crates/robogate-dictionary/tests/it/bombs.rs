//! Small files that request much memory or time are rejected, and the memory spent on them is bounded.
//!
//! The allocator counts, so the bounds hold on any machine and under any load. An allocation of a gigabyte or more ends
//! the test. The files are kept in `tests/corpus`; `ROBOGATE_UPDATE_CORPUS=1` writes them again.

use std::fs;
use std::path::{Path, PathBuf};

use parquet::file::metadata::ParquetMetaDataReader;
use robogate_dictionary::results::{Format, Mapping, import};
use robogate_dictionary::{Dictionary, write_parquet};
use robogate_testing::peak_memory;

use crate::common::{Folder, entry, provenance};
use crate::raw_parquet::{
    BOOLEAN, CHECKSUMS, Chunk, Column, DELTA_BYTE_ARRAY, DELTA_LENGTH_BYTE_ARRAY, DOUBLE, File, Group, INT64, PLAIN,
    Page, RLE_DICTIONARY, SNAPPY, TEXT, UNCOMPRESSED, ZSTD, delta, run, snappy, zstd_zeros,
};

/// Memory that any file may need, in bytes, and that each of its bytes may need.
const CONSTANT: usize = 256 << 20;
const PER_BYTE: usize = 100;

fn corpus(kind: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(kind)
}

/// Checks that a file is rejected with `expected` in the message, in bounded memory.
fn rejected(kind: &str, name: &str, bytes: &[u8], expected: &str, read: impl Fn(&Path) -> Result<(), String>) {
    let path = corpus(kind).join(name);
    if std::env::var_os("ROBOGATE_UPDATE_CORPUS").is_some() {
        fs::create_dir_all(corpus(kind)).unwrap();
        fs::write(&path, bytes).unwrap();
    }
    assert!(fs::read(&path).is_ok_and(|kept| kept == bytes), "{} is not the generated file", path.display());
    let (result, peak) = peak_memory(|| read(&path));
    let error = result.expect_err(name);
    assert!(error.contains(expected), "{name}: {error}");
    assert!(peak < CONSTANT + PER_BYTE * bytes.len(), "{name}: {} bytes need {peak} bytes of memory", bytes.len());
}

fn one(physical: i64, codec: i64, rows: i64, pages: Vec<Page>) -> File {
    let column = Column { name: "success".to_owned(), physical, optional: false };
    let group = Group { rows, chunks: vec![Chunk { codec, pages, same_as: None }], repeated: 1 };
    File { columns: vec![column], groups: vec![group], pairs: Vec::new() }
}

fn ten_truths() -> Page {
    Page::data(10, PLAIN, vec![0xff, 3])
}

fn import_it(path: &Path) -> Result<(), String> {
    let folder = Folder::new(&format!("bombs-{}", path.file_name().unwrap().to_string_lossy()));
    let to = folder.join("d.parquet");
    let imported = import(path, &to, Some(Format::Parquet), &Mapping::default());
    assert!(imported.is_ok() || !to.exists(), "an import that failed left a dictionary");
    imported.map(drop).map_err(|e| e.to_string())
}

#[test]
fn the_raw_writer_writes_readable_files() {
    let folder = Folder::new("bombs-sound");
    let path = folder.join("sound.parquet");
    fs::write(&path, one(BOOLEAN, UNCOMPRESSED, 10, vec![ten_truths()]).to_bytes()).unwrap();
    import_it(&path).unwrap();
}

#[test]
fn parquet_bombs_are_rejected_on_import() {
    let text = |length: usize| [&(length as u32).to_le_bytes()[..], &vec![b'a'; length]].concat();
    let indices = |rows: u64| [vec![1], run(rows)].concat();
    let claims = |unpacked: i64, page: Page| Page { unpacked, ..page };
    // Each value would repeat 64 KiB of the one before it.
    let prefixes = [delta(4096, 1 << 16, &[0; 160]), delta(4096, 0, &[0; 160])].concat();
    let repeated = Page::data(1 << 20, RLE_DICTIONARY, indices(1 << 20));
    let long = vec![Page::dictionary(1, text(1 << 16)), repeated.clone()];
    let many = vec![Page::dictionary(1, vec![0; 8]), repeated];
    let mut groups = one(DOUBLE, UNCOMPRESSED, 1 << 20, many.clone());
    groups.groups[0].repeated = 500;
    let billions = Page::data(i64::from(i32::MAX), RLE_DICTIONARY, indices(1 << 40));
    let zstd_pages = vec![claims(131_072, Page::data(1, PLAIN, zstd_zeros(100))); 300];
    let cases = [
        (
            "dictionary-values",
            one(INT64, UNCOMPRESSED, 10, vec![Page::dictionary(i64::from(i32::MAX), vec![0; 8]), ten_truths()]),
            "declares 2147483647 values",
        ),
        (
            "snappy-length",
            one(BOOLEAN, SNAPPY, 10, vec![claims(i64::from(i32::MAX), Page::data(10, PLAIN, snappy(1 << 31, 4)))]),
            "declares 2147483648 bytes",
        ),
        (
            "zstd-length",
            one(BOOLEAN, ZSTD, 10, vec![claims(10, Page::data(10, PLAIN, zstd_zeros(20_000)))]),
            "more than 67108864 bytes",
        ),
        ("zstd-pages", one(BOOLEAN, ZSTD, 300, zstd_pages), "unpack to more than 1024 times"),
        (
            "delta-length-values",
            one(TEXT, UNCOMPRESSED, 10, vec![Page::data(10, DELTA_LENGTH_BYTE_ARRAY, delta(1 << 40, 0, &[0; 32]))]),
            "declares 1099511627776 encoded values",
        ),
        (
            "delta-prefixes",
            one(TEXT, UNCOMPRESSED, 4096, vec![Page::data(4096, DELTA_BYTE_ARRAY, prefixes)]),
            "the texts of a page have more than 67108864 bytes",
        ),
        ("repeated-text", one(TEXT, UNCOMPRESSED, 1 << 20, long), "texts have more than"),
        ("many-rows", one(DOUBLE, UNCOMPRESSED, 1 << 40, vec![billions]), "may have"),
        ("many-groups", groups, "may have"),
        ("more-values-than-rows", one(DOUBLE, UNCOMPRESSED, 10, many), "more values than its row group has rows"),
    ];
    for (name, file, expected) in cases {
        rejected("parquet", name, &file.to_bytes(), expected, import_it);
    }
    // The footer states its own length.
    let mut bytes = one(BOOLEAN, UNCOMPRESSED, 10, vec![ten_truths()]).to_bytes();
    let at = bytes.len() - 8;
    bytes[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    rejected("parquet", "footer-length", &bytes, "its footer has 4294967295 bytes", import_it);
}

/// A dictionary with the schema and provenance of a written one, and pages of our own.
fn dictionary(rows: i64, pages: impl Fn(&Column) -> Chunk, repeated: usize) -> File {
    let folder = Folder::new(&format!("bombs-template-{repeated}-{rows}"));
    let path = folder.join("template.parquet");
    write_parquet(&path, &provenance(), [Ok(entry(0))].into_iter()).unwrap();
    let metadata = ParquetMetaDataReader::new().parse_and_finish(&fs::File::open(&path).unwrap()).unwrap();
    let metadata = metadata.file_metadata();
    let columns: Vec<Column> = (0..metadata.schema_descr().num_columns())
        .map(|i| {
            let leaf = metadata.schema_descr().column(i);
            let physical = match leaf.physical_type() {
                parquet::basic::Type::DOUBLE => DOUBLE,
                parquet::basic::Type::INT64 => INT64,
                _ => TEXT,
            };
            Column { name: leaf.name().to_owned(), physical, optional: leaf.max_def_level() > 0 }
        })
        .collect();
    let pairs = metadata.key_value_metadata().unwrap().iter();
    let pairs = pairs.map(|pair| {
        let value = pair.value.clone().unwrap_or_default();
        // The first checksum is that of the provenance.
        let value = if pair.key == CHECKSUMS { value.split(' ').next().unwrap().to_owned() } else { value };
        (pair.key.clone(), value)
    });
    let pairs = pairs.collect();
    let group = Group { rows, chunks: columns.iter().map(pages).collect(), repeated };
    File { columns, groups: vec![group], pairs }
}

/// Pages of zeros for any column: a dictionary with one value, and a run of it.
fn zeros(column: &Column, rows: u64) -> Chunk {
    let value = if column.physical == TEXT { vec![0; 4] } else { vec![0; 8] };
    let levels = if column.optional { crate::raw_parquet::present(rows) } else { Vec::new() };
    let body = [levels, vec![1], run(rows)].concat();
    let pages = vec![Page::dictionary(1, value), Page::data(rows as i64, RLE_DICTIONARY, body)];
    Chunk { codec: UNCOMPRESSED, pages, same_as: None }
}

#[test]
fn bombs_in_dictionaries_are_rejected() {
    let open = |path: &Path| {
        let dictionary = Dictionary::open(path).map_err(|e| e.to_string())?;
        let names: Vec<String> = dictionary.column_names().map(ToOwned::to_owned).collect();
        names.iter().try_for_each(|name| dictionary.column(name).map(drop)).map_err(|e| e.to_string())?;
        dictionary.entries().try_for_each(|entry| entry.map(drop)).map_err(|e| e.to_string())
    };
    let sound = dictionary(10, |column| zeros(column, 10), 1).to_bytes();
    let folder = Folder::new("bombs-dictionary");
    let path = folder.join("sound.parquet");
    fs::write(&path, sound).unwrap();
    // Its columns can be read. Its rows are not valid episodes.
    assert!(Dictionary::open(&path).unwrap().column("weight").is_ok());

    let rows = 1 << 20;
    let wide = dictionary(rows, |column| zeros(column, rows as u64), 1);
    rejected("dictionary", "many-rows", &wide.to_bytes(), "declares 1048576 rows of", open);
    let long = dictionary(1 << 16, |column| zeros(column, 1 << 16), 100);
    rejected("dictionary", "many-groups", &long.to_bytes(), "A file of this size may have", open);
    let first =
        |chunk: Chunk| move |column: &Column| if column.name == "index" { chunk.clone() } else { zeros(column, 10) };
    let claimed = Chunk {
        codec: UNCOMPRESSED,
        pages: vec![Page::dictionary(i64::from(i32::MAX), vec![0; 8]), Page::data(10, RLE_DICTIONARY, vec![1, 20, 0])],
        same_as: None,
    };
    let bytes = dictionary(10, first(claimed), 1).to_bytes();
    rejected("dictionary", "dictionary-values", &bytes, "declares 2147483647 values", open);
    let page = Page { unpacked: i64::from(i32::MAX), ..Page::data(10, PLAIN, snappy(1 << 31, 4)) };
    let packed = Chunk { codec: SNAPPY, pages: vec![page], same_as: None };
    let bytes = dictionary(10, first(packed), 1).to_bytes();
    rejected("dictionary", "snappy-length", &bytes, "declares 2147483648 bytes", open);
}

#[test]
fn provenance_bombs_are_rejected() {
    // Every `{"":0},` becomes a tree node of 632 bytes.
    let mut file = dictionary(10, |column| zeros(column, 10), 1);
    let json = format!("{{\"plan\":[{}0]}}", "{\"\":0},".repeat(300_000));
    for (key, value) in &mut file.pairs {
        match key.as_str() {
            "robogate.provenance" => value.clone_from(&json),
            CHECKSUMS => *value = format!("{:08x}", crc32fast::hash(json.as_bytes())),
            _ => {}
        }
    }
    let folder = Folder::new("bombs-provenance");
    let path = folder.join("provenance.parquet");
    fs::write(&path, file.to_bytes()).unwrap();
    let (result, peak) = peak_memory(|| Dictionary::open(&path));
    let error = result.unwrap_err().to_string();
    assert!(error.contains("too many values"), "{error}");
    assert!(peak < 32 << 20, "{peak}");
}
