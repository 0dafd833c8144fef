//! Results that come after the gate: which of them are about this evidence.
//!
//! `admit`, `monitor reference`, `warn train`, `requalify` and `fleet` write them. Each names what it is about by a digest, or by the
//! conditions under which it holds.

use std::path::Path;

use robogate_dictionary::{Provenance, hex};
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::{FileRecord, Problem, Role, judged};

/// Files that are about another run, policy or cell.
pub(super) fn problems(
    folder: &Path,
    files: &[FileRecord],
    provenance: &Provenance,
    dataset_sha256: &str,
) -> Vec<Problem> {
    let reason = |file: &FileRecord, json: &Value| match file.role {
        Role::Admission => {
            // Without a running policy, only the files of its checkpoint were compared. The gate recorded both in files of this role.
            let place = if json["fingerprint_sha256"].is_null() && json["checkpoint_sha256"].is_string() {
                "/checkpoint_sha256"
            } else {
                "/fingerprint_sha256"
            };
            let found = json.pointer(place).and_then(Value::as_str);
            let mut judged =
                files.iter().filter(|file| file.role == Role::Fingerprint).map(|file| file.sha256.as_str());
            let expected = judged.clone().find(|sha256| found == Some(*sha256)).or_else(|| judged.next());
            other(
                json,
                place,
                expected.unwrap_or("that of a fingerprint, which the evidence does not have"),
                "`robogate admit --json`",
            )
            .or_else(|| lacks(json, "/admitted", Value::is_boolean, "`robogate admit --json`"))
        }
        Role::Monitor => other(json, "/dataset_sha256", dataset_sha256, "`robogate monitor reference`"),
        Role::Requalification => other(json, "/dataset_sha256", dataset_sha256, "`robogate requalify --json`")
            .or_else(|| lacks(json, "/answer", Value::is_string, "`robogate requalify --json`")),
        Role::Fleet => {
            let of = |unit: &Value| unit["dataset_sha256"] == dataset_sha256;
            let units = json["units"].as_array();
            let found = units.is_some_and(|units| units.iter().any(of));
            (!found).then(|| "not the result of a fleet with the unit of these rows".to_owned())
        }
        Role::Warning => warning(json, provenance),
        _ => None,
    };
    let after = [Role::Admission, Role::Monitor, Role::Requalification, Role::Fleet, Role::Warning];
    let of_file = |file: &FileRecord| match judged::json(folder, file) {
        Ok(json) => reason(file, &json).map(|reason| Problem::new(file.path.as_str(), reason)),
        Err(problem) => Some(problem),
    };
    files.iter().filter(|file| after.contains(&file.role)).filter_map(of_file).collect()
}

/// Why the text at `place` is not `expected`.
fn other(json: &Value, place: &str, expected: &str, writer: &str) -> Option<String> {
    match json.pointer(place).and_then(Value::as_str) {
        Some(found) if found == expected => None,
        Some(found) => Some(format!(
            "about something else: `{}` is {}. Expected {expected}",
            &place[1..],
            found.chars().take(64).collect::<String>().escape_debug()
        )),
        None => lacks(json, place, Value::is_string, writer),
    }
}

fn lacks(json: &Value, place: &str, is: fn(&Value) -> bool, writer: &str) -> Option<String> {
    let name = &place[1..];
    (!json.pointer(place).is_some_and(is)).then(|| format!("`{name}` is missing. Expected the output of {writer}"))
}

/// Why a detector does not warn about this policy.
fn warning(json: &Value, provenance: &Provenance) -> Option<String> {
    let promised = ["/calibration/successes", "/calibration/promised"];
    if let Some(why) = promised.iter().find_map(|place| lacks(json, place, Value::is_number, "`robogate warn train`")) {
        return Some(why);
    }
    conditions(provenance).into_iter().find_map(|(what, expected)| {
        let why = other(json, &format!("/conditions/{what}"), &expected, "`robogate warn train`");
        // The promise may be for other scenarios than those of the gate: the argument says so.
        why.filter(|_| what != "population")
    })
}

/// The conditions under which the promise of a detector holds: names and texts.
pub fn conditions(provenance: &Provenance) -> [(&'static str, String); 5] {
    let short = |sha256: Option<String>| {
        sha256.map_or_else(String::new, |digest| format!(" (sha256 {})", &digest[..digest.len().min(12)]))
    };
    let task = &provenance.task;
    let changed = task.changed_settings();
    let suite = provenance.plan.pointer("/suite/suite/name").and_then(Value::as_str);
    let space = serde_json::to_vec(&provenance.space).unwrap_or_default();
    let population = match suite {
        Some(suite) => format!("suite {suite}"),
        None => format!("space {} (sha256 {})", provenance.space.name(), &hex(&Sha256::digest(space))[..12]),
    };
    let version = provenance.engine.version.as_deref().unwrap_or_default();
    [
        ("task", format!("{} {}{}{changed}", task.name, task.version, if changed.is_empty() { "" } else { " with " })),
        ("engine", format!("{} {version}", provenance.engine.name).trim_end().to_owned()),
        ("robot", format!("{}{}", provenance.robot.name, short(provenance.robot.sha256.clone()))),
        ("policy", format!("{}{}", provenance.policy, short(provenance.policy_sha256()))),
        ("population", population),
    ]
}
