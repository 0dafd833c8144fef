//! The compliance pack of evidence, as other tools read it.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use robogate_gate::Sampling;
use robogate_gate::evidence::{Content, Ingredients, MANIFEST, Manifest, Role, write};
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::assert_exit_in;

const REQUIREMENTS: &str = "name = \"cell 7 <A>\"\nmode = \"confidence\"\nconfidence = 0.75\n[budget]\nrounds = 8\n\
    [[requirement]]\nmetric = \"success\"\nat_least = 0.1\nids = [\"SYS-12\", \"R&D-3\"]\n\
    [[requirement]]\nmetric = \"failure:collision\"\nat_most = 0.9\n";
const SUITE: &str = r#"
schema = 1
name = "one"
version = "1.0.0"
description = "Two parts that the controller places."
defaults = { shape = "box", size_m = 0.05, mass_kg = 0.2, friction = 0.8, com_offset = 0.0, placement = "center_0", ik_noise_rad = 0.0, obstacles = 0 }
[[group]]
name = "easy"
category = "nominal"
scenarios = [{ id = "easy-1" }, { id = "easy-2", mass_kg = 0.3 }]
"#;

fn robogate(dir: &Path, line: &str, code: i32) -> String {
    assert_exit_in(dir, &line.split(' ').collect::<Vec<_>>(), code, &[])
}

/// A folder with the evidence `e` of a gate, with its pack.
fn pack() -> TempDir {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("suite.toml"), SUITE).unwrap();
    fs::write(dir.path().join("gate.toml"), REQUIREMENTS).unwrap();
    robogate(dir.path(), "gate --suite suite.toml --requirements gate.toml --seed 7 --out run", 0);
    robogate(dir.path(), "evidence run e --compliance", 0);
    dir
}

#[test]
fn compliance_pack_is_verified() {
    let dir = pack();
    robogate(dir.path(), "verify e", 0);
    let names: BTreeSet<String> = fs::read_dir(dir.path().join("e/compliance"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names, ["gate.junit.xml", "gate.reqif", "sbom.cdx.json", "verdict.pdf"].map(str::to_owned).into());
    // Equal runs give equal packs.
    robogate(dir.path(), "evidence run again --compliance", 0);
    for name in &names {
        let read = |folder: &str| fs::read(dir.path().join(folder).join("compliance").join(name)).unwrap();
        assert_eq!(read("e"), read("again"), "{name}");
    }
    let junit = fs::read_to_string(dir.path().join("e/compliance/gate.junit.xml")).unwrap();
    let junit = roxmltree::Document::parse(&junit).unwrap();
    let ids: Vec<_> = junit
        .descendants()
        .filter(|node| node.attribute("name") == Some("requirement"))
        .filter_map(|node| node.attribute("value"))
        .collect();
    assert_eq!(ids, ["SYS-12", "R&D-3"]);
}

#[test]
fn forged_documents_are_found() {
    let dir = pack();
    let at = |name: &str| dir.path().join("e").join(name);
    let manifest: Manifest = serde_json::from_slice(&fs::read(at(MANIFEST)).unwrap()).unwrap();
    let kept = |role: Role| matches!(role, Role::Plan | Role::Summary | Role::Question | Role::Robot);
    let others = manifest.files.iter().filter(|file| kept(file.role));
    let forged = Ingredients {
        dictionary: at("dictionary.parquet"),
        requirements: Content::File(at("requirements.toml")),
        baseline: None,
        real: None,
        against: None,
        sampling: Sampling::Sequential,
        reasked: false,
        others: others.map(|file| (file.role, file.path.clone(), Content::File(at(&file.path)))).collect(),
        documents: Some(|_, _| vec![("compliance/verdict.pdf".to_owned(), b"%PDF-1.4 PASS".to_vec())]),
    };
    // Consistent in all hashes and statements: only the document itself shows that it is not that of the evaluation.
    write(&dir.path().join("forged"), &forged, None).unwrap();
    let printed = robogate(dir.path(), "verify forged", 4);
    assert!(printed.contains("compliance/verdict.pdf: differs from the document of the evaluation"), "{printed}");
}

#[test]
fn references_of_reqif_resolve() {
    let dir = pack();
    let text = fs::read_to_string(dir.path().join("e/compliance/gate.reqif")).unwrap();
    let document = roxmltree::Document::parse(&text).unwrap();
    let identifiers: Vec<&str> = document.descendants().filter_map(|node| node.attribute("IDENTIFIER")).collect();
    let unique: BTreeSet<&str> = identifiers.iter().copied().collect();
    assert_eq!(unique.len(), identifiers.len());
    let references = document.descendants().filter(|node| node.tag_name().name().ends_with("-REF"));
    let references: Vec<&str> = references.filter_map(|node| node.text()).collect();
    assert!(references.len() > 20 && references.iter().all(|reference| unique.contains(reference)), "{references:?}");
    assert!(text.contains("\"SYS-12, R&amp;D-3\""));
}

#[test]
fn reqif_satisfies_its_schema() {
    let wanted = "a Python with the package reqif";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let dir = pack();
    // The package contains the schema of the standard and the schemas that it imports.
    let program = "import sys\nfrom reqif.cli.main import main\nsys.argv[1:] = ['validate', '--use-reqif-schema', sys.argv[1]]\nmain()";
    let file = dir.path().join("e/compliance/gate.reqif");
    let output = Command::new(python).args(["-c", program]).arg(file).output().unwrap();
    let printed = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{printed}");
}

#[test]
fn pdf_states_the_verdict() {
    let Some(pdftotext) = robogate_testing::program("pdftotext") else { return };
    let dir = pack();
    let file = dir.path().join("e/compliance/verdict.pdf");
    let output = Command::new(pdftotext).args(["-layout"]).arg(file).arg("-").output().unwrap();
    // A reader of PDF complains on stderr about a file that it has to repair.
    assert!(output.status.success() && output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let evaluation: Value = serde_json::from_slice(&fs::read(dir.path().join("e/evaluation.json")).unwrap()).unwrap();
    let dataset = evaluation["dataset_sha256"].as_str().unwrap();
    for part in ["PASS", "SYS-12, R&D-3", "cell 7 <A>", "built into robogate", dataset, "page 1 of"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn components_name_what_was_judged() {
    let dir = pack();
    let text = fs::read(dir.path().join("e/compliance/sbom.cdx.json")).unwrap();
    let sbom: Value = serde_json::from_slice(&text).unwrap();
    assert_eq!((sbom["bomFormat"].as_str(), sbom["specVersion"].as_str()), (Some("CycloneDX"), Some("1.5")));
    let components = sbom["components"].as_array().unwrap();
    let references: BTreeSet<&str> =
        components.iter().map(|component| component["bom-ref"].as_str().unwrap()).collect();
    assert_eq!(references.len(), components.len());
    for reference in ["policy", "robot", "episodes", "simulator"] {
        assert!(references.contains(reference), "{reference}");
    }
    let simulator = components.iter().find(|component| component["bom-ref"] == "simulator").unwrap();
    assert_eq!(simulator["name"], "mujoco");
    assert_eq!(simulator["hashes"][0]["content"].as_str().unwrap().len(), 64);
}
