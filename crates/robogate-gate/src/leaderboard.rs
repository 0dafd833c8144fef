//! Ranking of policies by the paper's confidence score, with bootstrap intervals.
//!
//! The score of each policy is computed over its own episodes. A bootstrap estimates how much the ranking depends on
//! the choice of scenarios: scenarios are resampled with replacement within each category, which keeps the mix of
//! categories. Every policy gets the same scenarios, each with all its episodes. The intervals of scores and ranks are
//! percentiles over 2,000 replicates.
//!
//! A leader is named only if it is significantly ahead of every other policy: an exact sign test over the scenarios (the
//! successes of each, compared pairwise) and the replicates of the score both reject equality. With k policies the
//! one-sided level of each test is 0.05/k. A policy that is not the best is then named in at most 5 % of leaderboards:
//! for each policy, the probability that it is significantly ahead of a better or equal one is at most 0.05/k, and k of
//! them are added (Bonferroni).
//!
//! The interval of a success rate is exact if the number of episodes was fixed in advance. A gate that stops as soon as its
//! verdict is certain chooses the number by the results, and the exact interval of such gates covered 89 to 92 % in
//! simulations. Their interval is a confidence sequence ([`robogate_stats::anytime`]), which covers at least 95 % after any
//! round.
//!
//! Limitation: resampling only sees observed outcomes. If all replicates are equal, no interval is given; use the interval
//! of the success rate instead. Source: Efron and Tibshirani (1993), chapters 6 and 13.

use std::collections::BTreeMap;

use robogate_core::Seed;
use robogate_stats::anytime::Bounds;
use robogate_stats::compare::{Pairs, mcnemar_exact};
use robogate_stats::resample::percentile_ends;
use robogate_stats::{Confidence, Interval, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::evaluation::EndingCount;
use crate::rounds::Rounds;
use crate::{Baseline, ConfidenceScore, Ending, GateError, Population, Record, Sampling, ScoreTerm, Trial};

/// The number of bootstrap replicates.
const DRAWS: usize = 2_000;
/// The campaign seed of the bootstrap. It is used by no campaign, so its random streams are independent of all
/// episodes.
const SEED: u64 = 0x1EAD_E2B0;
/// The largest probability with which a leaderboard names a leader that is not the best.
const LEADER_ERROR: f64 = 0.05;

/// One policy of a leaderboard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Standing {
    /// Its rank: one more than the number of policies with a higher score. `None` without a score.
    pub rank: Option<u64>,
    /// The range of its rank in 95 % of the replicates. `None` without a score.
    pub ranks_95: Option<[u64; 2]>,
    /// The displayed name.
    pub name: String,
    /// The robot.
    pub robot: String,
    /// The policy's name in its run.
    pub policy: String,
    /// SHA-256 (hex) of its rows.
    pub dataset_sha256: String,
    /// The score and its terms.
    pub score: ConfidenceScore,
    /// The interval that contains 95 % of the replicates. `None` if all replicates are equal.
    pub score_95: Option<[f64; 2]>,
    /// Number of valid episodes.
    pub valid: u64,
    /// Number of invalid episodes.
    pub invalid: u64,
    /// Number of successes.
    pub successes: u64,
    /// 95 % interval of the success rate: exact (Clopper-Pearson), or a confidence sequence if `sequential`.
    pub success_95: [f64; 2],
    /// Whether the number of episodes was not fixed in advance, as in a gate that stops as soon as its verdict is certain.
    #[serde(default)]
    pub sequential: bool,
    /// How the other episodes ended, the most frequent first.
    pub endings: Vec<EndingCount>,
}

/// A ranking of policies as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Leaderboard {
    /// Version of the format.
    pub format: u32,
    /// The population of the figures.
    pub population: Population,
    /// The baseline of relative terms.
    pub baseline: Option<Baseline>,
    /// The number of bootstrap replicates.
    pub draws: u64,
    /// The name of the policy that is significantly ahead of all others. `None` if no policy is.
    #[serde(default)]
    pub leader: Option<String>,
    /// The policies, the highest score first. Those without a score are last.
    pub standings: Vec<Standing>,
}

/// The scenarios of one policy, by category.
type Strata<'a> = BTreeMap<&'a str, BTreeMap<String, Vec<&'a Trial>>>;

impl Leaderboard {
    /// The version of the format.
    pub const FORMAT: u32 = 1;

    /// Whether the number of episodes of some policy was not fixed in advance.
    pub fn is_sequential(&self) -> bool {
        self.standings.iter().any(|standing| standing.sequential)
    }

