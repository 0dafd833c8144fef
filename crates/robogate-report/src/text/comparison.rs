//! The headline of a comparison in sentences.

use robogate_analysis::labels::{mode_label, parameter_label};
use robogate_analysis::{Comparison, PairedComparison, RateDifference};
use robogate_stats::format::{
    count, counted, list, percent, percent_or_dash, percent_range, points, points_range, sentence,
};
use schemars::JsonSchema;
use serde::Serialize;

use super::labels;

/// Maximum number of differences in the headline.
const MAX_DIFFERENCES: usize = 6;
/// Maximum number of paired comparisons in the headline.
const MAX_PAIRED: usize = 4;

/// The headline of a comparison.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ComparisonHeadline {
    /// The result in one or two sentences.
    pub answer: String,
    /// The differences.
    pub what_differs: Vec<String>,
    /// Properties that the datasets share.
    pub what_they_share: Vec<String>,
    /// The rates with their intervals and bounds.
    pub uncertainty: Vec<String>,
}

impl ComparisonHeadline {
    /// Creates the headline of a comparison.
    pub fn of(comparison: &Comparison) -> Self {
        Self {
            answer: answer(comparison),
            what_differs: what_differs(comparison),
            what_they_share: what_they_share(comparison),
            uncertainty: uncertainty(comparison),
        }
    }
}

/// The parameters in which the operating spaces differ.
pub(super) fn different_parameters(of: &Comparison) -> Vec<String> {
    let partly = of.marginal_effects.iter().filter(|curve| curve.remark.is_some()).map(|curve| &curve.parameter);
    partly.chain(of.parameters.not_shared.iter().map(|of| &of.parameter)).cloned().collect()
}

fn answer(of: &Comparison) -> String {
    if !of.has_evidence() {
        return "No comparison is possible: fewer than two of the datasets have rates that can be compared.".to_owned();
    }
    match largest(&of.paired) {
        Some(pair) => paired_answer(pair),
        None => independent_answer(of),
    }
}

fn paired_answer(pair: &PairedComparison) -> String {
    let Some(difference) = pair.difference else { return "No scenario is valid in both datasets.".to_owned() };
    let verdict = if pair.is_significant() {
        "The difference is significant"
    } else if pair.is_tie() {
        "It is a tie"
    } else {
        "The difference is not significant"
    };
    let scope = match pair.clusters {
        Some(n) if n < 8 => format!(
            " The pairs come from {} of dependent episodes, too few for a claim about new ones: at least 8 are needed.",
            counted(n, "group")
        ),
        Some(n) => format!(
            " Test and difference count {} of dependent episodes once each, so the difference need not be that of the rates, and \
             apply to new groups of the same kind.",
            counted(n, "group")
        ),
        None => " It applies to these scenarios.".to_owned(),
    };
    format!(
        "On the same {}, {} succeeds in {} and {} in {}. {verdict} ({} points, {}).{scope} {} differ in their outcome.",
        counted(pair.valid_pairs, if pair.clusters.is_some() { "episode" } else { "scenario" }),
        pair.first,
        percent_or_dash(pair.first_rate.rate),
        pair.second,
        percent_or_dash(pair.second_rate.rate),
        points(difference),
        points_range(pair.difference_95),
        counted(pair.first_only + pair.second_only, if pair.clusters.is_some() { "episode" } else { "scenario" })
    )
}

fn independent_answer(of: &Comparison) -> String {
    let mut ranked: Vec<(f64, &str)> = of
        .datasets
        .iter()
        .filter(|dataset| dataset.excluded_because.is_none())
        .filter_map(|dataset| Some((dataset.success.rate.rate?, dataset.name.as_str())))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let order: Vec<String> = ranked.iter().map(|(rate, name)| format!("{name} {}", percent(*rate))).collect();
    let significant = of.differences.iter().filter(|difference| difference.is_significant()).count();
    let tie = of.differences.first().is_some_and(RateDifference::is_tie);
    let verdict = match (significant, of.differences.len()) {
        (0, 1) if tie => "It is a tie".to_owned(),
        (0, 1) => "The difference is not significant".to_owned(),
        (1, 1) => "The difference is significant".to_owned(),
        (0, _) => "No difference is significant".to_owned(),
        (some, all) if some == all => "All differences are significant".to_owned(),
        (some, all) => format!("{some} of {all} differences are significant"),
    };
    let groups = match of.differences.first().and_then(|difference| difference.clusters) {
        Some(_) => " Differences count each group of dependent episodes once, so they need not be those of the rates.",
        None => "",
    };
    let parameters = different_parameters(of);
    let spaces = if parameters.is_empty() {
        String::new()
    } else {
        format!(" The operating spaces differ in {}, so the rates apply to different populations.", labels(&parameters))
    };
    format!("Success: {}. {verdict}.{groups}{spaces}", order.join(", "))
}

