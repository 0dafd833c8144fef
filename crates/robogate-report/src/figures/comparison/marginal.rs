//! The marginal effect of one parameter on several datasets.

use maud::Markup;
use robogate_analysis::labels::label_with_unit;
use robogate_analysis::{Rate, SharedCurve};
use robogate_stats::format::{percent, percent_range};

use super::{class, dot, legend, legend_height};
use crate::figures::svg::{Anchor, Scale, Svg, cut, round_ticks, tick};

/// Maximum number of characters of a level below a curve.
const MAX_LETTERS: usize = 14;

/// Draws the success rate by one parameter, with the same bins for every dataset.
pub(crate) fn shared_curve(curve: &SharedCurve, names: &[String]) -> Markup {
    let (left, right) = (42.0, 412.0);
    let top = legend_height(names, [left, right]) + 6.0;
    let bottom = top + 150.0;
    // Labels that are too long for the available space are rotated.
    let levels = curve.cells.iter().filter(|cell| cell.range.is_none());
    let longest = levels.map(|cell| cell.label.chars().count().min(MAX_LETTERS)).max().unwrap_or(0) as f64;
    let rotated = 6.4 * longest > (right - left) / curve.cells.len().max(1) as f64;
    let drop = if rotated { 6.6 * longest - 8.0 } else { 0.0 };
    let mut svg = Svg::new(420.0, bottom + drop + 40.0);
    legend(&mut svg, names, [left, right], 0.0);
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    for share in [0.0, 0.5, 1.0] {
        svg.line("gl", [left, y.at(share), right, y.at(share)]);
        svg.text("s d", Anchor::End, [left - 6.0, y.at(share) + 4.0], &format!("{:.0} %", 100.0 * share));
    }
    let room = (right - left) / curve.cells.len().max(1) as f64;
    let apart = (room * 0.7 / names.len().max(1) as f64).min(9.0);
    let place = |cell: usize, series: usize| {
        left + room * (cell as f64 + 0.5) + apart * (series as f64 - 0.5 * (names.len() as f64 - 1.0))
    };
    let ordered = curve.cells.iter().all(|cell| cell.range.is_some() || cell.label.parse::<f64>().is_ok());
    for (series, name) in names.iter().enumerate() {
        let rates: Vec<Option<&Rate>> = curve.cells.iter().map(|cell| cell.rates.get(series)).collect();
        if ordered {
            let mut piece: Vec<[f64; 2]> = Vec::new();
            for (i, rate) in rates.iter().enumerate() {
                match rate.and_then(|rate| rate.rate) {
                    Some(rate) => piece.push([place(i, series), y.at(rate)]),
                    None => {
                        svg.polyline(&format!("join {}", class(series)), &piece);
                        piece.clear();
                    }
                }
            }
            svg.polyline(&format!("join {}", class(series)), &piece);
        }
        for (i, (cell, rate)) in curve.cells.iter().zip(&rates).enumerate() {
            let Some((of, rate)) = rate.and_then(|of| Some((of, of.rate?))) else { continue };
            let at = place(i, series);
            let [low, high] = of.wilson_95.map(|end| y.at(end));
            svg.line(&format!("kwhisker {}", class(series)), [at, low, at, high]);
            let hint = format!(
                "{name}, {}: {} of {}, {} ({})",
                cell.label,
                of.successes,
                of.n,
                percent(rate),
                percent_range(of.wilson_95)
            );
            dot(&mut svg, series, [at, y.at(rate)], 3.4, &hint);
        }
    }
    let ends = curve.cells.first().and_then(|cell| cell.range).zip(curve.cells.last().and_then(|cell| cell.range));
    if let Some(([low, _], [_, high])) = ends {
        let x =
            if curve.log { Scale::log([low, high], [left, right]) } else { Scale::linear([low, high], [left, right]) };
        for at in round_ticks([low, high], 6, curve.log) {
            svg.text("s d", Anchor::Middle, [x.at(at), bottom + 16.0], &tick(at));
        }
    }
    for (i, cell) in curve.cells.iter().enumerate() {
        match cell.range {
            // Bins have an axis with round ticks.
            Some(_) => {}
            None => {
                let x = left + room * (i as f64 + 0.5);
                let every = (12.0 / room).ceil().max(1.0) as usize;
                if drop > 0.0 && i % every == 0 {
                    svg.text_up_to("s d", [x + 4.0, bottom + 7.0], &cut(&cell.label, MAX_LETTERS));
                } else if drop <= 0.0 {
                    svg.text("s d", Anchor::Middle, [x, bottom + 16.0], &cell.label);
                }
            }
        }
    }
    svg.text("a", Anchor::Middle, [0.5 * (left + right), bottom + drop + 35.0], &label_with_unit(&curve.parameter));
    svg.finish(&format!("Success by {}", label_with_unit(&curve.parameter)))
}
