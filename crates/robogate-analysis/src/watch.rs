//! Episodes that are worth watching: typical failures with their nearest passing twins, the worst and the unexplained.

use robogate_core::{Better, TaskSpec};
use robogate_stats::format::{count, counted, number, percent};

use crate::distance::{Difference, sentence};
use crate::labels::{mode_label, parameter_label};
use crate::replay::{ReplayEpisode, ReplayReason, episode};
use crate::table::{Ending, EpisodeTable, ParameterColumn, categories};
use crate::{Analysis, AnalysisError, Source};

/// Maximum number of failure modes with a typical episode.
const MAX_MODES: usize = 4;
/// Maximum number of scenario groups with a failed episode.
const MAX_GROUPS: usize = 2;

/// An episode that is worth watching.
#[derive(Debug, Clone, PartialEq)]
pub struct WatchedEpisode {
    /// The reason as a heading.
    pub title: String,
    /// The reason as a sentence.
    pub why: String,
    /// The episode.
    pub episode: ReplayEpisode,
    /// The passing episode with the most similar parameters.
    pub twin: Option<Twin>,
}

/// The passing episode with the most similar parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// The episode.
    pub episode: ReplayEpisode,
    /// The largest differences, as a sentence.
    pub differences: String,
}

/// Selects at most `max` episodes that are worth watching, twins included. `analysis` is that of the source.
///
/// # Errors
/// If a column cannot be read.
pub fn worth_watching(source: &Source, analysis: &Analysis, max: usize) -> Result<Vec<WatchedEpisode>, AnalysisError> {
    let dictionary = source.dictionary();
    let table = EpisodeTable::read(dictionary)?;
    let space = Space::of(&table);
    let mut chosen: Vec<(usize, String, String)> = Vec::new();
    typical(&table, &space, &mut chosen);
    worst(&table, &dictionary.provenance().task, &mut chosen);
    unexplained(&table, analysis, &mut chosen);
    let (names, groups) = categories(dictionary, "group")?;
    weakest_groups(&table, &names, &groups, &mut chosen);
    if chosen.is_empty() {
        successes(&table, &space, &mut chosen);
    }
    let passing: Vec<usize> = (0..table.len()).filter(|row| table.outcome[*row] == Ending::Success).collect();
    let mut watched: Vec<WatchedEpisode> = Vec::new();
    let mut rows: Vec<usize> = Vec::new();
    for (row, title, why) in chosen {
        if rows.contains(&row) {
            continue;
        }
        let failed = matches!(table.outcome[row], Ending::Failure(_));
        let twin = if failed { space.nearest(row, &passing) } else { None };
        let wanted: Vec<usize> = [row].into_iter().chain(twin.filter(|twin| !rows.contains(twin))).collect();
        if rows.len() + wanted.len() > max {
            continue;
        }
        rows.extend(wanted);
        let twin = twin.map(|twin| Twin {
            episode: episode(&table, twin, String::new()),
            differences: space.differences(row, twin),
        });
        watched.push(WatchedEpisode { title, why, episode: episode(&table, row, String::new()), twin });
    }
    Ok(watched)
}

/// The parameters of all rows on scales from 0 to 1.
struct Space<'a> {
    columns: Vec<(&'a ParameterColumn, Vec<f64>)>,
}

impl<'a> Space<'a> {
    fn of(table: &'a EpisodeTable) -> Self {
        Self { columns: table.parameters.iter().map(|column| (column, scaled(column))).collect() }
    }

    /// Distance of a row from a point: Euclidean over numbers, and 1 for a different level.
    fn distance(&self, row: usize, point: &[f64]) -> f64 {
        let part = |((column, values), to): (&(&ParameterColumn, Vec<f64>), &f64)| {
            let off = column.kind.apart(values[row], *to);
            off * off
        };
        self.columns.iter().zip(point).map(part).sum()
    }

