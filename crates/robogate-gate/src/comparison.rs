//! Non-inferiority test: may policy B replace policy A?
//!
//! Both policies ran the same scenarios with the same seeds, so the episodes form pairs. B may replace A if its success
//! rate is shown to be less than a margin below A's: non-inferiority. With a fixed number of pairs the test is the
//! exact unconditional one ([`robogate_stats::non_inferiority`]). A gate that stops early, at the end of one of a known
//! number of rounds, uses the group-sequential test ([`robogate_stats::group_sequential`]). If the number of looks is not
//! known, as for imported episodes, the test bets on the mean difference ([`robogate_stats::bounded_mean`]). The score
//! test of equal rates is reported in addition: whether the policies differ at all.
//!
//! A pair with an invalid episode counts for A in the test of "not worse", and for B in the test of the opposite.

use std::collections::BTreeMap;

use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::compare::Pairs;
use robogate_stats::{Confidence, difference, group_sequential, non_inferiority};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dependence::{are_grouped, by_group};
use crate::record::{recorded_numbers, recorded_seeds};
use crate::rounds::Rounds;
use crate::{Ending, GateError, Population, Record, Sampling, Status, Trial};

/// The policy that may be replaced.
#[derive(Debug, Clone, Copy)]
pub struct Against<'a> {
    /// Its episodes.
    pub record: &'a Record,
    /// The non-inferiority margin: 0.05 is five percentage points of the success rate.
    pub margin: f64,
}

/// Whether one policy may replace another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Comparison {
    /// The policy that may be replaced, A.
    pub policy: String,
    /// SHA-256 (hex) of its rows.
    pub dataset_sha256: String,
    /// The non-inferiority margin.
    pub margin: f64,
    /// Pairs in which both succeeded.
    pub both: u64,
    /// Pairs in which only A succeeded.
    pub only_other: u64,
    /// Pairs in which only B succeeded.
    pub only_this: u64,
    /// Pairs in which neither succeeded.
    pub neither: u64,
    /// Pairs in which either episode is invalid.
    pub invalid: u64,
    /// Success rate of B minus that of A over the valid pairs. `None` without a valid pair.
    pub difference: Option<f64>,
    /// 95 % interval of the difference over the valid pairs, from the paired score test. It assumes a fixed number of
    /// pairs.
    pub interval_95: [f64; 2],
    /// Two-sided p-value of equal rates over the valid pairs, from the same test: at most 0.05 if and only if the interval
    /// excludes 0.
    pub p_different: f64,
    /// p-value of "B is worse than A by the margin or more", for the worst outcome of invalid pairs.
    pub p_met: f64,
    /// p-value of "B is worse than A by less than the margin", for the best outcome of invalid pairs.
    pub p_violated: f64,
    /// The status of the comparison.
    pub status: Status,
    /// The same pairs by the share of the way to success that each episode went. The verdict does not depend on it. `None` if the task
    /// declares no stages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<StageComparison>,
    /// What differs between both besides the policy, in words, A before B: the latency, the environment's file, versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub differs: Vec<String>,
}

/// Pairs by the share of the way to success, of which success is the last step. A policy that gets further is seen with fewer episodes than by
/// success alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageComparison {
    /// Pairs in which both shares are known.
    pub pairs: u64,
    /// Mean share of B minus that of A.
    pub difference: f64,
    /// 95 % interval, valid after any round. Pairs with an unknown share count against each end.
    pub interval_95: [f64; 2],
    /// p-value of "the shares are equal or A's is larger", likewise.
    pub p_better: f64,
    /// p-value of "the shares are equal or B's is larger", likewise.
    pub p_worse: f64,
}

