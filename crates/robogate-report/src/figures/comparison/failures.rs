//! Failure modes of several datasets.

use maud::Markup;
use robogate_analysis::ComparedDataset;
use robogate_analysis::labels::mode_label;
use robogate_stats::format::{count, percent, percent_range};

use crate::figures::modes::{further_lines, mode_class, mode_legend};
use crate::figures::svg::{Anchor, Scale, Svg, cut};

/// Draws the shares of the failure modes, with one bar for each dataset.
pub(crate) fn failure_modes(datasets: &[&ComparedDataset]) -> Markup {
    let names = names(datasets);
    let top = 30.0 + further_lines(&names, 520.0);
    let bottom = top + 32.0 * datasets.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 22.0);
    mode_legend(&mut svg, &names, 520.0, 4.0);
    let x = Scale::linear([0.0, 1.0], [150.0, 440.0]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [x.at(tick), top - 4.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    for (row, dataset) in datasets.iter().enumerate() {
        let y = top + 2.0 + 32.0 * row as f64;
        let modes = &dataset.failure_modes;
        svg.text("s", Anchor::End, [142.0, y + 13.0], &cut(&dataset.name, 22));
        svg.rect("track", [x.at(0.0), y, x.at(1.0) - x.at(0.0), 18.0]);
        let mut from = 0.0;
        for share in &modes.modes {
            let Some(part) = share.share.filter(|part| *part > 0.0) else { continue };
            let hint = format!(
                "{}: {} {} ({})",
                dataset.name,
                mode_label(&share.mode),
                percent(part),
                percent_range(share.interval_95)
            );
            let mode = names.iter().position(|name| *name == share.mode).unwrap_or_default();
            svg.rect_with_hint(&mode_class(mode), [x.at(from), y, x.at(from + part) - x.at(from) - 0.8, 18.0], &hint);
            from += part;
        }
        svg.text("s d", Anchor::Start, [448.0, y + 13.0], &format!("n = {}", count(modes.failures)));
    }
    svg.finish("Failure modes of each dataset")
}

/// The modes of all datasets, including modes that their tasks do not declare.
fn names<'a>(datasets: &[&'a ComparedDataset]) -> Vec<&'a str> {
    let mut names = Vec::new();
    for share in datasets.iter().flat_map(|dataset| &dataset.failure_modes.modes) {
        if !names.contains(&share.mode.as_str()) {
            names.push(share.mode.as_str());
        }
    }
    names
}
