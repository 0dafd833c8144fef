//! Trials of the real robot, from a CSV file.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;

use robogate_core::{Domain, Parameter, ParameterSpace, Value};
use robogate_dictionary::results::{groups_rows, only_identifies};
use robogate_dictionary::{hex, read_text};
use robogate_stats::exact_strata::MOST_TRIALS;
use sha2::{Digest, Sha256};

use crate::AnalysisError;

/// The grouping of trials with equal settings.
const REPEATED: &str = "repeated setting";
/// Most columns of a file.
const MOST_COLUMNS: usize = 1_000;
/// Columns with the name of the policy.
const POLICY: [&str; 3] = ["policy", "policy_id", "policy_name"];
/// Cells without a value.
const MISSING: [&str; 5] = ["", "na", "nan", "null", "none"];

/// Trials of the real robot.
#[derive(Debug, Clone, PartialEq)]
pub struct RealTrials {
    /// SHA-256 (hex) of the file.
    pub sha256: String,
    /// The trials within the space.
    pub trials: Vec<RealTrial>,
    /// Lines of trials outside the space, which are left out.
    pub outside: Vec<u64>,
    /// Parameters in which these are outside.
    pub outside_in: BTreeSet<String>,
    /// Groupings of the trials: the name, and a group number for each trial. Each has at least two groups.
    pub groupings: Vec<(String, Vec<usize>)>,
    /// Columns that would group the trials, but have the same entry for all of them: the name and the entry.
    pub constant: Vec<(String, String)>,
    /// Whether all trials have the same setting.
    pub one_setting: bool,
    /// Parameters of the space without any value in the file.
    pub missing: Vec<String>,
    /// Trials with at least one missing value, beyond those of `missing`.
    pub incomplete: u64,
    /// Columns that are neither results nor parameters nor groups.
    pub ignored: Vec<String>,
    /// Whether the file has a column of failure modes.
    pub has_modes: bool,
    /// Whether the file names the policy of each trial.
    pub names_policy: bool,
}

/// One trial.
#[derive(Debug, Clone, PartialEq)]
pub struct RealTrial {
    /// Its line in the file.
    pub line: u64,
    /// Whether it succeeded.
    pub success: bool,
    /// Its failure mode, if it failed and the file states it.
    pub mode: Option<String>,
    /// The coded value of each parameter of the space. `None` if it is missing.
    pub values: Vec<Option<f64>>,
}

/// A problem in a file of trials.
fn wrong(path: &Path, line: u64, reason: impl Into<String>) -> AnalysisError {
    AnalysisError::Trials { path: path.to_owned(), line, reason: reason.into() }
}

/// The rows of a CSV file as text, with their lines.
struct Rows {
    sha256: String,
    header: Vec<String>,
    rows: Vec<(u64, Vec<String>)>,
}

fn read(path: &Path) -> Result<Rows, AnalysisError> {
    let file = read_text(path).map_err(|error| match error.kind() {
        ErrorKind::InvalidData | ErrorKind::FileTooLarge => wrong(path, 1, error.to_string()),
        _ => AnalysisError::io(path, "read")(error),
    })?;
    // Spreadsheets of some languages separate by semicolons and write decimal commas.
    let first = file.lines().next().unwrap_or_default();
    let separator = [b',', b';', b'\t'].into_iter().find(|separator| first.as_bytes().contains(separator));
    let separator = separator.unwrap_or(b',');
    let mut reader = csv::ReaderBuilder::new().delimiter(separator).trim(csv::Trim::All).from_reader(file.as_bytes());
    let cell = |cell: &str| match separator {
        b';' if cell.replacen(',', ".", 1).parse::<f64>().is_ok() => cell.replacen(',', ".", 1),
        _ => cell.to_owned(),
    };
    let text = |record: &csv::StringRecord| record.iter().map(cell).collect::<Vec<String>>();
    // After a line that ends with CR LF, the reader stands before the LF.
    let line_of = |position: Option<&csv::Position>| {
        position.map_or(0, |at| at.line() + u64::from(file.as_bytes().get(at.byte() as usize) == Some(&b'\n')))
    };
    let header = text(reader.headers().map_err(|error| wrong(path, 1, error.to_string()))?);
    if header.len() > MOST_COLUMNS {
        return Err(wrong(path, 1, format!("{} columns, at most {MOST_COLUMNS}", header.len())));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| wrong(path, line_of(error.position()), error.to_string()))?;
        rows.push((line_of(record.position()), text(&record)));
    }
    // Spreadsheets add columns without a name.
    let twice = |(i, name): &(usize, &String)| !name.is_empty() && header[..*i].contains(name);
    if let Some((_, name)) = header.iter().enumerate().find(twice) {
        return Err(wrong(path, 1, format!("the column `{name}` occurs twice")));
    }
    Ok(Rows { sha256: hex(&Sha256::digest(file.as_bytes())), header, rows })
}

