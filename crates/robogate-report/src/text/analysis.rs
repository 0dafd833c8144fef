//! The headline of an analysis in sentences.

use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::{Advice, Analysis, FailureRegion, ModeShare, Population, unrecorded};
use robogate_stats::format::{count, counted, list, number, percent, percent_or_dash, percent_range, range, sentence};
use schemars::JsonSchema;
use serde::Serialize;

use super::labels;

/// Smallest number of valid episodes for a verbal description of the rate.
const MIN_EPISODES: u64 = 30;

/// The headline of an analysis.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Headline {
    /// The success rate in one sentence.
    pub answer: String,
    /// Where and how it fails.
    pub where_it_fails: Vec<String>,
    /// Recommendations.
    pub what_to_do: Vec<String>,
    /// Intervals and bounds of the rate.
    pub uncertainty: Vec<String>,
}

impl Headline {
    /// Creates the headline of an analysis.
    pub fn of(analysis: &Analysis) -> Self {
        Self {
            answer: answer(analysis),
            where_it_fails: where_it_fails(analysis),
            what_to_do: analysis.claims.advice.iter().map(advise).collect(),
            uncertainty: uncertainty(analysis),
        }
    }
}

fn answer(analysis: &Analysis) -> String {
    let rate = &analysis.success.rate;
    let Some(share) = rate.rate else {
        return "No episode is valid, so there is no evidence about this policy.".to_owned();
    };
    let of = match analysis.population {
        Population::OperatingSpace => "over the operating space",
        Population::AsImported => "over the imported episodes",
        Population::Suite => "over the scenarios of the suite (not the operating space)",
        _ => "in a focused design (not the operating space)",
    };
    let chance = if rate.n < MIN_EPISODES {
        String::new()
    } else if share < 0.005 {
        ": almost never".to_owned()
    } else if share > 0.995 {
        ": almost always".to_owned()
    } else {
        format!(": about {} times in 10", (10.0 * share).round().clamp(0.0, 10.0))
    };
    format!("The policy succeeded in {} of {} {of}{chance}.", count(rate.successes), counted(rate.n, "valid episode"))
}

fn where_it_fails(analysis: &Analysis) -> Vec<String> {
    let mut lines = Vec::new();
    let modes = &analysis.failure_modes;
    if modes.failures > 0 && !modes.not_recorded.is_empty() {
        lines.push(format!("The failure modes are uncertain: {}.", unrecorded(&modes.not_recorded)));
    } else if modes.failures > 0 {
        lines.push(main_modes(&modes.modes));
    } else if analysis.success.rate.n > 0 {
        lines.push("No failure was observed. This bounds the failure rate, but does not make it zero.".to_owned());
    }
    let regions = &analysis.claims.failure_regions;
    lines.extend(regions.iter().map(region));
    if regions.is_empty() && modes.failures > 0 && !analysis.marginal_effects.is_empty() {
        lines.push(
            "No bin or level of a single parameter is significantly below 40 % success and below the overall rate."
                .into(),
        );
    }
    lines
}

fn main_modes(modes: &[ModeShare]) -> String {
    let occurred = modes.iter().filter(|m| m.failures > 0);
    let (unknown, mut by): (Vec<_>, Vec<_>) = occurred.partition(|m| m.is_unknown());
    if by.is_empty() {
        return "No failure mode is recorded.".to_owned();
    }
    by.sort_by_key(|m| std::cmp::Reverse(m.failures));
    let shares: Vec<String> = by
        .iter()
        .take(2)
        .map(|m| format!("{} ({})", mode_label(&m.mode), percent(m.share.unwrap_or_default())))
        .collect();
    let mostly = if by.len() > 2 || !unknown.is_empty() { "mostly by" } else { "by" };
    format!("It fails {mostly} {}.", list(&shares))
}

fn region(region: &FailureRegion) -> String {
    let cells = match (region.range, &region.cells) {
        (Some(both), _) => range(both),
        (None, [first, last]) if first == last => first.clone(),
        (None, [first, last]) => format!("{first} to {last}"),
    };
    format!(
        "{} {}: {} success in {}.",
        sentence(&parameter_label(&region.parameter)),
        value_with_unit(&cells, &region.parameter),
        percent(region.rate),
        counted(region.n, "episode")
    )
}

fn advise(advice: &Advice) -> String {
    match advice {
        Advice::ExplainInvalid => "Find out why every episode is invalid: see the faults under Sampling.".to_owned(),
        Advice::ReduceInvalid { invalid } => format!(
            "First investigate the {}: they are more than 2 % of the episodes.",
            counted(*invalid, "invalid episode")
        ),
        Advice::Keep { parameter, above, threshold } => {
            let (keep, fails) = if *above { ("above", "below") } else { ("below", "above") };
            format!(
                "Keep {} {keep} {}: {fails} it, failure is more likely than success (averaged over the other parameters).",
                parameter_label(parameter),
                value_with_unit(&number(*threshold), parameter)
            )
        }
        Advice::Narrow { parameter, best, worst } => format!(
            "Narrow the range of {}: success is {} at {} and {} at {}.",
            parameter_label(parameter),
            percent(best.rate),
            value_with_unit(&best.cell, parameter),
            percent(worst.rate),
            value_with_unit(&worst.cell, parameter)
        ),
        Advice::Joint { parameters } => format!(
            "The space samples {} jointly. The effect of one of them may be caused by another, so there is no advice on a single \
             one.",
            labels(parameters)
        ),
        Advice::Operate { parameters: [up, across], safe_cells } => {
            let map = format!("{} \u{d7} {} map", parameter_label(up), parameter_label(across));
            match safe_cells {
                0 => format!("Do not rely on any cell of the {map}: none is significantly at or above 70 % success."),
                1 => format!("Operate in the safe cell of the {map}: it is significantly at or above 70 % success."),
                n => format!(
                    "Operate in the {n} safe cells of the {map}: they are significantly at or above 70 % success."
                ),
            }
        }
        Advice::Replay { episode } => {
            format!(
                "Replay the failures that the risk model does not explain, starting with episode {episode} (listed below)."
            )
        }
    }
}

fn uncertainty(analysis: &Analysis) -> Vec<String> {
    let success = &analysis.success;
    let rate = &success.rate;
    if rate.n == 0 {
        return vec!["Without a valid episode the success rate may be anywhere from 0 to 100 %.".to_owned()];
    }
    let mut lines = vec![format!(
        "95 % interval {} (Wilson), {} (exact).",
        percent_range(rate.wilson_95),
        percent_range(rate.clopper_pearson_95)
    )];
    if success.bounds.invalid > 0 {
        lines.push(format!(
            "The rate excludes {}. If all of them had failed or succeeded, it would be {} or {}.",
            counted(success.bounds.invalid, "invalid episode"),
            percent_or_dash(success.bounds.worst_case),
            percent_or_dash(success.bounds.best_case)
        ));
    }
    if let Some(found) = success.reweighted.as_ref().and_then(|r| r.estimated()) {
        lines.push(format!(
            "With the focused rows by their weights: {}, interval {}, effective sample size {} of {} rows.",
            percent(found.estimate.rate),
            percent_range(found.estimate.interval_95),
            count(found.estimate.effective_sample_size.round() as u64),
            count(found.rows)
        ));
    }
    let roc = analysis.risk.estimated().and_then(|r| r.roc.estimated());
    if let Some(auc) = roc.and_then(|roc| roc.auc_cross_validated) {
        lines.push(format!(
            "A risk model of the parameters ranks a failure above a success in {} of all pairs (cross-validated AUC).",
            percent(auc)
        ));
    }
    lines
}
