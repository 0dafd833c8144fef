//! Whether a prior improves the predictions of episodes that neither model has seen.

use std::sync::Arc;

use robogate_core::Seed;

use crate::{Fitting, Inputs, RiskError, RiskModel, Sample};

/// Number of parts of the cross-validation.
const FOLDS: usize = 5;

/// Smallest predicted chance of an outcome. It bounds the loss of one episode.
const LEAST_CHANCE: f64 = 1e-6;

/// Losses with and without a prior, in cross-validation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorGain {
    /// Number of episodes.
    pub episodes: u64,
    /// Mean log loss with the prior.
    pub with: f64,
    /// Mean log loss without it.
    pub without: f64,
    /// Standard error of the difference.
    pub se: f64,
}

/// Compares [`RiskModel::fit_after`] with [`RiskModel::fit`] on held-out episodes. Where the latter is not possible, the success rate
/// of the other episodes predicts. The prior must not know any of these episodes.
///
/// # Errors
/// As [`RiskModel::fit_after`], or fewer episodes than parts.
pub fn prior_gain(
    prior: &Arc<RiskModel>,
    inputs: &Arc<Inputs>,
    samples: &[Sample],
    how: Fitting,
) -> Result<PriorGain, RiskError> {
    if samples.len() < FOLDS {
        let successes = samples.iter().filter(|sample| sample.success).count();
        return Err(RiskError::TooFew { successes, failures: samples.len() - successes, least: how.least });
    }
    let mut order: Vec<usize> = (0..samples.len()).collect();
    Seed::campaign(0).stream("prior gain folds").shuffle(&mut order);
    // Each outcome is spread evenly over the parts.
    order.sort_by_key(|row| samples[*row].success);
    let mut losses = Vec::with_capacity(samples.len());
    for fold in 0..FOLDS {
        let (train, test): (Vec<_>, Vec<_>) = order.iter().enumerate().partition(|(at, _)| at % FOLDS != fold);
        let train: Vec<Sample> = train.into_iter().map(|(_, row)| samples[*row].clone()).collect();
        let with = RiskModel::fit_after(prior, Arc::clone(inputs), &train, how)?;
        let without = RiskModel::fit(Arc::clone(inputs), &train, how).ok();
        let successes = train.iter().filter(|sample| sample.success).count() as f64;
        let rate = (successes + 0.5) / (train.len() as f64 + 1.0);
        for (_, row) in test {
            let Sample { scenario, success } = &samples[*row];
            let wrong = |fault| RiskError::Scenario { index: scenario.index, fault };
            let with = with.told(scenario).map_err(wrong)?;
            let without = without.as_ref().map_or(Ok(rate), |model| model.told(scenario)).map_err(wrong)?;
            losses.push([with, without].map(|p| -(if *success { p } else { 1.0 - p }).max(LEAST_CHANCE).ln()));
        }
    }
    let n = losses.len() as f64;
    let mean = |at: usize| losses.iter().map(|loss| loss[at]).sum::<f64>() / n;
    let (with, without) = (mean(0), mean(1));
    let spread = losses.iter().map(|loss| (loss[1] - loss[0] - (without - with)).powi(2)).sum::<f64>();
    Ok(PriorGain { episodes: losses.len() as u64, with, without, se: (spread / (n * (n - 1.0))).sqrt() })
}
