//! Tests of the Parquet record.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::{Folder, SEED, entry, provenance, same, strange_entry, task};
use robogate_core::{Domain, Parameter, ParameterSpace, Scale, Seed, Value};
use robogate_dictionary::{
    Column, Dictionary, DictionaryError, DictionaryWriter, Entry, SchemaVersion, dataset_hash, write_parquet,
};

fn write(path: &Path, entries: impl Iterator<Item = Entry>) -> String {
    write_parquet(path, &provenance(), entries.map(Ok)).unwrap().dataset_hash
}

fn replace(path: &Path, old: &str, new: &str) {
    assert_eq!(old.len(), new.len());
    let mut bytes = fs::read(path).unwrap();
    let mut found = 0;
    for at in 0..bytes.len() - old.len() {
        if &bytes[at..at + old.len()] == old.as_bytes() {
            bytes[at..at + old.len()].copy_from_slice(new.as_bytes());
            found += 1;
        }
    }
    assert!(found > 0, "{old} not found");
    fs::write(path, bytes).unwrap();
}

#[test]
fn entries_and_provenance_come_back() {
    let folder = Folder::new("parquet-back");
    let path = folder.join("d.parquet");
    // More than one row group.
    let n = 20_000;
    let hash = write(&path, (0..n).map(entry));
    let dictionary = Dictionary::open(&path).unwrap();
    assert_eq!(dictionary.len(), n);
    assert_eq!(dictionary.provenance(), &provenance());
    assert_eq!(dictionary.dataset_hash(), hash);
    let mut rows = 0;
    for (expected, found) in (0..n).map(entry).zip(dictionary.entries()) {
        assert_eq!(expected, found.unwrap());
        rows += 1;
    }
    assert_eq!(rows, n);
    assert_eq!(dataset_hash(task(), dictionary.entries()).unwrap(), hash);
    assert_eq!(dataset_hash(task(), (0..n).map(|index| Ok(entry(index)))).unwrap(), hash);
}

#[test]
fn same_entries_give_same_bytes() {
    let folder = Folder::new("parquet-bytes");
    let (a, b) = (folder.join("a.parquet"), folder.join("b.parquet"));
    write(&a, (0..5000).map(entry));
    write(&b, (0..5000).map(entry));
    assert!(fs::read(&a).unwrap() == fs::read(&b).unwrap());
    write(&b, (0..5001).map(entry));
    assert!(fs::read(&a).unwrap() != fs::read(&b).unwrap());
}

#[test]
fn unfitting_values_are_kept_aside() {
    let folder = Folder::new("parquet-strange");
    let path = folder.join("d.parquet");
    write(&path, [strange_entry(4)].into_iter());
    let dictionary = Dictionary::open(&path).unwrap();
    let found = dictionary.entries().next().unwrap().unwrap();
    let mut expected = strange_entry(4);
    // The order is that of the space. Values that are not finite and no parameters have one form, missing or NaN.
    expected.episode.measures = found.episode.measures.clone();
    assert_eq!(found.episode.measures.get("peak_force_n"), None, "NaN is missing");
    assert_eq!(found.episode.measures.get("depth_m").map(f64::to_bits), Some((-0.0_f64).to_bits()));
    expected.episode.time_s = f64::NAN;
    let by_name = |entry: &Entry| {
        let mut pairs: Vec<_> = entry.episode.applied.iter().map(|(n, v)| (n.to_owned(), format!("{v:?}"))).collect();
        pairs.sort();
        pairs
    };
    assert_eq!(by_name(&expected), by_name(&found));
    expected.episode.applied = found.episode.applied.clone();
    assert!(same(&expected, &found), "{expected:#?}\n{found:#?}");
    assert_eq!(dataset_hash(task(), [Ok(strange_entry(4))]).unwrap(), dictionary.dataset_hash());
    // The plain columns contain no NaN.
    for name in ["applied_friction", "applied_mass_kg", "applied_obstacles", "peak_force_n", "cycle_time_s"] {
        assert_eq!(dictionary.numbers(name).unwrap(), [None], "{name}");
    }
    assert_eq!(dictionary.numbers("friction").unwrap()[0].unwrap().to_bits(), (-0.0_f64).to_bits());
}

