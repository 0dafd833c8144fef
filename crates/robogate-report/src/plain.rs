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

/// A table with aligned columns.
pub(crate) fn table(lines: &mut Vec<Line>, of: &Table) {
    let shown = &of.rows[..of.rows.len().min(MOST_ROWS)];
    let wide = |at: usize| {
        let cells = shown.iter().filter_map(|row| row.get(at)).map(|cell| cell.chars().count());
        cells.chain([of.columns[at].head.chars().count()]).max().unwrap_or_default()
    };
    let widths: Vec<usize> = (0..of.columns.len()).map(wide).collect();
    let row = |cells: &mut dyn Iterator<Item = &str>| {
        let padded = cells.zip(&of.columns).zip(&widths).map(|((cell, column), &width)| match column.kind {
            Kind::Number => format!("{cell:>width$}"),
            Kind::Text | Kind::Short | Kind::Zone | Kind::Code => format!("{cell:<width$}"),
        });
        Line::Row(padded.collect::<Vec<_>>().join("  ").trim_end().to_owned())
    };
    lines.push(row(&mut of.columns.iter().map(|column| &*column.head)));
    lines.extend(shown.iter().map(|cells| row(&mut cells.iter().map(String::as_str))));
    if of.rows.len() > shown.len() {
        let more = (of.rows.len() - shown.len()) as u64;
        lines.push(Line::Text(format!("{} more rows are on the page and in the JSON document.", count(more))));
    }
    lines.extend(of.remark.clone().map(Line::Text));
}
