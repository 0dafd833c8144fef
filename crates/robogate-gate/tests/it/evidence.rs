//! Evidence is valid until a file changes, and verification names the changed file.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use robogate_core::{
    Assignment, Episode, FailureMode, Fault, FaultKind, Measures, Outcome, ParameterSpace, Scenario, Seed, Value,
};
use robogate_dictionary::{
    Engine, Entry, Label, Platform, Provenance, Robot, SCHEMA_VERSION, Tool, robot_sha256, write_parquet,
};
use robogate_gate::evidence::{
    Content, Envelope, EvidenceError, Ingredients, PrivateKey, Problem, PublicKey, Role, Signed,
    pre_authentication_encoding, verify, write,
};
use robogate_gate::{Sampling, Verdict};
use sha2::{Digest, Sha256};

const SEED: [u8; 32] = [7; 32];

/// The only file of the robot.
const ROBOT: &[u8] = b"name = 'franka'\n";

fn key() -> PrivateKey {
    PrivateKey::from_seed(SEED)
}

fn rows(path: &Path, n: u64, failures: u64) {
    planned_rows(path, n, failures, serde_json::json!({ "n": n }), |_| Label::default());
}

/// Rows with a plan and labels.
fn planned_rows(path: &Path, n: u64, failures: u64, plan: serde_json::Value, label: impl Fn(u64) -> Label) {
    let space = ParameterSpace::from_toml(
        "name = 'test'\n[[parameter]]\nname = 'mass_kg'\nkind = 'continuous'\nlow = 0.1\nhigh = 2.0\n",
    )
    .unwrap();
    let provenance = Provenance {
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: None,
        engine: Engine { name: "mujoco".into(), version: Some("3.17.0".into()), build_sha256: Some("ab".repeat(32)) },
        task: std::sync::Arc::new(crate::common::task()),
        robot: Robot { name: "franka".into(), sha256: Some(robot_sha256([("robot.toml", ROBOT)])), dimensions: None },
        policy: "scripted".into(),
        world: None,
        space,
        plan,
        seed: 5,
        question_sha256: None,
        platform: Some(Platform::here()),
        source: None,
    };
    let entry = |index: u64| {
        let requested: Assignment =
            [(Arc::from("mass_kg"), Value::Number(0.1 + index as f64 / n as f64))].into_iter().collect();
        let outcome = match index {
            i if i < failures => Outcome::Failure(FailureMode::constant("grip_loss")),
            i if i == n - 1 => Outcome::Invalid(Fault::new(FaultKind::Setup, "it starts in contact")),
            _ => Outcome::Success,
        };
        Entry {
            stage: "uniform".into(),
            design: "latin_hypercube".into(),
            weight: 1.0,
            label: label(index),
            episode: Episode {
                scenario: Scenario { index, seed: Seed::campaign(5).episode(index), requested },
                applied: Assignment::default(),
                outcome,
                time_s: 6.0,
                phase: None,
                contact: None,
                measures: Measures::default(),
                draws: Default::default(),
                ticks: 120,
                trajectory_hash: index,
            },
        }
    };
    write_parquet(path, &provenance, (0..n).map(|i| Ok(entry(i)))).unwrap();
    let plan = serde_json::json!({ "version": 1, "plan": provenance.plan, "provenance": provenance });
    fs::write(path.with_file_name("plan.json"), plan.to_string()).unwrap();
}

/// A folder with a run, and the content of its evidence.
struct Run {
    folder: tempfile::TempDir,
    ingredients: Ingredients,
}

fn run(failures: u64) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    rows(&at("d.parquet"), 80, failures);
    fs::write(
        at("r.toml"),
        "name = 'test'\nmode = 'confidence'\nconfidence = 0.95\n\n[[requirement]]\nmetric = 'success'\nat_least = 0.9\n",
    )
    .unwrap();
    fs::write(at("robot.toml"), ROBOT).unwrap();
    let ingredients = Ingredients {
        dictionary: at("d.parquet"),
        requirements: Content::File(at("r.toml")),
        baseline: None,
        real: None,
        against: None,
        sampling: Sampling::Fixed,
        reasked: false,
        others: vec![
            (Role::Plan, "plan.json".into(), Content::File(at("plan.json"))),
            (Role::Robot, "robot/robot.toml".into(), Content::File(at("robot.toml"))),
        ],
        documents: None,
    };
    Run { folder, ingredients }
}

