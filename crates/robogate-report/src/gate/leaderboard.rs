//! The leaderboard as Markdown and as one HTML file.

use maud::{Markup, html};
use robogate_gate::{Leaderboard, Standing};

use crate::document::{Kind, Table};
use crate::html::{frame, prose};
use crate::markdown::{self, escape_markdown};
use crate::plain;
use robogate_analysis::labels::mode_label;
use robogate_stats::format::{count, counted, fixed, percent, percent_range};

/// The cells of one policy.
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
                .map_or_else(|| "no interval".to_owned(), |[l, h]| format!("{} to {}", fixed(l, 1), fixed(h, 1))),
            success: format!("{rate} ({} of {})", count(standing.successes), count(standing.valid)),
            success_interval: percent_range(standing.success_95) + if standing.sequential { " *" } else { "" },
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

/// The title of the last column.
const FAILURES: &str = "failures";

/// The titles of the other columns.
fn heads(board: &Leaderboard) -> [&'static str; 6] {
    let interval = if board.is_sequential() { "95 % interval" } else { "exact 95 % interval" };
    ["rank (95 %)", "policy", "score", "95 % (bootstrap)", "success", interval]
}

fn terms(board: &Leaderboard) -> Vec<String> {
    board.standings.first().map_or_else(Vec::new, |first| {
        first.score.terms.iter().map(|t| format!("{} /{}", t.term.name, fixed(100.0 * t.term.weight, 0))).collect()
    })
}

fn caution(board: &Leaderboard) -> String {
    let sequential = if board.is_sequential() {
        " Intervals of success rates without * are exact. Those with * are confidence sequences, which hold for any number of \
         episodes: it was not fixed in advance, as in a gate that stops early, and the exact interval would cover too rarely."
    } else {
        ""
    };
    format!(
        "{} The score summarises observed figures. Its interval and that of the rank come from {} bootstrap replicates of the \
         scenarios, within each category and the same for every policy. The best policy is named if its score and its success rate are \
         significantly higher than those of every other one (5 % for all comparisons together). \"no interval\": all replicates are equal, which does not \
         mean that the score is exact.{sequential}",
        board.population.estimand(),
        count(board.draws)
    )
}

/// The leaderboard as Markdown.
pub fn leaderboard_markdown(board: &Leaderboard) -> String {
    format!("# Leaderboard\n\n{}", board_markdown(board))
}

/// Several leaderboards as one Markdown page, each in a section.
pub fn leaderboards_markdown(title: &str, boards: &[Leaderboard]) -> String {
    let sections: Vec<String> = boards
        .iter()
        .map(|board| format!("## {}\n\n{}", escape_markdown(&self::title(board)), board_markdown(board)))
        .collect();
    format!("# {}\n\n{}", escape_markdown(title), sections.join("\n"))
}

fn board_markdown(board: &Leaderboard) -> String {
    let mut out = format!("{}\n\n", escape_markdown(&board.population.to_string()));
    markdown::table(&mut out, &table(board, &terms(board)), false);
    out
}

/// The leaderboard as plain text.
pub fn leaderboard_text(board: &Leaderboard) -> Vec<plain::Line> {
    let mut lines =
        vec![plain::Line::Heading(format!("Leaderboard, {}", board.population)), plain::Line::Text(title(board))];
    plain::table(&mut lines, &table(board, &[]));
    lines
}

/// The standings, with the points of these terms of the score.
fn table(board: &Leaderboard, terms: &[String]) -> Table {
    let heads = heads(board);
    let texts = heads.into_iter().chain(terms.iter().map(String::as_str)).chain([FAILURES]);
    let columns: Vec<(&str, Kind)> = texts.map(|head| (head, Kind::Short)).collect();
    let cells = |line: Line| {
        let own = [line.rank, line.name, line.score, line.interval, line.success, line.success_interval];
        own.into_iter().chain(line.terms.into_iter().take(terms.len())).chain([line.failures]).collect()
    };
    let mut table = Table::new("", &columns, board.standings.iter().map(Line::of).map(cells).collect());
    table.remark = Some(caution(board));
    table
}

