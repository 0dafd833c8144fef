//! The marginal effect of one parameter.

use maud::Markup;
use robogate_analysis::labels::label_with_unit;
use robogate_analysis::{Cell, CriticalThreshold, MarginalEffect, ParameterType, Zone};
use robogate_stats::format::{count, percent, percent_range};

use super::ZONES;
use super::svg::{Anchor, Scale, Svg, cut, round_ticks, tick};

/// Draws the success rate by one parameter.
pub(crate) fn marginal_effect(effect: &MarginalEffect) -> Markup {
    match effect.kind {
        ParameterType::Continuous | ParameterType::ContinuousLog if effect.cells.iter().all(|c| c.range.is_some()) => {
            bins(effect)
        }
        _ => levels(effect),
    }
}

fn bins(effect: &MarginalEffect) -> Markup {
    let mut svg = Svg::new(340.0, 200.0);
    let (low, high) = match (effect.cells.first(), effect.cells.last()) {
        (Some(first), Some(last)) => (first.range.unwrap_or_default()[0], last.range.unwrap_or_default()[1]),
        _ => (0.0, 1.0),
    };
    let x = Scale::linear([low, high], [42.0, 330.0]);
    let y = Scale::linear([0.0, 1.0], [158.0, 12.0]);
    rate_axis(&mut svg, y, 42.0, 330.0);
    if let Some(CriticalThreshold::Crosses { at, low: l, high: h, .. }) = effect.threshold.estimated() {
        let (from, to) = (x.at(l.unwrap_or(low).max(low)), x.at(h.unwrap_or(high).min(high)));
        svg.rect("tband", [from, 12.0, to - from, 146.0]);
        svg.line("tline", [x.at(*at), 12.0, x.at(*at), 158.0]);
    }
    let curve = effect.curve();
    let upper = curve.iter().map(|point| [x.at(point.at), y.at(point.interval_95[1])]);
    let lower = curve.iter().rev().map(|point| [x.at(point.at), y.at(point.interval_95[0])]);
    svg.polygon("modelband", &upper.chain(lower).collect::<Vec<_>>());
    svg.polyline("model", &curve.iter().map(|point| [x.at(point.at), y.at(point.rate)]).collect::<Vec<_>>());
    for cell in &effect.cells {
        let (Some([from, to]), Some(rate)) = (cell.range, cell.rate.rate) else { continue };
        let middle = x.at(0.5 * (from + to));
        let [l, h] = cell.rate.wilson_95;
        svg.line("whisker", [middle, y.at(l), middle, y.at(h)]);
        svg.dot("target", [middle, y.at(rate)], 12.0, &hint(cell));
        svg.dot("dot", [middle, y.at(rate)], 3.6, &hint(cell));
    }
    for at in round_ticks([low, high], 5, false) {
        svg.line("axis", [x.at(at), 158.0, x.at(at), 162.0]);
        let (anchor, place) = if x.at(at) > 320.0 { (Anchor::End, 338.0) } else { (Anchor::Middle, x.at(at)) };
        svg.text("s d", anchor, [place, 174.0], &tick(at));
    }
    svg.text("a", Anchor::Middle, [186.0, 193.0], &label_with_unit(&effect.parameter));
    svg.finish(&format!("Success by {}", label_with_unit(&effect.parameter)))
}

/// Maximum number of levels in the figure. The table has all.
const MAX_LEVELS: usize = 10;
/// Number of levels up to which those without an episode are shown.
const FEW_LEVELS: usize = 8;

fn levels(effect: &MarginalEffect) -> Markup {
    let few = effect.cells.len() <= FEW_LEVELS;
    let cells: Vec<_> = effect.cells.iter().filter(|cell| few || cell.rate.n > 0).take(MAX_LEVELS).collect();
    let height = if cells.len() <= 7 { 26.0 } else { 19.0 };
    let bottom = 10.0 + height * cells.len() as f64;
    let mut svg = Svg::new(340.0, bottom + 40.0);
    let x = Scale::linear([0.0, 1.0], [108.0, 318.0]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [x.at(tick), 8.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 15.0], &format!("{:.0} %", 100.0 * tick));
    }
    for limit in ZONES {
        svg.line("gl dash", [x.at(limit), 8.0, x.at(limit), bottom]);
    }
    for (i, cell) in cells.iter().enumerate() {
        let y = 10.0 + height * (i as f64 + 0.5);
        svg.text("s", Anchor::End, [100.0, y + 4.0], &cut(&cell.label, 16));
        let Some(rate) = cell.rate.rate else {
            svg.text("s d", Anchor::Start, [x.at(0.0) + 6.0, y + 4.0], "no episode");
            continue;
        };
        let [l, h] = cell.rate.wilson_95;
        svg.line("whisker", [x.at(l), y, x.at(h), y]);
        svg.dot("dot", [x.at(rate), y], 3.6, &hint(cell));
    }
    svg.text("a", Anchor::Middle, [213.0, bottom + 33.0], &label_with_unit(&effect.parameter));
    svg.finish(&format!("Success by {}", label_with_unit(&effect.parameter)))
}

fn hint(cell: &Cell) -> String {
    let rate = cell.rate.rate.map_or_else(|| "-".to_owned(), percent);
    let zone = match cell.zone {
        Zone::Undecided => "undecided between zones",
        zone => zone.as_str(),
    };
    format!(
        "{}: {} of {} succeeded, {rate} ({}); {zone}",
        cell.label,
        count(cell.rate.successes),
        count(cell.rate.n),
        percent_range(cell.rate.wilson_95)
    )
}

fn rate_axis(svg: &mut Svg, y: Scale, left: f64, right: f64) {
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [left, y.at(tick), right, y.at(tick)]);
        svg.text("s d", Anchor::End, [left - 6.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
    }
    for limit in ZONES {
        svg.line("gl dash", [left, y.at(limit), right, y.at(limit)]);
    }
}
