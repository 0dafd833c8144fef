//! Failure modes of several datasets.

use maud::Markup;
use robogate_analysis::ComparedDataset;
use robogate_analysis::labels::mode_label;
use robogate_stats::format::{count, percent, percent_range};

use crate::figures::svg::{Anchor, Scale, Svg, cut};

/// Shares of the failure modes, one bar for each dataset.
pub(crate) fn failure_modes(datasets: &[&ComparedDataset]) -> Markup {
    let names: Vec<&str> =
        datasets.first().map_or_else(Vec::new, |d| d.failure_modes.modes.iter().map(|m| m.mode.as_str()).collect());
    let bottom = 30.0 + 32.0 * datasets.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 22.0);
    let mut at = 0.0;
    for (i, name) in names.iter().enumerate() {
        svg.rect(&format!("m{i}"), [at, 4.0, 11.0, 11.0]);
        svg.text("s", Anchor::Start, [at + 16.0, 14.0], &mode_label(name));
        at += 30.0 + 6.6 * name.len() as f64;
    }
    let x = Scale::linear([0.0, 1.0], [150.0, 440.0]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [x.at(tick), 26.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    for (row, dataset) in datasets.iter().enumerate() {
        let y = 32.0 + 32.0 * row as f64;
        let modes = &dataset.failure_modes;
        svg.text("s", Anchor::End, [142.0, y + 13.0], &cut(&dataset.name, 22));
        svg.rect("track", [x.at(0.0), y, x.at(1.0) - x.at(0.0), 18.0]);
        let mut from = 0.0;
        for (i, share) in modes.modes.iter().enumerate() {
            let Some(part) = share.share.filter(|part| *part > 0.0) else { continue };
            let hint = format!(
                "{}: {} {} ({})",
                dataset.name,
                mode_label(&share.mode),
                percent(part),
                percent_range(share.interval_95)
            );
            svg.rect_with_hint(&format!("m{i}"), [x.at(from), y, x.at(from + part) - x.at(from) - 0.8, 18.0], &hint);
            from += part;
        }
        svg.text("s d", Anchor::Start, [448.0, y + 13.0], &format!("n = {}", count(modes.failures)));
    }
    svg.finish("Failure modes of each dataset")
}
