//! Checks that plan, suite, robot, environment and policy in the folder are those of the rows.

use std::fs;
use std::path::Path;

use robogate_core::Suite;
use robogate_core::budget::Budget;
use robogate_dictionary::{Place, Provenance, read_regular_text, robot_sha256};

use super::{FileRecord, Problem, Role, policy};

/// The fields of `plan.json` that are used here. The campaign crate owns the format.
#[derive(serde::Deserialize)]
struct Settings {
    plan: serde_json::Value,
    provenance: Provenance,
}

/// Contradictions between the files and the recorded provenance.
///
/// Imported rows record no robot and no suite. Files with these roles are then not verified.
pub(super) fn problems(folder: &Path, files: &[FileRecord], provenance: &Provenance) -> Vec<Problem> {
    let of = |role: Role| files.iter().filter(move |file| file.role == role);
    let mut problems = Vec::new();
    for (role, check) in [(Role::Plan, plan as fn(&str, &Provenance) -> Result<(), String>), (Role::Suite, suite as _)]
    {
        for file in of(role) {
            let text = read_regular_text(&folder.join(&file.path)).map_err(|e| format!("cannot be read: {e}"));
            if let Err(reason) = text.and_then(|text| check(&text, provenance)) {
                problems.push(Problem::new(file.path.as_str(), reason));
            }
        }
    }
    problems.extend(policy::problems(files, provenance));
    problems.extend(of(Role::Environment).filter_map(|file| environment(file, provenance)));
    if let Some(recorded) = &provenance.robot.sha256 {
        problems.extend(robot(folder, of(Role::Robot), recorded));
    }
    problems
}

fn plan(text: &str, provenance: &Provenance) -> Result<(), String> {
    let settings: Settings = Budget::FILE.json(text.as_bytes()).map_err(|e| format!("not a plan of a run: {e}"))?;
    if settings.plan != provenance.plan {
        return Err("not the plan of the rows: `plan` differs".to_owned());
    }
    if settings.provenance != *provenance {
        return Err("not the plan of the rows: `provenance` differs".to_owned());
    }
    Ok(())
}

fn suite(text: &str, provenance: &Provenance) -> Result<(), String> {
    if provenance.source.is_some() {
        return Ok(());
    }
    let Some(recorded) = provenance.plan.get("suite").and_then(|stage| stage.get("suite")) else {
        return Err("the run had no suite".to_owned());
    };
    let suite = Suite::from_toml(text).map_err(|e| format!("not a suite: {e}"))?;
    let recorded: Suite =
        serde_json::from_value(recorded.clone()).map_err(|e| format!("the suite in the run's plan is invalid: {e}"))?;
    if suite == recorded { Ok(()) } else { Err(format!("not the suite of the run, `{}`", recorded.name())) }
}

/// A file that the environment of the run did not import.
fn environment(file: &FileRecord, provenance: &Provenance) -> Option<Problem> {
    let recorded = match provenance.world.as_ref().map(|world| &world.place) {
        Some(Place::Python(python)) => python.files.get(file.path.strip_prefix("environment/").unwrap_or(&file.path)),
        _ => None,
    };
    let reason = match recorded {
        None => "the environment of the run has no such file".to_owned(),
        Some(sha256) if *sha256 == file.sha256 => return None,
        Some(sha256) => format!("not the file of the run: its SHA-256 is {}, but the rows state {sha256}", file.sha256),
    };
    Some(Problem::new(file.path.as_str(), reason))
}

fn robot<'a>(folder: &Path, files: impl Iterator<Item = &'a FileRecord>, recorded: &str) -> Option<Problem> {
    let mut contents = Vec::new();
    for file in files {
        let bytes = match fs::read(folder.join(&file.path)) {
            Ok(bytes) => bytes,
            Err(error) => return Some(Problem::new(file.path.as_str(), format!("cannot be read: {error}"))),
        };
        contents.push((file.path.strip_prefix("robot/").unwrap_or(&file.path).to_owned(), bytes));
    }
    if contents.is_empty() {
        return None;
    }
    let found = robot_sha256(contents.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())));
    let reason = format!("these are not the files of the run: their SHA-256 is {found}, but the rows state {recorded}");
    (found != recorded).then(|| Problem::new("robot", reason))
}
