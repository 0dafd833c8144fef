//! The results of a study as a CSV file that `transfer`, `import` and `compare` read.

use std::path::Path;

use robogate_core::Word;
use robogate_dictionary::{hex, spreadsheet_cell};
use robogate_stats::format::date;
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::{Answer, JOURNAL, Problem, SUCCESS, Study};

/// Columns beside the properties of the set-ups and the measure. None of these can have one of the names.
pub(crate) const COLUMNS: [&str; 11] =
    [SUCCESS, "failure_mode", "cycle_time_s", "policy", "case", "operator", "day", "index", "id", "stage", "notes"];
/// The failure mode of a trial that was declared invalid after its end.
const INVALID_AFTER: &str = "invalid_after_stop";

/// The trials with a result as CSV, of all policies or of one. Repeated trials are left out; a trial that was declared invalid after
/// its end is a failure.
pub fn csv_of(study: &Study, policy: Option<usize>) -> String {
    let columns = study.plan.population.columns();
    let mut header = COLUMNS.to_vec();
    header.extend(study.plan.measure.map(Word::as_str));
    header.extend(columns.iter().map(String::as_str));
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing to memory cannot fail.
    let _ = writer.write_record(&header);
    for (index, attempt) in study.attempts().iter().enumerate() {
        let (planned, Some(success)) = (study.planned(attempt), attempt.success()) else { continue };
        if policy.is_some_and(|arm| arm != planned.arm) {
            continue;
        }
        let result = attempt.result.clone().unwrap_or_default();
        let mode = match result.mode {
            Some(mode) => mode.as_str(),
            None if success => "",
            None => INVALID_AFTER,
        };
        let number = |number: Option<f64>| number.map_or_else(String::new, |number| number.to_string());
        let mut row = vec![
            success.to_string(),
            mode.to_owned(),
            number(attempt.duration_s),
            study.plan.arms[planned.arm].name.clone(),
            format!("block-{}", planned.block + 1),
            attempt.operator.clone(),
            date(attempt.start.unix_ms / 1000),
            index.to_string(),
            attempt.code.clone(),
            result.stage.map_or("", |stage| stage.as_str()).to_owned(),
            result.notes,
        ];
        row.extend(study.plan.measure.map(|_| number(result.measured)));
        row.extend(planned.setup.iter().map(|(_, value)| value.clone()));
        // Operators type names and set-ups are files of others: a spreadsheet must not compute them.
        let _ = writer.write_record(row.iter().map(|cell| match cell.parse::<f64>() {
            Ok(_) => cell.clone(),
            Err(_) => spreadsheet_cell(cell).into_owned(),
        }));
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

/// The mapping with which `robogate import` reads the CSV file: what the columns mean, and how the number of trials was chosen.
pub fn mapping(study: &Study) -> String {
    let quoted = |text: &str| serde_json::to_string(text).unwrap_or_default();
    let has_number = |attempt: &crate::Attempt| attempt.result.as_ref().is_some_and(|result| result.measured.is_some());
    let measure = study.plan.measure.filter(|_| study.attempts().iter().any(has_number));
    let measures = measure.map_or_else(String::new, |name| format!("[measures]\n{0} = {0:?}\n", name.as_str()));
    let task = Word::nearest(&study.plan.task).map_or("task", Word::as_str);
    format!(
        "ignore = [\"index\", \"id\", \"stage\", \"notes\"]\n{measures}[about]\ntask = {}\nrobot = {}\nsimulator = \"real\"\n\
         sampling = \"observed\"\nstopping = \"monitored\"\n",
        quoted(task),
        quoted(&study.plan.robot)
    )
}

/// Where the results come from, as a JSON document beside the CSV file.
///
/// # Errors
/// If the journal cannot be read.
pub fn provenance(folder: &Path, study: &Study, answer: &Answer, csv: &str) -> Result<String, Problem> {
    let path = folder.join(JOURNAL);
    let journal = std::fs::read(&path).map_err(|error| Problem::File { path, reason: error.to_string() })?;
    let document = json!({
        "version": 1,
        "task": study.plan.task,
        "robot": study.plan.robot,
        "question": study.plan.question,
        "policies": study.plan.arms,
        "population": study.plan.population.describe(),
        "stopping": "sequential: the number of trials depends on the results",
        "plan_sha256": study.plan.sha256(),
        "journal_sha256": hex(&Sha256::digest(&journal)),
        "trials_sha256": hex(&Sha256::digest(csv.as_bytes())),
        "answer": answer,
    });
    Ok(serde_json::to_string_pretty(&document).unwrap_or_default() + "\n")
}
