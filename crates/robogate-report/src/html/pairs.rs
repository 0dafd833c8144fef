//! A map of any two parameters, which the reader chooses.

use maud::{Markup, PreEscaped, html};
use robogate_analysis::PairCounts;
use robogate_analysis::labels::label_and_unit;
use robogate_replay::packed_integers;
use serde_json::json;

/// The script of the map, bundled from web/src/pairs.js.
const SCRIPT: &str = include_str!("pairs.js");

pub(super) fn pairs(of: &PairCounts) -> Markup {
    let axes = of.axes.iter().map(|axis| {
        let (label, unit) = label_and_unit(&axis.parameter);
        json!({ "label": label, "unit": unit, "edges": axis.edges, "levels": axis.levels, "log": axis.log })
    });
    let counts = of.pairs.iter().flatten().flatten().copied();
    let data = json!({ "axes": axes.collect::<Vec<_>>(), "counts": packed_integers(counts) });
    let data = data.to_string().replace('<', "\\u003c");
    html! {
        details.pairs data-pairs hidden { summary { "Map of any two parameters" } }
        script type="application/json" id="pairs" { (PreEscaped(data)) }
        script { (PreEscaped(SCRIPT)) }
    }
}
