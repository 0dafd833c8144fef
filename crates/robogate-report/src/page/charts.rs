//! The smaller figures.

use maud::Markup;

use crate::page::heatmap::step;
use crate::page::svg::{Anchor, Scale, Svg, cut};
use robogate_analysis::labels::{label_with_unit, mode_label};
use robogate_analysis::{Along, AlongKind, Cell, CriticalThreshold, Zone};
use robogate_analysis::{CalibrationFigures, DangerZones, FailureModes, ModeChanges, Rate, Regression, RocFigures};
use robogate_stats::format::{count, number, percent, percent_range, significant};

/// Success limits of the zones, as the paper has them.
const ZONES: [f64; 2] = [0.3, 0.7];

/// The success rate on a line from 0 to 100 %, with its interval and the zones.
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
    svg.rect_told("ci", [x.at(low), y - 3.0, (x.at(high) - x.at(low)).max(3.0), 20.0], &percent_range(rate.wilson_95));
    if let Some(rate) = rate.rate {
        svg.line("mark", [x.at(rate), y - 6.0, x.at(rate), y + 20.0]);
    }
    let label = rate.rate.map_or_else(|| "no valid episode".to_owned(), percent);
    svg.finish(&format!("Success rate {label}, 95 % interval {}", percent_range(rate.wilson_95)))
}

/// Success along one parameter.
pub(crate) fn along(along: &Along) -> Markup {
    match along.kind {
        AlongKind::Continuous | AlongKind::ContinuousLog if along.cells.iter().all(|c| c.range.is_some()) => {
            bins(along)
        }
        _ => levels(along),
    }
}

fn bins(along: &Along) -> Markup {
    let mut svg = Svg::new(340.0, 200.0);
    let (low, high) = match (along.cells.first(), along.cells.last()) {
        (Some(first), Some(last)) => (first.range.unwrap_or_default()[0], last.range.unwrap_or_default()[1]),
        _ => (0.0, 1.0),
    };
    let x = Scale::linear([low, high], [42.0, 330.0]);
    let y = Scale::linear([0.0, 1.0], [158.0, 12.0]);
    rate_axis(&mut svg, y, 42.0, 330.0);
    if let Some(CriticalThreshold::Crosses { at, low: l, high: h, .. }) = along.threshold.estimated() {
        let (from, to) = (x.at(l.unwrap_or(low).max(low)), x.at(h.unwrap_or(high).min(high)));
        svg.rect("tband", [from, 12.0, to - from, 146.0]);
        svg.line("tline", [x.at(*at), 12.0, x.at(*at), 158.0]);
    }
    for cell in &along.cells {
        let (Some([from, to]), Some(rate)) = (cell.range, cell.rate.rate) else { continue };
        let middle = x.at(0.5 * (from + to));
        let [l, h] = cell.rate.wilson_95;
        svg.line("whisker", [middle, y.at(l), middle, y.at(h)]);
        svg.line("level", [x.at(from) + 1.0, y.at(rate), x.at(to) - 1.0, y.at(rate)]);
        svg.dot("dot", [middle, y.at(rate)], 3.6, &told(cell));
    }
    for (i, cell) in along.cells.iter().enumerate() {
        let Some([from, to]) = cell.range else { continue };
        if i % 3 == 0 {
            let anchor = if i == 0 { Anchor::Start } else { Anchor::Middle };
            svg.text("s d", anchor, [x.at(from), 174.0], &significant(from, 2));
        }
        if i + 1 == along.cells.len() && i % 3 != 0 {
            svg.text("s d", Anchor::End, [x.at(to), 174.0], &significant(to, 2));
        }
    }
    svg.text("a", Anchor::Middle, [186.0, 193.0], &label_with_unit(&along.parameter));
    svg.finish(&format!("Success along {}", label_with_unit(&along.parameter)))
}

/// Most levels that are drawn.
const MOST_LEVELS: usize = 24;

fn levels(along: &Along) -> Markup {
    let cells = &along.cells[..along.cells.len().min(MOST_LEVELS)];
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
        svg.dot("dot", [x.at(rate), y], 3.6, &told(cell));
    }
    svg.text("a", Anchor::Middle, [213.0, bottom + 33.0], &label_with_unit(&along.parameter));
    svg.finish(&format!("Success along {}", label_with_unit(&along.parameter)))
}

