//! Map of the scenarios whose outcomes differ between two datasets.

use maud::Markup;
use robogate_analysis::labels::label_with_unit;
use robogate_analysis::{Axis, DisagreementMap};
use robogate_stats::format::{count, percent, percent_range, points};

use crate::figures::svg::{Anchor, Scale, Svg, cut, round_ticks, tick};

/// Draws where the outcomes of two datasets differ.
pub(crate) fn disagreement(map: &DisagreementMap, names: [&str; 2]) -> Markup {
    const LEFT: f64 = 62.0;
    let (nx, ny) = (map.x.cells().max(1), map.y.cells().max(1));
    let w = (520.0 - LEFT - 14.0) / nx as f64;
    let h = (400.0 / ny as f64).clamp(24.0, 56.0);
    let bottom = 8.0 + h * ny as f64;
    let mut svg = Svg::new(520.0, bottom + 92.0);
    for (i, cell) in map.cells.iter().enumerate() {
        let (row, column) = (i / nx, i % nx);
        let place = [LEFT + w * column as f64 + 0.75, bottom - h * (row + 1) as f64 + 0.75, w - 1.5, h - 1.5];
        let middle = [place[0] + 0.5 * place[2], place[1] + 0.5 * place[3]];
        let Some(share) = cell.differ.rate else {
            svg.rect_with_hint("none", place, "no valid pair");
            svg.text("s d", Anchor::Middle, [middle[0], middle[1] + 4.0], "\u{2013}");
            continue;
        };
        let difference = (cell.first_only as f64 - cell.second_only as f64) / cell.differ.n.max(1) as f64;
        let hint = format!(
            "{} {}, {} {}: {} of {} differ, {} ({}); only {} in {}, only {} in {}, difference {} points",
            label_with_unit(&map.y.parameter),
            map.y.cell_label(row),
            label_with_unit(&map.x.parameter),
            map.x.cell_label(column),
            cell.differ.successes,
            cell.differ.n,
            percent(share),
            percent_range(cell.differ.wilson_95),
            names[0],
            cell.first_only,
            names[1],
            cell.second_only,
            points(difference)
        );
        let step = shade(difference);
        svg.rect_with_hint(&format!("r{step}"), place, &hint);
        if cell.holm_p <= 0.05 {
            let [x, y] = [place[0] + place[2], place[1]];
            svg.polygon("known", &[[x - 8.0, y], [x, y], [x, y + 8.0]]);
        }
        if w >= 26.0 && h >= 30.0 {
            svg.text(
                &format!("v t{step}"),
                Anchor::Middle,
                [middle[0], middle[1] + 1.0],
                &format!("{:.0}", 100.0 * share),
            );
            svg.text(&format!("n t{step}"), Anchor::Middle, [middle[0], middle[1] + 13.0], &count(cell.differ.n));
        } else if w >= 20.0 {
            svg.text(
                &format!("n t{step}"),
                Anchor::Middle,
                [middle[0], middle[1] + 4.0],
                &format!("{:.0}", 100.0 * share),
            );
        }
    }
    axes(&mut svg, map, [LEFT, w, h, bottom]);
    let y = bottom + 50.0;
    let from = LEFT;
    for step in 0..11 {
        svg.rect(&format!("r{step}"), [from + 15.0 * step as f64, y, 15.0, 12.0]);
    }
    let ends = format!("only {} succeeds \u{2026} only {}", cut(names[1], 18), cut(names[0], 18));
    svg.text("s", Anchor::Start, [from + 173.0, y + 10.0], &ends);
    svg.rect("r5", [LEFT, y + 21.0, 22.0, 12.0]);
    svg.polygon("known", &[[LEFT + 14.0, y + 21.0], [LEFT + 22.0, y + 21.0], [LEFT + 22.0, y + 29.0]]);
    svg.text(
        "s",
        Anchor::Start,
        [LEFT + 29.0, y + 31.0],
        "the direction is significant (McNemar, Holm over the cells)",
    );
    svg.finish(&format!("Where the outcomes of {} and {} differ", names[0], names[1]))
}

/// The colour of a difference. Neutral if neither dataset is ahead.
fn shade(difference: f64) -> usize {
    (5.0 + 5.0 * difference.clamp(-1.0, 1.0)).round() as usize
}

fn axes(svg: &mut Svg, map: &DisagreementMap, [left, w, h, bottom]: [f64; 4]) {
    let ticks = |axis: &Axis| -> Vec<(f64, String)> {
        if let (true, [low, .., high]) = (axis.levels.is_empty(), axis.edges.as_slice()) {
            let (from, to) = ([*low, *high], [0.0, axis.cells() as f64]);
            let place = if axis.log { Scale::log(from, to) } else { Scale::linear(from, to) };
            round_ticks(from, 6, axis.log).into_iter().map(|at| (place.at(at), tick(at))).collect()
        } else {
            axis.levels.iter().enumerate().map(|(i, level)| (i as f64 + 0.5, cut(level, 8))).collect()
        }
    };
    let every = |room: f64, wanted: f64| (wanted / room).ceil().max(1.0) as usize;
    for (i, (at, text)) in ticks(&map.x).into_iter().enumerate().step_by(every(w, 34.0)) {
        let class = if i % 2 == 1 { "s odd" } else { "s" };
        svg.text(class, Anchor::Middle, [left + w * at, bottom + 15.0], &text);
    }
    for (at, text) in ticks(&map.y).into_iter().step_by(every(h, 18.0)) {
        svg.text("s", Anchor::End, [left - 7.0, bottom - h * at + 4.0], &text);
    }
    svg.text("a", Anchor::Middle, [0.5 * (left + 506.0), bottom + 33.0], &label_with_unit(&map.x.parameter));
    svg.text_up("a", [11.0, 0.5 * (8.0 + bottom)], &label_with_unit(&map.y.parameter));
}
