//! Documents as Markdown. A figure becomes its table.

use std::fmt::Write;

use crate::Additions;
use crate::document::{Block, Document, Figure, Kind, Table, analysis_document, comparison_document};
use crate::watch::{Watch, WatchItem};
use robogate_analysis::{Analysis, Comparison};
use robogate_stats::format::is_deceptive;

/// The analysis as Markdown (GitHub's flavour, because of its tables).
pub fn markdown(analysis: &Analysis) -> String {
    markdown_with(analysis, &Additions::default())
}

/// The analysis as Markdown with additions.
pub fn markdown_with(analysis: &Analysis, additions: &Additions<'_>) -> String {
    page(&analysis_document(analysis, additions))
}

/// A comparison as Markdown in the same flavour.
pub fn comparison_markdown(comparison: &Comparison) -> String {
    page(&comparison_document(comparison, None))
}

fn page(document: &Document) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail, here and below.
    let _ = write!(out, "# {}\n\n{}\n\n", escape_markdown(&document.title), escape_markdown(&document.subtitle));
    if let Some(verdict) = &document.verdict {
        verdict.markdown(&mut out);
    }
    let _ =
        write!(out, "**{}** {} ({})\n\n", document.figure, escape_markdown(&document.figure_label), document.interval);
    let _ = write!(out, "{}\n\n", escape_markdown(&document.answer));
    for (title, lines) in &document.columns {
        if !lines.is_empty() {
            let _ = write!(out, "**{title}**\n\n");
            list(&mut out, lines);
        }
    }
    for section in &document.sections {
        let _ = write!(out, "## {}\n\n", escape_markdown(&section.title));
        if let Some(population) = &section.population {
            let _ = write!(out, "_{}_\n\n", escape_markdown(population));
        }
        for one in &section.blocks {
            block(&mut out, one);
        }
    }
    out
}

fn block(out: &mut String, block: &Block) {
    match block {
        Block::Text(text) | Block::Legend(text) => {
            let _ = write!(out, "{}\n\n", escape_markdown(text));
        }
        Block::Code(text) => {
            let _ = write!(out, "```text\n{}\n```\n\n", text.replace("```", "'''"));
        }
        Block::Caution(text) => {
            let _ = write!(out, "> **Caution.** {}\n\n", escape_markdown(text));
        }
        Block::Heading(text) => {
            let _ = write!(out, "### {}\n\n", escape_markdown(text));
        }
        Block::List(lines) => list(out, lines),
        Block::Figure(figure) => self::figure(out, figure),
        Block::Group(title, blocks) => {
            let _ = write!(out, "**{}**\n\n", escape_markdown(title));
            blocks.iter().for_each(|block| self::block(out, block));
        }
        Block::Grid(figures) => figures.iter().for_each(|figure| self::figure(out, figure)),
        Block::Table(table) | Block::Folded(table) => self::table(out, table, true),
        Block::Facts(facts) => {
            for (name, value) in facts {
                let _ = writeln!(out, "- {}: {}", escape_markdown(name), escape_markdown(value));
            }
            out.push('\n');
        }
        Block::Watch(watch) => self::watch(out, watch),
        // Markdown cannot be operated; `--pair` adds a map.
        Block::Pairs(_) => {}
    }
}

/// The episodes worth watching, with the commands that replay them.
fn watch(out: &mut String, watch: &Watch) {
    watch.items.iter().for_each(|item| watch_item(out, item));
    out.push('\n');
    for remark in &watch.remarks {
        let _ = write!(out, "{}\n\n", escape_markdown(remark));
    }
}

/// An episode with its command and, where they exist, its frames.
pub(crate) fn watch_item(out: &mut String, item: &WatchItem) {
    let words = [&item.why, &item.beside].map(|text| escape_markdown(text));
    let words: Vec<&str> = words.iter().map(String::as_str).filter(|text| !text.is_empty()).collect();
    let _ = writeln!(
        out,
        "- **{}** ({}): {} `{}`",
        escape_markdown(&item.title),
        escape_markdown(&item.outcome),
        words.join(" "),
        item.command.replace(['`', '\n'], "'")
    );
    for strip in &item.strips {
        let _ = writeln!(out, "\n  ![{}]({})\n", escape_markdown(&strip.alt), link(&strip.file));
    }
}

/// A relative path as the target of a link: other characters than letters, digits and `-._~/` are percent-encoded.
fn link(path: &str) -> String {
    let mut target = String::with_capacity(path.len());
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte) {
            target.push(char::from(byte));
        } else {
            let _ = write!(target, "%{byte:02X}");
        }
    }
    target
}

fn figure(out: &mut String, figure: &Figure) {
    let _ = write!(out, "### {}\n\n", escape_markdown(&figure.title));
    list(out, &figure.findings);
    if !figure.caption.is_empty() {
        let _ = write!(out, "{}\n\n", escape_markdown(&figure.caption));
    }
    table(out, &figure.table, false);
}

fn list(out: &mut String, lines: &[String]) {
    for line in lines {
        let _ = writeln!(out, "- {}", escape_markdown(line));
    }
    if !lines.is_empty() {
        out.push('\n');
    }
}

pub(crate) fn table(out: &mut String, table: &Table, titled: bool) {
    if titled && !table.title.is_empty() {
        let _ = write!(out, "**{}**\n\n", escape_markdown(&table.title));
    }
    let heads: Vec<String> = table.columns.iter().map(|c| escape_markdown(&c.head)).collect();
    let rules: Vec<&str> = table.columns.iter().map(|c| if c.kind == Kind::Number { "---:" } else { "---" }).collect();
    let _ = writeln!(out, "| {} |\n| {} |", heads.join(" | "), rules.join(" | "));
    for row in &table.rows {
        let cells: Vec<String> = row
            .iter()
            .zip(&table.columns)
            .map(|(cell, column)| match column.kind {
                Kind::Code => format!("`{}`", cell.replace(['`', '\n'], "'").replace('|', "\\|")),
                Kind::Text | Kind::Short | Kind::Number | Kind::Zone => escape_markdown(cell),
            })
            .collect();
        let _ = writeln!(out, "| {} |", cells.join(" | "));
    }
    out.push('\n');
    if let Some(remark) = &table.remark {
        let _ = write!(out, "{}\n\n", escape_markdown(remark));
    }
}

/// Escapes the Markdown and HTML markup of a text.
pub(crate) fn escape_markdown(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '&' => safe.push_str("&amp;"),
            '\n' | '\r' => safe.push(' '),
            '\\' | '`' | '*' | '_' | '|' | '[' | ']' | '#' => {
                safe.push('\\');
                safe.push(letter);
            }
            c if is_deceptive(c) && c != '\t' => safe.push('\u{fffd}'),
            c => safe.push(c),
        }
    }
    safe
}