impl StageComparison {
    /// The comparison of B's share minus A's in each pair, by betting on its mean.
    fn of(differences: &[Option<f64>], looks: &[usize]) -> Option<Self> {
        let known: Vec<f64> = differences.iter().copied().flatten().collect();
        // The difference, -1 to 1, is shifted to 0 to 2.
        let shifted = |unknown: f64| differences.iter().map(|d| d.map_or(unknown, |d| 1.0 + d)).collect::<Vec<f64>>();
        let (worst, best) = (shifted(0.0), shifted(2.0));
        let (low, high) = (BoundedMean::new(&worst, looks, 2.0).ok()?, BoundedMean::new(&best, looks, 2.0).ok()?);
        let tail = Confidence::P95.tail();
        (!known.is_empty()).then(|| Self {
            pairs: known.len() as u64,
            difference: known.iter().sum::<f64>() / known.len() as f64,
            interval_95: [low.interval(tail).low - 1.0, high.interval(tail).high - 1.0],
            p_better: (-low.ln_evidence_above(1.0)).exp(),
            p_worse: (-high.ln_evidence_below(1.0)).exp(),
        })
    }
}

impl Comparison {
    /// The name of the comparison among the requirement results.
    pub const ID: &'static str = "not worse than the other policy";
}

/// The plan of a gate that has not run yet.
#[derive(Debug, Clone, Copy)]
pub struct Planned {
    /// Its seed.
    pub seed: u64,
    /// Its maximum number of rounds.
    pub rounds: u64,
    /// How the number of rounds is chosen.
    pub sampling: Sampling,
    /// The error of a pass.
    pub alpha: f64,
}

/// Rejects an impossible comparison before anything runs: other scenarios, another seed, an invalid margin, or so few
/// pairs that even a policy without failures would not pass.
///
/// # Errors
/// The first of these problems.
pub fn check_pairing(other: &Record, this: &Record, planned: Planned, margin: f64) -> Result<(), GateError> {
    non_inferiority::check(margin)?;
    check_repeats(&[other, this])?;
    if !other.population.is_that_of(&this.population) {
        let baseline = other.population.to_string();
        return Err(GateError::ForeignBaseline { baseline, run: this.population.to_string() });
    }
    check_conditions(other, this)?;
    match other.trials.first() {
        Some(first) if first.seed != planned.seed => {
            let what = format!("the seeds are {} and {}", first.seed, planned.seed);
            return Err(GateError::NotPaired { index: first.index, what });
        }
        _ => {}
    }
    let rounds = Rounds::of(&other.trials, &other.population)?;
    let most = usize::try_from(planned.rounds).unwrap_or(usize::MAX);
    let (mut twins, mut looks) = (Vec::new(), Vec::new());
    for round in rounds.rounds.iter().take(most) {
        twins.extend(round.iter().map(|a| a.ending.is_valid().then_some((a.ending == Ending::Success, true))));
        looks.push(twins.len());
    }
    let sampling = other.sampling(planned.sampling);
    let best = Against { record: other, margin }.conclude(&twins, &looks, sampling, Some(planned.rounds))?;
    if best.p_met > planned.alpha {
        return Err(GateError::TooFewPairs { pairs: twins.len() as u64, margin });
    }
    Ok(())
}

/// Rejects records whose episodes do not follow from seed and parameters: then equal seeds make no pair.
///
/// # Errors
/// [`GateError::Unpaired`] if an environment does not repeat its episodes.
pub fn check_repeats(records: &[&Record]) -> Result<(), GateError> {
    records.iter().try_for_each(|record| {
        let repeats = record.controls.as_ref().and_then(|controls| controls.repeats);
        let why = repeats.and_then(|repeats| repeats.unpaired());
        why.map_or(Ok(()), |why| Err(GateError::Unpaired { policy: record.policy.clone(), why }))
    })
}

/// The episodes of A and B.
type Pair<'a> = (&'a Trial, &'a Trial);

/// Whether the episodes of a pair succeeded. `None` if one is invalid.
type Twin = Option<(bool, bool)>;

