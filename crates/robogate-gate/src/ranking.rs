//! A ranking: which of several policies is the best, and which of them cannot be distinguished from it.

use robogate_stats::anytime::Bounds;
use robogate_stats::contest::{Elimination, Guarantee, PairInterval};
use robogate_stats::interval::Confidence;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Verdict;

/// What the error probability of a ranking bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RankingGuarantee {
    /// The best policy is dropped at most this often. One of several equally good policies may be dropped.
    BestStays,
    /// Any policy that is as good as the best one is dropped at most this often.
    NoFalseElimination,
}

impl RankingGuarantee {
    /// The guarantee of the test.
    pub fn of_test(self) -> Guarantee {
        match self {
            Self::BestStays => Guarantee::BestStays,
            Self::NoFalseElimination => Guarantee::NoFalseElimination,
        }
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::BestStays => "best-stays",
            Self::NoFalseElimination => "no-false-elimination",
        }
    }

    /// The guarantee as a sentence.
    pub fn sentence(self, error: f64) -> String {
        let percent = robogate_stats::format::percent(error);
        match self {
            Self::BestStays => format!("The best policy is dropped in at most {percent} of such rankings."),
            Self::NoFalseElimination => {
                format!("A policy that is as good as the best one is dropped in at most {percent} of such rankings.")
            }
        }
    }
}

/// What a ranking compares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RankingOutcome {
    /// Success.
    #[default]
    Success,
    /// The stages that an episode reached, of which success is the last: which policy gets further more often.
    Stage,
}

impl RankingOutcome {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Stage => "stage",
        }
    }

    /// Whether success is compared.
    pub fn is_success(&self) -> bool {
        *self == Self::Success
    }
}

/// Where the episodes of a ranking come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum RankingDesign {
    /// All policies run the same scenarios in rounds, and worse ones leave.
    Rounds {
        /// Scenarios of a round.
        scenarios: u64,
        /// Rounds that ran.
        rounds: u64,
        /// The largest number of rounds, fixed before the first.
        most_rounds: u64,
    },
    /// Finished results, tested once.
    Results,
}

/// How the decisions of a ranking treat invalid episodes. Rates and differences leave them out in any case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum InvalidEpisodes {
    /// An invalid episode counts against each decision: as a success of the policy that would be dropped, and as a failure of the one
    /// that would be better. The error holds for any reason of invalid episodes.
    CountAgainst,
    /// They are left out. The error holds only if the reason for an invalid episode does not depend on its policy.
    #[default]
    LeftOut,
}

/// A policy that was dropped.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DroppedPolicy {
    /// A policy that is better.
    pub by: String,
    /// The round, counted from 1. Absent for finished results.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub round: Option<u64>,
}

/// A policy of a ranking.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RankedPolicy {
    /// Its name in this ranking.
    pub name: String,
    /// The folder or file of its episodes.
    pub run: String,
    /// Valid episodes.
    pub valid: u64,
    /// Invalid episodes. They are left out of every rate and difference.
    pub invalid: u64,
    /// Successes among the valid episodes.
    pub successes: u64,
    /// The success rate. Absent without a valid episode.
    pub rate: Option<f64>,
    /// The mean share of the way to success, in a ranking by stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<f64>,
    /// The 95 % interval of the rate. For rounds, it holds at any time the contest may end.
    pub interval_95: [f64; 2],
    /// How it was dropped. Absent if it is in the best set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dropped: Option<DroppedPolicy>,
}

/// The difference of two policies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RankedPair {
    /// The first policy.
    pub first: String,
    /// The second policy.
    pub second: String,
    /// Scenarios that are valid for both. 0 for independent results.
    pub pairs: u64,
    /// Clusters that the interval counts, if rows depend on each other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clusters: Option<u64>,
    /// First rate minus second. In a ranking by stage, the share of pairs in which the first got further minus that in which the second did.
    pub difference: f64,
    /// Its interval at 95 % for all pairs together. For rounds, it also holds after every round simultaneously.
    pub interval_95: [f64; 2],
}

/// A ranking as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Ranking {
    /// Version of the format.
    pub format: u32,
    /// The scenarios or results, in words.
    pub scenarios: String,
    /// Where the episodes come from.
    pub design: RankingDesign,
    /// What is compared.
    #[serde(default, skip_serializing_if = "RankingOutcome::is_success")]
    pub by: RankingOutcome,
    /// What the error bounds.
    pub guarantee: RankingGuarantee,
    /// The error probability, over all pairs and rounds.
    pub error: f64,
    /// How the decisions treat invalid episodes, which is a condition of the error.
    #[serde(default)]
    pub invalid_episodes: InvalidEpisodes,
    /// The best set: the policies that cannot be distinguished from the best.
    pub best: Vec<String>,
    /// The policies by their rate, or by their mean share of the way in a ranking by stage, the best set first.
    pub policies: Vec<RankedPolicy>,
    /// The differences of all pairs.
    pub differences: Vec<RankedPair>,
}

impl Ranking {
    /// The version of the format.
    pub const FORMAT: u32 = 1;

