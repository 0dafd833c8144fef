//! Failure modes.

use maud::Markup;
use robogate_analysis::labels::{label_with_unit, mode_label};
use robogate_analysis::{FailureModes, ModeChanges};
use robogate_stats::format::{count, number, percent, significant};

use super::modes::{further_lines, mode_class, mode_legend, short_label};
use super::svg::{Anchor, Scale, Svg};

/// Draws the shares of the failure modes.
pub(crate) fn failure_modes(modes: &FailureModes) -> Markup {
    let mut svg = Svg::new(520.0, 4.0 + 34.0 * modes.modes.len() as f64);
    let longest = modes.modes.iter().map(|share| short_label(&share.mode).chars().count()).max().unwrap_or_default();
    let left = (12.0 + 7.2 * longest as f64).max(92.0);
    let x = Scale::linear([0.0, 1.0], [left, 376.0]);
    for (i, share) in modes.modes.iter().enumerate() {
        let y = 6.0 + 34.0 * i as f64;
        svg.text("b", Anchor::End, [left - 8.0, y + 17.0], &short_label(&share.mode));
        svg.rect("track", [x.at(0.0), y + 4.0, x.at(1.0) - x.at(0.0), 17.0]);
        let Some(part) = share.share else { continue };
        svg.rect(&mode_class(i), [x.at(0.0), y + 4.0, x.at(part) - x.at(0.0), 17.0]);
        let [l, h] = share.interval_95;
        svg.line("whisker", [x.at(l), y + 12.5, x.at(h), y + 12.5]);
        svg.text("b", Anchor::Start, [384.0, y + 17.0], &percent(part));
        svg.text("s d", Anchor::End, [516.0, y + 17.0], &count(share.failures));
    }
    svg.finish("Failures by mode, with simultaneous intervals")
}

/// Draws the shares of the failure modes by one parameter.
pub(crate) fn mode_changes(parameter: &str, changes: &ModeChanges, modes: &FailureModes) -> Markup {
    let n = changes.bins.len().max(1);
    let names: Vec<&str> = modes.modes.iter().map(|share| share.mode.as_str()).collect();
    let further = further_lines(&names, 420.0);
    let mut svg = Svg::new(420.0, 232.0 + further);
    let (left, right, top, bottom) = (42.0, 412.0, 34.0 + further, 184.0 + further);
    let w = (right - left) / n as f64;
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    let ends = (changes.bins.first().map_or(0.0, |b| b.range[0]), changes.bins.last().map_or(1.0, |b| b.range[1]));
    // A tick that is negligible on this axis is shown as 0.
    let tick = |x: f64| if x.abs() < 0.005 * (ends.1 - ends.0) { "0".to_owned() } else { significant(x, 2) };
    mode_legend(&mut svg, &names, 420.0, 8.0);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [left, y.at(tick), right, y.at(tick)]);
        svg.text("s d", Anchor::End, [left - 6.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
    }
    for (i, bin) in changes.bins.iter().enumerate() {
        let all: u64 = bin.counts.iter().sum();
        let x = left + w * i as f64;
        let mut below = 0;
        for (m, counted) in bin.counts.iter().enumerate().filter(|(_, counted)| **counted > 0) {
            let (from, to) = (below as f64 / all as f64, (below + counted) as f64 / all as f64);
            let mode = names.get(m).copied().unwrap_or_default();
            let hint = format!(
                "{} to {}: {} of {all} {}",
                number(bin.range[0]),
                number(bin.range[1]),
                counted,
                mode_label(mode)
            );
            svg.rect_with_hint(&mode_class(m), [x + 1.0, y.at(to) + 0.5, w - 2.0, y.at(from) - y.at(to) - 1.0], &hint);
            below += counted;
        }
        let every = (44.0 / w).ceil().max(1.0) as usize;
        if i % every == 0 && i + every <= n {
            let anchor = if i == 0 { Anchor::Start } else { Anchor::Middle };
            svg.text("s d", anchor, [x, bottom + 15.0], &tick(bin.range[0]));
        }
        if i + 1 == n {
            svg.text("s d", Anchor::End, [right, bottom + 15.0], &tick(bin.range[1]));
        }
        if bin.significant {
            svg.dot("significant", [x + 0.5 * w, bottom + 26.0], 2.6, "significantly the most frequent mode");
        }
    }
    svg.text("a", Anchor::Middle, [0.5 * (left + right), bottom + 44.0], &label_with_unit(parameter));
    svg.finish(&format!("Failure modes by {}", label_with_unit(parameter)))
}
