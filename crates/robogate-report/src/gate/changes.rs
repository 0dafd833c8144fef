//! What to change after a gate that did not pass: statements that tests support, the most useful first, each with a command.

use robogate_analysis::labels::mode_label;
use robogate_analysis::{Advice, Analysis, FailureCondition, HERE, same_subject};
use robogate_gate::{Evaluation, Metric, Population, Sense, Status, Verdict};
use robogate_stats::format::{count, counted, percent, percent_or_dash, percent_range, sentence};

use crate::text::{advise, condition, main_modes, rounded_up};
use crate::watch::Watch;

/// Most statements.
const MOST: usize = 5;
/// Episodes that are named to be watched.
const WATCHED: usize = 2;

/// One statement, and the command that follows from it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// The statement.
    pub text: String,
    /// The command. Empty if there is none.
    pub command: String,
}

/// The options with which the judged subject runs again, each with a space before it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Again {
    /// Those of another gate on the same scenarios.
    pub gate: String,
    /// Those of another gate on other scenarios.
    pub gate_elsewhere: String,
    /// Those of a run.
    pub run: String,
    /// Whether a Python program called this command and has the environment: no command line reaches it.
    pub from_python: bool,
}

impl Again {
    /// What the provenance of a run names. It does not name files of requirements, scenarios or profiles.
    pub fn of(analysis: &Analysis) -> Self {
        let same = same_subject(&analysis.provenance);
        Self { gate: same.clone(), gate_elsewhere: same.clone(), run: same, from_python: false }
    }
}

/// A command with the options of the subject and these ones.
fn command(again: &Again, verb: &str, given: &str, options: &[(&str, &str)]) -> String {
    if again.from_python {
        let plain = |text: &str| text.parse::<f64>().is_ok();
        let option = |(name, value): &(&str, &str)| {
            let name = if *name == "n" { "episodes" } else { name };
            if plain(value) { format!(", {name}={value}") } else { format!(", {name}={value:?}") }
        };
        return format!("robogate_eval.{verb}(env, policy{})", options.iter().map(option).collect::<String>());
    }
    let option = |(name, value): &(&str, &str)| format!(" {}{name} {value}", if name.len() == 1 { "-" } else { "--" });
    format!("robogate {verb}{given}{}", options.iter().map(option).collect::<String>())
}

/// The success rate that the gate requires of all scenarios: the target of the advice.
pub fn required_success(evaluation: &Evaluation) -> Option<f64> {
    let of_all = |result: &&robogate_gate::RequirementResult| {
        let requirement = &result.requirement;
        requirement.metric == Metric::Success
            && result.bound.sense == Sense::AtLeast
            && (&requirement.category, &requirement.group, &requirement.each) == (&None, &None, &None)
    };
    evaluation.results.iter().find(of_all).map(|result| result.bound.limit).filter(|limit| (0.0..1.0).contains(limit))
}