    /// The ranking after the rounds of a contest. `policies` are the names and folders of the policies, with their invalid episodes.
    pub fn of_rounds(
        scenarios: String,
        design: RankingDesign,
        (guarantee, error, by): (RankingGuarantee, f64, RankingOutcome),
        policies: &[(String, String, u64)],
        contest: &Elimination,
    ) -> Self {
        let name = |at: usize| policies.get(at).map(|(name, ..)| name.clone()).unwrap_or_default();
        let ranked = (0..).zip(policies).map(|(at, (name_of, run, invalid))| {
            let trials = contest.trials(at);
            let mut bounds = Bounds::new(Confidence::P95.tail());
            bounds.look(trials);
            RankedPolicy {
                name: name_of.clone(),
                run: run.clone(),
                valid: trials.n(),
                invalid: *invalid,
                successes: trials.successes(),
                rate: trials.rate(),
                stage: contest.mean_score(at).filter(|_| !by.is_success()),
                interval_95: [bounds.interval().low, bounds.interval().high],
                dropped: contest.dropped(at).map(|out| DroppedPolicy { by: name(out.by), round: Some(out.look) }),
            }
        });
        let pair = |pair: PairInterval| RankedPair {
            first: name(pair.first),
            second: name(pair.second),
            pairs: pair.blocks,
            clusters: None,
            difference: pair.difference,
            interval_95: [pair.interval.low, pair.interval.high],
        };
        let differences = contest.table(Confidence::P95).into_iter().map(pair).collect();
        Self { by, ..Self::new(scenarios, design, (guarantee, error), ranked.collect(), differences) }
    }

    /// A ranking of these policies.
    pub fn new(
        scenarios: String,
        design: RankingDesign,
        (guarantee, error): (RankingGuarantee, f64),
        mut policies: Vec<RankedPolicy>,
        differences: Vec<RankedPair>,
    ) -> Self {
        let of = |policy: &RankedPolicy| policy.stage.or(policy.rate).unwrap_or(-1.0);
        policies.sort_by(|a, b| a.dropped.is_some().cmp(&b.dropped.is_some()).then_with(|| of(b).total_cmp(&of(a))));
        let best =
            policies.iter().filter(|policy| policy.dropped.is_none()).map(|policy| policy.name.clone()).collect();
        let invalid_episodes = match design {
            RankingDesign::Rounds { .. } => InvalidEpisodes::CountAgainst,
            RankingDesign::Results => InvalidEpisodes::LeftOut,
        };
        Self {
            format: Self::FORMAT,
            scenarios,
            design,
            by: RankingOutcome::Success,
            guarantee,
            error,
            invalid_episodes,
            best,
            policies,
            differences,
        }
    }

    /// The guarantee in words. If there are invalid episodes, also how the decisions treat them.
    pub fn statement(&self) -> String {
        let sentence = self.guarantee.sentence(self.error);
        if self.policies.iter().all(|policy| policy.invalid == 0) {
            return sentence;
        }
        let condition = match self.invalid_episodes {
            InvalidEpisodes::CountAgainst => {
                "An invalid episode counts as a failure of the policy that would be better, and as a success of the one that \
                 would be dropped."
            }
            InvalidEpisodes::LeftOut => {
                "This holds only if the reason for an invalid episode does not depend on its policy: the tests leave out \
                 invalid episodes."
            }
        };
        format!("{sentence} {condition}")
    }

    /// Pass if one policy is the best, inconclusive if several are left, and invalid if a policy has no valid episode.
    pub fn verdict(&self) -> Verdict {
        match self.best.len() {
            _ if self.policies.iter().any(|policy| policy.valid == 0) => Verdict::Invalid,
            1 => Verdict::Pass,
            _ => Verdict::Inconclusive,
        }
    }

    /// The answer in one sentence.
    pub fn headline(&self) -> String {
        let by = if self.by.is_success() { "" } else { " by the stages reached" };
        match &*self.best {
            [best] => format!("{best} is the best of {} policies{by}", self.policies.len()),
            best => {
                format!("{} of {} policies cannot be distinguished from the best{by}", best.len(), self.policies.len())
            }
        }
    }

    /// The names of the two policies with the highest ranks, and the rate of the first minus that of the second with its interval.
    pub fn first_difference(&self) -> Option<(String, [f64; 3])> {
        let [first, second, ..] = &*self.policies else { return None };
        let of = |a: &RankedPolicy, b: &RankedPolicy| {
            self.differences.iter().find(|pair| pair.first == a.name && pair.second == b.name)
        };
        let numbers = match of(first, second) {
            Some(pair) => [pair.difference, pair.interval_95[0], pair.interval_95[1]],
            None => of(second, first).map(|pair| [-pair.difference, -pair.interval_95[1], -pair.interval_95[0]])?,
        };
        Some((format!("{} - {}", first.name, second.name), numbers))
    }

    /// The document as JSON text.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranking(design: RankingDesign, invalid: u64) -> Ranking {
        let policy = RankedPolicy {
            name: "a".to_owned(),
            run: "runs/a".to_owned(),
            valid: 10,
            invalid,
            successes: 5,
            rate: Some(0.5),
            stage: None,
            interval_95: [0.2, 0.8],
            dropped: None,
        };
        Ranking::new(String::new(), design, (RankingGuarantee::BestStays, 0.05), vec![policy], Vec::new())
    }

    #[test]
    fn invalid_episodes_add_a_condition() {
        let rounds = RankingDesign::Rounds { scenarios: 5, rounds: 2, most_rounds: 3 };
        let plain = RankingGuarantee::BestStays.sentence(0.05);
        assert_eq!(ranking(rounds.clone(), 0).statement(), plain);
        assert!(ranking(rounds.clone(), 1).statement().contains("as a failure of the policy that would be better"));
        assert!(ranking(RankingDesign::Results, 1).statement().contains("This holds only if"));
        assert!(ranking(rounds, 0).to_json().contains("\"invalid_episodes\": \"count_against\""));
        // A document without the field is from a version whose tests left out invalid episodes.
        let old = ranking(RankingDesign::Results, 1);
        let mut document = serde_json::json!(old);
        document.as_object_mut().unwrap().remove("invalid_episodes").unwrap();
        assert_eq!(serde_json::from_value::<Ranking>(document).unwrap(), old);
    }
}
