//! What is demanded, as a file.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

use robogate_core::{Severity, TaskSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{GateError, Metric, Record, Requirement, ScoreTerm, Scoring, score};

/// The most rounds that a budget may have: what is more is a slip of the finger.
const MOST_ROUNDS: u32 = 10_000;

/// What is demanded of a policy, and how sure the gate must be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Requirements {
    /// Its name.
    pub name: String,
    /// The task that it is for; where it is left out, any task that has its failure modes and measures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// How a metric is compared with its limit.
    pub mode: Mode,
    /// In confidence mode: how sure a pass and a fail must each be. 0.95 means that each is wrong at most once in twenty.
    #[serde(default = "default_confidence")]
    pub confidence: f64,
    /// In confidence mode: what "all requirements at this confidence" means.
    #[serde(default)]
    pub family: Family,
    /// How much a gate that runs episodes itself may spend.
    #[serde(default)]
    pub budget: Budget,
    /// The demands.
    #[serde(default)]
    pub requirement: Vec<Requirement>,
    /// The terms of the confidence score; none, no score.
    #[serde(default)]
    pub score: Vec<ScoreTerm>,
}

/// How a metric is held against its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The observed figure is compared with the limit, however few episodes it comes from (the paper's gate).
    Point,
    /// The demand must be shown to hold at the stated confidence.
    Confidence,
}

/// What a confidence over several requirements means.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// A pass is the claim that all are met: an intersection-union test, in which each is shown at the full level and
    /// the claim as a whole holds at it (Berger 1982). A fail is the claim that some are violated: a union of tests,
    /// which shares its error among them by Holm's procedure.
    #[default]
    IntersectionUnion,
    /// As above, and each "met" may be read alone as well: these are adjusted by Holm's procedure too.
    Holm,
}

/// How much a gate that runs episodes itself may spend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// At most this many rounds of the suite, each with fresh seeds.
    pub rounds: u32,
}

impl Default for Budget {
    fn default() -> Self {
        Self { rounds: 20 }
    }
}

fn default_confidence() -> f64 {
    0.95
}

/// The set that is used where none is named.
const DEFAULT: &str = "default";

/// The sets that come with RoboGate: name and TOML.
const BUILT_IN: [(&str, &str); 2] = [
    (DEFAULT, include_str!("../../../assets/gates/default.toml")),
    ("paper", include_str!("../../../assets/gates/paper.toml")),
];

