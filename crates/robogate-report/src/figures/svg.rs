//! SVG drawings of a few shapes. Coordinates are rounded, so that equal data give equal bytes.

use maud::{Markup, PreEscaped, html};

use crate::html::prose;

/// Cuts a text to a number of characters.
pub(crate) fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['\u{2026}']).collect()
}

/// A drawing of fixed size that scales with its container.
pub(crate) struct Svg {
    width: f64,
    height: f64,
    body: Markup,
}

/// The alignment of a text at its point.
#[derive(Clone, Copy)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    fn attribute(self) -> Option<&'static str> {
        match self {
            Self::Start => None,
            Self::Middle => Some("middle"),
            Self::End => Some("end"),
        }
    }
}

/// Formats a coordinate with at most one decimal.
fn c(x: f64) -> String {
    let text = format!("{x:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A rectangle with a tooltip.
fn rectangle(class: Option<&str>, [x, y, w, h]: [f64; 4], hint: Option<&str>) -> Markup {
    html! {
        rect class=[class] x=(c(x)) y=(c(y)) width=(c(w.max(0.0))) height=(c(h.max(0.0))) {
            @if let Some(hint) = hint { title { (prose(hint)) } }
        }
    }
}

impl Svg {
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: PreEscaped(String::new()) }
    }

    fn push(&mut self, shape: &Markup) {
        self.body.0.push_str(&shape.0);
    }

    pub(crate) fn rect(&mut self, class: &str, place: [f64; 4]) {
        self.push(&rectangle(Some(class), place, None));
    }

    /// Draws a rectangle with a tooltip.
    pub(crate) fn rect_with_hint(&mut self, class: &str, place: [f64; 4], hint: &str) {
        self.push(&rectangle(Some(class), place, Some(hint)));
    }

    pub(crate) fn line(&mut self, class: &str, [x1, y1, x2, y2]: [f64; 4]) {
        self.push(&html! { line class=(class) x1=(c(x1)) y1=(c(y1)) x2=(c(x2)) y2=(c(y2)) {} });
    }

    pub(crate) fn dot(&mut self, class: &str, [x, y]: [f64; 2], r: f64, hint: &str) {
        self.push(&html! { circle class=(class) cx=(c(x)) cy=(c(y)) r=(c(r)) { title { (prose(hint)) } } });
    }

    pub(crate) fn text(&mut self, class: &str, anchor: Anchor, [x, y]: [f64; 2], text: &str) {
        let anchor = anchor.attribute();
        self.push(&html! { text class=(class) x=(c(x)) y=(c(y)) text-anchor=[anchor] { (prose(text)) } });
    }

    /// Draws a text that reads upwards and ends at its point.
    pub(crate) fn text_up_to(&mut self, class: &str, at: [f64; 2], text: &str) {
        self.upwards(class, Anchor::End, at, text);
    }

    /// Draws a text that reads upwards and is centred at its point.
    pub(crate) fn text_up(&mut self, class: &str, at: [f64; 2], text: &str) {
        self.upwards(class, Anchor::Middle, at, text);
    }

    fn upwards(&mut self, class: &str, anchor: Anchor, [x, y]: [f64; 2], text: &str) {
        let rotated = format!("translate({} {}) rotate(-90)", c(x), c(y));
        let anchor = anchor.attribute();
        self.push(&html! { text class=(class) text-anchor=[anchor] transform=(rotated) { (prose(text)) } });
    }

    pub(crate) fn polyline(&mut self, class: &str, points: &[[f64; 2]]) {
        if points.len() > 1 {
            self.push(&html! { polyline class=(class) points=(path(points)) {} });
        }
    }

    pub(crate) fn polygon(&mut self, class: &str, points: &[[f64; 2]]) {
        if points.len() > 1 {
            self.push(&html! { polygon class=(class) points=(path(points)) {} });
        }
    }

    /// Fills polygons that may share sides as one area.
    pub(crate) fn area(&mut self, class: &str, polygons: &[Vec<[f64; 2]>]) {
        let outline = |points: &Vec<[f64; 2]>| format!("M{}Z", path(points));
        if !polygons.is_empty() {
            self.push(&html! { path class=(class) d=(polygons.iter().map(outline).collect::<String>()) {} });
        }
    }

    /// Clips everything that `draw` draws to the rectangle. `id` must be unique on the page.
    pub(crate) fn clipped(&mut self, id: &str, place: [f64; 4], draw: impl FnOnce(&mut Self)) {
        let mut inner = Self::new(self.width, self.height);
        draw(&mut inner);
        self.push(&html! {
            clipPath id=(id) { (rectangle(None, place, None)) }
            g clip-path={ "url(#" (id) ")" } { (inner.body) }
        });
    }

    /// Finishes the element, with a label for screen readers.
    pub(crate) fn finish(self, label: &str) -> Markup {
        let (width, height) = (c(self.width), c(self.height));
        html! {
            svg viewBox={ "0 0 " (width) " " (height) } role="img" aria-label=(prose(label)) style={ "--w:" (width) } {
                (self.body)
            }
        }
    }
}