impl Run {
    fn evidence(&self, name: &str, key: Option<&PrivateKey>) -> PathBuf {
        let to = self.folder.path().join(name);
        write(&to, &self.ingredients, key).unwrap();
        to
    }
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(root: &Path, here: &Path, found: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(here).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(root, &path, found);
            } else {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(folder, folder, &mut found);
    found
}

fn names(problems: &[Problem]) -> Vec<&str> {
    problems.iter().map(|problem| problem.file.as_str()).collect()
}

/// The text of the problems of `file`. Panics if there are none.
fn about(result: Result<robogate_gate::evidence::Verified, Vec<Problem>>, file: &str) -> String {
    let problems = result.unwrap_err();
    assert!(names(&problems).contains(&file), "{file}: {problems:?}");
    problems.iter().map(|problem| format!("{problem}\n")).collect()
}

#[test]
fn unchanged_evidence_is_valid() {
    let run = run(0);
    let bare = verify(&run.evidence("bare", None), None).unwrap();
    assert_eq!((bare.verdict, bare.signed), (Verdict::Pass, Signed::Unsigned));
    assert_eq!((bare.counts.episodes, bare.counts.invalid), (80, 1));
    let signed = run.evidence("signed", Some(&key()));
    let keyid = key().public().id();
    assert_eq!(verify(&signed, None).unwrap().signed, Signed::ByUnknown { keyid: keyid.clone() });
    assert_eq!(verify(&signed, Some(&key().public())).unwrap().signed, Signed::ByTrusted { keyid });
}

#[test]
fn failed_gates_give_valid_evidence() {
    let run = run(40);
    let folder = run.evidence("e", Some(&key()));
    assert_eq!(verify(&folder, None).unwrap().verdict, Verdict::Fail);
    let envelope: Envelope = serde_json::from_slice(&fs::read(folder.join("test-result.dsse.json")).unwrap()).unwrap();
    let statement: serde_json::Value = serde_json::from_slice(&envelope.body().unwrap()).unwrap();
    assert_eq!(statement["predicate"]["result"], "FAILED");
    assert_eq!(statement["predicate"]["passedTests"], serde_json::json!([]));
    assert_eq!(statement["predicate"]["failedTests"].as_array().unwrap().len(), 1);
}

/// Offsets of the bytes to flip: all of a small file, otherwise a sample with a different start in each file.
fn places(length: usize) -> Box<dyn Iterator<Item = usize>> {
    const SMALL: usize = 400;
    if length <= SMALL { Box::new(0..length) } else { Box::new((length % 7..length).step_by(length / SMALL + 1)) }
}

#[test]
fn flipped_bytes_are_detected() {
    for key in [None, Some(key())] {
        let run = run(3);
        let folder = run.evidence("e", key.as_ref());
        let mut flips = 0;
        for (name, bytes) in files(&folder) {
            let path = folder.join(&name);
            for at in places(bytes.len()) {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << (at % 8);
                fs::write(&path, &changed).unwrap();
                let problems = verify(&folder, None).expect_err(&format!("byte {at} of {name}"));
                assert!(names(&problems).contains(&name.as_str()), "byte {at} of {name}: {problems:?}");
                flips += 1;
            }
            fs::write(&path, &bytes).unwrap();
        }
        assert!(verify(&folder, None).is_ok());
        println!("{flips} flipped bytes detected");
    }
}

#[test]
fn changed_file_lists_are_detected() {
    let run = run(0);
    let folder = run.evidence("e", Some(&key()));
    for name in files(&folder).into_keys() {
        let (there, away) = (folder.join(&name), run.folder.path().join("away"));
        fs::rename(&there, &away).unwrap();
        assert!(about(verify(&folder, None), &name).contains("missing"), "{name}");
        fs::rename(&away, &there).unwrap();
    }
    for name in ["more.parquet", "robot/extra", ".hidden", "evidence.intoto.json", "baseline.json"] {
        fs::write(folder.join(name), "{}").unwrap();
        assert!(about(verify(&folder, None), name).contains("not part of the evidence"));
        fs::remove_file(folder.join(name)).unwrap();
    }
    #[cfg(unix)]
    {
        let (there, away) = (folder.join("plan.json"), run.folder.path().join("away"));
        fs::rename(&there, &away).unwrap();
        std::os::unix::fs::symlink(&away, &there).unwrap();
        assert!(about(verify(&folder, None), "plan.json").contains("not a regular file"));
        fs::remove_file(&there).unwrap();
        fs::rename(&away, &there).unwrap();
    }
    assert!(verify(&folder, None).is_ok());
}

#[test]
fn forged_evidence_needs_the_key() {
    let run = run(30);
    let honest = run.evidence("honest", Some(&key()));
    assert_eq!(verify(&honest, Some(&key().public())).unwrap().verdict, Verdict::Fail);
    // The limit is lowered afterwards, and everything is signed again with another key.
    let requirements = run.folder.path().join("r.toml");
    let lowered = fs::read_to_string(&requirements).unwrap().replace("0.9\n", "0.3\n");
    fs::write(&requirements, lowered).unwrap();
    let other = PrivateKey::from_seed([8; 32]);
    let forged = run.evidence("forged", Some(&other));
    assert_eq!(verify(&forged, None).unwrap().signed, Signed::ByUnknown { keyid: other.public().id() });
    let text = about(verify(&forged, Some(&key().public())), "signer.pub.pem");
    assert!(text.contains(&other.public().id()) && text.contains(&key().public().id()), "{text}");
    let bare = run.evidence("bare", None);
    assert!(about(verify(&bare, Some(&key().public())), "manifest.json").contains("unsigned, but a signature"));
    // Only the envelopes are signed with the other key.
    for name in ["evidence.dsse.json", "test-result.dsse.json"] {
        let kept = fs::read(honest.join(name)).unwrap();
        fs::copy(forged.join(name), honest.join(name)).unwrap();
        assert!(about(verify(&honest, None), name).contains("no valid signature"));
        fs::write(honest.join(name), kept).unwrap();
    }
}

/// Nothing of a folder is parsed before the signature is checked: neither a manifest nor requirements can exhaust the verifier.
#[test]
fn signature_is_checked_first() {
    let run = run(30);
    let folder = run.evidence("e", Some(&key()));
    let other = PrivateKey::from_seed([8; 32]).public();
    let bomb = "[".repeat(1 << 20);
    fs::write(folder.join("manifest.json"), &bomb).unwrap();
    fs::write(folder.join("requirements.toml"), &bomb).unwrap();
    let problems = verify(&folder, Some(&other)).unwrap_err();
    assert_eq!(problems.iter().map(|problem| &*problem.file).collect::<Vec<_>>(), ["signer.pub.pem"]);
    let text = about(verify(&folder, Some(&key().public())), "manifest.json");
    assert!(text.contains("one of them was changed") && !text.contains("JSON"), "{text}");
}

#[test]
fn changed_verdicts_are_detected_unsigned() {
    let run = run(40);
    let folder = run.evidence("e", None);
    let manifest = fs::read_to_string(folder.join("manifest.json")).unwrap();
    fs::write(folder.join("manifest.json"), manifest.replace("\"verdict\": \"fail\"", "\"verdict\": \"pass\""))
        .unwrap();
    let text = about(verify(&folder, None), "manifest.json");
    assert!(text.contains("states pass, but the rows give fail"), "{text}");
}

#[test]
fn other_formats_are_rejected() {
    let run = run(0);
    let folder = run.evidence("e", None);
    let manifest = fs::read_to_string(folder.join("manifest.json")).unwrap();
    for (format, wanted) in [("2", "is no longer supported"), ("4", "upgrade robogate"), ("\"x\"", "no `format`")] {
        let changed = manifest.replacen("\"format\": 3", &format!("\"format\": {format}"), 1);
        fs::write(folder.join("manifest.json"), changed).unwrap();
        assert!(about(verify(&folder, None), "manifest.json").contains(wanted));
    }
    let out = manifest.replacen("\"path\": \"plan.json\"", "\"path\": \"../plan.json\"", 1);
    fs::write(folder.join("manifest.json"), out).unwrap();
    assert!(about(verify(&folder, None), "manifest.json").contains("not a valid path in the folder"));
    assert!(about(verify(run.folder.path(), None), "manifest.json").contains("missing"));
}

#[test]
fn bytes_are_reproducible_without_key() {
    let run = run(2);
    let (a, b) = (files(&run.evidence("a", Some(&key()))), files(&run.evidence("b", Some(&key()))));
    assert_eq!(a, b);
    let pem_path = run.folder.path().join("k");
    key().write_new(&pem_path).unwrap();
    let pem = fs::read_to_string(&pem_path).unwrap();
    let line = pem.lines().nth(1).unwrap().to_owned();
    let hex: String = SEED.iter().map(|byte| format!("{byte:02x}")).collect();
    for (name, bytes) in &a {
        let text = String::from_utf8_lossy(bytes);
        assert!(!text.contains(&line) && !text.contains(&hex), "{name}");
        assert!(!bytes.windows(SEED.len()).any(|window| window == SEED), "{name}");
    }
    assert!(!format!("{:?}", key()).contains(&hex));
    assert!(matches!(write(&run.folder.path().join("a"), &run.ingredients, None), Err(EvidenceError::Exists { .. })));
}

#[test]
fn invalid_paths_are_rejected() {
    let mut run = run(0);
    let plan = run.folder.path().join("plan.json");
    for (name, wanted) in [
        ("../plan.json", "not a valid path"),
        ("/etc/plan.json", "not a valid path"),
        ("a//b", "not a valid path"),
        (".plan", "not a valid path"),
        ("plan.json", "two files"),
        ("manifest.json", "two files"),
        ("test-result.dsse.json", "two files"),
    ] {
        run.ingredients.others.push((Role::Attachment, name.to_owned(), Content::File(plan.clone())));
        let to = run.folder.path().join("e");
        let error = write(&to, &run.ingredients, None).unwrap_err().to_string();
        assert!(error.contains(wanted), "{name}: {error}");
        assert!(!to.exists() && !run.folder.path().join(".e.part").exists());
        run.ingredients.others.pop();
    }
}

#[test]
#[cfg(unix)]
fn private_keys_are_owner_only() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("k.pem");
    let public = key().write_new(&path).unwrap();
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert_eq!(PrivateKey::read(&path).unwrap().public(), PublicKey::read(&public).unwrap());
    assert!(matches!(key().write_new(&path), Err(EvidenceError::Exists { .. })));
    for mode in [0o644, 0o640, 0o604, 0o660] {
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let error = PrivateKey::read(&path).unwrap_err().to_string();
        assert!(error.contains("chmod 600") && error.contains(&format!("{mode:03o}")), "{error}");
    }
    let error = PublicKey::read(&path).unwrap_err().to_string();
    assert!(error.contains("it is a private key"), "{error}");
    fs::set_permissions(&public, fs::Permissions::from_mode(0o600)).unwrap();
    let error = PrivateKey::read(&public).unwrap_err().to_string();
    assert!(error.contains("it is a public key"), "{error}");
    fs::write(folder.path().join("x"), "nothing").unwrap();
    fs::set_permissions(folder.path().join("x"), fs::Permissions::from_mode(0o600)).unwrap();
    let error = PrivateKey::read(&folder.path().join("x")).unwrap_err().to_string();
    assert!(error.contains("robogate keys new"), "{error}");
    assert_ne!(PrivateKey::generate().unwrap().public(), PrivateKey::generate().unwrap().public());
}

