//! The two in-toto statements.

use serde::Serialize;
use serde_json::{Value, json};

use super::{EVALUATION, FileRecord, MANIFEST, Manifest, Role};
use crate::{Comparison, Evaluation, Status, Verdict};

/// The statement's type (in-toto attestation framework, version 1).
pub const STATEMENT_TYPE: &str = "https://in-toto.io/Statement/v1";
/// The predicate type that other tools read.
pub const TEST_RESULT_PREDICATE: &str = "https://in-toto.io/attestation/test-result/v0.1";
/// The predicate type of RoboGate: the whole manifest.
pub const EVIDENCE_PREDICATE: &str = "urn:robogate:evidence:v1";
/// The payload type of an envelope around a statement.
pub const PAYLOAD_TYPE: &str = "application/vnd.in-toto+json";

/// A statement with its fields in the order of the specification.
#[derive(Debug, Serialize)]
struct Statement<'a> {
    #[serde(rename = "_type")]
    type_uri: &'static str,
    subject: Vec<Value>,
    #[serde(rename = "predicateType")]
    predicate_type: &'static str,
    predicate: &'a Value,
}

/// The bytes of the test-result statement.
///
/// The predicate has the results PASSED, WARNED and FAILED. Only a pass is PASSED. An undecided gate has shown nothing,
/// so a tool that looks for failures must find one.
pub(super) fn test_result(manifest: &Manifest, manifest_sha256: &str, evaluation: &Evaluation) -> String {
    let ids = |met: bool| -> Vec<&str> {
        let results = evaluation.results.iter().map(|result| (result.id.as_str(), result.status));
        let all = results.chain(evaluation.comparison.as_ref().map(|comparison| (Comparison::ID, comparison.status)));
        all.filter(|(_, status)| (*status == Status::Met) == met).map(|(id, _)| id).collect()
    };
    let configuration: Vec<Value> = manifest
        .files
        .iter()
        .filter(|file| {
            matches!(
                file.role,
                Role::Requirements
                    | Role::Baseline
                    | Role::Real
                    | Role::Plan
                    | Role::Question
                    | Role::Suite
                    | Role::Robot
                    | Role::Environment
                    | Role::Repeats
            )
        })
        .map(|file| descriptor(&file.path, &file.sha256))
        .collect();
    let predicate = json!({
        "result": if manifest.verdict == Verdict::Pass { "PASSED" } else { "FAILED" },
        "configuration": configuration,
        "passedTests": ids(true),
        "warnedTests": [],
        "failedTests": ids(false),
    });
    statement(manifest, manifest_sha256, TEST_RESULT_PREDICATE, &predicate)
}

/// The bytes of RoboGate's own statement.
pub(super) fn evidence(manifest: &Manifest, manifest_sha256: &str) -> String {
    // Every number is finite, so serialisation cannot fail.
    let predicate = serde_json::to_value(manifest).unwrap_or_default();
    statement(manifest, manifest_sha256, EVIDENCE_PREDICATE, &predicate)
}

fn statement(manifest: &Manifest, manifest_sha256: &str, predicate_type: &'static str, predicate: &Value) -> String {
    // The subject is the policy's own file if the run recorded its digest, otherwise its episodes and results.
    let judged = |file: &FileRecord| match file.role {
        Role::Policy => manifest.policy_binding.sha256() == Some(&file.sha256),
        Role::Dictionary => true,
        _ => file.path == EVALUATION,
    };
    let subject = std::iter::once(descriptor(MANIFEST, manifest_sha256))
        .chain(manifest.files.iter().filter(|file| judged(file)).map(|file| descriptor(&file.path, &file.sha256)))
        .collect();
    let statement = Statement { type_uri: STATEMENT_TYPE, subject, predicate_type, predicate };
    serde_json::to_string(&statement).unwrap_or_default()
}

/// The SHA-256 that a statement states for the manifest, if it has the manifest as a subject.
pub(super) fn manifest_sha256(statement: &str) -> Option<String> {
    let statement: Value = serde_json::from_str(statement).ok()?;
    let subject = statement.get("subject")?.as_array()?;
    let manifest = subject.iter().find(|subject| subject.get("name").is_some_and(|name| name == MANIFEST))?;
    Some(manifest.get("digest")?.get("sha256")?.as_str()?.to_owned())
}

/// A ResourceDescriptor with a name and a digest.
fn descriptor(name: &str, sha256: &str) -> Value {
    json!({ "name": name, "digest": { "sha256": sha256 } })
}
