//! The corrected model over the two most influential parameters, and its contour of equal real success.
//!
//! At each corner and in the middle of each cell, both parameters have the values of that place, and the other parameters
//! those of some settings of the population. The mean of the corrected model over these settings has a posterior: that of
//! shift, slope and effects. Contour and band are interpolated linearly between these places. Cells are as large as those of the
//! operating envelope, so that each holds enough simulated episodes.

use std::collections::BTreeMap;

use robogate_core::ParameterSpace;
use robogate_stats::Trials;
use robogate_stats::binning::Edges;
use robogate_stats::recalibration::{corrected, log_odds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::RealTrials;
use super::corrected::CorrectedModel;
use crate::effects::Effects;
use crate::marginal::Zone;
use crate::pairs::{Axis, ModelRate, PairCell, PairMap, ZoneCounts, axis, bins_for};
use crate::rate::{Finding, Rate, ends};
use crate::table::{ParameterColumn, Sample};

/// Settings that the other parameters are averaged over.
const SETTINGS: usize = 64;
/// Neighbours among the sorted predictions of a place that are replaced by their mean.
const TOGETHER: usize = 4;
/// The real success rate of the contour.
const TARGET: f64 = 0.5;

/// Curves or polygons on a map.
type Lines = Vec<Vec<[f64; 2]>>;

/// Real success over the two most influential parameters, by the corrected model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrectedMap {
    /// The cells: the rate of the real trials in it, and the corrected model in its middle.
    pub map: PairMap,
    /// Number of settings of the population whose other parameters the model is averaged over.
    pub settings: u64,
    /// The real success rate of contour and band.
    pub target: f64,
    /// Where the corrected model predicts the target: curves of points [x, y]. Empty if it predicts it nowhere.
    pub contour: Finding<Vec<Vec<[f64; 2]>>>,
    /// Where the pointwise 95 % interval contains the target: polygons of points [x, y]. Empty without a contour.
    pub band: Vec<Vec<[f64; 2]>>,
}

/// The places of a map at which the model is evaluated.
pub(super) struct Places {
    x: MapAxis,
    y: MapAxis,
    /// Positions of the parameters in a setting.
    at: [usize; 2],
}

/// One parameter of a map.
struct MapAxis {
    axis: Axis,
    edges: Edges,
}

impl MapAxis {
    fn of(parameter: &ParameterColumn, bins: usize) -> Option<Self> {
        axis(parameter, bins).map(|(axis, edges)| Self { axis, edges })
    }

    /// The value at a place, in units of cells.
    fn value(&self, place: f64) -> f64 {
        let edges = self.edges.as_slice();
        let cell = (place.max(0.0) as usize).min(edges.len().saturating_sub(2));
        let (low, high, part) = (edges[cell], edges[cell + 1], place - cell as f64);
        if self.axis.log { (low.ln() + part * (high / low).ln()).exp() } else { low + part * (high - low) }
    }
}

impl Places {
    /// The places for the two numeric parameters with the most influence in the simulation. `base` are the rows that the
    /// effects were tested with; `fitted` is the number of episodes that the model is fitted to.
    pub(super) fn of(space: &ParameterSpace, base: &Sample, effects: &Effects, fitted: usize) -> Finding<Self> {
        if effects.significant().next().is_none() {
            return Finding::not("no parameter has a significant effect in the simulation");
        }
        let ranked = effects.ranked.iter().filter_map(|effect| base.parameter(&effect.parameter));
        let numeric: Vec<&ParameterColumn> = ranked.filter(|parameter| parameter.is_numeric()).take(2).collect();
        let [up, across] = numeric.as_slice() else {
            return Finding::not("the simulation has fewer than two numeric parameters");
        };
        let bins = bins_for(fitted);
        let at = [space.position(&across.name), space.position(&up.name)];
        match (MapAxis::of(across, bins), MapAxis::of(up, bins), at[0], at[1]) {
            (Some(x), Some(y), Some(i), Some(j)) => Finding::Estimated(Self { x, y, at: [i, j] }),
            _ => Finding::not("one of the two parameters has no range"),
        }
    }

