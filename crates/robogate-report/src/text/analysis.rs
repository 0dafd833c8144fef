//! The headline of an analysis in sentences.

use robogate_analysis::labels::{mode_label, parameter_label, value_with_unit};
use robogate_analysis::{Advice, Analysis, FailureRegion, Population, unrecorded};
use robogate_stats::format::{count, counted, list, number, percent, percent_range, range, sentence};
use schemars::JsonSchema;
use serde::Serialize;

/// The answer in plain words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
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

impl Headline {
    /// The headline of an analysis.
    pub fn of(analysis: &Analysis) -> Self {
        Self {
            answer: answer(analysis),
            where_it_fails: where_it_fails(analysis),
            what_to_do: analysis.claims.advice.iter().map(advise).collect(),
            how_sure: how_sure(analysis),
        }
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
            .map(|m| format!("{} ({})", mode_label(&m.mode), percent(m.share.unwrap_or_default())))
            .collect();
        let others = if by.len() > 2 { "mostly by" } else { "by" };
        lines.push(format!("It fails {others} {}.", list(&told)));
    } else if analysis.success.rate.n > 0 {
        lines.push("No failure was seen; that bounds the failure rate, it does not make it zero.".to_owned());
    }
    let regions = &analysis.claims.failure_regions;
    lines.extend(regions.iter().map(region));
    if regions.is_empty() && modes.failures > 0 && !analysis.along.is_empty() {
        lines.push(
            "No bin or level of any one parameter is surely below 40 % success and below the overall rate.".into(),
        );
    }
    lines
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
        Advice::ExplainInvalid => {
            "Find out why no episode is valid; the faults are counted under how the points were drawn.".to_owned()
        }
        Advice::ReduceInvalid { invalid } => format!(
            "Look into the {} first: they are more than 2 % of the evidence.",
            counted(*invalid, "invalid episode")
        ),
        Advice::Keep { parameter, above, threshold } => {
            let (keep, fails) = if *above { ("above", "below") } else { ("below", "above") };
            format!(
                "Keep {} {keep} {}: {fails} it, failure is likelier than success (averaged over the other parameters).",
                parameter_label(parameter),
                value_with_unit(&number(*threshold), parameter)
            )
        }
        Advice::Narrow { parameter, best, worst } => format!(
            "Narrow {}: success is {} at {} and {} at {}.",
            parameter_label(parameter),
            percent(best.rate),
            value_with_unit(&best.cell, parameter),
            percent(worst.rate),
            value_with_unit(&worst.cell, parameter)
        ),
        Advice::Joint { parameters } => format!(
            "The space draws {} together: success along one of them may be the doing of another, so none is advised on alone.",
            labels(parameters)
        ),
        Advice::Operate { parameters: [up, across], safe_cells } => {
            let map = format!("{} \u{d7} {} map", parameter_label(up), parameter_label(across));
            match safe_cells {
                0 => format!("No cell of the {map} is surely at 70 % success: do not rely on one yet."),
                1 => format!("One cell of the {map} is surely at 70 % success or more: operate there."),
                n => format!("{n} cells of the {map} are surely at 70 % success or more: operate there."),
            }
        }
        Advice::Watch { episode } => format!(
            "Watch the failures that nothing explains, beginning with episode {episode}; they are listed below."
        ),
    }
}

/// The labels of parameters as a list.
pub(crate) fn labels(parameters: &[String]) -> String {
    let labels: Vec<String> = parameters.iter().map(|parameter| parameter_label(parameter)).collect();
    list(&labels)
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
        percent_range(rate.wilson_95),
        percent_range(rate.clopper_pearson_95)
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
            percent_range(found.estimate.interval_95),
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