fn path(points: &[[f64; 2]]) -> String {
    let points: Vec<String> = points.iter().map(|[x, y]| format!("{},{}", c(*x), c(*y))).collect();
    points.join(" ")
}

/// A linear or logarithmic mapping of numbers to positions on an axis.
#[derive(Clone, Copy)]
pub(crate) struct Scale {
    from: [f64; 2],
    to: [f64; 2],
    log: bool,
}

impl Scale {
    pub(crate) fn linear(from: [f64; 2], to: [f64; 2]) -> Self {
        Self { from, to, log: false }
    }

    pub(crate) fn log(from: [f64; 2], to: [f64; 2]) -> Self {
        Self { from, to, log: true }
    }

    pub(crate) fn at(&self, value: f64) -> f64 {
        let [low, high] = self.from;
        let share = if self.log {
            // Far below the axis, so that a value of 0 or less is clipped.
            (value.max(low * 1e-6) / low).ln() / (high / low).ln()
        } else {
            (value - low) / (high - low)
        };
        self.to[0] + share * (self.to[1] - self.to[0])
    }
}

/// Round numbers on an axis from `low` to `high`, at most about `count` of them: multiples of 1, 2 or 5 times a power of
/// ten. A logarithmic axis over more than a decade gets 1, 2 and 5 times powers of ten.
pub(crate) fn round_ticks([low, high]: [f64; 2], count: usize, log: bool) -> Vec<f64> {
    if !(low.is_finite() && high.is_finite() && high > low) {
        return Vec::new();
    }
    if log && low > 0.0 && high / low > 10.0 {
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let all: Vec<f64> = decades
            .flat_map(|decade| [1.0, 2.0, 5.0].map(|x| x * 10_f64.powi(decade)))
            .filter(|x| (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(x))
            .collect();
        let every = all.len().div_ceil(count.max(1));
        return all.into_iter().step_by(every.max(1)).collect();
    }
    let raw = (high - low) / count.max(1) as f64;
    let power = 10_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|x| x * power).find(|step| *step >= raw * (1.0 - 1e-9));
    let step = step.unwrap_or(10.0 * power);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A tick as text, without the digits of floating-point errors.
pub(crate) fn tick(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_short() {
        assert_eq!(c(1.0), "1");
        assert_eq!(c(-0.04), "0");
        assert_eq!(c(12.34), "12.3");
    }

    #[test]
    fn ticks_are_round() {
        let text =
            |range, count, log| round_ticks(range, count, log).into_iter().map(tick).collect::<Vec<_>>().join(" ");
        assert_eq!(text([0.02, 0.11], 5, false), "0.02 0.04 0.06 0.08 0.1");
        assert_eq!(text([0.05, 1.2], 6, false), "0.2 0.4 0.6 0.8 1 1.2");
        assert_eq!(text([0.05, 20.0], 9, true), "0.05 0.1 0.2 0.5 1 2 5 10 20");
        assert_eq!(text([-3.0, 3.0], 4, false), "-2 0 2");
        assert_eq!(text([1.0, 1.0], 4, false), "");
        assert!(round_ticks([1e-9, 1.0], 4, true).len() <= 8);
    }

    #[test]
    fn labels_are_escaped() {
        let mut svg = Svg::new(10.0, 10.0);
        svg.text("\"><script>", Anchor::End, [1.0, 2.0], "<b>");
        let text = svg.finish("a\"b").into_string();
        assert!(!text.contains("<script>") && !text.contains("<b>") && !text.contains("a\"b"), "{text}");
    }
}
