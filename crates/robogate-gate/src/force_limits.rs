//! Limits of contact forces that the user supplies, and the contacts that exceed them.

use std::collections::BTreeSet;
use std::path::Path;

use robogate_core::budget::Budget;
use robogate_core::{Contacting, PEAK_CONTACT_FORCE, Region, TaskSpec, Touched, Word, region_pairs};
use robogate_dictionary::read_regular_text;
use robogate_stats::format::{count, counted, significant};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{GateError, Trial};

/// Number of contacts that a result lists.
const MOST_CONTACTS: usize = 20;

/// A file of `--force-limits`: limits of contact forces, such as those of a risk assessment. RoboGate has none of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceLimits {
    /// Where the limits are from: a standard, or a document of the risk assessment. It appears in reports.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
    /// The limits.
    pub limit: Vec<ForceLimit>,
}

/// A limit of the contact forces of some regions of the robot, for example for one body region of a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceLimit {
    /// Its name: 1 to 64 letters, digits, `_`, `-` and `.`.
    pub name: Word,
    /// The regions of the robot that it applies to. Default: all.
    #[serde(default = "all_regions")]
    pub robot: Vec<Region>,
    /// What these regions touch. Default: parts and surroundings.
    #[serde(default = "all_touched")]
    pub on: Vec<Touched>,
    /// The largest mean force over 0.5 s, in newtons: clamping and pressing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quasi_static_n: Option<f64>,
    /// The largest force at any time, in newtons: impacts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transient_n: Option<f64>,
    /// In a gate: the share of episodes that may exceed it. Default 0.01.
    #[serde(default = "usual_share")]
    pub at_most: f64,
}

fn all_regions() -> Vec<Region> {
    Region::ALL.to_vec()
}

fn all_touched() -> Vec<Touched> {
    Touched::ALL.to_vec()
}

fn usual_share() -> f64 {
    0.01
}

/// A contact that exceeds a limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExcessContact {
    /// The episode's index in its campaign.
    pub episode: u64,
    /// How the episode ended.
    pub ending: String,
    /// The region of the robot.
    pub robot: Region,
    /// What it touched.
    pub on: Touched,
    /// The kind of contact.
    pub kind: Contacting,
    /// The force in newtons.
    pub force_n: f64,
    /// The limit in newtons.
    pub limit_n: f64,
}

/// How many episodes exceed a limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ForceLimitResult {
    /// The limit.
    pub limit: ForceLimit,
    /// Number of valid episodes whose forces are known.
    pub episodes: u64,
    /// Number of valid episodes whose forces by region are unknown.
    pub unknown: u64,
    /// Number of episodes that exceed the limit.
    pub exceeding: u64,
    /// The contacts that exceed it most in proportion to the limit, at most 20.
    pub contacts: Vec<ExcessContact>,
}

impl ForceLimits {
    /// The name of the file in the folder of a run that was started with limits.
    pub const FILE: &'static str = "force-limits.toml";

    /// Reads a file.
    ///
    /// # Errors
    /// A problem in the file, with its location.
    pub fn open(path: &Path) -> Result<Self, GateError> {
        let text = read_regular_text(path).map_err(|source| GateError::Unreadable { path: path.to_owned(), source })?;
        let in_file = |error| GateError::InFile { path: path.to_owned(), error: Box::new(error) };
        let limits: Self = Budget::FILE.toml(&text).map_err(|error| in_file(GateError::Syntax(error.to_string())))?;
        if limits.limit.is_empty() {
            return Err(in_file(GateError::Syntax(
                "no [[limit]]. Expected at least one\nHint: see docs/guides/forces.md for an example".to_owned(),
            )));
        }
        check(&limits.limit).map_err(in_file)?;
        Ok(limits)
    }

    /// Serialises the limits as TOML.
    pub fn to_toml(&self) -> String {
        // Strings, finite numbers and tables always serialise.
        toml::to_string(self).unwrap_or_default()
    }

    /// Checks that the episodes of a task record the forces that the limits apply to.
    ///
    /// # Errors
    /// If they do not.
    pub fn check_task(&self, task: &TaskSpec) -> Result<(), GateError> {
        check_task(&self.limit, task)
    }

    /// The contacts of these episodes that exceed each limit.
    pub fn results<'a>(&self, trials: impl Iterator<Item = &'a Trial> + Clone) -> Vec<ForceLimitResult> {
        self.limit.iter().map(|limit| limit.result(trials.clone())).collect()
    }
}

/// Returns an error if a limit is invalid for any episodes.
pub(crate) fn check(limits: &[ForceLimit]) -> Result<(), GateError> {
    let mut names = BTreeSet::new();
    for limit in limits {
        let wrong = |reason: &str| Err(GateError::Limit { name: limit.name, reason: reason.to_owned() });
        if !names.insert(limit.name) {
            return wrong("duplicate name\nHint: give each limit its own name");
        }
        let forces = [limit.quasi_static_n, limit.transient_n];
        match forces {
            [None, None] => return wrong("no force\nHint: give `quasi_static_n`, `transient_n` or both, in newtons"),
            [Some(held), Some(peak)] if peak < held => {
                return wrong("`transient_n` is below `quasi_static_n`, which would then have no effect");
            }
            _ => {}
        }
        if forces.iter().flatten().any(|force| !(force.is_finite() && *force > 0.0)) {
            return wrong("expected forces above 0 N");
        }
        if limit.robot.is_empty() || limit.on.is_empty() {
            return wrong("an empty list in `robot` or `on` matches no contact\nHint: leave it out for all of them");
        }
        if !(limit.at_most > 0.0 && limit.at_most < 1.0) {
            return wrong("`at_most` is a share of episodes: expected above 0 and below 1");
        }
    }
    Ok(())
}

