//! Weights of both designs together: the balance heuristic.
//!
//! The n1 points of the first stage and the n2 of the second have the pooled density (n1 p + n2 q)/(n1 + n2), so a point
//! of either stage has the weight (n1 + n2)/(n1 + n2 q/p). The second stage samples up to two boxes uniformly, the volume
//! and the emphasis, which may lie outside the volume. q/p is the sum over the boxes that contain the point of (share of
//! the stage's points)/(share of the operating space). The boundary report has these shares; the ends of each box are
//! those of its rows. Source: Veach and Guibas (1995), SIGGRAPH.

use crate::source::{BoundaryFile, BoundaryRegion};
use crate::table::{EpisodeTable, ParameterColumn, ParameterKind, Sample};

/// A sampled box, with its contribution to q/p.
struct Part {
    spans: Vec<Span>,
    density: f64,
}

/// The values of one parameter in a box.
enum Span {
    Range(f64, f64),
    Levels(Vec<bool>),
}

impl Span {
    fn of(parameter: &ParameterColumn, rows: &[usize]) -> Self {
        let values = || rows.iter().map(|row| parameter.values[*row]);
        match &parameter.kind {
            ParameterKind::Categorical { levels } => {
                let mut present = vec![false; levels.len()];
                values().for_each(|v| present[v as usize] = true);
                Self::Levels(present)
            }
            ParameterKind::Continuous { .. } | ParameterKind::Integer { .. } => {
                Self::Range(values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
            }
        }
    }

    fn contains(&self, value: f64) -> bool {
        match self {
            Self::Range(low, high) => *low <= value && value <= *high,
            Self::Levels(present) => present.get(value as usize).copied().unwrap_or(false),
        }
    }
}

/// Weights of the base rows followed by the focused ones, and the share of the volume.
pub(super) fn weights(
    table: &EpisodeTable,
    base: &Sample,
    focused: &Sample,
    boundary: &BoundaryFile,
) -> Result<(Vec<f64>, f64), &'static str> {
    if focused.len() == 0 || base.len() == 0 {
        return Err("one of the two designs has no valid episode");
    }
    let emphasis = boundary.emphasis.as_ref().map(|found| found.region);
    // The points of the emphasis come first in the stage. Invalid episodes count among them.
    let stage = (0..table.len()).filter(|row| table.is_focused(*row));
    let mut first: Vec<usize> = stage.collect();
    first.sort_by_key(|row| table.index[*row]);
    first.truncate(emphasis.map_or(0, |region| region.episodes as usize));
    first.sort_unstable();
    let (in_emphasis, in_volume): (Vec<usize>, Vec<usize>) =
        (0..focused.len()).partition(|at| first.binary_search(&(focused.rows[*at] as usize)).is_ok());
    let total = (emphasis.map_or(0, |region| region.episodes) + boundary.volume.episodes) as f64;
    let part = |rows: &[usize], region: BoundaryRegion| {
        let share = region.share_of_operating_space;
        (!rows.is_empty() && share > 0.0).then(|| Part {
            spans: focused.parameters.iter().map(|parameter| Span::of(parameter, rows)).collect(),
            density: region.episodes as f64 / total / share,
        })
    };
    let parts: Vec<Part> = [part(&in_volume, boundary.volume), emphasis.and_then(|region| part(&in_emphasis, region))]
        .into_iter()
        .flatten()
        .collect();
    let (n1, n2) = (base.len() as f64, focused.len() as f64);
    let weight = |sample: &Sample, row: usize| {
        let inside = |part: &&Part| part.spans.iter().zip(&sample.parameters).all(|(s, p)| s.contains(p.values[row]));
        let density: f64 = parts.iter().filter(inside).map(|part| part.density).sum();
        (n1 + n2) / (n1 + n2 * density)
    };
    let of = |sample: &Sample| (0..sample.len()).map(|row| weight(sample, row)).collect::<Vec<f64>>();
    let weights = [of(base), of(focused)].concat();
    Ok((weights, boundary.volume.share_of_operating_space))
}
