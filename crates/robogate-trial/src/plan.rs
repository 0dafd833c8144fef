//! The plan of a study: question, population, rules. It is public and does not change after the first trial.

use std::collections::BTreeSet;
use std::path::Path;

use robogate_core::{ParameterSpace, Word};
use robogate_dictionary::hex;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::study::LONGEST_NAME;
use crate::{Problem, Setup};

/// Version of the format of a plan.
pub const FORMAT: u32 = 1;
/// Most policies of a study.
pub const MOST_ARMS: usize = 12;
/// Most blocks of a study.
pub const MOST_BLOCKS: u64 = 500;
/// Most set-ups of a list.
const MOST_SETUPS: usize = 100_000;

/// The plan of a study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Version of the format.
    pub format: u32,
    /// What is asked.
    pub question: Question,
    /// The policies.
    pub arms: Vec<Arm>,
    /// The set-ups that the answer is about.
    pub population: Population,
    /// Name of the task.
    pub task: String,
    /// Name of the robot.
    pub robot: String,
    /// Failure modes, one button each.
    pub modes: Vec<Word>,
    /// Stages of the task in order. A failure names the last one that was reached.
    #[serde(default)]
    pub stages: Vec<Word>,
    /// Name of a number that the operator measures, with its unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measure: Option<Word>,
    /// Operators. Empty: any name.
    #[serde(default)]
    pub operators: Vec<String>,
    /// Largest number of blocks. A block is one set-up with one trial of each policy.
    pub blocks: u64,
    /// Probability of a wrong claim over all looks.
    pub error: f64,
    /// Time that the trials need, as far as it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<Time>,
    /// Expected numbers of trials.
    pub expected: Vec<Expected>,
    /// The rules in words: test, stopping, exclusions, blinding.
    pub rules: Vec<String>,
    /// SHA-256 (hex) of the secret that the order and the codes follow from.
    pub secret_sha256: String,
}

/// What a study asks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Question {
    /// Whether the success rate of one policy is at least a limit.
    AtLeast(f64),
    /// Which of two policies succeeds more often.
    Better,
    /// Which of several policies succeeds most often.
    Best,
}

/// One policy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Its name.
    pub name: String,
    /// SHA-256 (hex) of its files, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// The set-ups that the answer is about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Population {
    /// Each block draws a point of a space.
    Space(ParameterSpace),
    /// Each block draws one of these set-ups, each with the same chance and independently of the others.
    List(Vec<Setup>),
    /// As a list, of set-ups that are only numbered.
    Count(u64),
}

/// The times of a trial, in minutes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Changing the set-up.
    pub change_min: f64,
    /// One trial with its reset.
    pub trial_min: f64,
    /// One session.
    pub session_min: f64,
}

/// The expected number of trials at given true success rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expected {
    /// The true rate of each policy.
    pub rates: Vec<f64>,
    /// Mean number of trials.
    pub trials: f64,
    /// Probability of each answer, by its name.
    pub answers: Vec<(String, f64)>,
}

impl Population {
    /// Reads a list of set-ups: a CSV file whose columns are properties.
    ///
    /// # Errors
    /// If the file cannot be read, has no rows, or a column without a name.
    pub fn from_csv(path: &Path) -> Result<Self, Problem> {
        let wrong = |reason: String| Problem::File { path: path.to_owned(), reason };
        let text = robogate_dictionary::read_text(path).map_err(|error| wrong(error.to_string()))?;
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
        if let Some(at) = header.iter().position(str::is_empty) {
            return Err(wrong(format!("column {} has no name", at + 1)));
        }
        let mut setups = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| wrong(error.to_string()))?;
            setups.push(header.iter().zip(&record).map(|(a, b)| (a.to_owned(), b.to_owned())).collect());
            if setups.len() > MOST_SETUPS {
                return Err(wrong(format!("more than {MOST_SETUPS} set-ups")));
            }
        }
        if setups.is_empty() {
            return Err(wrong("no set-ups. Expected one row for each".to_owned()));
        }
        Ok(Self::List(setups))
    }

    /// The population in one sentence.
    pub fn describe(&self) -> String {
        match self {
            Self::Space(space) => format!("points of the space {}, drawn at random", space.name()),
            Self::List(setups) => format!("a list of {} set-ups, drawn at random with equal chances", setups.len()),
            Self::Count(n) => format!("{n} numbered set-ups, drawn at random with equal chances"),
        }
    }

    /// The names of its properties.
    pub fn columns(&self) -> Vec<String> {
        match self {
            Self::Space(space) => space.parameters().iter().map(|p| p.name.to_string()).collect(),
            Self::List(setups) => setups.first().into_iter().flatten().map(|(name, _)| name.clone()).collect(),
            Self::Count(_) => vec!["setup".to_owned()],
        }
    }
}

