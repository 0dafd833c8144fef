//! Figures that set dictionaries side by side.

use maud::Markup;

use crate::page::svg::{Anchor, Scale, Svg, cut};
use robogate_analysis::labels::{label_with_unit, mode_label, parameter_label};
use robogate_analysis::{ComparedDictionary, Rate};
use robogate_analysis::{DisagreementMap, ReachRow, Sensitivity, SharedCurve, UniversalZones};
use robogate_stats::format::{count, number, percent, percent_range, points, points_range, significant};

/// Series that have a colour of their own; the next ones begin anew with a hollow dot.
const COLOURS: usize = 6;

/// One row of a forest: a name, an estimate with its interval, and whether it is sure.
pub(crate) struct Row {
    pub(crate) label: String,
    pub(crate) estimate: f64,
    pub(crate) interval: [f64; 2],
    pub(crate) sure: bool,
    /// Its colour; none where it belongs to no dictionary.
    pub(crate) series: Option<usize>,
}

fn class(series: usize) -> String {
    let hollow = if series >= COLOURS { " hollow" } else { "" };
    format!("k{}{hollow}", series % COLOURS)
}

fn dot(svg: &mut Svg, series: usize, at: [f64; 2], r: f64, told: &str) {
    svg.dot(&format!("kdot {}", class(series)), at, r, told);
}

/// Names and colours in one line or more; returns the height that it takes.
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

/// How much room a legend takes.
fn legend_height(names: &[String], [left, right]: [f64; 2]) -> f64 {
    legend(&mut Svg::new(1.0, 1.0), names, [left, right], 0.0)
}

/// Success rates with their intervals.
pub(crate) fn rates(dictionaries: &[ComparedDictionary], names: &[String]) -> Markup {
    let mut svg = Svg::new(440.0, 30.0 + 34.0 * dictionaries.len() as f64);
    let x = Scale::linear([0.0, 1.0], [6.0, 424.0]);
    let bottom = 34.0 * dictionaries.len() as f64 + 6.0;
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        svg.line("gl", [x.at(tick), 4.0, x.at(tick), bottom]);
        svg.text(
            "s d",
            if tick > 0.0 { Anchor::Middle } else { Anchor::Start },
            [x.at(tick), bottom + 16.0],
            &format!("{:.0} %", 100.0 * tick),
        );
    }
    for (i, dictionary) in dictionaries.iter().enumerate() {
        let y = 34.0 * i as f64;
        let rate = &dictionary.success.rate;
        let told = rate.rate.map_or_else(
            || "no valid episode".to_owned(),
            |r| format!("{} ({})", percent(r), percent_range(rate.wilson_95)),
        );
        let label =
            format!("{}  {}", cut(&dictionary.name, 26), rate.rate.map_or_else(|| "\u{2013}".to_owned(), percent));
        svg.text("halo-text b", Anchor::Start, [8.0, y + 14.0], &label);
        let [low, high] = rate.wilson_95.map(|end| x.at(end));
        svg.line("whisker", [low, y + 26.0, high, y + 26.0]);
        if let Some(rate) = rate.rate {
            match names.iter().position(|name| *name == dictionary.name) {
                Some(series) => dot(&mut svg, series, [x.at(rate), y + 26.0], 5.0, &told),
                None => svg.dot("zdot hollow", [x.at(rate), y + 26.0], 5.0, &told),
            }
        }
    }
    svg.finish("Success rates with 95 % intervals")
}

/// Differences or slopes with their intervals about zero.
pub(crate) fn forest(rows: &[Row], unit: &str, ends: [&str; 2], label: &str) -> Markup {
    let far = rows.iter().flat_map(|row| row.interval).chain(rows.iter().map(|row| row.estimate));
    let far = far.filter(|v| v.is_finite()).fold(0.05_f64, |far, v| far.max(v.abs()));
    let bottom = 8.0 + 26.0 * rows.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 44.0);
    let x = Scale::linear([-far, far], [190.0, 506.0]);
    svg.line("axis", [x.at(0.0), 4.0, x.at(0.0), bottom]);
    for (at, anchor) in [(-far, Anchor::Start), (0.0, Anchor::Middle), (far, Anchor::End)] {
        svg.text("s d", anchor, [x.at(at), bottom + 16.0], &format!("{}{unit}", significant(at, 2)));
    }
    for (i, row) in rows.iter().enumerate() {
        let y = 21.0 + 26.0 * i as f64;
        svg.text(if row.sure { "s" } else { "s d" }, Anchor::End, [182.0, y + 4.0], &cut(&row.label, 30));
        let [low, high] = row.interval.map(|end| x.at(end.clamp(-far, far)));
        svg.line("whisker", [low, y, high, y]);
        let told = format!(
            "{}: {}{unit} ({} to {})",
            row.label,
            number(row.estimate),
            number(row.interval[0]),
            number(row.interval[1])
        );
        match row.series {
            Some(series) => dot(&mut svg, series, [x.at(row.estimate), y], 4.6, &told),
            None if row.sure => svg.dot("sure", [x.at(row.estimate), y], 4.4, &told),
            None => svg.dot("zdot hollow", [x.at(row.estimate), y], 4.4, &told),
        }
    }
    svg.text("a", Anchor::Start, [x.at(-far), bottom + 35.0], ends[0]);
    svg.text("a", Anchor::End, [x.at(far), bottom + 35.0], ends[1]);
    svg.finish(label)
}