#[test]
fn dsse_reference_vectors_match() {
    // The example of the protocol specification.
    assert_eq!(
        pre_authentication_encoding("http://example.com/HelloWorld", b"hello world"),
        b"DSSEv1 29 http://example.com/HelloWorld 11 hello world"
    );
    // LEN counts bytes. Two of the letters take three bytes.
    assert_eq!(pre_authentication_encoding("\u{e4}x", b""), "DSSEv1 3 \u{e4}x 0 ".as_bytes());
    // The ed25519 vectors of the DSSE repository (testvectors/vectors.json), whose key is that of RFC 8032, test 1.
    let seed = "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60";
    let bytes: Vec<u8> = (0..32).map(|i| u8::from_str_radix(&seed[2 * i..2 * i + 2], 16).unwrap()).collect();
    let key = PrivateKey::from_seed(bytes.try_into().unwrap());
    let statement = br#"{"_type":"https://in-toto.io/Statement/v1"}"#;
    let kind = "application/vnd.in-toto+json";
    let envelope = Envelope::sign(kind, statement, &key);
    assert_eq!(envelope.payload, "eyJfdHlwZSI6Imh0dHBzOi8vaW4tdG90by5pby9TdGF0ZW1lbnQvdjEifQ==");
    let signature = "2WAfaHm5jluo0w+0rk8uVkluELJYWjSmU9x7EUzx+AyteDGJ4/nqyJXfmAUVFIAoQafWm7AxBZNw5M9ixNHiCA==";
    assert_eq!(envelope.signatures[0].sig, signature);
    assert!(envelope.is_signed_by(&key.public()));
    let from = |payload: &str, kind: &str, sig: &str| -> Envelope {
        serde_json::from_value(serde_json::json!({
            "payload": payload, "payloadType": kind, "signatures": [{ "sig": sig, "keyid": "A" }]
        }))
        .unwrap()
    };
    let url_safe = from(
        "-_-_Pj8=",
        kind,
        "P-_KHICeR7tI6S_YyejJTRtrXhcQyQ2LYPaL8h90KjC9qN8HU_svOQ6TuDOT1HIrsGW886DbWNWcCmX5twLrAw==",
    );
    assert!(url_safe.is_signed_by(&key.public()));
    assert!(!from(&envelope.payload, "application/vnd.example.other+json", signature).is_signed_by(&key.public()));
    let umlaut = "xmSk/ug66ysT7ayhkCIjhAq42zgZXSsEWuzUaNL7w2eGAdF/NU6/fRXPtmfN+5DNSAs5/i2lUnHjbbjPsu0tAw==";
    assert!(from(&envelope.payload, "application/vnd.ex\u{e4}mple+json", umlaut).is_signed_by(&key.public()));
    let empty = "gSggCAaTLTYyRH6FIDBem6meyIynsYy8RTHVzwx9tnTb7Bg/1jMWnuVgI/gffqmbsC2VX5/jHfkkDqsj7CDbDg==";
    assert!(from("", kind, empty).is_signed_by(&key.public()));
    assert!(!from("", kind, signature).is_signed_by(&key.public()));
}

