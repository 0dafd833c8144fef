//! A requirement of the gate: the observed figure with its interval, and the limit.

use maud::Markup;
use robogate_gate::{RequirementResult, Sense};

use super::svg::{Anchor, Scale, Svg};
use crate::gate::value;

/// Width and height of the drawing.
const SIZE: [f64; 2] = [300.0, 40.0];
/// The vertical centre of the bar.
const MIDDLE: f64 = 13.0;

/// Draws the interval and the figure on an axis with the limit. The allowed side is shaded. `None` without a figure.
pub(crate) fn requirement_bar(result: &RequirementResult) -> Option<Markup> {
    let observed = result.figure.observed?;
    let [low, high] = result.interval.unwrap_or([observed, observed]);
    let limit = result.bound.limit;
    if ![observed, low, high, limit].iter().all(|x| x.is_finite()) {
        return None;
    }
    let [from, to] = axis([low, high, observed, limit], result.unit.is_empty());
    let x = Scale::linear([from, to], [2.0, SIZE[0] - 2.0]);
    let mut svg = Svg::new(SIZE[0], SIZE[1]);
    svg.rect("track", [x.at(from), MIDDLE - 9.0, x.at(to) - x.at(from), 18.0]);
    let allowed = match result.bound.sense {
        Sense::AtLeast => [limit, to],
        Sense::AtMost => [from, limit],
    };
    svg.rect("allowed", [x.at(allowed[0]), MIDDLE - 9.0, x.at(allowed[1]) - x.at(allowed[0]), 18.0]);
    if result.interval.is_some() {
        svg.line("span", [x.at(low), MIDDLE, x.at(high), MIDDLE]);
    }
    svg.line("limit", [x.at(limit), MIDDLE - 12.0, x.at(limit), MIDDLE + 12.0]);
    let text = |x: f64| value(result.requirement.metric, &result.unit, x);
    svg.dot("seen-dot", [x.at(observed), MIDDLE], 4.5, &text(observed));
    svg.text("s d", Anchor::Start, [2.0, 38.0], &text(from));
    svg.text("s d", Anchor::End, [SIZE[0] - 2.0, 38.0], &text(to));
    Some(svg.finish(&format!("Observed {}, limit {}", text(observed), text(limit))))
}

/// A round range around these values: within 0 and 1 for shares, from 0 for other figures.
fn axis(values: [f64; 4], share: bool) -> [f64; 2] {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let step = 10_f64.powf((high - low).max(high.abs() * 0.02).max(1e-9).log10().floor());
    let from = ((low - 0.1 * (high - low)) / step).floor() * step;
    let to = ((high + 0.1 * (high - low)) / step).ceil() * step;
    let from = if low >= 0.0 { from.max(0.0) } else { from };
    let to = if share && high <= 1.0 { to.min(1.0) } else { to };
    if to > from { [from, to] } else { [from, from + step] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_holds_all_values() {
        for (values, share) in
            [([0.9, 0.97, 0.95, 0.9], true), ([0.0, 0.0, 0.0, 0.02], true), ([3.0, 4.1, 3.5, 9.0], false)]
        {
            let [from, to] = axis(values, share);
            assert!(values.iter().all(|x| (from..=to).contains(x)), "{values:?}: {from} to {to}");
            assert!(!share || to <= 1.0);
        }
    }
}
