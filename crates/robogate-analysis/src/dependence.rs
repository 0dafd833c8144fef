//! Rows of a sample that depend on each other.
//!
//! Clusters come from labels (the case of a suite, a scenario, a seed, a day, an operator, a session, a robot, a unit), from
//! columns that the user names, and from equal settings. If nothing identifies clusters, a test of neighbouring rows
//! looks for dependence in the order of the file; if it rejects, blocks of neighbouring rows are clusters.

use robogate_dictionary::results::{SOURCE_SEED, follows_order, groups_rows};
use robogate_stats::clusters::{
    Clusters, FEWEST, Grouping, LOW_POWER, NEIGHBOURS, RateByCluster, Setting, coarsest_first, equal_settings,
};
use robogate_stats::serial::blocks_of_neighbours;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::table::{EpisodeTable, ParameterColumn, ParameterKind, Sample};
use crate::{AnalysisError, Population};

/// The name of the division by the scenarios of a suite.
const CASE: &str = "case";
/// The name of the division by the groups of a suite, or by a column of results with this role.
const GROUP: &str = "group";
/// The name of the division by equal settings.
pub(crate) const EQUAL_SETTINGS: &str = "equal settings";

/// The clusters of the rows that all figures count, in the document of an analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ClusterReport {
    /// What identifies clusters, the coarsest first.
    pub groupings: Vec<GroupingReport>,
    /// The number of clusters that rates and boxes count: that of the first grouping.
    pub clusters: u64,
    /// Valid episodes in them.
    pub episodes: u64,
    /// Whether there are fewer than 8 clusters: no claim is made.
    pub too_few: bool,
    /// Whether there are fewer than 15 clusters: only large effects are found.
    pub low_power: bool,
    /// The p-value of the test of neighbouring rows, if blocks of these are the clusters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_p: Option<f64>,
}

/// One way in which rows are divided into clusters.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct GroupingReport {
    /// The column, `equal settings`, or `neighbouring rows`.
    pub by: String,
    /// The number of clusters.
    pub clusters: u64,
}

/// The clusters of a sample.
#[derive(Debug, Clone)]
pub(crate) struct Dependence {
    /// Divisions that do not contain each other, the coarsest first. At least one.
    pub(crate) groupings: Vec<Grouping>,
    /// Whether rates estimate new clusters. Those of a suite are rates of its own scenarios.
    pub(crate) new_clusters: bool,
    serial_p: Option<f64>,
}

impl Dependence {
    /// The clusters of `base`. `groups` are columns that the user names. Scenarios that are strata are not clusters. `None` if
    /// nothing indicates that rows depend on each other.
    pub(crate) fn of(
        table: &EpisodeTable,
        base: &Sample,
        population: Population,
        groups: &[String],
        has_strata: bool,
    ) -> Result<Option<Self>, AnalysisError> {
        let mut found = Vec::new();
        for name in groups {
            let clusters = labelled(table, base, name).ok_or_else(|| AnalysisError::Groups {
                name: name.clone(),
                known: base.parameters.iter().map(|p| p.name.clone()).chain([CASE, GROUP].map(str::to_owned)).collect(),
            })?;
            found.push(Grouping { by: name.clone(), clusters });
        }
        let known_population = matches!(population, Population::AsImported | Population::Suite);
        if groups.is_empty() && known_population && !has_strata {
            found.extend(known(table, base, population));
        }
        let mut serial_p = None;
        found.retain(|grouping| grouping.clusters.divides() || groups.contains(&grouping.by));
        if found.is_empty()
            && population == Population::AsImported
            && let Some((p, blocks)) = neighbours(base)
        {
            serial_p = Some(p);
            found.push(Grouping { by: NEIGHBOURS.to_owned(), clusters: blocks });
        }
        let groupings = coarsest_first(found);
        let new_clusters = population != Population::Suite || !groups.is_empty();
        Ok((!groupings.is_empty()).then_some(Self { groupings, new_clusters, serial_p }))
    }