#[test]
fn reference_implementations_accept_signatures() {
    let wanted = "a Python with securesystemslib and cryptography";
    let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", wanted) else { return };
    let run = run(1);
    let private = run.folder.path().join("k.pem");
    let key = PrivateKey::generate().unwrap();
    let public = key.write_new(&private).unwrap();
    let folder = run.evidence("e", Some(&key));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/evidence.py");
    let output = Command::new(python).arg(script).args([&private, &public, &folder]).output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{out}{err}");
    assert!(out.contains(&key.public().id()), "{out}");
    println!("{out}");
}

const SUITE: &str = "schema = 1\nname = 'one'\nversion = '1.0.0'\ndescription = 'One.'\n[[group]]\nname = 'g'\ncategory = 'c'\nscenarios = [{ id = 'a', mass_kg = 0.2 }]\n";

fn of_suite(run: &Run, rounds: u64, sha256: Option<&str>) {
    let suite = robogate_core::Suite::from_toml(SUITE).unwrap();
    let sha256 = sha256.map_or_else(|| robogate_dictionary::suite_sha256(&suite), str::to_owned);
    let plan = serde_json::json!({ "suite": { "rounds": rounds, "sha256": sha256, "suite": suite } });
    let label = |_| Label { case: Some("a".into()), category: Some("c".into()), group: Some("g".into()) };
    planned_rows(&run.ingredients.dictionary, 80, 0, plan, label);
}

