//! The headline of a comparison in sentences, and what the comparison does not say.

use robogate_analysis::labels::{mode_label, parameter_label};
use robogate_analysis::{Comparison, PairedComparison, Population};
use robogate_stats::format::{count, counted, list, percent, percent_range, points, points_range, sentence};
use schemars::JsonSchema;
use serde::Serialize;

/// The answer in plain words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ComparisonHeadline {
    /// One or two sentences.
    pub answer: String,
    /// What tells them apart.
    pub what_differs: Vec<String>,
    /// What they have in common.
    pub what_is_common: Vec<String>,
    /// What stands behind it.
    pub how_sure: Vec<String>,
}

impl ComparisonHeadline {
    /// The headline of a comparison.
    pub fn of(comparison: &Comparison) -> Self {
        Self {
            answer: answer(comparison),
            what_differs: what_differs(comparison),
            what_is_common: what_is_common(comparison),
            how_sure: how_sure(comparison),
        }
    }
}

fn answer(of: &Comparison) -> String {
    if !of.has_evidence() {
        return "Nothing can be said: fewer than two of the dictionaries hold evidence that may be compared."
            .to_owned();
    }
    if let Some(widest) = widest(&of.paired) {
        let Some(gap) = widest.gap else { return "No scenario has evidence from both.".to_owned() };
        let flips = widest.first_only + widest.second_only;
        let sure = if widest.holm_p <= 0.05 { "surely differ" } else { "cannot be told apart" };
        return format!(
            "On the same {} {} succeeds in {} and {} in {}: they {sure} ({} points, {}). {} flip.",
            counted(widest.valid_pairs, "scenario"),
            widest.first,
            widest.first_rate.rate.map_or_else(|| "-".to_owned(), percent),
            widest.second,
            widest.second_rate.rate.map_or_else(|| "-".to_owned(), percent),
            points(gap),
            points_range(widest.gap_95),
            count(flips)
        );
    }
    let mut ranked: Vec<(f64, &str)> = of
        .dictionaries
        .iter()
        .filter(|dictionary| dictionary.left_out.is_none())
        .filter_map(|dictionary| Some((dictionary.success.rate.rate?, dictionary.name.as_str())))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let order: Vec<String> = ranked.iter().map(|(rate, name)| format!("{name} {}", percent(*rate))).collect();
    let sure = of.differences.iter().filter(|difference| difference.holm_p <= 0.05).count();
    let pairs = of.differences.len();
    let told = match (sure, pairs) {
        (0, 1) => "The two cannot be told apart".to_owned(),
        (1, 1) => "The two surely differ".to_owned(),
        (0, _) => "No two of them can be told apart".to_owned(),
        (sure, pairs) if sure == pairs => "Every two of them surely differ".to_owned(),
        (sure, pairs) => format!("{sure} of {pairs} pairs surely differ"),
    };
    let unlike = unlike(of);
    let spaces = if unlike.is_empty() {
        String::new()
    } else {
        format!(" Their operating spaces differ in {}: so does what these rates speak of.", list(&unlike))
    };
    format!("Success: {}. {told}.{spaces}", order.join(", "))
}

/// The parameters in which the operating spaces differ.
fn unlike(of: &Comparison) -> Vec<String> {
    let covered = of.along.iter().filter(|curve| curve.remark.is_some()).map(|curve| &curve.parameter);
    covered
        .chain(of.parameters.not_shared.iter().map(|of| &of.parameter))
        .map(|parameter| parameter_label(parameter))
        .collect()
}

fn widest(paired: &[PairedComparison]) -> Option<&PairedComparison> {
    paired.iter().max_by(|a, b| {
        let size = |of: &PairedComparison| of.gap.map_or(-1.0, f64::abs);
        size(a).total_cmp(&size(b)).then(std::cmp::Ordering::Greater)
    })
}

fn what_differs(of: &Comparison) -> Vec<String> {
    let mut lines: Vec<String> = of
        .differences
        .iter()
        .take(6)
        .map(|d| {
            let sure = if d.holm_p <= 0.05 { "" } else { ", not sure" };
            let paired = d.valid_pairs.map_or_else(String::new, |n| format!(" on the same {}", counted(n, "scenario")));
            format!(
                "{} against {}{paired}: {} points ({}){sure}.",
                d.first,
                d.second,
                points(d.difference),
                points_range(d.interval_95)
            )
        })
        .collect();
    for pair in of.paired.iter().take(4) {
        lines.push(format!(
            "{} scenarios only {} solves, {} only {}.",
            count(pair.first_only),
            pair.first,
            count(pair.second_only),
            pair.second
        ));
    }
    let modes: Vec<String> = of
        .dictionaries
        .iter()
        .filter_map(|d| Some(format!("{} by {}", d.name, mode_label(d.failure_modes.dominant.estimated()?))))
        .collect();
    if !modes.is_empty() {
        lines.push(format!("Fails mostly: {}.", list(&modes)));
    }
    lines.extend(lowers_success(of).into_iter().filter(|(all, _)| !all).map(|(_, line)| line));
    lines
}

