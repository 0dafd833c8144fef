//! Imported episodes that share something which moves their rate: a day, an operator, a session, a robot.
//!
//! The episodes of one operator are not independent evidence about other operators. Each group is then one observation, the mean
//! of its episodes, and a requirement is tested for the mean over new groups by betting on it
//! ([`robogate_stats::bounded_mean`]): the error is guaranteed for any distribution over the groups, if they are a random
//! sample. Groups that cross each other (days and operators) are tested one after the other, and the least favourable result
//! counts. With fewer than [`FEWEST`] groups nothing is decided.

use std::collections::{BTreeMap, BTreeSet};

use robogate_core::Value;
use robogate_dictionary::results::{SOURCE_SEED, follows_order, groups_rows, names_scenario, only_identifies};
use robogate_stats::Interval;
use robogate_stats::bounded_mean::{BoundedMean, OutOfBounds};
use robogate_stats::clusters::{Clusters, FEWEST, Grouping, NEIGHBOURS, coarsest_first};
use robogate_stats::format::counted;
use robogate_stats::serial::blocks_of_neighbours;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::figure::figure;
use crate::{Ending, Requirement, Trial};

/// What the episodes of one group share, and the number of groups.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RowGroups {
    /// The column, or `neighbouring rows`.
    pub by: String,
    /// Number of groups.
    pub count: u64,
}

impl RowGroups {
    /// Several divisions as text: "10 values of operator and 6 values of date".
    pub(crate) fn text(groups: &[Self]) -> String {
        let one = |of: &Self| match of.by.as_str() {
            NEIGHBOURS => format!("{} of neighbouring rows", counted(of.count, "block")),
            by => format!("{} of {by}", counted(of.count, "value")),
        };
        groups.iter().map(one).collect::<Vec<_>>().join(" and ")
    }
}

/// Finds the groups of imported episodes, and writes the number of its groups into each trial. `named` are columns that the
/// requirements name; without them, columns whose names say so count. If nothing identifies groups, a test of neighbouring
/// rows looks for dependence in the order of the file, unless `repeats` says that the rows repeat cases.
///
/// # Errors
/// The first of `named` that is not a column.
pub(crate) fn divide(trials: &mut [Trial], named: &[String], repeats: bool) -> Result<Vec<RowGroups>, String> {
    let mut found = Vec::new();
    for name in named {
        let by_name = match name.as_str() {
            "case" => Some(by_case(trials)),
            "group" if trials.iter().any(|trial| trial.label.group.is_some()) => {
                Some(Clusters::of_labels(trials.iter().map(|trial| trial.label.group.clone())))
            }
            name => by_value(trials, name),
        };
        let clusters = by_name.ok_or_else(|| name.clone())?;
        found.push(Grouping { by: name.clone(), clusters });
    }
    if named.is_empty() {
        let names: BTreeSet<&str> =
            trials.iter().flat_map(|trial| trial.requested.iter()).map(|(name, _)| name).collect();
        let groups = |name: &&str| groups_rows(name) && !only_identifies(name);
        for name in names.into_iter().filter(groups) {
            let clusters = by_value(trials, name).filter(Clusters::divides);
            found.extend(clusters.map(|clusters| Grouping { by: name.to_owned(), clusters }));
        }
        if found.is_empty() && !repeats {
            let blocks = neighbours(trials);
            found.extend(blocks.map(|clusters| Grouping { by: NEIGHBOURS.to_owned(), clusters }));
        }
    }
    let found = coarsest_first(found);
    for (row, trial) in trials.iter_mut().enumerate() {
        trial.groups = found.iter().map(|grouping| grouping.clusters.of_row()[row]).collect();
    }
    Ok(found.into_iter().map(|of| RowGroups { by: of.by, count: of.clusters.count() as u64 }).collect())
}

fn by_case(trials: &[Trial]) -> Clusters {
    Clusters::of_labels(trials.iter().map(|trial| format!("{:?}", trial.label)))
}

/// Rows with equal values of a column. Rows without a value share one. `None` if no row has the column.
fn by_value(trials: &[Trial], name: &str) -> Option<Clusters> {
    let name = if name == "seed" { SOURCE_SEED } else { name };
    // The number of a scenario may be unique within its case only.
    let label = |trial: &Trial| names_scenario(name).then(|| format!("{:?}", trial.label));
    let values: Vec<String> =
        trials.iter().map(|trial| format!("{:?} {:?}", trial.requested.get(name), label(trial))).collect();
    let any = trials.iter().any(|trial| trial.requested.get(name).is_some());
    any.then(|| Clusters::of_labels(values))
}