    /// Ranks named records by `terms`. The sampling of each record is how its number of episodes was chosen. The record
    /// can override it ([`Record::sampling`]).
    ///
    /// # Errors
    /// If there is nothing to rank, or if the records have different populations.
    pub fn of(
        entries: &[(String, Record, Sampling)],
        terms: &[ScoreTerm],
        baseline: Option<&Baseline>,
    ) -> Result<Self, GateError> {
        let Some((_, first, _)) = entries.first() else { return Err(GateError::NothingToRank) };
        if let Some(baseline) = baseline {
            baseline.check(first)?;
        } else if let Some(term) = terms.iter().find(|term| term.scoring.needs_baseline()) {
            return Err(GateError::NoBaseline { what: format!("the score's term `{}`", term.name) });
        }
        let mut judged = Vec::new();
        for (name, record, _) in entries {
            if !record.population.is_that_of(&first.population) {
                return Err(GateError::NotComparable {
                    name: name.clone(),
                    population: record.population.to_string(),
                    first: first.population.to_string(),
                });
            }
            let rounds = Rounds::of(&record.trials, &record.population)?;
            judged.push(rounds.trials().collect::<Vec<&Trial>>());
        }
        let strata: Vec<Strata<'_>> = judged.iter().map(|trials| strata(trials)).collect();
        let draws = draw(&strata, terms, baseline);
        let mut standings = Vec::new();
        for (i, (name, record, sampling)) in entries.iter().enumerate() {
            let trials = judged.get(i).map_or(&[][..], Vec::as_slice);
            let scores: Option<Vec<f64>> = draws.iter().map(|d| d.get(i).copied().flatten()).collect();
            let Some(score) = ConfidenceScore::of(terms, baseline, trials.iter().copied()) else {
                return Err(GateError::Score { reason: "the requirements have no score term to rank by".to_owned() });
            };
            let sampling = record.sampling(*sampling);
            standings.push(standing(name, record, trials, sampling, score, scores));
        }
        ranks(&mut standings, &draws);
        let leader = (0..standings.len())
            .find(|i| successes_lead(&strata, *i) && scores_lead(&draws, *i))
            .and_then(|i| Some(standings.get(i)?.name.clone()));
        standings.sort_by(|a, b| {
            let points = |s: &Standing| s.score.points.unwrap_or(f64::NEG_INFINITY);
            points(b).total_cmp(&points(a)).then_with(|| a.name.cmp(&b.name))
        });
        Ok(Self {
            format: Self::FORMAT,
            population: first.population.clone(),
            baseline: baseline.cloned(),
            draws: DRAWS as u64,
            leader,
            standings,
        })
    }

    /// Serialises the leaderboard. Equal leaderboards give equal bytes.
    pub fn to_json(&self) -> String {
        // Every number is finite, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

fn strata<'a>(trials: &[&'a Trial]) -> Strata<'a> {
    let mut strata: Strata<'a> = BTreeMap::new();
    for trial in trials {
        let category = trial.label.category.as_deref().unwrap_or_default();
        // Without a suite, each episode is its own scenario.
        let case = trial.label.case.clone().unwrap_or_else(|| format!("{:020}", trial.index));
        strata.entry(category).or_default().entry(case).or_default().push(*trial);
    }
    strata
}

