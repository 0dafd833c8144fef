//! The leaderboard as Markdown and as one HTML file.

use std::fmt::Write;

use robogate_gate::{Leaderboard, Standing};

use crate::page::{STYLE, escape, escape_markdown};
use robogate_analysis::labels::mode_label;
use robogate_stats::format::{count, fixed, percent, percent_range};

/// What the columns say, one policy a line.
struct Line {
    rank: String,
    name: String,
    score: String,
    interval: String,
    success: String,
    success_interval: String,
    failures: String,
    terms: Vec<String>,
}

impl Line {
    fn of(standing: &Standing) -> Self {
        let dash = || "-".to_owned();
        let rank = match (standing.rank, standing.ranks_95) {
            (Some(rank), Some([low, high])) if low < high => format!("{rank} ({low} to {high})"),
            (Some(rank), _) => rank.to_string(),
            (None, _) => dash(),
        };
        let failures: Vec<String> =
            standing.endings.iter().map(|e| format!("{} {}", mode_label(&e.ending), count(e.episodes))).collect();
        let rate = if standing.valid > 0 { percent(standing.successes as f64 / standing.valid as f64) } else { dash() };
        Self {
            rank,
            name: standing.name.clone(),
            score: standing.score.points.map_or_else(dash, |points| fixed(points, 1)),
            interval: standing
                .score_95
                .map_or_else(|| "no spread".to_owned(), |[l, h]| format!("{} to {}", fixed(l, 1), fixed(h, 1))),
            success: format!("{rate} ({} of {})", count(standing.successes), count(standing.valid)),
            success_interval: percent_range(standing.success_95),
            failures: if failures.is_empty() { dash() } else { failures.join(", ") },
            terms: standing
                .score
                .terms
                .iter()
                .map(|term| term.points.map_or_else(dash, |points| fixed(points, 1)))
                .collect(),
        }
    }
}

const HEADS: [&str; 6] = ["rank (95 %)", "policy", "score", "95 % of draws", "success", "exact 95 % interval"];

fn terms(board: &Leaderboard) -> Vec<String> {
    board.standings.first().map_or_else(Vec::new, |first| {
        first.score.terms.iter().map(|t| format!("{} /{}", t.term.name, fixed(100.0 * t.term.weight, 0))).collect()
    })
}

fn caution(board: &Leaderboard) -> String {
    format!(
        "{} The score summarises observed figures. Its interval and that of the rank come from {} draws of the scenarios, \
         with replacement within each category, the same for every policy; \"no spread\" means that resampling cannot tell, not \
         that there is no doubt.",
        board.population.estimand(),
        count(board.draws)
    )
}

/// The leaderboard as Markdown.
pub fn leaderboard_markdown(board: &Leaderboard) -> String {
    let mut heads: Vec<String> = HEADS.iter().map(|head| (*head).to_owned()).collect();
    heads.extend(terms(board));
    heads.push("otherwise".to_owned());
    let mut out = format!("# Leaderboard\n\n{}\n\n", escape_markdown(&board.population.to_string()));
    // Writing to a string cannot fail; so throughout this file.
    let _ = writeln!(
        out,
        "| {} |\n|{}",
        heads.iter().map(|h| escape_markdown(h)).collect::<Vec<_>>().join(" | "),
        "---|".repeat(heads.len())
    );
    for line in board.standings.iter().map(Line::of) {
        let mut cells = vec![line.rank, line.name, line.score, line.interval, line.success, line.success_interval];
        cells.extend(line.terms);
        cells.push(line.failures);
        let cells: Vec<String> = cells.iter().map(|cell| escape_markdown(cell)).collect();
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
    let _ = writeln!(out, "\n{}", escape_markdown(&caution(board)));
    out
}

/// The leaderboard as one self-contained HTML file: the same bytes for the same leaderboard.
pub fn leaderboard_html(board: &Leaderboard) -> String {
    let mut out = String::new();
    let _ = write!(
        out,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>Leaderboard \u{b7} RoboGate</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <header class=\"top\">\n<p class=\"brand\"><b>RoboGate</b> leaderboard</p>\n<h1>{}</h1>\n\
         <p class=\"sub\">{}</p>\n</header>\n<main>\n<section>\n<div class=\"scroll\"><table>\n<thead><tr>",
        escape(&title(board)),
        escape(&board.population.to_string())
    );
    for head in HEADS.iter().copied().map(str::to_owned).chain(["otherwise".to_owned()]) {
        let _ = write!(out, "<th scope=\"col\">{}</th>", escape(&head));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for (standing, line) in board.standings.iter().map(|s| (s, Line::of(s))) {
        let _ = writeln!(
            out,
            "<tr><td>{}</td><th scope=\"row\">{}</th><td>{}{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&line.rank),
            escape(&line.name),
            escape(&line.score),
            scale(standing),
            escape(&line.interval),
            escape(&line.success),
            escape(&line.success_interval),
            escape(&line.failures)
        );
    }
    out.push_str(
        "</tbody></table></div>\n</section>\n<section>\n<header><h2>What each score is made of</h2></header>\n",
    );
    out.push_str("<div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">policy</th>");
    for head in terms(board) {
        let _ = write!(out, "<th scope=\"col\">{}</th>", escape(&head));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for line in board.standings.iter().map(Line::of) {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th>", escape(&line.name));
        for term in &line.terms {
            let _ = write!(out, "<td>{}</td>", escape(term));
        }
        out.push_str("</tr>\n");
    }
    let _ = write!(
        out,
        "</tbody></table></div>\n<p class=\"text\">{}</p>\n</section>\n</main>\n\
         <footer><p>RoboGate {} \u{b7} the same data give the same page, byte for byte</p></footer>\n</body>\n</html>\n",
        escape(&caution(board)),
        env!("CARGO_PKG_VERSION")
    );
    out
}

fn title(board: &Leaderboard) -> String {
    match board.standings.as_slice() {
        [only] => format!("{} alone", only.name),
        [first, ..] if first.score.points.is_some() => {
            format!("{} leads {} policies", first.name, board.standings.len())
        }
        _ => "Nothing to rank".to_owned(),
    }
}

/// The score on a line from 0 to 100, with its interval.
fn scale(standing: &Standing) -> String {
    let Some(points) = standing.score.points else { return String::new() };
    let band = standing.score_95.map_or_else(String::new, |[low, high]| {
        format!(
            "<rect x=\"{}\" y=\"3\" width=\"{}\" height=\"6\" fill=\"var(--band)\"/>",
            fixed(low, 2),
            fixed((high - low).max(0.5), 2)
        )
    });
    format!(
        "<svg viewBox=\"-1 0 102 12\" width=\"120\" height=\"14\" role=\"img\" aria-label=\"{} of 100\" style=\"display:block\">\
         <line x1=\"0\" y1=\"6\" x2=\"100\" y2=\"6\" stroke=\"var(--line)\"/>{band}\
         <circle cx=\"{}\" cy=\"6\" r=\"2.6\" fill=\"var(--accent)\"/></svg>",
        fixed(points, 1),
        fixed(points, 2)
    )
}
