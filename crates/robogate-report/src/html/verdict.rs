//! The verdict of the gate at the top of a page.

use maud::{Markup, html};
use robogate_gate::Status;

use super::prose::{prose, rich};
use crate::gate::{VerdictBlock, sign};

pub(super) fn verdict(of: &VerdictBlock) -> Markup {
    html! {
        section class={ "verdict " (of.verdict.as_str()) } aria-label="Verdict" {
            p.verdict-word { (of.word()) }
            p.verdict-because { (rich(&of.because)) }
            ul.requirements {
                @for one in &of.requirements {
                    li class=(status(one.row.status)) {
                        span.sign role="img" aria-label=(status(one.row.status)) { (sign(one.row.status)) }
                        span.demand { (prose(&one.row.requirement)) }
                        span.bar { @if let Some(bar) = &one.bar { (bar) } }
                        span.seen {
                            b { (prose(&one.row.observed)) }
                            @if !one.row.interval.is_empty() { span { (prose(&one.row.interval)) } }
                        }
                        @if !one.row.note.is_empty() { span.note { (prose(&one.row.note)) } }
                    }
                }
            }
            p.verdict-next { b { "Next step" } " " (rich(&of.next)) }
            @if !of.changes.is_empty() {
                p.verdict-head { "What to change" }
                ol.verdict-weakest {
                    @for change in &of.changes {
                        li { (rich(&change.text)) @if !change.command.is_empty() { " " code { (prose(&change.command)) } } }
                    }
                }
            }
            @if !of.weakest.is_empty() {
                p.verdict-head { "Weakest scenarios" }
                ul.verdict-weakest { @for line in &of.weakest { li { (rich(line)) } } }
            }
            @if !of.controls.is_empty() {
                p.verdict-head { "Controls" }
                ul.verdict-weakest { @for line in &of.controls { li { (rich(line)) } } }
            }
            @if let Some(text) = &of.outside_range { p.remark { (rich(text)) } }
            details { summary { "How this was decided" } p.remark { (rich(&of.basis)) } }
        }
    }
}

/// The status as a word.
fn status(status: Status) -> &'static str {
    match status {
        Status::Met => "met",
        Status::Violated => "violated",
        Status::Undecided => "undecided",
        Status::NoEvidence => "no-evidence",
    }
}
