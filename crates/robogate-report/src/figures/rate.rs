//! A success rate on its scale.

use maud::Markup;
use robogate_analysis::Rate;
use robogate_stats::format::{percent, percent_range};

use super::svg::{Anchor, Scale, Svg};

/// Draws the success rate on a line from 0 to 100 %, with its interval and its bounds. It has no zones: which rate is sufficient is
/// the user's decision.
pub(crate) fn rate_scale(rate: &Rate, bounds: Option<[f64; 2]>) -> Markup {
    let mut svg = Svg::new(360.0, 62.0);
    let x = Scale::linear([0.0, 1.0], [6.0, 354.0]);
    let y = 12.0;
    svg.rect("zb", [x.at(0.0), y, x.at(1.0) - x.at(0.0), 14.0]);
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
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
