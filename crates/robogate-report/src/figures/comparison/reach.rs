//! Success rates by workspace distance over reach.

use maud::Markup;
use robogate_analysis::ReachRow;
use robogate_stats::format::{number, percent};

use super::{class, dot, legend, legend_height};
use crate::figures::svg::{Anchor, Scale, Svg};

/// Draws the success rates by workspace distance over reach.
pub(crate) fn reach(rows: &[ReachRow], names: &[String]) -> Markup {
    let known: Vec<(&ReachRow, f64)> = rows.iter().filter_map(|row| Some((row, row.ratio?))).collect();
    let extent = known.iter().map(|(_, ratio)| *ratio).fold(1.0_f64, f64::max) * 1.1;
    let top = legend_height(names, [46.0, 512.0]) + 8.0;
    let bottom = top + 200.0;
    let mut svg = Svg::new(520.0, bottom + 42.0);
    legend(&mut svg, names, [46.0, 512.0], 0.0);
    let x = Scale::linear([0.0, extent], [46.0, 506.0]);
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [46.0, y.at(tick), 506.0, y.at(tick)]);
        svg.text("s d", Anchor::End, [40.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
    }
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &number(tick));
    }
    svg.line("axis dash", [x.at(1.0), top, x.at(1.0), bottom]);
    for (row, ratio) in known {
        let series = names.iter().position(|name| *name == row.name).unwrap_or_default();
        let [low, high] = row.rate.wilson_95.map(|end| y.at(end));
        svg.line(&format!("kwhisker {}", class(series)), [x.at(ratio), low, x.at(ratio), high]);
        let rate = row.rate.rate.unwrap_or_default();
        dot(
            &mut svg,
            series,
            [x.at(ratio), y.at(rate)],
            5.0,
            &format!("{}: ratio {}, {}", row.name, number(ratio), percent(rate)),
        );
    }
    svg.text("a", Anchor::Middle, [276.0, bottom + 36.0], "workspace distance / reach");
    svg.finish("Success rate by workspace distance over reach")
}
