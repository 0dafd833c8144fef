//! Files that spreadsheets, Python and version control leave behind: the right value or an error, never a wrong figure.

use std::fs;

use robogate_core::Value;
use robogate_dictionary::results::audit::{Audit, Check, CheckResult, audit};
use robogate_dictionary::results::{Mapping, import, import_export, recorded_seed};
use robogate_dictionary::{Dictionary, DictionaryError, Entry, Provenance, export};

use crate::common::Folder;

fn read(name: &str, content: impl AsRef<[u8]>) -> Result<(Provenance, Vec<Entry>), DictionaryError> {
    let folder = Folder::new(&format!("foreign-{name}"));
    let (from, to) = (folder.join("t"), folder.join("d.parquet"));
    fs::write(&from, content).unwrap();
    import(&from, &to, None, &Mapping::default())?;
    let dictionary = Dictionary::open(&to).unwrap();
    let entries = dictionary.entries().collect::<Result<_, _>>().unwrap();
    Ok((dictionary.provenance().clone(), entries))
}

fn refused(name: &str, content: impl AsRef<[u8]>, wanted: &[&str]) {
    let error = read(name, content).unwrap_err().to_string();
    assert!(wanted.iter().all(|part| error.contains(part)), "{name}: {error}");
}

fn audited(name: &str, content: &str) -> Result<Audit, DictionaryError> {
    let folder = Folder::new(&format!("foreign-audit-{name}"));
    let path = folder.join("t");
    fs::write(&path, content).unwrap();
    audit(&path, None, &Mapping::default())
}

fn result(audit: &Audit, check: Check) -> &CheckResult {
    &audit.checks.iter().find(|checked| checked.check == check).unwrap().result
}

fn not_checked(audit: &Audit, check: Check) -> &str {
    match result(audit, check) {
        CheckResult::NotPossible { because } => because,
        other => panic!("{other:?}"),
    }
}

fn words(entries: &[Entry]) -> String {
    entries.iter().map(|entry| entry.episode.outcome.as_str()).collect::<Vec<_>>().join(" ")
}

fn numbers(entries: &[Entry], parameter: &str) -> Vec<f64> {
    entries.iter().map(|entry| entry.episode.scenario.requested.number(parameter).unwrap()).collect()
}

fn notes(provenance: &Provenance) -> String {
    provenance.source.as_ref().unwrap().notes.join("\n")
}

#[test]
fn repeated_header_is_no_episode() {
    let (provenance, entries) = read("merged", "trial_no,success\n1,no\ntrial_no,success\n2,no\n3,yes\n").unwrap();
    assert_eq!(words(&entries), "unknown unknown success");
    assert!(notes(&provenance).contains("repeat the header, as after a merge of files: 1, first line 3"));
    // Other columns, or another order, would change the meaning of the rows after them.
    let wanted = &["line 3", "second header with other columns"];
    refused("order", "mass,success\n1,1\nsuccess,mass\n1,0\n", wanted);
    refused("other", "run,mass,success\n1,1,0\nrun,weight,success\n2,1,0\n", wanted);
    refused("single", "success\nfail\nsuccess\n", &["line 3", "a header or a value"]);
    // A word that is also the name of a column.
    assert_eq!(words(&read("word", "mass,success\n1,success\n2,fail\n").unwrap().1), "success unknown");
}

#[test]
fn decimal_commas_are_numbers() {
    let (_, entries) = read("comma", "success;mu;force\n1;0,125;1.250,5\n0;1,375;980\n1;2,5;1.000\n").unwrap();
    assert_eq!(numbers(&entries, "mu"), [0.125, 1.375, 2.5]);
    assert_eq!(numbers(&entries, "force"), [1250.5, 980.0, 1000.0]);
    let (_, entries) = read("thousands", "success,rpm,mu\n1,\"1,200\",0.5\n0,\"12,500\",0.25\n").unwrap();
    assert_eq!(numbers(&entries, "rpm"), [1200.0, 12_500.0]);
    refused("ambiguous", "success;rpm\n1;1,200\n0;2,500\n", &["line 2: `1,200` is ambiguous"]);
    refused("mixed", "success;a;b\n1;0,5;0.5\n", &["line 2 has `0,5`", "line 2 has `0.5`"]);
}