/// The coded value of a cell. `None` if it is missing.
fn value(domain: &Domain, cell: &str) -> Result<Option<f64>, String> {
    // A level may have the name `none`.
    if let Some(level) = domain.encode(&Value::Category(cell.into())) {
        return Ok(Some(level));
    }
    if MISSING.contains(&cell.to_ascii_lowercase().as_str()) {
        return Ok(None);
    }
    let found = match domain {
        Domain::Categorical { choices } => {
            let known: Vec<&str> = choices.iter().map(|choice| &**choice).collect();
            return Err(format!("`{cell}` is not a level. Expected one of {}, or no value", known.join(", ")));
        }
        Domain::Continuous { .. } | Domain::Integer { .. } => {
            let number: f64 = cell.parse().map_err(|_| format!("`{cell}` is not a number"))?;
            if !number.is_finite() {
                return Err(format!("`{cell}` is not a finite number"));
            }
            if matches!(domain, Domain::Integer { .. }) && number.fract() != 0.0 {
                return Err(format!("`{cell}` is not an integer"));
            }
            number
        }
    };
    Ok(Some(found))
}

/// Whether a coded value lies in the domain, up to rounding.
fn inside(domain: &Domain, value: f64) -> bool {
    let within = |low: f64, high: f64| {
        let slack = 1e-9 * (high - low);
        (low - slack..=high + slack).contains(&value)
    };
    match domain {
        Domain::Continuous { low, high, .. } => within(*low, *high),
        Domain::Integer { low, high } => within(*low as f64, *high as f64),
        Domain::Categorical { .. } => true,
    }
}

/// Rejects trials of another policy, and of several. `at` is the column with the name of the policy.
fn check_policy(path: &Path, at: usize, rows: &[(u64, Vec<String>)], policy: &str) -> Result<(), AnalysisError> {
    if let Some((line, _)) = rows.iter().find(|row| MISSING.contains(&row.1[at].to_lowercase().as_str())) {
        return Err(wrong(
            path,
            *line,
            "a trial without the name of its policy\nHint: fill in the column `policy`, or remove it",
        ));
    }
    let mut rows = rows.iter();
    let Some((first, names)) = rows.next() else { return Ok(()) };
    let name = &names[at];
    if let Some((line, other)) = rows.find(|row| row.1[at] != *name) {
        let reason = format!(
            "a trial of the policy `{}`, and line {first} has one of `{name}`\nHint: give the trials of one policy; `robogate trial report` \
             writes a file for each",
            other[at]
        );
        return Err(wrong(path, *line, reason));
    }
    if name != policy {
        let reason = format!(
            "a trial of the policy `{name}`, and the simulation is of `{policy}`\nHint: if both are one policy, add --policy {name}"
        );
        return Err(wrong(path, *first, reason));
    }
    Ok(())
}

