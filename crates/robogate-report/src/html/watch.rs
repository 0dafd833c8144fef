//! The list of episodes worth watching and their viewer.

use maud::{Markup, PreEscaped, html};

use super::prose::{prose, rich, script_data};
use crate::watch::{Watch, WatchItem};

/// The viewer with three.js, bundled from web/src/replays.js.
pub(super) const VIEWER: &str = include_str!("viewer.js");

/// The list, and the place of the viewer.
pub(super) fn watch(watch: &Watch) -> Markup {
    html! {
        div.watch.watch-alone[watch.reel.is_none()] {
            ol.watch-list { @for one in &watch.items { li { (item(one)) } } }
            @if watch.is_recorded() {
                div.watch-view data-viewer {
                    noscript { p.text { "The viewer needs JavaScript. The commands in the list replay the episodes." } }
                }
            }
        }
        @for remark in &watch.remarks { p.remark { (rich(remark)) } }
    }
}

fn item(item: &WatchItem) -> Markup {
    let body = html! {
        span.watch-title { (prose(&item.title)) }
        span.chip.good[item.success].bad[!item.success] { (prose(&item.outcome)) }
        span.watch-why { (prose(&item.why)) }
        @if !item.beside.is_empty() { span.watch-why { "Nearest pass: " (prose(&item.beside)) } }
    };
    html! {
        @if let Some(clip) = item.clip {
            // The script enables the button.
            button type="button" disabled data-first=(clip) data-second=[item.second] { (body) }
        } @else {
            div.watch-plain { (body) }
        }
        code.watch-command { (prose(&item.command)) }
    }
}

/// The recordings and the viewer at the end of a page.
pub(super) fn scripts(watch: Option<&Watch>) -> Markup {
    let reel = watch.filter(|watch| watch.is_recorded()).and_then(|watch| watch.reel.as_ref());
    html! {
        @if let Some(reel) = reel {
            script type="application/json" id="reel" { (PreEscaped(script_data(&reel.json))) }
            script { (PreEscaped(VIEWER)) }
        }
    }
}
