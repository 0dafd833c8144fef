//! One parameter cut in the same way for every dictionary.

use robogate_stats::Trials;
use robogate_stats::binning::Edges;

use crate::comparison::entrant::Entrant;
use crate::labels::parameter_label;
use crate::rows::{ParameterColumn, ParameterKind};
use crate::{Axis, Population};
use robogate_stats::format::{list, range};

/// More levels of a whole number than this are cut into bins.
const MOST_LEVELS: i64 = 16;

/// A parameter that every dictionary has, over what all of them cover.
pub(crate) struct SharedAxis {
    pub(crate) axis: Axis,
    /// What is not shared of it, as a sentence.
    pub(crate) remark: Option<String>,
    cut: Cut,
}

enum Cut {
    Edges(Edges),
    Words(Vec<String>),
}

impl SharedAxis {
    /// Cuts the part of `parameter` that all of `entrants` cover into `bins` or its levels.
    ///
    /// # Errors
    /// Why it is not shared, as the end of a sentence.
    pub(crate) fn of(entrants: &[&Entrant<'_>], parameter: &str, bins: usize) -> Result<Self, String> {
        let columns: Vec<&ParameterColumn> = entrants.iter().filter_map(|e| e.parameter(parameter)).collect();
        if columns.len() != entrants.len() {
            return Err("not every dictionary has it".to_owned());
        }
        if columns.iter().all(|column| !column.is_numeric()) {
            return Self::words(parameter, &columns);
        }
        if columns.iter().any(|column| !column.is_numeric()) {
            return Err("it is a word in one dictionary and a number in another".to_owned());
        }
        let spans: Vec<[f64; 2]> = columns.iter().map(|column| span(column)).collect();
        let [low, high] = common(&spans, entrants.iter().any(|e| e.population == Population::AsImported));
        let remark = spans.iter().any(|s| s[0] < low || s[1] > high).then(|| {
            format!(
                "Only {} of {} is covered by every dictionary; rows outside are left out.",
                range([low, high]),
                parameter_label(parameter)
            )
        });
        let whole = columns.iter().all(|column| matches!(column.kind, ParameterKind::Integer { .. }));
        if whole && low <= high && high - low < MOST_LEVELS as f64 {
            let levels: Vec<String> = (low as i64..=high as i64).map(|level| level.to_string()).collect();
            let edges = (0..=levels.len()).map(|i| low - 0.5 + i as f64).collect();
            let edges = Edges::new(edges).map_err(|error| error.to_string())?;
            let axis = Axis { parameter: parameter.to_owned(), edges: Vec::new(), levels, log: false };
            return Ok(Self { axis, remark, cut: Cut::Edges(edges) });
        }
        let log = columns.iter().all(|c| matches!(c.kind, ParameterKind::Continuous { log: true, .. })) && low > 0.0;
        let at = |i: usize| {
            let u = i as f64 / bins as f64;
            match i {
                0 => low,
                i if i == bins => high,
                _ if log => (low.ln() + u * (high.ln() - low.ln())).exp(),
                _ => low + u * (high - low),
            }
        };
        let edges = Edges::new((0..=bins).map(at).collect()).map_err(|_| "they have no range in common".to_owned())?;
        let axis = Axis { parameter: parameter.to_owned(), edges: edges.as_slice().to_vec(), levels: Vec::new(), log };
        Ok(Self { axis, remark, cut: Cut::Edges(edges) })
    }

    fn words(parameter: &str, columns: &[&ParameterColumn]) -> Result<Self, String> {
        let of = |column: &ParameterColumn| match &column.kind {
            ParameterKind::Categorical { words } => words.clone(),
            _ => Vec::new(),
        };
        let mut every: Vec<String> = Vec::new();
        for word in columns.iter().flat_map(|column| of(column)) {
            if !every.contains(&word) {
                every.push(word);
            }
        }
        let (levels, rest): (Vec<String>, Vec<String>) =
            every.into_iter().partition(|word| columns.iter().all(|column| of(column).contains(word)));
        if levels.is_empty() {
            return Err("they have no level in common".to_owned());
        }
        let remark = (!rest.is_empty()).then(|| {
            format!(
                "Not every dictionary has the {} {}; their rows are left out.",
                parameter_label(parameter),
                list(&rest)
            )
        });
        let axis = Axis { parameter: parameter.to_owned(), edges: Vec::new(), levels: levels.clone(), log: false };
        Ok(Self { axis, remark, cut: Cut::Words(levels) })
    }

    /// How many cells it has.
    pub(crate) fn cells(&self) -> usize {
        self.axis.cells()
    }

    /// The cell of each row of a dictionary's sample; `None` outside what is shared.
    pub(crate) fn places(&self, column: &ParameterColumn) -> Vec<Option<usize>> {
        match (&self.cut, &column.kind) {
            (Cut::Edges(edges), _) => column.values.iter().map(|value| edges.bin(*value)).collect(),
            (Cut::Words(levels), ParameterKind::Categorical { words }) => {
                let places: Vec<Option<usize>> =
                    words.iter().map(|word| levels.iter().position(|level| level == word)).collect();
                column.codes().into_iter().map(|code| places.get(code).copied().flatten()).collect()
            }
            (Cut::Words(_), _) => vec![None; column.values.len()],
        }
    }

    /// Successes per cell of one dictionary.
    pub(crate) fn trials(&self, entrant: &Entrant<'_>) -> Vec<Trials> {
        match entrant.parameter(&self.axis.parameter) {
            Some(column) => tally(&self.places(column), &entrant.base.success, self.cells()),
            None => vec![Trials::NONE; self.cells()],
        }
    }

    /// Successes per cell of this parameter and `across`, which runs fastest.
    pub(crate) fn trials_with(&self, across: &Self, entrant: &Entrant<'_>) -> Vec<Trials> {
        let cells = self.cells() * across.cells();
        let columns = (entrant.parameter(&self.axis.parameter), entrant.parameter(&across.axis.parameter));
        let (Some(up), Some(to)) = columns else { return vec![Trials::NONE; cells] };
        let places: Vec<Option<usize>> = self
            .places(up)
            .into_iter()
            .zip(across.places(to))
            .map(|(row, column)| Some(row? * across.cells() + column?))
            .collect();
        tally(&places, &entrant.base.success, cells)
    }

    /// The edges of one cell; `None` for a level.
    pub(crate) fn range(&self, at: usize) -> Option<[f64; 2]> {
        match self.axis.edges.get(at..at + 2) {
            Some([low, high]) => Some([*low, *high]),
            _ => None,
        }
    }
}

/// What all spans cover. Ends of an imported dictionary are those of its rows and hang on chance: ends that lie within
/// 0.5 % of the widest span are one, and no row is left out for them.
fn common(spans: &[[f64; 2]], observed: bool) -> [f64; 2] {
    let ends = |at: usize| spans.iter().map(move |span| span[at]);
    let least = |at: usize| ends(at).fold(f64::INFINITY, f64::min);
    let most = |at: usize| ends(at).fold(f64::NEG_INFINITY, f64::max);
    let widest = spans.iter().map(|span| span[1] - span[0]).fold(0.0, f64::max);
    let alike = |at: usize| observed && most(at) - least(at) <= 0.005 * widest;
    [if alike(0) { least(0) } else { most(0) }, if alike(1) { most(1) } else { least(1) }]
}

fn span(column: &ParameterColumn) -> [f64; 2] {
    match &column.kind {
        ParameterKind::Continuous { low, high, .. } => [*low, *high],
        ParameterKind::Integer { low, high } => [*low as f64, *high as f64],
        ParameterKind::Categorical { .. } => [f64::NEG_INFINITY, f64::INFINITY],
    }
}

fn tally(places: &[Option<usize>], success: &[bool], cells: usize) -> Vec<Trials> {
    let mut counts = vec![(0, 0); cells];
    for (place, success) in places.iter().zip(success) {
        if let Some((successes, n)) = place.and_then(|place| counts.get_mut(place)) {
            *successes += u64::from(*success);
            *n += 1;
        }
    }
    // No more successes than rows, by the way they were counted.
    counts.into_iter().map(|(successes, n)| Trials::new(successes, n).unwrap_or(Trials::NONE)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observed_ends_that_nearly_meet_are_one_and_asked_for_ends_are_not() {
        let spans = [[0.0, 100.0], [0.3, 99.8]];
        assert_eq!(common(&spans, true), [0.0, 100.0]);
        assert_eq!(common(&spans, false), [0.3, 99.8]);
        assert_eq!(common(&[[0.0, 100.0], [2.0, 99.8]], true), [2.0, 100.0]);
    }
}