    /// The coarsest division, which rates, models and boxes count.
    pub(crate) fn main(&self) -> &Clusters {
        &self.groupings[0].clusters
    }

    /// The division that explains most of a parameter's variance, and that share. The coarser one of two equal ones. A value that
    /// the scenarios of a suite draw anew in each episode is independent of them: their division, and no share.
    pub(crate) fn grouping_of(&self, parameter: &ParameterColumn) -> (&Clusters, f64) {
        let case = self.groupings.iter().find(|grouping| grouping.by == CASE).filter(|_| !self.new_clusters);
        if let Some(case) = case.filter(|case| varies_within(&case.clusters, parameter)) {
            return (&case.clusters, 0.0);
        }
        let levels = match &parameter.kind {
            ParameterKind::Categorical { levels } => Some(levels.len()),
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => None,
        };
        let mut best = (self.main(), f64::NEG_INFINITY);
        for grouping in &self.groupings {
            let share = grouping.clusters.between_share(&parameter.values, levels).unwrap_or(0.0);
            if share > best.1 + 1e-9 {
                best = (&grouping.clusters, share);
            }
        }
        best
    }

    /// The rate over new clusters of the rows for which `used` is true.
    pub(crate) fn rate(&self, base: &Sample, used: impl Fn(usize) -> bool + Copy) -> RateByCluster {
        let groupings: Vec<&Clusters> = self.groupings.iter().map(|grouping| &grouping.clusters).collect();
        RateByCluster::of(&groupings, &base.success, used)
    }

    /// How many independent rows one row counts for, from 0 to 1.
    pub(crate) fn share(&self, base: &Sample) -> f64 {
        let all = self.rate(base, |_| true);
        (all.effective / all.trials.n().max(1) as f64).clamp(0.0, 1.0)
    }

    /// The same clusters for a part of the rows.
    pub(crate) fn take(&self, rows: &[u32]) -> Self {
        let take = |grouping: &Grouping| Grouping {
            by: grouping.by.clone(),
            clusters: grouping.clusters.take(rows.iter().map(|row| *row as usize)),
        };
        Self { groupings: self.groupings.iter().map(take).collect(), ..self.clone() }
    }

    pub(crate) fn report(&self, base: &Sample) -> ClusterReport {
        let clusters = self.main().count();
        let report = |of: &Grouping| GroupingReport { by: of.by.clone(), clusters: of.clusters.count() as u64 };
        ClusterReport {
            groupings: self.groupings.iter().map(report).collect(),
            clusters: clusters as u64,
            episodes: base.len() as u64,
            too_few: clusters < FEWEST,
            low_power: clusters < LOW_POWER,
            serial_p: self.serial_p,
        }
    }
}

/// Why too few clusters allow no claim, as the end of a sentence. `None` if there are enough.
pub(crate) fn too_few(clusters: usize) -> Option<String> {
    (clusters < FEWEST)
        .then(|| format!("the rows come in {clusters} clusters, and a claim about others needs at least {FEWEST}"))
}

/// The clusters that a named column or the case of a suite gives. `None` if there is no such column.
fn labelled(table: &EpisodeTable, base: &Sample, name: &str) -> Option<Clusters> {
    if name == CASE {
        return table.cases.as_ref().map(|cases| Clusters::of_labels(base.rows.iter().map(|row| cases[*row as usize])));
    }
    if name == GROUP && !table.groups.is_empty() {
        return Some(Clusters::of_labels(base.rows.iter().map(|row| table.groups[*row as usize])));
    }
    let plain = |column: &ParameterColumn| column.name == name || (name == "seed" && column.name == SOURCE_SEED);
    let column = base.parameters.iter().chain(&base.identifiers).find(|column| plain(column))?;
    Some(by_value(column))
}

