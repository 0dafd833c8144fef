//! Mutation fuzzing of all file readers: the importers, the Parquet reader, the journal.
//!
//! A damaged file must be rejected or read in bounded time and without a panic. A normal test run tries each reader a
//! few hundred times. For a longer run:
//!
//! ```text
//! ROBOGATE_FUZZ_SECONDS=600 cargo test --release -p robogate-dictionary --test it fuzz -- --nocapture
//! ```
//!
//! `ROBOGATE_FUZZ_SEED` sets the first round. A finding is printed with its round, which reproduces the file. The file
//! is also kept in the run's folder.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use robogate_core::{Seed, Stream};
use robogate_dictionary::results::{Format, Mapping, import};
use robogate_dictionary::{Dictionary, Journal, export, published, write_parquet};

use crate::common::{Folder, PLAN, entry, provenance};
use crate::raw_parquet::random;

/// A file reader under test. `read` returns `true` for an accepted file and `false` for a rejected one.
struct Target {
    name: &'static str,
    /// Valid files.
    corpus: Vec<Vec<u8>>,
    /// Words with a meaning for the reader.
    words: &'static [&'static str],
    read: fn(&Path) -> bool,
}

/// Every declared part of an accepted file must be readable.
fn read_dictionary(path: &Path) -> bool {
    let Ok(dictionary) = Dictionary::open(path) else {
        return false;
    };
    let names: Vec<String> = dictionary.column_names().map(ToOwned::to_owned).collect();
    let columns = names.iter().filter(|name| dictionary.column(name).is_ok()).count();
    dictionary.entries().all(|entry| entry.is_ok()) && columns == names.len()
}

fn read_journal(path: &Path) -> bool {
    Journal::open(path, &PLAN).is_ok_and(|(mut journal, _)| journal.ordered().all(|entry| entry.is_ok()))
}

/// An imported file must be a dictionary that can be opened.
fn import_as(path: &Path, format: Option<Format>) -> bool {
    let to = path.with_extension("imported");
    match import(path, &to, format, &Mapping::default()) {
        Err(_) => false,
        Ok(imported) => {
            assert!(read_dictionary(&to), "an imported dictionary cannot be read");
            assert!(imported.written.rows > 0, "the import accepted a file without rows");
            true
        }
    }
}