#[test]
fn stopped_suites_are_sequential() {
    let run = run(0);
    of_suite(&run, 80, None);
    assert_eq!(write(&run.folder.path().join("whole"), &run.ingredients, None).unwrap().sampling, Sampling::Fixed);
    of_suite(&run, 200, None);
    let to = run.evidence("short", None);
    let manifest = fs::read_to_string(to.join("manifest.json")).unwrap();
    assert!(manifest.contains("\"sampling\": \"sequential\""), "{manifest}");
    verify(&to, None).unwrap();
    let forged = manifest.replace("\"sampling\": \"sequential\"", "\"sampling\": \"fixed\"");
    fs::write(to.join("manifest.json"), forged).unwrap();
    let problems = verify(&to, None).unwrap_err();
    assert!(problems.iter().any(|problem| problem.reason.contains("statements about the rows differ")), "{problems:?}");
}

#[test]
fn wrong_suite_hash_is_rejected() {
    let run = run(0);
    let refused = |part: &str| {
        let error = write(&run.folder.path().join("out"), &run.ingredients, None).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    };
    of_suite(&run, 80, Some(&"0".repeat(64)));
    refused("but the plan states 000");
    planned_rows(&run.ingredients.dictionary, 80, 0, serde_json::json!({ "suite": { "sha256": "00" } }), |_| {
        Label::default()
    });
    refused("cannot be read");
}

