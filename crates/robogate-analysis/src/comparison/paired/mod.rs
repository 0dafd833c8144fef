//! Paired comparison of two datasets that ran the same scenarios.

mod cross_table;
mod disagreement;
mod flips;
mod keys;
mod rows;

use robogate_stats::clusters::paired_clusters;
use robogate_stats::compare::Pairs;
use robogate_stats::{Trials, difference};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use cross_table::CrossTable;
pub use disagreement::{DisagreementCell, DisagreementMap};
pub use flips::Flip;

use crate::AnalysisError;
use crate::comparison::ComparisonError;
use crate::comparison::dataset::Dataset;
use crate::comparison::differences::{ERROR, adjusted, level};
use crate::rate::{Finding, Rate, ends};
use crate::table::Ending;
use rows::{Design, PairedRows};

/// Two datasets with the same scenarios. Rows of focused stages are excluded, because each campaign chooses its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairedComparison {
    /// Name of the first.
    pub first: String,
    /// Name of the second.
    pub second: String,
    /// Scenarios that both ran.
    pub scenarios: u64,
    /// The columns by which imported rows were paired: case, seed, otherwise all parameters. Absent for runs with the same design.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paired_by: Vec<String>,
    /// Imported rows of either dataset without a partner. They are excluded.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unpaired: u64,
    /// Scenarios that are valid in both. All figures below apply to them.
    pub valid_pairs: u64,
    /// Both succeeded.
    pub both: u64,
    /// Only the first succeeded.
    pub first_only: u64,
    /// Only the second succeeded.
    pub second_only: u64,
    /// Neither succeeded.
    pub neither: u64,
    /// Success rate of the first.
    pub first_rate: Rate,
    /// Success rate of the second.
    pub second_rate: Rate,
    /// First rate minus second. `None` without valid pairs.
    pub difference: Option<f64>,
    /// Interval of the difference at 95 % for all pairs of datasets together (Bonferroni). It excludes 0 if and only if
    /// `adjusted_p` is at most 0.05, because both come from one score test.
    pub difference_95: [f64; 2],
    /// The clusters that the test counts, if rows depend on each other: the difference then applies to new scenarios of the
    /// same kind, and not to exactly these. Absent if it counts episodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clusters: Option<u64>,
    /// ln of the two-sided p-value of equal rates, for this pair of datasets alone.
    pub ln_p: f64,
    /// The p-value, adjusted by Bonferroni over all pairs of datasets.
    pub adjusted_p: f64,
    /// Invalid scenarios, and the bounds that they leave.
    pub invalid: PairedInvalid,
    /// Cross table of the outcomes.
    pub outcomes: CrossTable,
    /// Where the outcomes differ, over two parameters.
    pub disagreement: Finding<DisagreementMap>,
    /// Scenarios with different outcomes: the first ones of each direction.
    pub flips: Vec<Flip>,
}

impl PairedComparison {
    /// Whether the rates differ significantly.
    pub fn is_significant(&self) -> bool {
        self.adjusted_p <= ERROR
    }

    /// How imported rows were paired, as a sentence. `None` for runs with the same design.
    pub fn how_paired(&self) -> Option<String> {
        let by = Some(self.paired_by.join(", ")).filter(|by| !by.is_empty())?;
        let left_out = match self.unpaired {
            0 => String::new(),
            1 => " 1 row without a partner is left out.".to_owned(),
            n => format!(" {n} rows without a partner are left out."),
        };
        Some(format!("Pairs are rows with the same {by}.{left_out}"))
    }

