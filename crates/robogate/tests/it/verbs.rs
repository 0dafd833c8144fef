//! End-to-end tests of `analyze`, `report` and `compare`: exit codes, stdout and stderr.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::{assert_done, assert_refused, path, robogate, stderr, stdout};

/// A published dictionary in which episodes succeed above the friction `from`, and mass has a small effect.
fn published(dir: &TempDir, robot: &str, rows: u32, from: f64) -> String {
    let experiments: Vec<Value> = (0..rows)
        .map(|i| {
            let unit = |step: u32| f64::from((i * step) % 97) / 97.0;
            let (friction, mass) = (0.05 + 1.15 * unit(31), 0.05 + 1.95 * unit(17));
            let success = friction + 0.1 * unit(53) > from + 0.2 * mass;
            json!({
                "sample_idx": i,
                "friction": friction,
                "mass": mass,
                "placement": if i % 2 == 0 { "center_0" } else { "edge_0" },
                "success": success,
                "failure_type": if success { "none" } else { "grasp_miss" },
                "cycle_time": 4.0
            })
        })
        .collect();
    let text = json!({ "metadata": { "robot": robot }, "summary": {}, "experiments": experiments }).to_string();
    let file = path(dir, &format!("{robot}.json"));
    fs::write(&file, text).unwrap();
    file
}

pub(crate) fn assert_self_contained(page: &str) {
    let text = fs::read_to_string(page).unwrap();
    assert!(text.starts_with("<!DOCTYPE html>") && text.trim_end().ends_with("</html>"));
    for forbidden in ["http://", "https://", "src=", "@import", "url(http", "//cdn"] {
        assert!(!text.contains(forbidden), "{page} has {forbidden}");
    }
}

fn assert_fits(output: &Output) {
    let text = stdout(output);
    for line in text.lines() {
        assert!(line.chars().count() <= 100, "{} columns: {line}", line.chars().count());
    }
}

#[test]
fn analyze_writes_to_stdout() {
    let dir = TempDir::new().unwrap();
    let file = published(&dir, "arm", 200, 0.5);
    let output = robogate(&["analyze", &file]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stderr(&output), "");
    assert!(stdout(&output).contains("Where it fails"));
    assert_fits(&output);
    let output = robogate(&["analyze", &file, "--json"]);
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["version"], 4);
    assert_eq!(document["success"]["rate"]["n"], 200);
    assert_refused(&["analyze", &path(&dir, "nowhere")], &["nowhere"]);
    assert_refused(&["analyze", &file, "--target", "1.2"], &["1.2", "between 0 and 1"]);
    assert_refused(&["analyze", &file, "--pair", "friction", "fricton"], &["fricton", "mass_kg"]);
}

#[test]
fn report_writes_one_file() {
    let dir = TempDir::new().unwrap();
    let file = published(&dir, "arm", 200, 0.5);
    let page = path(&dir, "page.html");
    let output = robogate(&["report", &file, "--out", &page]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stdout(&output), "");
    assert!(stderr(&output).contains("page.html"));
    assert_self_contained(&page);
    let markdown = robogate(&["report", &file, "--format", "md", "--out", "-"]);
    assert_eq!((markdown.status.code(), stderr(&markdown).as_str()), (Some(0), ""));
    assert!(stdout(&markdown).starts_with("# "));
    let document = robogate(&["report", &file, "--format", "json", "--out", "-"]);
    let analysis = robogate(&["analyze", &file, "--json"]);
    assert_eq!(document.stdout, analysis.stdout);
    assert_refused(&["report", &file, "--format", "pdf"], &["pdf", "html"]);
    let nowhere = robogate(&["report", &file, "--out", &path(&dir, "no/such/folder.html")]);
    assert_eq!(nowhere.status.code(), Some(5), "{}", stderr(&nowhere));
}

