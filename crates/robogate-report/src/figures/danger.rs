//! Danger zones.

use maud::Markup;
use robogate_analysis::DangerZones;
use robogate_analysis::labels::parameter_label;
use robogate_stats::format::{percent, percent_range};

use super::heatmap::step;
use super::svg::{Anchor, Scale, Svg, cut};

/// Draws the danger zones with the smallest p-values and their intervals.
pub(crate) fn danger_zones(zones: &DangerZones, max: usize) -> Markup {
    let shown = &zones.zones[..zones.zones.len().min(max)];
    let bottom = 8.0 + 24.0 * shown.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 26.0);
    let x = Scale::linear([0.0, 1.0], [190.0, 496.0]);
    for tick in [0.0, 0.2, zones.limit, 0.6, 0.8, 1.0] {
        let class = if (tick - zones.limit).abs() < 1e-9 { "tline" } else { "gl" };
        svg.line(class, [x.at(tick), 4.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    for (i, zone) in shown.iter().enumerate() {
        let y = 20.0 + 24.0 * i as f64;
        let label = cut(&format!("{} {}", parameter_label(&zone.parameter), zone.cell), 27);
        svg.text(if zone.significant { "s" } else { "s d" }, Anchor::End, [182.0, y + 4.0], &label);
        let [l, h] = zone.rate.wilson_95;
        svg.line("whisker", [x.at(l), y, x.at(h), y]);
        let rate = zone.rate.rate.unwrap_or_default();
        let class = if zone.significant { format!("zdot r{}", step(rate)) } else { "zdot hollow".to_owned() };
        svg.dot(
            &class,
            [x.at(rate), y],
            4.4,
            &format!("{label}: {} ({})", percent(rate), percent_range(zone.rate.wilson_95)),
        );
    }
    svg.finish("Bins and levels below 40 % success: rates with intervals")
}