fn told(cell: &Cell) -> String {
    let rate = cell.rate.rate.map_or_else(|| "-".to_owned(), percent);
    let zone = match cell.zone {
        Zone::TooThin => "too thin to name a zone",
        Zone::Undecided => "undecided between zones",
        zone => zone.word(),
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

/// Shares of the failure modes.
pub(crate) fn modes(modes: &FailureModes) -> Markup {
    let mut svg = Svg::new(520.0, 4.0 + 34.0 * modes.modes.len() as f64);
    let x = Scale::linear([0.0, 1.0], [92.0, 376.0]);
    for (i, share) in modes.modes.iter().enumerate() {
        let y = 6.0 + 34.0 * i as f64;
        svg.text("b", Anchor::End, [84.0, y + 17.0], &mode_label(&share.mode));
        svg.rect("track", [x.at(0.0), y + 4.0, x.at(1.0) - x.at(0.0), 17.0]);
        let Some(part) = share.share else { continue };
        svg.rect(&format!("m{i}"), [x.at(0.0), y + 4.0, x.at(part) - x.at(0.0), 17.0]);
        let [l, h] = share.interval_95;
        svg.line("whisker", [x.at(l), y + 12.5, x.at(h), y + 12.5]);
        svg.text("b", Anchor::Start, [384.0, y + 17.0], &percent(part));
        svg.text("s d", Anchor::End, [516.0, y + 17.0], &count(share.failures));
    }
    svg.finish("Failures by mode, with intervals that hold together")
}

/// How the modes change along a parameter.
pub(crate) fn mode_changes(parameter: &str, changes: &ModeChanges, modes: &FailureModes) -> Markup {
    let n = changes.bins.len().max(1);
    let mut svg = Svg::new(420.0, 232.0);
    let (left, right, top, bottom) = (42.0, 412.0, 34.0, 184.0);
    let w = (right - left) / n as f64;
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    let ends = (changes.bins.first().map_or(0.0, |b| b.range[0]), changes.bins.last().map_or(1.0, |b| b.range[1]));
    // What is next to nothing on this axis is nothing.
    let tick = |x: f64| if x.abs() < 0.005 * (ends.1 - ends.0) { "0".to_owned() } else { significant(x, 2) };
    let mut at = 0.0;
    for (i, of) in modes.modes.iter().enumerate() {
        svg.rect(&format!("m{i}"), [at, 8.0, 11.0, 11.0]);
        svg.text("s", Anchor::Start, [at + 16.0, 18.0], &mode_label(&of.mode));
        at += 28.0 + 6.6 * of.mode.len() as f64;
    }
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
            let word = modes.modes.get(m).map_or("", |m| m.mode.as_str());
            let told = format!(
                "{} to {}: {} of {all} {}",
                number(bin.range[0]),
                number(bin.range[1]),
                counted,
                mode_label(word)
            );
            svg.rect_told(&format!("m{m}"), [x + 1.0, y.at(to) + 0.5, w - 2.0, y.at(from) - y.at(to) - 1.0], &told);
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
        if bin.sure {
            svg.dot("sure", [x + 0.5 * w, bottom + 26.0], 2.6, "the dominant mode is sure");
        }
    }
    svg.text("a", Anchor::Middle, [0.5 * (left + right), bottom + 44.0], &label_with_unit(parameter));
    svg.finish(&format!("Failure modes along {}", label_with_unit(parameter)))
}

/// The surest danger zones with their intervals.
pub(crate) fn danger(zones: &DangerZones, most: usize) -> Markup {
    let shown = &zones.zones[..zones.zones.len().min(most)];
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
        let label = cut(&format!("{} {}", robogate_analysis::labels::parameter_label(&zone.parameter), zone.cell), 27);
        svg.text(if zone.sure { "s" } else { "s d" }, Anchor::End, [182.0, y + 4.0], &label);
        let [l, h] = zone.rate.wilson_95;
        svg.line("whisker", [x.at(l), y, x.at(h), y]);
        let rate = zone.rate.rate.unwrap_or_default();
        let class = if zone.sure { format!("zdot r{}", step(rate)) } else { "zdot hollow".to_owned() };
        svg.dot(
            &class,
            [x.at(rate), y],
            4.4,
            &format!("{label}: {} ({})", percent(rate), percent_range(zone.rate.wilson_95)),
        );
    }
    svg.finish("Bins and levels below 40 % success: rates, with intervals")
}

