//! The explorer: a page that shows the episodes of runs, served or as one file.

use maud::{DOCTYPE, PreEscaped, html};

use super::policy;
use super::prose::{prose, script_data};
use super::watch::VIEWER;

/// The explorer, bundled from web/src/explorer/main.js. It uses the viewer of the script before it.
const SCRIPT: &str = include_str!("explorer.js");
/// Colours and the viewer of episodes.
const STYLE: &str = include_str!("style.css");
/// The parts of the explorer.
const OWN_STYLE: &str = include_str!("explorer.css");

/// The page, and its content security policy.
///
/// `data` are two JSON documents: the episodes, and the reel of recorded episodes. Both must contain no `<`. With them the
/// page is self-contained and makes no request. Without them it reads everything from the server that it came from.
pub fn explorer_page(runs: &str, data: Option<(&str, &str)>) -> (String, String) {
    let body = html! {
        div id="explorer" {
            noscript { p.text { "The explorer needs JavaScript." } }
        }
        @if let Some((episodes, reel)) = data {
            script type="application/json" id="explorer-data" { (PreEscaped(script_data(episodes))) }
            script type="application/json" id="explorer-reel" { (PreEscaped(script_data(reel))) }
        }
        script { (PreEscaped(VIEWER)) }
        script { (PreEscaped(SCRIPT)) }
    };
    let style = format!("{STYLE}{OWN_STYLE}");
    let policy = if data.is_some() { policy::of(&body.0, None, &style) } else { policy::of_served(&body.0, &style) };
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                (super::metadata())
                // The header of the server has more than a page can say about itself.
                @if data.is_some() { meta http-equiv="Content-Security-Policy" content=(policy); }
                title { (prose(runs)) " \u{b7} RoboGate explorer" }
                style { (PreEscaped(style)) }
            }
            body.explorer { (body) }
        }
    };
    (page.into_string(), policy)
}