/// Blocks of neighbouring rows, if these depend on each other.
fn neighbours(trials: &[Trial]) -> Option<Clusters> {
    let success: Vec<bool> = trials.iter().map(|trial| trial.ending == Ending::Success).collect();
    let names: BTreeSet<&str> = trials.iter().flat_map(|trial| trial.requested.iter()).map(|(name, _)| name).collect();
    let numbers = |name: &str| -> Option<Vec<f64>> {
        let number = |trial: &Trial| match trial.requested.get(name)? {
            Value::Number(value) => Some(*value),
            Value::Integer(value) => Some(*value as f64),
            Value::Category(_) => None,
        };
        trials.iter().map(number).collect()
    };
    let explains = |name: &&str| !only_identifies(name) && !follows_order(name);
    let columns: Vec<Vec<f64>> = names.into_iter().filter(explains).filter_map(numbers).collect();
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    blocks_of_neighbours(&success, &columns, &columns).map(|(_, blocks)| blocks)
}

/// The mean of a requirement's figure over the groups of the first division. `None` for quantiles, counts and figures of time.
pub(crate) fn mean_over_groups<'a>(requirement: &Requirement, trials: impl Iterator<Item = &'a Trial>) -> Option<f64> {
    if !requirement.metric.is_rate() && !requirement.metric.is_mean() {
        return None;
    }
    let mut groups: BTreeMap<usize, Vec<&Trial>> = BTreeMap::new();
    trials.for_each(|trial| groups.entry(*trial.groups.first().unwrap_or(&0)).or_default().push(trial));
    let of = |trials: &Vec<&Trial>| figure(requirement.metric, trials.iter().copied(), requirement.range()).2.observed;
    let observed: Vec<f64> = groups.values().filter_map(of).collect();
    (!observed.is_empty()).then(|| observed.iter().sum::<f64>() / observed.len() as f64)
}

/// Two bounds of the mean over new groups, from the smallest and the largest possible value of each episode.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ByGroup {
    /// ln of the evidence that the mean is above the limit, and that it is below.
    pub(crate) ln_evidence: [f64; 2],
    pub(crate) interval: Interval,
}

impl ByGroup {
    /// The p-values of "the mean is at most the limit" and "at least the limit".
    pub(crate) fn p(&self) -> [f64; 2] {
        self.ln_evidence.map(|ln_evidence| (-ln_evidence.max(0.0)).exp())
    }
}

/// Whether the trials are those of groups.
pub(crate) fn are_grouped(trials: &[&Trial]) -> bool {
    trials.first().is_some_and(|trial| !trial.groups.is_empty())
}

/// Tests the mean over new groups against `limit`, at the error `alpha` of each end of the interval. `least` and `most` are the
/// smallest and the largest possible value of each trial, from 0 to `ceiling`.
pub(crate) fn by_group(
    trials: &[&Trial],
    [least, most]: [&[f64]; 2],
    ceiling: f64,
    limit: f64,
    alpha: f64,
) -> Result<ByGroup, OutOfBounds> {
    let divisions = trials.first().map_or(0, |trial| trial.groups.len());
    if divisions == 0 {
        return Ok(ByGroup { ln_evidence: [0.0; 2], interval: Interval { low: 0.0, high: ceiling } });
    }
    let mut found = ByGroup { ln_evidence: [f64::INFINITY; 2], interval: Interval { low: ceiling, high: 0.0 } };
    for division in 0..divisions {
        let means = |values: &[f64]| {
            let groups = trials.iter().map(|trial| trial.groups[division]).max().map_or(0, |last| last + 1);
            let mut sums = vec![(0.0, 0_u64); groups];
            for (trial, value) in trials.iter().zip(values) {
                let of = &mut sums[trial.groups[division]];
                *of = (of.0 + value, of.1 + 1);
            }
            // The part of the episodes that a requirement is about may not occur in a group.
            let filled = sums.into_iter().filter(|(_, n)| *n > 0);
            filled.map(|(sum, n)| (sum / n as f64).min(ceiling)).collect::<Vec<f64>>()
        };
        let (low, high) = (means(least), means(most));
        let looks = [low.len()];
        let (low, high) = (BoundedMean::new(&low, &looks, ceiling)?, BoundedMean::new(&high, &looks, ceiling)?);
        let enough = looks[0] >= FEWEST;
        let evidence = [low.ln_evidence_above(limit), high.ln_evidence_below(limit)];
        for (least, of) in found.ln_evidence.iter_mut().zip(evidence) {
            *least = least.min(if enough { of } else { 0.0 });
        }
        found.interval.low = found.interval.low.min(low.interval(alpha).low);
        found.interval.high = found.interval.high.max(high.interval(alpha).high);
    }
    Ok(found)
}