/// What to change. `analysis` has the rows of the evaluation, with [`required_success`] as its target. `phases` are the phases in
/// which its most frequent failure mode ended episodes, with their counts. `run` is the run as a word of a shell command, and `again`
/// has the options of a new one. Empty for a gate that passed.
pub fn what_to_change(
    evaluation: &Evaluation,
    analysis: &Analysis,
    phases: &[(String, u64)],
    watch: Option<&Watch>,
    run: &str,
    again: &Again,
) -> Vec<Change> {
    if matches!(evaluation.verdict, Verdict::Pass | Verdict::Invalid) || evaluation.ruled_out.is_some() {
        return Vec::new();
    }
    let mut changes = Vec::new();
    // A policy that was changed must be judged on new scenarios.
    let seed = analysis.provenance.seed.wrapping_add(1);
    let add = |changes: &mut Vec<Change>, text: String, command: String| changes.push(Change { text, command });
    // A requirement other than success says nothing about limits that raise success.
    let unmet = |metric: Metric| {
        evaluation.results.iter().any(|one| one.requirement.metric == metric && one.status != Status::Met)
    };
    let limits = analysis
        .claims
        .advice
        .iter()
        .find(|advice| matches!(advice, Advice::Operate { .. } | Advice::RunMore { .. } | Advice::NoBox { .. }));
    if let Some(advice) = limits.filter(|_| unmet(Metric::Success)) {
        let command = match advice {
            _ if !analysis.subject.replayable => String::new(),
            Advice::Operate { .. } => {
                command(again, "gate", &again.gate_elsewhere, &[("space", "LIMITED.toml"), ("seed", &seed.to_string())])
            }
            Advice::RunMore { episodes, .. } => {
                let episodes = rounded_up(*episodes).to_string();
                command(again, "run", &again.run, &[("n", &episodes), ("seed", &seed.to_string())])
            }
            _ => String::new(),
        };
        add(&mut changes, advise(analysis, advice), command);
    }
    if analysis.failure_modes.failures > 0 {
        add(&mut changes, costliest(analysis, phases), String::new());
    }
    match analysis.conditions.failing.first() {
        Some(worst) => add(&mut changes, separating(worst), format!("robogate analyze {run}")),
        None => {
            if let Some(power) = analysis.conditions.power.filter(|_| analysis.failure_modes.failures > 0) {
                let episodes = rounded_up(power.episodes_for_10_points);
                let text = format!(
                    "No parameter separates failures from successes in these episodes. A difference of 10 points needs about {}.",
                    counted(episodes, "episode")
                );
                let options = [("n", &*episodes.to_string()), ("seed", &seed.to_string())];
                let command = command(again, "run", &again.run, &options);
                add(&mut changes, text, if analysis.subject.replayable { command } else { String::new() });
            }
        }
    }
    // The commands of the items have the place of the page.
    let failed = watch.into_iter().flat_map(|watch| &watch.items).filter(|item| !item.success);
    for item in failed.take(WATCHED) {
        add(
            &mut changes,
            format!("Watch: {}.", item.title),
            item.command.replacen(&format!(" {HERE} "), &format!(" {run} "), 1),
        );
    }
    if watch.is_none() && analysis.subject.replayable && analysis.failure_modes.failures > 0 {
        add(
            &mut changes,
            "Watch the failed episodes beside the nearest successful ones.".to_owned(),
            format!("robogate view {run}"),
        );
    }
    changes.truncate(MOST);
    let undecided = evaluation.results.iter().find_map(|result| Some((result, result.next?)));
    if let Some((result, next)) = undecided.filter(|_| evaluation.verdict == Verdict::Inconclusive) {
        let imported = matches!(evaluation.population, Population::Imported { .. });
        let text = format!(
            "`{}` is undecided. Another gate of {} decides it with a probability of {} if the observed rate is the true one. {}",
            result.id,
            counted(next.episodes, "episode"),
            percent(next.at_observed),
            if imported {
                "Record more episodes, and import them alone."
            } else {
                "A larger one, with the same options:"
            }
        );
        let rounds = 2 * evaluation.planned_rounds.unwrap_or_else(|| evaluation.requirements.budget.rounds.into());
        let options = [("rounds", &*rounds.to_string()), ("seed", &seed.to_string())];
        let command = command(again, "gate", &again.gate, &options);
        add(&mut changes, text, if imported { String::new() } else { command });
    }
    changes
}

/// The failure mode that costs most, and where in the cycle it occurs.
fn costliest(analysis: &Analysis, phases: &[(String, u64)]) -> String {
    let modes = &analysis.failure_modes;
    let dominant = modes.dominant.estimated().and_then(|name| modes.modes.iter().find(|mode| mode.mode == *name));
    let Some(of) = dominant else { return main_modes(modes) };
    let share = match of.share {
        Some(share) => format!(" ({}, 95 % interval {})", percent(share), percent_range(of.interval_95)),
        None => String::new(),
    };
    let phase =
        phases.iter().max_by_key(|(_, n)| *n).filter(|_| phases.len() > 1).map_or_else(String::new, |(phase, n)| {
            format!(", {} of them in the phase {}", count(*n), phase.replace('_', " "))
        });
    format!(
        "Costs most: {}, {} of {}{share}{phase}.",
        mode_label(&of.mode),
        count(of.failures),
        counted(modes.failures, "failure")
    )
}

/// The condition that separates failures from successes best.
fn separating(worst: &FailureCondition) -> String {
    format!(
        "{}: success {} in {}, and {} elsewhere (significant after correction for all parameters).",
        sentence(&condition(worst)),
        percent_or_dash(worst.inside.rate),
        counted(worst.inside.n, "episode"),
        percent_or_dash(worst.outside.rate)
    )
}
