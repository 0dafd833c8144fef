//! The operating envelope: observed rates per cell, and the frontier.

use maud::Markup;

use super::svg::{Anchor, Scale, Svg, cut, round_ticks, tick};
use robogate_analysis::labels::label_with_unit;
use robogate_analysis::transfer::CorrectedMap;
use robogate_analysis::{Axis, Frontier, FrontierPoint, PairMap};
use robogate_stats::format::{count, percent, percent_range};

const WIDTH: f64 = 520.0;
const LEFT: f64 = 62.0;
const TOP: f64 = 8.0;
const RIGHT: f64 = 14.0;

/// Number of steps of the colour scale.
pub(crate) const STEPS: usize = 11;

/// The step of the colour scale for a rate.
pub(crate) fn step(rate: f64) -> usize {
    ((rate * STEPS as f64) as usize).min(STEPS - 1)
}

/// The boundary between success and failure on a map.
#[derive(Clone, Copy)]
pub(crate) enum Boundary<'a> {
    None,
    /// The frontier in closed form.
    Frontier(&'a Frontier),
    /// The contour of the corrected model of a real robot, with its band.
    Corrected(&'a CorrectedMap),
}

impl Boundary<'_> {
    /// The same, or nothing if no part of it lies on the map.
    fn on(self, map: &PairMap) -> Self {
        let drawn = match self {
            Self::None => false,
            Self::Frontier(frontier) => {
                map.x.levels.is_empty() && map.y.levels.is_empty() && !drawable(frontier).is_empty()
            }
            Self::Corrected(of) => {
                of.contour.estimated().is_some_and(|curves| !curves.is_empty() || !of.band.is_empty())
            }
        };
        if drawn { self } else { Self::None }
    }

    /// The class of the curve and the text of the legend.
    fn legend(self) -> Option<(&'static str, String)> {
        match self {
            Self::None => None,
            Self::Frontier(frontier) if frontier.contradicted => {
                Some(("curve wrong", "50 % frontier of the model, contradicted by the observed rates".to_owned()))
            }
            Self::Frontier(_) => Some(("curve", "50 % frontier of the model, exact 95 % band".to_owned())),
            Self::Corrected(of) => {
                Some(("curve", format!("{:.0} % real success, 95 % band of the correction", 100.0 * of.target)))
            }
        }
    }
}

/// Draws the cells of a map with the boundary. `id` must be unique on the page.
pub(crate) fn heatmap(map: &PairMap, boundary: Boundary<'_>, id: &str) -> Markup {
    let boundary = boundary.on(map);
    let (nx, ny) = (map.x.cells().max(1), map.y.cells().max(1));
    let w = (WIDTH - LEFT - RIGHT) / nx as f64;
    let h = (330.0 / ny as f64).clamp(22.0, 52.0);
    let bottom = TOP + h * ny as f64;
    let curve = boundary.legend().is_some();
    let drop = drop(&map.x, w);
    let mut svg = Svg::new(WIDTH, bottom + drop + if curve { 112.0 } else { 92.0 });
    let mut numbers = Vec::new();
    for (i, cell) in map.cells.iter().enumerate() {
        let (row, column) = (i / nx, i % nx);
        let place = [LEFT + w * column as f64 + 0.75, bottom - h * (row + 1) as f64 + 0.75, w - 1.5, h - 1.5];
        let middle = [place[0] + 0.5 * place[2], place[1] + 0.5 * place[3]];
        let Some(rate) = cell.model.map(|model| model.rate).or(cell.rate.rate) else {
            svg.rect_with_hint("none", place, "no episode");
            svg.text("s d", Anchor::Middle, [middle[0], middle[1] + 4.0], "\u{2013}");
            continue;
        };
        let classified = cell.zone.is_classified();
        let model = cell.model.map_or_else(String::new, |model| {
            format!("; model {} ({})", percent(model.rate), percent_range(model.interval_95))
        });
        let observed = match cell.rate.rate {
            Some(rate) => format!(
                "{} of {} succeeded, {} ({})",
                cell.rate.successes,
                cell.rate.n,
                percent(rate),
                percent_range(cell.rate.wilson_95)
            ),
            None => "nothing observed".to_owned(),
        };
        let hint = format!(
            "{} {}, {} {}: {observed}{model}; {}",
            label_with_unit(&map.y.parameter),
            map.y.cell_label(row),
            label_with_unit(&map.x.parameter),
            map.x.cell_label(column),
            cell.zone.as_str()
        );
        let step = step(rate);
        svg.rect_with_hint(&format!("r{step}"), place, &hint);
        if classified {
            mark(&mut svg, [place[0] + place[2], place[1]]);
        }
        // The numbers are above the frontier, each with a rim in the colour of its cell.
        let ink = format!("t{step} rim h{step}{}", if classified { "" } else { " light" });
        let success = format!("{:.0}", 100.0 * rate);
        if w >= 26.0 && h >= 30.0 {
            numbers.push((format!("v {ink}"), [middle[0], middle[1] + 1.0], success));
            numbers.push((format!("n {ink}"), [middle[0], middle[1] + 13.0], count(cell.rate.n)));
        } else if w >= 20.0 {
            numbers.push((format!("n {ink}"), [middle[0], middle[1] + 4.0], success));
        }
    }
    if curve {
        let across = scale(&map.x, [LEFT, WIDTH - RIGHT]);
        let up = scale(&map.y, [bottom, TOP]);
        svg.clipped(id, [LEFT, TOP, WIDTH - LEFT - RIGHT, bottom - TOP], |svg| match boundary {
            Boundary::None => {}
            Boundary::Frontier(frontier) => draw_frontier(svg, frontier, across, up),
            Boundary::Corrected(of) => draw_contour(svg, of, across, up),
        });
    }
    for (class, place, text) in &numbers {
        svg.text(class, Anchor::Middle, *place, text);
    }
    ticks(&mut svg, map, [w, h], bottom, drop);
    legend(&mut svg, bottom + drop + 56.0, boundary);
    svg.finish(&format!(
        "Success rate by {} and {}: {} cells",
        label_with_unit(&map.y.parameter),
        label_with_unit(&map.x.parameter),
        map.cells.len()
    ))
}

