//! Documents as self-contained HTML files.

mod explorer;
mod pairs;
mod policy;
mod prose;
mod replay;
mod verdict;
mod watch;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use robogate_analysis::transfer::Transfer;
use robogate_analysis::{Analysis, Comparison};

pub use explorer::explorer_page;
pub use prose::script_data;
pub(crate) use prose::{prose, rich};
pub use replay::replay_page;

use crate::Additions;
use crate::document::{
    Block, Document, Figure, Kind, RequalificationPage, Section, Table, analysis_document, comparison_document,
    requalification_document, transfer_document,
};
use crate::watch::Watch;

pub(crate) const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// The analysis as one self-contained page. Equal analyses give equal bytes.
///
/// It makes no network request, works without scripts, can be printed, and has a light and a dark theme. Text from data
/// is escaped.
pub fn html(analysis: &Analysis) -> String {
    html_with(analysis, &Additions::default())
}

/// The analysis as one page with the same properties and these additions.
pub fn html_with(analysis: &Analysis, additions: &Additions<'_>) -> String {
    page(&analysis_document(analysis, additions), additions.watch)
}

/// A comparison as one self-contained page with the same properties.
pub fn comparison_html(comparison: &Comparison) -> String {
    comparison_html_with(comparison, None)
}

/// A comparison as one page with the same properties, and with episodes worth watching.
pub fn comparison_html_with(comparison: &Comparison, watch: Option<&Watch>) -> String {
    page(&comparison_document(comparison, watch), watch)
}

/// A transfer to the real robot as one self-contained page with the same properties.
pub fn transfer_html(transfer: &Transfer) -> String {
    page(&transfer_document(transfer), None)
}

/// A requalification as one self-contained page with the same properties.
pub fn requalification_html(of: &RequalificationPage<'_>) -> String {
    page(&requalification_document(of), None)
}

/// What the head of every page begins with.
fn metadata() -> Markup {
    html! {
        meta charset="utf-8";
        meta name="viewport" content="width=device-width, initial-scale=1";
        meta name="color-scheme" content="light dark";
        link rel="icon" href="data:,";
    }
}

/// A complete page around a body.
pub(crate) fn frame(title: &str, body: &Markup, script: bool) -> String {
    let own = script.then_some(SCRIPT);
    let body = prose::inert(&body.0);
    let policy = policy::of(&body, own, STYLE);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                (metadata())
                meta http-equiv="Content-Security-Policy" content=(policy);
                title { (prose(title)) " \u{b7} RoboGate" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                (PreEscaped(&body))
                footer {
                    p {
                        "RoboGate " (env!("CARGO_PKG_VERSION"))
                        " \u{b7} the same data give the same page, byte for byte"
                    }
                }
                @if let Some(script) = own { script { (PreEscaped(script)) } }
            }
        }
    };
    page.into_string()
}

fn page(document: &Document, watch: Option<&Watch>) -> String {
    let body = html! {
        (hero(document))
        main { @for section in &document.sections { (self::section(section, document.verdict.is_some())) } }
        (watch::scripts(watch))
    };
    frame(&document.title, &body, true)
}

fn hero(document: &Document) -> Markup {
    html! {
        header.top {
            p.brand { b { "RoboGate" } " " (document.kind) }
            h1 { (prose(&document.title)) }
            p.sub { (prose(&document.subtitle)) }
            @if let Some(verdict) = &document.verdict { (verdict::verdict(verdict)) }
            div.hero {
                div.rate {
                    p.big { (big(&document.figure)) }
                    p.what { (prose(&document.figure_label)) }
                    (document.scale)
                    p.ci-text { (prose(&document.interval)) }
                }
                div.say { p.answer { (rich(&document.answer)) } }
            }
            div.three {
                @for (title, lines) in &document.columns {
                    section {
                        h2 { (prose(title)) }
                        ul { @for line in lines { li { (rich(line)) } } }
                    }
                }
            }
            nav aria-label="Contents" {
                ul {
                    @for section in &document.sections { li { a href={ "#" (section.id) } { (prose(&section.title)) } } }
                }
            }
        }
    }
}

/// The key figure with a small unit.
fn big(figure: &str) -> Markup {
    match figure.split_once(' ') {
        Some((number, unit)) => html! { (prose(number)) small { (prose(unit)) } },
        None => html! { (prose(figure)) },
    }
}

