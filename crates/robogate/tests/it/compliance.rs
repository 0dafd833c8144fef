//! The compliance pack of evidence, as other tools read it.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use robogate_gate::Sampling;
use robogate_gate::evidence::{Content, Ingredients, MANIFEST, Manifest, Role, write};
use serde_json::Value;
use tempfile::TempDir;

use crate::harness::{assert_exit_in, path};
use crate::verbs::assert_self_contained;

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
    assert_eq!(
        names,
        ["gate.junit.xml", "operating-domain.odd.yaml", "sbom.cdx.json", "verdict.html"].map(str::to_owned).into()
    );
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
        documents: Some(|_| vec![("compliance/verdict.html".to_owned(), b"<h1>PASS</h1>".to_vec())]),
    };
    let others = forged.others.clone();
    // Consistent in all hashes and statements: only the document itself shows that it is not that of the evaluation.
    write(&dir.path().join("forged"), &forged, None).unwrap();
    let printed = robogate(dir.path(), "verify forged", 4);
    assert!(printed.contains("compliance/verdict.html: differs from the document of the evaluation"), "{printed}");

    // The summary of other rows, and lists of components without one, or about another policy.
    let summary = fs::read_to_string(at("summary.json")).unwrap();
    let better = summary.replacen("\"successes\": ", "\"successes\": 1", 1);
    assert_ne!(summary, better);
    let others = others.into_iter().map(|(role, path, content)| match role {
        Role::Summary => (role, path, Content::Bytes(better.clone().into_bytes())),
        _ => (role, path, content),
    });
    let forged = Ingredients { others: others.collect(), documents: None, ..forged };
    write(&dir.path().join("better"), &forged, None).unwrap();
    let printed = robogate(dir.path(), "verify better", 4);
    assert!(
        printed.contains("summary.json: `stages.0.successes` is 1") && printed.contains("the rows give"),
        "{printed}"
    );

    let honest = Ingredients {
        others: manifest
            .files
            .iter()
            .filter(|file| kept(file.role))
            .map(|file| (file.role, file.path.clone(), Content::File(at(&file.path))))
            .collect(),
        ..forged
    };
    let listed = fs::read_to_string(at("compliance/sbom.cdx.json")).unwrap();
    let source = robogate_session::SOURCE_SHA256;
    let lists = [
        (listed.replace("\"name\": \"serde\"", "\"name\": \"serde2\""), "`components."),
        (
            listed.replace("\"name\": \"mujoco\"", "\"name\": \"mujoco2\"").replace(source, "of another build"),
            "the rows give",
        ),
    ];
    for (number, (list, reason)) in lists.into_iter().enumerate() {
        assert_ne!(list, listed);
        let name = format!("list-{number}");
        let path = "compliance/sbom.cdx.json".to_owned();
        let others = honest.others.iter().cloned().chain([(Role::Compliance, path, Content::Bytes(list.into_bytes()))]);
        write(&dir.path().join(&name), &Ingredients { others: others.collect(), ..honest.clone() }, None).unwrap();
        let printed = robogate(dir.path(), &format!("verify {name}"), 4);
        assert!(printed.contains("compliance/sbom.cdx.json: ") && printed.contains(reason), "{printed}");
    }
}

#[test]
fn page_states_the_verdict() {
    let dir = pack();
    let page = fs::read_to_string(dir.path().join("e/compliance/verdict.html")).unwrap();
    assert_self_contained(&path(&dir, "e/compliance/verdict.html"));
    let evaluation: Value = serde_json::from_slice(&fs::read(dir.path().join("e/evaluation.json")).unwrap()).unwrap();
    let dataset = evaluation["dataset_sha256"].as_str().unwrap();
    for part in
        ["<h1>PASS</h1>", "SYS-12, R&amp;D-3", "cell 7 &lt;A&gt;", "built into robogate", dataset, "@media print"]
    {
        assert!(page.contains(part), "{part}: {page}");
    }
}

/// Every folder of evidence opens with a page for a reader who was not there, and `verify` ends with whether to trust it.
#[test]
fn evidence_has_a_first_page_and_a_last_line() {
    let dir = pack();
    robogate(dir.path(), "keys new author", 0);
    robogate(dir.path(), "evidence run plain", 0);
    robogate(dir.path(), "evidence run signed --key author", 0);
    let page = fs::read_to_string(dir.path().join("plain/index.html")).unwrap();
    assert_self_contained(&path(&dir, "plain/index.html"));
    for part in [
        "Operating ranges",
        "mass_kg",
        "Nothing was tested outside of them",
        "No requirement limits these failure modes alone",
        "robogate verify .",
        "states no signature",
    ] {
        assert!(page.contains(part), "{part}: {page}");
    }
    let last = |line: &str, code: i32| {
        robogate(dir.path(), line, code).lines().rfind(|line| !line.is_empty()).unwrap().to_owned()
    };
    assert!(last("verify plain", 0).contains("Do not trust this evidence yet, because it is unsigned"));
    assert!(last("verify signed", 0).contains("Do not trust this evidence yet, because you did not say whom to trust"));
    assert!(
        last("verify signed --key author.pub", 0).contains("Trust the verdict pass as far as you trust its signer")
    );
    fs::write(dir.path().join("plain/index.html"), page.replace("PASS", "FAIL")).unwrap();
    assert!(last("verify plain", 4).contains("Do not trust this evidence, because index.html does not verify."));
}

