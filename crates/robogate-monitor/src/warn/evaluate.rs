//! What a detector sees before failures, by failure mode.
//!
//! - At fixed seconds: the area under the ROC curve (AUROC) of the highest score so far, among the episodes that still run.
//! - Time-matched, some time before the event: the share of successes, still running at that time of their own, with a lower highest
//!   score so far; ties count half. A clock has 0.5 here, because both sides have the same age.
//! - Leads: the time from the first warning to the event.

use std::collections::BTreeMap;

use robogate_stats::Confidence;
use robogate_stats::roc;
use serde::Serialize;

use super::train::{Scored, independent_successes, quantile, upper_bound};

/// The times before the event at which scores are compared, in seconds.
pub const LEADS_S: [f64; 3] = [0.25, 0.5, 1.0];
/// The lead from which a warning is early, in seconds.
pub const EARLY_S: f64 = 0.5;
/// The lead below which a failure is only detected, in seconds.
pub const DETECTED_S: f64 = 0.25;
/// The fewest episodes on each side of a comparison.
const FEWEST: usize = 10;

/// The share of warned successes, each scenario once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FalseWarnings {
    /// The number of warned successes.
    pub warned: u64,
    /// All of them.
    pub of: u64,
    /// The one-sided 95 % upper bound of their share.
    pub upper_bound: f64,
    /// The same lower bound.
    pub lower_bound: f64,
}

/// An AUROC.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Auroc {
    /// At this time since the start, or before the event, in seconds.
    pub at_s: f64,
    /// The area. `None` with fewer than ten failures or successes.
    pub auroc: Option<f64>,
    /// The number of failures.
    pub failures: usize,
    /// The 95 % lower bound of the area, one-sided. `None` where it is unknown.
    pub lower_bound: Option<f64>,
}

/// What is seen of one failure mode, or of all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeView {
    /// The mode. `None` for all failures.
    pub mode: Option<String>,
    /// The number of failures.
    pub failures: usize,
    /// The share warned at all before the event.
    pub warned: f64,
    /// The share warned at least 0.5 s before.
    pub early: f64,
    /// The share warned less than 0.25 s before: detected.
    pub detected: f64,
    /// The median lead of the warned ones, in seconds.
    pub median_lead_s: Option<f64>,
    /// The time-matched AUROCs.
    pub matched: Vec<Auroc>,
}

/// What a score with a threshold sees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct View {
    /// Warned successes.
    pub false_warnings: FalseWarnings,
    /// All failures, then each mode by number.
    pub modes: Vec<ModeView>,
    /// AUROCs among the episodes that still run at fixed seconds.
    pub running: Vec<Auroc>,
}

impl ModeView {
    /// Whether the scores half a second before the event do not differ from those of successes of the same age. `None` if that is
    /// unknown.
    pub fn is_hidden(&self) -> Option<bool> {
        let matched = self.matched.iter().find(|of| (of.at_s - EARLY_S).abs() < 1e-9)?;
        Some(matched.lower_bound? <= 0.5)
    }
}

/// The share of warned successes of independent scenarios.
pub fn false_warnings(scored: &[Scored], threshold: f64) -> FalseWarnings {
    let successes = independent_successes(scored);
    let of = successes.len() as u64;
    let warned = successes.iter().filter(|episode| episode.highest() > threshold).count() as u64;
    FalseWarnings { warned, of, upper_bound: upper_bound(warned, of), lower_bound: 1.0 - upper_bound(of - warned, of) }
}

/// Seconds at which the episodes are compared: a quarter, a half and three quarters of the median duration of successes, and all
/// of it, to half a second.
pub fn seconds(scored: &[Scored]) -> Vec<f64> {
    let mut durations: Vec<f64> = scored.iter().filter(|of| of.failure.is_none()).map(|of| of.event_s).collect();
    durations.sort_by(f64::total_cmp);
    let median = quantile(&durations, 0.5);
    let mut seconds: Vec<f64> =
        [0.25, 0.5, 0.75, 1.0].iter().map(|share| (2.0 * share * median).round().max(1.0) / 2.0).collect();
    seconds.dedup();
    seconds
}

/// What these scores see with this threshold.
pub fn view(scored: &[Scored], threshold: f64, seconds: &[f64]) -> View {
    let highest: Vec<Vec<f64>> = scored.iter().map(|episode| running_highest(&episode.scores)).collect();
    let mut by_mode: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (at, episode) in scored.iter().enumerate() {
        if let Some(mode) = &episode.failure {
            by_mode.entry(mode).or_default().push(at);
        }
    }
    let all: Vec<usize> = by_mode.values().flatten().copied().collect();
    let mut modes: Vec<ModeView> = by_mode
        .into_iter()
        .map(|(mode, failures)| mode_view(Some(mode), &failures, scored, &highest, threshold))
        .collect();
    modes.sort_by(|a, b| b.failures.cmp(&a.failures).then_with(|| a.mode.cmp(&b.mode)));
    if !all.is_empty() {
        modes.insert(0, mode_view(None, &all, scored, &highest, threshold));
    }
    let running = seconds.iter().map(|at_s| running(scored, &highest, *at_s)).collect();
    View { false_warnings: false_warnings(scored, threshold), modes, running }
}

