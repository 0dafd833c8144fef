//! The safety case of evidence: every status follows from the files.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use robogate_gate::Sampling;
use robogate_gate::evidence::{Content, Ingredients, MANIFEST, Manifest, Role, write};
use serde_json::Value;
use tempfile::TempDir;

use crate::fleet::SUITE;
use crate::harness::{path, verb};
use crate::verbs::assert_self_contained;

/// Scenarios that are copies of each other.
const COPIES: &str = r#"
schema = 1
name = "copies"
version = "1.0.0"
description = "One scenario under several names."
defaults = { mass_kg = 0.2, start_rad = 0.1 }
[[group]]
name = "poles"
category = "nominal"
scenarios = [{ id = "a" }, { id = "b" }, { id = "c" }, { id = "d" }, { id = "e" }, { id = "f" }, { id = "g" }, { id = "h" }, { id = "i" }, { id = "j" }]
"#;
const UNITS: &str =
    "name = \"units\"\n[[parameter]]\nname = \"angle_bias_rad\"\nkind = \"continuous\"\nlow = -0.4\nhigh = 0.4\n";
const GATE: &str = "gate --task pendulum --suite suite.toml --seed 7";

fn requirements(at_least: f64, confidence: f64, rounds: u32) -> String {
    format!(
        "name = \"most\"\nmode = \"confidence\"\nconfidence = {confidence}\n[budget]\nrounds = {rounds}\n[[requirement]]\nmetric = \
         \"success\"\nat_least = {at_least}\nids = [\"SYS-12\"]\n"
    )
}

fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    let texts = [
        ("suite.toml", SUITE.to_owned()),
        ("copies.toml", COPIES.to_owned()),
        ("units.toml", UNITS.to_owned()),
        ("gate.toml", requirements(0.5, 0.9, 12)),
    ];
    for (name, text) in texts {
        fs::write(dir.path().join(name), text).unwrap();
    }
    dir
}

