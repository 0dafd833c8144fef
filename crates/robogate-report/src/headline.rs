//! The answer first, in plain words.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::along::{Along, AlongKind, Cell, Correlation, CriticalThreshold, Zone};
use crate::analysis::{drawn_together, is_drawn_together};
use crate::failures::unrecorded;
use crate::words::{count, counted, listed, mode, name, number, percent, percents, range, sentence, with_unit};
use crate::{Analysis, Population};

/// The answer in plain words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Headline {
    /// How often it succeeds, in one sentence.
    pub answer: String,
    /// Where and how it fails.
    pub where_it_fails: Vec<String>,
    /// What to do about it.
    pub what_to_do: Vec<String>,
    /// How far the answer can be trusted.
    pub how_sure: Vec<String>,
}

pub(crate) fn headline(analysis: &Analysis) -> Headline {
    Headline {
        answer: answer(analysis),
        where_it_fails: where_it_fails(analysis),
        what_to_do: what_to_do(analysis),
        how_sure: how_sure(analysis),
    }
}

fn answer(analysis: &Analysis) -> String {
    let rate = &analysis.success.rate;
    let Some(share) = rate.rate else {
        return "No valid episode: nothing can be said about this policy.".to_owned();
    };
    let of = match analysis.population {
        Population::OperatingSpace => "over the operating space",
        Population::AsImported => "over the imported episodes",
        Population::Suite => "over the scenarios of the suite (this is no operating rate)",
        _ => "in a focused design (this is no operating rate)",
    };
    let chance = if rate.n < 30 {
        String::new()
    } else if share < 0.005 {
        ": practically never".to_owned()
    } else if share > 0.995 {
        ": practically always".to_owned()
    } else {
        format!(": about {} times in 10", (10.0 * share).round().clamp(0.0, 10.0))
    };
    format!("The policy succeeded in {} of {} {of}{chance}.", count(rate.successes), counted(rate.n, "valid episode"))
}

fn where_it_fails(analysis: &Analysis) -> Vec<String> {
    let mut lines = Vec::new();
    let modes = &analysis.failure_modes;
    if modes.failures > 0 && !modes.not_recorded.is_empty() {
        lines.push(format!("How it fails cannot be said: {}.", unrecorded(&modes.not_recorded)));
    } else if modes.failures > 0 {
        let mut by: Vec<_> = modes.modes.iter().filter(|m| m.failures > 0).collect();
        by.sort_by_key(|m| std::cmp::Reverse(m.failures));
        let told: Vec<String> = by
            .iter()
            .take(2)
            .map(|m| format!("{} ({})", mode(&m.mode), percent(m.share.unwrap_or_default())))
            .collect();
        let others = if by.len() > 2 { "mostly by" } else { "by" };
        lines.push(format!("It fails {others} {}.", listed(&told)));
    } else if analysis.success.rate.n > 0 {
        lines.push("No failure was seen; that bounds the failure rate, it does not make it zero.".to_owned());
    }
    let stretches = worst_stretches(analysis);
    for (along, stretch) in stretches.iter().take(3) {
        lines.push(format!(
            "{} {}: {} success in {}.",
            sentence(&along.label),
            with_unit(&stretch.label, &along.parameter),
            percent(stretch.rate),
            counted(stretch.n, "episode")
        ));
    }
    if stretches.is_empty() && modes.failures > 0 && !analysis.along.is_empty() {
        lines.push(
            "No bin or level of any one parameter is surely below 40 % success and below the overall rate.".into(),
        );
    }
    lines
}

/// Neighbouring cells of one parameter in which it surely fails.
struct Stretch {
    label: String,
    rate: f64,
    n: u64,
}

