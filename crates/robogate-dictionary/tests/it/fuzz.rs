//! Fuzzing of all file readers: the importers, the Parquet reader, the journal. A damaged file must be refused or read in
//! bounded time and memory, and without a panic.

use std::fs;
use std::path::Path;

use robogate_dictionary::results::{Format, Mapping, import};
use robogate_dictionary::{Dictionary, Journal, export, published, write_parquet};
use robogate_testing::fuzz;

use crate::common::{Folder, PLAN, entry, provenance};
use crate::raw_parquet::random;

/// A file reader under test. `read` returns `true` for an accepted file and `false` for a rejected one.
struct Target {
    name: &'static str,
    /// Valid files.
    valid: Vec<Vec<u8>>,
    /// Files that the reader refuses.
    refused: Vec<Vec<u8>>,
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
    let target = |name, valid, words, read| Target { name, valid, refused: Vec::new(), words, read };
    vec![
        target("parquet", vec![fs::read(&parquet).unwrap()], &["PAR1", "robogate.provenance"][..], read_dictionary),
        target("journal", vec![fs::read(&path).unwrap()], &[][..], read_journal),
        target("published", vec![as_published], JSON, |path| import_as(path, Some(Format::Published))),
        target("lerobot", vec![fixture("lerobot_one_environment.json"), fixture("lerobot_tasks.json")], JSON, |path| {
            import_as(path, Some(Format::LeRobot))
        }),
        target("inspect_robots", vec![fixture("../captures/inspect_robots.json")], JSON, |path| {
            import_as(path, Some(Format::InspectRobots))
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
        Target {
            // Its columns need a mapping.
            refused: vec![fixture("table.csv")],
            ..target(
                "recognised",
                vec![
                    fixture("lerobot_tasks.json"),
                    fixture("vla_eval.json"),
                    fixture("table.jsonl"),
                    fixture("table.parquet"),
                ],
                JSON,
                |path| import_as(path, None),
            )
        },
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

/// One test for each target, so that each can run for as long as the others.
macro_rules! fuzzed {
    ($($name:ident),* $(,)?) => {
        mod fuzzed {
            $(#[test]
            fn $name() {
                super::fuzzed(stringify!($name));
            })*

            #[test]
            fn all_targets_have_a_test() {
                let folder = crate::common::Folder::new("fuzz-all");
                let targets: Vec<&str> = super::targets(&folder).iter().map(|target| target.name).collect();
                assert_eq!(targets, [$(stringify!($name)),*]);
            }
        }
    };
}

fuzzed!(
    parquet,
    journal,
    published,
    lerobot,
    inspect_robots,
    vla_eval,
    csv,
    json_lines,
    exported_csv,
    exported_json,
    foreign_parquet,
    recognised,
    mapping,
);

fn fuzzed(name: &str) {
    let folder = Folder::new(&format!("fuzz-{name}"));
    let Target { valid, refused, words, read, .. } =
        targets(&folder).into_iter().find(|target| target.name == name).expect("it is in the list");
    let path = folder.join("fuzzed");
    fuzz::Target { name, valid: &valid, kept: &refused, words, inputs: 300 }.run(|bytes| {
        fs::write(&path, bytes).unwrap();
        read(&path)
    });
}

/// Files that are built part by part, so that a reader gets far into them.
#[test]
fn fuzzed_parts_of_parquet_never_panic() {
    let folder = Folder::new("fuzz-parquet");
    let path = folder.join("generated");
    for kind in ["parquet", "dictionary"] {
        for bytes in fuzz::corpus(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(kind)) {
            fs::write(&path, bytes).unwrap();
            assert!(!import_as(&path, Some(Format::Parquet)) && !read_dictionary(&path));
        }
    }
    let mut most = 0;
    let counts = fuzz::run(
        "parquet parts",
        4_000,
        |draw| random(draw).to_bytes(),
        |bytes| {
            fs::write(&path, bytes).unwrap();
            let (accepted, peak) = robogate_testing::peak_memory(|| import_as(&path, Some(Format::Parquet)));
            most = most.max(peak);
            accepted
        },
    );
    println!("most memory: {most} bytes");
    assert!(counts.read > 0 && most < 256 << 20, "{counts:?} {most}");
}