/// The elements of an argument, as another reader of YAML and of GSN sees them.
fn argument(folder: &Path) -> Option<BTreeMap<String, Value>> {
    let python = robogate_testing::path("ROBOGATE_TEST_PYTHON", "a Python with ruamel.yaml")?;
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/gsn.py");
    let output = Command::new(python).arg(program).arg(folder.join("safety-case.gsn.yaml")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[track_caller]
fn assert_statuses(argument: &BTreeMap<String, Value>, expected: &[(&str, &str)]) {
    for (name, status) in expected {
        let element = argument.get(*name).unwrap_or_else(|| panic!("no {name}"));
        assert_eq!(element["status"], *status, "{name}: {element}");
    }
}

#[test]
fn argument_follows_from_the_files() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{GATE} --requirements gate.toml --out run"), 0, &[]);
    verb(at, "evidence run e --safety-case", 0, &[]);
    verb(at, "evidence run again --safety-case", 0, &[]);
    verb(at, "verify e", 0, &[]);
    for name in ["safety-case.html", "safety-case.gsn.yaml", "compliance/operating-domain.odd.yaml"] {
        let read = |folder: &str| fs::read(at.join(folder).join(name)).unwrap();
        assert_eq!(read("e"), read("again"), "{name}");
    }
    let page = fs::read_to_string(at.join("e/safety-case.html")).unwrap();
    assert_self_contained(&path(&dir, "e/safety-case.html"));
    for part in ["UNDEVELOPED", "SYS-12", "is not claimed", "Annex III, Part B, 1.1.9", "4.2", "robogate verify ."] {
        assert!(page.contains(part), "{part}: {page}");
    }
    // Without limits on forces, no clause about contacts with persons.
    assert!(!page.contains("1.3.7") && !page.contains("4.3.2"), "{page}");
    assert!(fs::read_to_string(at.join("e/index.html")).unwrap().contains("href=\"safety-case.html\""));
    verb(at, "evidence run plain", 0, &[]);
    assert!(!fs::read_to_string(at.join("plain/index.html")).unwrap().contains("safety-case"));

    let Some(argument) = argument(&at.join("e")) else { return };
    assert_statuses(
        &argument,
        &[
            ("G-may-run", "undeveloped"),
            ("G-requirements", "supported"),
            ("G-requirement-1", "supported"),
            ("G-population", "supported"),
            ("G-independence", "supported"),
            ("G-subject", "supported"),
            ("G-question", "undeveloped"),
            ("G-cell", "undeveloped"),
            ("G-deployed", "undeveloped"),
            ("G-monitor", "undeveloped"),
            ("CG-chance", "answered"),
            ("CG-simulation", "open"),
            ("CG-best-of-several", "open"),
        ],
    );
    // Each solution is a listed file.
    let manifest: Manifest = serde_json::from_slice(&fs::read(at.join("e").join(MANIFEST)).unwrap()).unwrap();
    let solutions: Vec<_> = argument.values().filter(|element| element["path"].is_string()).collect();
    assert!(solutions.len() > 5);
    for solution in solutions {
        let listed = manifest.files.iter().find(|file| solution["path"] == file.path).unwrap();
        assert_eq!(solution["sha256"], listed.sha256, "{}", listed.path);
    }
}

#[test]
fn verdict_decides_the_argument() {
    let dir = folder();
    let at = dir.path();
    fs::write(at.join("hard.toml"), requirements(0.999, 0.99, 2)).unwrap();
    verb(at, &format!("{GATE} --requirements gate.toml --policy random --out fail"), 1, &[]);
    verb(at, "run --task pendulum --suite suite.toml --seed 7 --out open", 0, &[]);
    let runs = [
        ("fail", "", 1, "NOT SUPPORTED", "not supported"),
        ("open", " --requirements hard.toml", 3, "UNDEVELOPED", "undeveloped"),
    ];
    for (run, more, code, word, status) in runs {
        verb(at, &format!("evidence {run} {run}-evidence --safety-case{more}"), code, &[]);
        verb(at, &format!("verify {run}-evidence"), 0, &[]);
        let evidence = at.join(format!("{run}-evidence"));
        let page = fs::read_to_string(evidence.join("safety-case.html")).unwrap();
        assert!(page.contains(&format!("<h1>{word}</h1>")), "{page}");
        let Some(argument) = argument(&evidence) else { return };
        assert_statuses(&argument, &[("G-may-run", status), ("G-requirements", status), ("G-requirement-1", status)]);
        assert_eq!(argument["G-requirement-1"]["defeated"], code == 1);
        assert_eq!(argument.contains_key("CG-requirement-1-violated"), code == 1);
    }
    // Another question than that of the gate contradicts a claim.
    verb(at, "evidence fail reasked --safety-case --requirements hard.toml --reasked", 1, &[]);
    if let Some(argument) = argument(&at.join("reasked")) {
        assert_statuses(&argument, &[("G-question", "not supported"), ("CG-chosen-question", "confirmed")]);
    }
    // Invalid evidence has no argument.
    verb(at, "gate --task pendulum --suite copies.toml --requirements gate.toml --out copies", 4, &[]);
    verb(at, "evidence copies invalid --safety-case", 4, &[]);
    verb(at, "verify invalid", 0, &[]);
    let page = fs::read_to_string(at.join("invalid/safety-case.html")).unwrap();
    assert!(page.contains("<h1>NO ARGUMENT</h1>") && page.contains("distinct trajectories"), "{page}");
    assert!(!at.join("invalid/safety-case.gsn.yaml").exists());
}

#[test]
fn forged_argument_is_found() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{GATE} --requirements gate.toml --policy random --out run"), 1, &[]);
    verb(at, "evidence run e --safety-case", 1, &[]);
    let inside = |name: &str| at.join("e").join(name);
    let manifest: Manifest = serde_json::from_slice(&fs::read(inside(MANIFEST)).unwrap()).unwrap();
    let kept = manifest.files.iter().filter(|file| matches!(file.role, Role::Plan | Role::Question));
    let honest: BTreeMap<&str, String> = ["safety-case.html", "safety-case.gsn.yaml"]
        .map(|name| (name, fs::read_to_string(inside(name)).unwrap()))
        .into();
    for (number, (name, text)) in honest.iter().enumerate() {
        let changed = text.replace("not supported", "supported").replace("NOT SUPPORTED", "SUPPORTED");
        assert_ne!(*text, changed);
        let documents = honest.iter().map(|(of, text)| {
            let text = if of == name { &changed } else { text };
            (Role::Compliance, (*of).to_owned(), Content::Bytes(text.clone().into_bytes()))
        });
        let forged = Ingredients {
            dictionary: inside("dictionary.parquet"),
            requirements: Content::File(inside("requirements.toml")),
            baseline: None,
            real: None,
            against: None,
            sampling: Sampling::Sequential,
            reasked: false,
            others: kept
                .clone()
                .map(|file| (file.role, file.path.clone(), Content::File(inside(&file.path))))
                .chain(documents)
                .collect(),
            documents: None,
        };
        // Consistent in all hashes and statements.
        write(&at.join(format!("forged-{number}")), &forged, None).unwrap();
        verb(at, &format!("verify forged-{number}"), 4, &[&format!("{name}: differs from the document")]);
    }
}