/// For each parameter the stretch of cells around its worst one that are all sure danger zones and surely below the
/// overall rate; parameters that go most with success first.
fn worst_stretches(analysis: &Analysis) -> Vec<(&Along, Stretch)> {
    let overall = analysis.success.rate.rate.unwrap_or(0.0);
    let mut found: Vec<(&Along, Stretch)> = Vec::new();
    for along in &analysis.along {
        let sure = |cell: &Cell| {
            cell.rate.wilson_95[1] < overall
                && analysis
                    .danger_zones
                    .zones
                    .iter()
                    .any(|z| z.sure && z.parameter == along.parameter && z.cell == cell.label)
        };
        let cells = &along.cells;
        let low = |i: &usize| cells[*i].rate.rate.unwrap_or(1.0);
        let Some(worst) = (0..cells.len()).filter(|i| sure(&cells[*i])).min_by(|a, b| low(a).total_cmp(&low(b))) else {
            continue;
        };
        let (mut from, mut to) = (worst, worst);
        // Categories have no neighbours.
        if !matches!(along.kind, AlongKind::Categorical) {
            while from > 0 && sure(&cells[from - 1]) {
                from -= 1;
            }
            while to + 1 < cells.len() && sure(&cells[to + 1]) {
                to += 1;
            }
        }
        let n: u64 = cells[from..=to].iter().map(|c| c.rate.n).sum();
        let successes: u64 = cells[from..=to].iter().map(|c| c.rate.successes).sum();
        let label = match (cells[from].range, cells[to].range) {
            (Some([low, _]), Some([_, high])) => range([low, high]),
            _ if from == to => cells[from].label.clone(),
            _ => format!("{} to {}", cells[from].label, cells[to].label),
        };
        found.push((along, Stretch { label, rate: successes as f64 / n.max(1) as f64, n }));
    }
    let strength = |a: &Along| a.correlation.estimated().map_or(0.0, |c| c.strength());
    found.sort_by(|a, b| strength(b.0).total_cmp(&strength(a.0)));
    found
}

fn what_to_do(analysis: &Analysis) -> Vec<String> {
    let mut lines = Vec::new();
    let rate = &analysis.success.rate;
    if rate.n == 0 {
        lines.push(
            "Find out why no episode is valid; the faults are counted under how the points were drawn.".to_owned(),
        );
        return lines;
    }
    if analysis.success.bounds.invalid * 50 > rate.n {
        lines.push(format!(
            "Look into the {} first: they are more than 2 % of the evidence.",
            counted(analysis.success.bounds.invalid, "invalid episode")
        ));
    }
    let mut thresholds: Vec<(&Along, f64, bool, f64)> = analysis
        .along
        .iter()
        .filter(|along| !is_drawn_together(analysis, &along.parameter))
        .filter_map(|along| match along.threshold.estimated()? {
            CriticalThreshold::Crosses { at, rising, crossing_share, .. } if *crossing_share >= 0.95 => {
                let strength = along.correlation.estimated().map_or(0.0, |c| c.strength());
                Some((along, *at, *rising, strength))
            }
            _ => None,
        })
        .collect();
    thresholds.sort_by(|a, b| b.3.total_cmp(&a.3));
    for (along, at, rising, _) in thresholds.iter().take(2) {
        lines.push(format!(
            "Keep {} {} {}: {} it, failure is likelier than success (averaged over the other parameters).",
            along.label,
            if *rising { "above" } else { "below" },
            with_unit(&number(*at), &along.parameter),
            if *rising { "below" } else { "above" }
        ));
    }
    if thresholds.is_empty() {
        let strength = |a: &Along| a.correlation.estimated().map_or(0.0, |c| c.strength());
        let mut ranked: Vec<&Along> =
            analysis.along.iter().filter(|a| surely_matters(a) && !is_drawn_together(analysis, &a.parameter)).collect();
        ranked.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
        for along in ranked.into_iter().take(2) {
            let rated = |pick: fn(f64, f64) -> bool| {
                let mut best: Option<(&Cell, f64)> = None;
                for cell in along.cells.iter().filter(|c| c.rate.n >= 20) {
                    if let Some(rate) = cell.rate.rate.filter(|r| best.is_none_or(|(_, b)| pick(*r, b))) {
                        best = Some((cell, rate));
                    }
                }
                best
            };
            if let (Some((best, high)), Some((worst, low))) = (rated(|a, b| a > b), rated(|a, b| a < b)) {
                lines.push(format!(
                    "Narrow {}: success is {} at {} and {} at {}.",
                    along.label,
                    percent(high),
                    with_unit(&best.label, &along.parameter),
                    percent(low),
                    with_unit(&worst.label, &along.parameter)
                ));
            }
        }
    }
    let together = drawn_together(analysis);
    if !together.is_empty() {
        lines.push(format!(
            "The space draws {} together: success along one of them may be the doing of another, so none is advised on alone.",
            listed(&together)
        ));
    }
    // Where the scenarios were chosen, a cell of the map is a handful of questions and no place to operate in.
    let map = analysis.envelopes.first().and_then(|e| e.map.estimated());
    if let Some(map) = map.filter(|_| analysis.population != Population::Suite) {
        let best = map.cells.iter().filter(|c| c.zone == Zone::Safe).count();
        let (up, across) = (name(&map.y.parameter), name(&map.x.parameter));
        lines.push(match best {
            0 => format!("No cell of the {up} \u{d7} {across} map is surely at 70 % success: do not rely on one yet."),
            1 => format!("One cell of the {up} \u{d7} {across} map is surely at 70 % success or more: operate there."),
            n => {
                format!("{n} cells of the {up} \u{d7} {across} map are surely at 70 % success or more: operate there.")
            }
        });
    }
    let unexplained = analysis.replay.iter().find(|g| g.title.starts_with("Failed where"));
    if let (Some(first), true) = (unexplained.and_then(|g| g.episodes.first()), analysis.subject.replayable) {
        lines.push(format!(
            "Watch the failures that nothing explains, beginning with episode {}; they are listed below.",
            first.index
        ));
    }
    lines
}