#[test]
fn comparison_is_in_test_result() {
    let mut run = run(0);
    run.ingredients.against = Some((run.ingredients.dictionary.clone(), 0.2));
    let to = run.evidence("compared", None);
    let name =
        fs::read_dir(&to).unwrap().map(|e| e.unwrap().path()).find(|p| p.display().to_string().contains("test-result"));
    let text = fs::read_to_string(name.unwrap()).unwrap();
    let statement: serde_json::Value = serde_json::from_str(&text).unwrap();
    let passed = statement["predicate"]["passedTests"].to_string();
    assert!(passed.contains("not worse than the other policy"), "{text}");
}

#[test]
fn errors_name_the_users_path() {
    let mut run = run(0);
    fs::create_dir(run.folder.path().join("deep")).unwrap();
    let folder = Content::File(run.folder.path().join("deep"));
    run.ingredients.requirements = folder;
    assert!(unwritten(&run).contains("deep"));
    // A file at the path of a required folder.
    run.ingredients.requirements = Content::File(run.folder.path().join("r.toml"));
    let robot = Content::File(run.folder.path().join("robot.toml"));
    run.ingredients.others.push((Role::Attachment, "requirements.toml/x".into(), robot));
    let text = unwritten(&run);
    assert!(text.contains("unwritten/requirements.toml") && !text.contains(".part"), "{text}");
}

/// The error of writing evidence from this run.
fn unwritten(run: &Run) -> String {
    let to = run.folder.path().join("unwritten");
    let error = write(&to, &run.ingredients, None).unwrap_err().to_string();
    assert!(!to.exists());
    error
}