/// The leaderboard as one self-contained HTML file. Equal leaderboards give equal bytes.
pub fn leaderboard_html(board: &Leaderboard) -> String {
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " leaderboard" }
            h1 { (prose(&title(board))) }
            p.sub { (prose(&board.population.to_string())) }
        }
        main { (sections(board)) }
    };
    frame("Leaderboard", &body, false)
}

/// Several leaderboards as one self-contained HTML file, each in a section.
pub fn leaderboards_html(title: &str, boards: &[Leaderboard]) -> String {
    let policies: usize = boards.iter().map(|board| board.standings.len()).sum();
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " leaderboard" }
            h1 { (prose(title)) }
            p.sub { (prose(&format!("{} on {} of scenarios", counted(policies as u64, "run"), counted(boards.len() as u64, "set")))) }
        }
        main {
            @for board in boards {
                section {
                    header { h2 { (prose(&self::title(board))) } }
                    p.text { (prose(&board.population.to_string())) }
                }
                (sections(board))
            }
        }
    };
    frame(title, &body, false)
}

/// The tables of a leaderboard.
fn sections(board: &Leaderboard) -> Markup {
    let lines: Vec<Line> = board.standings.iter().map(Line::of).collect();
    html! {
        section {
            div.scroll {
                table {
                    thead { tr { @for head in heads(board).into_iter().chain([FAILURES]) { th scope="col" { (prose(head)) } } } }
                    tbody { @for (standing, line) in board.standings.iter().zip(&lines) { (row(standing, line)) } }
                }
            }
        }
        section {
            header { h2 { "Terms of each score" } }
            div.scroll {
                table {
                    thead {
                        tr {
                            th scope="col" { "policy" }
                            @for head in terms(board) { th scope="col" { (prose(&head)) } }
                        }
                    }
                    tbody {
                        @for line in &lines {
                            tr {
                                th scope="row" { (prose(&line.name)) }
                                @for term in &line.terms { td { (prose(term)) } }
                            }
                        }
                    }
                }
            }
            p.text { (prose(&caution(board))) }
        }
    }
}

fn row(standing: &Standing, line: &Line) -> Markup {
    html! {
        tr {
            td { (prose(&line.rank)) }
            th scope="row" { (prose(&line.name)) }
            td { (prose(&line.score)) @if let Some(points) = standing.score.points { (scale(points, standing.score_95)) } }
            @for cell in [&line.interval, &line.success, &line.success_interval, &line.failures] { td { (prose(cell)) } }
        }
    }
}

fn title(board: &Leaderboard) -> String {
    let n = board.standings.len();
    match (&board.leader, board.standings.as_slice()) {
        (_, [only]) => format!("{}, the only policy", only.name),
        (Some(leader), _) => format!("{leader} is the best of {n} policies"),
        (None, [first, ..]) if first.score.points.is_some() => format!("No policy of {n} is significantly the best"),
        _ => "No policy can be ranked".to_owned(),
    }
}

/// The score on a line from 0 to 100, with its interval.
fn scale(points: f64, interval: Option<[f64; 2]>) -> Markup {
    html! {
        svg viewBox="-1 0 102 12" width="120" height="14" role="img" aria-label={ (fixed(points, 1)) " of 100" }
            style="display:block"
        {
            line x1="0" y1="6" x2="100" y2="6" stroke="var(--line)" {}
            @if let Some([low, high]) = interval {
                rect x=(fixed(low, 2)) y="3" width=(fixed((high - low).max(0.5), 2)) height="6" fill="var(--band)" {}
            }
            circle cx=(fixed(points, 2)) cy="6" r="2.6" fill="var(--accent)" {}
        }
    }
}
