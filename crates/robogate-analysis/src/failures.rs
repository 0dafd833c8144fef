//! How the policy fails, and where surely most.

use robogate_stats::Confidence;
use robogate_stats::compare::at_most;
use robogate_stats::modes::{Joint, distribution, dominance};
use robogate_stats::multiplicity::holm;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::along::Along;
use crate::labels::mode_label;
use crate::rate::ends;
use crate::rate::{Finding, Rate};
use crate::rows::{Rows, Sample};
use robogate_stats::format::{counted, list};

/// The success rate below which the paper's table calls a bin a danger zone.
pub const DANGER_LIMIT: f64 = 0.40;

/// Failures by mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FailureModes {
    /// Failures among the rows that every figure is made from.
    pub failures: u64,
    /// Every mode, also those that did not happen.
    pub modes: Vec<ModeShare>,
    /// The most frequent mode, where it is surely ahead of the second.
    pub dominant: Finding<String>,
    /// Modes that the source of imported rows does not record: a failure that counts as a timeout may have been one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_recorded: Vec<String>,
}

/// One mode's part of the failures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeShare {
    /// The mode.
    pub mode: String,
    /// Whether the task declares it; else these are failures of unknown kind.
    #[serde(default = "declared")]
    pub declared: bool,
    /// How often.
    pub failures: u64,
    /// Share of all failures; absent where nothing failed.
    pub share: Option<f64>,
    /// 95 % intervals that hold for all modes together (Goodman).
    pub interval_95: [f64; 2],
}

/// Analyses of earlier versions know declared modes alone.
fn declared() -> bool {
    true
}

impl FailureModes {
    pub(crate) fn of(rows: &Rows, base: &Sample) -> Self {
        let mut counts = vec![0; rows.modes.len()];
        base.failures(rows).1.into_iter().for_each(|mode| counts[mode] += 1);
        let failures = counts.iter().sum();
        let shares = distribution(&counts, Joint::Simultaneous, Confidence::P95);
        let not_recorded: Vec<String> = rows.not_recorded.iter().map(|mode| mode.as_str().to_owned()).collect();
        let word = |mode: usize| rows.mode(mode).to_owned();
        let dominant = match dominance(&counts) {
            Some(_) if !not_recorded.is_empty() => Finding::not(unrecorded(&not_recorded)),
            None => Finding::not("nothing failed"),
            Some(found) if found.count == failures => Finding::Estimated(word(found.mode)),
            Some(found) if found.ln_p.is_some_and(|p| p < 0.05_f64.ln()) => Finding::Estimated(word(found.mode)),
            Some(_) => {
                Finding::not(format!("the two most frequent modes are too close in {}", counted(failures, "failure")))
            }
        };
        Self {
            failures,
            modes: shares
                .into_iter()
                .enumerate()
                .map(|(mode, share)| ModeShare {
                    mode: word(mode),
                    declared: mode < rows.declared,
                    failures: share.count,
                    share: share.share,
                    interval_95: ends(share.interval),
                })
                .collect(),
            dominant,
            not_recorded,
        }
    }
}

/// What follows from modes that a source does not record.
pub fn unrecorded(modes: &[String]) -> String {
    let modes: Vec<String> = modes.iter().map(|word| mode_label(word)).collect();
    format!("the source does not record {}: what counts as a timeout may have been one", list(&modes))
}

/// Bins and levels in which the policy surely fails most of the time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DangerZones {
    /// The success rate that a zone must be surely below: that of the paper's table.
    pub limit: f64,
    /// How many bins and levels were looked at: the family of Holm's adjustment.
    pub looked_at: u64,
    /// Those observed below the limit, or surely so; the surest first.
    pub zones: Vec<DangerZone>,
}

/// One bin or level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DangerZone {
    /// The parameter.
    pub parameter: String,
    /// The bin or level.
    pub cell: String,
    /// Edges of a bin.
    pub range: Option<[f64; 2]>,
    /// Its rate.
    pub rate: Rate,
    /// ln of the exact one-sided p-value that the rate is not below the limit.
    pub ln_p: f64,
    /// The p-value adjusted by Holm over everything looked at.
    pub holm_p: f64,
    /// Whether the zone is sure: adjusted p at most 0.05.
    pub sure: bool,
}

impl DangerZones {
    pub(crate) fn of(along: &[Along]) -> Self {
        let cells: Vec<(&Along, &crate::along::Cell)> = along
            .iter()
            .flat_map(|a| a.cells.iter().map(move |cell| (a, cell)))
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
            .map(|(((along, cell), ln_p), holm_p)| DangerZone {
                parameter: along.parameter.clone(),
                cell: cell.label.clone(),
                range: cell.range,
                rate: cell.rate,
                ln_p,
                holm_p,
                sure: holm_p <= 0.05,
            })
            .collect();
        zones.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
        Self { limit: DANGER_LIMIT, looked_at: cells.len() as u64, zones }
    }
}