fn targets(folder: &Folder) -> Vec<Target> {
    let parquet = folder.join("whole.parquet");
    write_parquet(&parquet, &provenance(), (0..40).map(|i| Ok(entry(i)))).unwrap();
    let path = folder.join("whole.journal");
    let mut journal = Journal::create(&path, &PLAN).unwrap();
    (0..10).for_each(|i| journal.append(&entry(i)).unwrap());
    drop(journal);
    let mut as_published = Vec::new();
    let valid = folder.join("valid.parquet");
    // The published form has no faults.
    write_parquet(&valid, &provenance(), (0..6).map(|i| Ok(entry(i)))).unwrap();
    published::export(&Dictionary::open(&valid).unwrap(), &mut as_published).unwrap();
    let exported = [export::Format::Csv, export::Format::JsonLines].map(|format| {
        let path = folder.join("exported");
        export::write_file(&Dictionary::open(&parquet).unwrap(), format, &path).unwrap();
        fs::read(&path).unwrap()
    });
    let fixture =
        |name: &str| fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/results").join(name)).unwrap();
    const JSON: &[&str] = &[
        "{",
        "}",
        "[",
        "]",
        "null",
        "true",
        "false",
        "NaN",
        "1e999",
        "-0.0",
        "18446744073709551616",
        "\"\"",
        "\\u0000",
        "\\ud800",
        "per_episode",
        "per_task",
        "tasks",
        "episodes",
        "experiments",
        "successes",
        "success",
        "metrics",
        "failure_reason",
        "metadata",
        "[[[[[[[[",
        "{\"a\":{\"a\":{\"a\":",
    ];
    const TABLE: &[&str] = &[
        "\"", "\"\"", ",", ";", "\t", "\r", "\n", "nan", "inf", "1e400", "-1", "success", "error", "\u{feff}", "\u{0}",
    ];
    let target = |name, corpus, words, read| Target { name, corpus, words, read };
    vec![
        target("parquet", vec![fs::read(&parquet).unwrap()], &["PAR1", "robogate.provenance"][..], read_dictionary),
        target("journal", vec![fs::read(&path).unwrap()], &[][..], read_journal),
        target("published", vec![as_published], JSON, |path| import_as(path, Some(Format::Published))),
        target("lerobot", vec![fixture("lerobot_one_environment.json"), fixture("lerobot_tasks.json")], JSON, |path| {
            import_as(path, Some(Format::LeRobot))
        }),
        target("vla_eval", vec![fixture("vla_eval.json")], JSON, |path| import_as(path, Some(Format::VlaEval))),
        target(
            "csv",
            vec![
                b"success,failure_mode,cycle_time_s,collision,mass,shape\n1,,2.5,0,0.5,box\n0,collision,1,1,1.5,ball\n"
                    .to_vec(),
                b"success;x;y\ntrue;1;\"a;b\"\nfalse;2;\"c\"\"d\"\n;3;e\n".to_vec(),
            ],
            TABLE,
            |path| import_as(path, Some(Format::Csv)),
        ),
        target("json_lines", vec![fixture("table.jsonl")], JSON, |path| import_as(path, Some(Format::JsonLines))),
        target("exported_csv", vec![exported[0].clone()], TABLE, |path| import_as(path, Some(Format::Csv))),
        target("exported_json", vec![exported[1].clone()], JSON, |path| import_as(path, Some(Format::JsonLines))),
        target("foreign_parquet", vec![fixture("table.parquet")], &["PAR1"][..], |path| {
            import_as(path, Some(Format::Parquet))
        }),
        target(
            "recognised",
            vec![
                fixture("lerobot_tasks.json"),
                fixture("vla_eval.json"),
                fixture("table.jsonl"),
                fixture("table.csv"),
                fixture("table.parquet"),
            ],
            JSON,
            |path| import_as(path, None),
        ),
        target(
            "mapping",
            vec![fixture("table.toml")],
            &["[", "]", "=", "\"", "'''", "[parameters]", "ignore"][..],
            |path| {
                String::from_utf8(fs::read(path).unwrap()).is_ok_and(|text| Mapping::from_toml(&text, "fuzz").is_ok())
            },
        ),
    ]
}

/// Applies one to four mutations to a valid file.
fn mutate(target: &Target, stream: &mut Stream) -> Vec<u8> {
    let mut bytes = target.corpus[stream.below(target.corpus.len())].clone();
    for _ in 0..=stream.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = stream.below(bytes.len());
        // Half of the mutations are near the end, where Parquet stores its metadata.
        let at = if stream.below(2) == 0 { at } else { bytes.len() - 1 - at / 4 };
        match stream.below(9) {
            0 => bytes[at] ^= 1 << stream.below(8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'"'][stream.below(7)],
            2 => bytes.truncate(at),
            3 => {
                let end = (at + stream.below(32)).min(bytes.len());
                bytes.drain(at..end);
            }
            4 => {
                let random: Vec<u8> = (0..stream.below(16)).map(|_| stream.bits() as u8).collect();
                bytes.splice(at..at, random);
            }
            5 if !target.words.is_empty() => {
                let word = target.words[stream.below(target.words.len())].as_bytes();
                let end = if stream.below(2) == 0 { at } else { (at + word.len()).min(bytes.len()) };
                bytes.splice(at..end, word.iter().copied());
            }
            6 => {
                // Repeats a piece of the file, once or many times.
                let piece = bytes[at..(at + 1 + stream.below(64)).min(bytes.len())].to_vec();
                let again = piece.repeat(1 << stream.below(10));
                let to = stream.below(bytes.len());
                bytes.splice(to..to, again);
            }
            7 => {
                let other = &target.corpus[stream.below(target.corpus.len())];
                let from = stream.below(other.len());
                let piece = &other[from..(from + stream.below(200)).min(other.len())];
                bytes.splice(at..at, piece.iter().copied());
            }
            _ => {
                let n = stream.below(9);
                for byte in bytes.iter_mut().skip(at).take(n) {
                    *byte = stream.bits() as u8;
                }
            }
        }
    }
    bytes
}

fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is `{text}`, not an integer of at least 0")))
}

