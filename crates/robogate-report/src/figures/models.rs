//! Coefficients, ROC curves and calibration of a model.

use maud::Markup;
use robogate_analysis::{CalibrationFigures, Regression, RocFigures};
use robogate_stats::format::{count, number, percent, percent_range};

use super::svg::{Anchor, Scale, Svg, cut};

/// Draws coefficients with their intervals.
pub(crate) fn coefficients(regression: &Regression) -> Markup {
    let shown: Vec<_> = regression
        .terms
        .iter()
        .filter(|t| t.term != "intercept")
        .filter_map(|t| Some((t.term.as_str(), t.estimate.estimated()?)))
        .take(24)
        .collect();
    let extent =
        shown.iter().flat_map(|(_, e)| e.interval_95).filter(|v| v.is_finite()).fold(0.1_f64, |m, v| m.max(v.abs()));
    let bottom = 8.0 + 24.0 * shown.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 42.0);
    let x = Scale::linear([-extent, extent], [160.0, 506.0]);
    svg.line("axis", [x.at(0.0), 4.0, x.at(0.0), bottom]);
    for (at, anchor) in [(-extent, Anchor::Start), (0.0, Anchor::Middle), (extent, Anchor::End)] {
        svg.text("s d", anchor, [x.at(at), bottom + 16.0], &number(at));
    }
    for (i, (term, estimate)) in shown.iter().enumerate() {
        let y = 20.0 + 24.0 * i as f64;
        svg.text("s", Anchor::End, [152.0, y + 4.0], &cut(term, 25));
        let [l, h] = estimate.interval_95;
        svg.line("whisker", [x.at(l.max(-extent)), y, x.at(h.min(extent)), y]);
        svg.dot("dot", [x.at(estimate.coefficient), y], 4.0, &format!("{term}: {}", number(estimate.coefficient)));
    }
    let [less, more] =
        [format!("\u{2190} less {}", regression.outcome), format!("more {} \u{2192}", regression.outcome)];
    svg.text("a", Anchor::Start, [x.at(-extent), bottom + 34.0], &less);
    svg.text("a", Anchor::End, [x.at(extent), bottom + 34.0], &more);
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

/// Draws ROC curves of failure detection.
pub(crate) fn roc(figures: &RocFigures) -> Markup {
    let mut svg = Svg::new(SQUARE, SQUARE);
    let (x, y) = square(&mut svg, "false positive rate", "true positive rate");
    for curve in &figures.curves {
        let points: Vec<[f64; 2]> = curve.points.iter().map(|[f, t]| [x.at(*f), y.at(*t)]).collect();
        let class = if curve.rows == "cross_validated" { "curve2" } else { "curve2 second" };
        svg.polyline(class, &points);
    }
    svg.line("curve2", [160.0, 254.0, 180.0, 254.0]);
    let cross_validated = figures.auc_cross_validated.map_or_else(|| "-".to_owned(), |a| format!("{a:.3}"));
    svg.text("s", Anchor::Start, [186.0, 258.0], &format!("cross-validated {cross_validated}"));
    svg.line("curve2 second", [160.0, 274.0, 180.0, 274.0]);
    svg.text("s", Anchor::Start, [186.0, 278.0], &format!("in sample {:.3}", figures.auc_in_sample));
    svg.finish("ROC curves of the risk model")
}

/// Draws observed failure rates by predicted probability.
pub(crate) fn reliability(figures: &CalibrationFigures) -> Markup {
    let mut svg = Svg::new(SQUARE, SQUARE);
    let (x, y) = square(&mut svg, "predicted probability of failure", "observed failure rate");
    for bin in &figures.bins {
        let [l, h] = bin.interval_95;
        svg.line("whisker", [x.at(bin.predicted), y.at(l), x.at(bin.predicted), y.at(h)]);
        let hint = format!(
            "predicted {}, observed {} ({}) in {} episodes",
            percent(bin.predicted),
            percent(bin.observed),
            percent_range(bin.interval_95),
            count(bin.rows)
        );
        svg.dot("dot", [x.at(bin.predicted), y.at(bin.observed)], 4.0, &hint);
    }
    svg.finish("Reliability of the risk model")
}