#[test]
fn numbers_with_a_unit_are_numbers() {
    let (provenance, entries) =
        read("unit", "success;humidity;mass;part\n1;45 %;0,5 kg;12A\n0;5 %;;13A\n1;99,5 %;1,25 kg;12A\n").unwrap();
    assert_eq!(numbers(&entries, "humidity"), [45.0, 5.0, 99.5]);
    assert_eq!(entries[2].episode.scenario.requested.get("part"), Some(&Value::Category("12A".into())));
    assert!(notes(&provenance).contains("read as numbers: `humidity` in %, `mass` in kg."), "{}", notes(&provenance));
    refused("units", "success,mass\n1,500 g\n0,0.7 kg\n", &["`g` in line 2 and `kg` in line 3", "Hint: "]);
    refused("bare", "success,humidity\n1,45 %\n0,50\n", &["`%` in line 2 and no unit in line 3"]);
}

#[test]
fn columns_of_spreadsheets_are_parameters() {
    let (provenance, entries) =
        read("names", "success,Mass (kg),H\u{f6}he,belt-speed,belt_speed\n1,0.5,2,3,4\n0,0.7,2.5,5,6\n").unwrap();
    assert_eq!(numbers(&entries, "Mass_kg"), [0.5, 0.7]);
    assert_eq!(numbers(&entries, "Hoehe"), [2.0, 2.5]);
    // Another column has the name.
    assert_eq!(numbers(&entries, "belt_speed"), [4.0, 6.0]);
    assert!(notes(&provenance).contains("Column `belt-speed` is ignored"), "{}", notes(&provenance));
}

#[test]
fn separator_line_is_read() {
    for line in ["sep=;\r\n", "\"sep=;\"\n", "SEP=;\n"] {
        let (provenance, entries) =
            read("sep", format!("{line}Gut;success;mass\nWAHR;1;0,5\nFALSCH;0;1,25\n")).unwrap();
        assert_eq!(words(&entries), "success unknown");
        assert_eq!(numbers(&entries, "mass"), [0.5, 1.25]);
        assert_eq!(provenance.space.len(), 1, "the truth values of a spreadsheet are not a parameter");
    }
    refused("sep-line", "sep=;\nsuccess;mass\n1;2\n1\n", &["line 4"]);
}

#[test]
fn utf_16_and_latin_1_are_read() {
    let text = "success;Griff\n1;Würfel €\n0;Kugel\n";
    let little = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let big: Vec<u8> = format!("\u{FEFF}{text}").encode_utf16().flat_map(u16::to_be_bytes).collect();
    let windows: Vec<u8> = text
        .chars()
        .map(|c| match c {
            'ü' => 0xFC,
            '€' => 0x80,
            c => u8::try_from(c).unwrap(),
        })
        .collect();
    for (name, bytes) in
        [("bom", little(&format!("\u{FEFF}{text}"))), ("bare", little(text)), ("big", big), ("windows", windows)]
    {
        let (provenance, entries) = read(name, bytes).unwrap();
        assert_eq!(entries[0].episode.scenario.requested.category("Griff"), Some("Würfel €"), "{name}");
        assert!(notes(&provenance).contains("The file is not UTF-8"), "{name}");
    }
    let jsonl = "\u{FEFF}{\"success\": true, \"mass\": 1.5}\r\n{\"success\": false, \"mass\": 2}\r\n";
    assert_eq!(words(&read("jsonl", little(jsonl)).unwrap().1), "success unknown");
    // GB18030.
    refused("chinese", b"success,shape\n1,\xB7\xBD\xBF\xE9\n", &["line 2", "not UTF-8", "iconv"]);
}

#[test]
fn pointers_are_not_the_file() {
    let folder = Folder::new("foreign-pointer");
    let pointer = folder.join("d.parquet");
    fs::write(&pointer, "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n").unwrap();
    let none = Mapping::default();
    let out = folder.join("o.parquet");
    for error in [
        import(&pointer, &out, None, &none).unwrap_err(),
        import(&pointer, &out, Some(robogate_dictionary::results::Format::Csv), &none).unwrap_err(),
        audit(&pointer, None, &none).unwrap_err(),
        Dictionary::open(&pointer).unwrap_err(),
    ] {
        assert!(error.to_string().contains("git lfs pull"), "{error}");
    }
}

#[test]
fn compressed_files_name_their_program() {
    for (magic, program) in [
        (&b"\x1f\x8b\x08\0"[..], "gunzip"),
        (b"BZh91AY", "bunzip2"),
        (b"\xfd7zXZ\0\0", "unxz"),
        (b"\x28\xb5\x2f\xfd\x04", "unzstd"),
        (b"PK\x03\x04\x14\0", "save the sheet as CSV"),
    ] {
        refused("compressed", magic, &[program]);
    }
}

