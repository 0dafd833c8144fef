//! Shares of failure modes, the dominant mode, and its changes along a parameter.
//!
//! - [`distribution`]: share of each failure mode with its interval: Wilson per mode, or Wilson at a level shared over
//!   the modes, which is Goodman's simultaneous interval (all shares hold together).
//! - [`dominance`]: tests whether the most frequent mode is significantly ahead of the second: exact sign test on their
//!   two counts, Bonferroni over the modes it could have been compared with.
//! - [`transitions`]: bins along a parameter in which a mode dominates significantly (p-values of all bins adjusted by
//!   Holm), and the positions where the dominant mode changes.
//!
//! Limit: shares apply to the failures of the design; a focused design has a different mix. Bins without a significant
//! mode have no mode. Between two bins with different modes the change may be anywhere in the gap. Sources: Goodman
//! (1965), Technometrics 7; Holm (1979); robogate paper, table of transitions.

use crate::binning::{BinningError, Edges};
use crate::compare::sign_test;
use crate::interval::{Confidence, Interval, Trials, wilson};
use crate::multiplicity::holm;

/// Whether the intervals of a distribution hold individually or simultaneously.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Joint {
    /// Each interval has the confidence level by itself.
    PerMode,
    /// All intervals hold simultaneously at the confidence level (Goodman).
    Simultaneous,
}

/// The share of one failure mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeShare {
    /// Failures of this mode.
    pub count: u64,
    /// Share of all failures. `None` without failures.
    pub share: Option<f64>,
    /// Interval of the share.
    pub interval: Interval,
}

/// Shares of failure modes, in the order of `counts`.
pub fn distribution(counts: &[u64], joint: Joint, confidence: Confidence) -> Vec<ModeShare> {
    let total = counts.iter().sum();
    let level = match joint {
        Joint::PerMode => confidence,
        Joint::Simultaneous => confidence.shared_by(counts.len()),
    };
    counts
        .iter()
        .map(|&count| {
            // A count never exceeds the sum that contains it.
            let trials = Trials::new(count, total).unwrap_or(Trials::NONE);
            ModeShare { count, share: trials.rate(), interval: wilson(trials, level) }
        })
        .collect()
}

/// The most frequent mode, compared with the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dominance {
    /// Index of the most frequent mode; the first of equals.
    pub mode: usize,
    /// Index of the second. `None` if there is only one mode.
    pub runner_up: Option<usize>,
    /// Failures of the most frequent mode.
    pub count: u64,
    /// All failures.
    pub failures: u64,
    /// ln of the p-value for the hypothesis that another mode is more frequent. `None` if there is only one mode.
    pub ln_p: Option<f64>,
}

/// The dominant mode of a set of failures. `None` without failures.
pub fn dominance(counts: &[u64]) -> Option<Dominance> {
    let failures: u64 = counts.iter().sum();
    if failures == 0 {
        return None;
    }
    let mut order: Vec<usize> = (0..counts.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(counts[i]));
    let (mode, runner_up) = (order[0], order.get(1).copied());
    let ln_p = runner_up.map(|second| {
        let comparisons = (counts.len() - 1) as f64;
        (sign_test(counts[mode], counts[second]) + comparisons.ln()).min(0.0)
    });
    Some(Dominance { mode, runner_up, count: counts[mode], failures, ln_p })
}

/// One bin along a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct ModeBin {
    /// Edges of the bin.
    pub range: Interval,
    /// Failures of each mode.
    pub counts: Vec<u64>,
    /// Dominant mode. `None` without failures.
    pub dominance: Option<Dominance>,
    /// Whether the dominant mode is significant after correction over all bins.
    pub sure: bool,
}

/// A change of the significantly dominant mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// Mode before.
    pub from: usize,
    /// Mode after.
    pub to: usize,
    /// From the lower edge of the gap (upper edge of the last significant bin before it) to the lower edge of the first
    /// significant bin after it. A single edge if the bins are adjacent.
    pub between: Interval,
}

/// Modes along one parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Transitions {
    /// All bins, in order.
    pub bins: Vec<ModeBin>,
    /// Changes between significant bins, in order.
    pub transitions: Vec<Transition>,
    /// Failures outside the edges.
    pub outside: usize,
}