impl Against<'_> {
    pub(crate) fn compare(&self, record: &Record, sampling: Sampling) -> Result<Comparison, GateError> {
        check_repeats(&[self.record, record])?;
        let population = &record.population;
        if !self.record.population.is_that_of(population) {
            let baseline = self.record.population.to_string();
            return Err(GateError::ForeignBaseline { baseline, run: population.to_string() });
        }
        check_conditions(self.record, record)?;
        let imported = self.record.imported || record.imported;
        let (pairs, looks) = if imported {
            let pairs = imported_pairs(self.record, record)?;
            let looks = vec![pairs.len()];
            (pairs, looks)
        } else {
            self.pairs(record)?
        };
        let twins: Vec<Twin> = pairs.iter().map(|(a, b)| twin(a, b)).collect();
        let share = |record: &Record, trial: &Trial| {
            let valid = trial.ending.is_valid();
            valid.then(|| record.task.stage_share(trial.ending == Ending::Success, &trial.measures)).flatten()
        };
        let differences: Vec<Option<f64>> =
            pairs.iter().map(|(a, b)| Some(share(record, b)? - share(self.record, a)?)).collect();
        let (stated, planned) = match imported {
            true => (record.sampling(sampling), None),
            false => (self.record.sampling(sampling), planned_rounds(record)),
        };
        let (others, these): (Vec<&Trial>, Vec<&Trial>) = pairs.iter().copied().unzip();
        if let Some(grouped) = [these, others].iter().find(|trials| are_grouped(trials)) {
            return self.by_group(grouped, &twins);
        }
        let stage = StageComparison::of(&differences, &looks);
        let differs = self.record.conditions.differences(&record.conditions);
        Ok(Comparison { stage, differs, ..self.conclude(&twins, &looks, stated, planned)? })
    }

    /// The comparison after all planned rounds of a suite, once if all pairs that are not invalid speak for this policy, and once if the
    /// rounds so far repeat themselves. `None` without a plan.
    pub(crate) fn extremes(&self, record: &Record) -> Result<Option<[Comparison; 2]>, GateError> {
        let Some(planned) = planned_rounds(record).filter(|_| !record.imported && !self.record.imported) else {
            return Ok(None);
        };
        let (twins, looks) = self.twins(record)?;
        let rounds: Vec<&[Twin]> =
            looks.iter().scan(0, |from, end| twins.get(std::mem::replace(from, *end)..*end)).collect();
        let all = |with: &dyn Fn(Twin, bool) -> Twin| {
            let most = usize::try_from(planned).unwrap_or(usize::MAX);
            let (mut twins, mut looks) = (Vec::new(), Vec::new());
            for (at, round) in rounds.iter().cycle().take(most).enumerate() {
                twins.extend(round.iter().map(|twin| with(*twin, at < rounds.len())));
                looks.push(twins.len());
            }
            self.conclude(&twins, &looks, Sampling::Sequential, Some(planned))
        };
        let best = all(&|twin, happened| if happened { twin.and(Some((false, true))) } else { Some((false, true)) })?;
        Ok(Some([best, all(&|twin, _| twin)?]))
    }

    /// Whether the episodes of the pairs of complete rounds succeeded, and their number after each round.
    fn twins(&self, record: &Record) -> Result<(Vec<Twin>, Vec<usize>), GateError> {
        let (pairs, looks) = self.pairs(record)?;
        Ok((pairs.iter().map(|(a, b)| twin(a, b)).collect(), looks))
    }

    /// The pairs of complete rounds, and their number after each round.
    fn pairs<'a>(&'a self, record: &'a Record) -> Result<(Vec<Pair<'a>>, Vec<usize>), GateError> {
        let others: BTreeMap<u64, &Trial> = self.record.trials.iter().map(|trial| (trial.index, trial)).collect();
        let rounds = Rounds::of(&record.trials, &record.population)?;
        let mut pairs = Vec::new();
        let mut looks = Vec::new();
        for round in &rounds.rounds {
            let found: Vec<Pair<'_>> =
                round.iter().filter_map(|trial| Some((*others.get(&trial.index)?, *trial))).collect();
            // The other run may have fewer rounds. Incomplete rounds are not used.
            if rounds.suite && found.len() < round.len() {
                break;
            }
            for (a, b) in found {
                same_world(a, b)?;
                pairs.push((a, b));
            }
            looks.push(pairs.len());
        }
        Ok((pairs, looks))
    }

    /// The comparison of imported pairs in groups that depend on each other: each group is one observation, and the interval is that
    /// of the bets, which holds for any distribution over groups.
    fn by_group(&self, these: &[&Trial], twins: &[Twin]) -> Result<Comparison, GateError> {
        let plain = self.conclude(twins, &[twins.len()], Sampling::Sequential, None)?;
        let (least, most, tail) = (moved(twins, 0.0), moved(twins, 2.0), Confidence::P95.tail());
        let test = |limit: f64| by_group(these, [&least, &most], 2.0, limit, tail);
        let (Ok(margin), Ok(equal)) = (test(1.0 - self.margin), test(1.0)) else {
            return Ok(Comparison { interval_95: [-1.0, 1.0], p_different: 1.0, p_met: 1.0, p_violated: 1.0, ..plain });
        };
        let [p_met, p_violated] = margin.p();
        let interval_95 = [equal.interval.low - 1.0, equal.interval.high - 1.0];
        let p_different = (2.0 * equal.p().into_iter().fold(1.0, f64::min)).min(1.0);
        Ok(Comparison { interval_95, p_different, p_met, p_violated, ..plain })
    }

    /// `rounds` is the largest number of looks, if it was fixed before the first episode.
    fn conclude(
        &self,
        twins: &[Twin],
        looks: &[usize],
        sampling: Sampling,
        rounds: Option<u64>,
    ) -> Result<Comparison, GateError> {
        let valid = count(twins, None);
        let (p_met, p_violated) = match (sampling, rounds) {
            (Sampling::Fixed, _) => {
                let worst = count(twins, Some((true, false)));
                let best = count(twins, Some((false, true)));
                (
                    non_inferiority::exact(worst, self.margin)?.exp(),
                    non_inferiority::exact_worse(best, self.margin)?.exp(),
                )
            }
            (Sampling::Sequential, Some(rounds)) => {
                let at = |n: usize| {
                    let seen = twins.get(..n).unwrap_or(twins);
                    [count(seen, Some((true, false))), count(seen, Some((false, true)))]
                };
                let looks: Vec<[Pairs; 2]> = looks.iter().map(|n| at(*n)).collect();
                let [met, violated] = group_sequential::paired_p(&looks, rounds, self.margin)?;
                (met, violated)
            }
            (Sampling::Sequential, None) => {
                // The mean under the hypothesis is 1 - margin.
                non_inferiority::check(self.margin)?;
                let (worst, best) = (moved(twins, 0.0), moved(twins, 2.0));
                let account = |values: &[f64], above: bool| {
                    // The values are 0, 1 and 2.
                    BoundedMean::new(values, looks, 2.0).map_or(0.0, |mean| {
                        let limit = 1.0 - self.margin;
                        if above { mean.ln_evidence_above(limit) } else { mean.ln_evidence_below(limit) }
                    })
                };
                ((-account(&worst, true)).exp(), (-account(&best, false)).exp())
            }
        };
        let difference = difference::paired(valid, Confidence::P95);
        let none = valid.n() == 0;
        Ok(Comparison {
            policy: self.record.policy.clone(),
            dataset_sha256: self.record.dataset_sha256.clone(),
            margin: self.margin,
            both: valid.both,
            only_other: valid.first_only,
            only_this: valid.second_only,
            neither: valid.neither,
            invalid: twins.iter().filter(|twin| twin.is_none()).count() as u64,
            // The library subtracts the second rate from the first, so B comes first.
            difference: difference.estimate.map(|d| -d),
            interval_95: [-difference.interval.high, -difference.interval.low],
            p_different: difference.ln_p.exp(),
            p_met,
            p_violated,
            status: if none { Status::NoEvidence } else { Status::Undecided },
            stage: None,
            differs: Vec::new(),
        })
    }
}