#[test]
fn bars_separate_fields() {
    assert_eq!(words(&read("bars", "seed|success\n1|true\n2|false\n").unwrap().1), "success unknown");
}

#[test]
fn python_tokens_are_read() {
    let (_, entries) = read(
        "nan",
        r#"{"per_task": [{"task_group": "g", "task_id": 1, "metrics": {"sum_rewards": [NaN, 2.0, -Infinity],
        "successes": [false, true, true]}}], "overall": {"avg_sum_reward": NaN, "pc_success": 66.66667}}"#,
    )
    .unwrap();
    assert_eq!(words(&entries), "unknown success success");
    let (_, entries) =
        read("lines", "{\"success\": 1, \"mass\": NaN, \"x\": 1}\n{\"success\": NaN, \"mass\": 2.5}\n").unwrap();
    assert_eq!(words(&entries), "success invalid");
    assert_eq!(entries[1].episode.scenario.requested.number("mass"), Some(2.5));
}

fn seeds_are_exact(text: &str, seeds: [u64; 4]) {
    let (_, entries) = read("seeds", text).unwrap();
    let found: Vec<u64> =
        entries.iter().map(|entry| recorded_seed(&entry.episode.scenario.requested).unwrap().cast_unsigned()).collect();
    assert_eq!(found, seeds);
    let audit = audited("seeds", text).unwrap();
    assert!(matches!(result(&audit, Check::RepeatedSeeds), CheckResult::Clear { .. }), "{:?}", audit.checks);
}

#[test]
fn seeds_of_64_bits_are_exact() {
    // The second ones lie close together.
    for seeds in [[u64::MAX, u64::MAX - 1, 1 << 63, 3], [1 << 63, (1 << 63) + 1, (1 << 63) + 2, (1 << 63) + 3]] {
        let csv: String = seeds.iter().map(|seed| format!("1,{seed}\n")).collect();
        let json: String = seeds.iter().map(|seed| format!("{{\"success\": true, \"seed\": {seed}}}\n")).collect();
        for text in [format!("success,seed\n{csv}"), json] {
            seeds_are_exact(&text, seeds);
        }
    }
    // Seeds of 128 bits differ in their last digit only.
    let text: String =
        (0..3).map(|i| format!("{{\"success\": 1, \"seed\": 34028236692093846346337460743176821145{i}}}\n")).collect();
    let audit = audited("wide", &text).unwrap();
    assert!(matches!(result(&audit, Check::RepeatedSeeds), CheckResult::Clear { .. }), "{:?}", audit.checks);
    let small = read("small", "success,seed\n1,7\n").unwrap().1;
    assert_eq!(small[0].episode.scenario.requested.get("source_seed"), Some(&Value::Integer(7)));
}

#[test]
fn exports_are_recognised() {
    let folder = Folder::new("foreign-export");
    let (table, first, again) = (folder.join("t"), folder.join("d.parquet"), folder.join("again.parquet"));
    fs::write(&table, "success,mass\n1,0.5\n0,0.25\n").unwrap();
    import(&table, &first, None, &Mapping::default()).unwrap();
    assert!(!import_export(&table, &again).unwrap(), "a table of another tool");
    let exported = folder.join("e.csv");
    let dictionary = Dictionary::open(&first).unwrap();
    export::csv(&dictionary, &mut fs::File::create(&exported).unwrap()).unwrap();
    assert!(import_export(&exported, &again).unwrap());
    assert_eq!(Dictionary::open(&again).unwrap().dataset_hash(), dictionary.dataset_hash());
}

#[test]
fn averages_are_no_episodes() {
    let wanted = &["the rows are averages", "Expected one row per episode"];
    let table = "task,n_episodes,success_rate\npush,25,1.0\npull,25,0.0\n";
    let error = read("rates", table).unwrap_err().to_string();
    assert!(error.contains("line 2: `n_episodes` is 25") && error.contains(wanted[1]), "{error}");
    assert_eq!(audited("rates", table).unwrap_err().to_string().lines().last(), error.lines().last());
    refused("bare", "task,success_rate\npush,1\npull,0\n", &["--map success=success_rate"]);
    // A setting that all episodes repeat.
    let rows: String = (0..25).map(|i| format!("push,25,{}\n", i % 2)).collect();
    assert_eq!(read("setting", format!("task,n_episodes,success\n{rows}")).unwrap().1.len(), 25);
    let rows: String = (0..3).map(|i| format!("{i},push{i},25,1\n")).collect();
    assert_eq!(read("numbered", format!("episode,task,n_episodes,success\n{rows}")).unwrap().1.len(), 3);
}

