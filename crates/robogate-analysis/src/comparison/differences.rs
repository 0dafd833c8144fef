//! Differences of success rates between pairs of datasets: paired if both ran the same scenarios.

use std::collections::BTreeMap;

use robogate_dictionary::results::SOURCE_SEED;
use robogate_stats::clusters::NEIGHBOURS;
use robogate_stats::clusters::{FEWEST, independent_clusters, paired_clusters};
use robogate_stats::compare::Pairs;
use robogate_stats::difference::{ScoreDifference, independent, paired};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::comparison::dataset::Dataset;
use crate::comparison::paired::same_scenarios;
use crate::dependence::EQUAL_SETTINGS;
use crate::rate::ends;
use crate::table::{ParameterColumn, categories};

/// The difference of two success rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RateDifference {
    /// Name of the first dataset.
    pub first: String,
    /// Name of the second dataset.
    pub second: String,
    /// First rate minus second. A paired difference uses the scenarios that are valid in both.
    pub difference: f64,
    /// Interval of the difference at 95 % for all pairs of datasets together (Bonferroni). It excludes 0 if and only if
    /// `adjusted_p` is at most 0.05, because both come from one score test.
    pub interval_95: [f64; 2],
    /// Scenarios that are valid in both, if the difference is paired; absent for independent runs.
    #[serde(default)]
    pub valid_pairs: Option<u64>,
    /// The clusters that the test counts, if rows depend on each other: the difference then applies to new scenarios of the
    /// same kind, and not to exactly these. Absent if it counts episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clusters: Option<u64>,
    /// ln of the two-sided p-value of equal rates, for this pair alone.
    pub ln_p: f64,
    /// The p-value, adjusted by Bonferroni over all pairs of datasets.
    pub adjusted_p: f64,
}

impl RateDifference {
    /// The name of the test.
    pub fn test(&self) -> &'static str {
        if self.valid_pairs.is_some() { "paired" } else { "independent" }
    }

    /// Whether the rates differ significantly.
    pub fn is_significant(&self) -> bool {
        self.adjusted_p <= ERROR
    }

    /// Whether both succeeded equally often.
    pub fn is_tie(&self) -> bool {
        self.difference.abs() <= 0.0
    }
}

/// Joint error of all differences.
pub(crate) const ERROR: f64 = 0.05;

/// The adjusted p-value of one of `family` differences.
pub(crate) fn adjusted(ln_p: f64, family: usize) -> f64 {
    (ln_p.exp() * family.max(1) as f64).min(1.0)
}

/// The level of one of `family` intervals that hold together at 95 %.
pub(crate) fn level(family: usize) -> Confidence {
    Confidence::new(1.0 - ERROR / family.max(1) as f64).unwrap_or(Confidence::P95)
}

