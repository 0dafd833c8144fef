//! Differences between simulation and reality that pass a test, and checks of the trials' settings.

use robogate_core::{Domain, ParameterSpace, Seed};
use robogate_stats::compare::fisher_exact;
use robogate_stats::multiplicity::holm;
use robogate_stats::prediction_powered::design_effect;
use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::trials::{RealTrial, RealTrials};
use crate::rate::ends;
use crate::table::{Ending, EpisodeTable, Sample};

/// How far a sample is from a distribution.
type Distance = Box<dyn Fn(&[f64]) -> f64>;

/// Simulated samples of a distribution test.
const SIMULATIONS: usize = 999;

/// The rate of one ending in reality and in simulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EndingDifference {
    /// `success` or a failure mode.
    pub ending: String,
    /// Trials that ended so.
    pub trials: u64,
    /// Their share.
    pub real: f64,
    /// Exact 95 % interval of that rate, for independent trials.
    pub real_95: [f64; 2],
    /// The rate in the simulated operating space.
    pub simulated: f64,
    /// p-value of equal rates (Fisher's exact test), adjusted for all endings (Holm). Trials that share effects count as the
    /// number of independent ones with the same variance.
    pub adjusted_p: f64,
}

/// The effect of one parameter that the simulation does not explain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterDifference {
    /// The parameter.
    pub parameter: String,
    /// The level, for a categorical parameter.
    pub level: Option<String>,
    /// The change of the log-odds of success for one standard deviation of the trials, beyond shift and slope of the
    /// corrected simulation.
    pub effect: f64,
    /// Its 95 % interval (not adjusted).
    pub interval_95: [f64; 2],
    /// p-value of no effect, adjusted for all parameters and levels.
    pub adjusted_p: f64,
}

/// Whether the trials' values of one parameter look like a sample of the population.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SettingsCheck {
    /// The parameter.
    pub parameter: String,
    /// Trials with a value.
    pub trials: u64,
    /// p-value of a random sample, adjusted for all parameters (Holm).
    pub adjusted_p: f64,
}

/// Compares the rates of all endings. Modes are compared only if each failed trial names its mode.
pub(super) fn endings(table: &EpisodeTable, simulated: &Sample, trials: &RealTrials) -> Vec<EndingDifference> {
    let count =
        |ending: Ending| simulated.rows.iter().filter(|row| table.outcome[**row as usize] == ending).count() as u64;
    let mut all = vec![("success".to_owned(), count(Ending::Success))];
    if trials.names_modes() {
        let mut names: Vec<String> = table.modes.iter().map(|mode| mode.as_str().to_owned()).collect();
        let unknown = |mode: &String| !names.contains(mode);
        let mut others: Vec<String> = trials.trials.iter().filter_map(|t| t.mode.clone()).filter(unknown).collect();
        others.sort();
        others.dedup();
        let known = names.len();
        names.extend(others);
        all.extend(names.into_iter().enumerate().map(|(i, name)| {
            let simulated = if i < known { count(Ending::Failure(i as u16)) } else { 0 };
            (name, simulated)
        }));
    }
    let ended = |trial: &RealTrial, ending: &str| match &trial.mode {
        _ if ending == "success" => trial.success,
        mode => mode.as_deref() == Some(ending),
    };
    let groups = trials.groups();
    let compared: Vec<(EndingDifference, f64)> = all
        .into_iter()
        .filter_map(|(ending, count)| {
            let outcomes: Vec<bool> = trials.trials.iter().map(|trial| ended(trial, &ending)).collect();
            let (real, simulated) =
                (Trials::count(outcomes.iter().copied()), Trials::new(count, simulated.len() as u64).ok()?);
            if ending != "success" && real.successes() + simulated.successes() == 0 {
                return None;
            }
            let p = equal_rates(&outcomes, &groups, simulated);
            let found = EndingDifference {
                ending,
                trials: real.successes(),
                real: real.rate().unwrap_or(0.0),
                real_95: ends(clopper_pearson(real, Confidence::P95)),
                simulated: simulated.rate().unwrap_or(0.0),
                adjusted_p: 1.0,
            };
            Some((found, p))
        })
        .collect();
    let p: Vec<f64> = compared.iter().map(|(_, p)| *p).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    compared
        .into_iter()
        .zip(adjusted)
        .map(|((found, _), adjusted_p)| EndingDifference { adjusted_p, ..found })
        .collect()
}

/// p-value of the hypothesis that trials and simulated episodes end so at the same rate.
fn equal_rates(outcomes: &[bool], groups: &[Vec<usize>], simulated: Trials) -> f64 {
    let trials = Trials::count(outcomes.iter().copied());
    fisher_exact(independent(trials, design_effect(outcomes, groups, Confidence::P95), simulated), simulated)
}