/// Finds changes of the dominant failure mode along `values`.
///
/// All rows are failures: `modes[i]`, below `mode_count`, is the mode of the failure at `values[i]`.
///
/// # Errors
/// Unequal lengths or a mode out of range.
pub fn transitions(
    values: &[f64],
    modes: &[usize],
    mode_count: usize,
    edges: &Edges,
    confidence: Confidence,
) -> Result<Transitions, BinningError> {
    if values.len() != modes.len() {
        return Err(BinningError::Length { expected: values.len(), found: modes.len() });
    }
    if let Some(row) = modes.iter().position(|m| *m >= mode_count) {
        return Err(BinningError::UnknownCategory { row, code: modes[row], categories: mode_count });
    }
    let mut counts = vec![vec![0_u64; mode_count]; edges.bins()];
    let mut outside = 0;
    for (value, mode) in values.iter().zip(modes) {
        match edges.bin(*value) {
            Some(bin) => counts[bin][*mode] += 1,
            None => outside += 1,
        }
    }
    let dominant: Vec<Option<Dominance>> = counts.iter().map(|c| dominance(c)).collect();
    let tested: Vec<usize> = (0..dominant.len()).filter(|&b| dominant[b].is_some_and(|d| d.ln_p.is_some())).collect();
    let p: Vec<f64> = tested.iter().filter_map(|&b| dominant[b].and_then(|d| d.ln_p).map(f64::exp)).collect();
    let mut sure = vec![false; edges.bins()];
    if let Ok(adjusted) = holm(&p) {
        for (&bin, a) in tested.iter().zip(adjusted) {
            sure[bin] = a <= 1.0 - confidence.level();
        }
    }
    let at = edges.as_slice();
    let bins: Vec<ModeBin> = counts
        .into_iter()
        .enumerate()
        .map(|(b, counts)| ModeBin {
            range: Interval { low: at[b], high: at[b + 1] },
            counts,
            dominance: dominant[b],
            sure: sure[b],
        })
        .collect();
    let mut found = Vec::new();
    let mut last: Option<(usize, f64)> = None;
    for bin in bins.iter().filter(|b| b.sure) {
        let Some(d) = bin.dominance else { continue };
        if let Some((from, edge)) = last
            && from != d.mode
        {
            found.push(Transition { from, to: d.mode, between: Interval { low: edge, high: bin.range.low } });
        }
        last = Some((d.mode, bin.range.high));
    }
    Ok(Transitions { bins, transitions: found, outside })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_failures_give_no_share() {
        let shares = distribution(&[0, 0], Joint::PerMode, Confidence::P95);
        assert!(shares.iter().all(|s| s.share.is_none() && s.interval == Interval::UNIT));
        assert_eq!(dominance(&[0, 0, 0]), None);
        assert!(distribution(&[], Joint::Simultaneous, Confidence::P95).is_empty());
    }

    #[test]
    fn simultaneous_intervals_are_wider() {
        let one = distribution(&[40, 30, 20, 10], Joint::PerMode, Confidence::P95);
        let all = distribution(&[40, 30, 20, 10], Joint::Simultaneous, Confidence::P95);
        assert!(one.iter().zip(&all).all(|(a, b)| a.interval.width() < b.interval.width()));
    }

    #[test]
    fn published_mixed_bin_is_not_significant() {
        // grip_loss is 33.1 % of 1,067 failures, between two bins of timeout. It is significant only if far ahead of
        // the second mode.
        let close = dominance(&[340, 353, 214, 160]).unwrap();
        assert_eq!(close.mode, 1);
        assert!(close.ln_p.unwrap().exp() > 0.05);
        let far = dominance(&[770, 500, 400, 298]).unwrap();
        assert!(far.ln_p.unwrap().exp() < 1e-10);
    }

    #[test]
    fn transition_spans_the_gap() {
        let edges = Edges::new(vec![0.0, 1.0, 2.0, 3.0]).unwrap();
        let mut values = Vec::new();
        let mut modes = Vec::new();
        for (bin, counts) in [[90, 10], [12, 11], [5, 80]].iter().enumerate() {
            for (mode, count) in counts.iter().enumerate() {
                for _ in 0..*count {
                    values.push(bin as f64 + 0.5);
                    modes.push(mode);
                }
            }
        }
        let found = transitions(&values, &modes, 2, &edges, Confidence::P95).unwrap();
        assert_eq!(found.bins.iter().map(|b| b.sure).collect::<Vec<_>>(), [true, false, true]);
        let between = Interval { low: 1.0, high: 2.0 };
        assert_eq!(found.transitions, [Transition { from: 0, to: 1, between }]);
    }

    #[test]
    fn single_mode_has_no_p_value() {
        let d = dominance(&[7]).unwrap();
        assert_eq!((d.mode, d.runner_up, d.ln_p), (0, None, None));
    }
}
