//! The headline of a transfer to the real robot, in sentences.

use robogate_analysis::Finding;
use robogate_analysis::labels::{mode_label, parameter_label, parameter_or_level};
use robogate_analysis::transfer::{NextTrials, Transfer};
use robogate_stats::format::{count, counted, fixed, list, percent, percent_or_dash, percent_range, sentence};
use schemars::JsonSchema;
use serde::Serialize;

/// The headline of a transfer.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct TransferHeadline {
    /// The real success rate in one or two sentences.
    pub answer: String,
    /// What the simulation adds to the trials.
    pub what_the_simulation_adds: Vec<String>,
    /// Significant differences between simulation and reality.
    pub what_differs: Vec<String>,
    /// What the figures assume.
    pub limits: Vec<String>,
}

/// What the trials to run next are expected to give.
pub(crate) fn next_trials(next: &NextTrials) -> String {
    let mut text = format!(
        "They are expected to narrow the interval from ±{} to ±{} points.",
        fixed(100.0 * next.half_width, 1),
        fixed(100.0 * next.expected_half_width, 1)
    );
    // Without a saving, the number would be that of these trials or less.
    if next.without_simulation > next.settings.len() as u64 {
        text += &format!(" Without the simulation this would need {} more trials.", count(next.without_simulation));
    }
    text
}

impl TransferHeadline {
    /// Creates the headline of a transfer.
    pub fn of(transfer: &Transfer) -> Self {
        Self {
            answer: answer(transfer),
            what_the_simulation_adds: adds(transfer),
            what_differs: differs(transfer),
            limits: limits(transfer),
        }
    }
}

fn answer(of: &Transfer) -> String {
    match &of.rate {
        Finding::Estimated(found) => format!(
            "The real robot succeeds in {} of cases (95 % interval {}), from {} and {}.",
            percent(found.rate),
            percent_range(found.interval_95),
            counted(of.real.trials, "real trial"),
            counted(of.simulated.n, "simulated episode"),
        ),
        Finding::CannotBeEstimated { because } => format!(
            "The trials alone: {} of {} succeed ({}, 95 % interval {}). The simulation cannot narrow this because {because}.",
            count(of.alone.successes),
            count(of.alone.n),
            percent_or_dash(of.alone.rate),
            percent_range(of.alone.wilson_95),
        ),
    }
}

fn adds(of: &Transfer) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(found) = of.rate.estimated() {
        let correlation = found.correlation.map_or_else(
            || "Outcomes or predictions do not vary, so their correlation is unknown.".to_owned(),
            |r| {
                format!(
                    "Outcomes of the trials and predictions of the simulation have a correlation of {}.",
                    fixed(r, 2)
                )
            },
        );
        lines.push(correlation);
        let worth = found.worth_trials.round().max(0.0) as u64;
        let saved = worth.saturating_sub(of.real.trials);
        lines.push(if saved > 0 {
            format!(
                "The interval is as narrow as that of {} without the simulation: {} saved.",
                counted(worth, "independent trial"),
                counted(saved, "trial"),
            )
        } else {
            format!("The simulation saves no trial. The trials alone give {}.", percent_range(found.alone_95))
        });
    }
    if let Some(exact) = of.exact.estimated().filter(|exact| exact.strata[0].share > 0.0) {
        lines.push(format!(
            "The exact interval, which holds for any quality of the simulation, is {}. The trials alone give {}.",
            percent_range(exact.interval_95),
            percent_range(of.alone.clopper_pearson_95)
        ));
    }
    lines
}

fn differs(of: &Transfer) -> Vec<String> {
    let mut lines: Vec<String> = of
        .different_endings()
        .map(|ending| {
            format!(
                "{}: {} in reality, {} in simulation.",
                sentence(&mode_label(&ending.ending)),
                percent(ending.real),
                percent(ending.simulated)
            )
        })
        .collect();
    lines.extend(of.different_parameters().map(|parameter| {
        let name = match &parameter.level {
            Some(_) => parameter_or_level(&parameter.parameter, parameter.level.as_deref()),
            None => format!("larger {}", parameter_label(&parameter.parameter)),
        };
        let which = if parameter.effect > 0.0 { "better" } else { "worse" };
        format!("{}: reality is {which} than the simulation predicts.", sentence(&name))
    }));
    if lines.is_empty() {
        let what = match (of.endings.is_empty(), &of.not_compared) {
            (true, _) => "No parameter differs",
            (false, Some(_)) => "Neither the success rate nor a parameter differs",
            (false, None) => "No ending and no parameter differs",
        };
        lines.push(format!("{what} significantly between simulation and reality."));
    }
    lines
}

fn limits(of: &Transfer) -> Vec<String> {
    let mut lines = vec![format!(
        "The real rate applies to {}. The trials must be settings chosen at random from it.",
        of.population
    )];
    let real = &of.real;
    if of.settings.is_empty() {
        lines.push("Too few trials state their settings to check this.".to_owned());
    }
    if !real.outside.is_empty() {
        lines.push(format!(
            "{} outside the simulated space {} left out.",
            counted(real.outside.len() as u64, "trial"),
            if real.outside.len() == 1 { "is" } else { "are" }
        ));
    }
    if !real.missing.is_empty() {
        let names: Vec<String> = real.missing.iter().map(|name| parameter_label(name)).collect();
        lines.push(format!("Predictions are averaged over {}, which the trials do not state.", list(&names)));
    }
    if real.incomplete > 0 {
        lines.push(format!(
            "{} with missing values: predictions are averaged over them. Values must be missing at random.",
            counted(real.incomplete, "trial")
        ));
    }
    for (name, groups) in &real.groupings {
        lines.push(format!(
            "Trials with the same {name} may share effects: the interval counts {} of them.",
            counted(*groups, "group")
        ));
    }
    for (name, entry) in &real.constant {
        let entry = if entry.is_empty() { String::new() } else { format!(", `{entry}`") };
        lines.push(format!("All trials have the same {name}{entry}: the rate may differ for others."));
    }
    lines.extend(of.not_compared.clone());
    if !real.ignored.is_empty() {
        lines.push(format!("Ignored columns: {}.", list(&real.ignored)));
    }
    lines
}