/// Rejects policies that were judged under other settings of the task, in another engine or on another robot.
fn check_conditions(other: &Record, this: &Record) -> Result<(), GateError> {
    let found = other.conditions.contradiction(&this.conditions);
    found.map_or(Ok(()), |differences| Err(GateError::OtherConditions { differences }))
}

/// The planned number of rounds of a suite. `None` if it was not fixed before the first episode.
fn planned_rounds(record: &Record) -> Option<u64> {
    match &record.population {
        Population::Suite { cases, .. } => record.planned.map(|planned| planned / (*cases).max(1)),
        Population::Drawn { .. } | Population::Imported { .. } => None,
    }
}

/// Pairs imported episodes by case and seed, because nothing else identifies their scenario. A file without cases has
/// one, and a file without seeds is paired by the number of the episode within its case.
fn imported_pairs<'a>(other: &'a Record, this: &'a Record) -> Result<Vec<Pair<'a>>, GateError> {
    let without = |record: &Record| record.trials.iter().all(|trial| trial.label.case.is_none());
    let one_case = without(other) && without(this);
    let (others, these) = (by_identity(other, one_case)?, by_identity(this, one_case)?);
    Ok(these.iter().filter_map(|(key, b)| Some((*others.get(key)?, *b))).collect())
}

fn by_identity(record: &Record, one_case: bool) -> Result<BTreeMap<(&str, i64), &Trial>, GateError> {
    let refuse = || GateError::NoIdentity { policy: record.policy.clone() };
    let seeds = recorded_seeds(&record.trials).or_else(|| recorded_numbers(&record.trials)).ok_or_else(refuse)?;
    let mut found = BTreeMap::new();
    for (trial, seed) in record.trials.iter().zip(seeds) {
        let case = if one_case { "" } else { trial.label.case.as_deref().ok_or_else(refuse)? };
        if let Some(first) = found.insert((case, seed), trial) {
            return Err(GateError::Copies { first: first.index, second: trial.index });
        }
    }
    Ok(found)
}