/// Each figure of the page is a file of its own, without variables, scripts or outer styles, with its data beside it.
#[test]
fn figures_are_files() {
    let dir = TempDir::new().unwrap();
    let file = published(&dir, "one", 400, 0.5);
    let list = stdout(&robogate(&["figure", &file]));
    let names: Vec<&str> = list.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.len() >= 4, "{list}");
    assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>().len(), names.len(), "{list}");
    let (svg, csv) = (path(&dir, "f.svg"), path(&dir, "f.csv"));
    for name in names {
        assert_done(&robogate(&["figure", &file, name, "--svg", &svg, "--csv", &csv]));
        let text = fs::read_to_string(&svg).unwrap();
        let document = roxmltree::Document::parse(&text).unwrap_or_else(|why| panic!("{name}: {why}: {text}"));
        assert!(document.root_element().has_tag_name(("http://www.w3.org/2000/svg", "svg")), "{name}");
        assert!(!text.contains("var(") && text.contains("<style>"), "{name}: {text}");
        let data = fs::read_to_string(&csv).unwrap();
        assert!(data.lines().count() >= 2, "{name}: {data}");
    }
    if !cfg!(feature = "print") {
        let pdf = path(&dir, "f.pdf");
        let name = list.split_whitespace().next().unwrap();
        let words = ["SVG only", "Hint: build with --features print"];
        assert_refused(&["figure", &file, name, "--pdf", &pdf], &words);
        assert!(!std::path::Path::new(&pdf).exists());
    }
    assert_refused(&["figure", &file, "none"], &["no such figure", "Expected one of"]);
    assert_refused(&["figure", &file, "none", "--svg", &svg, "--csv", &svg], &["--svg and --csv are the same file"]);
}

