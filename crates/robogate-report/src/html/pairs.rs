//! A map of any two parameters, which the reader chooses.

use maud::{Markup, PreEscaped, html};
use robogate_analysis::PairCounts;
use robogate_analysis::labels::{label_and_unit, mode_label};
use robogate_replay::packed_integers;
use serde_json::json;

use super::prose::script_data;

/// The script of the map, bundled from web/src/pairs.js.
const SCRIPT: &str = include_str!("pairs.js");

pub(super) fn pairs(of: &PairCounts) -> Markup {
    let axes = of.axes.iter().map(|axis| {
        let (label, unit) = label_and_unit(&axis.parameter);
        json!({ "label": label, "unit": unit, "edges": axis.edges, "levels": axis.levels, "log": axis.log })
    });
    let counts = of.pairs.iter().flatten().flatten().copied();
    // Column by column, because the numbers of one column are alike and compress well. 0 is no cell.
    let listed = || of.listed.iter();
    let cells = (0..of.axes.len()).flat_map(|axis| {
        listed().map(move |episode| episode.cells.get(axis).copied().flatten().map_or(0, |cell| cell as u64 + 1))
    });
    let indices = listed().scan(0, |last, episode| Some(episode.index - std::mem::replace(last, episode.index)));
    let columns = indices.chain(listed().map(|episode| episode.outcome as u64)).chain(cells);
    let data = json!({
        "axes": axes.collect::<Vec<_>>(),
        "counts": packed_integers(counts),
        "listed": packed_integers(columns),
        "outcomes": of.outcomes.iter().map(|outcome| mode_label(outcome)).collect::<Vec<_>>(),
        "success": of.outcomes.iter().position(|outcome| outcome == "success"),
    });
    let data = script_data(&data.to_string());
    html! {
        details.pairs data-pairs hidden { summary { "Map of any two parameters" } }
        script type="application/json" id="pairs" { (PreEscaped(data)) }
        script { (PreEscaped(SCRIPT)) }
    }
}