fn twin(a: &Trial, b: &Trial) -> Twin {
    let both = a.ending.is_valid() && b.ending.is_valid();
    both.then_some((a.ending == Ending::Success, b.ending == Ending::Success))
}

/// The difference of each pair, -1 to 1, shifted to 0 to 2. Pairs with an invalid episode have the value `unknown`.
fn moved(twins: &[Twin], unknown: f64) -> Vec<f64> {
    let difference = |(a, b): (bool, bool)| 1.0 + f64::from(u8::from(b)) - f64::from(u8::from(a));
    twins.iter().map(|twin| twin.map_or(unknown, difference)).collect()
}

/// Counts pairs. Those with an invalid episode count as `unknown`, or are skipped.
fn count(twins: &[Twin], unknown: Twin) -> Pairs {
    let mut pairs = Pairs::default();
    for twin in twins {
        match twin.or(unknown) {
            Some((true, true)) => pairs.both += 1,
            Some((true, false)) => pairs.first_only += 1,
            Some((false, true)) => pairs.second_only += 1,
            Some((false, false)) => pairs.neither += 1,
            None => {}
        }
    }
    pairs
}

fn same_world(a: &Trial, b: &Trial) -> Result<(), GateError> {
    let what = if a.seed != b.seed {
        format!("the seeds are {} and {}", a.seed, b.seed)
    } else if a.label != b.label {
        "the scenarios differ".to_owned()
    } else if a.requested != b.requested {
        "the parameters differ".to_owned()
    } else {
        return Ok(());
    };
    Err(GateError::NotPaired { index: b.index, what })
}