#[test]
fn columns_are_read_by_name() {
    let folder = Folder::new("parquet-columns");
    let path = folder.join("d.parquet");
    let n = 17_000;
    write(&path, (0..n).map(entry));
    let dictionary = Dictionary::open(&path).unwrap();
    let friction = dictionary.numbers("friction").unwrap();
    assert_eq!(friction.len() as u64, n);
    assert_eq!(friction[16_500], entry(16_500).episode.scenario.requested.number("friction"));
    assert_eq!(dictionary.numbers("depth_m").unwrap()[16_506], None);
    assert_eq!(dictionary.numbers("obstacles").unwrap()[3], entry(3).episode.scenario.requested.number("obstacles"));
    let Column::Counts(index) = dictionary.column("index").unwrap() else { panic!() };
    assert!(index.into_iter().eq((0..n).map(Some)));
    let Column::Categories { words, codes } = dictionary.column("outcome").unwrap() else { panic!() };
    assert_eq!(words[codes[3].unwrap() as usize], "jammed");
    assert_eq!(words.len(), 6);
    let Column::Categories { words, codes } = dictionary.column("failure_type").unwrap() else { panic!() };
    assert_eq!(codes[13], None, "an invalid episode has no failure type");
    assert!(words.contains(&"none".to_owned()));
    assert!(matches!(dictionary.numbers("shape"), Err(DictionaryError::ColumnKind { .. })));
    let error = dictionary.column("mass").unwrap_err().to_string();
    assert!(error.contains("mass_kg"), "{error}");
}

#[test]
fn empty_dictionary_is_valid() {
    let folder = Folder::new("parquet-empty");
    let path = folder.join("d.parquet");
    write(&path, std::iter::empty());
    let dictionary = Dictionary::open(&path).unwrap();
    assert!(dictionary.is_empty());
    assert!(dictionary.entries().next().is_none());
    assert!(dictionary.column("weight").unwrap().is_empty());
}