/// Checks that the episodes of a task record the forces of these limits.
pub(crate) fn check_task(limits: &[ForceLimit], task: &TaskSpec) -> Result<(), GateError> {
    let declares = |region: Region, touched: Touched| {
        Contacting::ALL.iter().all(|kind| task.measure(kind.measure(region, touched).as_str()).is_some())
    };
    let recorded: Vec<Region> = Region::ALL.into_iter().filter(|region| declares(*region, Touched::Part)).collect();
    match limits.iter().find(|limit| !limit.robot.iter().any(|region| recorded.contains(region))) {
        None => Ok(()),
        Some(limit) => {
            let list = |regions: &[Region]| match regions {
                [] => "none".to_owned(),
                some => some.iter().map(|region| region.as_str()).collect::<Vec<_>>().join(", "),
            };
            let reason = format!(
                "it applies to {}, but the task {} records contact forces of these regions of the robot: {}\nHint: the tasks of \
                 the built-in cell record them",
                list(&limit.robot),
                task.name,
                list(&recorded)
            );
            Err(GateError::Limit { name: limit.name, reason })
        }
    }
}

impl ForceLimit {
    /// The contacts of an episode that exceed the limit. `None` if the forces are unknown.
    fn excess(&self, trial: &Trial) -> Option<Vec<ExcessContact>> {
        let force = |kind: Contacting, (region, touched)| kind.force(&trial.measures, region, touched);
        let known = region_pairs().any(|pair| force(Contacting::Transient, pair).is_some());
        let touched = trial.measures.get(PEAK_CONTACT_FORCE.as_str()).is_some();
        if !trial.ending.is_valid() || (touched && !known) {
            return None;
        }
        let mut excess = Vec::new();
        for (robot, on) in region_pairs().filter(|(robot, on)| self.robot.contains(robot) && self.on.contains(on)) {
            for (kind, limit) in Contacting::ALL.into_iter().zip([self.transient_n, self.quasi_static_n]) {
                let (Some(limit_n), Some(force_n)) = (limit, force(kind, (robot, on))) else { continue };
                if force_n > limit_n {
                    let ending = trial.ending.as_str().to_owned();
                    excess.push(ExcessContact { episode: trial.index, ending, robot, on, kind, force_n, limit_n });
                }
            }
        }
        Some(excess)
    }

    /// Whether an episode exceeds the limit. `None` if its forces are unknown.
    pub(crate) fn exceeded(&self, trial: &Trial) -> Option<bool> {
        self.excess(trial).map(|contacts| !contacts.is_empty())
    }

    /// The contacts of these episodes that exceed the limit.
    pub(crate) fn result<'a>(&self, trials: impl Iterator<Item = &'a Trial>) -> ForceLimitResult {
        let limit = self.clone();
        let mut result = ForceLimitResult { limit, episodes: 0, unknown: 0, exceeding: 0, contacts: Vec::new() };
        for trial in trials.filter(|trial| trial.ending.is_valid()) {
            match self.excess(trial) {
                None => result.unknown += 1,
                Some(contacts) => {
                    result.episodes += 1;
                    result.exceeding += u64::from(!contacts.is_empty());
                    result.contacts.extend(contacts);
                }
            }
        }
        let share = |contact: &ExcessContact| contact.force_n / contact.limit_n;
        result.contacts.sort_by(|a, b| share(b).total_cmp(&share(a)).then(a.episode.cmp(&b.episode)));
        result.contacts.truncate(MOST_CONTACTS);
        result
    }
}

impl ExcessContact {
    /// What touched what.
    pub fn pair(&self) -> String {
        let on = match self.on {
            Touched::Part => "a part",
            Touched::Surroundings => "the surroundings",
        };
        format!("{} on {on}", self.robot.as_str())
    }

    /// The contact in a few words.
    pub fn text(&self) -> String {
        format!(
            "episode {} ({}): {}, {} N {} (limit {} N)",
            self.episode,
            self.ending,
            self.pair(),
            significant(self.force_n, 3),
            self.kind.as_str(),
            significant(self.limit_n, 3)
        )
    }
}

impl ForceLimitResult {
    /// The result in one sentence without a full stop.
    pub fn text(&self) -> String {
        let name = self.limit.name;
        let unknown = match self.unknown {
            0 => String::new(),
            n => format!("; the forces of {} are unknown", counted(n, "episode")),
        };
        let of = counted(self.episodes, "episode");
        format!("force limit {name}: {} of {of} exceed it{unknown}", count(self.exceeding))
    }

    /// The result and the hardest contacts, one line each.
    pub fn lines(&self, contacts: usize) -> Vec<String> {
        let contacts = self.contacts.iter().take(contacts).map(ExcessContact::text);
        std::iter::once(self.text()).chain(contacts).collect()
    }
}

impl Trial {
    /// Judges the forces of the episode by these limits.
    pub(crate) fn judge_forces(&mut self, limits: &[ForceLimit]) {
        self.forces = limits.iter().map(|limit| (limit.name, limit.exceeded(self))).collect();
    }

    /// Whether the episode exceeds the limit of this name. `None` if that is unknown.
    pub(crate) fn exceeds(&self, name: Word) -> Option<bool> {
        self.forces.iter().find(|(known, _)| *known == name).and_then(|(_, exceeded)| *exceeded)
    }
}