/// Failure modes, one bar for each dictionary.
pub(crate) fn modes(dictionaries: &[&ComparedDictionary]) -> Markup {
    let words: Vec<&str> =
        dictionaries.first().map_or_else(Vec::new, |d| d.failure_modes.modes.iter().map(|m| m.mode.as_str()).collect());
    let bottom = 30.0 + 32.0 * dictionaries.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 22.0);
    let mut at = 0.0;
    for (i, word) in words.iter().enumerate() {
        svg.rect(&format!("m{i}"), [at, 4.0, 11.0, 11.0]);
        svg.text("s", Anchor::Start, [at + 16.0, 14.0], &mode_label(word));
        at += 30.0 + 6.6 * word.len() as f64;
    }
    let x = Scale::linear([0.0, 1.0], [150.0, 440.0]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [x.at(tick), 26.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    for (row, dictionary) in dictionaries.iter().enumerate() {
        let y = 32.0 + 32.0 * row as f64;
        let modes = &dictionary.failure_modes;
        svg.text("s", Anchor::End, [142.0, y + 13.0], &cut(&dictionary.name, 22));
        svg.rect("track", [x.at(0.0), y, x.at(1.0) - x.at(0.0), 18.0]);
        let mut from = 0.0;
        for (i, share) in modes.modes.iter().enumerate() {
            let Some(part) = share.share.filter(|part| *part > 0.0) else { continue };
            let told = format!(
                "{}: {} {} ({})",
                dictionary.name,
                mode_label(&share.mode),
                percent(part),
                percent_range(share.interval_95)
            );
            svg.rect_told(&format!("m{i}"), [x.at(from), y, x.at(from + part) - x.at(from) - 0.8, 18.0], &told);
            from += part;
        }
        svg.text("s d", Anchor::Start, [448.0, y + 13.0], &format!("n = {}", count(modes.failures)));
    }
    svg.finish("Failure modes of each dictionary")
}

/// Most letters of a level under a curve.
const MOST_LETTERS: usize = 14;

/// Success along one parameter, every dictionary in the same bins.
pub(crate) fn curve(curve: &SharedCurve, names: &[String]) -> Markup {
    let (left, right) = (42.0, 412.0);
    let top = legend_height(names, [left, right]) + 6.0;
    let bottom = top + 150.0;
    // Words that are too long for their place stand upright.
    let levels = curve.cells.iter().filter(|cell| cell.range.is_none());
    let longest = levels.map(|cell| cell.label.chars().count().min(MOST_LETTERS)).max().unwrap_or(0) as f64;
    let upright = 6.4 * longest > (right - left) / curve.cells.len().max(1) as f64;
    let drop = if upright { 6.6 * longest - 8.0 } else { 0.0 };
    let mut svg = Svg::new(420.0, bottom + drop + 40.0);
    legend(&mut svg, names, [left, right], 0.0);
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [left, y.at(tick), right, y.at(tick)]);
        svg.text("s d", Anchor::End, [left - 6.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
    }
    let n = curve.cells.len().max(1);
    let room = (right - left) / n as f64;
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
            let told = format!(
                "{name}, {}: {} of {}, {} ({})",
                cell.label,
                of.successes,
                of.n,
                percent(rate),
                percent_range(of.wilson_95)
            );
            dot(&mut svg, series, [at, y.at(rate)], 3.4, &told);
        }
    }
    for (i, cell) in curve.cells.iter().enumerate() {
        match cell.range {
            Some([low, high]) => {
                let every = (44.0 / room).ceil().max(1.0) as usize;
                if i % every == 0 && (i + every <= n || n <= every) {
                    svg.text(
                        "s d",
                        if i == 0 { Anchor::Start } else { Anchor::Middle },
                        [left + room * i as f64, bottom + 16.0],
                        &significant(low, 2),
                    );
                }
                if i + 1 == n {
                    svg.text("s d", Anchor::End, [right, bottom + 16.0], &significant(high, 2));
                }
            }
            None => {
                let x = left + room * (i as f64 + 0.5);
                let every = (12.0 / room).ceil().max(1.0) as usize;
                if drop > 0.0 && i % every == 0 {
                    svg.text_up_to("s d", [x + 4.0, bottom + 7.0], &cut(&cell.label, MOST_LETTERS));
                } else if drop <= 0.0 {
                    svg.text("s d", Anchor::Middle, [x, bottom + 16.0], &cell.label);
                }
            }
        }
    }
    svg.text("a", Anchor::Middle, [0.5 * (left + right), bottom + drop + 35.0], &label_with_unit(&curve.parameter));
    svg.finish(&format!("Success along {}", label_with_unit(&curve.parameter)))
}

