//! Tests of the export to CSV and JSON Lines.

use std::fs;

use robogate_dictionary::export::{Format, csv, json_lines, write_file};
use robogate_dictionary::{Dictionary, write_parquet};

use crate::common::{Folder, entry, provenance, strange_entry};

fn dictionary(folder: &Folder) -> Dictionary {
    let path = folder.join("d.parquet");
    let entries = (0..100).map(|i| if i == 50 { strange_entry(i) } else { entry(i) });
    write_parquet(&path, &provenance(), entries.map(Ok)).unwrap();
    Dictionary::open(&path).unwrap()
}

/// An independent parser for RFC 4180. `None` is an unquoted empty field.
fn parse_csv(text: &str) -> Vec<Vec<Option<String>>> {
    let (mut rows, mut row, mut field) = (Vec::new(), Vec::new(), String::new());
    let (mut quoted, mut was_quoted) = (false, false);
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                field.push('"');
                chars.next();
            }
            '"' => {
                quoted = !quoted;
                was_quoted = true;
            }
            ',' | '\n' if !quoted => {
                let value = std::mem::take(&mut field);
                row.push((was_quoted || !value.is_empty()).then_some(value));
                was_quoted = false;
                if c == '\n' {
                    rows.push(std::mem::take(&mut row));
                }
            }
            '\r' if !quoted => assert_eq!(chars.peek(), Some(&'\n')),
            _ => field.push(c),
        }
    }
    assert!(row.is_empty() && field.is_empty() && !quoted);
    rows
}

#[test]
fn csv_equals_json_lines() {
    let folder = Folder::new("export-same");
    let dictionary = dictionary(&folder);
    let (mut table, mut lines) = (Vec::new(), Vec::new());
    assert_eq!(csv(&dictionary, &mut table).unwrap(), 100);
    assert_eq!(json_lines(&dictionary, &mut lines).unwrap(), 100);
    let table = parse_csv(std::str::from_utf8(&table).unwrap());
    let names: Vec<&str> = dictionary.column_names().collect();
    assert!(table[0].iter().flatten().eq(names.iter()));
    let lines = String::from_utf8(lines).unwrap();
    assert_eq!(lines.lines().count(), 100);
    for (row, line) in table[1..].iter().zip(lines.lines()) {
        let object: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(object.as_object().unwrap().len(), names.len());
        assert_eq!(row.len(), names.len());
        for (name, field) in names.iter().zip(row) {
            match (&object[*name], field) {
                (serde_json::Value::Null, None) => {}
                (serde_json::Value::String(text), Some(field)) => assert_eq!(text, field),
                (value, Some(field)) => {
                    let x: f64 = field.parse().unwrap();
                    assert_eq!(value.as_f64().unwrap().to_bits(), x.to_bits(), "{name}");
                }
                (value, None) => panic!("{name}: {value} and nothing"),
            }
        }
    }
    let strange = &table[51];
    let field = |name: &str| &strange[names.iter().position(|n| *n == name).unwrap()];
    assert_eq!(*field("contact_robot_body"), Some(String::new()), "empty is not missing");
    assert_eq!(*field("peak_force_n"), None, "NaN is missing");
    assert_eq!(*field("friction"), Some("-0.0".to_owned()));
    assert!(!lines.contains("NaN,") && !lines.contains("inf,"));
}

#[test]
fn exports_are_reproducible() {
    let folder = Folder::new("export-file");
    let dictionary = dictionary(&folder);
    for format in [Format::Csv, Format::JsonLines, Format::Published] {
        let (a, b) = (folder.join("a"), folder.join("b"));
        let rows = write_file(&dictionary, format, &a).unwrap();
        assert_eq!(write_file(&dictionary, format, &b).unwrap(), rows);
        assert!(fs::read(&a).unwrap() == fs::read(&b).unwrap());
        let error = write_file(&dictionary, format, &folder.join("no/where")).unwrap_err().to_string();
        assert!(error.contains("where"), "{error}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3, "no temporary file is left");
}

#[test]
#[cfg(target_os = "linux")]
fn full_device_is_an_error() {
    let folder = Folder::new("export-full");
    let dictionary = dictionary(&folder);
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let error = csv(&dictionary, full).unwrap_err().to_string();
    assert!(error.contains("Hint: free disk space"), "{error}");
}