impl RealTrials {
    /// Reads trials. The columns are `success` (true or false, yes or no, 1 or 0), optionally `failure_mode`, the
    /// parameters of `space` by name, and groups. `groups` names the columns of trials that may share effects; without
    /// them those whose names say so are used, such as `operator`, `day` and `session`. Trials with equal parameters form
    /// groups too, if one of these is a continuous one: the others may be equal by chance.
    ///
    /// A column `policy` must have the name `policy` in each row: trials of another policy say nothing about this one.
    ///
    /// # Errors
    /// The first problem in the file, with its line.
    pub fn open(path: &Path, space: &ParameterSpace, groups: &[String], policy: &str) -> Result<Self, AnalysisError> {
        let Rows { sha256, header, rows } = read(path)?;
        let is_policy = |name: &String| POLICY.contains(&name.to_lowercase().as_str());
        let policy_at = header.iter().position(is_policy);
        policy_at.map_or(Ok(()), |at| check_policy(path, at, &rows, policy))?;
        let place = |name: &str| header.iter().position(|column| column == name);
        let Some(success) = place("success") else {
            let found = header.join(", ");
            return Err(wrong(path, 1, format!("no column `success`. The columns are {found}")));
        };
        let mode = place("failure_mode");
        let is_parameter = |name: &str| space.parameters().iter().any(|parameter| &*parameter.name == name);
        let names: Vec<String> = match groups {
            [] => header.iter().filter(|name| groups_rows(name) && !is_parameter(name)).cloned().collect(),
            given => given.iter().map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect(),
        };
        if let Some(unknown) = names.iter().find(|name| place(name).is_none()) {
            return Err(wrong(path, 1, format!("no column `{unknown}`, which should group the trials")));
        }
        if let Some((line, _)) = rows.get(MOST_TRIALS as usize) {
            return Err(wrong(path, *line, format!("{} trials, at most {MOST_TRIALS}", rows.len())));
        }
        let columns: Vec<Option<usize>> = space.parameters().iter().map(|p| place(&p.name)).collect();
        if columns.iter().all(Option::is_none) {
            let known: Vec<&str> = space.parameters().iter().map(|p| &*p.name).collect();
            return Err(wrong(path, 1, format!("no column is a parameter. Expected some of {}", known.join(", "))));
        }
        let used = |i: usize| {
            i == success
                || Some(i) == mode
                || columns.contains(&Some(i))
                || names.contains(&header[i])
                || is_policy(&header[i])
                || header[i].is_empty()
        };
        let ignored = (0..header.len()).filter(|i| !used(*i)).map(|i| header[i].clone()).collect();
        let (mut trials, mut outside, mut labels) = (Vec::new(), Vec::new(), vec![Vec::new(); names.len()]);
        let mut outside_in = BTreeSet::new();
        for (line, row) in &rows {
            let outcome = match row[success].to_ascii_lowercase().as_str() {
                "true" | "yes" | "1" | "success" => true,
                "false" | "no" | "0" | "failure" => false,
                other => {
                    let reason = format!("success: `{other}` is not an outcome. Expected true or false");
                    return Err(wrong(path, *line, reason));
                }
            };
            let mut values = Vec::with_capacity(columns.len());
            for (parameter, column) in space.parameters().iter().zip(&columns) {
                let found = column.map_or(Ok(None), |column| value(&parameter.domain, &row[column]));
                values.push(found.map_err(|reason| wrong(path, *line, format!("{}: {reason}", parameter.name)))?);
            }
            let fits = |(p, v): &(&Parameter, &Option<f64>)| v.is_none_or(|v| inside(&p.domain, v));
            let wrong: Vec<String> = space
                .parameters()
                .iter()
                .zip(&values)
                .filter(|pair| !fits(pair))
                .map(|(p, _)| p.name.to_string())
                .collect();
            if !wrong.is_empty() {
                outside_in.extend(wrong);
                outside.push(*line);
                continue;
            }
            for (label, name) in labels.iter_mut().zip(&names) {
                label.push(place(name).map_or_else(String::new, |at| row[at].clone()));
            }
            let mode = mode.map(|at| row[at].clone()).filter(|m| !outcome && !MISSING.contains(&&*m.to_lowercase()));
            trials.push(RealTrial { line: *line, success: outcome, mode, values });
        }
        let (mut groupings, mut constant) = (Vec::new(), Vec::new());
        for (name, labels) in names.into_iter().zip(labels) {
            match labels.first() {
                Some(first) if labels.iter().all(|label| label == first) => constant.push((name, first.clone())),
                // A column that numbers the trials groups none.
                _ if groups.is_empty() && labels.iter().collect::<BTreeSet<_>>().len() == labels.len() => {}
                _ => groupings.push((name, numbered(&labels))),
            }
        }
        let settings: Vec<String> = trials.iter().map(|trial| format!("{:?}", trial.values)).collect();
        let continuous = |trial: &RealTrial| {
            let mut known = space.parameters().iter().zip(&trial.values).filter(|(_, value)| value.is_some());
            known.any(|(parameter, _)| matches!(parameter.domain, Domain::Continuous { .. }))
        };
        let repeated = numbered(&settings);
        let count = repeated.iter().max().map_or(0, |most| most + 1);
        let are_repeats = count < trials.len() && trials.iter().all(continuous);
        let one_setting = are_repeats && count == 1;
        if are_repeats && !one_setting {
            groupings.push((REPEATED.to_owned(), repeated));
        }
        let absent = |i: usize| trials.iter().all(|trial| trial.values[i].is_none());
        let lost: Vec<bool> = (0..space.len()).map(absent).collect();
        // A trial cannot have the seed or the number of a simulated episode.
        let setting = |i: &usize| !only_identifies(&space.parameters()[*i].name);
        let incomplete =
            |trial: &&RealTrial| (0..space.len()).filter(setting).any(|i| trial.values[i].is_none() && !lost[i]);
        Ok(Self {
            sha256,
            incomplete: trials.iter().filter(incomplete).count() as u64,
            missing: (0..space.len())
                .filter(|i| lost[*i] && setting(i))
                .map(|i| space.parameters()[i].name.to_string())
                .collect(),
            trials,
            outside,
            outside_in,
            groupings,
            constant,
            one_setting,
            ignored,
            has_modes: mode.is_some(),
            names_policy: policy_at.is_some(),
        })
    }

