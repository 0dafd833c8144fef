//! The summary at the end of a campaign.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

use robogate_analysis::{Analysis, Finding};
use robogate_campaign::folder::DICTIONARY;
use robogate_campaign::{
    BoundaryReport, DrawnFrom, GroupSummary, OutcomeCounts, Population, Sought, Stage, StageSummary, SuiteSummary,
    Summary,
};
use robogate_core::FailureMode;
use robogate_gate::{HANDOVER, NominalRate, Twins, WARNED_STOP, WarnerEffect};
use robogate_report::{Additions, Headline, analysis_text};
use robogate_stats::format::counted;
use serde_json::json;

use crate::active_model;
use crate::commands::report::PAGE;
use crate::terminal::{bold, dim, foreign, grouped, is_verbose, line, percent, print_report, wrapped};
use robogate_session::text::quoted;

/// The campaigns beside a run.
pub(crate) struct Arms<'a> {
    /// The comparison with the control arm.
    pub(crate) twins: Option<&'a Twins>,
    /// The success rate with nothing varied.
    pub(crate) nominal: Option<&'a NominalRate>,
    /// What a warner changed.
    pub(crate) warner: Option<&'a WarnerEffect>,
}

/// Prints the summary as one JSON document.
pub(crate) fn json(
    dir: &Path,
    summary: &Summary,
    boundary: Option<&BoundaryReport>,
    arms: Arms<'_>,
    analysis: Option<&Analysis>,
) -> serde_json::Result<()> {
    let mut document = json!({ "version": 1, "dir": dir, "summary": summary, "boundary": boundary });
    if let (Some(document), Some((rate, interval_95))) = (document.as_object_mut(), leading_rate(summary, analysis)) {
        document.insert("success".to_owned(), json!({ "rate": rate, "interval_95": interval_95 }));
    }
    if let Some(document) = document.as_object_mut() {
        if let Some(twins) = arms.twins {
            document.insert("twins".to_owned(), serde_json::to_value(twins)?);
        }
        if let Some(nominal) = arms.nominal {
            document.insert("nominal".to_owned(), serde_json::to_value(nominal)?);
        }
        if let Some(warner) = arms.warner {
            document.insert("warner".to_owned(), serde_json::to_value(warner)?);
        }
    }
    line(serde_json::to_string_pretty(&document)?);
    Ok(())
}

/// Prints the summary for people: one rate, where the policy fails, and what to do. `--verbose` adds the rest.
pub(crate) fn print(
    dir: &Path,
    summary: &Summary,
    boundary: Option<&BoundaryReport>,
    analysis: Option<&Analysis>,
    arms: &Arms<'_>,
) {
    line("");
    headline_rate(summary, analysis);
    arms.nominal.iter().for_each(|nominal| line(format_args!("                 {}", nominal.line())));
    // Counts of episodes that a design chose are not those of the operating space.
    if let [stage] = summary.stages.as_slice() {
        failures_in_one_line(stage);
    }
    if let Some(warner) = arms.warner {
        line("");
        warner.lines().iter().for_each(|text| wrapped(text));
    }
    excluded(&summary.stages);
    if let Some(found) = &summary.sought {
        sought(found);
    }
    if let Some(outside) = summary.outside_range.as_ref().filter(|outside| outside.episodes > 0) {
        line(outside);
    }
    if let Some(again) = &summary.run_again {
        line(format_args!(
            "{} ran again after {}, the first because of {}",
            counted(again.episodes, "episode"),
            counted(again.lost_attempts, "lost attempt"),
            foreign(&again.first_fault)
        ));
    }
    if let Some(analysis) = analysis {
        headline(analysis);
    }
    if let Some(suite) = &summary.suite {
        groups(suite);
    }
    other_populations(summary);
    if is_verbose() {
        details(dir, boundary, analysis);
    }
    files(dir, summary);
}

/// Prints what the headline leaves out: the analysis, and the boundary stage.
fn details(dir: &Path, boundary: Option<&BoundaryReport>, analysis: Option<&Analysis>) {
    if let Some(analysis) = analysis {
        let active = active_model::of_run(dir);
        line("");
        print_report(&analysis_text(analysis, &Additions { active: active.as_ref(), ..Additions::default() }));
    }
    boundary.iter().for_each(|report| found(report));
}

/// The rate that the report leads with: that of all episodes by their weights, if a design chose some of them.
fn leading_rate(summary: &Summary, analysis: Option<&Analysis>) -> Option<(f64, [f64; 2])> {
    let of_analysis =
        analysis.and_then(|analysis| Some((analysis.success.rate.rate?, analysis.success.rate.wilson_95)));
    of_analysis.or_else(|| Some((summary.estimate.success_rate?, summary.estimate.interval_95)))
}

