//! Success rates of several datasets.

use maud::Markup;
use robogate_analysis::ComparedDataset;
use robogate_stats::format::{percent, percent_range};

use super::dot;
use crate::figures::svg::{Anchor, Scale, Svg, cut};

/// Draws the success rates with their intervals.
pub(crate) fn rates(datasets: &[ComparedDataset], names: &[String]) -> Markup {
    let mut svg = Svg::new(440.0, 30.0 + 34.0 * datasets.len() as f64);
    let x = Scale::linear([0.0, 1.0], [6.0, 424.0]);
    let bottom = 34.0 * datasets.len() as f64 + 6.0;
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        svg.line("gl", [x.at(tick), 4.0, x.at(tick), bottom]);
        svg.text(
            "s d",
            if tick > 0.0 { Anchor::Middle } else { Anchor::Start },
            [x.at(tick), bottom + 16.0],
            &format!("{:.0} %", 100.0 * tick),
        );
    }
    for (i, dataset) in datasets.iter().enumerate() {
        let y = 34.0 * i as f64;
        let rate = &dataset.success.rate;
        let hint = rate.rate.map_or_else(
            || "no valid episode".to_owned(),
            |r| format!("{} ({})", percent(r), percent_range(rate.wilson_95)),
        );
        let label = format!("{}  {}", cut(&dataset.name, 26), rate.rate.map_or_else(|| "\u{2013}".to_owned(), percent));
        svg.text("halo-text b", Anchor::Start, [8.0, y + 14.0], &label);
        let [low, high] = rate.wilson_95.map(|end| x.at(end));
        svg.line("whisker", [low, y + 26.0, high, y + 26.0]);
        if let Some(rate) = rate.rate {
            match names.iter().position(|name| *name == dataset.name) {
                Some(series) => dot(&mut svg, series, [x.at(rate), y + 26.0], 5.0, &hint),
                None => svg.dot("zdot hollow", [x.at(rate), y + 26.0], 5.0, &hint),
            }
        }
    }
    svg.finish("Success rates with 95 % intervals")
}