#[test]
fn other_success_values_are_refused() {
    for value in ["100", "0.5", "ok", "-1", "2"] {
        let table = format!("episode,success\n0,0\n1,1\n2,{value}\n");
        refused("value", &table, &["line 4, column `success`", "is neither true nor false"]);
        let error = audited("value", &table).unwrap_err().to_string();
        assert!(error.contains("line 4, column `success`"), "{error}");
    }
}

#[test]
fn lerobot_episodes_are_rows() {
    let rows = "{\"episode_index\": 0, \"tasks\": [\"fold\"], \"length\": 9, \"success\": true}\n\
                {\"episode_index\": 1, \"tasks\": [\"fold\"], \"length\": 8, \"success\": false}\n";
    let (provenance, entries) = read("lerobot", rows).unwrap();
    assert_eq!(words(&entries), "success unknown");
    assert_eq!(provenance.source.as_ref().unwrap().format, "json_lines");
}

#[test]
fn success_at_time_limit_is_found() {
    let row = |i: usize| match i % 4 {
        0 => format!("{i},True,False,True,300\n"),
        1 => format!("{i},False,False,True,300\n"),
        _ => format!("{i},True,True,False,80\n"),
    };
    let rows: String = (0..20).map(row).collect();
    let audit = audited("limit", &format!("episode,success,terminated,truncated,length\n{rows}")).unwrap();
    let CheckResult::Found { problems, .. } = result(&audit, Check::SuccessAtTimeLimit) else { panic!("{audit:?}") };
    assert_eq!(problems[0].rows, [0, 4, 8, 12, 16]);
    // A task that always lasts until its limit.
    let rows: String = (0..20).map(|i| format!("{i},{},True\n", i % 2 == 0)).collect();
    let audit = audited("always", &format!("episode,success,truncated\n{rows}")).unwrap();
    assert!(not_checked(&audit, Check::SuccessAtTimeLimit).contains("every success lasts"));
}

#[test]
fn checks_without_power_are_not_ok() {
    // In the order in which 50 parallel episodes end.
    let rows: String = (0..100).map(|i| format!("{i},{}\n", u8::from(i % 50 < 30))).collect();
    let audit = audited("completion", &format!("episode,success\n{rows}")).unwrap();
    assert!(not_checked(&audit, Check::BatchArtefacts).contains("order in which episodes ended"));
    let rows: String = (0..100).map(|i| format!("{i},{},5\n", u8::from((i * 7 + i / 3) % 5 < 3))).collect();
    let audit = audited("few", &format!("episode,success,steps\n{rows}")).unwrap();
    assert!(not_checked(&audit, Check::BatchArtefacts).contains("only batches of up to"), "{audit:?}");
    assert!(not_checked(&audit, Check::InfrastructureErrors).contains("no text about an error"));
    let audit = audited("failed", "episode,success,steps\n0,0,5\n1,0,7\n").unwrap();
    assert!(not_checked(&audit, Check::SuccessAtFirstStep).contains("no success has"));
}

#[test]
fn an_odd_cell_is_named() {
    let (provenance, _) = read("odd", "mass_kg,success\n0.5,1\n0x10,0\n0.7,1\n").unwrap();
    assert!(notes(&provenance).contains("its values have several types: line 3 has `0x10`"), "{}", notes(&provenance));
    let (_, entries) = read("letters", "mass_kg,success\n0.5,y\n0.6,n\n").unwrap();
    assert_eq!(words(&entries), "success unknown");
}

#[test]
fn restarted_seeds_are_not_hidden_by_a_column_of_results() {
    let rows = |x: fn(u32) -> String| -> String {
        (0..120).map(|i| format!("{},{},{}\n", 5000 + i % 8, x(i), u32::from(i % 8 < 5))).collect()
    };
    let audit = audited("restart", &format!("seed,x_m,success\n{}", rows(|i| format!("0.{}1", 101 + i)))).unwrap();
    let because = not_checked(&audit, Check::RepeatedSeeds);
    assert!(because.starts_with("8 seeds occur in 120 rows, each time with other numbers in x_m."), "{because}");
    // A design that repeats its seeds in each scenario.
    let audit = audited("design", &format!("seed,x_m,success\n{}", rows(|i| format!("0.{}1", 101 + i / 8)))).unwrap();
    assert!(matches!(result(&audit, Check::RepeatedSeeds), CheckResult::Clear { .. }));
}
