//! Drawing by hand: a few shapes, coordinates rounded so that the same data give the same bytes.

use std::fmt::Write;

/// Text with everything that HTML or XML would read as markup escaped; a percent sign stays with its number.
pub(crate) fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            ' ' if letters.peek() == Some(&'%') => safe.push('\u{a0}'),
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            // What XML cannot hold at all.
            c if c.is_control() && !matches!(c, '\n' | '\t') => safe.push('\u{FFFD}'),
            c => safe.push(c),
        }
    }
    safe
}

/// A text cut to so many letters.
pub(crate) fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['\u{2026}']).collect()
}

/// A drawing of fixed size that scales with its place on the page.
pub(crate) struct Svg {
    width: f64,
    height: f64,
    body: String,
}

/// How a text stands on its point.
#[derive(Clone, Copy)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A coordinate with one decimal at most.
fn c(x: f64) -> String {
    let text = format!("{x:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

impl Svg {
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: String::new() }
    }

    pub(crate) fn rect(&mut self, class: &str, [x, y, w, h]: [f64; 4]) {
        // Writing to a string cannot fail; so throughout this file.
        let _ = write!(
            self.body,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
            c(x),
            c(y),
            c(w.max(0.0)),
            c(h.max(0.0))
        );
    }

    /// A rectangle that tells more when pointed at.
    pub(crate) fn rect_told(&mut self, class: &str, [x, y, w, h]: [f64; 4], told: &str) {
        let _ = write!(
            self.body,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
            c(x),
            c(y),
            c(w.max(0.0)),
            c(h.max(0.0)),
            escape(told)
        );
    }

    pub(crate) fn line(&mut self, class: &str, [x1, y1, x2, y2]: [f64; 4]) {
        let _ = write!(
            self.body,
            "<line class=\"{class}\" x1=\"{}\" y1=\"{}\" x2=\"{}\" y2=\"{}\"/>",
            c(x1),
            c(y1),
            c(x2),
            c(y2)
        );
    }

    pub(crate) fn dot(&mut self, class: &str, [x, y]: [f64; 2], r: f64, told: &str) {
        let _ = write!(
            self.body,
            "<circle class=\"{class}\" cx=\"{}\" cy=\"{}\" r=\"{}\"><title>{}</title></circle>",
            c(x),
            c(y),
            c(r),
            escape(told)
        );
    }

    pub(crate) fn text(&mut self, class: &str, anchor: Anchor, [x, y]: [f64; 2], text: &str) {
        let anchor = match anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let _ =
            write!(self.body, "<text class=\"{class}\" x=\"{}\" y=\"{}\"{anchor}>{}</text>", c(x), c(y), escape(text));
    }

    /// A text that reads upwards and ends at its point.
    pub(crate) fn text_up_to(&mut self, class: &str, [x, y]: [f64; 2], text: &str) {
        let (x, y) = (c(x), c(y));
        let _ = write!(
            self.body,
            "<text class=\"{class}\" text-anchor=\"end\" transform=\"translate({x} {y}) rotate(-90)\">{}</text>",
            escape(text)
        );
    }

    /// A text that reads upwards, its middle at its point.
    pub(crate) fn text_up(&mut self, class: &str, [x, y]: [f64; 2], text: &str) {
        let (x, y) = (c(x), c(y));
        let _ = write!(
            self.body,
            "<text class=\"{class}\" text-anchor=\"middle\" transform=\"translate({x} {y}) rotate(-90)\">{}</text>",
            escape(text)
        );
    }

    pub(crate) fn polyline(&mut self, class: &str, points: &[[f64; 2]]) {
        self.path("polyline", class, points);
    }

    pub(crate) fn polygon(&mut self, class: &str, points: &[[f64; 2]]) {
        self.path("polygon", class, points);
    }

    fn path(&mut self, element: &str, class: &str, points: &[[f64; 2]]) {
        if points.len() < 2 {
            return;
        }
        let points: Vec<String> = points.iter().map(|[x, y]| format!("{},{}", c(*x), c(*y))).collect();
        let _ = write!(self.body, "<{element} class=\"{class}\" points=\"{}\"/>", points.join(" "));
    }

    /// What `draw` draws is cut at the rectangle; `id` must be the only one of its name on the page.
    pub(crate) fn clipped(&mut self, id: &str, [x, y, w, h]: [f64; 4], draw: impl FnOnce(&mut Self)) {
        let _ = write!(
            self.body,
            "<clipPath id=\"{id}\"><rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/></clipPath><g clip-path=\"url(#{id})\">",
            c(x),
            c(y),
            c(w),
            c(h)
        );
        draw(self);
        self.body.push_str("</g>");
    }

    /// The element, with what it shows for those who cannot see it.
    pub(crate) fn finish(self, label: &str) -> String {
        format!(
            "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\" style=\"--w:{}\">{}</svg>",
            c(self.width),
            c(self.height),
            escape(label),
            c(self.width),
            self.body
        )
    }
}

/// A number's place along an axis.
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
            // Far below the axis, so that a value of 0 or less is cut off and not lost.
            (value.max(low * 1e-6) / low).ln() / (high / low).ln()
        } else {
            (value - low) / (high - low)
        };
        self.to[0] + share * (self.to[1] - self.to[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_data_can_become_markup() {
        assert_eq!(escape("<script>\"&'"), "&lt;script&gt;&quot;&amp;&#39;");
        assert_eq!(escape("a\u{0}b"), "a\u{FFFD}b");
    }

    #[test]
    fn coordinates_are_short() {
        assert_eq!(c(1.0), "1");
        assert_eq!(c(-0.04), "0");
        assert_eq!(c(12.34), "12.3");
    }
}
