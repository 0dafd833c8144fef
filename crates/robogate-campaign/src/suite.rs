//! Campaigns over a suite: its scenarios run in rounds, each with fresh seeds.

use std::ops::Range;

use robogate_core::{Suite, SuiteError};
pub use robogate_dictionary::suite_sha256;
use robogate_dictionary::{Entry, Label, LostEpisode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::OutcomeCounts;

/// The 68 scenarios of the paper's industrial suite, as TOML.
pub const INDUSTRIAL_68: &str = include_str!("../../../assets/suites/industrial-68.toml");

/// The built-in suites: names and commented TOML.
pub const BUILT_IN_SUITES: [(&str, &str); 8] = [
    ("industrial-68", INDUSTRIAL_68),
    ("tabletop-40", include_str!("../../../assets/suites/tabletop-40.toml")),
    ("stacking-40", include_str!("../../../assets/suites/stacking-40.toml")),
    ("insertion-40", include_str!("../../../assets/suites/insertion-40.toml")),
    ("libero-spatial", include_str!("../../../assets/suites/libero-spatial.toml")),
    ("libero-object", include_str!("../../../assets/suites/libero-object.toml")),
    ("libero-goal", include_str!("../../../assets/suites/libero-goal.toml")),
    ("libero-10", include_str!("../../../assets/suites/libero-10.toml")),
];

/// The built-in suite with this name.
pub fn built_in_suite(name: &str) -> Option<Result<Suite, SuiteError>> {
    BUILT_IN_SUITES.iter().find(|(known, _)| *known == name).map(|(_, text)| Suite::from_toml(text))
}

/// The plan for a suite, which replaces both stages.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteStage {
    /// The maximum number of rounds. A caller may stop after any round.
    pub rounds: u64,
    /// The [`suite_sha256`] of the suite.
    pub sha256: String,
    /// The suite.
    pub suite: Suite,
}

impl SuiteStage {
    /// Creates a stage with at most `rounds` rounds.
    pub fn new(suite: Suite, rounds: u64) -> Self {
        Self { rounds, sha256: suite_sha256(&suite), suite }
    }

    /// The number of episodes of all rounds.
    pub fn episodes(&self) -> u64 {
        self.rounds.saturating_mul(self.scenarios())
    }

    /// The number of episodes of one round.
    pub fn scenarios(&self) -> u64 {
        self.suite.cases().len() as u64
    }

    /// The episodes of one round.
    pub(crate) fn indices(&self, round: u64) -> Range<u64> {
        round * self.scenarios()..(round + 1) * self.scenarios()
    }

    /// The columns of the dictionary that identify the scenario of episode `index`.
    pub(crate) fn label(&self, index: u64) -> Label {
        let case = self.suite.case(index);
        Label { case: Some(case.id.clone()), category: Some(case.category.clone()), group: Some(case.group.clone()) }
    }
}

/// A round that is complete and recorded.
#[derive(Debug)]
pub struct Round<'a> {
    /// The round number, from 0.
    pub number: u64,
    /// The episodes, one per scenario, in the suite's order.
    pub entries: &'a [Entry],
    /// All attempts that infrastructure faults have lost so far.
    pub lost: &'a [LostEpisode],
}

/// The outcomes of a suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SuiteSummary {
    /// The suite's name.
    pub name: String,
    /// The version of the suite.
    pub version: String,
    /// The [`suite_sha256`] of the suite.
    pub sha256: String,
    /// The number of completed rounds.
    pub rounds: u64,
    /// The groups, in the suite's order.
    pub groups: Vec<GroupSummary>,
}

/// The outcomes of one group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupSummary {
    /// The category.
    pub category: String,
    /// The group.
    pub group: String,
    /// The number of scenarios.
    pub scenarios: u64,
    /// The outcomes of the episodes.
    pub outcomes: OutcomeCounts,
    /// The share of successes among the valid episodes. Absent if none is valid.
    pub success_rate: Option<f64>,
    /// Wilson's 95 % interval of the success rate. [0, 1] if no episode is valid.
    pub interval_95: [f64; 2],
}

/// Counts the episodes of a suite, group by group.
#[derive(Debug)]
pub(crate) struct Groups(Vec<Group>);

#[derive(Debug)]
struct Group {
    category: String,
    group: String,
    scenarios: u64,
    outcomes: OutcomeCounts,
}

impl Groups {
    pub(crate) fn new(suite: &Suite) -> Self {
        let mut groups: Vec<Group> = Vec::new();
        for case in suite.cases() {
            match groups.iter_mut().find(|g| (&g.category, &g.group) == (&case.category, &case.group)) {
                Some(group) => group.scenarios += 1,
                None => groups.push(Group {
                    category: case.category.clone(),
                    group: case.group.clone(),
                    scenarios: 1,
                    outcomes: OutcomeCounts::default(),
                }),
            }
        }
        Self(groups)
    }

    pub(crate) fn add(&mut self, entry: &Entry) {
        let Label { category, group, .. } = &entry.label;
        let of = |g: &&mut Group| Some(&g.category) == category.as_ref() && Some(&g.group) == group.as_ref();
        if let Some(group) = self.0.iter_mut().find(of) {
            group.outcomes.add(&entry.episode.outcome);
        }
    }

    pub(crate) fn finish(self, stage: &SuiteStage, rounds: u64) -> SuiteSummary {
        let summary = |Group { category, group, scenarios, outcomes }| GroupSummary {
            category,
            group,
            scenarios,
            success_rate: outcomes.success_rate(),
            interval_95: outcomes.interval_95(),
            outcomes,
        };
        SuiteSummary {
            name: stage.suite.name().to_owned(),
            version: stage.suite.version().to_owned(),
            sha256: stage.sha256.clone(),
            rounds,
            groups: self.0.into_iter().map(summary).collect(),
        }
    }
}