/// The rate that the run is about: that over its population from all episodes.
fn headline_rate(summary: &Summary, analysis: Option<&Analysis>) {
    let weighting = analysis.and_then(|analysis| analysis.success.weighting.as_ref());
    let is_active = summary.stages.iter().any(|stage| stage.stage == Stage::Active);
    let is_weighted = is_active || matches!(weighting, Some(Finding::Estimated(_)));
    match leading_rate(summary, analysis).filter(|_| is_weighted) {
        Some((rate, [low, high])) => line(format_args!(
            "{}  over the operating space, 95 % interval {} to {}; {}",
            bold(format_args!("success {:>6}", percent(rate))),
            percent(low),
            percent(high),
            valid_of(summary)
        )),
        None => summary.stages.iter().for_each(|stage| rate(stage, &summary.sampler)),
    }
}

/// The episodes that a rate counts.
fn valid_of(summary: &Summary) -> String {
    let valid: u64 = summary.stages.iter().map(|stage| stage.valid).sum();
    let all = counted(summary.episodes, "episode");
    if valid < summary.episodes { format!("{} valid of {all}", grouped(valid)) } else { all }
}

/// The failures of a stage by mode, the most frequent first.
fn failures_in_one_line(stage: &StageSummary) {
    let mut modes: Vec<_> = stage.failure_modes.iter().filter(|mode| mode.episodes > 0).collect();
    modes.sort_by_key(|mode| Reverse(mode.episodes));
    // An episode that a warning ended is no failure by a mode of the task.
    let ended = |mode: &FailureMode| [WARNED_STOP, HANDOVER].contains(mode);
    let stopped: u64 = modes.iter().filter(|of| ended(&of.mode)).map(|of| of.episodes).sum();
    if stopped > 0 {
        line(format_args!("                 {} ended at a warning", counted(stopped, "episode")));
    }
    modes.retain(|of| !ended(&of.mode));
    let failures: u64 = modes.iter().map(|mode| mode.episodes).sum();
    if failures > 0 {
        let modes: Vec<String> =
            modes.iter().map(|mode| format!("{} {}", mode.mode.as_str(), grouped(mode.episodes))).collect();
        line(format_args!("                 {}: {}", counted(failures, "failure"), modes.join(", ")));
    }
}

/// Rates over parts of the population.
fn other_populations(summary: &Summary) {
    let parts = || summary.stages.iter().filter(|stage| stage.population != Population::FocusedDesign);
    if is_verbose() || !parts().any(|stage| stage.feasible.as_ref().is_some_and(|part| part.valid < stage.valid)) {
        return;
    }
    line("");
    line(bold("Other populations"));
    parts().for_each(feasible);
}

/// Most failure modes in one line. An environment of another author may invent a mode for each episode.
const MODES_IN_LINE: usize = 12;

/// Formats the counts of an unfinished campaign in one line.
pub(crate) fn outcomes_in_one_line(counts: &OutcomeCounts) -> String {
    let mut text = match counts.success_rate() {
        Some(rate) => format!("success {} ({} of {})", percent(rate), grouped(counts.success), grouped(counts.valid())),
        None => "no valid episode yet".to_owned(),
    };
    // First, because a narrow terminal cuts the end.
    if counts.invalid > 0 {
        text += &format!(" · INVALID {}", grouped(counts.invalid));
    }
    let mut failures: Vec<_> = counts.failures.iter().collect();
    if failures.len() > MODES_IN_LINE {
        failures.sort_by_key(|(_, count)| Reverse(**count));
    }
    for (mode, count) in failures.iter().take(MODES_IN_LINE) {
        text += &format!(" · {mode} {}", grouped(**count));
    }
    if let Some(others) = failures.get(MODES_IN_LINE..).filter(|others| !others.is_empty()) {
        let episodes = others.iter().map(|(_, count)| **count).sum();
        text += &format!(" · {} other modes {}", others.len(), grouped(episodes));
    }
    text
}

