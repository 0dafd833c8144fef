//! One parameter, binned in the same way for every dataset.

use robogate_stats::Trials;
use robogate_stats::binning::Edges;

use crate::comparison::dataset::Dataset;
use crate::labels::parameter_label;
use crate::table::{ParameterColumn, ParameterKind};
use crate::{Axis, Population};
use robogate_stats::format::{list, range};

/// An integer parameter with at least this many levels is cut into bins.
const MAX_LEVELS: i64 = 16;

/// The probability of the differences between observed ends that chance explains.
const SAME_END: f64 = 0.01;

/// A parameter that all datasets have, over the range that all of them cover.
pub(crate) struct SharedAxis {
    pub(crate) axis: Axis,
    /// A sentence on the part of it that is not shared.
    pub(crate) remark: Option<String>,
    bins: Bins,
}

enum Bins {
    Edges(Edges),
    Levels(Vec<String>),
}

impl SharedAxis {
    /// Divides the part of `parameter` that all of `datasets` cover into `bins` or its levels.
    ///
    /// # Errors
    /// The reason why it is not shared, as the end of a sentence.
    pub(crate) fn of(datasets: &[&Dataset<'_>], parameter: &str, bins: usize) -> Result<Self, String> {
        let columns: Vec<&ParameterColumn> = datasets.iter().filter_map(|e| e.parameter(parameter)).collect();
        if columns.len() != datasets.len() {
            return Err("not every dataset has it".to_owned());
        }
        if columns.iter().all(|column| !column.is_numeric()) {
            return Self::levels(parameter, &columns);
        }
        if columns.iter().any(|column| !column.is_numeric()) {
            return Err("it is categorical in one dataset and numeric in another".to_owned());
        }
        let spans: Vec<[f64; 2]> = columns.iter().map(|column| span(column)).collect();
        let observed = datasets.iter().any(|e| e.population == Population::AsImported);
        let [low, high] = if observed { observed_range(&columns) } else { shared_range(&spans) };
        let remark = spans.iter().any(|s| s[0] < low || s[1] > high).then(|| {
            format!(
                "Only {} of {} is covered by every dataset; rows outside are excluded.",
                range([low, high]),
                parameter_label(parameter)
            )
        });
        let whole = columns.iter().all(|column| matches!(column.kind, ParameterKind::Integer { .. }));
        if whole && low <= high && high - low < MAX_LEVELS as f64 {
            let levels: Vec<String> = (low as i64..=high as i64).map(|level| level.to_string()).collect();
            let edges = (0..=levels.len()).map(|i| low - 0.5 + i as f64).collect();
            let edges = Edges::new(edges).map_err(|error| error.to_string())?;
            let axis = Axis { parameter: parameter.to_owned(), edges: Vec::new(), levels, log: false };
            return Ok(Self { axis, remark, bins: Bins::Edges(edges) });
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
        let edges = Edges::new((0..=bins).map(at).collect()).map_err(|_| "their ranges do not overlap".to_owned())?;
        let axis = Axis { parameter: parameter.to_owned(), edges: edges.as_slice().to_vec(), levels: Vec::new(), log };
        Ok(Self { axis, remark, bins: Bins::Edges(edges) })
    }

    fn levels(parameter: &str, columns: &[&ParameterColumn]) -> Result<Self, String> {
        let of = |column: &ParameterColumn| match &column.kind {
            ParameterKind::Categorical { levels } => levels.clone(),
            _ => Vec::new(),
        };
        let mut all: Vec<String> = Vec::new();
        for level in columns.iter().flat_map(|column| of(column)) {
            if !all.contains(&level) {
                all.push(level);
            }
        }
        let (levels, rest): (Vec<String>, Vec<String>) =
            all.into_iter().partition(|level| columns.iter().all(|column| of(column).contains(level)));
        if levels.is_empty() {
            return Err("they have no level in common".to_owned());
        }
        let remark = (!rest.is_empty()).then(|| {
            format!(
                "Not every dataset has the {} {}; their rows are excluded.",
                parameter_label(parameter),
                list(&rest)
            )
        });
        let axis = Axis { parameter: parameter.to_owned(), edges: Vec::new(), levels: levels.clone(), log: false };
        Ok(Self { axis, remark, bins: Bins::Levels(levels) })
    }

    /// Number of cells.
    pub(crate) fn cells(&self) -> usize {
        self.axis.cells()
    }

    /// The cell of each row of a dataset; `None` outside the shared part.
    pub(crate) fn places(&self, column: &ParameterColumn) -> Vec<Option<usize>> {
        match (&self.bins, &column.kind) {
            (Bins::Edges(edges), _) => column.values.iter().map(|value| edges.bin(*value)).collect(),
            (Bins::Levels(levels), ParameterKind::Categorical { levels: own }) => {
                let places: Vec<Option<usize>> =
                    own.iter().map(|own| levels.iter().position(|level| level == own)).collect();
                column.codes().into_iter().map(|code| places.get(code).copied().flatten()).collect()
            }
            (Bins::Levels(_), _) => vec![None; column.values.len()],
        }
    }

    /// Successes per cell of one dataset.
    pub(crate) fn trials(&self, dataset: &Dataset<'_>) -> Vec<Trials> {
        match dataset.parameter(&self.axis.parameter) {
            Some(column) => {
                let places = self.places(column);
                dataset.base.effective_cells(self.cells(), |row| places[row])
            }
            None => vec![Trials::NONE; self.cells()],
        }
    }

    /// Successes per cell of this parameter and `across`, which varies fastest.
    pub(crate) fn trials_with(&self, across: &Self, dataset: &Dataset<'_>) -> Vec<Trials> {
        let cells = self.cells() * across.cells();
        let columns = (dataset.parameter(&self.axis.parameter), dataset.parameter(&across.axis.parameter));
        let (Some(up), Some(to)) = columns else { return vec![Trials::NONE; cells] };
        let places: Vec<Option<usize>> = self
            .places(up)
            .into_iter()
            .zip(across.places(to))
            .map(|(row, column)| Some(row? * across.cells() + column?))
            .collect();
        dataset.base.effective_cells(cells, |row| places[row])
    }

    /// The edges of one cell; `None` for a level.
    pub(crate) fn range(&self, at: usize) -> Option<[f64; 2]> {
        match self.axis.edges.get(at..at + 2) {
            Some([low, high]) => Some([*low, *high]),
            _ => None,
        }
    }
}

/// The range that all spans cover.
fn shared_range(spans: &[[f64; 2]]) -> [f64; 2] {
    let low = spans.iter().map(|span| span[0]).fold(f64::NEG_INFINITY, f64::max);
    [low, spans.iter().map(|span| span[1]).fold(f64::INFINITY, f64::min)]
}

/// The range that the rows of all datasets cover. The ends of imported ranges are the extremes of their rows, so they are random: an end
/// is shared unless one dataset has so many different values beyond the last one of another that chance does not explain it. If
/// both have the same distribution, the largest k of all values lie in the first with the probability of k draws without replacement.
fn observed_range(columns: &[&ParameterColumn]) -> [f64; 2] {
    let distinct = |column: &&ParameterColumn| {
        let mut values = column.values.clone();
        values.sort_unstable_by(f64::total_cmp);
        values.dedup();
        values
    };
    let values: Vec<Vec<f64>> = columns.iter().map(distinct).filter(|values| !values.is_empty()).collect();
    let end = |sign: f64| {
        let ends = || values.iter().map(|of| of.iter().map(|v| sign * v).fold(f64::NEG_INFINITY, f64::max));
        let (nearest, farthest) = (ends().fold(f64::INFINITY, f64::min), ends().fold(f64::NEG_INFINITY, f64::max));
        let shortest = values.iter().zip(ends()).filter(|(_, end)| *end <= nearest).map(|(of, _)| of.len()).min();
        let by_chance = values.iter().all(|of| {
            let beyond = of.iter().filter(|v| sign * **v > nearest).count();
            let all = (of.len() + shortest.unwrap_or(0)) as f64;
            let chance: f64 = (0..beyond).map(|i| (of.len() as f64 - i as f64) / (all - i as f64)).product();
            chance > SAME_END / values.len() as f64
        });
        sign * if by_chance { farthest } else { nearest }
    };
    [end(-1.0), end(1.0)]
}

fn span(column: &ParameterColumn) -> [f64; 2] {
    match &column.kind {
        ParameterKind::Continuous { low, high, .. } => [*low, *high],
        ParameterKind::Integer { low, high } => [*low as f64, *high as f64],
        ParameterKind::Categorical { .. } => [f64::NEG_INFINITY, f64::INFINITY],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_that_differ_by_chance_are_shared() {
        let column = |from: f64, to: f64, n: usize| ParameterColumn {
            name: "mass_kg".to_owned(),
            kind: ParameterKind::Continuous { low: from, high: to, log: false },
            values: (0..n).map(|i| from + (to - from) * i as f64 / (n - 1) as f64).collect(),
        };
        let range = |a: &ParameterColumn, b: &ParameterColumn| observed_range(&[a, b]);
        // Two of fifty values lie beyond the last one of the other dataset; then a quarter of them.
        assert_eq!(range(&column(0.0, 1.0, 50), &column(0.0, 0.97, 50)), [0.0, 1.0]);
        assert_eq!(range(&column(0.0, 1.0, 50), &column(0.0, 0.75, 50)), [0.0, 0.75]);
        // A few values of a large dataset beyond those of a small one are likely.
        assert_eq!(range(&column(-0.1, 1.0, 500), &column(0.0, 1.0, 10)), [-0.1, 1.0]);
        assert_eq!(shared_range(&[[0.0, 100.0], [0.3, 99.8]]), [0.3, 99.8]);
    }
}