/// The scenarios of a suite that only say which parameters an episode draws, as those with one family of perturbations each do:
/// each parameter that differs between them is sampled in each episode of some of them. Their episodes are independent, but values of a
/// parameter can be compared only within one of them.
pub(crate) fn strata(table: &EpisodeTable, base: &Sample, population: Population) -> Option<Clusters> {
    let cases = labelled(table, base, CASE).filter(|cases| population == Population::Suite && cases.divides())?;
    let differs = |parameter: &&ParameterColumn| parameter.values.windows(2).any(|pair| pair[0] != pair[1]);
    let mut varied = base.parameters.iter().filter(differs).peekable();
    varied.peek()?;
    varied.all(|parameter| varies_within(&cases, parameter)).then_some(cases)
}

/// Whether a parameter has several values in one cluster.
fn varies_within(clusters: &Clusters, parameter: &ParameterColumn) -> bool {
    varying(clusters, parameter).contains(&true)
}

/// The clusters in which a parameter has several values.
pub(crate) fn varying(clusters: &Clusters, parameter: &ParameterColumn) -> Vec<bool> {
    let mut first = vec![None; clusters.count()];
    let mut varies = vec![false; clusters.count()];
    for (cluster, value) in clusters.of_row().iter().zip(&parameter.values) {
        varies[*cluster] |= *first[*cluster].get_or_insert(value) != value;
    }
    varies
}

/// Rows with equal values of a column are one cluster.
fn by_value(column: &ParameterColumn) -> Clusters {
    Clusters::of_labels(column.values.iter().map(|v| v.to_bits()))
}

/// Divisions that labels and settings identify.
fn known(table: &EpisodeTable, base: &Sample, population: Population) -> Vec<Grouping> {
    let mut found = Vec::new();
    if let Some(clusters) = labelled(table, base, CASE) {
        found.push(Grouping { by: CASE.to_owned(), clusters });
    }
    for column in base.parameters.iter().filter(|column| groups_rows(&column.name)) {
        found.push(Grouping { by: column.name.clone(), clusters: by_value(column) });
    }
    let settings: Vec<Setting<'_>> = base.parameters.iter().filter(|p| !groups_rows(&p.name)).map(setting).collect();
    let equal = match population {
        Population::Suite => {
            let bits = |row: usize| base.parameters.iter().map(|p| p.values[row].to_bits()).collect::<Vec<_>>();
            Some(Clusters::of_labels((0..base.len()).map(bits)))
        }
        _ => equal_settings(&settings),
    };
    if let Some(clusters) = equal {
        found.push(Grouping { by: EQUAL_SETTINGS.to_owned(), clusters });
    }
    // A seed that occurs at several settings is the number of a repeat.
    if let Some(seed) = base.identifiers.iter().find(|column| column.name == SOURCE_SEED) {
        let clusters = by_value(seed);
        let constant =
            |p: &ParameterColumn| clusters.between_share(&p.values, None).is_none_or(|share| share > 1.0 - 1e-6);
        let settings = base.parameters.iter().filter(|p| !groups_rows(&p.name)).all(constant);
        let crossed = found.iter().any(|other| other.clusters.divides() && !clusters.is_within(&other.clusters));
        if settings && !crossed {
            found.push(Grouping { by: "seed".to_owned(), clusters });
        }
    }
    found
}

fn setting(column: &ParameterColumn) -> Setting<'_> {
    match column.kind {
        ParameterKind::Categorical { .. } => Setting::Levels(&column.values),
        ParameterKind::Continuous { log: true, low, .. } if low > 0.0 => Setting::Logarithmic(&column.values),
        ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => Setting::Numbers(&column.values),
    }
}

/// Blocks of neighbouring rows, and the p-value of the test, if rows depend on their neighbours.
fn neighbours(base: &Sample) -> Option<(f64, Clusters)> {
    let explains = base.parameters.iter().filter(|column| !follows_order(&column.name));
    let columns: Vec<&[f64]> = explains.clone().map(|column| column.values.as_slice()).collect();
    let numeric: Vec<&[f64]> =
        explains.filter(|column| column.is_numeric()).map(|column| column.values.as_slice()).collect();
    blocks_of_neighbours(&base.success, &columns, &numeric)
}
