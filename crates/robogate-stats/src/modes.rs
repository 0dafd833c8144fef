//! Shares of failure modes, the dominant mode, and where it changes.
//!
//! - [`distribution`]: share of each failure mode with its interval: Wilson per mode, or Wilson at a level shared over
//!   the modes, which is Goodman's simultaneous interval (all shares hold together).
//! - [`dominance`]: is the most frequent mode significantly ahead of the second? Exact sign test on their two counts,
//!   Bonferroni over the modes it could have been compared with.
//! - [`transitions`]: bins along a parameter in which a mode dominates significantly (p-values of all bins adjusted by
//!   Holm), and the places where the dominant mode changes.
//!
//! Limit: shares are of the failures that the design produced; a focused design has its own mix. Bins without
//! a significant mode belong to no mode; between two bins with different modes the change may be anywhere in the gap.
//! Sources: Goodman (1965), Technometrics 7; Holm (1979); robogate paper, table of transitions.

use crate::binning::{BinningError, Edges};
use crate::compare::sign_test;
use crate::interval::{Confidence, Interval, Trials, wilson};
use crate::multiplicity::holm;

/// Whether the intervals of a distribution hold one by one or all together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Joint {
    /// Each interval holds at the level.
    PerMode,
    /// All intervals hold together at the level (Goodman).
    Simultaneous,
}

/// One mode's part of the failures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeShare {
    /// Failures of this mode.
    pub count: u64,
    /// Share of all failures; `None` without failures.
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
            // A count never exceeds the sum it is part of.
            let trials = Trials::new(count, total).unwrap_or(Trials::NONE);
            ModeShare { count, share: trials.rate(), interval: wilson(trials, level) }
        })
        .collect()
}

/// The most frequent mode against the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dominance {
    /// Index of the most frequent mode; the first of equals.
    pub mode: usize,
    /// Index of the second; `None` where there is only one mode to choose from.
    pub runner_up: Option<usize>,
    /// Failures of the most frequent mode.
    pub count: u64,
    /// All failures.
    pub failures: u64,
    /// ln of the p-value that it is not truly the most frequent; `None` with one mode to choose from.
    pub ln_p: Option<f64>,
}

/// The dominant mode of a set of failures; `None` where nothing failed.
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
    /// Dominant mode; `None` where nothing failed.
    pub dominance: Option<Dominance>,
    /// Whether the dominant mode is sure, all bins considered together.
    pub sure: bool,
}

/// A change of the significantly dominant mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// Mode before.
    pub from: usize,
    /// Mode after.
    pub to: usize,
    /// From the lower edge of the gap (upper edge of the last sure bin before) to the lower edge of the first sure bin
    /// after; a single edge where the bins touch.
    pub between: Interval,
}

/// Modes along one parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Transitions {
    /// All bins, in order.
    pub bins: Vec<ModeBin>,
    /// Changes between sure bins, in order.
    pub transitions: Vec<Transition>,
    /// Failures outside the edges.
    pub outside: usize,
}

/// How the dominant failure mode changes along `values`.
///
/// Rows are failures only: `modes[i]`, below `mode_count`, is the mode of the failure at `values[i]`.
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
    fn no_failures_leave_every_share_open() {
        let shares = distribution(&[0, 0], Joint::PerMode, Confidence::P95);
        assert!(shares.iter().all(|s| s.share.is_none() && s.interval == Interval::UNIT));
        assert_eq!(dominance(&[0, 0, 0]), None);
        assert!(distribution(&[], Joint::Simultaneous, Confidence::P95).is_empty());
    }

    #[test]
    fn simultaneous_intervals_are_wider_than_single_ones() {
        let one = distribution(&[40, 30, 20, 10], Joint::PerMode, Confidence::P95);
        let all = distribution(&[40, 30, 20, 10], Joint::Simultaneous, Confidence::P95);
        assert!(one.iter().zip(&all).all(|(a, b)| a.interval.width() < b.interval.width()));
    }

    #[test]
    fn the_published_mixed_bin_is_not_a_sure_mode() {
        // grip_loss 33.1 % of 1,067 failures, between two bins of timeout: significantly ahead only if far ahead of the second.
        let close = dominance(&[340, 353, 214, 160]).unwrap();
        assert_eq!(close.mode, 1);
        assert!(close.ln_p.unwrap().exp() > 0.05);
        let far = dominance(&[770, 500, 400, 298]).unwrap();
        assert!(far.ln_p.unwrap().exp() < 1e-10);
    }

    #[test]
    fn a_transition_is_reported_between_sure_bins_with_its_gap() {
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
    fn a_mode_without_rivals_is_named_but_not_proved() {
        let d = dominance(&[7]).unwrap();
        assert_eq!((d.mode, d.runner_up, d.ln_p), (0, None, None));
    }
}
