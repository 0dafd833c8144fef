//! The gate's evaluation and its plan in the terminal.

use robogate_gate::{Evaluation, GatePlan, Metric, Mode, PairPlan, Population, Sampling, Sense, Status, Verdict};
use robogate_report::{RequirementRow, feasible_part, how_judged, new_cases, of_invalid, sign, what_next};
use robogate_stats::format::{counted, number};

use crate::force_limits;
use crate::terminal::{Styled, bold, dim, foreign, grouped, is_verbose, line, longest_line, percent, styled};
use crate::twins;

/// Prints the evaluation.
pub(crate) fn print(evaluation: &Evaluation) {
    line("");
    line(format_args!("  {}  {}", banner(evaluation.verdict), evaluation.because));
    let next = what_next(evaluation);
    let stopped = evaluation.ruled_out.is_some();
    if stopped {
        // It quotes the environment.
        line(bold(format_args!("  {}", foreign(&next))));
    }
    line(dim(format_args!("  {} on {}, {}", evaluation.policy, evaluation.robot, evaluation.population)));
    line("");
    let rows = RequirementRow::all(evaluation);
    let wide = |cell: fn(&RequirementRow) -> &str, head: &str| {
        rows.iter().map(|row| cell(row).chars().count()).max().unwrap_or(0).max(head.chars().count())
    };
    let heads = ["requirement", "observed", "one-sided bounds"];
    let widths = [wide(|r| &r.requirement, heads[0]), wide(|r| &r.observed, heads[1]), wide(|r| &r.interval, heads[2])];
    let point = evaluation.requirements.mode == Mode::Point;
    let [a, b, c] = widths;
    let third = if point { "" } else { heads[2] };
    line(dim(format_args!("     {:<a$}  {:>b$}  {:>c$}", heads[0], heads[1], third)));
    for row in &rows {
        let text = format!("{:<a$}  {:>b$}  {:>c$}", row.requirement, row.observed, row.interval);
        line(format_args!(
            "  {}  {text}  {}",
            colour(row.status, sign(row.status)),
            colour(row.status, row.status.as_str())
        ));
        if !row.note.is_empty() {
            line(dim(format_args!("     {}", row.note)));
        }
    }
    line("");
    counts(evaluation);
    if let Some(outside) = evaluation.outside_range.as_ref().filter(|outside| outside.episodes > 0) {
        line(format_args!("  {outside}"));
    }
    evaluation.remarks().iter().for_each(|text| wrapped(text));
    for text in evaluation.controls.iter().flat_map(robogate_gate::Controls::lines) {
        wrapped(&text);
    }
    // What the verdict is about is a part of it.
    new_cases(evaluation).iter().for_each(|text| wrapped(text));
    if is_verbose() {
        wrapped(&how_judged(evaluation));
        wrapped(&evaluation.estimand);
        feasible_part(evaluation).iter().for_each(|text| wrapped(text));
        if let Population::Suite { fresh: false, .. } = evaluation.population {
            wrapped(
                "The rate of `robogate run` differs: it is that over a whole parameter space, not over these chosen scenarios.",
            );
        }
    }
    force_limits::print(&evaluation.force_limits);
    groups(evaluation);
    evaluation.twins.iter().for_each(twins::print);
    production(evaluation);
    score(evaluation);
    if !next.is_empty() && !stopped {
        line("");
        line(bold(format_args!("  {next}")));
    }
}

fn counts(evaluation: &Evaluation) {
    let counts = evaluation.counts;
    let rounds = match counts.rounds {
        Some(1) => " in one round".to_owned(),
        Some(rounds) => format!(" in {} rounds", grouped(rounds)),
        None => String::new(),
    };
    let invalid = match counts.invalid {
        0 => "0 invalid".to_owned(),
        n => format!("{} invalid: {}", grouped(n), of_invalid(evaluation.verdict)),
    };
    let distinct = evaluation.distinct_trajectories.map_or_else(String::new, |n| match n {
        1 => ", 1 distinct trajectory".to_owned(),
        n => format!(", {} distinct trajectories", grouped(n)),
    });
    line(format_args!("  {}{rounds}{distinct}, {invalid}", counted(counts.episodes, "episode")));
    if counts.focused > 0 {
        line(format_args!(
            "  {} episodes of a focused design are excluded: they do not estimate the rate of the operating space",
            grouped(counts.focused)
        ));
    }
}

