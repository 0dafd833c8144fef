//! Fuzzing of what RoboGate stores and reads again: records of gates, monitors, detectors and trials, and the folders of studies,
//! sweeps and contests.

use std::fs;
use std::path::Path;

use robogate_core::budget::Budget;
use robogate_dictionary::LostEpisode;
use robogate_gate::evidence::{PrivateKey, PublicKey, Registration};
use robogate_gate::{Asked, ForceLimits};
use robogate_monitor::Reference;
use robogate_monitor::service::ServiceSettings;
use robogate_monitor::warn::WarnFile;
use robogate_session::read_signals;
use robogate_testing::fuzz::Target;
use robogate_trial::Plan;

use crate::fuzz::{JSON, TOML, damaged, names_in, repository, texts};
use crate::harness::verb;

/// The bytes of a file that a command has written.
fn written(dir: &Path, name: &str) -> Vec<u8> {
    fs::read(dir.join(name)).unwrap()
}

#[test]
fn fuzzed_questions_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "gate --task pendulum --out gate", 1, &[]);
    let valid = written(dir.path(), "gate/gate-question.json");
    texts("question", &[valid], JSON, |text| Asked::from_json(Path::new("gate-question.json"), text).is_ok());
}

#[test]
fn fuzzed_limits_of_forces_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("limits.toml");
    let guide = fs::read_to_string(repository("docs/guides/forces.md")).unwrap();
    let example = guide.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    texts("forces", &[example.as_bytes().to_vec()], TOML, |text| {
        fs::write(&path, text).unwrap();
        ForceLimits::open(&path).is_ok()
    });
}

#[test]
fn fuzzed_results_of_transfers_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "run --task pendulum --design uniform -n 40 --out run", 0, &[]);
    let rows: String = (0..20).map(|i| format!("{},{}\n", i % 3 > 0, 0.4 + 0.02 * f64::from(i))).collect();
    fs::write(dir.path().join("real.csv"), format!("success,torque_limit_nm\n{rows}")).unwrap();
    verb(dir.path(), "transfer --sim run --real real.csv --out real.json", 0, &[]);
    damaged("transfer", dir.path(), &["real.json".to_owned()], &["gate --run run --real real.json --out gate"]);
}

#[test]
fn fuzzed_references_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "run --task pendulum --design uniform -n 40 --out run", 0, &[]);
    verb(dir.path(), "monitor reference run --learn-baseline --out m.json", 0, &[]);
    texts("reference", &[written(dir.path(), "m.json")], JSON, |text| {
        let read: Result<Reference, _> = Budget::FILE.json(text.as_bytes());
        read.is_ok_and(|reference| reference.check().is_ok())
    });
}

#[test]
fn fuzzed_settings_of_monitors_are_read_or_refused() {
    let valid = b"[detectors.recipes.bracket]\nsuccess = { count = 4890, of = 5000 }\n";
    texts("monitor.toml", &[valid.to_vec()], TOML, |text| {
        let read: Result<ServiceSettings, _> = Budget::FILE.toml(text);
        read.is_ok_and(|settings| settings.check().is_ok())
    });
}

#[test]
fn fuzzed_detectors_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "run --task pendulum --design uniform -n 400 --record-signals --out run -q", 0, &[]);
    verb(dir.path(), "warn train run --successes-only --out w.json", 0, &[]);
    texts("detector", &[written(dir.path(), "w.json")], JSON, |text| {
        let read: Result<WarnFile, _> = Budget::FILE.json(text.as_bytes());
        read.is_ok_and(|file| file.detector().is_ok() && file.scenario_risk().is_ok())
    });
}

#[test]
fn fuzzed_signals_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "run --task pendulum --design uniform -n 2 --record-signals --out run -q", 0, &[]);
    let path = dir.path().join("run/signals.rgs");
    let valid = [written(dir.path(), "run/signals.rgs")];
    Target { name: "signals", valid: &valid, kept: &[], words: JSON, inputs: 300 }.run(|bytes| {
        fs::write(&path, bytes).unwrap();
        read_signals(&dir.path().join("run"), &mut |_, _| {}).is_ok()
    });
}

#[test]
fn fuzzed_plans_of_trials_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "trial plan study --policy a --policy b --blocks 4 --count 12 --modes slip,drop", 0, &[]);
    texts("trial plan", &[written(dir.path(), "study/plan.json")], JSON, |text| {
        Plan::from_json(Path::new("plan.json"), text).is_ok_and(|plan| plan.check().is_ok())
    });
}

#[test]
fn fuzzed_registrations_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "keys new key", 0, &[]);
    verb(dir.path(), "gate --task pendulum --register key --out gate", 1, &[]);
    let key = PrivateKey::read(&dir.path().join("key")).unwrap().public();
    texts("registration", &[written(dir.path(), "gate/registration.dsse.json")], JSON, |text| {
        Registration::open(text, &key).is_ok()
    });
    texts("public key", &[written(dir.path(), "key.pub")], &["-----BEGIN", "-----END", "=", "\n"], |text| {
        PublicKey::from_pem(text).is_ok()
    });
}

#[test]
fn fuzzed_lost_episodes_are_read_or_refused() {
    let valid = br#"{"index": 7, "fault": "unreachable: refused", "began": true}"#;
    texts("lost episodes", &[valid.to_vec()], JSON, |text| !LostEpisode::parse(text).is_empty());
}

/// A study: its plan, its secret, its journal and the head.
#[test]
fn fuzzed_studies_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "trial plan study --policy a --policy b --blocks 4 --count 12", 0, &[]);
    let next = verb(dir.path(), "trial next study", 0, &[]);
    let code = next.split_whitespace().nth(1).unwrap();
    verb(dir.path(), &format!("trial record study start --code {code} --operator Ada"), 0, &[]);
    damaged("study", dir.path(), &names_in(dir.path(), "study"), &["trial status study"]);
}

/// A sweep: what people write, and the plan of its folder.
#[test]
fn fuzzed_sweeps_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let sweep = "version = 1\nname = \"s\"\nseed = 7\n[[task]]\nname = \"pendulum\"\nepisodes = 4\n[[policy]]\nname = \"scripted\"\n\
                 [[policy]]\nname = \"other\"\npolicy = \"random\"\n";
    fs::write(dir.path().join("sweep.toml"), sweep).unwrap();
    verb(dir.path(), "matrix sweep.toml --divide 2 --out sweep", 0, &[]);
    let names = ["sweep.toml", "sweep/sweep.json"].map(str::to_owned);
    damaged("sweep", dir.path(), &names, &["matrix sweep.toml --list", "plan sweep", "plan sweep --next"]);
}

/// A contest of policies, and the project file.
#[test]
fn fuzzed_contests_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    verb(dir.path(), "rank scripted random --task pendulum --rounds 1 --out rank", 0, &[]);
    fs::write(dir.path().join("robogate.toml"), "threads = 1\n").unwrap();
    let names = ["rank/question.json", "rank/ranking.json", "robogate.toml"].map(str::to_owned);
    damaged(
        "contest",
        dir.path(),
        &names,
        &["runs .", "config", "rank scripted random --task pendulum --rounds 1 --out rank"],
    );
}