#[test]
fn file_is_complete_or_absent() {
    let folder = Folder::new("parquet-atomic");
    let path = folder.join("d.parquet");
    write(&path, (0..10).map(entry));
    let before = fs::read(&path).unwrap();
    // An error in the middle of the entries, after a whole row group.
    let failing = (0..17_000).map(|index| if index == 16_999 { Err(failure()) } else { Ok(entry(index)) });
    assert!(write_parquet(&path, &provenance(), failing).is_err());
    let mut abandoned = DictionaryWriter::create(&path, &provenance()).unwrap();
    abandoned.push(&entry(0)).unwrap();
    drop(abandoned);
    assert!(fs::read(&path).unwrap() == before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
}

fn failure() -> DictionaryError {
    DictionaryError::Order { index: 0, previous: 0 }
}

#[test]
fn unusable_path_is_named() {
    let folder = Folder::new("parquet-folder");
    for path in [folder.join("no/such/d.parquet"), folder.path().to_owned()] {
        let error = DictionaryWriter::create(&path, &provenance()).unwrap_err();
        assert!(error.to_string().contains(folder.path().to_str().unwrap()), "{error}");
    }
    assert!(matches!(Dictionary::open(&folder.join("none")), Err(DictionaryError::Io { .. })));
}

#[test]
fn contradicting_entries_are_rejected() {
    let folder = Folder::new("parquet-refuse");
    let path = folder.join("d.parquet");
    let mut writer = DictionaryWriter::create(&path, &provenance()).unwrap();
    writer.push(&entry(5)).unwrap();
    for index in [5, 4] {
        assert!(matches!(writer.push(&entry(index)), Err(DictionaryError::Order { previous: 5, .. })));
    }
    let mut foreign = entry(6);
    foreign.episode.scenario.seed = Seed::campaign(SEED + 1).episode(6);
    assert!(matches!(writer.push(&foreign), Err(DictionaryError::ForeignCampaign { found: 2027, .. })));
    for (name, value) in [
        ("shape", Value::Number(1.0)),
        ("mass_kg", Value::Category("1.0".into())),
        ("mass_kg", Value::Number(f64::NAN)),
        ("obstacles", Value::Number(1.5)),
        ("colour", Value::Integer(1)),
    ] {
        let mut wrong = entry(6);
        wrong.episode.scenario.requested.set(name, value);
        let error = writer.push(&wrong).unwrap_err();
        assert!(
            matches!(&error, DictionaryError::Parameter { index: 6, parameter, .. } if parameter == name),
            "{error}"
        );
    }
    let mut missing = entry(6);
    missing.episode.scenario.requested = missing
        .episode
        .scenario
        .requested
        .iter()
        .filter(|(name, _)| *name != "shape")
        .map(|(name, value)| (name.into(), value.clone()))
        .collect();
    assert!(matches!(writer.push(&missing), Err(DictionaryError::Parameter { .. })));
    assert_eq!(writer.finish().unwrap().rows, 1);
}

#[test]
fn column_name_clash_is_rejected() {
    let folder = Folder::new("parquet-clash");
    let domain = || Domain::Continuous { low: 0.0, high: 1.0, scale: Scale::Linear };
    let of = |names: &[&str]| {
        let parameters = names.iter().map(|name| Parameter { name: (*name).into(), domain: domain() });
        ParameterSpace::new("clash", parameters.collect()).unwrap()
    };
    for names in [&["outcome"][..], &["seed"], &["applied_mass", "mass"], &["Mass", "mass"], &["Weight"]] {
        let provenance = robogate_dictionary::Provenance { space: of(names), ..provenance() };
        let error = DictionaryWriter::create(&folder.join("d"), &provenance).unwrap_err();
        assert!(
            matches!(&error, DictionaryError::ColumnClash { column } if names.iter().any(|n| column.ends_with(n))),
            "{error}"
        );
    }
}

#[test]
fn other_schemas_are_rejected() {
    let folder = Folder::new("parquet-version");
    let path = folder.join("d.parquet");
    // A provenance name with the same length as the version string: only the key-value pair is replaced.
    write(&path, (0..3).map(entry));
    let bytes = fs::read(&path).unwrap();
    let with_version = |version: &str| {
        let key = b"robogate.schema_version";
        let at = bytes.windows(key.len()).position(|window| window == key).unwrap() + key.len();
        let mut changed = bytes.clone();
        // Thrift's compact protocol: a field header, then the length of the text, then the text.
        assert_eq!(&changed[at + 2..at + 5], b"4.0");
        changed[at + 2..at + 5].copy_from_slice(version.as_bytes());
        fs::write(&path, changed).unwrap();
        Dictionary::open(&path)
    };
    let newer = with_version("5.0").unwrap_err();
    assert!(matches!(newer, DictionaryError::OtherSchema { found: SchemaVersion { major: 5, minor: 0 }, .. }));
    assert!(newer.to_string().contains("upgrade robogate"), "{newer}");
    for version in ["3.0", "1.0", "0.9"] {
        let older = with_version(version).unwrap_err().to_string();
        assert!(older.contains(&format!("its schema version is {version}. Expected 4.0")), "{older}");
        assert!(older.contains("run the campaign again"), "{older}");
    }
    let minor = with_version("4.7").unwrap();
    assert_eq!(minor.entries().filter(Result::is_ok).count(), 3);
    assert!(with_version("1-0").is_err());
}

#[test]
fn edited_provenance_is_noticed() {
    let folder = Folder::new("parquet-edit");
    let path = folder.join("d.parquet");
    write(&path, (0..50).map(entry));
    replace(&path, "franka", "frenka");
    let error = Dictionary::open(&path).unwrap_err().to_string();
    assert!(error.contains("provenance"), "{error}");
}

#[test]
fn foreign_and_truncated_files_are_rejected() {
    let folder = Folder::new("parquet-foreign");
    let path = folder.join("d.parquet");
    write(&path, (0..50).map(entry));
    let whole = fs::read(&path).unwrap();
    let says = |bytes: &[u8], words: &str| {
        fs::write(&path, bytes).unwrap();
        let error = Dictionary::open(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("d.parquet"), "{error}");
    };
    says(&whole[..whole.len() - 1], "truncated");
    says(&whole[..whole.len() / 2], "truncated");
    says(&whole[..5], "too few");
    says(b"", "0 bytes");
    says(b"{\"metadata\": {}, \"experiments\": []}", "robogate import");
}

#[test]
fn python_readers_agree() {
    let wanted = "a Python with pyarrow, pandas and duckdb";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let folder = Folder::new("parquet-readers");
    let path = folder.join("d.parquet");
    let hash = write(&path, (0..20_000).map(entry));
    let csv = folder.join("expected.csv");
    let mut out = fs::File::create(&csv).unwrap();
    robogate_dictionary::export::csv(&Dictionary::open(&path).unwrap(), &mut out).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers.py");
    let output = Command::new(python).arg(script).args([&path, &csv]).arg(hash).output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{out}{err}");
    println!("{out}");
}

/// The child process of the test below: writes a dictionary that exceeds the size limit.
#[test]
#[ignore = "run by another test"]
fn writer() {
    let path = std::env::var_os("ROBOGATE_TEST_DICTIONARY").expect("set by the test that runs this");
    let error = write_parquet(Path::new(&path), &provenance(), (0..40_000).map(|i| Ok(entry(i)))).unwrap_err();
    assert!(matches!(error, DictionaryError::Io { action: "write", .. }), "{error:?}");
    println!("stopped: {error}");
}

#[test]
#[cfg(target_os = "linux")]
fn full_disk_keeps_the_old_file() {
    let folder = Folder::new("parquet-full");
    let path = folder.join("d.parquet");
    write(&path, (0..10).map(entry));
    let before = fs::read(&path).unwrap();
    // As in the journal's test, a limit on the file size simulates a full disk.
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 1000; exec \"$0\" parquet::writer --exact --ignored --nocapture"])
        .arg(std::env::current_exe().unwrap())
        .env("ROBOGATE_TEST_DICTIONARY", &path)
        .output()
        .unwrap();
    let output = String::from_utf8_lossy(&output.stdout);
    assert!(output.contains("stopped: cannot write") && output.contains("1 passed"), "{output}");
    assert!(fs::read(&path).unwrap() == before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn fixed_columns_keep_their_order() {
    let folder = Folder::new("parquet-fixed");
    let path = folder.join("d.parquet");
    write(&path, std::iter::empty());
    let dictionary = Dictionary::open(&path).unwrap();
    let task = task();
    let measures = task.measures.iter().map(|measure| measure.name.to_string());
    let own: Vec<String> = provenance()
        .space
        .parameters()
        .iter()
        .flat_map(|p| [p.name.to_string(), format!("applied_{}", p.name)])
        .chain(measures)
        .collect();
    let fixed = dictionary.column_names().filter(|name| !own.iter().any(|own| own == name));
    assert!(fixed.eq(robogate_dictionary::fixed_columns().map(|column| column.name)));
}

#[test]
fn provenance_bytes_are_stable() {
    let schema = serde_json::to_value(schemars::schema_for!(robogate_dictionary::Provenance)).unwrap();
    for field in ["tool", "schema_version", "engine", "robot", "policy", "space", "plan", "seed"] {
        assert!(schema["required"].as_array().unwrap().contains(&field.into()), "{field}: {schema}");
    }
    let json = provenance().to_json();
    assert_eq!(json, provenance().to_json());
    assert_eq!(serde_json::from_str::<robogate_dictionary::Provenance>(&json).unwrap(), provenance());
}
