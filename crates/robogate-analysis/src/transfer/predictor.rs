//! Predictions of a simulation's model for real trials and for the population.

use std::sync::Arc;

use robogate_core::{ParameterSpace, Sampler, Seed, samplers};
use robogate_stats::recalibration::LARGEST_LOG_ODDS;

use super::trials::RealTrials;
use crate::learners::flexible_scores;
use crate::table::{EpisodeTable, ParameterColumn, Sample};

/// Points of the space at which the model is evaluated.
const POINTS: usize = 4_096;
/// Simulated episodes that train the model at most.
const MOST_EPISODES: usize = 4_000;
/// Draws of the missing parameters of a trial.
const DRAWS: usize = 32;
/// The seed of the points. Equal inputs give equal figures.
const SEED: u64 = 20;

/// P(success) by the simulation's model.
#[derive(Debug, Clone, PartialEq)]
pub struct Predictions {
    /// For each trial. Missing parameters are averaged over the population.
    pub trials: Vec<f64>,
    /// For points of the population.
    pub population: Vec<f64>,
    /// For the settings of a map, if one was requested.
    pub map: Vec<f64>,
}

/// Points of the space: a scrambled Sobol sequence.
pub(super) fn points(space: &ParameterSpace) -> Result<Vec<Vec<f64>>, String> {
    let space = Arc::new(space.clone());
    let stream = Seed::campaign(SEED).stream("transfer population");
    let design = samplers::Sobol.design(&space, POINTS, stream).map_err(|error| error.to_string())?;
    Ok((0..design.len()).filter_map(|i| design.coded(i).map(<[f64]>::to_vec)).collect())
}

/// The episodes that train the model.
pub(super) fn training(table: &EpisodeTable) -> Sample {
    let train = table.unselected();
    if train.len() <= MOST_EPISODES {
        return train;
    }
    let kept: Vec<bool> = (0..train.len()).map(|i| i < MOST_EPISODES).collect();
    train.restricted(&kept)
}

/// A step that reaches each of `n` points, so that draws differ also in files with few or regular settings.
fn stride(n: usize) -> usize {
    let common = |step: usize| {
        let (mut a, mut b) = (step, n);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    (7..).find(|step| common(*step) == 1).unwrap_or(1)
}

/// Trains the model on the valid episodes of a simulation and predicts trials, points and the settings of a map.
pub(super) fn predict(
    table: &EpisodeTable,
    space: &ParameterSpace,
    trials: &RealTrials,
    points: &[Vec<f64>],
    map: Vec<Vec<f64>>,
    fitted: &mut dyn FnMut(u32, u32),
) -> Result<Predictions, String> {
    let train = training(table);
    let on_map = map.len();
    let mut rows: Vec<Vec<f64>> = points.iter().cloned().chain(map).collect();
    let mut sizes = Vec::with_capacity(trials.trials.len());
    let stride = stride(points.len());
    for (i, trial) in trials.trials.iter().enumerate() {
        if trial.values.iter().all(Option::is_some) {
            rows.push(trial.values.iter().map(|v| v.unwrap_or_default()).collect());
            sizes.push(1);
        } else {
            let draw = |k: usize| &points[(i * DRAWS + k) * stride % points.len()];
            let row = |k: usize| trial.values.iter().zip(draw(k)).map(|(v, drawn)| v.unwrap_or(*drawn)).collect();
            rows.extend((0..DRAWS).map(row));
            sizes.push(DRAWS);
        }
    }
    if train.success.iter().all(|success| Some(success) == train.success.first()) {
        // Such a simulation says nothing about differences between settings. Its rate is shrunk, as an expected success.
        let successes = train.success.iter().filter(|success| **success).count() as f64;
        let rate = (successes + 0.5) / (train.len() as f64 + 1.0);
        let of = |n: usize| vec![rate; n];
        return Ok(Predictions { trials: of(sizes.len()), population: of(points.len()), map: of(on_map) });
    }
    let column = |known: &ParameterColumn| {
        let at = space.position(&known.name)?;
        let values = rows.iter().map(|row| row[at]).collect();
        Some(ParameterColumn { name: known.name.clone(), kind: known.kind.clone(), values })
    };
    let test = Sample {
        rows: Vec::new(),
        success: vec![false; rows.len()],
        parameters: train.parameters.iter().filter_map(column).collect(),
        identifiers: Vec::new(),
        weights: None,
        dependence: None,
        strata: None,
    };
    let scores = flexible_scores(&train, &test, fitted)?;
    let probability = |eta: &f64| 1.0 / (1.0 + (-eta.clamp(-LARGEST_LOG_ODDS, LARGEST_LOG_ODDS)).exp());
    let all: Vec<f64> = scores.iter().map(probability).collect();
    let (population, rest) = all.split_at(points.len());
    let (map, mut rest) = rest.split_at(on_map);
    let mut predicted = Vec::with_capacity(sizes.len());
    for size in sizes {
        let (own, others) = rest.split_at(size);
        predicted.push(own.iter().sum::<f64>() / size as f64);
        rest = others;
    }
    Ok(Predictions { trials: predicted, population: population.to_vec(), map: map.to_vec() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_reach_each_point() {
        for n in [1, 2, 7, 14, 21, 4_096] {
            let mut reached: Vec<usize> = (0..n).map(|k| k * stride(n) % n).collect();
            reached.sort_unstable();
            assert_eq!(reached, (0..n).collect::<Vec<_>>());
        }
    }
}