/// The highest score up to each evaluation.
fn running_highest(scores: &[f64]) -> Vec<f64> {
    let highest = scores.iter().scan(f64::NEG_INFINITY, |highest, score| {
        *highest = highest.max(*score);
        Some(*highest)
    });
    highest.collect()
}

/// The highest score up to this time. `None` before the first evaluation, and after the event.
fn until(episode: &Scored, highest: &[f64], time_s: f64) -> Option<f64> {
    let n = episode.times.partition_point(|t| f64::from(*t) <= time_s + 1e-4);
    (episode.event_s > time_s).then(|| n.checked_sub(1)).flatten().and_then(|at| highest.get(at).copied())
}

fn mode_view(
    mode: Option<&str>,
    failures: &[usize],
    scored: &[Scored],
    highest: &[Vec<f64>],
    threshold: f64,
) -> ModeView {
    let mut leads: Vec<f64> = failures.iter().filter_map(|at| scored[*at].lead_s(threshold)).collect();
    leads.sort_by(f64::total_cmp);
    let share =
        |of: &dyn Fn(f64) -> bool| leads.iter().filter(|lead| of(**lead)).count() as f64 / failures.len() as f64;
    let matched = LEADS_S.iter().map(|lead_s| matched(failures, scored, highest, *lead_s)).collect();
    ModeView {
        mode: mode.map(str::to_owned),
        failures: failures.len(),
        warned: share(&|_| true),
        early: share(&|lead| lead >= EARLY_S - 1e-4),
        detected: share(&|lead| lead < DETECTED_S - 1e-4),
        median_lead_s: (!leads.is_empty()).then(|| quantile(&leads, 0.5)),
        matched,
    }
}

fn matched(failures: &[usize], scored: &[Scored], highest: &[Vec<f64>], lead_s: f64) -> Auroc {
    let mut placements = Vec::new();
    for at in failures {
        let time_s = scored[*at].event_s - lead_s;
        let Some(own) = until(&scored[*at], &highest[*at], time_s) else { continue };
        let (mut n, mut below) = (0, 0.0);
        for (episode, highest) in scored.iter().zip(highest).filter(|(episode, _)| episode.failure.is_none()) {
            if let Some(other) = until(episode, highest, time_s) {
                n += 1;
                below += if other < own {
                    1.0
                } else if other > own {
                    0.0
                } else {
                    0.5
                };
            }
        }
        if n >= FEWEST {
            placements.push(below / f64::from(u32::try_from(n).unwrap_or(u32::MAX)));
        }
    }
    let n = placements.len() as f64;
    let mean = placements.iter().sum::<f64>() / n.max(1.0);
    let deviation = (placements.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    let known = placements.len() >= FEWEST;
    let lower = mean - 1.645 * deviation / n.max(1.0).sqrt();
    Auroc {
        at_s: lead_s,
        auroc: known.then_some(mean),
        failures: placements.len(),
        lower_bound: known.then_some(lower.max(0.0)),
    }
}

fn running(scored: &[Scored], highest: &[Vec<f64>], at_s: f64) -> Auroc {
    let (mut scores, mut outcomes) = (Vec::new(), Vec::new());
    for (episode, highest) in scored.iter().zip(highest) {
        if let Some(score) = until(episode, highest, at_s) {
            scores.push(-score);
            outcomes.push(episode.failure.is_none());
        }
    }
    let failures = outcomes.iter().filter(|success| !**success).count();
    let enough = failures >= FEWEST && outcomes.len() - failures >= FEWEST;
    let level = Confidence::new(0.9).unwrap_or(Confidence::P95);
    let auc = enough.then(|| roc::auc(&scores, &outcomes, None, level).ok()).flatten();
    Auroc { at_s, auroc: auc.map(|auc| auc.auc), failures, lower_bound: auc.map(|auc| auc.interval.low) }
}

/// The share of failures that random warnings with the same share of warned successes would warn at least 0.5 s before, for all
/// failures: each evaluation warns with the same probability.
pub fn random_early(scored: &[Scored], share: f64) -> Option<f64> {
    let (failures, successes): (Vec<&Scored>, Vec<&Scored>) = scored.iter().partition(|of| of.failure.is_some());
    let mean = |lengths: &[usize], p: f64| {
        let warned = lengths.iter().map(|n| 1.0 - (1.0 - p).powf(*n as f64));
        warned.sum::<f64>() / lengths.len().max(1) as f64
    };
    let all: Vec<usize> = successes.iter().map(|of| of.times.len()).collect();
    let early = |of: &&Scored| of.times.partition_point(|t| f64::from(*t) <= of.event_s - EARLY_S + 1e-4);
    let before: Vec<usize> = failures.iter().map(early).collect();
    if all.is_empty() || before.is_empty() {
        return None;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if mean(&all, middle) < share { low = middle } else { high = middle }
    }
    Some(mean(&before, low))
}