/// Whether a parameter surely goes with success: a p-value far below what many looks would give by chance.
fn surely_matters(along: &Along) -> bool {
    let ln_p = match along.correlation.estimated() {
        Some(Correlation::Number { ln_p, .. }) => *ln_p,
        Some(Correlation::Category { ln_p, .. }) => Some(*ln_p),
        None => None,
    };
    ln_p.is_some_and(|p| p < 0.001_f64.ln())
}

fn how_sure(analysis: &Analysis) -> Vec<String> {
    let success = &analysis.success;
    let rate = &success.rate;
    let mut lines = Vec::new();
    if rate.n == 0 {
        lines.push("Without a valid episode the rate may be anything from 0 to 100 %.".to_owned());
        return lines;
    }
    lines.push(format!(
        "95 % interval {} (Wilson), {} (exact).",
        percents(rate.wilson_95),
        percents(rate.clopper_pearson_95)
    ));
    if success.bounds.invalid > 0 {
        lines.push(format!(
            "{} are no evidence; counting them all one way or the other, the rate is {} to {}.",
            counted(success.bounds.invalid, "invalid episode"),
            success.bounds.worst_case.map_or_else(|| "-".to_owned(), percent),
            success.bounds.best_case.map_or_else(|| "-".to_owned(), percent)
        ));
    }
    if let Some(found) = success.reweighted.as_ref().and_then(|r| r.estimated()) {
        lines.push(format!(
            "With the focused rows by their weights: {}, interval {}, effective sample size {} of {} rows.",
            percent(found.estimate.rate),
            percents(found.estimate.interval_95),
            count(found.estimate.effective_sample_size.round() as u64),
            count(found.rows)
        ));
    }
    let roc = analysis.risk.estimated().and_then(|r| r.roc.estimated());
    if let Some(auc) = roc.and_then(|roc| roc.auc_cross_validated) {
        lines.push(format!(
                "Knowing the parameters, a risk model ranks a failure above a success {} of the time (cross-validated AUC).",
                percent(auc)
            ));
    }
    lines
}