impl Plan {
    /// Parses a plan.
    ///
    /// # Errors
    /// If it is not a valid plan.
    pub fn from_json(path: &Path, text: &str) -> Result<Self, Problem> {
        let wrong = |reason: String| Problem::File { path: path.to_owned(), reason };
        let plan: Self =
            robogate_core::budget::Budget::FILE.json(text.as_bytes()).map_err(|error| wrong(error.to_string()))?;
        plan.check().map_err(|problem| wrong(problem.to_string()))?;
        Ok(plan)
    }

    /// Serialises the plan. Equal plans give equal bytes.
    pub fn to_json(&self) -> String {
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// SHA-256 (hex) of the file of the plan.
    pub fn sha256(&self) -> String {
        hex(&Sha256::digest(self.to_json().as_bytes()))
    }

    /// Largest number of trials.
    pub fn most_trials(&self) -> u64 {
        self.blocks * self.arms.len() as u64
    }

    /// Checks what a type cannot express.
    ///
    /// # Errors
    /// The first contradiction.
    pub fn check(&self) -> Result<(), Problem> {
        let wrong = |reason: String| Err(Problem::Plan(reason));
        let arms = self.arms.len();
        if self.format != FORMAT {
            return wrong(format!("unsupported format {}. Expected {FORMAT}", self.format));
        }
        let fits = match self.question {
            Question::AtLeast(limit) => {
                if !(limit > 0.0 && limit < 1.0) {
                    return wrong(format!("the limit {limit} is out of range. Expected a rate in (0, 1)"));
                }
                arms == 1
            }
            Question::Better => arms == 2,
            Question::Best => (3..=MOST_ARMS).contains(&arms),
        };
        if !fits {
            let (question, expected) = match self.question {
                Question::AtLeast(_) => ("whether a rate is at least a limit", "one".to_owned()),
                Question::Better => ("which of two is better", "two".to_owned()),
                Question::Best => ("which is the best", format!("3 to {MOST_ARMS}")),
            };
            return wrong(format!("{arms} policies, but the question is {question}. Expected {expected}"));
        }
        let names: BTreeSet<&str> = self.arms.iter().map(|arm| arm.name.as_str()).collect();
        if names.len() != arms || names.contains("") {
            return wrong("each policy needs a name of its own".to_owned());
        }
        let mut operators = BTreeSet::new();
        for name in &self.operators {
            if name.is_empty() || name.trim() != name || name.len() > LONGEST_NAME {
                return wrong(format!(
                    "`{name}` cannot name an operator. Expected 1 to {LONGEST_NAME} bytes, no space at either end"
                ));
            }
            if !operators.insert(name) {
                return wrong(format!("`{name}` occurs twice among the operators"));
            }
        }
        if !(1..=MOST_BLOCKS).contains(&self.blocks) {
            return wrong(format!("{} blocks are out of range. Expected 1 to {MOST_BLOCKS}", self.blocks));
        }
        if !(self.error > 0.0 && self.error < 0.5) {
            return wrong(format!("the error {} is out of range. Expected a probability in (0, 0.5)", self.error));
        }
        let empty = match &self.population {
            Population::Space(_) => false,
            Population::List(setups) => setups.is_empty(),
            Population::Count(n) => *n == 0,
        };
        if empty {
            return wrong("the population is empty".to_owned());
        }
        let mut columns = self.population.columns();
        columns.extend(self.measure.map(|measure| measure.as_str().to_owned()));
        let mut known: BTreeSet<&str> = crate::table::COLUMNS.into_iter().collect();
        if let Some(name) = columns.iter().find(|name| !known.insert(name)) {
            return wrong(format!(
                "`{name}` names two columns of the results\nHint: rename the property of the set-ups"
            ));
        }
        let mut buttons: Vec<Word> = self.modes.iter().chain(&self.stages).copied().collect();
        buttons.sort_unstable();
        if let Some(twice) = buttons.windows(2).find(|pair| pair[0] == pair[1]) {
            return wrong(format!("`{}` occurs twice among the failure modes and stages", twice[0].as_str()));
        }
        if self.modes.is_empty() {
            return wrong("no failure modes. Expected at least one, such as `failed`".to_owned());
        }
        if self.modes.iter().any(|mode| mode.as_str() == crate::SUCCESS) {
            return wrong(format!("`{}` cannot be a failure mode", crate::SUCCESS));
        }
        Ok(())
    }
}