#[test]
fn compare_writes_every_format() {
    let dir = TempDir::new().unwrap();
    let (one, two) = (published(&dir, "one", 300, 0.4), published(&dir, "two", 240, 0.8));
    let (page, text) = (path(&dir, "page.html"), path(&dir, "page.md"));
    let output = robogate(&[
        "compare",
        &one,
        &two,
        "--html",
        &page,
        "--md",
        &text,
        "--reach",
        "one=0.85",
        "--reach",
        "two=0.5",
        "--workspace",
        "0.5",
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    for part in ["Success rates", "What differs", "In 4 cells of 29 tested", "32.0 points one ahead of two"] {
        assert!(stdout(&output).contains(part), "{part}: {}", stdout(&output));
    }
    assert_fits(&output);
    assert!(stderr(&output).contains("page.html") && stderr(&output).contains("page.md"));
    assert_self_contained(&page);
    assert!(fs::read_to_string(&text).unwrap().starts_with("# one and two"));
    let output = robogate(&["compare", &one, &two, "--json"]);
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["version"], 3);
    assert_eq!(document["compared"], json!(["one", "two"]));
    assert!(document["differences"][0]["adjusted_p"].as_f64().unwrap() < 0.05);
    assert_eq!(document["reach"][0]["reach_m"], Value::Null);
}

/// A rounded number that two files have in common by chance makes no pair: all other rows would be left out.
#[test]
fn chance_coincidences_are_no_pairs() {
    let dir = TempDir::new().unwrap();
    let import = |name: &str, from: u32, failures: u32| {
        let rows: String =
            (0..100).map(|i| format!("{:.4},{}\n", f64::from(from + 7 * i) / 1e4, i >= failures)).collect();
        let (csv, out) = (path(&dir, &format!("{name}.csv")), path(&dir, &format!("{name}.parquet")));
        fs::write(&csv, format!("friction,success\n{rows}")).unwrap();
        assert_done(&robogate(&["import", &csv, &out]));
        out
    };
    // The last value of the first file is the first of the second one.
    let (one, two) = (import("one", 0, 5), import("two", 693, 60));
    let compared = stdout(&robogate(&["compare", &one, &two]));
    assert!(compared.contains("55.0 points") && !compared.contains("not significant"), "{compared}");
    let paired = robogate(&["compare", "--paired", &one, &two]);
    assert_eq!(paired.status.code(), Some(2), "{}", stderr(&paired));
    assert!(stderr(&paired).contains("only 1 of 100 rows have the same"), "{}", stderr(&paired));
}

/// Tools number their seeds alike: rows with the same seed and other parameters are not the same scenario. Those with a case are.
#[test]
fn equal_seeds_with_other_parameters_are_no_pairs() {
    let dir = TempDir::new().unwrap();
    let import = |name: &str, with: &str, shift: u32| {
        let rows: String = (0..60)
            .map(|i| format!("{i},{},{},{}\n", (i * 37 + shift) % 60, (i * 23 + 2 * shift) % 60, i % 3 > 0))
            .collect();
        let (csv, out) = (path(&dir, &format!("{name}.csv")), path(&dir, &format!("{name}.parquet")));
        fs::write(&csv, format!("{with},humidity,mass_g,success\n{rows}")).unwrap();
        assert_done(&robogate(&["import", &csv, &out]));
        out
    };
    let paired = |one: &str, two: &str| robogate(&["compare", "--paired", one, two]);
    let (one, two) = (import("one", "seed", 0), import("two", "seed", 17));
    let refused = paired(&one, &two);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(
        stderr(&refused).contains("most rows with the same source_seed have another humidity"),
        "{}",
        stderr(&refused)
    );
    let compared = stdout(&robogate(&["compare", &one, &two]));
    assert!(!compared.contains("the same 60 scenarios"), "{compared}");
    // What differs between two trials of one case was not set.
    let (one, two) = (import("three", "case", 0), import("four", "case", 17));
    assert_eq!(paired(&one, &two).status.code(), Some(0), "{}", stderr(&paired(&one, &two)));
}

#[test]
fn compare_rejects_invalid_arguments() {
    let dir = TempDir::new().unwrap();
    let (one, two) = (published(&dir, "one", 60, 0.4), published(&dir, "two", 50, 0.8));
    assert_refused(&["compare", &one], &["at least two", "analyze"]);
    assert_refused(&["compare", &one, &one], &["given twice"]);
    let copy = path(&dir, "copy.json");
    fs::copy(&one, &copy).unwrap();
    assert_refused(&["compare", &one, &copy], &["same rows"]);
    assert_refused(&["compare", &one, &two, "--paired"], &["did not run the same scenarios", "60", "50"]);
    assert_refused(&["compare", &one, &two, "--reach", "three=1"], &["`three`", "one, two"]);
    assert_refused(&["compare", &one, &two, "--reach", "one"], &["NAME=METRES"]);
    assert_refused(&["compare", &one, &two, "--danger", "40"], &["40", "(0, 1)"]);
    assert_refused(&["compare", &one, &two, "--names", "a"], &["1 names for 2"]);
    assert_refused(&["compare", &one, &two, "--pair", "friction", "colour"], &["`colour`", "friction"]);
    assert_refused(&["compare", &one, &two, "--out", &two], &["would overwrite"]);
    assert_refused(&["compare", &one, &path(&dir, "nowhere.json")], &["nowhere.json"]);
}

#[test]
fn paired_runs_can_be_replayed() {
    let dir = TempDir::new().unwrap();
    let (strong, weak) = (path(&dir, "strong"), path(&dir, "weak"));
    for (out, force) in [(&strong, "30"), (&weak, "2")] {
        let output = robogate(&[
            "run",
            "--design",
            "two-stage",
            "-n",
            "24",
            "--set",
            &format!("grip_force_n={force}"),
            "--threads",
            "1",
            "--out",
            out,
        ]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    let output = robogate(&["compare", &strong, &weak, "--paired", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let pair = &document["paired"][0];
    assert_eq!(pair["scenarios"], 16);
    assert_eq!(document["reach"][0]["reach_m"], 0.855);
    assert!(pair["first_only"].as_u64().unwrap() > 0, "a gripper of 2 N loses nothing that one of 30 N holds");
    let command = pair["flips"][0]["replay"][0].as_str().unwrap();
    let words: Vec<&str> = command.split(' ').collect();
    assert_eq!(&words[..2], ["robogate", "replay"]);
    assert!(Path::new(words[2]).is_dir());
    assert_eq!(robogate(&words[1..]).status.code(), Some(0));
    let other = path(&dir, "other");
    robogate(&["run", "--design", "two-stage", "-n", "24", "--seed", "9", "--threads", "1", "--out", &other]);
    assert_refused(&["compare", &strong, &other, "--paired"], &["row 0", "seed"]);
}

#[test]
fn transfer_writes_every_format() {
    let dir = TempDir::new().unwrap();
    let simulation = published(&dir, "franka", 300, 0.6);
    let trials = path(&dir, "trials.csv");
    let rows: Vec<String> = (0..40)
        .map(|i| {
            let unit = |step: u32| f64::from((i * step + 11) % 97) / 97.0;
            let (friction, mass) = (0.05 + 1.15 * unit(37), 0.05 + 1.95 * unit(29));
            format!("{},{friction},{mass},{}", friction > 0.65, 1 + i % 5)
        })
        .collect();
    fs::write(&trials, format!("success,friction,mass_kg,note\n{}\n", rows.join("\n"))).unwrap();
    let (page, file) = (path(&dir, "transfer.html"), path(&dir, "transfer.json"));
    let same = path(&dir, "./transfer.html");
    assert_refused(
        &["transfer", "--sim", &simulation, "--real", &trials, "--html", &page, "--out", &same],
        &["--html and --out are the same file"],
    );
    assert_refused(
        &["transfer", "--sim", &simulation, "--real", &trials, "--out", &trials],
        &["--real and --out are the same file"],
    );
    assert_refused(
        &["compare", &simulation, &trials, "--out", &page, "--md", &same],
        &["--out and --md are the same file"],
    );
    let arguments = ["transfer", "--sim", &simulation, "--real", &trials, "--html", &page, "--out", &file];
    let output = robogate(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = stdout(&output);
    for part in ["The real robot", "Trials to run next", "Ignored columns: note"] {
        assert!(text.contains(part) || text.contains("The trials alone"), "{part}: {text}");
    }
    assert_self_contained(&page);
    // Terminal, page and document have the map of the two most influential parameters.
    assert!(text.contains("Trials to run next\n") && text.contains("0.809 to 1.19"), "{text}");
    let html = fs::read_to_string(&page).unwrap();
    assert!(html.contains("Real success in percent by the corrected model"));
    let json = robogate(&["transfer", "--sim", &simulation, "--real", &trials, "--json"]);
    assert_eq!(fs::read_to_string(&file).unwrap().trim(), stdout(&json).trim());
    let document: Value = serde_json::from_str(&stdout(&json)).unwrap();
    assert_eq!(document["real"]["trials"], 40);
    let (ranked, map) = (&document["effects"]["ranked"], &document["map"]["estimated"]["map"]);
    assert_eq!([&map["y"]["parameter"], &map["x"]["parameter"]], [0, 1].map(|i| &ranked[i]["parameter"]));
    assert_eq!(map["cells"].as_array().unwrap().len(), 9);
    fs::write(&trials, "success,friction\nperhaps,0.5\n").unwrap();
    assert_refused(&["transfer", "--sim", &simulation, "--real", &trials], &["trials.csv:2", "perhaps"]);
    let folder = dir.path().to_str().unwrap();
    assert_refused(&["transfer", "--sim", &simulation, "--real", folder], &["cannot read"]);
}

/// Markup, a colour, and a reversed text in every name that a table can bring along.
#[test]
fn hostile_names_are_inert() {
    let dir = TempDir::new().unwrap();
    let name = "<img src=x onerror=a()>\u{1b}[32mok\u{9b}2J\u{202e}ssap\u{2066}";
    let table = path(&dir, "table.csv");
    let rows: String = (0..120).map(|i| format!("{},0.{:03},{name}{}\n", i % 3 == 0, i * 7 % 997, i % 2)).collect();
    fs::write(&table, format!("success,mass_kg,{name}\n{rows}")).unwrap();
    let [one, other, page] = ["one.parquet", "other.parquet", "page.html"].map(|file| path(&dir, file));
    let explorer = path(&dir, "explorer.html");
    let mapping = path(&dir, "mapping.toml");
    fs::write(&mapping, format!("[parameters]\nmass_kg = \"mass_kg\"\nkind = {}\n", json!(name))).unwrap();
    let named = ["--policy", name, "--robot", name, "--simulator", name, "--mapping", &mapping];
    let commands: Vec<Vec<&str>> = vec![
        [&["import", &table, &one][..], &named[..]].concat(),
        [&["import", &table, &other][..], &named[..]].concat(),
        vec!["analyze", &one],
        vec!["analyze", &one, "--json"],
        vec!["audit", &one],
        vec!["report", &one, "--out", &page],
        vec!["report", &one, "--format", "md", "--out", "-"],
        vec!["compare", &one, &other],
        vec!["view", &one, "--export", &explorer],
        vec!["report", name],
        vec!["run", "--task", name],
        vec!["gate", "--requirements", name],
    ];
    let hidden = ['\u{1b}', '\u{9b}', '\u{202e}', '\u{2066}'];
    for arguments in commands {
        let output = robogate(&arguments);
        for text in [stdout(&output), stderr(&output)] {
            assert!(!text.contains(hidden), "{arguments:?}: {text:?}");
            assert!(!text.contains("internal error"), "{text}");
        }
    }
    let text = fs::read_to_string(&page).unwrap();
    assert!(text.contains("&lt;img src=x"), "the name is not on the page");
    assert!(!text.contains(hidden) && !text.contains("<img src=x"));
    // The scripts of this page read its names from JSON, which can also write these characters as escapes.
    let text = fs::read_to_string(&explorer).unwrap();
    let data = &text[text.find("application/json").unwrap()..];
    assert!(data.contains("[32mok\u{fffd}2J\u{fffd}ssap"), "the name is not on the page");
    assert!(!data.contains(hidden) && !data.contains("\\u001b[32m") && !data.contains("<img src=x"));
}
