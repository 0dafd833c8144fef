//! The requirements as a file.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

use robogate_core::budget;
use robogate_core::{FailureMode, Severity, TaskSpec};
use robogate_dictionary::read_text;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::force_limits::{self, ForceLimit};
use crate::{ForceLimits, GateError, Metric, RealEvidence, Record, Requirement, ScoreTerm, Scoring, score};

/// Upper limit of the number of rounds. Larger values are probably typing errors.
const MOST_ROUNDS: u32 = 10_000;

/// The requirements of a policy, with the confidence level of the verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Requirements {
    /// Its name.
    pub name: String,
    /// The task that they apply to. Default: any task that has their failure modes and measures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// How a metric is compared with its limit.
    pub mode: Mode,
    /// In confidence mode: the confidence level of a pass and of a fail. At 0.95, each is wrong in at most 5 % of
    /// gates.
    #[serde(default = "default_confidence")]
    pub confidence: f64,
    /// In confidence mode: the meaning of the confidence level for several requirements.
    #[serde(default)]
    pub family: Family,
    /// The budget of a gate that runs episodes.
    #[serde(default)]
    pub budget: Budget,
    /// The requirements.
    #[serde(default)]
    pub requirement: Vec<Requirement>,
    /// Columns of imported episodes: those with equal values depend on each other. Default: columns whose names say so, such as
    /// `operator`, `day`, `session` and `robot`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<String>,
    /// The terms of the confidence score. Without terms there is no score.
    #[serde(default)]
    pub score: Vec<ScoreTerm>,
    /// Limits of contact forces, to which requirements on `force_limit:<name>` refer.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub force_limit: Vec<ForceLimit>,
}

/// How a metric is compared with its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The observed figure is compared with the limit, for any number of episodes (the paper's gate).
    Point,
    /// The requirement must be shown to hold at the confidence level.
    Confidence,
}

/// The meaning of the confidence level for several requirements.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// A pass claims that all requirements are met: an intersection-union test, in which each is shown at the full
    /// level (Berger 1982). A fail claims that at least one is violated: a union of tests, which divides its error by
    /// Holm's procedure.
    #[default]
    IntersectionUnion,
    /// As `joint`, and each "met" also holds on its own: these p-values are adjusted by Holm's procedure too.
    Holm,
}

/// The budget of a gate that runs episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// Maximum number of rounds of the suite. Each round has fresh seeds.
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

/// The built-in set that is used by default.
const DEFAULT: &str = "default";

/// The failure mode of contacts with too much force.
const STRUCK: FailureMode = FailureMode::constant("struck");

/// The built-in sets: name and TOML.
const BUILT_IN: [(&str, &str); 2] = [
    (DEFAULT, include_str!("../../../assets/gates/default.toml")),
    ("paper", include_str!("../../../assets/gates/paper.toml")),
];

