//! Success by two parameters: the operating envelope.

use robogate_stats::binning::{Edges, per_pair};
use robogate_stats::format::range;
use robogate_stats::surface::{Surface, SurfaceRate};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;
use crate::effects::{Effects, ParameterEffect};
use crate::marginal::Zone;
use crate::rate::{Rate, ends};
use crate::table::{ParameterColumn, ParameterKind, Sample};
use crate::task::TaskAnalysis;

/// Bins of one axis.
const MAX_BINS: usize = 10;
/// Bins of one axis in which the smooth model counts the rows.
const FINE: usize = 20;
/// Episodes that a cell should hold on average.
const EPISODES_PER_CELL: usize = 25;

/// Success rates per cell of two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairMap {
    /// The horizontal parameter.
    pub x: Axis,
    /// The vertical parameter.
    pub y: Axis,
    /// The cells, row by row from the lowest y; x varies fastest.
    pub cells: Vec<PairCell>,
    /// Rows outside both ranges.
    pub outside: u64,
    /// Cells of each zone.
    pub zones: ZoneCounts,
    /// The length scale of the smooth model, in units of the range of a parameter on its own scale. `None` without one.
    #[serde(default)]
    pub length_scale: Option<f64>,
}

/// One axis of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Axis {
    /// The parameter.
    pub parameter: String,
    /// Edges of its bins; empty for a categorical parameter.
    pub edges: Vec<f64>,
    /// Its levels, if it is categorical or an integer with few levels.
    pub levels: Vec<String>,
    /// Whether its bins have equal width on a logarithmic scale.
    pub log: bool,
}

impl Axis {
    /// Number of bins or levels.
    pub fn cells(&self) -> usize {
        if self.levels.is_empty() { self.edges.len().saturating_sub(1) } else { self.levels.len() }
    }

    /// The edges or the level of a cell; empty if there is no such cell.
    pub fn cell_label(&self, at: usize) -> String {
        match (self.levels.get(at), self.edges.get(at..at + 2)) {
            (Some(level), _) => level.clone(),
            (None, Some([low, high])) => range([*low, *high]),
            _ => String::new(),
        }
    }
}

/// One cell of a map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairCell {
    /// Its observed rate.
    pub rate: Rate,
    /// The rate in its middle by a smooth model of all rows. `None` if a parameter is categorical, or without a model.
    #[serde(default)]
    pub model: Option<ModelRate>,
    /// Its zone: by the interval of the model, otherwise by its own episodes.
    pub zone: Zone,
}

/// A rate by a smooth model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelRate {
    /// The rate.
    pub rate: f64,
    /// Its pointwise 95 % interval.
    pub interval_95: [f64; 2],
}

/// Cells of each zone.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ZoneCounts {
    /// Cells significantly at or above 70 %.
    pub safe: u64,
    /// Cells significantly between.
    pub boundary: u64,
    /// Cells significantly at or below 30 %.
    pub danger: u64,
    /// Cells with enough episodes whose interval includes a limit.
    #[serde(default)]
    pub undecided: u64,
    /// Cells with too few episodes for any zone.
    pub too_few_episodes: u64,
}

impl ZoneCounts {
    /// Counts a cell of this zone.
    pub(crate) fn add(&mut self, zone: Zone) {
        match zone {
            Zone::Safe => self.safe += 1,
            Zone::Boundary => self.boundary += 1,
            Zone::Danger => self.danger += 1,
            Zone::Undecided => self.undecided += 1,
            Zone::TooFewEpisodes => self.too_few_episodes += 1,
        }
    }
}