/// The surest zones in which all of them fail.
pub(crate) fn universal(zones: &UniversalZones, names: &[String], most: usize) -> Markup {
    let shown = &zones.zones[..zones.zones.len().min(most)];
    let (left, right) = (214.0, 500.0);
    let top = legend_height(names, [0.0, right]) + 6.0;
    let step = (8.0 * names.len() as f64 + 8.0).max(22.0);
    let bottom = top + step * shown.len() as f64;
    let mut svg = Svg::new(520.0, bottom + 26.0);
    legend(&mut svg, names, [0.0, right], 0.0);
    let x = Scale::linear([0.0, 1.0], [left, right]);
    for tick in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
        if (tick - zones.limit).abs() < 0.09 {
            continue;
        }
        svg.line("gl", [x.at(tick), top - 4.0, x.at(tick), bottom]);
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &format!("{:.0} %", 100.0 * tick));
    }
    svg.line("tline", [x.at(zones.limit), top - 4.0, x.at(zones.limit), bottom]);
    svg.text("s", Anchor::Middle, [x.at(zones.limit), bottom + 16.0], &format!("{:.0} %", 100.0 * zones.limit));
    for (i, zone) in shown.iter().enumerate() {
        let middle = top + step * (i as f64 + 0.5);
        let said = zone.describe();
        svg.text(if zone.sure { "s" } else { "s d" }, Anchor::End, [left - 10.0, middle + 4.0], &cut(&said, 27));
        for (series, (rate, name)) in zone.rates.iter().zip(names).enumerate() {
            let y = middle + 8.0 * (series as f64 - 0.5 * (names.len() as f64 - 1.0));
            let [low, high] = rate.wilson_95.map(|end| x.at(end));
            svg.line(&format!("kwhisker {}", class(series)), [low, y, high, y]);
            let told = format!(
                "{name}, {said}: {} ({})",
                rate.rate.map_or_else(|| "-".to_owned(), percent),
                percent_range(rate.wilson_95)
            );
            dot(&mut svg, series, [x.at(rate.rate.unwrap_or_default()), y], 3.4, &told);
        }
    }
    svg.finish("Cells in which every dictionary was observed below the limit")
}

/// Workspace over reach against success.
pub(crate) fn reach(rows: &[ReachRow], names: &[String]) -> Markup {
    let known: Vec<(&ReachRow, f64)> = rows.iter().filter_map(|row| Some((row, row.ratio?))).collect();
    let far = known.iter().map(|(_, ratio)| *ratio).fold(1.0_f64, f64::max) * 1.1;
    let top = legend_height(names, [46.0, 512.0]) + 8.0;
    let bottom = top + 200.0;
    let mut svg = Svg::new(520.0, bottom + 42.0);
    legend(&mut svg, names, [46.0, 512.0], 0.0);
    let x = Scale::linear([0.0, far], [46.0, 506.0]);
    let y = Scale::linear([0.0, 1.0], [bottom, top]);
    for tick in [0.0, 0.5, 1.0] {
        svg.line("gl", [46.0, y.at(tick), 506.0, y.at(tick)]);
        svg.text("s d", Anchor::End, [40.0, y.at(tick) + 4.0], &format!("{:.0} %", 100.0 * tick));
    }
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        svg.text("s d", Anchor::Middle, [x.at(tick), bottom + 16.0], &number(tick));
    }
    svg.line("axis dash", [x.at(1.0), top, x.at(1.0), bottom]);
    for (row, ratio) in known {
        let series = names.iter().position(|name| *name == row.name).unwrap_or_default();
        let [low, high] = row.rate.wilson_95.map(|end| y.at(end));
        svg.line(&format!("kwhisker {}", class(series)), [x.at(ratio), low, x.at(ratio), high]);
        let rate = row.rate.rate.unwrap_or_default();
        dot(
            &mut svg,
            series,
            [x.at(ratio), y.at(rate)],
            5.0,
            &format!("{}: ratio {}, {}", row.name, number(ratio), percent(rate)),
        );
    }
    svg.text("a", Anchor::Middle, [276.0, bottom + 36.0], "distance of the workspace over reach");
    svg.finish("Workspace over reach against success rate")
}