#[test]
fn fuzzed_files_never_panic_or_hang() {
    let budget = number("ROBOGATE_FUZZ_SECONDS").map(Duration::from_secs);
    let first = number("ROBOGATE_FUZZ_SEED").unwrap_or(0);
    let folder = Folder::new("fuzz");
    let targets = targets(&folder);
    for target in &targets {
        for (i, whole) in target.corpus.iter().enumerate() {
            let path = folder.join("sound");
            fs::write(&path, whole).unwrap();
            let needs_mapping = whole.starts_with(b"trial;ok");
            assert!((target.read)(&path) != needs_mapping, "{} file {i} is valid", target.name);
        }
    }
    let start = Instant::now();
    let mut counts = vec![(0_u64, 0_u64); targets.len()];
    let mut slowest = (Duration::ZERO, "", 0);
    let mut finds = Vec::new();
    let mut round = first;
    let path = folder.join("fuzzed");
    while budget.map_or(round < first + 300, |budget| start.elapsed() < budget) {
        for (target, (read, refused)) in targets.iter().zip(&mut counts) {
            let bytes = mutate(target, &mut Seed::campaign(round).stream(target.name));
            fs::write(&path, &bytes).unwrap();
            let began = Instant::now();
            match catch_unwind(AssertUnwindSafe(|| (target.read)(&path))) {
                Ok(true) => *read += 1,
                Ok(false) => *refused += 1,
                Err(_) => {
                    let kept = std::env::temp_dir().join(format!("robogate-fuzz-{}-{round}", target.name));
                    fs::write(&kept, &bytes).unwrap();
                    finds.push(format!("{} in round {round}: {}", target.name, kept.display()));
                }
            }
            let mut took = began.elapsed();
            if took > Duration::from_secs(5) {
                // The cause may be the file or a busy machine. A second run decides.
                let began = Instant::now();
                let _ = catch_unwind(AssertUnwindSafe(|| (target.read)(&path)));
                took = took.min(began.elapsed());
            }
            slowest = slowest.max((took, target.name, round));
        }
        round += 1;
    }
    for (target, (read, refused)) in targets.iter().zip(&counts) {
        println!("{}: {} files, {refused} refused, {read} read", target.name, read + refused);
    }
    println!("rounds {first} to {round} in {:.0?}; slowest {slowest:?}", start.elapsed());
    assert!(finds.is_empty(), "{finds:#?}");
    assert!(slowest.0 < Duration::from_secs(20), "{slowest:?}");
    // If every file were rejected at the first check, the fuzzing would test only that check.
    let enough = round - first >= 300;
    for (target, (read, refused)) in targets.iter().zip(&counts) {
        assert!(!enough || (*refused > 0 && *read > 0), "{}", target.name);
    }
}

/// Files that are built part by part, so that a reader gets far into them. Their number is [`ROUNDS`], or what
/// `ROBOGATE_FUZZ_SECONDS` allows.
#[test]
fn generated_parquet_files_never_panic() {
    const ROUNDS: u64 = 4_000;
    let budget = number("ROBOGATE_FUZZ_SECONDS").map(Duration::from_secs);
    let first = number("ROBOGATE_FUZZ_SEED").unwrap_or(0);
    let folder = Folder::new("fuzz-parquet");
    let path = folder.join("generated");
    for kind in ["parquet", "dictionary"] {
        let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(kind);
        for file in fs::read_dir(corpus).unwrap() {
            let file = file.unwrap().path();
            fs::copy(&file, &path).unwrap();
            assert!(!import_as(&path, Some(Format::Parquet)) && !read_dictionary(&path), "{}", file.display());
        }
    }
    let start = Instant::now();
    let (mut round, mut read) = (first, 0_u64);
    let mut most = (0, 0);
    while budget.map_or(round < first + ROUNDS, |budget| start.elapsed() < budget) {
        let bytes = random(&mut Seed::campaign(round).stream("parquet")).to_bytes();
        fs::write(&path, &bytes).unwrap();
        let (accepted, peak) = robogate_testing::peak_memory(|| import_as(&path, Some(Format::Parquet)));
        read += u64::from(accepted);
        most = most.max((peak, round));
        round += 1;
    }
    println!("{} files, {read} read, most memory {most:?} in {:.0?}", round - first, start.elapsed());
    assert!(read > 0, "no generated file is valid");
    assert!(most.0 < 256 << 20, "{most:?}");
}