fn rate(stage: &StageSummary, sampler: &str) {
    let [low, high] = stage.interval_95;
    let of = match stage.population {
        Population::OperatingSpace => "over the operating space",
        Population::Suite => "over the suite (not an operating space)",
        Population::FocusedDesign => "in the focused design (not the operating space)",
    };
    match stage.success_rate {
        Some(rate) => line(format_args!(
            "{}  {of}: {} of {}, 95 % interval {} to {}",
            bold(format_args!("success {:>6}", percent(rate))),
            grouped(stage.successes),
            grouped(stage.valid),
            percent(low),
            percent(high)
        )),
        None => line(format_args!("success      -  {of}: no valid episode, so no estimate")),
    }
    if is_verbose() && stage.population == Population::OperatingSpace {
        let conservative = if sampler == "uniform" { "" } else { ", conservative for this design" };
        line(dim(format_args!("                 each parameter uniform on its scale; Wilson interval{conservative}")));
    }
}

/// The invalid episodes of all stages.
fn excluded(stages: &[StageSummary]) {
    let invalid: u64 = stages.iter().map(|stage| stage.invalid).sum();
    let mut kinds: BTreeMap<String, u64> = BTreeMap::new();
    stages.iter().flat_map(|stage| &stage.faults).for_each(|of| {
        *kinds.entry(of.fault.to_string()).or_default() += of.episodes;
    });
    if invalid > 0 {
        let kinds: Vec<String> = kinds.iter().map(|(fault, n)| format!("{n} {fault}")).collect();
        line(format_args!(
            "                 {} {} excluded: {}",
            counted(invalid, "invalid episode"),
            if invalid == 1 { "is" } else { "are" },
            kinds.join(", ")
        ));
    }
}

/// The rate of the failure mode that the campaign sought.
fn sought(found: &Sought) {
    let Some(rate) = found.rate else { return };
    let [low, high] = found.interval_95;
    let saved = found.worth_episodes.map_or_else(String::new, |worth| {
        format!("; as precise as {} uniform episodes", grouped(worth.round() as u64))
    });
    line(format_args!(
        "{}  over the operating space: {} of {} episodes failed in this way, 95 % interval {} to {}{saved}",
        bold(format_args!("{} {}", found.mode, small_percent(rate))),
        grouped(found.failures),
        grouped(found.valid),
        small_percent(low),
        small_percent(high),
    ));
}

/// The rate over the scenarios that some policy may complete, if there are others.
fn feasible(stage: &StageSummary) {
    let Some(part) = stage.feasible.as_ref().filter(|part| part.valid < stage.valid) else { return };
    let share = part.share.map_or_else(|| "-".to_owned(), percent);
    match part.success_rate {
        Some(rate) => line(format_args!(
            "{}  over the feasible part ({share} of it): {} of {}, 95 % interval {} to {}",
            bold(format_args!("success {:>6}", percent(rate))),
            grouped(part.successes),
            grouped(part.valid),
            percent(part.interval_95[0]),
            percent(part.interval_95[1])
        )),
        None => line("success      -  over the feasible part: no policy can complete any of these scenarios"),
    }
}

/// The width of a column of names, in characters: at least `least`.
fn widest<'a>(names: impl Iterator<Item = &'a str>, least: usize) -> usize {
    names.map(|name| name.chars().count()).fold(least, usize::max)
}

/// Groups of a suite that are shown.
const MAX_GROUPS: usize = 6;

fn groups(suite: &SuiteSummary) {
    line("");
    let rounds = if suite.rounds == 1 { "1 round".to_owned() } else { format!("{} rounds", grouped(suite.rounds)) };
    line(bold(format_args!("{} {}, {rounds}", suite.name, suite.version)));
    let troubled = |group: &&GroupSummary| group.outcomes.success < group.outcomes.total();
    let all = suite.groups.len();
    let mut groups: Vec<&GroupSummary> = suite.groups.iter().filter(|group| is_verbose() || troubled(group)).collect();
    if groups.is_empty() {
        line(format_args!("  all episodes of all {all} scenario groups succeeded"));
        return;
    }
    if !is_verbose() {
        // The worst first.
        groups.sort_by(|a, b| a.success_rate.unwrap_or(0.0).total_cmp(&b.success_rate.unwrap_or(0.0)));
        let left_out = groups.len().saturating_sub(MAX_GROUPS);
        groups.truncate(MAX_GROUPS);
        if left_out > 0 {
            line(dim(format_args!(
                "  the {MAX_GROUPS} weakest of {} groups with failures; --verbose lists all",
                left_out + MAX_GROUPS
            )));
        }
    }
    let names: Vec<String> = groups.iter().map(|group| format!("{} / {}", group.category, group.group)).collect();
    let wide = widest(names.iter().map(String::as_str), 40);
    for (group, name) in groups.into_iter().zip(names) {
        let OutcomeCounts { success, invalid, .. } = group.outcomes;
        let rate = group.success_rate.map_or_else(|| "-".to_owned(), percent);
        let invalid = if invalid > 0 { format!(", {} invalid", grouped(invalid)) } else { String::new() };
        line(format_args!(
            "  {name:<wide$} {rate:>8}  {:>6} of {}{invalid}",
            grouped(success),
            grouped(group.outcomes.valid())
        ));
    }
}