/// The number of independent trials with the variance of these, and their successes. Both are rounded so that the
/// difference from `other` does not grow.
fn independent(trials: Trials, design_effect: f64, other: Trials) -> Trials {
    let (Some(rate), Some(limit)) = (trials.rate(), other.rate()) else { return trials };
    if design_effect <= 1.0 {
        return trials;
    }
    let n = (trials.n() as f64 / design_effect).floor();
    let successes = if rate > limit { (rate * n).floor() } else { (rate * n).ceil() };
    Trials::new(successes as u64, n as u64).unwrap_or(Trials::NONE)
}

/// Tests whether the trials' values are a random sample of the population, parameter by parameter.
pub(super) fn settings(space: &ParameterSpace, trials: &RealTrials, points: &[Vec<f64>]) -> Vec<SettingsCheck> {
    let mut random = Seed::campaign(2).stream("settings of trials");
    let (mut checks, mut p) = (Vec::new(), Vec::new());
    // A setting that was tried several times counts once.
    let once = trials.once();
    for (at, parameter) in space.parameters().iter().enumerate() {
        let values: Vec<f64> = once.iter().filter_map(|t| t.values[at]).collect();
        let mut known: Vec<f64> = points.iter().map(|point| point[at]).collect();
        if values.len() < 5 || known.is_empty() {
            continue;
        }
        known.sort_by(f64::total_cmp);
        let distance: Distance = match &parameter.domain {
            Domain::Categorical { choices } => {
                let count = |of: &[f64], level: usize| of.iter().filter(|v| **v as usize == level).count() as f64;
                let shares: Vec<f64> =
                    (0..choices.len()).map(|level| count(&known, level) / known.len() as f64).collect();
                Box::new(move |sample: &[f64]| {
                    let n = sample.len() as f64;
                    let one = |(level, share): (usize, &f64)| {
                        (count(sample, level) - n * share).powi(2) / (n * share).max(1e-9)
                    };
                    shares.iter().enumerate().map(one).sum()
                })
            }
            _ => Box::new({
                let known = known.clone();
                move |sample: &[f64]| kolmogorov(sample, &known)
            }),
        };
        let observed = distance(&values);
        let mut above = 0;
        for _ in 0..SIMULATIONS {
            let sample: Vec<f64> = values.iter().map(|_| known[random.below(known.len())]).collect();
            above += usize::from(distance(&sample) >= observed - 1e-12);
        }
        p.push((above + 1) as f64 / (SIMULATIONS + 1) as f64);
        checks.push((parameter.name.to_string(), values.len() as u64));
    }
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    checks
        .into_iter()
        .zip(adjusted)
        .map(|((parameter, trials), adjusted_p)| SettingsCheck { parameter, trials, adjusted_p })
        .collect()
}

/// The largest difference of both distribution functions (Kolmogorov). Ties make it larger, also in the simulated
/// samples. `known` is sorted.
fn kolmogorov(sample: &[f64], known: &[f64]) -> f64 {
    let mut sample = sample.to_vec();
    sample.sort_by(f64::total_cmp);
    let n = sample.len() as f64;
    let share = |count: usize| count as f64 / known.len() as f64;
    sample
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let below = share(known.partition_point(|k| k < v));
            let up_to = share(known.partition_point(|k| k <= v));
            (below - i as f64 / n).abs().max((up_to - (i + 1) as f64 / n).abs())
        })
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often the test rejects equal rates at 5 %, for trials whose rate differs by `spread` between groups.
    fn rejected(trials: usize, groups: usize, spread: f64, simulated: u64, shift: f64) -> f64 {
        let sets = 1_000;
        let rejected = (0..sets).filter(|set| {
            let mut stream = Seed::campaign(*set).stream("endings");
            let rates: Vec<f64> = (0..groups).map(|_| 0.6 + shift + spread * (stream.uniform() - 0.5)).collect();
            let group: Vec<usize> = (0..trials).map(|i| i % groups).collect();
            let outcomes: Vec<bool> = group.iter().map(|group| stream.uniform() < rates[*group]).collect();
            let successes = (0..simulated).filter(|_| stream.uniform() < 0.6).count() as u64;
            let groupings = if groups < trials { vec![group] } else { Vec::new() };
            equal_rates(&outcomes, &groupings, Trials::new(successes, simulated).unwrap()) <= 0.05
        });
        rejected.count() as f64 / sets as f64
    }

    #[test]
    fn endings_have_the_stated_error() {
        for simulated in [100, 620, 2_000] {
            for (trials, groups, spread) in [(100, 100, 0.0), (30, 30, 0.0), (60, 6, 0.6), (60, 12, 0.8), (40, 10, 0.0)]
            {
                let error = rejected(trials, groups, spread, simulated, 0.0);
                assert!(error <= 0.065, "{trials} {groups} {spread} {simulated}: {error}");
            }
        }
        assert!(rejected(100, 100, 0.0, 2_000, -0.2) > 0.9);
        assert!(rejected(60, 12, 0.4, 2_000, -0.4) > 0.8);
    }
}
