//! The safety case as one page that can be filed and printed.

use maud::{Markup, html};

use super::{Answered, Claim, NO_CONFORMITY, NoteKind, SafetyCase, Support};
use crate::document::Kind::{Short, Text, Zone};
use crate::document::{Block, Table};
use crate::html::{block, frame, prose, rich};

/// The name of the file with the argument, from the page.
const ARGUMENT: &str = "safety-case.gsn.yaml";

/// The argument as one self-contained HTML file without scripts, or a page with the reason why the evidence supports no argument. Equal
/// arguments give equal bytes.
pub fn safety_case_html(case: Result<&SafetyCase, &str>) -> String {
    let case = match case {
        Ok(case) => case,
        Err(because) => return without(because),
    };
    let claim = &case.claim;
    let of = |support| claim.parts.iter().filter(move |part| part.support == support).map(|part| part.text.clone());
    let not = of(Support::NotSupported).collect::<Vec<String>>();
    let open = of(Support::Undeveloped).collect::<Vec<String>>();
    let notes = |kind: NoteKind| {
        // What is not claimed stands above the clauses.
        let of_kind = case.notes.iter().filter(|note| note.kind == kind && note.name != "conformity");
        of_kind.map(|note| note.text.clone()).collect::<Vec<String>>()
    };
    let sections = [
        ("Argument", "argument", html! { (legend()) ul.argument { (branch(claim)) } }),
        ("What can defeat it", "defeaters", block(&Block::Table(defeaters(claim)))),
        ("Contexts", "contexts", block(&Block::List(notes(NoteKind::Context)))),
        ("Assumptions", "assumptions", block(&Block::List(notes(NoteKind::Assumption)))),
        ("Method", "method", block(&Block::List(notes(NoteKind::Justification)))),
        (
            "Clauses that this can support",
            "clauses",
            html! { (block(&Block::Caution(NO_CONFORMITY.to_owned()))) (block(&Block::Table(clauses(case)))) },
        ),
        ("Evidence by digest", "evidence", block(&Block::Table(solutions(case)))),
        ("How to check", "check", check()),
    ];
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " safety case" }
            h1 { (claim.support.as_str().to_uppercase()) }
            p.sub { (prose(&claim.text)) }
            p.sub { (prose(&claim.because)) }
            div.three {
                @for (title, texts) in [("Contradicted claims", &not), ("Undeveloped claims", &open)] {
                    @if !texts.is_empty() {
                        section { h2 { (title) } ul { @for text in texts { li { (prose(text)) } } } }
                    }
                }
            }
            nav aria-label="Contents" { ul { @for (title, id, _) in &sections { li { a href={ "#" (id) } { (title) } } } } }
        }
        main { @for (title, id, content) in &sections { section id=(id) { header { h2 { (title) } } (content) } } }
    };
    frame("Safety case", &body, false)
}

/// The page of invalid evidence.
fn without(because: &str) -> String {
    let body = html! {
        header.top {
            p.brand { b { "RoboGate" } " safety case" }
            h1 { "NO ARGUMENT" }
            p.sub { "The evidence supports no argument: " (prose(because.trim_end_matches('.'))) "." }
        }
        main { section { header { h2 { "What to do" } } p.text {
            "Remove the cause and run the gate again. Invalid evidence says nothing about the policy: neither that it may run, nor that it may not."
        } } }
    };
    frame("Safety case: no argument", &body, false)
}

fn legend() -> Markup {
    html! {
        p.text {
            "A claim is " span.zone.supported { "supported" } " if files of this evidence support it and no defeater is open, "
            span.zone.undeveloped { "undeveloped" } " if nothing is known about it or a defeater is open, and "
            span.zone.not-supported { "not supported" } " if a file contradicts it. Each status is computed from the files."
        }
    }
}

/// A claim with everything below it. Supported ranges are one line each, with their files at their common claim.
fn branch(claim: &Claim) -> Markup {
    let class = claim.support.as_str().replace(' ', "-");
    let is_short = claim.name.starts_with("range-") && claim.support == Support::Supported;
    let ranges = if claim.name == "ranges" { claim.parts.first() } else { None };
    let files = ranges.map_or(&claim.files, |part| &part.files);
    html! {
        li id=(claim.name) {
            p { span class={ "zone " (class) } { (claim.support.as_str()) } " " b { (prose(&claim.text)) } }
            @if !is_short {
                p.remark { (rich(&claim.because)) }
                @if !files.is_empty() {
                    p.remark {
                        "Evidence: "
                        @for (at, file) in files.iter().enumerate() { @if at > 0 { ", " } a href=(file) { (prose(file)) } }
                    }
                }
            }
            @if !claim.parts.is_empty() { ul { @for part in &claim.parts { (branch(part)) } } }
        }
    }
}

fn defeaters(claim: &Claim) -> Table {
    let columns = [("status", Zone), ("what would make a claim false", Text), ("claim", Text), ("why", Text)];
    let mut rows: Vec<(Answered, Vec<String>)> = Vec::new();
    for claim in claim.all() {
        rows.extend(claim.defeaters.iter().map(|defeater| {
            let cells = [defeater.state.as_str(), &defeater.text, &claim.text, &defeater.because];
            (defeater.state, cells.map(|text| text.replace('`', "")).to_vec())
        }));
    }
    rows.sort_by_key(|(state, _)| *state);
    Table::new("", &columns, rows.into_iter().map(|(_, row)| row).collect())
}

fn clauses(case: &SafetyCase) -> Table {
    let columns = [("clause", Text), ("title", Text), ("what this evidence contributes", Text), ("its claims", Zone)];
    let rows = case.clauses.iter().map(|clause| {
        let number = format!("{}, {}", clause.source, clause.number);
        [&number, clause.title, clause.contributes, clause.support.as_str()].map(str::to_owned).to_vec()
    });
    Table::new("", &columns, rows.collect())
}

fn solutions(case: &SafetyCase) -> Table {
    let columns = [("file", Short), ("content", Text), ("SHA-256", Text)];
    let row = |of: &super::Solution| [&of.path, of.what, &of.sha256].map(str::to_owned).to_vec();
    Table::new("", &columns, case.solutions.iter().map(row).collect())
}

fn check() -> Markup {
    let how = "Run `robogate verify .` in this folder. It computes the verdict again from the rows, writes this page and the argument again, and \
        compares both. This page states no signature: `verify` says who signed.";
    html! {
        p.text { (rich(how)) }
        p.text {
            "The argument for tools is " a href=(ARGUMENT) { code { (ARGUMENT) } }
            ": Goal Structuring Notation as YAML, which gsn2x reads, checks and draws."
        }
    }
}
