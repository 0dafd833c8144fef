//! Tests that damaged and hostile files are read or rejected without a panic.

use std::fs;
use std::path::Path;

use robogate_core::{Seed, Stream};
use robogate_dictionary::published::{export, import};
use robogate_dictionary::{Dictionary, Entry, Journal, write_parquet};

use crate::common::{Folder, PLAN, entry, provenance};

/// Reads the file with every reading function of a dictionary.
fn read_parquet(path: &Path) -> Result<Vec<Entry>, String> {
    let dictionary = Dictionary::open(path).map_err(|e| e.to_string())?;
    let names: Vec<String> = dictionary.column_names().map(ToOwned::to_owned).collect();
    for name in names {
        let _ = dictionary.column(&name);
    }
    dictionary.entries().collect::<Result<_, _>>().map_err(|e| e.to_string())
}

fn read_journal(path: &Path) -> Result<Vec<Entry>, String> {
    let (mut journal, _) = Journal::open(path, &PLAN).map_err(|e| e.to_string())?;
    journal.ordered().collect::<Result<_, _>>().map_err(|e| e.to_string())
}

fn read_published(path: &Path) -> Result<Vec<Entry>, String> {
    let to = path.with_extension("imported");
    import(path, &to).map_err(|e| e.to_string())?;
    read_parquet(&to)
}

type Reader = fn(&Path) -> Result<Vec<Entry>, String>;

/// A valid file of each kind with its reader.
fn kinds(folder: &Folder) -> [(&'static str, Vec<u8>, Reader); 3] {
    let parquet = folder.join("whole.parquet");
    write_parquet(&parquet, &provenance(), (0..40).map(|i| Ok(entry(i)))).unwrap();
    let path = folder.join("whole.journal");
    let mut journal = Journal::create(&path, &PLAN).unwrap();
    (0..10).for_each(|i| journal.append(&entry(i)).unwrap());
    let mut json = Vec::new();
    export(&Dictionary::open(&parquet).unwrap(), &mut json).unwrap();
    [
        ("parquet", fs::read(&parquet).unwrap(), read_parquet),
        ("journal", fs::read(&path).unwrap(), read_journal),
        ("json", json, read_published),
    ]
}

fn damage(whole: &[u8], stream: &mut Stream) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    match stream.below(5) {
        0 => bytes.truncate(stream.below(whole.len())),
        1 => {
            // Mutations hit the footer of a Parquet file more often than its size alone would give.
            let from = if stream.below(2) == 0 { 0 } else { whole.len() - whole.len() / 3 };
            for _ in 0..=stream.below(8) {
                let at = from + stream.below(whole.len() - from);
                bytes[at] ^= 1 << stream.below(8);
            }
        }
        2 => {
            let at = stream.below(whole.len());
            bytes.splice(at..at, (0..stream.below(40)).map(|i| (i * 37) as u8).collect::<Vec<_>>());
        }
        3 => {
            let at = stream.below(whole.len());
            let end = (at + stream.below(64)).min(whole.len());
            bytes[at..end].fill(if stream.below(2) == 0 { 0 } else { 0xff });
        }
        _ => {
            // Copies a piece of the file over another one: valid parts at the wrong position.
            let n = stream.below(200.min(whole.len()));
            let (from, to) = (stream.below(whole.len() - n), stream.below(whole.len() - n));
            bytes.copy_within(from..from + n, to);
        }
    }
    bytes
}

#[test]
fn damaged_files_never_panic() {
    let folder = Folder::new("hostile-damaged");
    for (kind, whole, read) in kinds(&folder) {
        let path = folder.join("damaged");
        fs::write(&path, &whole).unwrap();
        let sound = read(&path).unwrap();
        let (mut refused, mut other) = (0, 0);
        for case in 0..2000 {
            let bytes = damage(&whole, &mut Seed::campaign(case).stream(kind));
            fs::write(&path, &bytes).unwrap();
            match read(&path) {
                Err(error) => {
                    assert!(error.contains("damaged") || error.contains(folder.path().to_str().unwrap()), "{error}");
                    refused += 1;
                }
                // The checksums of our files detect all damage. JSON has none.
                Ok(entries) if kind == "parquet" => assert_eq!(entries, sound, "case {case}"),
                Ok(entries) if kind == "journal" => assert!(entries[..] == sound[..entries.len()], "case {case}"),
                Ok(_) => other += 1,
            }
        }
        println!("{kind}: {refused} of 2000 refused, {other} read as other data");
    }
}

#[test]
fn flipped_bits_are_rejected_or_harmless() {
    let folder = Folder::new("hostile-flip");
    let path = folder.join("d.parquet");
    write_parquet(&path, &provenance(), (0..3).map(|i| Ok(entry(i)))).unwrap();
    let whole = fs::read(&path).unwrap();
    let sound = read_parquet(&path).unwrap();
    let provenance = Dictionary::open(&path).unwrap().provenance().clone();
    let (mut refused, mut harmless) = (0, 0);
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        fs::write(&path, &bytes).unwrap();
        match read_parquet(&path) {
            Err(_) => refused += 1,
            Ok(entries) => {
                assert_eq!(entries, sound, "byte {at}");
                assert_eq!(*Dictionary::open(&path).unwrap().provenance(), provenance);
                harmless += 1;
            }
        }
    }
    println!("{refused} refused, {harmless} harmless");
    assert!(refused > harmless);
}

#[test]
fn random_bytes_are_rejected() {
    let folder = Folder::new("hostile-random");
    let path = folder.join("random");
    for case in 0..1000 {
        let mut stream = Seed::campaign(case).stream("random bytes");
        let n = stream.below(400);
        let mut bytes: Vec<u8> = (0..n).map(|_| stream.bits() as u8).collect();
        if case % 2 == 0 && n > 12 {
            // Longer than the part that format recognition reads.
            bytes[..4].copy_from_slice(b"PAR1");
            bytes[n - 4..].copy_from_slice(b"PAR1");
            let footer = stream.below(n) as u32;
            bytes[n - 8..n - 4].copy_from_slice(&footer.to_le_bytes());
        }
        fs::write(&path, &bytes).unwrap();
        assert!(read_parquet(&path).is_err());
        assert!(read_published(&path).is_err());
        assert!(n < 16 || read_journal(&path).is_err());
    }
}

#[test]
fn oversized_json_is_rejected() {
    let folder = Folder::new("hostile-json");
    let path = folder.join("p.json");
    let rows = |row: String| format!("{{\"experiments\": [{row}]}}");
    let wide: Vec<String> = (0..5000).map(|i| format!("\"f{i}\": {i}")).collect();
    for json in [
        "[".repeat(100_000),
        rows("[".repeat(100_000)),
        rows(format!("{{\"a\": {}", "{\"a\":".repeat(100_000))),
        rows(format!("{{{}}}", wide.join(","))),
        rows("{\"mass\": 1e999}".to_owned()),
        rows("{\"mass\": 123456789012345678901234567890, \"success\": true}".to_owned()),
        rows("{\"mass\": 1, \"mass\": 1}".to_owned()),
    ] {
        fs::write(&path, json).unwrap();
        assert!(read_published(&path).is_err());
    }
}