/// Prints the figures of production.
fn production(evaluation: &Evaluation) {
    let Some(figures) = evaluation.production.as_ref().filter(|_| is_verbose()) else { return };
    line("");
    line(bold("  Production (95 % intervals for independent episodes)"));
    let or = |x: Option<f64>, none: &str| x.map_or_else(|| none.to_owned(), number);
    for (name, unit, figure) in figures.rows() {
        let ends = format!("{} to {}", or(figure.low, "0"), or(figure.high, "no limit"));
        line(format_args!("     {name:<29} {:>9} {unit:<8} ({ends})", or(figure.at, "-")));
    }
    if let Some([low, high]) = figures.tolerance_cycle_time_s {
        let (low, high) = (number(low), number(high));
        line(format_args!("     90 % of successful cycles take {low} to {high} s (95 % confidence)"));
    }
}

/// Groups of scenarios that are shown.
const MAX_GROUPS: usize = 5;

/// Prints the scenario groups that contain failures or invalid episodes.
fn groups(evaluation: &Evaluation) {
    let mut troubled: Vec<_> = evaluation.groups.iter().filter(|g| !g.endings.is_empty()).collect();
    if evaluation.groups.is_empty() {
        return;
    }
    line("");
    if troubled.is_empty() {
        let groups = counted(evaluation.groups.len() as u64, "scenario group");
        line(format_args!("  All episodes of {groups} succeeded."));
        return;
    }
    let all = troubled.len();
    if !is_verbose() {
        // The worst first.
        troubled.sort_by_key(|group| std::cmp::Reverse((group.valid - group.successes, group.endings.len())));
        troubled.truncate(MAX_GROUPS);
    }
    let which = if troubled.len() < all { format!(", the first {MAX_GROUPS} of {all}") } else { String::new() };
    line(bold(format_args!("  Scenario groups with failures or invalid episodes{which}")));
    let wide = troubled.iter().map(|g| g.category.len() + g.group.len() + 1).max().unwrap_or(0);
    for group in &troubled {
        let name = format!("{}/{}", group.category, group.group);
        let endings: Vec<String> =
            group.endings.iter().map(|e| format!("{} {}", e.ending.replace('_', " "), e.episodes)).collect();
        line(format_args!("     {name:<wide$}  {:>4} of {:<4}  {}", group.successes, group.valid, endings.join(", ")));
    }
}

fn score(evaluation: &Evaluation) {
    let Some(score) = &evaluation.score else { return };
    line("");
    let Some(points) = score.points else {
        let missing: Vec<&str> =
            score.terms.iter().filter(|t| t.points.is_none()).map(|t| t.term.name.as_str()).collect();
        line(format_args!("  No confidence score: no value for {}", missing.join(", ")));
        return;
    };
    let [least, most] = score.bounds;
    let bounds = if most - least > 0.05 {
        format!(", {least:.1} to {most:.1} depending on the missing values")
    } else {
        String::new()
    };
    line(bold(format_args!("  Confidence score {points:.1} of 100{bounds}")));
    if !is_verbose() {
        return;
    }
    for term in &score.terms {
        let figure = term.value.map_or_else(String::new, |x| value(term.term.metric, x));
        let against = term.baseline.map_or_else(String::new, |x| format!("baseline {}", value(term.term.metric, x)));
        line(format_args!(
            "     {:<16} {figure:>9}  {against:<18} {:>5.1} of {:.0}",
            term.term.name,
            term.points.unwrap_or(0.0),
            100.0 * term.term.weight
        ));
    }
}

/// Prints the joint operating characteristic of all requirements.
fn print_joint(plan: &GatePlan) {
    if plan.joint.is_empty() {
        return;
    }
    line("");
    line(bold("All requirements together"));
    let without = match plan.joint_without.as_slice() {
        [] => String::new(),
        some => format!(" Not simulated: {}.", some.join(", ")),
    };
    line(dim(format_args!(
        "1,000 simulated gates per row, failures spread over the limited modes in proportion to their limits.{without}"
    )));
    line(dim(format_args!(
        "     {:>12}  {:>8}  {:>8}  {:>12}  {:>13}",
        "true success", "pass", "fail", "inconclusive", "mean episodes"
    )));
    for row in &plan.joint {
        line(format_args!(
            "     {:>12}  {:>8}  {:>8}  {:>12}  {:>13}",
            percent(row.success),
            percent(row.pass),
            percent(row.fail),
            percent(row.open),
            grouped(row.episodes.round() as u64)
        ));
    }
}