/// The score of each policy in each bootstrap replicate.
fn draw(strata: &[Strata<'_>], terms: &[ScoreTerm], baseline: Option<&Baseline>) -> Vec<Vec<Option<f64>>> {
    let mut stream = Seed::campaign(SEED).stream("leaderboard");
    // Scenarios that any policy ran. A policy that did not run a scenario gets no episodes from it.
    let mut cases: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (category, known) in strata.iter().flatten() {
        let list = cases.entry(category).or_default();
        list.extend(known.keys().map(String::as_str));
        list.sort_unstable();
        list.dedup();
    }
    (0..DRAWS)
        .map(|_| {
            let resampled: Vec<(&str, &str)> = cases
                .iter()
                .flat_map(|(category, list)| {
                    let picks: Vec<usize> = list.iter().map(|_| stream.below(list.len())).collect();
                    picks.into_iter().filter_map(|i| Some((*category, *list.get(i)?))).collect::<Vec<_>>()
                })
                .collect();
            strata
                .iter()
                .map(|strata| {
                    let trials: Vec<&Trial> = resampled
                        .iter()
                        .filter_map(|(category, case)| strata.get(category)?.get(*case))
                        .flatten()
                        .copied()
                        .collect();
                    ConfidenceScore::of(terms, baseline, trials.iter().copied()).and_then(|score| score.points)
                })
                .collect()
        })
        .collect()
}

fn standing(
    name: &str,
    record: &Record,
    trials: &[&Trial],
    sampling: Sampling,
    score: ConfidenceScore,
    scores: Option<Vec<f64>>,
) -> Standing {
    let valid = trials.iter().filter(|trial| trial.ending.is_valid()).count() as u64;
    let successes = trials.iter().filter(|trial| trial.ending == Ending::Success).count() as u64;
    let interval = success_interval(Trials::new(successes, valid).unwrap_or(Trials::NONE), sampling);
    let ends = scores.and_then(|mut scores| percentile_ends(&mut scores, Confidence::P95));
    Standing {
        rank: None,
        ranks_95: None,
        name: name.to_owned(),
        robot: record.robot.clone(),
        policy: record.policy.clone(),
        dataset_sha256: record.dataset_sha256.clone(),
        score,
        score_95: ends.filter(|(low, high)| high - low > 1e-9).map(|(low, high)| [low, high]),
        valid,
        invalid: trials.len() as u64 - valid,
        successes,
        success_95: [interval.low, interval.high],
        sequential: sampling == Sampling::Sequential,
        endings: crate::evaluation::endings(trials),
    }
}

/// The 95 % interval of a success rate.
fn success_interval(trials: Trials, sampling: Sampling) -> Interval {
    match sampling {
        Sampling::Fixed => clopper_pearson(trials, Confidence::P95),
        Sampling::Sequential => {
            let mut bounds = Bounds::new(Confidence::P95.tail());
            bounds.look(trials);
            bounds.interval()
        }
    }
}

/// Computes the rank of each policy, and its ranks in the replicates.
fn ranks(standings: &mut [Standing], draws: &[Vec<Option<f64>>]) {
    let above = |scores: &[Option<f64>], i: usize| {
        let own = scores.get(i).copied().flatten()?;
        Some(1 + scores.iter().flatten().filter(|other| **other > own + 1e-9).count() as u64)
    };
    let points: Vec<Option<f64>> = standings.iter().map(|s| s.score.points).collect();
    for (i, standing) in standings.iter_mut().enumerate() {
        standing.rank = above(&points, i);
        let mut resampled: Vec<u64> = draws.iter().filter_map(|scores| above(scores, i)).collect();
        resampled.sort_unstable();
        let at = |q: f64| resampled.get((q * resampled.len() as f64) as usize).copied();
        standing.ranks_95 = at(0.025).zip(at(0.975)).map(|(low, high)| [low, high]);
    }
}

/// Whether policy `i` succeeds significantly more often than each other policy: an exact sign test over the scenarios
/// that both ran. The episodes of one scenario count as one observation.
fn successes_lead(strata: &[Strata<'_>], i: usize) -> bool {
    let level = LEADER_ERROR / strata.len() as f64;
    strata.len() > 1
        && strata.get(i).is_some_and(|own| {
            let others = strata.iter().enumerate().filter(|(j, _)| *j != i);
            others.into_iter().all(|(_, other)| {
                let pairs = better_scenarios(own, other);
                // The exact test is two-sided.
                pairs.first_only > pairs.second_only && mcnemar_exact(pairs) <= (2.0 * level).ln()
            })
        })
}

/// Counts the scenarios in which one policy has the higher success rate.
fn better_scenarios(first: &Strata<'_>, second: &Strata<'_>) -> Pairs {
    let rate = |trials: &[&Trial]| {
        let valid = trials.iter().filter(|trial| trial.ending.is_valid()).count();
        let successes = trials.iter().filter(|trial| trial.ending == Ending::Success).count();
        (valid > 0).then(|| successes as f64 / valid as f64)
    };
    let mut pairs = Pairs::default();
    for (category, scenarios) in first {
        for (case, trials) in scenarios {
            let other = second.get(category).and_then(|known| known.get(case));
            let Some((a, b)) = rate(trials).zip(other.and_then(|trials| rate(trials))) else { continue };
            pairs.first_only += u64::from(a > b);
            pairs.second_only += u64::from(b > a);
        }
    }
    pairs
}

/// Whether the score of policy `i` is higher than that of each other policy in nearly all replicates.
fn scores_lead(draws: &[Vec<Option<f64>>], i: usize) -> bool {
    let policies = draws.first().map_or(0, Vec::len);
    let most = LEADER_ERROR / policies as f64 * draws.len() as f64;
    (0..policies).filter(|j| *j != i).all(|j| {
        let behind = |scores: &&Vec<Option<f64>>| {
            let (own, other) = (scores.get(i).copied().flatten(), scores.get(j).copied().flatten());
            own.zip(other).is_none_or(|(own, other)| own <= other)
        };
        draws.iter().filter(behind).count() as f64 <= most
    })
}

#[cfg(test)]
mod tests {
    use robogate_stats::operating::{Answer, RateTest};

    use super::*;

    #[test]
    fn intervals_of_stopped_gates_cover() {
        let mut stream = Seed::campaign(5).stream("test");
        let test = RateTest { at_least: 0.8, alpha: 0.05, beta: 0.05 };
        for rate in [0.7, 0.8, 0.9] {
            let (gates, mut covered) = (1_000, 0);
            for _ in 0..gates {
                let mut trials = Trials::NONE;
                for _ in 0..20 {
                    let new = (0..20).filter(|_| stream.uniform() < rate).count() as u64;
                    trials = Trials::new(trials.successes() + new, trials.n() + 20).unwrap();
                    if test.look(trials) != Answer::Open {
                        break;
                    }
                }
                covered += u32::from(success_interval(trials, Sampling::Sequential).contains(rate));
            }
            assert!(covered >= 950, "{rate}: {covered} of {gates}");
        }
    }

    #[test]
    fn fixed_numbers_have_the_exact_interval() {
        let trials = Trials::new(60, 68).unwrap();
        let [exact, any] = [Sampling::Fixed, Sampling::Sequential].map(|sampling| success_interval(trials, sampling));
        assert_eq!(exact, clopper_pearson(trials, Confidence::P95));
        assert!(any.low < exact.low && exact.high < any.high, "{any:?} {exact:?}");
    }
}