pub(crate) fn differences(datasets: &[&Dataset<'_>]) -> Result<Vec<RateDifference>, AnalysisError> {
    let family = datasets.len() * datasets.len().saturating_sub(1) / 2;
    let mut found = Vec::new();
    for (i, first) in datasets.iter().enumerate() {
        for second in &datasets[i + 1..] {
            found.push(between(first, second, family)?);
        }
    }
    Ok(found)
}

fn between(first: &Dataset<'_>, second: &Dataset<'_>, family: usize) -> Result<RateDifference, AnalysisError> {
    let pairs: Option<Pairs> = same_scenarios(first, second)?.filter(|pairs| pairs.n() > 0);
    let by_cluster = clustered(first, second, pairs.is_some(), level(family))?;
    let clusters = by_cluster.map(|(_, clusters)| clusters);
    let difference: ScoreDifference = if let Some((difference, _)) = by_cluster {
        difference
    } else if let Some(pairs) = pairs {
        paired(pairs, level(family))
    } else {
        let [one, two] = [first, second].map(|of| of.base.effective(|_| true));
        independent(one, two, level(family))
    };
    Ok(RateDifference {
        first: first.name.clone(),
        second: second.name.clone(),
        // Only datasets with valid episodes are compared, so the estimate exists.
        difference: difference.estimate.unwrap_or_default(),
        interval_95: ends(difference.interval),
        valid_pairs: pairs.map(|pairs| pairs.n()),
        clusters,
        ln_p: difference.ln_p.max(f64::MIN),
        adjusted_p: adjusted(difference.ln_p, family),
    })
}

/// The difference by clusters, and their number. `None` if the rows of both are independent, or those of chosen scenarios.
fn clustered(
    first: &Dataset<'_>,
    second: &Dataset<'_>,
    paired: bool,
    confidence: Confidence,
) -> Result<Option<(ScoreDifference, u64)>, AnalysisError> {
    let of = |dataset: &Dataset<'_>| dataset.base.dependence.as_ref().is_some_and(|of| of.new_clusters);
    if !of(first) && !of(second) {
        return Ok(None);
    }
    let (one, two) = (labelled(first)?, labelled(second)?);
    let shared: Vec<&Vec<String>> = one.keys().filter(|name| two.contains_key(*name)).collect();
    // The same scenarios in both: their differences are compared, even if the runs of each differ.
    if paired || (2 * shared.len() > one.len().max(two.len()) && shared.len() >= FEWEST.min(one.len())) {
        let rates = |of: &BTreeMap<Vec<String>, Trials>| shared.iter().map(|name| of[*name]).collect::<Vec<Trials>>();
        return Ok(Some((paired_clusters(&rates(&one), &rates(&two), confidence), shared.len() as u64)));
    }
    let rates = |of: BTreeMap<Vec<String>, Trials>| of.into_values().collect::<Vec<Trials>>();
    let clusters = one.len().min(two.len()) as u64;
    Ok(Some((independent_clusters(&rates(one), &rates(two), confidence), clusters)))
}

/// The outcomes of each cluster by its name: the case with its category and group, the settings, or the value of the column that
/// identifies clusters. Blocks of neighbouring rows have names that no other dataset has.
fn labelled(dataset: &Dataset<'_>) -> Result<BTreeMap<Vec<String>, Trials>, AnalysisError> {
    let base = &dataset.base;
    let Some(clusters) = base.clusters() else {
        // Each row is its own cluster.
        let rows = base.success.iter().enumerate();
        return Ok(rows.map(|(row, success)| (vec![row.to_string()], Trials::count([*success]))).collect());
    };
    let trials = clusters.trials(&base.success, |_| true);
    let by = base.dependence.as_ref().map_or("", |of| of.groupings[0].by.as_str());
    let mut words = Vec::new();
    if by == "case" {
        for column in ["case", "category", "group"] {
            words.push(categories(dataset.source.dictionary(), column)?);
        }
    }
    let mut names: Vec<Option<Vec<String>>> = vec![None; clusters.count()];
    for (at, cluster) in clusters.of_row().iter().enumerate() {
        let row = base.rows[at] as usize;
        let label = || -> Vec<String> {
            if by == NEIGHBOURS {
                return vec![dataset.name.clone(), cluster.to_string()];
            }
            if words.is_empty() {
                let seed = |p: &ParameterColumn| by == "seed" && p.name == SOURCE_SEED;
                let named = |p: &&ParameterColumn| by == EQUAL_SETTINGS || p.name == by;
                let columns = base.parameters.iter().filter(named).chain(base.identifiers.iter().filter(|p| seed(p)));
                return columns.map(|p| p.exactly(p.values[at])).collect();
            }
            let word = |(words, codes): &(Vec<String>, Vec<Option<u32>>)| {
                let code = codes.get(row).copied().flatten();
                code.map_or_else(String::new, |code| words[code as usize].clone())
            };
            words.iter().map(word).collect()
        };
        names[*cluster].get_or_insert_with(label);
    }
    Ok(names.into_iter().zip(trials).filter_map(|(name, trials)| Some((name?, trials))).collect())
}
