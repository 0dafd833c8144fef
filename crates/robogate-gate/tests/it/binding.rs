//! Evidence is bound to what was judged. Each test is one attack of `docs/concepts/signatures.md`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use robogate_core::{Assignment, Episode, Measures, Outcome, ParameterSpace, Scenario, Seed, Value};
use robogate_dictionary::{
    Build, CellPlace, Engine, Entry, Label, Place, Platform, PolicyRecord, Provenance, Robot, SCHEMA_VERSION, Tool,
    World, write_parquet,
};
use robogate_gate::evidence::{
    Content, EnvironmentBinding, EvidenceError, Ingredients, PolicyBinding, PrivateKey, Problem, QuestionBinding,
    REGISTRATION, REGISTRATION_KEY, Registration, Role, Signed, list_of, random_positions, register, verify, write,
};
use robogate_gate::{Asked, RealEvidence, RealStratum, Requirements, Sampling};
use serde_json::json;
use sha2::{Digest, Sha256};

const NETWORK: &[u8] = b"the judged network";
const OTHER: &[u8] = b"another network";

fn key() -> PrivateKey {
    PrivateKey::from_seed([7; 32])
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn requirements(least: f64) -> String {
    format!(
        "name = 'test'\nmode = 'confidence'\nconfidence = 0.95\n\n[[requirement]]\nmetric = 'success'\nat_least = {least}\n"
    )
}

fn place() -> CellPlace {
    CellPlace {
        robot: "franka".to_owned(),
        engine: "mujoco".to_owned(),
        time_step_s: 0.002,
        renderer: None,
        physics_servers: false,
    }
}

/// A run of a gate in a folder.
struct Run {
    folder: tempfile::TempDir,
    provenance: Provenance,
    ingredients: Ingredients,
}

impl Run {
    /// A run of this policy (the value of `world.policy`) that was asked for a success rate of 90 %.
    fn of(policy: serde_json::Value) -> Self {
        let policy: Option<PolicyRecord> = serde_json::from_value(policy).unwrap();
        let space = ParameterSpace::from_toml(
            "name = 'test'\n[[parameter]]\nname = 'mass_kg'\nkind = 'continuous'\nlow = 0.1\nhigh = 2.0\n",
        );
        let asked = Asked {
            format: Asked::FORMAT,
            requirements: Requirements::from_toml(&requirements(0.9)).unwrap(),
            baseline: None,
            against: None,
            sampling: Sampling::Fixed,
            real: None,
        };
        let provenance = Provenance {
            tool: Tool::robogate(),
            schema_version: SCHEMA_VERSION,
            build: Some(Build { source_sha256: "5e".repeat(32) }),
            engine: Engine {
                name: "mujoco".into(),
                version: Some("3.17.0".into()),
                build_sha256: Some("ab".repeat(32)),
            },
            task: Arc::new(crate::common::task()),
            robot: Robot { name: "franka".into(), sha256: None, dimensions: None },
            policy: "judged".into(),
            world: Some(World { policy, ..World::new(Place::Cell(place())) }),
            space: space.unwrap(),
            plan: json!({ "n": 80 }),
            seed: 5,
            question_sha256: Some(asked.sha256()),
            platform: Some(Platform::here()),
            source: None,
        };
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (name, content) in [("network.onnx", NETWORK), ("other.onnx", OTHER)] {
            fs::write(at(name), content).unwrap();
        }
        fs::write(at("requirements.toml"), requirements(0.9)).unwrap();
        fs::write(at(Asked::FILE), asked.to_json()).unwrap();
        let ingredients = Ingredients {
            dictionary: at("d.parquet"),
            requirements: Content::File(at("requirements.toml")),
            baseline: None,
            real: None,
            against: None,
            sampling: Sampling::Fixed,
            reasked: false,
            others: vec![(Role::Question, Asked::FILE.to_owned(), Content::File(at(Asked::FILE)))],
            documents: None,
        };
        let run = Self { folder, provenance, ingredients };
        run.write_rows();
        run
    }

    /// A run of the file `network.onnx`.
    fn of_network() -> Self {
        Self::of(
            json!({ "kind": "external", "server": "/models/network.onnx", "profile": {}, "declared": { "sha256": sha256(NETWORK) } }),
        )
    }

    fn write_rows(&self) {
        let entry = |index: u64| {
            let requested: Assignment =
                [(Arc::from("mass_kg"), Value::Number(0.1 + 0.01 * index as f64))].into_iter().collect();
            let scenario = Scenario { index, seed: Seed::campaign(5).episode(index), requested };
            let episode = Episode {
                scenario,
                applied: Assignment::default(),
                outcome: Outcome::Success,
                time_s: 6.0,
                phase: None,
                contact: None,
                measures: Measures::default(),
                draws: Measures::default(),
                ticks: 120,
                trajectory_hash: index,
            };
            Entry {
                stage: "uniform".into(),
                design: "latin_hypercube".into(),
                weight: 1.0,
                label: Label::default(),
                episode,
            }
        };
        write_parquet(&self.path("d.parquet"), &self.provenance, (0..80).map(|i| Ok(entry(i)))).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn include(&mut self, role: Role, name: &str, file: &str) {
        let content = Content::File(self.path(file));
        self.ingredients.others.push((role, name.to_owned(), content));
    }

    fn written(&self, name: &str) -> PathBuf {
        let to = self.path(name);
        write(&to, &self.ingredients, Some(&key())).unwrap();
        to
    }

    fn refused(&self) -> EvidenceError {
        let to = self.path("refused");
        let error = write(&to, &self.ingredients, Some(&key())).unwrap_err();
        assert!(!to.exists());
        error
    }

    /// Registers the run with a new list of registrations, and includes the registration.
    fn registered(&mut self, key_file: &Path) -> u64 {
        let (envelope, number) = register(&key(), key_file, &self.provenance).unwrap();
        fs::write(self.path(REGISTRATION), envelope.to_json()).unwrap();
        fs::write(self.path(REGISTRATION_KEY), key().public().to_pem()).unwrap();
        self.include(Role::Registration, REGISTRATION, REGISTRATION);
        self.include(Role::Registration, REGISTRATION_KEY, REGISTRATION_KEY);
        number
    }
}

/// Replaces a file of the folder by other content, and its digest and length in the manifest.
fn replace(folder: &Path, name: &str, content: &[u8]) {
    let path = folder.join(name);
    let before = fs::read(&path).unwrap();
    fs::write(&path, content).unwrap();
    let manifest = folder.join("manifest.json");
    let length = |bytes: &[u8]| format!("\"bytes\": {},\n      \"sha256\": \"{}\"", bytes.len(), sha256(bytes));
    let text = fs::read_to_string(&manifest).unwrap();
    let changed = text.replace(&length(&before), &length(content));
    assert_ne!(text, changed, "{name} is in the manifest");
    fs::write(manifest, changed).unwrap();
}

fn problems(folder: &Path) -> String {
    let problems: Vec<Problem> = verify(folder, None).unwrap_err();
    problems.iter().map(|problem| format!("{problem}\n")).collect()
}

fn subjects(folder: &Path) -> Vec<String> {
    let envelope: robogate_gate::evidence::Envelope =
        serde_json::from_slice(&fs::read(folder.join("evidence.dsse.json")).unwrap()).unwrap();
    let statement: serde_json::Value = serde_json::from_slice(&envelope.body().unwrap()).unwrap();
    let subject = statement["subject"].as_array().unwrap();
    subject.iter().map(|subject| subject["name"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn other_policy_files_are_rejected() {
    let mut run = Run::of_network();
    run.include(Role::Policy, "policy/network.onnx", "other.onnx");
    let error = run.refused().to_string();
    assert!(error.contains("not the policy that was judged") && error.contains(&sha256(NETWORK)), "{error}");
    run.ingredients.others.pop();
    run.include(Role::Policy, "policy/network.onnx", "network.onnx");
    let folder = run.written("e");
    let verified = verify(&folder, Some(&key().public())).unwrap();
    assert_eq!(verified.policy_binding, PolicyBinding::File { sha256: sha256(NETWORK) });
    assert!(subjects(&folder).contains(&"policy/network.onnx".to_owned()));
    // Exchanged afterwards, with the manifest.
    replace(&folder, "policy/network.onnx", OTHER);
    assert!(problems(&folder).contains("not the policy that was judged"), "{}", problems(&folder));
}

#[test]
fn declared_digests_are_bound() {
    let declared = format!("sha256:{}", sha256(NETWORK));
    for policy in [
        json!({ "kind": "external", "server": "ws://host:8000", "profile": {}, "declared": { "sha256": sha256(NETWORK) } }),
        json!({ "kind": "hosted", "name": "expert", "version": declared }),
    ] {
        let mut run = Run::of(policy);
        assert_eq!(PolicyBinding::of(&run.provenance), PolicyBinding::Declared { sha256: sha256(NETWORK) });
        run.include(Role::Policy, "policy/network.onnx", "other.onnx");
        assert!(run.refused().to_string().contains("not the policy that was judged"));
    }
}

#[test]
fn unknown_policies_are_not_bound() {
    let mut run = Run::of(
        json!({ "kind": "external", "server": "ws://host:8000", "profile": {}, "declared": { "name": "act" } }),
    );
    run.include(Role::Policy, "policy/network.onnx", "network.onnx");
    let folder = run.written("e");
    let verified = verify(&folder, None).unwrap();
    assert_eq!(verified.policy_binding.to_string(), "not bound: as declared by the server");
    // The file is in the folder, but the signature does not say that it was judged.
    assert!(!subjects(&folder).contains(&"policy/network.onnx".to_owned()));
    let manifest = fs::read_to_string(folder.join("manifest.json")).unwrap();
    assert!(manifest.contains("as declared by the server"));
}

#[test]
fn built_in_policies_have_no_file() {
    let mut run = Run::of(serde_json::Value::Null);
    run.include(Role::Policy, "policy/network.onnx", "network.onnx");
    assert!(run.refused().to_string().contains("is built into robogate and has no file"));
}

#[test]
fn easier_requirements_need_consent() {
    let mut run = Run::of_network();
    fs::write(run.path("requirements.toml"), requirements(0.5)).unwrap();
    let error = run.refused();
    assert!(matches!(&error, EvidenceError::Reasked { changed } if *changed == ["requirements"]), "{error}");
    assert!(error.to_string().contains("--reasked"), "{error}");
    run.ingredients.reasked = true;
    let verified = verify(&run.written("e"), None).unwrap();
    assert_eq!(verified.question, QuestionBinding::Reasked { changed: vec!["requirements".to_owned()] });
    assert!(verified.question.to_string().starts_with("REASKED"));
}

#[test]
fn exchanged_requirements_are_detected() {
    let run = Run::of_network();
    let folder = run.written("e");
    assert_eq!(verify(&folder, None).unwrap().question, QuestionBinding::AsAsked);
    replace(&folder, "requirements.toml", requirements(0.5).as_bytes());
    assert!(!problems(&folder).is_empty());
}

#[test]
fn missing_questions_are_rejected() {
    let mut run = Run::of_network();
    run.ingredients.others.clear();
    let error = run.refused().to_string();
    assert!(error.contains("gate-question.json: missing"), "{error}");
}

#[test]
fn forged_questions_are_rejected() {
    let run = Run::of_network();
    let path = run.path(Asked::FILE);
    let easier = fs::read_to_string(&path).unwrap().replace("0.9,", "0.5,").replace("0.9\n", "0.5\n");
    fs::write(&path, &easier).unwrap();
    fs::write(run.path("requirements.toml"), requirements(0.5)).unwrap();
    let error = run.refused().to_string();
    assert!(error.contains("not the question that the gate was asked"), "{error}");
}

#[test]
fn other_baselines_and_margins_need_consent() {
    let mut run = Run::of_network();
    run.ingredients.against = Some((run.path("d.parquet"), 0.2));
    let error = run.refused();
    assert!(matches!(&error, EvidenceError::Reasked { changed } if *changed == ["margin"]), "{error}");
}

/// Trials of the real robot about the run of a test, `successes` of 20 in each stratum.
fn real_trials(successes: u64) -> RealEvidence {
    let stratum = RealStratum { share: 0.5, trials: 20, successes };
    RealEvidence {
        format: RealEvidence::FORMAT,
        task: crate::common::task().name.as_str().to_owned(),
        robot: "franka".to_owned(),
        robot_sha256: None,
        policy: "judged".to_owned(),
        policy_sha256: None,
        population: "the operating space".to_owned(),
        trials_sha256: format!("{successes:064}"),
        simulation_sha256: "c".repeat(64),
        strata: [stratum; 2],
    }
}

#[test]
fn other_real_trials_need_consent() {
    let with = |real: &RealEvidence| Some(Content::Bytes(real.to_json().into_bytes()));
    let consent = |run: &Run| {
        let error = run.refused();
        assert!(matches!(&error, EvidenceError::Reasked { changed } if *changed == ["real trials"]), "{error}");
    };
    // A gate without trials, which are added afterwards.
    let mut run = Run::of_network();
    run.ingredients.real = with(&real_trials(20));
    consent(&run);
    // A gate with weak trials, which are exchanged for stronger ones or left out.
    let path = run.path(Asked::FILE);
    let weak =
        Asked { real: Some(real_trials(12)), ..Asked::from_json(&path, &fs::read_to_string(&path).unwrap()).unwrap() };
    fs::write(&path, weak.to_json()).unwrap();
    assert!(run.refused().to_string().contains("not the question that the gate was asked"));
    run.provenance.question_sha256 = Some(weak.sha256());
    run.write_rows();
    consent(&run);
    run.ingredients.real = None;
    consent(&run);
    run.ingredients.real = with(&real_trials(12));
    assert_eq!(verify(&run.written("e"), None).unwrap().question, QuestionBinding::AsAsked);
}

#[test]
fn rows_without_question_say_so() {
    let mut run = Run::of_network();
    run.provenance.question_sha256 = None;
    run.write_rows();
    assert_eq!(verify(&run.written("old"), None).unwrap().question, QuestionBinding::Afterwards);
    run.ingredients.others.clear();
    let verified = verify(&run.written("none"), None).unwrap();
    assert!(verified.question.to_string().contains("may have been chosen after the run"));
}

#[test]
fn environments_have_a_hash() {
    let run = Run::of_network();
    let verified = verify(&run.written("e"), None).unwrap();
    assert!(verified.environment.simulator_build_known);
    let hash = |change: fn(&mut Provenance)| {
        let mut provenance = run.provenance.clone();
        change(&mut provenance);
        EnvironmentBinding::of(&provenance).sha256
    };
    let random = PolicyRecord::BuiltIn { name: "random".to_owned() };
    let mut other = run.provenance.clone();
    other.world.as_mut().unwrap().policy = Some(random);
    assert_eq!(EnvironmentBinding::of(&other).sha256, verified.environment.sha256);
    for change in [
        (|p| p.engine.build_sha256 = Some("cd".repeat(32))) as fn(&mut Provenance),
        |p| {
            p.world = Some(World::new(Place::Cell(CellPlace { time_step_s: 0.001, ..place() })));
        },
        |p| p.robot.sha256 = Some("00".to_owned()),
        |p| Arc::make_mut(&mut p.task).version += 1,
    ] {
        assert_ne!(hash(change), verified.environment.sha256);
    }
}

#[test]
fn registrations_are_numbered() {
    let mut run = Run::of_network();
    let key_file = run.path("k.pem");
    assert_eq!(register(&key(), &key_file, &run.provenance).unwrap().1, 1);
    let number = run.registered(&key_file);
    let verified = verify(&run.written("e"), Some(&key().public())).unwrap();
    let registered = verified.registration.unwrap();
    assert_eq!((number, registered.number, registered.keyid), (2, 2, key().public().id()));
    // The second names the first.
    let list = fs::read_to_string(list_of(&key_file)).unwrap();
    let lines: Vec<&str> = list.lines().collect();
    let second = Registration::open(lines[1], &key().public()).unwrap();
    assert_eq!(second.previous_sha256, Some(sha256(lines[0].as_bytes())));
    assert_eq!(second.policy_binding, PolicyBinding::File { sha256: sha256(NETWORK) });
}

#[test]
fn registration_lists_are_append_only() {
    let run = Run::of_network();
    let key_file = run.path("k.pem");
    for _ in 0..3 {
        register(&key(), &key_file, &run.provenance).unwrap();
    }
    let list = list_of(&key_file);
    let text = fs::read_to_string(&list).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    for kept in [vec![lines[0], lines[2]], vec![lines[1], lines[2]], vec![lines[1], lines[0], lines[2]]] {
        fs::write(&list, kept.join("\n") + "\n").unwrap();
        let error = register(&key(), &key_file, &run.provenance).unwrap_err().to_string();
        assert!(error.contains("must not be edited"), "{error}");
    }
    let other = PrivateKey::from_seed([8; 32]);
    fs::write(&list, &text).unwrap();
    assert!(register(&other, &key_file, &run.provenance).unwrap_err().to_string().contains("no valid signature"));
}

#[test]
fn registrations_of_other_runs_are_rejected() {
    let mut run = Run::of_network();
    let key_file = run.path("k.pem");
    // Registered with another seed; the better run is shown.
    run.provenance.seed = 6;
    run.registered(&key_file);
    run.provenance.seed = 5;
    let error = run.refused().to_string();
    assert!(error.contains("registers another run"), "{error}");
}

#[test]
fn forged_registrations_are_rejected() {
    let mut run = Run::of_network();
    run.registered(&run.path("k.pem"));
    let envelope = fs::read_to_string(run.path(REGISTRATION)).unwrap();
    // Another key than the one that signed.
    fs::write(run.path(REGISTRATION_KEY), PrivateKey::from_seed([8; 32]).public().to_pem()).unwrap();
    assert!(run.refused().to_string().contains("no valid signature"));
    fs::write(run.path(REGISTRATION_KEY), key().public().to_pem()).unwrap();
    // Evidence is not a registration.
    let folder = {
        let plain = Run::of_network();
        let folder = plain.written("e");
        fs::read_to_string(folder.join("evidence.dsse.json")).unwrap()
    };
    fs::write(run.path(REGISTRATION), folder).unwrap();
    assert!(run.refused().to_string().contains("not a registration"));
    fs::write(run.path(REGISTRATION), envelope).unwrap();
    run.ingredients.others.retain(|(_, name, _)| name != REGISTRATION_KEY);
    assert!(run.refused().to_string().contains("registration.pub.pem: missing"));
}

#[test]
fn unsigned_evidence_names_no_signer() {
    let run = Run::of_network();
    let to = run.path("bare");
    write(&to, &run.ingredients, None).unwrap();
    assert_eq!(verify(&to, None).unwrap().signed, Signed::Unsigned);
    let error = verify(&to, Some(&key().public())).unwrap_err();
    assert!(error[0].reason.contains("unsigned, but a signature"), "{error:?}");
}

#[test]
fn verifier_chooses_rows_at_random() {
    for (n, k) in [(0, 3), (5, 5), (5, 9), (1_000, 20)] {
        let rows = random_positions(n, k).unwrap();
        assert_eq!(rows.len() as u64, k.min(n));
        assert!(rows.is_sorted_by(|a, b| a < b) && rows.iter().all(|row| *row < n));
    }
    let draws: Vec<_> = (0..5).map(|_| random_positions(1 << 40, 3).unwrap()).collect();
    assert!(draws.windows(2).all(|pair| pair[0] != pair[1]));
    // Each position is drawn about equally often.
    let mut counts = [0_u32; 5];
    for _ in 0..2_000 {
        random_positions(5, 2).unwrap().iter().for_each(|row| counts[*row as usize] += 1);
    }
    assert!(counts.iter().all(|count| (640..960).contains(count)), "{counts:?}");
}

/// Each attack in the documentation names its test, which must exist.
#[test]
fn each_attack_has_a_test() {
    fn sources(folder: &Path, found: &mut String) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                sources(&path, found);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                found.push_str(&fs::read_to_string(&path).unwrap());
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut code = String::new();
    for name in ["robogate-gate/tests", "robogate-campaign/tests", "robogate/tests"] {
        sources(&root.join("crates").join(name), &mut code);
    }
    let page = fs::read_to_string(root.join("docs/concepts/signatures.md")).unwrap();
    let leaves: Vec<&str> = page
        .lines()
        .filter(|line| line.starts_with("| ") && line.as_bytes()[2].is_ascii_digit())
        .map(|line| line.rsplit('`').nth(1).unwrap())
        .collect();
    assert!(leaves.len() > 20, "{leaves:?}");
    let missing: Vec<_> = leaves.iter().filter(|name| !code.contains(&format!("fn {name}("))).collect();
    assert!(missing.is_empty(), "no test: {missing:?}");
}
