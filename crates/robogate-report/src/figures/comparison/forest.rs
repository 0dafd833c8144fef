//! Forest plots: estimates with their intervals around zero.

use maud::Markup;
use robogate_analysis::Sensitivity;
use robogate_analysis::labels::parameter_label;
use robogate_stats::format::{number, significant};

use super::dot;
use crate::figures::svg::{Anchor, Scale, Svg, cut};

/// One row of a forest plot.
pub(crate) struct ForestRow {
    pub(crate) label: String,
    pub(crate) estimate: f64,
    pub(crate) interval: [f64; 2],
    /// Whether the estimate differs significantly from zero.
    pub(crate) significant: bool,
    /// The dataset that determines the colour, if the row belongs to one.
    pub(crate) series: Option<usize>,
}

/// Draws a forest plot of differences or slopes.
pub(crate) fn forest(rows: &[ForestRow], unit: &str, ends: [&str; 2], label: &str) -> Markup {
    let extent = rows.iter().flat_map(|row| row.interval).chain(rows.iter().map(|row| row.estimate));
    let extent = extent.filter(|v| v.is_finite()).fold(0.05_f64, |extent, v| extent.max(v.abs()));
    let bottom = 8.0 + 26.0 * rows.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 44.0);
    let x = Scale::linear([-extent, extent], [190.0, 506.0]);
    svg.line("axis", [x.at(0.0), 4.0, x.at(0.0), bottom]);
    for (at, anchor) in [(-extent, Anchor::Start), (0.0, Anchor::Middle), (extent, Anchor::End)] {
        svg.text("s d", anchor, [x.at(at), bottom + 16.0], &format!("{}{unit}", significant(at, 2)));
    }
    for (i, row) in rows.iter().enumerate() {
        let y = 21.0 + 26.0 * i as f64;
        svg.text(if row.significant { "s" } else { "s d" }, Anchor::End, [182.0, y + 4.0], &cut(&row.label, 30));
        let [low, high] = row.interval.map(|end| x.at(end.clamp(-extent, extent)));
        svg.line("whisker", [low, y, high, y]);
        let hint = format!(
            "{}: {}{unit} ({} to {})",
            row.label,
            number(row.estimate),
            number(row.interval[0]),
            number(row.interval[1])
        );
        match row.series {
            Some(series) => dot(&mut svg, series, [x.at(row.estimate), y], 4.6, &hint),
            None if row.significant => svg.dot("significant", [x.at(row.estimate), y], 4.4, &hint),
            None => svg.dot("zdot hollow", [x.at(row.estimate), y], 4.4, &hint),
        }
    }
    svg.text("a", Anchor::Start, [x.at(-extent), bottom + 35.0], ends[0]);
    svg.text("a", Anchor::End, [x.at(extent), bottom + 35.0], ends[1]);
    svg.finish(label)
}

/// Draws slopes of the log-odds over the logarithm of a parameter.
pub(crate) fn sensitivity(sensitivity: &Sensitivity) -> Markup {
    let rows: Vec<ForestRow> = sensitivity
        .effects
        .iter()
        .enumerate()
        .filter_map(|(series, effect)| {
            let slope = effect.slope.estimated()?;
            let [low, high] = slope.interval_95;
            let ends = [low.unwrap_or(f64::NEG_INFINITY), high.unwrap_or(f64::INFINITY)];
            Some(ForestRow {
                label: effect.name.clone(),
                estimate: slope.per_log_unit,
                interval: ends,
                significant: ends[0] > 0.0 || ends[1] < 0.0,
                series: Some(series),
            })
        })
        .collect();
    let label = parameter_label(&sensitivity.parameter);
    let ends = [format!("\u{2190} {label} lowers success"), format!("{label} raises success \u{2192}")];
    forest(
        &rows,
        "",
        ends.each_ref().map(String::as_str),
        &format!("Slope of the log-odds of success over ln({label})"),
    )
}