    fn cells(&self) -> [usize; 2] {
        [self.x.axis.cells(), self.y.axis.cells()]
    }

    /// Places in units of cells: the middle of each cell, and for two parameters without levels the corners, row by row.
    fn places(&self) -> Vec<[f64; 2]> {
        let [nx, ny] = self.cells();
        let middles = (0..nx * ny).map(|i| [(i % nx) as f64 + 0.5, (i / nx) as f64 + 0.5]);
        let corners = if self.has_contour() { (nx + 1) * (ny + 1) } else { 0 };
        middles.chain((0..corners).map(|i| [(i % (nx + 1)) as f64, (i / (nx + 1)) as f64])).collect()
    }

    fn has_contour(&self) -> bool {
        self.x.axis.levels.is_empty() && self.y.axis.levels.is_empty()
    }

    /// The settings at which the model must be evaluated: those of each place in turn.
    pub(super) fn settings(&self, others: &[&Vec<f64>]) -> Vec<Vec<f64>> {
        let at_place = |[x, y]: [f64; 2]| {
            let (x, y) = (self.x.value(x), self.y.value(y));
            others.iter().map(move |other| {
                let mut setting = (*other).clone();
                setting[self.at[0]] = x;
                setting[self.at[1]] = y;
                setting
            })
        };
        self.places().into_iter().flat_map(at_place).collect()
    }

    /// The map from the predictions for [`Self::settings`] of these other settings.
    pub(super) fn map(
        &self,
        predicted: &[f64],
        others: &[&Vec<f64>],
        trials: &RealTrials,
        model: &CorrectedModel<'_>,
    ) -> CorrectedMap {
        let settings = self.settings(others);
        let each = others.len().max(1);
        let places = predicted.chunks(each).zip(settings.chunks(each));
        let rates: Vec<ModelRate> = places.map(|(predicted, settings)| rate(predicted, settings, model)).collect();
        let [nx, ny] = self.cells();
        let mut counts = vec![Trials::NONE; nx * ny];
        let mut outside = 0;
        for trial in &trials.trials {
            let value = |at: usize| trial.values.get(at).copied().flatten();
            let cell = value(self.at[0]).zip(value(self.at[1]));
            match cell.and_then(|(x, y)| Some((self.x.edges.bin(x)?, self.y.edges.bin(y)?))) {
                Some((i, j)) => {
                    let count = &mut counts[j * nx + i];
                    let all = (count.successes() + u64::from(trial.success), count.n() + 1);
                    *count = Trials::new(all.0, all.1).unwrap_or(*count);
                }
                None => outside += 1,
            }
        }
        let mut zones = ZoneCounts::default();
        let cell = |(trials, model): (&Trials, &ModelRate)| {
            let zone = Zone::of_interval(model.interval_95);
            zones.add(zone);
            PairCell { rate: Rate::of(*trials), model: Some(*model), zone }
        };
        let cells = counts.iter().zip(&rates).map(cell).collect();
        let (contour, band) = self.boundary(&rates, model);
        let (x, y) = (self.x.axis.clone(), self.y.axis.clone());
        CorrectedMap {
            map: PairMap { x, y, cells, outside, zones, length_scale: None },
            settings: others.len() as u64,
            target: TARGET,
            contour,
            band,
        }
    }

    /// The contour of the target and its band.
    fn boundary(&self, rates: &[ModelRate], model: &CorrectedModel<'_>) -> (Finding<Lines>, Lines) {
        if !self.has_contour() {
            return (Finding::not("one of the two parameters has few levels"), Vec::new());
        }
        if model.posterior().boundary(TARGET).is_none() {
            return (Finding::not("the trials do not show that the slope is positive"), Vec::new());
        }
        let nodes: Vec<Node> = self
            .places()
            .into_iter()
            .zip(rates)
            .map(|(place, of)| Node {
                place,
                rate: of.rate - TARGET,
                below: TARGET - of.interval_95[0],
                above: of.interval_95[1] - TARGET,
            })
            .collect();
        let value = |[x, y]: [f64; 2]| [self.x.value(x), self.y.value(y)];
        let values = |of: Lines| of.into_iter().map(|line| line.into_iter().map(value).collect()).collect();
        let [nx, ny] = self.cells();
        let triangles = triangles(nx, ny);
        (Finding::Estimated(values(contour(&nodes, &triangles))), values(band(&nodes, &triangles)))
    }
}