impl Requirements {
    /// The names of the sets that come with RoboGate.
    pub const NAMES: [&'static str; 2] = [BUILT_IN[0].0, BUILT_IN[1].0];

    /// A set that comes with RoboGate, or a TOML file, for `task`. The set `default` of a task that brings none requires a
    /// success rate of 92 %, and at most 1 % of each critical failure mode.
    ///
    /// # Errors
    /// What is wrong with the file, and where.
    pub fn open(name_or_path: &str, task: &TaskSpec) -> Result<Self, GateError> {
        if let Some((_, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            let set = Self::from_toml(text)?;
            let fits = set.task.as_deref().is_none_or(|name| task.name == name);
            return if fits || name_or_path != DEFAULT { Ok(set) } else { Ok(Self::derived(task)) };
        }
        let path = Path::new(name_or_path);
        let text =
            std::fs::read_to_string(path).map_err(|source| GateError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text).map_err(|error| GateError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// What is required where nothing else is said.
    fn derived(task: &TaskSpec) -> Self {
        let requirement = |metric, at_least, at_most| Requirement {
            metric,
            at_least,
            at_most,
            at_most_times_baseline: None,
            category: None,
            group: None,
            each: None,
            ceiling: None,
            floor: None,
        };
        let critical = task.failure_modes.iter().filter(|mode| mode.severity == Severity::Critical);
        let failures = critical.map(|mode| requirement(Metric::Failure(mode.name), None, Some(0.01)));
        Self {
            name: DEFAULT.to_owned(),
            task: Some(task.name.as_str().to_owned()),
            mode: Mode::Confidence,
            confidence: default_confidence(),
            family: Family::default(),
            budget: Budget::default(),
            requirement: std::iter::once(requirement(Metric::Success, Some(0.92), None)).chain(failures).collect(),
            score: vec![ScoreTerm {
                name: "Success".to_owned(),
                metric: Metric::Success,
                category: None,
                weight: 1.0,
                scoring: Scoring::Linear { full_at: 1.0 },
            }],
        }
    }

    /// The record as these requirements may be asked of it.
    ///
    /// An import declares the failure modes that were found in it: of any other, it is not known whether it was recorded.
    ///
    /// # Errors
    /// Requirements for another task, or with a failure mode or measure that the task does not have.
    pub(crate) fn fit<'a>(&self, record: &'a Record) -> Result<Cow<'a, Record>, GateError> {
        let task = &record.task;
        let wrong = |reason: String| GateError::NotOfTask { requirements: self.name.clone(), reason };
        if let Some(name) = self.task.as_deref().filter(|name| task.name != *name && !record.imported) {
            let hint = "hint: use --requirements default, or a file of your own";
            return Err(wrong(format!("they are for the task {name}; these episodes are of {}\n{hint}", task.name)));
        }
        let metrics = self.requirement.iter().map(|r| r.metric).chain(self.score.iter().map(|term| term.metric));
        let mut unseen = Vec::new();
        for metric in metrics {
            match (metric.check(task), metric) {
                (Ok(()), _) => {}
                (Err(_), Metric::Failure(mode) | Metric::FailureCount(mode)) if record.imported => unseen.push(mode),
                (Err(reason), _) => return Err(wrong(reason)),
            }
        }
        Ok(if unseen.is_empty() { Cow::Borrowed(record) } else { Cow::Owned(record.without(&unseen)) })
    }

    /// Reads TOML.
    ///
    /// # Errors
    /// What is wrong and where: an unknown key, a demand without a limit, one that can't be met at any number of
    /// episodes.
    pub fn from_toml(text: &str) -> Result<Self, GateError> {
        let requirements: Self = toml::from_str(text).map_err(|error| GateError::Syntax(error.to_string()))?;
        requirements.check()?;
        Ok(requirements)
    }

    /// As a file holds it: the same requirements give the same bytes.
    pub fn to_toml(&self) -> String {
        // A table of strings, finite numbers and tables cannot fail to serialise.
        toml::to_string(self).unwrap_or_default()
    }

    /// Refuses what is wrong whatever the evidence.
    ///
    /// # Errors
    /// As [`Self::from_toml`].
    pub fn check(&self) -> Result<(), GateError> {
        if self.requirement.is_empty() {
            return Err(GateError::NoRequirements);
        }
        // Below this, binomial tests of unlike scenarios lose their ground (see `Question`).
        if !(0.75..1.0).contains(&self.confidence) {
            return Err(GateError::Confidence { confidence: self.confidence });
        }
        if !(1..=MOST_ROUNDS).contains(&self.budget.rounds) {
            return Err(GateError::Budget { rounds: self.budget.rounds, most: MOST_ROUNDS });
        }
        let mut seen = BTreeSet::new();
        for requirement in &self.requirement {
            requirement.check(self.mode)?;
            if requirement.at_most_times_baseline.is_none() {
                requirement.bound(self.mode, None)?;
            }
            if !seen.insert((requirement.id(), requirement.at_least.is_some())) {
                return Err(GateError::Twice { id: requirement.id() });
            }
        }
        score::check(&self.score)
    }

    /// The probability with which a pass, and with which a fail, may be wrong.
    pub fn alpha(&self) -> f64 {
        // 1 - 0.95 is not 0.05 in floating point; twelve decimals are more than anybody writes.
        ((1.0 - self.confidence) * 1e12).round() / 1e12
    }

    /// Whether a demand or a term refers to a baseline.
    pub fn needs_baseline(&self) -> bool {
        self.requirement.iter().any(|r| r.at_most_times_baseline.is_some())
    }
}