    /// The centre of rows: means of numbers, and the most frequent level.
    fn centre(&self, rows: &[usize]) -> Vec<f64> {
        let of = |(column, values): &(&ParameterColumn, Vec<f64>)| {
            if column.is_numeric() {
                return rows.iter().map(|row| values[*row]).sum::<f64>() / rows.len().max(1) as f64;
            }
            let mut counts: Vec<usize> = Vec::new();
            for row in rows {
                let level = values[*row].max(0.0) as usize;
                if counts.len() <= level {
                    counts.resize(level + 1, 0);
                }
                counts[level] += 1;
            }
            let most = counts.iter().copied().max().unwrap_or_default();
            counts.iter().position(|n| *n == most).unwrap_or_default() as f64
        };
        self.columns.iter().map(of).collect()
    }

    fn nearest_to(&self, point: &[f64], rows: &[usize]) -> Option<usize> {
        let distance = |row: &usize| self.distance(*row, point);
        rows.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// The nearest of `rows` to a row.
    fn nearest(&self, row: usize, rows: &[usize]) -> Option<usize> {
        let point: Vec<f64> = self.columns.iter().map(|(_, values)| values[row]).collect();
        self.nearest_to(&point, rows)
    }

    /// The largest differences between a failed episode and its twin.
    fn differences(&self, row: usize, twin: usize) -> String {
        sentence(self.columns.iter().map(|(column, _)| Difference {
            name: &column.name,
            kind: &column.kind,
            failed: column.values[row],
            passed: column.values[twin],
        }))
    }
}

/// The values of a column on a scale from 0 to 1; those of a categorical one are its levels.
fn scaled(column: &ParameterColumn) -> Vec<f64> {
    column.values.iter().map(|x| column.kind.position(*x)).collect()
}

/// Without failures: the most typical success and the slowest one.
fn successes(table: &EpisodeTable, space: &Space<'_>, chosen: &mut Vec<(usize, String, String)>) {
    let rows: Vec<usize> = (0..table.len()).filter(|row| table.outcome[*row] == Ending::Success).collect();
    if let Some(row) = space.nearest_to(&space.centre(&rows), &rows) {
        let why = format!(
            "No episode failed. The parameters are nearest to the average of {}.",
            counted(rows.len() as u64, "episode")
        );
        chosen.push((row, "Typical success".to_owned(), why));
    }
    let time = |row: &usize| table.time_s[*row].unwrap_or(f64::NEG_INFINITY);
    let slowest =
        rows.iter().copied().filter(|row| table.time_s[*row].is_some()).min_by(|a, b| time(b).total_cmp(&time(a)));
    if let Some(row) = slowest {
        chosen.push((row, "Slowest success".to_owned(), "The success with the longest time.".to_owned()));
    }
}

/// The failed episode nearest to the centre of each failure mode, the most frequent mode first.
fn typical(table: &EpisodeTable, space: &Space<'_>, chosen: &mut Vec<(usize, String, String)>) {
    let valid = table.outcome.iter().filter(|ending| **ending != Ending::Invalid).count();
    let mut modes: Vec<(usize, Vec<usize>)> = (0..table.modes.len()).map(|mode| (mode, Vec::new())).collect();
    for (row, ending) in table.outcome.iter().enumerate() {
        if let Ending::Failure(mode) = ending
            && let Some((_, rows)) = modes.get_mut(usize::from(*mode))
        {
            rows.push(row);
        }
    }
    modes.retain(|(_, rows)| !rows.is_empty());
    modes.sort_by(|a, b| b.1.len().cmp(&a.1.len()).then(a.0.cmp(&b.0)));
    for (mode, rows) in modes.iter().take(MAX_MODES) {
        let Some(row) = space.nearest_to(&space.centre(rows), rows) else { continue };
        let label = mode_label(table.mode(*mode));
        let why = format!(
            "The parameters are nearest to the average of {} with this outcome ({} of all).",
            counted(rows.len() as u64, "episode"),
            percent(rows.len() as f64 / valid.max(1) as f64)
        );
        chosen.push((row, format!("Typical {label}"), why));
    }
}

/// The failed episode with the worst measures: the highest mean rank over the measures with a preferred direction.
fn worst(table: &EpisodeTable, task: &TaskSpec, chosen: &mut Vec<(usize, String, String)>) {
    let mut sums: Vec<(f64, usize)> = vec![(0.0, 0); table.len()];
    let mut extremes: Vec<(usize, String)> = Vec::new();
    for spec in &task.measures {
        let Some(values) = table.measure(spec.name.as_str()) else { continue };
        let sign = match spec.better {
            Better::Lower => 1.0,
            Better::Higher => -1.0,
            Better::Neither => continue,
        };
        let mut ranked: Vec<(f64, usize)> =
            values.iter().enumerate().filter_map(|(row, x)| Some((sign * (*x)?, row))).collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let n = ranked.len().max(1) as f64;
        for (rank, (_, row)) in ranked.iter().enumerate() {
            sums[*row].0 += (rank + 1) as f64 / n;
            sums[*row].1 += 1;
        }
        extremes.extend(ranked.last().map(|(value, row)| {
            let name = parameter_label(spec.name.as_str());
            (*row, format!("{name} {} {}", number(sign * value), spec.unit).trim_end().to_owned())
        }));
    }
    let failed = |row: &usize| matches!(table.outcome[*row], Ending::Failure(_)) && sums[*row].1 > 0;
    let mean = |row: usize| sums[row].0 / sums[row].1 as f64;
    let Some(row) = (0..table.len()).filter(failed).min_by(|a, b| mean(*b).total_cmp(&mean(*a))) else { return };
    let most: Vec<&str> = extremes.iter().filter(|(at, _)| *at == row).map(|(_, text)| text.as_str()).collect();
    let mut why = "The failed episode with the worst measures on average.".to_owned();
    if !most.is_empty() {
        why = format!("{why} It has the worst value of all episodes: {}.", most.join(", "));
    }
    chosen.push((row, "Worst measures".to_owned(), why));
}

/// The episodes whose outcomes contradict the risk model most.
fn unexplained(table: &EpisodeTable, analysis: &Analysis, chosen: &mut Vec<(usize, String, String)>) {
    for group in &analysis.replay {
        let title = match group.reason {
            ReplayReason::UnexpectedFailure => "Unexplained failure",
            ReplayReason::UnexpectedSuccess => "Unexplained success",
            ReplayReason::Boundary | ReplayReason::Task | ReplayReason::Invalid => continue,
        };
        let Some(first) = group.episodes.first() else { continue };
        if let Some(row) = table.index.iter().position(|index| *index == first.index) {
            chosen.push((row, title.to_owned(), format!("{} ({})", group.why.trim_end_matches('.'), first.figure)));
        }
    }
}

/// The first failed episode of each scenario group with the lowest success rates.
fn weakest_groups(
    table: &EpisodeTable,
    names: &[String],
    codes: &[Option<u32>],
    chosen: &mut Vec<(usize, String, String)>,
) {
    let mut groups: Vec<(u64, u64, Option<usize>)> = vec![(0, 0, None); names.len()];
    for (row, code) in codes.iter().enumerate() {
        let Some(group) = code.and_then(|code| groups.get_mut(code as usize)) else { continue };
        match table.outcome[row] {
            Ending::Success => group.0 += 1,
            Ending::Failure(_) => group.2 = group.2.or(Some(row)),
            Ending::Invalid => continue,
        }
        group.1 += 1;
    }
    let rate = |at: &usize| groups[*at].0 as f64 / groups[*at].1.max(1) as f64;
    let mut order: Vec<usize> = (0..groups.len()).filter(|at| groups[*at].2.is_some()).collect();
    order.sort_by(|a, b| rate(a).total_cmp(&rate(b)).then(a.cmp(b)));
    for at in order.into_iter().take(MAX_GROUPS) {
        let (successes, n, row) = groups[at];
        let why = format!("The group succeeded in {} of {}.", count(successes), counted(n, "episode"));
        chosen.extend(row.map(|row| (row, format!("Weakest scenarios: {}", names[at].replace('_', " ")), why)));
    }
}
