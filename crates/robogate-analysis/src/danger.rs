//! Danger zones: bins and levels in which the policy significantly fails most of the time, and more often than elsewhere.

use robogate_stats::Trials;
use robogate_stats::compare::{at_most, z_test};
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::effects::Effects;
use crate::marginal::{Cell, MarginalEffect};
use crate::rate::Rate;

/// The success rate below which the paper's table calls a bin a danger zone.
pub const DANGER_LIMIT: f64 = 0.40;
/// The level of significance, after Holm's adjustment.
const LEVEL: f64 = 0.05;

/// Danger zones: bins and levels with a success rate significantly below the limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DangerZones {
    /// The limit that the success rate of a zone is tested against: that of the paper's table.
    pub limit: f64,
    /// Bins and levels that were tested: the family of Holm's adjustment.
    pub tested: u64,
    /// Those that were observed below the limit, the smallest p-value first.
    pub zones: Vec<DangerZone>,
}

/// One bin or level with its test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DangerZone {
    /// The parameter.
    pub parameter: String,
    /// The bin or level.
    pub cell: String,
    /// Edges of a bin.
    pub range: Option<[f64; 2]>,
    /// Its success rate.
    pub rate: Rate,
    /// ln of the exact one-sided p-value that the rate is not below the limit.
    pub ln_p: f64,
    /// One-sided p-value that the rate is not below that of all other cells of the parameter. 1 if it is not.
    #[serde(default = "one")]
    pub below_others_p: f64,
    /// The larger of both p-values, adjusted by Holm over everything tested.
    pub holm_p: f64,
    /// Whether the rate is significantly below the limit and below the other cells (adjusted p-value at most 0.05), and
    /// the parameter has a significant effect.
    pub significant: bool,
}

/// The default of documents from earlier versions, which did not compare with other cells.
fn one() -> f64 {
    1.0
}

impl DangerZones {
    pub(crate) fn of(effects: &[MarginalEffect], tested: &Effects) -> Self {
        let cells: Vec<(&MarginalEffect, &Cell)> = effects
            .iter()
            .flat_map(|effect| effect.cells.iter().map(move |cell| (effect, cell)))
            .filter(|(_, cell)| cell.rate.n > 0)
            .collect();
        let ln_p: Vec<f64> = cells
            .iter()
            .map(|(_, cell)| at_most(cell.rate.effective_trials(), DANGER_LIMIT).clamp(f64::MIN, 0.0))
            .collect();
        let below: Vec<f64> = cells.iter().map(|(effect, cell)| below_others(effect, cell)).collect();
        // Both must hold, so the larger p-value counts.
        let plain: Vec<f64> = ln_p.iter().zip(&below).map(|(p, below)| p.exp().max(*below)).collect();
        let adjusted = holm(&plain).unwrap_or_else(|_| vec![1.0; plain.len()]);
        let mut zones: Vec<DangerZone> = cells
            .iter()
            .zip(ln_p)
            .zip(below)
            .zip(adjusted)
            .filter(|((((_, cell), _), _), _)| cell.rate.rate.is_some_and(|rate| rate < DANGER_LIMIT))
            .map(|((((effect, cell), ln_p), below_others_p), holm_p)| DangerZone {
                parameter: effect.parameter.clone(),
                cell: cell.label.clone(),
                range: cell.range,
                rate: cell.rate,
                ln_p,
                below_others_p,
                holm_p,
                significant: holm_p <= LEVEL && tested.significant().any(|of| of.parameter == effect.parameter),
            })
            .collect();
        zones.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
        Self { limit: DANGER_LIMIT, tested: cells.len() as u64, zones }
    }
}

/// One-sided p-value that the rate of a cell is not below that of the other cells of its parameter.
fn below_others(effect: &MarginalEffect, cell: &Cell) -> f64 {
    let own = cell.rate.effective_trials();
    let all = effect.cells.iter().map(|cell| cell.rate.effective_trials());
    let (k, n) = all.fold((0, 0), |(k, n), trials| (k + trials.successes(), n + trials.n()));
    let others = Trials::new(k - own.successes(), n - own.n()).unwrap_or(Trials::NONE);
    match z_test(own, others) {
        Some(test) if test.z < 0.0 => (0.5 * test.ln_p.exp()).clamp(0.0, 1.0),
        _ => 1.0,
    }
}