/// A monitor, an upgrade and a fleet belong to the rows that they are about, and change the argument.
#[test]
fn later_results_are_bound_to_the_rows() {
    let dir = folder();
    let at = dir.path();
    verb(at, &format!("{GATE} --requirements gate.toml --fixed --out run"), 0, &[]);
    verb(at, "gate --task pendulum --suite suite.toml --seed 8 --requirements gate.toml --out other", 0, &[]);
    verb(at, "monitor reference run --learn-baseline --out monitor.json", 0, &[]);
    let output = verb(at, "requalify run --policy random --pairs 40 --json -q", 1, &[]);
    fs::write(at.join("upgrade.json"), output).unwrap();
    verb(
        at,
        "evidence run e --safety-case --include monitor=monitor.json --include requalification=upgrade.json",
        0,
        &[],
    );
    verb(at, "verify e", 0, &[]);
    if let Some(argument) = argument(&at.join("e")) {
        let expected = [
            ("G-operation", "supported"),
            ("CG-outside", "answered"),
            ("G-upgrade-1", "not supported"),
            ("G-may-run", "not supported"),
            ("G-requirements", "supported"),
        ];
        assert_statuses(&argument, &expected);
    }
    for include in ["monitor=monitor.json", "requalification=upgrade.json"] {
        let line = format!("evidence other wrong --include {include}");
        verb(
            at,
            &line,
            4,
            &["about something else: `dataset_sha256` is", "Hint: evidence must contain the files of the run"],
        );
    }
    fs::write(at.join("empty.json"), "{}").unwrap();
    for (role, writer) in [
        ("monitor", "monitor reference"),
        ("requalification", "requalify --json"),
        ("warning", "warn train"),
        ("admission", "admit --json"),
    ] {
        let line = format!("evidence run wrong --include {role}=empty.json");
        verb(at, &line, 4, &[&format!("is missing. Expected the output of `robogate {writer}`")]);
    }
    verb(at, "evidence run wrong --include fleet=empty.json", 4, &["not the result of a fleet with the unit"]);
    assert!(!at.join("wrong").exists());
}

#[test]
fn unit_of_a_fleet_includes_its_fleet() {
    let dir = folder();
    let at = dir.path();
    let fleet =
        "fleet --task pendulum --suite suite.toml --unit-space units.toml --requirements gate.toml --seed 5 --units 12";
    let printed = verb(at, &format!("{fleet} --share 0.99 --out fleet"), 1, &[]);
    verb(at, "evidence fleet e", 2, &["the folder of a fleet", "unit-001"]);
    let code = |unit: u32| fs::read_to_string(at.join(format!("fleet/unit-{unit:03}/gate.json"))).unwrap();
    let unit =
        (1..=12).find(|unit| code(*unit).contains("\"verdict\": \"pass\"")).unwrap_or_else(|| panic!("{printed}"));
    verb(at, &format!("evidence fleet/unit-{unit:03} e --safety-case"), 0, &[]);
    verb(at, "verify e", 0, &[]);
    let Some(argument) = argument(&at.join("e")) else { return };
    assert_statuses(
        &argument,
        &[("G-fleet", "not supported"), ("G-requirements", "supported"), ("G-may-run", "not supported")],
    );
}

/// Imported rows leave open what their author alone knows.
#[test]
fn imports_have_open_defeaters() {
    let dir = folder();
    let at = dir.path();
    let rows = |header: &str, row: &dyn Fn(u32) -> String| {
        let rows: Vec<String> = (0..240).map(|i| format!("{},{}", u8::from(i % 11 != 0), row(i))).collect();
        format!("success,{header}\n{}\n", rows.join("\n"))
    };
    let mass = |i: u32| format!("{:.3}", 0.1 + f64::from(i * 37 % 240) / 600.0);
    fs::write(at.join("plain.csv"), rows("mass_kg", &mass)).unwrap();
    fs::write(at.join("groups.csv"), rows("mass_kg,operator", &|i| format!("{},op{}", mass(i), i % 30))).unwrap();
    verb(at, "import plain.csv plain", 0, &[]);
    verb(at, "import groups.csv groups --sampling observed --stopping fixed", 0, &[]);
    verb(at, "evidence plain e --requirements gate.toml --safety-case", 0, &[]);
    verb(at, "evidence groups g --requirements gate.toml --safety-case", 0, &[]);
    verb(at, "verify e", 0, &[]);
    let Some(plain) = argument(&at.join("e")) else { return };
    let open = [
        ("CG-chosen-episodes", "open"),
        ("CG-dependence", "open"),
        ("CG-other-policy", "open"),
        ("CG-other-environment", "open"),
        ("CG-chosen-question", "open"),
        ("CG-simulation", "open"),
        ("G-requirements", "supported"),
        ("G-population", "undeveloped"),
    ];
    assert_statuses(&plain, &open);
    let groups = argument(&at.join("g")).unwrap();
    assert_statuses(&groups, &[("CG-chosen-episodes", "answered"), ("CG-dependence", "answered")]);
}

/// A task from a file, with the arm.
#[test]
fn task_files_have_arguments() {
    let dir = folder();
    let at = dir.path();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/tasks/button");
    let file = file.canonicalize().unwrap();
    fs::write(at.join("some.toml"), requirements(0.05, 0.75, 1)).unwrap();
    let line = format!("gate --task {} --requirements some.toml --rounds 1 --out run", file.display());
    let printed = crate::harness::text(&crate::harness::robogate_in(at, &line.split(' ').collect::<Vec<_>>()));
    let output = crate::harness::robogate_in(at, &["evidence", "run", "e", "--safety-case"]);
    assert!(matches!(output.status.code(), Some(0 | 1 | 3)), "{printed} {}", crate::harness::text(&output));
    verb(at, "verify e", 0, &[]);
    let Some(argument) = argument(&at.join("e")) else { return };
    assert_statuses(&argument, &[("G-subject", "supported"), ("G-independence", "supported")]);
}