/// Another reader of OpenODD decides for 10,000 points, half of them beyond one range, whether they are in the operating domain.
#[test]
fn operating_domain_agrees_with_openodd() {
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", "a Python with openodd-py") else { return };
    let dir = pack();
    let (domain, points) = (dir.path().join("e/compliance/operating-domain.odd.yaml"), dir.path().join("points.json"));
    let text = fs::read_to_string(&domain).unwrap();
    assert!(text.contains("mass_kg: \"[0.2, 0.3]\"") && text.contains("shape: [\"box\"]"), "{text}");
    let inside = |at: u64| at.is_multiple_of(2);
    let point = |at: u64| {
        let beyond = if inside(at) { 0 } else { 1 + at % 3 };
        let mass_kg = if beyond == 1 { 0.31 + at as f64 } else { 0.2 + 1e-5 * (at % 10_001) as f64 };
        let obstacles = if beyond == 2 { -(at as i64) } else { 0 };
        let shape = if beyond == 3 { "cylinder" } else { "box" };
        serde_json::json!({ "mass_kg": mass_kg, "obstacles": obstacles, "shape": shape, "size_m": 0.05, "friction": 0.8,
            "com_offset": 0.0, "placement": "center_0", "ik_noise_rad": 0.0 })
    };
    fs::write(&points, serde_json::to_string(&(0..10_000).map(point).collect::<Vec<_>>()).unwrap()).unwrap();
    let found = evaluated(&python, &domain, &points);
    assert_eq!(found, (0..10_000).map(inside).collect::<Vec<bool>>());
}

/// Whether each point is in the domain, as openodd-py decides.
fn evaluated(python: &Path, domain: &Path, points: &Path) -> Vec<bool> {
    let program = "import json, sys, pathlib, openodd\n\
        odd = openodd.load_openodd(pathlib.Path(sys.argv[1]), name='x')\n\
        print(json.dumps([odd.evaluate(point).inside for point in json.load(open(sys.argv[2]))]))";
    let output = std::process::Command::new(python).args(["-c", program]).arg(domain).arg(points).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Names, words and numbers of any kind: the other reader decides as the space does.
#[test]
fn any_operating_domain_agrees_with_openodd() {
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", "a Python with openodd-py") else { return };
    let dir = TempDir::new().unwrap();
    let at = |name: &str| dir.path().join(name);
    let space = r##"
        name = "any: \"space\""
        [[parameter]]
        name = "tiny_m"
        kind = "continuous"
        low = 1e-9
        high = 3e-7
        scale = "log"
        [[parameter]]
        name = "below"
        kind = "continuous"
        low = -2.5
        high = -0.0
        [[parameter]]
        name = "large_n"
        kind = "continuous"
        low = 1e5
        high = 1.5e17
        [[parameter]]
        name = "count"
        kind = "integer"
        low = -3
        high = 4
        [[parameter]]
        name = "word"
        kind = "categorical"
        choices = ["yes", "no", "1", "null", "a, b", "[x]", "été", "quote\"d", "#"]
    "##;
    let space = robogate_core::ParameterSpace::from_toml(space).unwrap();
    fs::write(at("x.odd.yaml"), robogate_gate::operating_domain(space.name(), space.parameters())).unwrap();
    let words = ["yes", "no", "1", "null", "a, b", "[x]", "été", "quote\"d", "#", "other", "a", "x"];
    let mut expected = Vec::new();
    let mut points = Vec::new();
    for i in 0..10_000_u32 {
        let share = |step: u32| f64::from(i.wrapping_mul(step) % 1_009) / 1_000.0;
        let (tiny_m, below) = (1e-9 + share(7) * 2.99e-7, -2.5 + share(13) * 2.5);
        let (large_n, count) = (1e5 + share(29) * 1.5e17, i64::from(i % 10) - 4);
        let word = words[(i % 37) as usize % words.len()];
        let inside = tiny_m <= 3e-7
            && below <= 0.0
            && large_n <= 1.5e17
            && (-3..=4).contains(&count)
            && (i % 37) as usize % words.len() < 9;
        expected.push(inside);
        points.push(
            serde_json::json!({ "tiny_m": tiny_m, "below": below, "large_n": large_n, "count": count, "word": word }),
        );
    }
    assert!(expected.iter().filter(|inside| **inside).count() > 4_000);
    fs::write(at("points.json"), serde_json::to_string(&points).unwrap()).unwrap();
    assert_eq!(evaluated(&python, &at("x.odd.yaml"), &at("points.json")), expected);
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