/// The pairs that are mapped by default: the two numeric parameters with the most influential significant effects, then
/// that of the task. Without effects and task, the two most influential ones. The frontier is solved for the first.
pub(crate) fn default_pairs(base: &Sample, effects: &Effects, task: &TaskAnalysis) -> Vec<(String, String)> {
    let numeric = |name: &str| base.parameter(name).is_some_and(ParameterColumn::is_numeric);
    let pair = |names: Vec<&str>| match names.as_slice() {
        [first, second, ..] => Some(((*first).to_owned(), (*second).to_owned())),
        _ => None,
    };
    let is_numeric = |effect: &&ParameterEffect| numeric(&effect.parameter);
    let of_task = task.envelope.filter(|pair| pair.iter().all(|name| base.parameter(name).is_some()));
    let of_task = of_task.map(|[up, across]| (up.to_owned(), across.to_owned()));
    let same = |a: &(String, String), b: &(String, String)| a == b || (&a.0, &a.1) == (&b.1, &b.0);
    let mut pairs: Vec<(String, String)> = Vec::new();
    match (pair(effects.significant().filter(is_numeric).map(|e| e.parameter.as_str()).collect()), of_task) {
        (Some(found), Some(of_task)) if same(&found, &of_task) => pairs.push(of_task),
        (Some(found), of_task) => {
            pairs.push(found);
            pairs.extend(of_task);
        }
        (None, Some(of_task)) => pairs.push(of_task),
        (None, None) => {
            let ranked: Vec<&str> = effects.ranked.iter().filter(is_numeric).map(|e| e.parameter.as_str()).collect();
            let all: Vec<&str> = base.parameters.iter().map(|p| p.name.as_str()).filter(|name| numeric(name)).collect();
            pairs.extend(pair(ranked).or_else(|| pair(all)));
        }
    }
    pairs
}

/// Checks that two parameters can be mapped.
pub(crate) fn check(base: &Sample, first: &str, second: &str) -> Result<(), AnalysisError> {
    let known = || base.parameters.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ");
    for name in [first, second] {
        if base.parameter(name).is_none() {
            let reason = "unknown parameter";
            return Err(AnalysisError::Pair { name: name.to_owned(), reason, known: known() });
        }
    }
    if first == second {
        let reason = "a pair needs two different parameters";
        return Err(AnalysisError::Pair { name: first.to_owned(), reason, known: known() });
    }
    Ok(())
}

/// The map of two parameters: `up` on the vertical axis, `across` on the horizontal one.
pub(crate) fn map(base: &Sample, up: &ParameterColumn, across: &ParameterColumn) -> Option<PairMap> {
    let bins = bins_for(base.len());
    let (y_axis, y_edges) = axis(up, bins)?;
    let (x_axis, x_edges) = axis(across, bins)?;
    let counted = per_pair(&up.values, &y_edges, &across.values, &x_edges, &base.success).ok()?;
    // The smooth model assumes independent rows.
    let model = if base.dependence.is_none() { smooth(base, up, across, &y_axis, &x_axis) } else { None };
    let rates = rates(base, &counted.cells, |row| {
        Some(y_edges.bin(up.values[row])? * x_axis.cells() + x_edges.bin(across.values[row])?)
    });
    let by_episodes = Zone::of(&rates.iter().map(Rate::effective_trials).collect::<Vec<_>>());
    let cells: Vec<PairCell> = rates
        .into_iter()
        .zip(by_episodes)
        .enumerate()
        .map(|(i, (rate, zone))| {
            let model = model.as_ref().and_then(|(rates, _)| rates.get(i).copied());
            PairCell { rate, model, zone: model.map_or(zone, |m| Zone::of_interval(m.interval_95)) }
        })
        .collect();
    let mut counts = ZoneCounts::default();
    cells.iter().for_each(|cell| counts.add(cell.zone));
    Some(PairMap {
        x: x_axis,
        y: y_axis,
        cells,
        outside: counted.outside as u64,
        zones: counts,
        length_scale: model.map(|(_, length_scale)| length_scale),
    })
}

/// The observed rates of cells. `cell_of` is the cell of a row.
fn rates(base: &Sample, cells: &[Trials], cell_of: impl Fn(usize) -> Option<usize>) -> Vec<Rate> {
    if base.is_plain() {
        return cells.iter().map(|trials| Rate::of(*trials)).collect();
    }
    let of_row: Vec<Option<usize>> = (0..base.len()).map(cell_of).collect();
    (0..cells.len()).map(|cell| Rate::of_rows(base, |row| of_row[row] == Some(cell))).collect()
}