    /// Whether both succeeded equally often.
    pub fn is_tie(&self) -> bool {
        self.valid_pairs > 0 && self.first_only == self.second_only
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// Scenarios that are invalid in one of the two.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairedInvalid {
    /// Invalid in the first.
    pub first: u64,
    /// Invalid in the second.
    pub second: u64,
    /// Invalid in at least one: excluded from every rate.
    pub either: u64,
    /// Bounds of the difference over all scenarios, for all possible outcomes of the invalid episodes.
    pub difference_bounds: Option<[f64; 2]>,
}

/// The scenarios that both datasets ran. `None` if the designs differ.
pub(crate) fn same_scenarios(first: &Dataset<'_>, second: &Dataset<'_>) -> Result<Option<Pairs>, AnalysisError> {
    if first.unpaired().or_else(|| second.unpaired()).is_some() {
        return Ok(None);
    }
    let (one, two) = (Design::of(first)?, Design::of(second)?);
    Ok(PairedRows::of(first, &one, second, &two).ok().map(|pairs| pairs.counts()))
}

/// Compares each pair of datasets scenario by scenario.
pub(crate) fn paired(
    datasets: &[&Dataset<'_>],
    pair: Option<(&str, &str)>,
    max_flips: usize,
) -> Result<Vec<PairedComparison>, ComparisonError> {
    if let Some((name, why)) = datasets.iter().find_map(|of| Some((of.name.clone(), of.unpaired()?))) {
        return Err(ComparisonError::NoPairs { name, why });
    }
    let designs = datasets.iter().map(|dataset| Design::of(dataset));
    let designs: Vec<Design> = designs.collect::<Result<_, _>>().map_err(AnalysisError::from)?;
    let family = datasets.len() * datasets.len().saturating_sub(1) / 2;
    let mut found = Vec::new();
    for (i, first) in datasets.iter().enumerate() {
        for (j, second) in datasets.iter().enumerate().skip(i + 1) {
            match PairedRows::of(first, &designs[i], second, &designs[j]) {
                Ok(pairs) => found.push(compared(&pairs, pair, max_flips, family)),
                Err(difference) => {
                    let (first, second) = (first.name.clone(), second.name.clone());
                    return Err(ComparisonError::NotTheSameDesign { first, second, difference });
                }
            }
        }
    }
    Ok(found)
}

fn compared(pairs: &PairedRows<'_>, pair: Option<(&str, &str)>, max_flips: usize, family: usize) -> PairedComparison {
    let counts = pairs.counts();
    let by_cluster = by_cluster(pairs);
    let difference = match &by_cluster {
        Some([one, two]) => paired_clusters(one, two, level(family)),
        None => difference::paired(counts, level(family)),
    };
    let rate = |successes| Rate::of(Trials::new(successes, counts.n()).unwrap_or(Trials::NONE));
    PairedComparison {
        first: pairs.first.name.clone(),
        second: pairs.second.name.clone(),
        scenarios: pairs.rows.len() as u64,
        paired_by: pairs.by.clone(),
        unpaired: pairs.unpaired,
        valid_pairs: counts.n(),
        both: counts.both,
        first_only: counts.first_only,
        second_only: counts.second_only,
        neither: counts.neither,
        first_rate: rate(counts.both + counts.first_only),
        second_rate: rate(counts.both + counts.second_only),
        difference: difference.estimate,
        difference_95: ends(difference.interval),
        clusters: by_cluster.map(|[one, _]| one.iter().filter(|trials| trials.n() > 0).count() as u64),
        ln_p: difference.ln_p.max(f64::MIN),
        adjusted_p: adjusted(difference.ln_p, family),
        invalid: invalid(pairs),
        outcomes: CrossTable::of(pairs),
        disagreement: disagreement::disagreement(pairs, pair),
        flips: flips::flips(pairs, max_flips),
    }
}

/// The outcomes of both in each cluster of the first, over the pairs that are valid in both. `None` if its rows are independent,
/// or those of chosen scenarios.
fn by_cluster(pairs: &PairedRows<'_>) -> Option<[Vec<Trials>; 2]> {
    let base = &pairs.first.base;
    let dependence = base.dependence.as_ref().filter(|of| of.new_clusters)?;
    let mut counts = vec![[0_u64; 3]; dependence.main().count()];
    for at in &pairs.rows {
        let (Ok(row), (one, two)) = (base.rows.binary_search(&(at.0 as u32)), pairs.endings(*at)) else { continue };
        if two != Ending::Invalid {
            let cell = &mut counts[dependence.main().of_row()[row]];
            cell[0] += 1;
            cell[1] += u64::from(one == Ending::Success);
            cell[2] += u64::from(two == Ending::Success);
        }
    }
    let of = |which: usize| counts.iter().map(|c| Trials::new(c[which], c[0]).unwrap_or(Trials::NONE)).collect();
    Some([of(1), of(2)])
}

fn invalid(pairs: &PairedRows<'_>) -> PairedInvalid {
    let mut found = PairedInvalid { first: 0, second: 0, either: 0, difference_bounds: None };
    let mut bounds = [0_i64; 2];
    for at in &pairs.rows {
        let (one, two) = pairs.endings(*at);
        found.first += u64::from(one == Ending::Invalid);
        found.second += u64::from(two == Ending::Invalid);
        found.either += u64::from(one == Ending::Invalid || two == Ending::Invalid);
        let ([low_one, high_one], [low_two, high_two]) = (possible(one), possible(two));
        bounds[0] += low_one - high_two;
        bounds[1] += high_one - low_two;
    }
    let share = |bound: i64| bound as f64 / pairs.rows.len() as f64;
    found.difference_bounds = (found.either > 0).then(|| bounds.map(share));
    found
}

/// The possible values of success as 0 or 1. Both for an invalid episode.
fn possible(ending: Ending) -> [i64; 2] {
    match ending {
        Ending::Success => [1, 1],
        Ending::Failure(_) => [0, 0],
        Ending::Invalid => [0, 1],
    }
}