/// The sections that are open when the page opens. A reader acts on them; the others hold the evidence.
const OPEN: [&str; 6] = ["watch", "marginal-effects", "rates", "real-map", "paired", ENVELOPE];
/// This one is folded below a verdict: the scenarios of a gate are chosen, and do not fill a map.
const ENVELOPE: &str = "envelope";

fn section(section: &Section, below_verdict: bool) -> Markup {
    let of = html! { @if let Some(population) = &section.population { p.of { (rich(population)) } } };
    let blocks = html! { @for one in &section.blocks { (block(one)) } };
    let open = OPEN.iter().any(|id| section.id.starts_with(id)) && !(below_verdict && section.id == ENVELOPE);
    html! {
        section id=(section.id) class=[(!open).then_some("folded")] {
            @if open {
                header { h2 { (prose(&section.title)) } (of) }
                (blocks)
            } @else {
                details.section { summary { h2 { (prose(&section.title)) } } (of) (blocks) }
            }
        }
    }
}

pub(crate) fn block(block: &Block) -> Markup {
    match block {
        Block::Text(text) | Block::Legend(text) => html! { p.text { (rich(text)) } },
        Block::Caution(text) => html! { p.caution { (rich(text)) } },
        Block::Code(text) => html! { pre { (prose(text)) } },
        Block::Heading(text) => html! { h3 { (prose(text)) } },
        Block::List(lines) => list("plain", lines),
        Block::Figure(figure) => self::figure(figure, "wide"),
        Block::Grid(figures) => html! { div.grid { @for one in figures { (self::figure(one, "small")) } } },
        Block::Group(title, blocks) => html! {
            details { summary { (prose(title)) } @for one in blocks { (self::block(one)) } }
        },
        Block::Table(table) => html! {
            @if !table.title.is_empty() { h3 { (prose(&table.title)) } }
            (self::table(table))
        },
        Block::Folded(table) => folded(table),
        Block::Watch(watch) => watch::watch(watch),
        Block::Pairs(pairs) => pairs::pairs(pairs),
        Block::Facts(facts) => html! {
            dl { @for (name, value) in facts { div { dt { (prose(name)) } dd { (prose(value)) } } } }
        },
    }
}

fn list(class: &str, lines: &[String]) -> Markup {
    html! { ul class=(class) { @for line in lines { li { (rich(line)) } } } }
}

fn figure(figure: &Figure, class: &str) -> Markup {
    html! {
        figure class=(class) {
            h3 { (prose(&figure.title)) }
            div.pane {
                div.draw.map[figure.is_map] { (figure.svg) }
                figcaption {
                    @if !figure.findings.is_empty() { (list("reading", &figure.findings)) }
                    @if !figure.caption.is_empty() { p { (rich(&figure.caption)) } }
                }
            }
            (folded(&figure.table))
        }
    }
}

fn folded(table: &Table) -> Markup {
    html! { details { summary { (prose(&table.title)) } (self::table(table)) } }
}

fn table(table: &Table) -> Markup {
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        @for column in &table.columns {
                            @if column.head.is_empty() {
                                td {}
                            } @else {
                                th scope="col" class=[class_of(column.kind)] { (prose(&column.head)) }
                            }
                        }
                    }
                }
                tbody {
                    @for row in &table.rows {
                        tr { @for (cell, column) in row.iter().zip(&table.columns) { (self::cell(cell, column.kind)) } }
                    }
                }
            }
        }
        @if let Some(remark) = &table.remark { p.remark { (rich(remark)) } }
    }
}

fn cell(text: &str, kind: Kind) -> Markup {
    match kind {
        Kind::Zone => html! { td { span class={ "zone " (text.replace(' ', "-")) } { (prose(text)) } } },
        Kind::Code => html! { td { code { (prose(text)) } } },
        Kind::Text | Kind::Number | Kind::Short => html! { td class=[class_of(kind)] { (prose(text)) } },
    }
}

fn class_of(kind: Kind) -> Option<&'static str> {
    match kind {
        Kind::Number => Some("num"),
        Kind::Short => Some("short"),
        Kind::Text | Kind::Zone | Kind::Code => None,
    }
}