/// Slopes of the log-odds over the logarithm of a parameter.
pub(crate) fn sensitivity(sensitivity: &Sensitivity) -> Markup {
    let rows: Vec<Row> = sensitivity
        .effects
        .iter()
        .enumerate()
        .filter_map(|(series, effect)| {
            let slope = effect.slope.estimated()?;
            let [low, high] = slope.interval_95;
            let ends = [low.unwrap_or(f64::NEG_INFINITY), high.unwrap_or(f64::INFINITY)];
            let sure = ends[0] > 0.0 || ends[1] < 0.0;
            Some(Row {
                label: effect.name.clone(),
                estimate: slope.per_log_unit,
                interval: ends,
                sure,
                series: Some(series),
            })
        })
        .collect();
    let label = parameter_label(&sensitivity.parameter);
    let ends = [format!("\u{2190} {label} hurts"), format!("{label} helps \u{2192}")];
    forest(
        &rows,
        "",
        ends.each_ref().map(String::as_str),
        &format!("Slope of the log-odds of success over ln({label})"),
    )
}

/// Where two dictionaries end differently.
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
        let Some(share) = cell.disagree.rate else {
            svg.rect_told("none", place, "no pair with evidence from both");
            svg.text("s d", Anchor::Middle, [middle[0], middle[1] + 4.0], "\u{2013}");
            continue;
        };
        let gap = (cell.first_only as f64 - cell.second_only as f64) / cell.disagree.n.max(1) as f64;
        let told = format!(
            "{} {}, {} {}: {} of {} differ, {} ({}); only {} in {}, only {} in {}, gap {} points",
            label_with_unit(&map.y.parameter),
            map.y.cell_label(row),
            label_with_unit(&map.x.parameter),
            map.x.cell_label(column),
            cell.disagree.successes,
            cell.disagree.n,
            percent(share),
            percent_range(cell.disagree.wilson_95),
            names[0],
            cell.first_only,
            names[1],
            cell.second_only,
            points(gap)
        );
        let step = shade(gap);
        svg.rect_told(&format!("r{step}"), place, &told);
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
            svg.text(&format!("n t{step}"), Anchor::Middle, [middle[0], middle[1] + 13.0], &count(cell.disagree.n));
        } else if w >= 20.0 {
            svg.text(
                &format!("n t{step}"),
                Anchor::Middle,
                [middle[0], middle[1] + 4.0],
                &format!("{:.0}", 100.0 * share),
            );
        }
    }
    sides(&mut svg, map, [LEFT, w, h, bottom]);
    let y = bottom + 50.0;
    let from = LEFT;
    for step in 0..11 {
        svg.rect(&format!("r{step}"), [from + 15.0 * step as f64, y, 15.0, 12.0]);
    }
    let ends = format!("only {} succeeds \u{2026} only {}", cut(names[1], 18), cut(names[0], 18));
    svg.text("s", Anchor::Start, [from + 173.0, y + 10.0], &ends);
    svg.rect("r5", [LEFT, y + 21.0, 22.0, 12.0]);
    svg.polygon("known", &[[LEFT + 14.0, y + 21.0], [LEFT + 22.0, y + 21.0], [LEFT + 22.0, y + 29.0]]);
    svg.text("s", Anchor::Start, [LEFT + 29.0, y + 31.0], "the direction is sure (McNemar, Holm over the cells)");
    svg.finish(&format!("Where {} and {} end differently", names[0], names[1]))
}

/// The colour of a gap: the neutral one where neither is ahead.
fn shade(gap: f64) -> usize {
    (5.0 + 5.0 * gap.clamp(-1.0, 1.0)).round() as usize
}

fn sides(svg: &mut Svg, map: &DisagreementMap, [left, w, h, bottom]: [f64; 4]) {
    let ticks = |axis: &robogate_analysis::Axis| -> Vec<(f64, String)> {
        if axis.levels.is_empty() {
            axis.edges.iter().enumerate().map(|(i, edge)| (i as f64, significant(*edge, 2))).collect()
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

/// The interval of a paired gap as a caption.
pub(crate) fn gap(interval: [f64; 2]) -> String {
    format!("{} points", points_range(interval))
}
