//! The analysis as one HTML file that needs nothing beside itself.

use std::fmt::Write;

use crate::page::svg::escape;
use crate::story::{Block, Figure, Kind, Story, Table, tell, tell_comparison};
use robogate_analysis::{Analysis, Comparison};

pub(crate) const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// The analysis as one self-contained page: the same bytes for the same analysis.
///
/// It asks nothing of the network, works with scripts off, prints, and knows light and dark. Whatever comes from
/// data is escaped.
pub fn html(analysis: &Analysis) -> String {
    page(&tell(analysis))
}

/// A comparison as one self-contained page, in the same way.
pub fn comparison_html(comparison: &Comparison) -> String {
    page(&tell_comparison(comparison))
}

fn page(story: &Story) -> String {
    let mut out = String::with_capacity(256 * 1024);
    let title = escape(&story.title);
    // Writing to a string cannot fail; so throughout this file.
    let _ = write!(
        out,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <link rel=\"icon\" href=\"data:,\">\n\
         <title>{title} \u{b7} RoboGate</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
    );
    hero(&mut out, story);
    out.push_str("<main>\n");
    for section in &story.sections {
        let _ = write!(out, "<section id=\"{}\">\n<header><h2>{}</h2>", section.id, escape(&section.title));
        if let Some(population) = &section.population {
            let _ = write!(out, "<p class=\"of\">{}</p>", escape(population));
        }
        out.push_str("</header>\n");
        for one in &section.blocks {
            block(&mut out, one);
        }
        out.push_str("</section>\n");
    }
    out.push_str("</main>\n");
    let _ = write!(
        out,
        "<footer><p>RoboGate {} \u{b7} the same data give the same page, byte for byte</p></footer>\n<script>\n{SCRIPT}</script>\n\
         </body>\n</html>\n",
        env!("CARGO_PKG_VERSION")
    );
    out
}

fn hero(out: &mut String, story: &Story) {
    let _ = write!(
        out,
        "<header class=\"top\">\n<p class=\"brand\"><b>RoboGate</b> {}</p>\n<h1>{}</h1>\n<p class=\"sub\">{}</p>\n\
         <div class=\"hero\">\n<div class=\"rate\"><p class=\"big\">{}</p><p class=\"what\">{}</p>{}<p class=\"ci-text\">{}</p></div>\n\
         <div class=\"say\"><p class=\"answer\">{}</p></div>\n</div>\n<div class=\"three\">\n",
        story.kind,
        escape(&story.title),
        escape(&story.subtitle),
        big(&story.rate),
        escape(&story.rate_of),
        story.scale,
        escape(&story.interval),
        escape(&story.answer)
    );
    for (title, lines) in &story.columns {
        let _ = write!(out, "<section><h2>{title}</h2><ul>");
        for line in lines {
            let _ = write!(out, "<li>{}</li>", escape(line));
        }
        out.push_str("</ul></section>\n");
    }
    out.push_str("</div>\n<nav aria-label=\"Contents\"><ul>");
    for section in &story.sections {
        let _ = write!(out, "<li><a href=\"#{}\">{}</a></li>", section.id, escape(&section.title));
    }
    out.push_str("</ul></nav>\n</header>\n");
}

/// The large figure, its unit small.
fn big(rate: &str) -> String {
    match rate.split_once(' ') {
        Some((number, unit)) => format!("{}<small>{}</small>", escape(number), escape(unit)),
        None => escape(rate),
    }
}

fn block(out: &mut String, block: &Block) {
    let paragraph = |out: &mut String, class: &str, text: &str| {
        let _ = writeln!(out, "<p class=\"{class}\">{}</p>", escape(text));
    };
    match block {
        Block::Text(text) => paragraph(out, "text", text),
        Block::Caution(text) => paragraph(out, "caution", text),
        Block::Code(text) => {
            let _ = writeln!(out, "<pre>{}</pre>", escape(text));
        }
        Block::Heading(text) => {
            let _ = writeln!(out, "<h3>{}</h3>", escape(text));
        }
        Block::List(lines) => list(out, "plain", lines),
        Block::Figure(figure) => self::figure(out, figure, "wide"),
        Block::Grid(figures) => {
            out.push_str("<div class=\"grid\">\n");
            figures.iter().for_each(|figure| self::figure(out, figure, "small"));
            out.push_str("</div>\n");
        }
        Block::Table(table) => {
            if !table.title.is_empty() {
                let _ = write!(out, "<h3>{}</h3>", escape(&table.title));
            }
            self::table(out, table);
        }
        Block::Folded(table) => folded(out, table),
        Block::Facts(facts) => {
            out.push_str("<dl>");
            for (name, value) in facts {
                let _ = write!(out, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
            }
            out.push_str("</dl>\n");
        }
    }
}

fn list(out: &mut String, class: &str, lines: &[String]) {
    let _ = write!(out, "<ul class=\"{class}\">");
    for line in lines {
        let _ = write!(out, "<li>{}</li>", escape(line));
    }
    out.push_str("</ul>\n");
}

fn figure(out: &mut String, figure: &Figure, class: &str) {
    let _ = write!(
        out,
        "<figure class=\"{class}\">\n<h3>{}</h3>\n<div class=\"pane\"><div class=\"draw{}\">{}</div>",
        escape(&figure.title),
        if figure.is_map { " map" } else { "" },
        figure.svg
    );
    out.push_str("<figcaption>");
    if !figure.reading.is_empty() {
        list(out, "reading", &figure.reading);
    }
    if !figure.caption.is_empty() {
        let _ = write!(out, "<p>{}</p>", escape(&figure.caption));
    }
    out.push_str("</figcaption></div>\n");
    folded(out, &figure.table);
    out.push_str("</figure>\n");
}

fn folded(out: &mut String, table: &Table) {
    let _ = write!(out, "<details><summary>{}</summary>", escape(&table.title));
    self::table(out, table);
    out.push_str("</details>\n");
}

fn table(out: &mut String, table: &Table) {
    out.push_str("<div class=\"scroll\"><table><thead><tr>");
    for column in &table.columns {
        let _ = write!(out, "<th scope=\"col\"{}>{}</th>", class_of(column.kind), escape(&column.head));
    }
    out.push_str("</tr></thead><tbody>\n");
    for row in &table.rows {
        out.push_str("<tr>");
        for (cell, column) in row.iter().zip(&table.columns) {
            let cell = escape(cell);
            let _ = match column.kind {
                Kind::Zone => write!(out, "<td><span class=\"zone {}\">{cell}</span></td>", cell.replace(' ', "-")),
                Kind::Code => write!(out, "<td><code>{cell}</code></td>"),
                Kind::Text | Kind::Number | Kind::Short => write!(out, "<td{}>{cell}</td>", class_of(column.kind)),
            };
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
    if let Some(remark) = &table.remark {
        let _ = writeln!(out, "<p class=\"remark\">{}</p>", escape(remark));
    }
}

fn class_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Number => " class=\"num\"",
        Kind::Short => " class=\"short\"",
        Kind::Text | Kind::Zone | Kind::Code => "",
    }
}
