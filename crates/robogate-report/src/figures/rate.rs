//! A success rate on its scale.

use maud::Markup;
use robogate_analysis::Rate;
use robogate_stats::format::{percent, percent_range};

use super::ZONES;
use super::svg::{Anchor, Scale, Svg};

/// Draws the success rate on a line from 0 to 100 %, with its interval, its bounds and the zones.
pub(crate) fn rate_scale(rate: &Rate, bounds: Option<[f64; 2]>) -> Markup {
    let mut svg = Svg::new(360.0, 84.0);
    let x = Scale::linear([0.0, 1.0], [6.0, 354.0]);
    let y = 34.0;
    for (class, from, to, text) in
        [("zd", 0.0, ZONES[0], "danger"), ("zb", ZONES[0], ZONES[1], "boundary"), ("zs", ZONES[1], 1.0, "safe")]
    {
        svg.rect(class, [x.at(from), y, x.at(to) - x.at(from) - 1.5, 14.0]);
        svg.text("s d", Anchor::Middle, [x.at(0.5 * (from + to)), y - 8.0], text);
    }
    for tick in [0.0, 0.3, 0.5, 0.7, 1.0] {
        let anchor = match tick {
            t if t <= 0.0 => Anchor::Start,
            t if t >= 1.0 => Anchor::End,
            _ => Anchor::Middle,
        };
        svg.text("s d", anchor, [x.at(tick), y + 44.0], &format!("{:.0} %", 100.0 * tick));
    }
    if let Some([low, high]) = bounds {
        svg.line("bounds", [x.at(low), y + 20.0, x.at(high), y + 20.0]);
    }
    let [low, high] = rate.wilson_95;
    svg.rect_with_hint(
        "ci",
        [x.at(low), y - 3.0, (x.at(high) - x.at(low)).max(3.0), 20.0],
        &percent_range(rate.wilson_95),
    );
    if let Some(rate) = rate.rate {
        svg.line("mark", [x.at(rate), y - 6.0, x.at(rate), y + 20.0]);
    }
    let label = rate.rate.map_or_else(|| "no valid episode".to_owned(), percent);
    svg.finish(&format!("Success rate {label}, 95 % interval {}", percent_range(rate.wilson_95)))
}
