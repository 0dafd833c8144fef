//! Failures by mode.

use robogate_core::FailureMode;
use robogate_stats::format::{count, counted, list};
use robogate_stats::modes::{Joint, distribution, dominance};
use robogate_stats::{Confidence, Trials, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::labels::mode_label;
use crate::rate::{Finding, ends};
use crate::table::{EpisodeTable, Sample};

/// Failures by mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FailureModes {
    /// Number of failures in the rows of the analysis.
    pub failures: u64,
    /// Every mode, including those that did not occur.
    pub modes: Vec<ModeShare>,
    /// The most frequent mode, if it is significantly more frequent than the second.
    pub dominant: Finding<String>,
    /// Modes that the source of imported rows does not record. Any failure may be one of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_recorded: Vec<String>,
}

/// One mode's share of the failures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModeShare {
    /// The mode.
    pub mode: String,
    /// Whether the task declares it. Other modes occur only in the data.
    #[serde(default = "declared")]
    pub declared: bool,
    /// Number of failures with this mode.
    pub failures: u64,
    /// Share of all failures, by sampling weights. `None` without failures.
    pub share: Option<f64>,
    /// 95 % interval. The intervals hold simultaneously for all modes (Goodman). A failure of unknown mode may have any mode, and so may
    /// every failure of a source that does not record some modes.
    pub interval_95: [f64; 2],
}

impl ModeShare {
    /// Whether these are the failures without a recorded mode.
    pub fn is_unknown(&self) -> bool {
        self.mode == FailureMode::UNKNOWN.as_str()
    }
}

/// The default of documents from earlier versions, which contain declared modes only.
fn declared() -> bool {
    true
}

impl FailureModes {
    pub(crate) fn of(table: &EpisodeTable, base: &Sample) -> Self {
        let mut counts = vec![0; table.modes.len()];
        base.failures(table).1.into_iter().for_each(|mode| counts[mode] += 1);
        let failures = counts.iter().sum();
        // Episodes count by their weights, and those in clusters as fewer independent ones.
        let (failed, modes_of) = base.failures(table);
        let mut weighted = vec![0.0; counts.len()];
        failed.iter().zip(modes_of).for_each(|(row, mode)| weighted[mode] += base.weight(*row));
        let all_weights = weighted.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let worth = failed.len() as f64 * base.share() / all_weights;
        let independent: Vec<u64> = weighted.iter().map(|weight| (weight * worth).round() as u64).collect();
        let shares = distribution(&independent, Joint::Simultaneous, Confidence::P95);
        let all = counts.clone();
        let not_recorded = table.not_recorded.clone();
        let mode_name = |mode: usize| table.mode(mode).to_owned();
        let unknown = table.modes.iter().position(|mode| *mode == FailureMode::UNKNOWN);
        let unknown_failures = unknown.map_or(0, |at| counts[at]);
        let dominant = match dominance(&with_unknown_as_second(independent.clone(), unknown)) {
            Some(_) if !not_recorded.is_empty() => Finding::not(unrecorded(&not_recorded)),
            None => Finding::not("nothing failed"),
            Some(found) if Some(found.mode) == unknown => Finding::not(format!(
                "the mode of {} of {} is unknown",
                count(unknown_failures),
                counted(failures, "failure")
            )),
            // Without a second mode there is nothing to compare with.
            Some(found) if found.ln_p.is_none_or(|p| p <= 0.05_f64.ln()) => Finding::Estimated(mode_name(found.mode)),
            Some(_) => Finding::not(format!(
                "the two most frequent modes do not differ significantly in {}",
                counted(failures, "failure")
            )),
        };
        // A failure whose mode is unknown may have any mode.
        let level = Confidence::P95.shared_by(table.modes.len());
        let of_unknown = unknown.map_or(0, |at| independent[at]);
        let highest = |mode: usize| {
            let trials = Trials::new(independent[mode] + of_unknown, independent.iter().sum());
            trials.map_or(1.0, |trials| wilson(trials, level).high)
        };
        let modes = shares.into_iter().enumerate().map(|(mode, share)| {
            let recorded = !not_recorded.iter().any(|name| name == table.mode(mode));
            let [low, high] = ends(share.interval);
            let high = if of_unknown > 0 && Some(mode) != unknown { highest(mode) } else { high };
            ModeShare {
                mode: mode_name(mode),
                declared: mode < table.declared,
                failures: all[mode],
                share: (failures > 0 && recorded).then(|| weighted[mode] / all_weights),
                interval_95: if not_recorded.is_empty() {
                    [low, high]
                } else {
                    [0.0, if recorded { high } else { 1.0 }]
                },
            }
        });
        Self { failures, modes: modes.collect(), dominant, not_recorded }
    }
}

/// Counts in which all failures of unknown mode have the second most frequent mode: the least favourable case for the
/// most frequent one.
fn with_unknown_as_second(mut counts: Vec<u64>, unknown: Option<usize>) -> Vec<u64> {
    let Some(unknown) = unknown else { return counts };
    let mut known: Vec<usize> = (0..counts.len()).filter(|mode| *mode != unknown && counts[*mode] > 0).collect();
    known.sort_by_key(|mode| std::cmp::Reverse(counts[*mode]));
    if let Some(second) = known.get(1) {
        counts[*second] += std::mem::take(&mut counts[unknown]);
    }
    counts
}

/// The reason why unrecorded modes make the others uncertain, as the end of a sentence.
pub fn unrecorded(modes: &[String]) -> String {
    let modes: Vec<String> = modes.iter().map(|mode| mode_label(mode)).collect();
    format!("the source does not record {}: any failure may be one of them", list(&modes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_modes_count_against_dominance() {
        assert_eq!(with_unknown_as_second(vec![9, 5, 1, 4], Some(3)), [9, 9, 1, 0]);
        assert_eq!(with_unknown_as_second(vec![9, 0, 4], Some(2)), [9, 0, 4]);
        assert_eq!(with_unknown_as_second(vec![9, 4], None), [9, 4]);
    }
}