/// The paired comparison with the largest difference. Among equal ones the first.
fn largest(paired: &[PairedComparison]) -> Option<&PairedComparison> {
    paired.iter().max_by(|a, b| {
        let size = |of: &PairedComparison| of.difference.map_or(-1.0, f64::abs);
        size(a).total_cmp(&size(b)).then(std::cmp::Ordering::Greater)
    })
}

fn what_differs(of: &Comparison) -> Vec<String> {
    let mut lines: Vec<String> = of
        .differences
        .iter()
        .take(MAX_DIFFERENCES)
        .map(|d| {
            let verdict = if d.is_significant() {
                ""
            } else if d.is_tie() {
                ", a tie"
            } else {
                ", not significant"
            };
            let paired = match (d.clusters, d.valid_pairs) {
                (Some(n), _) => format!(" over {} of dependent episodes, each counted once", counted(n, "group")),
                (None, Some(n)) => format!(" on the same {}", counted(n, "scenario")),
                (None, None) => String::new(),
            };
            format!(
                "{} compared with {}{paired}: {} points ({}){verdict}.",
                d.first,
                d.second,
                points(d.difference),
                points_range(d.interval_95)
            )
        })
        .collect();
    for pair in of.paired.iter().take(MAX_PAIRED) {
        lines.push(format!(
            "Only {} solves {}, and only {} solves {}.",
            pair.first,
            counted(pair.first_only, "scenario"),
            pair.second,
            count(pair.second_only)
        ));
    }
    let modes: Vec<String> = of
        .datasets
        .iter()
        .filter_map(|d| Some(format!("{} ({})", mode_label(d.failure_modes.dominant.estimated()?), d.name)))
        .collect();
    if !modes.is_empty() {
        lines.push(format!("Dominant failure modes: {}.", list(&modes)));
    }
    lines.extend(lowers_success(of).into_iter().filter(|(all, _)| !all).map(|(_, line)| line));
    lines
}

fn what_they_share(of: &Comparison) -> Vec<String> {
    if of.compared.len() < 2 {
        return vec!["Fewer than two datasets can be compared.".to_owned()];
    }
    let mut lines = vec![universal_zones(of)];
    lines.extend(lowers_success(of).into_iter().filter(|(all, _)| *all).map(|(_, line)| line));
    let shared = of.parameters.shared.as_slice();
    lines.push(match shared {
        [] => "They share no parameter, so only rates and failure modes can be compared.".to_owned(),
        _ => format!("{} shared: {}.", counted(shared.len() as u64, "parameter"), labels(shared)),
    });
    lines
}

fn universal_zones(of: &Comparison) -> String {
    let zones = &of.universal_zones;
    let significant: Vec<_> = zones.zones.iter().filter(|zone| zone.significant).collect();
    let limit = format!("{:.0} %", 100.0 * zones.limit);
    match significant.as_slice() {
        [] if zones.tested == 0 => {
            "No cell has enough episodes of every dataset to find where all of them fail.".to_owned()
        }
        [] => format!(
            "In none of {} is the success of all of them significantly below {limit}.",
            counted(zones.tested, "cell")
        ),
        [first, ..] => format!(
            "In {} of {} tested, the success of all of them is significantly below {limit}, most clearly at {}.",
            counted(significant.len() as u64, "cell"),
            count(zones.tested),
            first.describe()
        ),
    }
}

/// The datasets whose success rate decreases with larger values of the task's parameter, and whether these are all.
fn lowers_success(of: &Comparison) -> Option<(bool, String)> {
    let sensitivity = of.sensitivity.estimated()?;
    let parameter = parameter_label(&sensitivity.parameter);
    match sensitivity.lowers_success_of.as_slice() {
        [] => None,
        all if all.len() == sensitivity.effects.len() => {
            Some((true, format!("{} significantly lowers the success of all of them.", sentence(&parameter))))
        }
        some => Some((
            false,
            format!(
                "{} significantly lowers the success of {}, but not of the {}.",
                sentence(&parameter),
                list(some),
                if sensitivity.effects.len() - some.len() == 1 { "other" } else { "others" }
            ),
        )),
    }
}

fn uncertainty(of: &Comparison) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for dataset in &of.datasets {
        let rate = &dataset.success.rate;
        match &dataset.excluded_because {
            Some(because) => lines.push(format!("{} is not compared: {because}.", dataset.name)),
            None => lines.push(format!(
                "{}: {} ({}) in {}.",
                dataset.name,
                percent_or_dash(rate.rate),
                percent_range(rate.wilson_95),
                counted(rate.n, "valid episode")
            )),
        }
    }
    for pair in &of.paired {
        if let Some(bounds) = pair.invalid.difference_bounds {
            lines.push(format!(
                "{} not valid in both could put the difference of {} and {} anywhere within {} points.",
                counted(pair.invalid.either, "scenario"),
                pair.first,
                pair.second,
                points_range(bounds)
            ));
        }
    }
    lines
}