impl Requirements {
    /// The names of the built-in sets.
    pub const NAMES: [&'static str; 2] = [BUILT_IN[0].0, BUILT_IN[1].0];

    /// Opens a built-in set or a TOML file, for `task`. For a task without its own set, `default` requires a success
    /// rate of at least 92 %, and at most 1 % of each critical failure mode.
    ///
    /// # Errors
    /// A problem in the file, with its location.
    pub fn open(name_or_path: &str, task: &TaskSpec) -> Result<Self, GateError> {
        if let Some((_, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            let mut set = Self::from_toml(text)?;
            let fits = set.task.as_deref().is_none_or(|name| task.name == name);
            if name_or_path == DEFAULT {
                // Without a limit of contact forces, as in the cell of the paper, no episode is `struck`.
                let lacks = |metric: Metric| metric == Metric::Failure(STRUCK) && metric.check(task).is_err();
                set.requirement.retain(|requirement| !lacks(requirement.metric));
            }
            return if fits || name_or_path != DEFAULT { Ok(set) } else { Ok(Self::derived(task)) };
        }
        let path = Path::new(name_or_path);
        let text = read_text(path).map_err(|source| GateError::Unreadable { path: path.to_owned(), source })?;
        Self::from_toml(&text).map_err(|error| GateError::InFile { path: path.to_owned(), error: Box::new(error) })
    }

    /// The default requirements of a task without its own set.
    fn derived(task: &TaskSpec) -> Self {
        let critical = task.failure_modes.iter().filter(|mode| mode.severity == Severity::Critical);
        let failures = critical.map(|mode| Requirement::on(Metric::Failure(mode.name), None, Some(0.01)));
        Self {
            name: DEFAULT.to_owned(),
            task: Some(task.name.as_str().to_owned()),
            mode: Mode::Confidence,
            confidence: default_confidence(),
            family: Family::default(),
            budget: Budget::default(),
            groups: Vec::new(),
            requirement: std::iter::once(Requirement::on(Metric::Success, Some(0.92), None)).chain(failures).collect(),
            score: vec![ScoreTerm {
                name: "Success".to_owned(),
                metric: Metric::Success,
                category: None,
                weight: 1.0,
                scoring: Scoring::Linear { full_at: 1.0 },
            }],
            force_limit: Vec::new(),
        }
    }

    /// The same requirements with these limits of contact forces in place of their own: in at most [`ForceLimit::at_most`] of the
    /// episodes, a contact may exceed a limit.
    ///
    /// # Errors
    /// If a limit is not valid.
    pub fn with_force_limits(mut self, limits: ForceLimits) -> Result<Self, GateError> {
        self.requirement.retain(|requirement| !matches!(requirement.metric, Metric::ForceLimit(_)));
        self.force_limit.clear();
        for limit in &limits.limit {
            self.requirement.push(Requirement::on(Metric::ForceLimit(limit.name), None, Some(limit.at_most)));
        }
        self.force_limit.extend(limits.limit);
        self.check().map(|()| self)
    }

    /// The metrics that the task does not have, each with the reason.
    fn unknown_metrics(&self, task: &TaskSpec) -> impl Iterator<Item = (Metric, String)> {
        let metrics = self.requirement.iter().map(|r| r.metric).chain(self.score.iter().map(|term| term.metric));
        metrics.filter_map(|metric| Some((metric, metric.check(task).err()?)))
    }

    /// Rejects requirements that episodes of this task cannot answer, before any of them runs.
    ///
    /// # Errors
    /// The first metric that the task does not have.
    pub fn check_task(&self, task: &TaskSpec) -> Result<(), GateError> {
        match self.unknown_metrics(task).next() {
            Some((_, reason)) => Err(GateError::NotOfTask { requirements: self.name.clone(), reason }),
            None => Ok(()),
        }
    }

    /// Prepares the record for these requirements.
    ///
    /// An import declares the failure modes that occurred in it. For other modes it is unknown whether they were
    /// recorded.
    ///
    /// # Errors
    /// If the requirements are for another task, or if the task does not have a failure mode or measure.
    pub(crate) fn fit<'a>(&self, record: &'a Record) -> Result<Cow<'a, Record>, GateError> {
        let task = &record.task;
        let wrong = |reason: String| GateError::NotOfTask { requirements: self.name.clone(), reason };
        if let Some(name) = self.task.as_deref().filter(|name| task.name != *name && !record.imported) {
            let hint = "Hint: use --requirements default, or your own file";
            return Err(wrong(format!(
                "the requirements are for the task {name}, but the episodes are of {}\n{hint}",
                task.name
            )));
        }
        let mut unseen = Vec::new();
        for (metric, reason) in self.unknown_metrics(task) {
            match metric {
                Metric::Failure(mode) | Metric::FailureCount(mode) if record.imported => unseen.push(mode),
                _ => return Err(wrong(reason)),
            }
        }
        let mut record = if unseen.is_empty() { Cow::Borrowed(record) } else { Cow::Owned(record.without(&unseen)) };
        if !self.force_limit.is_empty() {
            force_limits::check_task(&self.force_limit, task)?;
            record.to_mut().trials.iter_mut().for_each(|trial| trial.judge_forces(&self.force_limit));
        }
        if self.requirement.iter().any(|requirement| requirement.metric == Metric::Stage) {
            record = Cow::Owned(record.with_stages());
        }
        if !self.groups.is_empty() {
            record = Cow::Owned(record.grouped_by(&self.groups).map_err(wrong)?);
        }
        Ok(record)
    }

    /// Parses TOML.
    ///
    /// # Errors
    /// A problem with its location: an unknown key, a requirement without a limit, or one that cannot be met at any
    /// number of episodes.
    pub fn from_toml(text: &str) -> Result<Self, GateError> {
        let requirements: Self =
            budget::Budget::FILE.toml(text).map_err(|error| GateError::Syntax(error.to_string()))?;
        requirements.check()?;
        Ok(requirements)
    }

    /// Serialises the requirements as TOML. Equal requirements give equal bytes.
    pub fn to_toml(&self) -> String {
        // Strings, finite numbers and tables always serialise.
        toml::to_string(self).unwrap_or_default()
    }

    /// Returns an error if the requirements are invalid for any evidence.
    ///
    /// # Errors
    /// As [`Self::from_toml`].
    pub fn check(&self) -> Result<(), GateError> {
        if self.requirement.is_empty() {
            return Err(GateError::NoRequirements);
        }
        // At a lower confidence, binomial tests of scenarios with different rates are not valid (see `Question`).
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
        force_limits::check(&self.force_limit)?;
        let named = |name| self.force_limit.iter().any(|limit| limit.name == name);
        let unknown =
            self.requirement.iter().find(|one| matches!(one.metric, Metric::ForceLimit(name) if !named(name)));
        if let Some(requirement) = unknown {
            let reason = "there is no [[force_limit]] of this name\nHint: add it, or give --force-limits".to_owned();
            return Err(GateError::Requirement { id: requirement.id(), reason });
        }
        score::check(&self.score)
    }

    /// Checks that a gate which runs episodes has the trials of the real robot that a requirement needs.
    ///
    /// # Errors
    /// If a requirement is on the real robot and there are no trials.
    pub fn check_real(&self, real: Option<&RealEvidence>) -> Result<(), GateError> {
        let needs = self.requirement.iter().find(|requirement| requirement.metric == Metric::RealSuccess);
        match needs.filter(|_| real.is_none_or(|real| real.trials() == 0)) {
            Some(requirement) => Err(GateError::NoRealTrials { id: requirement.id() }),
            None => Ok(()),
        }
    }

    /// The error probability of a pass, and of a fail.
    pub fn alpha(&self) -> f64 {
        // 1 - 0.95 is not 0.05 in floating point, so the result is rounded to 12 decimals.
        ((1.0 - self.confidence) * 1e12).round() / 1e12
    }

    /// Whether a requirement or a score term refers to a baseline.
    pub fn needs_baseline(&self) -> bool {
        self.requirement.iter().any(|r| r.at_most_times_baseline.is_some())
    }
}