/// Coefficients with their intervals.
pub(crate) fn coefficients(regression: &Regression) -> Markup {
    let shown: Vec<_> = regression
        .terms
        .iter()
        .filter(|t| t.term != "intercept")
        .filter_map(|t| Some((t.term.as_str(), t.found.estimated()?)))
        .take(24)
        .collect();
    let far =
        shown.iter().flat_map(|(_, e)| e.interval_95).filter(|v| v.is_finite()).fold(0.1_f64, |m, v| m.max(v.abs()));
    let bottom = 8.0 + 24.0 * shown.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 42.0);
    let x = Scale::linear([-far, far], [160.0, 506.0]);
    svg.line("axis", [x.at(0.0), 4.0, x.at(0.0), bottom]);
    for (at, anchor) in [(-far, Anchor::Start), (0.0, Anchor::Middle), (far, Anchor::End)] {
        svg.text("s d", anchor, [x.at(at), bottom + 16.0], &number(at));
    }
    for (i, (term, estimate)) in shown.iter().enumerate() {
        let y = 20.0 + 24.0 * i as f64;
        svg.text("s", Anchor::End, [152.0, y + 4.0], &cut(term, 25));
        let [l, h] = estimate.interval_95;
        svg.line("whisker", [x.at(l.max(-far)), y, x.at(h.min(far)), y]);
        svg.dot("dot", [x.at(estimate.coefficient), y], 4.0, &format!("{term}: {}", number(estimate.coefficient)));
    }
    let [less, more] =
        [format!("\u{2190} less {}", regression.outcome), format!("more {} \u{2192}", regression.outcome)];
    svg.text("a", Anchor::Start, [x.at(-far), bottom + 34.0], &less);
    svg.text("a", Anchor::End, [x.at(far), bottom + 34.0], &more);
    svg.finish(&format!("Coefficients on the log-odds of {}", regression.outcome))
}

const SQUARE: f64 = 340.0;

fn square(svg: &mut Svg, across: &str, up: &str) -> (Scale, Scale) {
    let x = Scale::linear([0.0, 1.0], [46.0, 328.0]);
    let y = Scale::linear([0.0, 1.0], [294.0, 12.0]);
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        svg.line("gl", [x.at(tick), y.at(0.0), x.at(tick), y.at(1.0)]);
        svg.line("gl", [x.at(0.0), y.at(tick), x.at(1.0), y.at(tick)]);
        if (tick * 2.0).fract() <= 0.0 {
            svg.text("s d", Anchor::Middle, [x.at(tick), 310.0], &format!("{:.0} %", 100.0 * tick));
            svg.text("s d", Anchor::End, [40.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
        }
    }
    svg.line("axis dash", [x.at(0.0), y.at(0.0), x.at(1.0), y.at(1.0)]);
    svg.text("a", Anchor::Middle, [187.0, 331.0], across);
    svg.text_up("a", [9.0, 153.0], up);
    (x, y)
}

/// ROC curves.
pub(crate) fn roc(figures: &RocFigures) -> Markup {
    let mut svg = Svg::new(SQUARE, SQUARE);
    let (x, y) = square(&mut svg, "successes called failures", "failures found");
    for curve in &figures.curves {
        let points: Vec<[f64; 2]> = curve.points.iter().map(|[f, t]| [x.at(*f), y.at(*t)]).collect();
        let class = if curve.of == "cross_validated" { "curve2" } else { "curve2 second" };
        svg.polyline(class, &points);
    }
    svg.line("curve2", [196.0, 254.0, 216.0, 254.0]);
    let unseen = figures.auc_cross_validated.map_or_else(|| "-".to_owned(), |a| format!("{a:.3}"));
    svg.text("s", Anchor::Start, [222.0, 258.0], &format!("unseen {unseen}"));
    svg.line("curve2 second", [196.0, 274.0, 216.0, 274.0]);
    svg.text("s", Anchor::Start, [222.0, 278.0], &format!("in sample {:.3}", figures.auc_in_sample));
    svg.finish("ROC curves of the risk model")
}

/// Stated against observed failure rates.
pub(crate) fn reliability(figures: &CalibrationFigures) -> Markup {
    let mut svg = Svg::new(SQUARE, SQUARE);
    let (x, y) = square(&mut svg, "stated chance of failure", "observed failure rate");
    for bin in &figures.bins {
        let [l, h] = bin.interval_95;
        svg.line("whisker", [x.at(bin.stated), y.at(l), x.at(bin.stated), y.at(h)]);
        let told = format!(
            "stated {}, observed {} ({}) in {} episodes",
            percent(bin.stated),
            percent(bin.observed),
            percent_range(bin.interval_95),
            count(bin.rows)
        );
        svg.dot("dot", [x.at(bin.stated), y.at(bin.observed)], 4.0, &told);
    }
    svg.finish("Reliability of the risk model")
}
