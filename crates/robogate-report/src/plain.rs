//! Documents as plain text, for a terminal. A figure becomes its findings and its table.

use robogate_analysis::transfer::Transfer;
use robogate_analysis::{Analysis, Comparison};
use robogate_stats::format::count;

use crate::Additions;
use crate::document::{
    Block, Document, Figure, Kind, Section, Table, analysis_document, comparison_document, transfer_document,
};

/// A line of a report as plain text. Texts from files are unchanged: a terminal escapes them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Line {
    /// The title of the report or of a section.
    Heading(String),
    /// The title of a part of a section.
    Subheading(String),
    /// A sentence or a few, which may wrap.
    Text(String),
    /// A row of a table, or a command.
    Row(String),
}

/// Rows of a table. The page has the others.
const MOST_ROWS: usize = 16;
/// Columns of a row, and between two cells.
const MOST_COLUMNS: usize = 94;
const GAP: usize = 2;

/// The analysis as plain text, with additions.
pub fn analysis_text(analysis: &Analysis, additions: &Additions<'_>) -> Vec<Line> {
    text(&analysis_document(analysis, additions))
}

/// A comparison as plain text.
pub fn comparison_text(comparison: &Comparison) -> Vec<Line> {
    text(&comparison_document(comparison, None))
}

/// A transfer to the real robot as plain text.
pub fn transfer_text(transfer: &Transfer) -> Vec<Line> {
    text(&transfer_document(transfer))
}

fn text(document: &Document) -> Vec<Line> {
    let mut lines = vec![
        Line::Heading(format!("RoboGate {}: {}", document.kind, document.title)),
        Line::Text(document.subtitle.clone()),
        Line::Text(document.answer.clone()),
        Line::Text(format!("{} {} ({})", document.figure, document.figure_label, document.interval)),
    ];
    for (title, sentences) in &document.columns {
        lines.push(Line::Heading((*title).to_owned()));
        lines.extend(sentences.iter().cloned().map(Line::Text));
    }
    // What a dataset consists of is on the page.
    for section in document.sections.iter().filter(|section| section.id != "provenance") {
        of_section(&mut lines, section);
    }
    lines
}

fn of_section(lines: &mut Vec<Line>, section: &Section) {
    lines.push(Line::Heading(section.title.clone()));
    lines.extend(section.population.clone().map(Line::Text));
    section.blocks.iter().for_each(|block| of_block(lines, block));
}

fn of_block(lines: &mut Vec<Line>, block: &Block) {
    match block {
        Block::Text(text) => lines.push(Line::Text(text.clone())),
        Block::Caution(text) => lines.push(Line::Text(format!("Caution: {text}"))),
        Block::Code(text) => lines.extend(text.lines().map(|row| Line::Row(row.to_owned()))),
        Block::Heading(text) => lines.push(Line::Subheading(text.clone())),
        Block::List(sentences) => lines.extend(sentences.iter().cloned().map(Line::Text)),
        Block::Figure(figure) => of_figure(lines, figure),
        Block::Grid(figures) => figures.iter().for_each(|figure| of_figure(lines, figure)),
        Block::Group(title, blocks) => {
            lines.push(Line::Subheading(title.clone()));
            blocks.iter().for_each(|block| of_block(lines, block));
        }
        Block::Table(table) => {
            lines.extend((!table.title.is_empty()).then(|| Line::Subheading(table.title.clone())));
            self::table(lines, table);
        }
        Block::Facts(facts) => {
            lines.extend(facts.iter().map(|(name, value)| Line::Text(format!("{name}: {value}"))));
        }
        // They are for a page with drawings that can be operated.
        Block::Legend(_) | Block::Folded(_) | Block::Watch(_) | Block::Pairs(_) => {}
    }
}

fn of_figure(lines: &mut Vec<Line>, figure: &Figure) {
    lines.push(Line::Subheading(figure.title.clone()));
    lines.extend(figure.findings.iter().cloned().map(Line::Text));
    table(lines, &figure.table);
}

/// A table with aligned columns. One that is too wide continues below, with its first column again.
pub(crate) fn table(lines: &mut Vec<Line>, of: &Table) {
    let shown = &of.rows[..of.rows.len().min(MOST_ROWS)];
    let heads: Vec<String> = of.columns.iter().map(|column| column.head.clone()).collect();
    let wide = |at: usize| {
        let rows = shown.iter().chain([&heads]);
        rows.filter_map(|row| row.get(at)).map(|cell| cell.chars().count()).max().unwrap_or_default()
    };
    let first = wide(0).min(MOST_COLUMNS / 2);
    let widths: Vec<usize> =
        (0..heads.len()).map(|at| if at == 0 { first } else { wide(at).min(MOST_COLUMNS - GAP - first) }).collect();
    for part in parts(&widths) {
        for row in [&heads].into_iter().chain(shown) {
            let cells = part.iter().filter_map(|&at| {
                let (cell, width) = (fitted(row.get(at)?, widths[at]), widths[at]);
                Some(match of.columns[at].kind {
                    Kind::Number => format!("{cell:>width$}"),
                    Kind::Text | Kind::Short | Kind::Zone | Kind::Code => format!("{cell:<width$}"),
                })
            });
            lines.push(Line::Row(cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()));
        }
    }
    if of.rows.len() > shown.len() {
        let more = (of.rows.len() - shown.len()) as u64;
        lines.push(Line::Text(format!("{} more rows are on the page and in the JSON document.", count(more))));
    }
    lines.extend(of.remark.clone().map(Line::Text));
}

/// The columns of each part of a table that fits into a line. Each part begins with the first column.
fn parts(widths: &[usize]) -> Vec<Vec<usize>> {
    let first = widths.first().copied().unwrap_or_default();
    let (mut parts, mut used) = (vec![vec![0]], first);
    for (at, width) in widths.iter().enumerate().skip(1) {
        if used + GAP + width > MOST_COLUMNS {
            parts.push(vec![0]);
            used = first;
        }
        if let Some(part) = parts.last_mut() {
            part.push(at);
        }
        used += GAP + width;
    }
    parts
}

/// A text of at most so many characters.
fn fitted(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['\u{2026}']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_tables_continue_below() {
        let columns = [("name", Kind::Short), ("n", Kind::Number), ("what", Kind::Text)];
        let row = |name: &str| vec![name.to_owned(), "7".to_owned(), "x".repeat(200)];
        let mut lines = Vec::new();
        table(&mut lines, &Table::new("", &columns, vec![row("a"), row("b")]));
        let rows: Vec<&str> = lines
            .iter()
            .map(|line| match line {
                Line::Row(row) => row.as_str(),
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(rows[..3], ["name  n", "a     7", "b     7"]);
        assert_eq!((rows.len(), rows[3], rows[4].chars().count()), (6, "name  what", MOST_COLUMNS));
        assert!(rows[5].starts_with("b     xxx") && rows[5].ends_with('\u{2026}'));
    }
}
