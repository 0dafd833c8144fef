//! Figures of several datasets.

mod disagreement;
mod failures;
mod forest;
mod marginal;
mod rates;
mod reach;
mod universal;

use super::svg::{Anchor, Svg, cut};

pub(crate) use disagreement::disagreement;
pub(crate) use failures::failure_modes;
pub(crate) use forest::{ForestRow, forest, sensitivity};
pub(crate) use marginal::shared_curve;
pub(crate) use rates::rates;
pub(crate) use reach::reach;
pub(crate) use universal::universal_zones;

/// Number of series with their own colour. Further series reuse the colours with a hollow dot.
const COLOURS: usize = 6;
fn class(series: usize) -> String {
    let hollow = if series >= COLOURS { " hollow" } else { "" };
    format!("k{}{hollow}", series % COLOURS)
}

fn dot(svg: &mut Svg, series: usize, at: [f64; 2], r: f64, hint: &str) {
    svg.dot(&format!("kdot {}", class(series)), at, r, hint);
}

/// Draws names and colours on one or more lines, and returns their height.
fn legend(svg: &mut Svg, names: &[String], [left, right]: [f64; 2], top: f64) -> f64 {
    let (mut x, mut y) = (left, top + 10.0);
    for (series, name) in names.iter().enumerate() {
        let text = cut(name, 26);
        let room = 22.0 + 6.6 * text.chars().count() as f64;
        if x + room > right && x > left {
            x = left;
            y += 18.0;
        }
        dot(svg, series, [x + 5.0, y - 4.0], 4.4, name);
        svg.text("s", Anchor::Start, [x + 14.0, y], &text);
        x += room;
    }
    y - top + 10.0
}

/// The height of a legend.
fn legend_height(names: &[String], [left, right]: [f64; 2]) -> f64 {
    legend(&mut Svg::new(1.0, 1.0), names, [left, right], 0.0)
}