/// The settings whose other parameters the model is averaged over. The first points of a space cover it evenly; a file of
/// settings may be sorted.
pub(super) fn others(points: &[Vec<f64>], sorted: bool) -> Vec<&Vec<f64>> {
    let step = if sorted { points.len().div_ceil(SETTINGS).max(1) } else { 1 };
    points.iter().step_by(step).take(SETTINGS).collect()
}

/// The mean of the corrected model over these settings, with its interval.
fn rate(predicted: &[f64], settings: &[Vec<f64>], model: &CorrectedModel<'_>) -> ModelRate {
    let mut at: Vec<(f64, Vec<f64>)> =
        predicted.iter().zip(settings).map(|(p, setting)| (log_odds(*p), model.values(setting))).collect();
    at.sort_by(|a, b| a.0.total_cmp(&b.0));
    let n = at.len() as f64;
    // Neighbours have about the same prediction, but not the same parameters.
    let together = if at.iter().all(|(_, values)| values.is_empty()) { TOGETHER } else { 1 };
    let few: Vec<(f64, &[f64], f64)> = at
        .chunks(together)
        .map(|of| {
            let eta = of.iter().map(|(eta, _)| eta).sum::<f64>() / of.len() as f64;
            (eta, of[0].1.as_slice(), of.len() as f64 / n)
        })
        .collect();
    let mean = |a: f64, b: f64, effects: &[f64]| {
        few.iter().map(|(eta, values, share)| share * corrected(a, b, effects, *eta, values)).sum()
    };
    let found = model.posterior().of_function(mean);
    ModelRate { rate: found.mean, interval_95: ends(found.interval) }
}

/// A place with the distances of its rate and its interval from the target.
struct Node {
    place: [f64; 2],
    rate: f64,
    /// The target above the lower end of the interval.
    below: f64,
    /// The upper end above the target.
    above: f64,
}

/// The triangles of each cell, by index of their nodes: a side and the middle of the cell.
fn triangles(nx: usize, ny: usize) -> Vec<[usize; 3]> {
    let corner = |i: usize, j: usize| nx * ny + j * (nx + 1) + i;
    let of_cell = |cell: usize| {
        let (i, j) = (cell % nx, cell / nx);
        let ring = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        (0..4).map(move |side| [ring[side], ring[(side + 1) % 4], cell])
    };
    (0..nx * ny).flat_map(of_cell).collect()
}

/// The point between two places where a quantity is 0.
fn between(a: [f64; 2], b: [f64; 2], of_a: f64, of_b: f64) -> [f64; 2] {
    let part = of_a / (of_a - of_b);
    [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])]
}

/// The curves on which the rate is the target.
fn contour(nodes: &[Node], triangles: &[[usize; 3]]) -> Lines {
    // A curve crosses sides of triangles. Both triangles of a side see the same point.
    type Side = (usize, usize);
    let mut next: BTreeMap<Side, Vec<Side>> = BTreeMap::new();
    for triangle in triangles {
        let crossed: Vec<Side> = (0..3)
            .map(|i| (triangle[i], triangle[(i + 1) % 3]))
            .filter(|(a, b)| (nodes[*a].rate >= 0.0) != (nodes[*b].rate >= 0.0))
            .map(|(a, b)| (a.min(b), a.max(b)))
            .collect();
        if let [one, other] = crossed[..] {
            next.entry(one).or_default().push(other);
            next.entry(other).or_default().push(one);
        }
    }
    let point = |(a, b): Side| between(nodes[a].place, nodes[b].place, nodes[a].rate, nodes[b].rate);
    let mut curves = Vec::new();
    // Open curves begin at a side with one neighbour. The rest are rings.
    while let Some(first) =
        next.iter().find(|(_, to)| to.len() == 1).or_else(|| next.iter().next()).map(|(side, _)| *side)
    {
        let mut curve = vec![point(first)];
        let mut at = first;
        while let Some(to) = next.get_mut(&at).and_then(Vec::pop) {
            if let Some(back) = next.get_mut(&to) {
                back.retain(|side| *side != at);
            }
            curve.push(point(to));
            at = to;
        }
        next.retain(|_, to| !to.is_empty());
        curves.push(curve);
    }
    curves
}

