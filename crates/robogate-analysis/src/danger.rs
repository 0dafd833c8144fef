//! Danger zones: bins and levels in which the policy significantly fails most of the time.

use robogate_stats::compare::at_most;
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// The p-value, adjusted by Holm over everything tested.
    pub holm_p: f64,
    /// Whether the rate is significantly below the limit: adjusted p-value at most 0.05.
    pub significant: bool,
}

impl DangerZones {
    pub(crate) fn of(effects: &[MarginalEffect]) -> Self {
        let cells: Vec<(&MarginalEffect, &Cell)> = effects
            .iter()
            .flat_map(|effect| effect.cells.iter().map(move |cell| (effect, cell)))
            .filter(|(_, cell)| cell.rate.n > 0)
            .collect();
        let ln_p: Vec<f64> =
            cells.iter().map(|(_, cell)| at_most(cell.rate.trials(), DANGER_LIMIT).clamp(f64::MIN, 0.0)).collect();
        let plain: Vec<f64> = ln_p.iter().map(|p| p.exp()).collect();
        let adjusted = holm(&plain).unwrap_or_else(|_| vec![1.0; plain.len()]);
        let mut zones: Vec<DangerZone> = cells
            .iter()
            .zip(ln_p)
            .zip(adjusted)
            .filter(|(((_, cell), _), _)| cell.rate.rate.is_some_and(|rate| rate < DANGER_LIMIT))
            .map(|(((effect, cell), ln_p), holm_p)| DangerZone {
                parameter: effect.parameter.clone(),
                cell: cell.label.clone(),
                range: cell.range,
                rate: cell.rate,
                ln_p,
                holm_p,
                significant: holm_p <= LEVEL,
            })
            .collect();
        zones.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
        Self { limit: DANGER_LIMIT, tested: cells.len() as u64, zones }
    }
}