/// Prints the plan of the comparison with another policy.
pub(crate) fn print_pair_plan(plan: &PairPlan) {
    line("");
    line(bold(format_args!(
        "Not worse than the other policy by {:.1} points, up to {} of {}",
        100.0 * plan.margin,
        counted(plan.rounds, "round"),
        counted(plan.per_round, "pair")
    )));
    line(dim(format_args!(
        "{} simulated gates per row. Each wrong conclusion has a probability of at most {}.",
        grouped(plan.runs),
        percent(plan.alpha)
    )));
    line(dim(format_args!(
        "     {:>14}  {:>12}  {:>9}  {:>9}  {:>9}  {:>11}",
        "true difference", "disagreement", "not worse", "worse", "undecided", "mean pairs"
    )));
    for row in &plan.at {
        line(format_args!(
            "     {:>10.1} points  {:>12}  {:>9}  {:>9}  {:>9}  {:>11}",
            100.0 * row.difference,
            percent(row.disagreement),
            percent(row.met),
            percent(row.violated),
            percent(row.open),
            grouped(row.pairs.round() as u64)
        ));
    }
}

/// Prints the plan of the gate.
pub(crate) fn print_plan(plan: &GatePlan) {
    let (rounds, each) = (counted(plan.rounds, "round"), counted(plan.per_round, "episode"));
    let how = match plan.sampling {
        Sampling::Fixed => format!("{rounds} of {each}, judged once"),
        Sampling::Sequential => format!("up to {rounds} of {each}, stopped as soon as the verdict is certain"),
    };
    line(bold(format_args!("Gate `{}`: {how}", plan.requirements.name)));
    if plan.requirements.mode == Mode::Confidence {
        line(dim(format_args!(
            "Each requirement alone, at {} confidence, with equal success rates in all scenarios. The gate passes at most as often as its least likely requirement.",
            percent(plan.requirements.confidence)
        )));
    } else {
        line(dim("Point comparisons, each requirement alone, with equal success rates in all scenarios."));
    }
    for planned in &plan.demands {
        let limit = value(planned.requirement.metric, planned.bound.limit);
        line("");
        let scope = planned.id.find('[').map_or("", |at| &planned.id[at..]);
        line(bold(format_args!("{}{scope} {} {limit}", planned.requirement.metric.title(), planned.bound.sense)));
        if let Some(fewest) = planned.fewest_rounds {
            let without = if matches!(planned.requirement.metric, Metric::CycleTime(_) | Metric::Measure(..)) {
                "if every episode equals the baseline's mean"
            } else {
                "if no episode fails"
            };
            line(format_args!(
                "  met at the earliest after {} ({}), {without}",
                counted(fewest, "round"),
                counted(fewest * plan.per_round, "episode")
            ));
        }
        if planned.at.is_empty() {
            line(dim("  no table: the test makes no assumption about the distribution of the values"));
            continue;
        }
        line(dim("    true rate     pass     fail     open   episodes"));
        for at in &planned.at {
            let better = match planned.bound.sense {
                Sense::AtLeast => at.rate > planned.bound.limit,
                Sense::AtMost => at.rate < planned.bound.limit,
            };
            let mark = if (at.rate - planned.bound.limit).abs() < 1e-12 {
                "limit"
            } else if better {
                ""
            } else {
                "worse"
            };
            line(format_args!(
                "    {:>9} {:>8} {:>8} {:>8} {:>10}  {}",
                value(Metric::Success, at.rate),
                percent(at.met),
                percent(at.violated),
                percent(at.open),
                grouped(at.episodes.round() as u64),
                dim(mark)
            ));
        }
    }
    print_joint(plan);
}

/// A figure of a metric with its unit.
pub(crate) fn value(metric: Metric, x: f64) -> String {
    match metric {
        Metric::CycleTime(_) | Metric::TimeToSuccess(_) => format!("{x:.2} s"),
        Metric::Measure(..) | Metric::Production(_) => number(x),
        Metric::FailureCount(_) => format!("{x:.0}"),
        _ => format!("{:.2} %", 100.0 * x),
    }
}

fn banner(verdict: Verdict) -> Styled<String> {
    let style = match verdict {
        Verdict::Pass => "1;97;42",
        Verdict::Fail => "1;97;41",
        Verdict::Inconclusive => "1;30;43",
        Verdict::Invalid => "1;97;45",
    };
    styled(style, format!(" {} ", verdict.as_str().to_uppercase()))
}

fn colour(status: Status, text: &str) -> Styled<&str> {
    let style = match status {
        Status::Met => "32",
        Status::Violated => "31",
        Status::Undecided => "33",
        Status::NoEvidence => "35",
    };
    styled(style, text)
}

/// Prints a sentence in dimmed lines of at most 100 columns.
fn wrapped(text: &str) {
    let longest = longest_line() - 4;
    let mut row = String::new();
    for word in text.split(' ') {
        if !row.is_empty() && row.chars().count() + word.chars().count() > longest {
            line(dim(format_args!("  {row}")));
            row.clear();
        }
        if !row.is_empty() {
            row.push(' ');
        }
        row.push_str(word);
    }
    line(dim(format_args!("  {row}")));
}