fn scale(axis: &Axis, to: [f64; 2]) -> Scale {
    let ends = [axis.edges.first().copied().unwrap_or(0.0), axis.edges.last().copied().unwrap_or(1.0)];
    if axis.log { Scale::log(ends, to) } else { Scale::linear(ends, to) }
}

/// The visible parts of the curve and its band: inside the observed ranges, where the exact interval is bounded. One
/// more point on each side extends them to the edge. They are split at the pole.
pub(crate) fn drawable(frontier: &Frontier) -> Vec<Vec<(&FrontierPoint, [f64; 2])>> {
    let curve = &frontier.curve;
    let near = |i: usize| (i.saturating_sub(1)..=(i + 1).min(curve.len() - 1)).any(|j| curve[j].observed);
    let mut pieces: Vec<Vec<(&FrontierPoint, [f64; 2])>> = vec![Vec::new()];
    for (i, point) in curve.iter().enumerate() {
        let beyond = |pole: f64| i > 0 && curve[i - 1].y < pole && pole <= point.y;
        if frontier.pole.is_some_and(beyond) {
            pieces.push(Vec::new());
        }
        match (point.exact_95.filter(|_| near(i)), pieces.last_mut()) {
            (Some(band), Some(piece)) => piece.push((point, band)),
            _ => pieces.push(Vec::new()),
        }
    }
    pieces.retain(|piece| piece.len() > 1);
    pieces
}

fn draw_frontier(svg: &mut Svg, frontier: &Frontier, across: Scale, up: Scale) {
    for piece in drawable(frontier) {
        let upper = piece.iter().map(|(p, band)| [across.at(p.y), up.at(band[1])]);
        let lower = piece.iter().rev().map(|(p, band)| [across.at(p.y), up.at(band[0])]);
        let curve: Vec<[f64; 2]> = piece.iter().map(|(p, _)| [across.at(p.y), up.at(p.x)]).collect();
        svg.polygon("band", &upper.chain(lower).collect::<Vec<_>>());
        svg.polyline("halo", &curve);
        svg.polyline(if frontier.contradicted { "curve wrong" } else { "curve" }, &curve);
    }
}

