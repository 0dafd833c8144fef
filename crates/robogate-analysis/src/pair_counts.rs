//! Numbers of successes over any two parameters, for a page with a map that the reader chooses.

use crate::pairs::{Axis, axis, bins_for};
use crate::table::EpisodeTable;
use crate::weighting::Counted;
use crate::{Analysis, AnalysisError, Source};

/// Maximum number of parameters, which gives 120 pairs.
const MAX_PARAMETERS: usize = 16;
/// Maximum number of episodes that the page can list by cell.
const MAX_LISTED: usize = 20_000;

/// Numbers of successes over all pairs of parameters.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PairCounts {
    /// The parameters with their bins, the strongest effect first.
    pub axes: Vec<Axis>,
    /// For each pair (first, second) of axes with first before second, in order: episodes and successes of each cell, row
    /// by row from the lowest value of the first; the second varies fastest.
    pub pairs: Vec<Vec<[u64; 2]>>,
    /// Episodes that the cells list: at equal distances, if there are too many for a page.
    pub listed: Vec<ListedEpisode>,
    /// The outcomes that occur among the listed episodes.
    pub outcomes: Vec<String>,
}

/// An episode with its place on every axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedEpisode {
    /// Its index in the run.
    pub index: u64,
    /// Index of its outcome in [`PairCounts::outcomes`].
    pub outcome: usize,
    /// The cell on each axis, from 0. `None` outside the axis.
    pub cells: Vec<Option<usize>>,
}

/// Counts successes over all pairs of the parameters with the strongest effects. `analysis` is that of the source.
///
/// # Errors
/// If a column cannot be read.
pub fn pair_counts(source: &Source, analysis: &Analysis) -> Result<PairCounts, AnalysisError> {
    let table = EpisodeTable::read(source.dictionary())?;
    let base = Counted::of(&table, source.boundary()).base;
    let bins = bins_for(base.len());
    let strength = |name: &str| {
        let effect = analysis.marginal_effects.iter().find(|effect| effect.parameter == name);
        effect.and_then(|effect| effect.correlation.estimated()).map_or(0.0, |found| found.strength())
    };
    let mut columns: Vec<_> = base.parameters.iter().filter_map(|column| Some((column, axis(column, bins)?))).collect();
    columns.sort_by(|a, b| strength(&b.0.name).total_cmp(&strength(&a.0.name)));
    columns.truncate(MAX_PARAMETERS);
    let mut pairs = Vec::new();
    for (i, (up, (_, y))) in columns.iter().enumerate() {
        for (across, (_, x)) in &columns[i + 1..] {
            let cell = |row: usize| Some(y.bin(up.values[row])? * x.bins() + x.bin(across.values[row])?);
            let cells = base.effective_cells(y.bins() * x.bins(), cell);
            pairs.push(cells.iter().map(|trials| [trials.n(), trials.successes()]).collect());
        }
    }
    let mut outcomes: Vec<String> = Vec::new();
    let step = base.len().div_ceil(MAX_LISTED).max(1);
    let listed = (0..base.len()).step_by(step).map(|at| {
        let row = base.rows[at] as usize;
        let name = table.outcome_name(table.outcome[row]);
        let outcome = outcomes.iter().position(|known| *known == name).unwrap_or_else(|| {
            outcomes.push(name.to_owned());
            outcomes.len() - 1
        });
        let cells = columns.iter().map(|(column, (_, edges))| edges.bin(column.values[at])).collect();
        ListedEpisode { index: table.index[row], outcome, cells }
    });
    let listed = listed.collect();
    Ok(PairCounts { listed, outcomes, axes: columns.into_iter().map(|(_, (axis, _))| axis).collect(), pairs })
}