    /// The first trial of each setting.
    pub(super) fn once(&self) -> Vec<&RealTrial> {
        if self.one_setting {
            return self.trials.iter().take(1).collect();
        }
        let Some((_, groups)) = self.groupings.iter().find(|(name, _)| name == REPEATED) else {
            return self.trials.iter().collect();
        };
        let mut seen = BTreeSet::new();
        self.trials.iter().zip(groups).filter(|(_, group)| seen.insert(**group)).map(|(trial, _)| trial).collect()
    }

    /// The number of failed trials that name no failure mode.
    pub(super) fn without_mode(&self) -> u64 {
        self.trials.iter().filter(|trial| !trial.success && trial.mode.is_none()).count() as u64
    }

    /// Whether each failed trial names its mode.
    pub(super) fn names_modes(&self) -> bool {
        self.has_modes && self.without_mode() == 0
    }

    /// The outcomes.
    pub fn outcomes(&self) -> Vec<bool> {
        self.trials.iter().map(|trial| trial.success).collect()
    }

    /// The group numbers of all groupings.
    pub fn groups(&self) -> Vec<Vec<usize>> {
        self.groupings.iter().map(|(_, groups)| groups.clone()).collect()
    }
}

/// Numbers labels in order of appearance.
fn numbered(labels: &[String]) -> Vec<usize> {
    let mut known = BTreeMap::new();
    labels
        .iter()
        .map(|label| {
            let next = known.len();
            *known.entry(label).or_insert(next)
        })
        .collect()
}

/// Settings that the real robot meets, from a CSV file with a column for every parameter. Values outside the space are
/// an error.
pub(super) fn settings(path: &Path, space: &ParameterSpace) -> Result<Vec<Vec<f64>>, AnalysisError> {
    let Rows { header, rows, .. } = read(path)?;
    let mut points = Vec::with_capacity(rows.len());
    for (line, row) in &rows {
        let mut point = Vec::with_capacity(space.len());
        for parameter in space.parameters() {
            let Some(column) = header.iter().position(|name| *name == *parameter.name) else {
                return Err(wrong(path, 1, format!("no column `{}`", parameter.name)));
            };
            let at = |reason: String| wrong(path, *line, format!("{}: {reason}", parameter.name));
            let found = value(&parameter.domain, &row[column]).map_err(at)?;
            match found.filter(|v| inside(&parameter.domain, *v)) {
                Some(value) => point.push(value),
                None => return Err(at(format!("`{}` is missing or outside the simulated range", row[column]))),
            }
        }
        points.push(point);
    }
    if points.is_empty() {
        return Err(wrong(path, 1, "the file has no settings"));
    }
    Ok(points)
}