#[test]
fn plan_robot_and_suite_must_match_rows() {
    let mut run = run(0);
    let (plan, robot) = (run.folder.path().join("plan.json"), run.folder.path().join("robot.toml"));
    let honest = fs::read_to_string(&plan).unwrap();
    for (from, to) in [("{\"n\":80}", "{\"n\":800}"), ("scripted", "another"), ("{\"plan\"", "{\"plans\"")] {
        let changed = honest.replacen(from, to, 1);
        assert_ne!(changed, honest);
        fs::write(&plan, changed).unwrap();
        assert!(unwritten(&run).starts_with("plan.json: not "), "{}", unwritten(&run));
    }
    fs::write(&plan, &honest).unwrap();
    fs::write(&robot, "name = 'other'\n").unwrap();
    assert!(unwritten(&run).contains("not the files of the run"));
    fs::write(&robot, ROBOT).unwrap();
    run.ingredients.others.push((Role::Suite, "suite/s.toml".into(), Content::File(robot)));
    assert!(unwritten(&run).contains("suite/s.toml: the run had no suite"));
}

#[test]
fn foreign_plans_are_detected() {
    let run = run(0);
    let folder = run.evidence("e", None);
    let (plan, manifest) = (folder.join("plan.json"), folder.join("manifest.json"));
    let honest = fs::read_to_string(&plan).unwrap();
    let forged = honest.replacen("{\"n\":80}", "{\"n\":81}", 1);
    fs::write(&plan, &forged).unwrap();
    // The manifest is changed to match.
    let text = fs::read_to_string(&manifest).unwrap().replace(&sha256(&honest), &sha256(&forged));
    fs::write(&manifest, text).unwrap();
    assert!(about(verify(&folder, None), "plan.json").contains("not the plan of the rows"));
}

fn sha256(text: &str) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn added_empty_folders_are_detected() {
    let run = run(0);
    let folder = run.evidence("e", None);
    fs::create_dir_all(folder.join("robot/more")).unwrap();
    assert!(about(verify(&folder, None), "robot/more/").contains("no file of the evidence"));
}

#[test]
#[cfg(unix)]
fn pipes_and_devices_are_not_read() {
    let run = run(0);
    let folder = run.evidence("e", Some(&key()));
    let kept = run.folder.path().join("kept");
    let pipe = |path: &Path| assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    for name in files(&folder).into_keys() {
        let path = folder.join(&name);
        fs::rename(&path, &kept).unwrap();
        pipe(&path);
        assert!(about(verify(&folder, None), &name).contains("not a regular file"));
        fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        assert!(about(verify(&folder, None), &name).contains("not a regular file"));
        fs::remove_file(&path).unwrap();
        fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(about(verify(&folder, None), &name).contains("1099511627776 bytes"));
        fs::rename(&kept, &path).unwrap();
    }
    // Nor are those that the manifest does not list.
    for name in ["baseline.json", "against.parquet", "real.json", "gate-question.json", "registration.dsse.json"] {
        let path = folder.join(name);
        if !path.exists() {
            pipe(&path);
            assert!(about(verify(&folder, None), name).contains("not part of the evidence"));
            fs::remove_file(&path).unwrap();
        }
    }
    let path = run.folder.path().join("pipe");
    pipe(&path);
    assert!(PublicKey::read(&path).unwrap_err().to_string().contains("not a regular file"));
    assert!(PrivateKey::read(&path).unwrap_err().to_string().contains("not a regular file"));
}

#[test]
#[cfg(unix)]
fn key_pairs_are_written_completely() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("k");
    let public = key().write_new(&path).unwrap();
    assert_eq!(fs::metadata(&public).unwrap().permissions().mode() & 0o022, 0);
    // A public key is reported as such for any file mode.
    assert!(PrivateKey::read(&public).unwrap_err().to_string().contains("it is a public key"));
    let (other, target) = (folder.path().join("l"), folder.path().join("target"));
    std::os::unix::fs::symlink(&target, folder.path().join("l.pub")).unwrap();
    assert!(matches!(key().write_new(&other), Err(EvidenceError::Exists { .. })));
    assert!(!other.exists() && !target.exists());
    // A file name of maximum length leaves no room for the suffix `.pub`.
    let longest = folder.path().join("n".repeat(253));
    assert!(key().write_new(&longest).is_err());
    assert!(!longest.exists());
}