/// The parts of the triangles in which the interval contains the target. A cell that lies inside it is one polygon.
fn band(nodes: &[Node], triangles: &[[usize; 3]]) -> Lines {
    let inside = |node: &usize| nodes[*node].below >= 0.0 && nodes[*node].above >= 0.0;
    let mut polygons = Vec::new();
    for cell in triangles.chunks(4) {
        if cell.iter().flatten().all(inside) {
            polygons.push(cell.iter().map(|side| nodes[side[0]].place).collect());
            continue;
        }
        for triangle in cell {
            let corners = triangle.map(|node| (nodes[node].place, [nodes[node].below, nodes[node].above]));
            let part = cut(&cut(&corners, 0), 1);
            if part.len() > 2 {
                polygons.push(part.into_iter().map(|(place, _)| place).collect());
            }
        }
    }
    polygons
}

/// The part of a convex polygon in which one of two linear quantities is not negative (Sutherland and Hodgman 1974).
fn cut(polygon: &[([f64; 2], [f64; 2])], of: usize) -> Vec<([f64; 2], [f64; 2])> {
    let mut part = Vec::new();
    for (i, (place, known)) in polygon.iter().enumerate() {
        let (next, known_next) = polygon[(i + 1) % polygon.len()];
        if known[of] >= 0.0 {
            part.push((*place, *known));
        }
        if (known[of] >= 0.0) != (known_next[of] >= 0.0) {
            let at = |a: [f64; 2], b: [f64; 2]| between(a, b, known[of], known_next[of]);
            part.push((at(*place, next), at(*known, known_next)));
        }
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nodes of a grid of 4 x 4 cells, with this rate and an interval of ± 0.1.
    fn nodes(rate: impl Fn([f64; 2]) -> f64) -> Vec<Node> {
        let middles = (0..16).map(|i| [f64::from(i % 4) + 0.5, f64::from(i / 4) + 0.5]);
        let corners = (0..25).map(|i| [f64::from(i % 5), f64::from(i / 5)]);
        let node = |place| {
            let rate = rate(place);
            Node { place, rate, below: 0.1 - rate, above: 0.1 + rate }
        };
        middles.chain(corners).map(node).collect()
    }

    fn area(polygon: &[[f64; 2]]) -> f64 {
        let next = polygon.iter().cycle().skip(1);
        0.5 * polygon.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>().abs()
    }

    #[test]
    fn straight_contour_is_one_line() {
        let nodes = nodes(|[x, y]| 0.2 * (x + 0.5 * y - 2.6));
        let curves = contour(&nodes, &triangles(4, 4));
        assert_eq!(curves.len(), 1);
        assert!(curves[0].iter().all(|[x, y]| (x + 0.5 * y - 2.6).abs() < 1e-12));
        let ends = [curves[0][0][1], curves[0].last().unwrap()[1]];
        assert!(ends.contains(&0.0) && ends.contains(&4.0), "{ends:?}");
        // The band is 2 x 0.1 / 0.2 wide along x.
        let total: f64 = band(&nodes, &triangles(4, 4)).iter().map(|part| area(part)).sum();
        assert!((total - 4.0).abs() < 1e-9, "{total}");
    }

    #[test]
    fn closed_contour_is_a_ring() {
        let nodes = nodes(|[x, y]| 1.5 - (x - 2.1).hypot(y - 1.9));
        let curves = contour(&nodes, &triangles(4, 4));
        assert_eq!(curves.len(), 1);
        assert_eq!(curves[0].first(), curves[0].last());
        assert!(curves[0].iter().all(|[x, y]| ((x - 2.1).hypot(y - 1.9) - 1.5).abs() < 0.1));
    }
}
