//! Whether plan, suite and robot beside the rows are those that the rows come from.

use std::fs;
use std::path::Path;

use robogate_core::Suite;
use robogate_dictionary::{Provenance, robot_sha256};

use super::{FileRecord, Problem, Role};

/// What `plan.json` has of use here; the campaign owns its form.
#[derive(serde::Deserialize)]
struct Settings {
    plan: serde_json::Value,
    provenance: Provenance,
}

/// What contradicts the provenance that stands beside the rows.
///
/// Rows that were imported say nothing of robot and suite: files of them are then their sender's word.
pub(super) fn problems(folder: &Path, files: &[FileRecord], provenance: &Provenance) -> Vec<Problem> {
    let of = |role: Role| files.iter().filter(move |file| file.role == role);
    let mut problems = Vec::new();
    for (role, check) in [(Role::Plan, plan as fn(&str, &Provenance) -> Result<(), String>), (Role::Suite, suite as _)]
    {
        for file in of(role) {
            let text = fs::read_to_string(folder.join(&file.path)).map_err(|e| format!("it cannot be read: {e}"));
            if let Err(reason) = text.and_then(|text| check(&text, provenance)) {
                problems.push(Problem::new(file.path.as_str(), reason));
            }
        }
    }
    if let Some(recorded) = &provenance.robot.sha256 {
        problems.extend(robot(folder, of(Role::Robot), recorded));
    }
    problems
}

fn plan(text: &str, provenance: &Provenance) -> Result<(), String> {
    let settings: Settings = serde_json::from_str(text).map_err(|e| format!("it is no plan of a run: {e}"))?;
    if settings.plan != provenance.plan {
        return Err("it is not the plan that the rows were measured by: its `plan` is another".to_owned());
    }
    if settings.provenance != *provenance {
        return Err("it is not the plan that the rows were measured by: its `provenance` is another".to_owned());
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
    let suite = Suite::from_toml(text).map_err(|e| format!("it is no suite: {e}"))?;
    let recorded: Suite =
        serde_json::from_value(recorded.clone()).map_err(|e| format!("the suite in the run's plan is none: {e}"))?;
    if suite == recorded { Ok(()) } else { Err(format!("it is not the suite that was run, `{}`", recorded.name())) }
}

fn robot<'a>(folder: &Path, files: impl Iterator<Item = &'a FileRecord>, recorded: &str) -> Option<Problem> {
    let mut contents = Vec::new();
    for file in files {
        let bytes = match fs::read(folder.join(&file.path)) {
            Ok(bytes) => bytes,
            Err(error) => return Some(Problem::new(file.path.as_str(), format!("it cannot be read: {error}"))),
        };
        contents.push((file.path.strip_prefix("robot/").unwrap_or(&file.path).to_owned(), bytes));
    }
    if contents.is_empty() {
        return None;
    }
    let found = robot_sha256(contents.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())));
    let reason = format!("its files are not those of the run: their SHA-256 is {found}, the rows say {recorded}");
    (found != recorded).then(|| Problem::new("robot", reason))
}
