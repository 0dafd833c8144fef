//! The page of the monitor that plays the simulated episodes most similar to an alarm.

use maud::{DOCTYPE, PreEscaped, html};

use super::policy;
use super::watch::VIEWER;

/// The page, bundled from web/src/replay.js. It uses the viewer of the script before it.
const SCRIPT: &str = include_str!("replay.js");
/// Colours and the viewer of episodes.
const STYLE: &str = include_str!("style.css");
/// The parts of this page.
const OWN_STYLE: &str = "header.top { padding-bottom: 6px; } .brand a { text-decoration: underline; } .watch table { min-width: 0; width: 100%; margin-top: 16px; } \
     .x-hidden { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }";

/// The page, and its content security policy. It contains no data: it reads the alarm from its address, and the episodes
/// from the server that it came from.
pub fn replay_page() -> (String, String) {
    let body = html! {
        div id="replay" {
            noscript { p.text { "This page needs JavaScript." } }
        }
        script { (PreEscaped(VIEWER)) }
        script { (PreEscaped(SCRIPT)) }
    };
    let style = format!("{STYLE}{OWN_STYLE}");
    let policy = policy::of_served(&body.0, &style);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                (super::metadata())
                title { "Similar simulated episodes \u{b7} RoboGate monitor" }
                style { (PreEscaped(style)) }
            }
            body { (body) }
        }
    };
    (page.into_string(), policy)
}
