//! Rates of the fine simulator from a run with coarse episodes, and what they cost.

use std::collections::BTreeMap;

use robogate_core::Outcome;
use robogate_dictionary::{Dictionary, Fidelity};
use robogate_stats::two_fidelities::{Pairs, best_share, rate, relative_cost};
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::AnalysisError;

/// Success in the list of rates.
const SUCCESS: &str = "success";

/// Rates of the fine simulator from fine and coarse episodes of the same scenarios, and what they cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TwoFidelities {
    /// The version of the format.
    pub version: u32,
    /// The fine simulator.
    pub fine: SimulatorFigures,
    /// The coarse simulator.
    pub coarse: SimulatorFigures,
    /// Valid fine episodes, each with a coarse partner: the same scenario and seed.
    pub pairs: u64,
    /// Pairs that succeeded in the fine simulator only.
    pub fine_success_only: u64,
    /// Pairs that succeeded in the coarse simulator only.
    pub coarse_success_only: u64,
    /// The rates: `success`, then `failure:<mode>` for each mode that occurred.
    pub rates: Vec<FidelityRate>,
    /// What the rate of success costs.
    pub cost: FidelityCost,
    /// Whether coarse episodes improve the risk model. Absent if no comparison was possible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub risk: Option<FidelityRisk>,
}

/// A simulator and its episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SimulatorFigures {
    /// Its time step, in seconds.
    pub time_step_s: f64,
    /// Its episodes.
    pub episodes: u64,
    /// Invalid ones among them.
    pub invalid: u64,
    /// Steps of the physics in all control periods of its episodes.
    pub physics_steps: u64,
}

impl SimulatorFigures {
    /// Mean number of physics steps of an episode.
    pub fn steps_per_episode(&self) -> f64 {
        self.physics_steps as f64 / self.episodes.max(1) as f64
    }
}

/// A rate of the fine simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FidelityRate {
    /// `success` or `failure:<mode>`.
    pub metric: String,
    /// The estimate from fine and coarse episodes.
    pub rate: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
    /// The rate of the fine episodes alone.
    pub fine_alone: f64,
    /// Its 95 % interval (Wilson).
    pub fine_alone_95: [f64; 2],
    /// The rate of all coarse episodes, which estimates the coarse simulator. Invalid ones count as other outcomes.
    pub coarse_alone: f64,
    /// The coefficient of the control variate.
    pub control: f64,
    /// Correlation of both outcomes among the pairs. Absent if either does not vary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlation: Option<f64>,
    /// Number of fine episodes alone with the same standard error.
    pub worth_fine_episodes: f64,
}

/// What the rate of success costs, in physics steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FidelityCost {
    /// Physics steps of a coarse episode relative to a fine one.
    pub coarse_relative: f64,
    /// Physics steps of all episodes.
    pub steps: u64,
    /// Physics steps of fine episodes alone with the same standard error.
    pub fine_alone_steps: f64,
    /// The share of these steps that was saved. Negative if coarse episodes cost more than they gave.
    pub saved: f64,
    /// Share of the scenarios that ran in the fine simulator too.
    pub share: f64,
    /// The share with the least cost at the observed correlation. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_share: Option<f64>,
    /// The cost at that share relative to fine episodes alone with the same standard error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_relative: Option<f64>,
}

/// Whether a risk model of coarse episodes, corrected with fine ones, predicts fine episodes better than one of these alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FidelityRisk {
    /// Coarse episodes that trained it. None of them is the partner of a fine one.
    pub coarse_episodes: u64,
    /// Fine episodes of the cross-validation.
    pub fine_episodes: u64,
    /// Mean log loss with the coarse episodes.
    pub with: f64,
    /// Mean log loss without them.
    pub without: f64,
    /// 95 % interval of the gain: the loss without minus the loss with them.
    pub gain_95: [f64; 2],
    /// The slope of the coarse model's log-odds in the model of all fine episodes. 0 if it was not chosen.
    pub slope: f64,
}

/// The episodes of one simulator that the estimate needs.
struct Episodes {
    figures: SimulatorFigures,
    /// The outcome of each episode by its index. `None` if it is invalid.
    outcomes: BTreeMap<u64, Option<String>>,
}

