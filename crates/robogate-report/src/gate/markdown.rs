//! Gate evaluations as Markdown, for a pull request or a job summary.

use std::fmt::Write;

use robogate_gate::{ConfidenceScore, Controls, Evaluation, Mode, Twins, Verdict};

use super::{RequirementRow, TwinRow, feasible_part, how_judged, new_cases, sign, value, what_next};
use crate::markdown::{escape_markdown, watch_item};
use crate::watch::Watch;
use robogate_stats::format::{count, counted, fixed, percent, percent_range, sentence};

/// Maximum number of episodes in the summary of a pull request.
const MAX_EPISODES: usize = 6;

/// The evaluation as Markdown.
pub fn evaluation_markdown(evaluation: &Evaluation) -> String {
    evaluation_markdown_with(evaluation, None)
}

/// The evaluation as Markdown, with the episodes that are worth watching.
pub fn evaluation_markdown_with(evaluation: &Evaluation, watch: Option<&Watch>) -> String {
    let mut out = String::new();
    let mark = match evaluation.verdict {
        Verdict::Pass => "\u{2705}",
        Verdict::Fail => "\u{274c}",
        Verdict::Inconclusive => "\u{2754}",
        Verdict::Invalid => "\u{26a0}\u{fe0f}",
    };
    let verdict = evaluation.verdict.as_str().to_uppercase();
    // Writing to a string cannot fail, here and below.
    let _ = writeln!(
        out,
        "## {mark} RoboGate: {verdict}\n\n**{}** on {}, {}: {}.\n",
        escape_markdown(&evaluation.policy),
        escape_markdown(&evaluation.robot),
        escape_markdown(&evaluation.population.to_string()),
        escape_markdown(&evaluation.because)
    );
    if evaluation.requirements.mode == Mode::Confidence {
        out.push_str("| | requirement | observed | one-sided bounds | |\n|---|---|---:|---:|---|\n");
    } else {
        out.push_str("| | requirement | observed | |\n|---|---|---:|---|\n");
    }
    for row in RequirementRow::all(evaluation) {
        let _ = write!(
            out,
            "| {} | {} | {} |",
            sign(row.status),
            escape_markdown(&row.requirement),
            escape_markdown(&row.observed)
        );
        if evaluation.requirements.mode == Mode::Confidence {
            let _ = write!(out, " {} |", escape_markdown(&row.interval));
        }
        let _ = writeln!(out, " {} |", escape_markdown(&row.note));
    }
    let next = what_next(evaluation);
    if !next.is_empty() {
        let _ = writeln!(out, "\n{}", escape_markdown(&next));
    }
    let counts = evaluation.counts;
    let rounds = counts.rounds.map_or_else(String::new, |rounds| format!(" in {}", counted(rounds, "round")));
    let _ = writeln!(
        out,
        "\n{} episodes{rounds}, {} of them invalid. {} {}",
        count(counts.episodes),
        count(counts.invalid),
        how_judged(evaluation),
        escape_markdown(&evaluation.estimand)
    );
    let controls = evaluation.controls.iter().flat_map(Controls::lines);
    let controls = evaluation.remarks().into_iter().chain(controls);
    let lines: Vec<String> = controls.chain(evaluation.outside_range.as_ref().map(ToString::to_string)).collect();
    if !lines.is_empty() {
        out.push('\n');
        lines.iter().for_each(|line| {
            let _ = writeln!(out, "- {}", escape_markdown(line));
        });
    }
    for result in &evaluation.force_limits {
        result.lines(MAX_EPISODES).iter().for_each(|text| {
            let _ = writeln!(out, "- {}", escape_markdown(text));
        });
    }
    for text in new_cases(evaluation).into_iter().chain(feasible_part(evaluation)) {
        let _ = writeln!(out, "\n{text}");
    }
    if let Some(twins) = &evaluation.twins {
        self::twins(&mut out, twins);
    }
    if let Some(watch) = watch.filter(|watch| !watch.items.is_empty()) {
        out.push_str("\n### Episodes worth watching\n\n");
        watch.items.iter().take(MAX_EPISODES).for_each(|item| watch_item(&mut out, item));
    }
    if let Some(score) = &evaluation.score {
        self::score(&mut out, score);
    }
    if !evaluation.groups.is_empty() {
        out.push_str("\n<details><summary>Success by scenario group</summary>\n\n");
        out.push_str(
            "| category | group | success | rate | 95 % interval | failures |\n|---|---|---:|---:|---:|---|\n",
        );
        for group in &evaluation.groups {
            let rate =
                if group.valid > 0 { percent(group.successes as f64 / group.valid as f64) } else { "-".to_owned() };
            let endings: Vec<String> = group.endings.iter().map(|e| format!("{} {}", e.ending, e.episodes)).collect();
            let _ = writeln!(
                out,
                "| {} | {} | {} of {} | {rate} | {} | {} |",
                escape_markdown(&group.category),
                escape_markdown(&group.group),
                count(group.successes),
                count(group.valid),
                percent_range(group.interval_95),
                escape_markdown(&endings.join(", "))
            );
        }
        out.push_str("\n</details>\n");
    }
    out
}

/// The control arm.
fn twins(out: &mut String, twins: &Twins) {
    out.push_str("\n### Control arm: the same seeds without the perturbations\n\n");
    for line in twins.lines() {
        let _ = writeln!(out, "- {}", escape_markdown(&line));
    }
    let _ = writeln!(out, "\n| {} |\n|---|---|---:|---:|---|", TwinRow::HEADS.join(" | "));
    for family in &twins.families {
        let cells = TwinRow::of(family).cells().map(|cell| escape_markdown(&cell));
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
}

fn score(out: &mut String, score: &ConfidenceScore) {
    let points = score.points.map_or_else(|| "-".to_owned(), |points| fixed(points, 1));
    let _ = writeln!(out, "\n<details><summary>Confidence score {points} of 100</summary>\n");
    out.push_str("| term | figure | baseline | term | weight | points |\n|---|---:|---:|---:|---:|---:|\n");
    let dash = || "-".to_owned();
    for term in &score.terms {
        let metric = term.term.metric;
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} |",
            escape_markdown(&term.term.name),
            term.value.map_or_else(dash, |x| value(metric, "", x)),
            term.baseline.map_or_else(String::new, |x| value(metric, "", x)),
            term.scored.map_or_else(dash, |x| fixed(x, 3)),
            fixed(term.term.weight, 2),
            term.points.map_or_else(dash, |x| fixed(x, 1))
        );
    }
    let [least, most] = score.bounds;
    if score.points.is_none_or(|points| most - least > 1e-9 || (points - least).abs() > 1e-9) {
        let text = format!(
            "with invalid episodes and missing terms at their worst and best: {} to {}.",
            fixed(least, 1),
            fixed(most, 1)
        );
        let _ = writeln!(out, "\n{}", sentence(&text));
    }
    out.push_str("\nThe score summarises observed figures and has no interval. The verdict does not depend on it.\n\n</details>\n");
}
