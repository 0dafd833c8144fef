//! The rounds of a campaign in shards. Each round needs the complete results of the previous one.

use std::fmt;

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use crate::{Plan, Stage};

/// A part of a campaign that is divided into shards: a stage, or one round of a suite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShardRound {
    /// The uniform stage.
    Uniform,
    /// The boundary stage. Its points follow from the results of the uniform stage.
    Boundary,
    /// A round of a suite, from 0.
    Suite(u64),
    /// A round of the active stage, from 0. Its points follow from the results of all rounds before. The stage may end
    /// earlier than planned.
    Active(u64),
}

impl ShardRound {
    /// The rounds of a plan in order.
    pub fn all(plan: &Plan) -> Vec<Self> {
        match &plan.suite {
            Some(suite) => (0..suite.rounds).map(Self::Suite).collect(),
            None if plan.boundary.episodes > 0 => vec![Self::Uniform, Self::Boundary],
            None => {
                let active = plan.active.as_ref().map_or(0, |stage| stage.rounds(plan.uniform.episodes).len() as u64);
                std::iter::once(Self::Uniform).chain((0..active).map(Self::Active)).collect()
            }
        }
    }

    /// The stage that the round belongs to.
    pub fn stage(self) -> Stage {
        match self {
            Self::Uniform => Stage::Uniform,
            Self::Boundary => Stage::Boundary,
            Self::Suite(_) => Stage::Suite,
            Self::Active(_) => Stage::Active,
        }
    }

    /// The indices of its episodes in the campaign.
    pub(crate) fn indices(self, plan: &Plan) -> std::ops::Range<u64> {
        let uniform = plan.uniform.episodes;
        match (self, &plan.suite) {
            (Self::Uniform, _) => 0..uniform,
            (Self::Boundary, _) => uniform..uniform + plan.boundary.episodes,
            (Self::Suite(number), Some(suite)) => suite.indices(number),
            (Self::Suite(_), None) => 0..0,
            (Self::Active(number), _) => {
                let rounds = plan.active.as_ref().map_or_else(Vec::new, |stage| stage.rounds(uniform));
                usize::try_from(number).ok().and_then(|at| rounds.get(at).cloned()).unwrap_or(0..0)
            }
        }
    }

    /// The two numbers that identify the round in a shard file.
    pub(super) fn code(self) -> (u32, u64) {
        match self {
            Self::Uniform => (0, 0),
            Self::Boundary => (1, 0),
            Self::Suite(number) => (2, number),
            Self::Active(number) => (3, number),
        }
    }

    /// The round with these numbers.
    pub(super) fn from_code(code: (u32, u64)) -> Option<Self> {
        match code {
            (0, 0) => Some(Self::Uniform),
            (1, 0) => Some(Self::Boundary),
            (2, number) => Some(Self::Suite(number)),
            (3, number) => Some(Self::Active(number)),
            _ => None,
        }
    }

    /// The round with this name.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        if let Some(number) = name.strip_prefix("suite-") {
            return number.parse().ok().map(Self::Suite);
        }
        if let Some(number) = name.strip_prefix("active-") {
            return number.parse().ok().map(Self::Active);
        }
        [Self::Uniform, Self::Boundary].into_iter().find(|round| round.to_string() == name)
    }
}

impl fmt::Display for ShardRound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Uniform | Self::Boundary => self.stage().fmt(f),
            Self::Suite(number) | Self::Active(number) => write!(f, "{}-{number}", self.stage()),
        }
    }
}

/// A round is written as its name.
impl Serialize for ShardRound {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl JsonSchema for ShardRound {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ShardRound".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "The name of a round: `uniform`, `boundary`, `active-0`, `active-1`, ..., or `suite-0`, `suite-1`, ...",
            "type": "string",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_codes_round_trip() {
        let numbered = [ShardRound::Suite(0), ShardRound::Suite(12), ShardRound::Active(0), ShardRound::Active(9)];
        for round in [ShardRound::Uniform, ShardRound::Boundary].into_iter().chain(numbered) {
            assert_eq!(ShardRound::from_name(&round.to_string()), Some(round));
            assert_eq!(ShardRound::from_code(round.code()), Some(round));
        }
        for name in ["", "suite", "suite-", "suite-x", "active", "active-", "Uniform"] {
            assert_eq!(ShardRound::from_name(name), None, "{name}");
        }
        assert_eq!(ShardRound::from_code((1, 1)), None);
    }
}