/// Where the policy fails and what to do, as in the report.
pub(crate) fn headline(analysis: &Analysis) {
    let headline = Headline::of(analysis);
    for (title, lines) in [("Where it fails", &headline.where_it_fails), ("What to do", &headline.what_to_do)] {
        if !lines.is_empty() {
            line("");
            line(bold(title));
            lines.iter().for_each(|text| wrapped(text));
        }
    }
}

fn found(report: &BoundaryReport) {
    let [low, high] = report.band;
    line("");
    line(bold(format_args!(
        "Where success turns into failure (bins at {:.0} to {:.0} % success)",
        100.0 * low,
        100.0 * high
    )));
    let varied = report.parameters.iter().map(|parameter| &*parameter.effect.parameter);
    let wide = widest(varied.chain(report.restricted.iter().map(|restricted| &*restricted.parameter)), 14);
    for parameter in &report.parameters {
        let [from, to] = parameter.drawn;
        let how = match parameter.drawn_from {
            DrawnFrom::Bins => format!("{} of {} bins", parameter.in_band.len(), parameter.effect.bins.len()),
            DrawnFrom::Fallback => "no bin in the band: fallback range".to_owned(),
            DrawnFrom::WholeRange => "no bin in the band: whole range".to_owned(),
        };
        line(format_args!("  {:<wide$} {from:>7.4} to {to:>7.4}  {how}", parameter.effect.parameter));
    }
    for restricted in &report.restricted {
        line(format_args!(
            "  {:<wide$} {:>7} to {:>7}  restricted by the plan",
            restricted.parameter, restricted.low, restricted.high
        ));
    }
    wrapped(&format!(
        "the region covers {} of the operating space; {} episodes sampled uniformly in it{}",
        small_percent(report.volume.share_of_operating_space),
        grouped(report.volume.episodes),
        match &report.emphasis {
            Some(emphasis) => format!(
                ", {} in the emphasis region{}",
                grouped(emphasis.region.episodes),
                match emphasis.beyond.as_slice() {
                    [] => String::new(),
                    beyond => format!(", which lies outside it along {}", beyond.join(" and ")),
                }
            ),
            None => String::new(),
        }
    ));
}

/// Formats a share that may be very small, with two significant digits.
fn small_percent(share: f64) -> String {
    if share >= 0.1 { percent(share) } else { format!("{:.1$} %", 100.0 * share, decimals_of(100.0 * share)) }
}

/// Decimals that show two digits of a number.
fn decimals_of(x: f64) -> usize {
    if x > 0.0 { (1.0 - x.log10().floor()).clamp(0.0, 13.0) as usize } else { 1 }
}

fn files(dir: &Path, summary: &Summary) {
    let (run, hash) = (quoted(dir), &summary.dataset_hash);
    line("");
    line(format_args!("{}  {}, dataset {}", bold("rows   "), dir.join(DICTIONARY).display(), hash));
    line(format_args!("{}  {}", bold("report "), dir.join(PAGE).display()));
    line(format_args!("{}  robogate view {run}", bold("next   ")));
}

#[cfg(test)]
mod tests {
    use robogate_campaign::OutcomeCounts;
    use robogate_core::{FailureMode, Outcome};

    use super::{decimals_of, outcomes_in_one_line};

    /// An environment may invent a failure mode for each episode.
    #[test]
    fn lines_of_outcomes_are_bounded() {
        let mut counts = OutcomeCounts::default();
        for n in 0..1_000 {
            counts.add(&Outcome::Failure(FailureMode::from_foreign(&format!("mode-{n}"))));
        }
        counts.add(&Outcome::Failure(FailureMode::from_foreign("mode-999")));
        let line = outcomes_in_one_line(&counts);
        assert!(line.contains("mode-999 2") && line.contains("988 other modes 988") && line.len() < 400, "{line}");
    }

    /// The ends of a narrow range differ in the digits that are shown.
    #[test]
    fn two_digits_of_a_difference_are_shown() {
        for (difference, decimals) in [(0.000_28, 5), (0.04, 3), (0.5, 2), (1.0, 1), (80.0, 0), (20_000.0, 0)] {
            assert_eq!(decimals_of(difference), decimals, "{difference}");
        }
    }
}
