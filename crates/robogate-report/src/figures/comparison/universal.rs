//! Universal zones.

use maud::Markup;
use robogate_analysis::UniversalZones;
use robogate_stats::format::{percent_or_dash, percent_range};

use super::{class, dot, legend, legend_height};
use crate::figures::svg::{Anchor, Scale, Svg, cut};

/// Draws the universal zones with the smallest p-values.
pub(crate) fn universal_zones(zones: &UniversalZones, names: &[String], max: usize) -> Markup {
    let shown = &zones.zones[..zones.zones.len().min(max)];
    let (left, right) = (214.0, 500.0);
    let top = legend_height(names, [0.0, right]) + 6.0;
    let step = (8.0 * names.len() as f64 + 8.0).max(22.0);
    let bottom = top + step * shown.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 26.0);
    legend(&mut svg, names, [0.0, right], 0.0);
    let x = Scale::linear([0.0, 1.0], [left, right]);
    for tick in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
        if (tick - zones.limit).abs() < 0.09 {
            continue;
        }
        svg.line("gl", [x.at(tick), top - 4.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    svg.line("tline", [x.at(zones.limit), top - 4.0, x.at(zones.limit), bottom]);
    svg.text("s", Anchor::Middle, [x.at(zones.limit), bottom + 16.0], &format!("{:.0} %", 100.0 * zones.limit));
    for (i, zone) in shown.iter().enumerate() {
        let middle = top + step * (i as f64 + 0.5);
        let cell = zone.describe();
        svg.text(if zone.significant { "s" } else { "s d" }, Anchor::End, [left - 10.0, middle + 4.0], &cut(&cell, 27));
        for (series, (rate, name)) in zone.rates.iter().zip(names).enumerate() {
            let y = middle + 8.0 * (series as f64 - 0.5 * (names.len() as f64 - 1.0));
            let [low, high] = rate.wilson_95.map(|end| x.at(end));
            svg.line(&format!("kwhisker {}", class(series)), [low, y, high, y]);
            let hint = format!("{name}, {cell}: {} ({})", percent_or_dash(rate.rate), percent_range(rate.wilson_95));
            dot(&mut svg, series, [x.at(rate.rate.unwrap_or_default()), y], 3.4, &hint);
        }
    }
    svg.finish("Cells in which the observed rate of every dataset is below the limit")
}