fn draw_contour(svg: &mut Svg, of: &CorrectedMap, across: Scale, up: Scale) {
    let drawn = |points: &Vec<[f64; 2]>| points.iter().map(|[x, y]| [across.at(*x), up.at(*y)]).collect::<Vec<_>>();
    svg.area("band", &of.band.iter().map(drawn).collect::<Vec<_>>());
    let curves: Vec<_> = of.contour.estimated().into_iter().flatten().map(drawn).collect();
    curves.iter().for_each(|curve| svg.polyline("halo", curve));
    curves.iter().for_each(|curve| svg.polyline("curve", curve));
}

/// Maximum number of characters of a level on the horizontal axis.
const MAX_LETTERS: usize = 16;

/// Height of the labels on the horizontal axis if they are too long and therefore rotated.
fn drop(axis: &Axis, room: f64) -> f64 {
    let longest = axis.levels.iter().map(|level| level.chars().count().min(MAX_LETTERS)).max().unwrap_or(0) as f64;
    if 7.0 * longest > room { 7.0 * longest - 4.0 } else { 0.0 }
}

fn ticks(svg: &mut Svg, map: &PairMap, [w, h]: [f64; 2], bottom: f64, drop: f64) {
    let axis = |axis: &Axis, room: f64| -> Vec<(f64, String)> {
        if axis.levels.is_empty() {
            let cells = axis.cells() as f64;
            let ends = [axis.edges.first().copied().unwrap_or(0.0), axis.edges.last().copied().unwrap_or(1.0)];
            let place = scale(axis, [0.0, cells]);
            let count = (room * cells / 60.0).max(2.0) as usize;
            round_ticks(ends, count, axis.log).into_iter().map(|x| (place.at(x), tick(x))).collect()
        } else {
            let every = (16.0 / room).ceil().max(1.0) as usize;
            let all = axis.levels.iter().enumerate().step_by(every);
            all.map(|(i, level)| (i as f64 + 0.5, cut(level, (room / 5.5).max(3.0) as usize))).collect()
        }
    };
    if drop > 0.0 {
        for (i, level) in map.x.levels.iter().enumerate() {
            let x = LEFT + w * (i as f64 + 0.5) + 4.0;
            svg.text_up_to("s", [x, bottom + 6.0], &cut(level, MAX_LETTERS));
        }
    }
    let across = if drop > 0.0 { Vec::new() } else { axis(&map.x, w) };
    for (i, (at, text)) in across.into_iter().enumerate() {
        let x = LEFT + w * at;
        svg.text(if i % 2 == 1 { "s odd" } else { "s" }, Anchor::Middle, [x, bottom + 15.0], &text);
    }
    for (at, text) in axis(&map.y, h * 1.6) {
        svg.text("s", Anchor::End, [LEFT - 7.0, bottom - h * at + 4.0], &cut(&text, 8));
    }
    svg.text(
        "a",
        Anchor::Middle,
        [0.5 * (LEFT + WIDTH - RIGHT), bottom + drop + 33.0],
        &label_with_unit(&map.x.parameter),
    );
    svg.text_up("a", [11.0, 0.5 * (TOP + bottom)], &label_with_unit(&map.y.parameter));
}

/// The mark of a classified cell, in its upper right corner.
fn mark(svg: &mut Svg, [x, y]: [f64; 2]) {
    svg.polygon("known", &[[x - 8.0, y], [x, y], [x, y + 8.0]]);
}

fn legend(svg: &mut Svg, y: f64, boundary: Boundary<'_>) {
    let w = 15.0;
    svg.text("s", Anchor::Start, [LEFT, y + 10.0], "0 %");
    let from = LEFT + 34.0;
    for step in 0..STEPS {
        svg.rect(&format!("r{step}"), [from + w * step as f64, y, w, 12.0]);
    }
    svg.text("s", Anchor::Start, [from + w * STEPS as f64 + 7.0, y + 10.0], "100 % success");
    svg.rect("r5", [LEFT, y + 21.0, 22.0, 12.0]);
    mark(svg, [LEFT + 22.0, y + 21.0]);
    svg.text("s", Anchor::Start, [LEFT + 29.0, y + 31.0], "at 70 % or more, at 30 % or less, or between: significant");
    if let Some((class, text)) = boundary.legend() {
        svg.rect("band", [LEFT, y + 42.0, 22.0, 12.0]);
        svg.line(class, [LEFT, y + 48.0, LEFT + 22.0, y + 48.0]);
        svg.text("s", Anchor::Start, [LEFT + 29.0, y + 52.0], &text);
    }
}