fn what_is_common(of: &Comparison) -> Vec<String> {
    if of.compared.len() < 2 {
        return vec!["There are no two of them to look at.".to_owned()];
    }
    let mut lines = Vec::new();
    let zones = &of.universal_zones;
    let sure: Vec<_> = zones.zones.iter().filter(|zone| zone.sure).collect();
    let limit = format!("{:.0} %", 100.0 * zones.limit);
    match sure.as_slice() {
        [] if zones.looked_at == 0 => {
            lines.push("Where all of them fail cannot be said: no cell holds enough episodes of each.".to_owned());
        }
        [] => lines.push(format!(
            "In none of {} is it sure that all of them are below {limit}.",
            counted(zones.looked_at, "cell")
        )),
        [first, ..] => lines.push(format!(
            "All of them are surely below {limit} in {} of {} looked at, first of all at {}.",
            counted(sure.len() as u64, "cell"),
            count(zones.looked_at),
            first.describe()
        )),
    }
    lines.extend(lowers_success(of).into_iter().filter(|(all, _)| *all).map(|(_, line)| line));
    let shared = of.parameters.shared.len() as u64;
    lines.push(match shared {
        0 => "They share no parameter, so that only rates and failure modes can be compared.".to_owned(),
        _ => {
            let names: Vec<String> = of.parameters.shared.iter().map(|p| parameter_label(p)).collect();
            format!("{} shared: {}.", counted(shared, "parameter"), list(&names))
        }
    });
    lines
}

/// Whose success larger values of the task's parameter lower, and whether that is every one of them.
fn lowers_success(of: &Comparison) -> Option<(bool, String)> {
    let sensitivity = of.sensitivity.estimated()?;
    let parameter = sentence(&parameter_label(&sensitivity.parameter));
    match sensitivity.lowers_success_of.as_slice() {
        [] => None,
        all if all.len() == sensitivity.effects.len() => {
            Some((true, format!("{parameter} surely hurts every one of them.")))
        }
        some => Some((false, format!("{parameter} surely hurts {}; of the others that is not sure.", list(some)))),
    }
}

fn how_sure(of: &Comparison) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for dictionary in &of.dictionaries {
        let rate = &dictionary.success.rate;
        match &dictionary.left_out {
            Some(because) => lines.push(format!("{} is not compared: {because}.", dictionary.name)),
            None => lines.push(format!(
                "{}: {} ({}) in {}.",
                dictionary.name,
                rate.rate.map_or_else(|| "-".to_owned(), percent),
                percent_range(rate.wilson_95),
                counted(rate.n, "valid episode")
            )),
        }
    }
    for pair in &of.paired {
        if let Some(bounds) = pair.invalid.gap_bounds {
            lines.push(format!(
                "{} without evidence from both could move the gap between {} and {} to anything from {} points.",
                counted(pair.invalid.either, "scenario"),
                pair.first,
                pair.second,
                points_range(bounds)
            ));
        }
    }
    lines
}

/// What a comparison does not say, in sentences.
pub fn comparison_limits(of: &Comparison) -> Vec<String> {
    let mut lines = Vec::new();
    for dictionary in &of.dictionaries {
        if let Some(because) = &dictionary.left_out {
            lines.push(format!("{} is shown and not compared: {because}.", dictionary.name));
        }
        let bounds = &dictionary.success.bounds;
        if let (1.., Some(worst), Some(best)) = (bounds.invalid, bounds.worst_case, bounds.best_case) {
            lines.push(format!(
                "{} of {} are invalid and in no rate; whatever they had been, its rate would lie between {} and {}.",
                counted(bounds.invalid, "episode"),
                dictionary.name,
                percent(worst),
                percent(best)
            ));
        }
    }
    if of.dictionaries.iter().any(|d| d.left_out.is_none() && d.population == Population::AsImported) {
        lines.push(
            "Imported rows are taken as a draw from their operating space; how they were drawn is not known here."
                .to_owned(),
        );
    }
    let unlike = unlike(of);
    if !unlike.is_empty() {
        lines.push(format!(
            "Their operating spaces differ in {}: a difference of success rates is also one of spaces.",
            list(&unlike)
        ));
    }
    for of in of.differences.iter().filter(|of| of.valid_pairs.is_some()) {
        lines.push(format!(
            "{} and {} ran the same scenarios: their difference is that of the pairs. --paired shows which of them flip.",
            of.first, of.second
        ));
    }
    lines.push(
        "A curve shows one parameter while the others vary as each dictionary drew them; it is no effect of that \
         parameter alone where spaces differ."
            .to_owned(),
    );
    lines.push(
        "Universal zones are cells of a grid: they say nothing within a cell, nor of the robots that were not compared."
            .to_owned(),
    );
    if of.reach.iter().any(|row| row.ratio.is_some()) {
        lines.push(
            "Reach goes with whatever else sets these robots apart; a few of them show no law of reach.".to_owned(),
        );
    }
    lines
}
