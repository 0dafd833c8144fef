//! The folder of a gate that the library ran is the same as that of `robogate gate`.

use std::sync::atomic::AtomicBool;

use robogate_campaign::folder::DICTIONARY;
use robogate_dictionary::Dictionary;
use robogate_gate::Asked;
use robogate_session::{EnvironmentChoice, GateRequest, PolicyChoice, Subject, Workers};
use tempfile::TempDir;

use crate::harness::verb;

#[test]
fn gates_of_the_library_have_their_question() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("gate");
    let environment = EnvironmentChoice { task: "pendulum".to_owned(), ..EnvironmentChoice::default() };
    let random = PolicyChoice { policy: Some("random".to_owned()), ..PolicyChoice::default() };
    let subject = Subject::of(&environment, &PolicyChoice::default()).unwrap();
    let rival = Subject::of(&environment, &random).unwrap();
    let request = GateRequest { rounds: Some(2), fixed: true, ..GateRequest::of(subject.sampled_suite(8, 1).unwrap()) };
    let workers = Workers { threads: None, in_flight: None, stop: &AtomicBool::new(false) };
    let evaluation = request.decide(subject, Some(rival), &folder, workers, &mut |_| {}).unwrap();
    let asked = Asked::of(&folder).unwrap().unwrap();
    let dictionary = Dictionary::open(&folder.join(DICTIONARY)).unwrap();
    assert_eq!(dictionary.provenance().question_sha256, Some(asked.sha256()));
    let against = asked.against.unwrap();
    assert_eq!(Some(against.dataset_sha256), evaluation.comparison.map(|comparison| comparison.dataset_sha256));
    // The command judges the folder as its own.
    let code = i32::from(evaluation.verdict.exit_code());
    verb(dir.path(), "gate --run gate", code, &["random"]);
    verb(dir.path(), "evidence gate evidence", code, &[]);
    verb(dir.path(), "verify evidence", 0, &["verification passed"]);
}