impl Episodes {
    fn read(dictionary: &Dictionary, expected: Fidelity) -> Result<Self, AnalysisError> {
        let provenance = dictionary.provenance();
        let wrong = |reason: &str| AnalysisError::NotTwoFidelities {
            path: dictionary.path().to_owned(),
            reason: reason.to_owned(),
        };
        if provenance.fidelity != expected {
            return Err(wrong(&format!("its episodes are {}. Expected {expected} ones", provenance.fidelity)));
        }
        let time_step_s = provenance.world.get("time_step_s").and_then(serde_json::Value::as_f64);
        let time_step_s = time_step_s.filter(|step| *step > 0.0).ok_or_else(|| wrong("it records no time step"))?;
        let per_period = (provenance.task.control_period_s / time_step_s).round() as u64;
        let mut outcomes = BTreeMap::new();
        let (mut invalid, mut physics_steps) = (0, 0);
        for entry in dictionary.entries() {
            let entry = entry?;
            physics_steps += u64::from(entry.episode.ticks) * per_period;
            let outcome = match &entry.episode.outcome {
                Outcome::Invalid(_) => {
                    invalid += 1;
                    None
                }
                outcome => Some(outcome.as_str().to_owned()),
            };
            outcomes.insert(entry.index(), outcome);
        }
        let episodes = outcomes.len() as u64;
        Ok(Self { figures: SimulatorFigures { time_step_s, episodes, invalid, physics_steps }, outcomes })
    }
}

impl TwoFidelities {
    /// The version of the format.
    pub const VERSION: u32 = 1;

    /// Rates and costs of a run and of its coarse episodes, whose first scenarios are those of the run.
    ///
    /// An invalid fine episode is excluded. An invalid coarse one stays: its outcome is none of the others, which keeps the estimate
    /// unbiased.
    ///
    /// # Errors
    /// Rows that cannot be read or that are not those of one run, and too few pairs.
    pub fn of(fine: &Dictionary, coarse: &Dictionary) -> Result<Self, AnalysisError> {
        let wrong = |reason: String| AnalysisError::NotTwoFidelities { path: coarse.path().to_owned(), reason };
        let (a, b) = (fine.provenance(), coarse.provenance());
        if a.seed != b.seed || a.space != b.space || a.task != b.task || a.policy != b.policy {
            return Err(wrong("it is not the coarse part of the run: seed, space, task or policy differ".to_owned()));
        }
        let modes: Vec<&str> = a.task.modes().map(robogate_core::FailureMode::as_str).collect();
        let (fine, coarse) = (Episodes::read(fine, Fidelity::Fine)?, Episodes::read(coarse, Fidelity::Coarse)?);
        let mut pairs: Vec<(&str, Option<&str>)> = Vec::new();
        for (index, outcome) in &fine.outcomes {
            let partner = coarse.outcomes.get(index);
            let partner = partner.ok_or_else(|| wrong(format!("it lacks episode {index} of the run")))?;
            if let Some(outcome) = outcome {
                pairs.push((outcome, partner.as_deref()));
            }
        }
        let of = |outcome: &str| {
            let pairs = Pairs::count(pairs.iter().map(|(fine, coarse)| (*fine == outcome, *coarse == Some(outcome))));
            let all = Trials::count(coarse.outcomes.values().map(|found| found.as_deref() == Some(outcome)));
            rate(&pairs, all, Confidence::P95)
                .map(|found| (pairs, all, found))
                .map_err(|error| wrong(error.to_string()))
        };
        let name = Outcome::Success.as_str();
        let (success, _, found) = of(name)?;
        let mut rates = Vec::new();
        for mode in std::iter::once(name).chain(modes) {
            let (pairs, all, found) = of(mode)?;
            if mode != name && pairs.fine().successes() == 0 && all.successes() == 0 {
                continue;
            }
            rates.push(FidelityRate {
                metric: if mode == name { SUCCESS.to_owned() } else { format!("failure:{mode}") },
                rate: found.rate,
                interval_95: [found.interval.low, found.interval.high],
                fine_alone: pairs.fine().rate().unwrap_or(0.0),
                fine_alone_95: [found.alone.low, found.alone.high],
                coarse_alone: all.rate().unwrap_or(0.0),
                control: found.control,
                correlation: found.correlation,
                worth_fine_episodes: found.worth,
            });
        }
        let (fine, coarse) = (fine.figures, coarse.figures);
        let coarse_relative = coarse.steps_per_episode() / fine.steps_per_episode().max(1.0);
        let share = fine.episodes as f64 / coarse.episodes.max(1) as f64;
        let steps = fine.physics_steps + coarse.physics_steps;
        let fine_alone_steps = found.worth * fine.steps_per_episode();
        let best = found.correlation.map(|correlation| {
            let best = best_share(correlation, coarse_relative);
            (best, relative_cost(correlation, coarse_relative, best))
        });
        let cost = FidelityCost {
            coarse_relative,
            steps,
            fine_alone_steps,
            saved: 1.0 - steps as f64 / fine_alone_steps.max(1.0),
            share,
            best_share: best.map(|best| best.0),
            best_relative: best.map(|best| best.1),
        };
        Ok(Self {
            version: Self::VERSION,
            fine,
            coarse,
            pairs: success.n(),
            fine_success_only: success.fine_only,
            coarse_success_only: success.coarse_only,
            rates,
            cost,
            risk: None,
        })
    }

    /// The rate of success.
    pub fn success(&self) -> Option<&FidelityRate> {
        self.rates.iter().find(|rate| rate.metric == SUCCESS)
    }
}