/// The rates in the middle of each cell by a smooth model, and its length scale. `None` for categorical parameters, and
/// without both outcomes.
fn smooth(
    base: &Sample,
    up: &ParameterColumn,
    across: &ParameterColumn,
    y: &Axis,
    x: &Axis,
) -> Option<(Vec<ModelRate>, f64)> {
    let (fine_y, fine_x) = (fine(up)?, fine(across)?);
    let mut counts = vec![[0.0; 2]; fine_x.bins() * fine_y.bins()];
    let all: f64 = (0..base.len()).map(|row| base.weight(row)).sum();
    let worth = base.len() as f64 * base.share() / all.max(f64::MIN_POSITIVE);
    for (row, success) in base.success.iter().enumerate() {
        if let (Some(y), Some(x)) = (fine_y.bin(up.values[row]), fine_x.bin(across.values[row])) {
            counts[y * fine_x.bins() + x][usize::from(!success)] += worth * base.weight(row);
        }
    }
    let surface = Surface::fit(&counts, fine_x.bins(), fine_y.bins())?;
    let (nx, ny) = (x.cells(), y.cells());
    let at = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
    let (xs, ys): (Vec<f64>, Vec<f64>) = (0..nx * ny).map(|i| (at(i % nx, nx), at(i / nx, ny))).unzip();
    let rates = surface.at(&xs, &ys, Confidence::P95)?;
    let rate = |of: SurfaceRate| ModelRate { rate: of.rate, interval_95: ends(of.interval) };
    Some((rates.into_iter().map(rate).collect(), surface.length_scale()))
}

/// The cells in which the smooth model counts the rows of a numeric parameter.
fn fine(parameter: &ParameterColumn) -> Option<Edges> {
    if !parameter.is_numeric() {
        return None;
    }
    Some(axis(parameter, FINE)?.1)
}

/// The number of bins of an axis, which leaves enough episodes for each cell.
pub(crate) fn bins_for(episodes: usize) -> usize {
    let side = (episodes as f64 / EPISODES_PER_CELL as f64).sqrt() as usize;
    side.clamp(3, MAX_BINS)
}

/// Bins of equal probability under the operating distribution: of equal width on the parameter's own scale.
pub(crate) fn axis(parameter: &ParameterColumn, bins: usize) -> Option<(Axis, Edges)> {
    let name = parameter.name.clone();
    let levels_of = |levels: Vec<String>, first: f64| {
        let edges = Edges::new((0..=levels.len()).map(|i| first - 0.5 + i as f64).collect()).ok()?;
        Some((Axis { parameter: name.clone(), edges: Vec::new(), levels, log: false }, edges))
    };
    let binned = |low: f64, high: f64, log: bool| {
        let at = |i: usize| {
            let u = i as f64 / bins as f64;
            match i {
                0 => low,
                i if i == bins => high,
                _ if log => (low.ln() + u * (high.ln() - low.ln())).exp(),
                _ => low + u * (high - low),
            }
        };
        let edges = Edges::new((0..=bins).map(at).collect()).ok()?;
        Some((Axis { parameter: name.clone(), edges: edges.as_slice().to_vec(), levels: Vec::new(), log }, edges))
    };
    match &parameter.kind {
        ParameterKind::Continuous { low, high, log } => binned(*low, *high, *log),
        ParameterKind::Integer { low, high } if high - low < 16 => {
            levels_of((*low..=*high).map(|level| level.to_string()).collect(), *low as f64)
        }
        ParameterKind::Integer { low, high } => binned(*low as f64 - 0.5, *high as f64 + 0.5, false),
        ParameterKind::Categorical { levels } if levels.len() <= 40 => levels_of(levels.clone(), 0.0),
        ParameterKind::Categorical { .. } => None,
    }
}
