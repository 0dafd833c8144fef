//! Colours of failure modes and their legend.

use robogate_analysis::labels::mode_label;

use super::svg::{Anchor, Svg, cut};

/// Number of failure modes with their own colour. Further modes reuse the colours.
const COLOURS: usize = 8;

/// Maximum number of characters of a label.
pub(super) const MAX_LABEL: usize = 26;

/// Height of one line of a legend.
const LINE: f64 = 18.0;

/// The style class of a failure mode, by its index.
pub(super) fn mode_class(mode: usize) -> String {
    format!("m{}", mode % COLOURS)
}

/// The label of a mode in a figure.
pub(super) fn short_label(mode: &str) -> String {
    cut(&mode_label(mode), MAX_LABEL)
}

/// Draws the modes and their colours on one or more lines, from `top` up to the width `right`. Returns the height of
/// the lines after the first.
pub(super) fn mode_legend(svg: &mut Svg, modes: &[&str], right: f64, top: f64) -> f64 {
    let (mut x, mut y) = (0.0, top);
    for (i, mode) in modes.iter().enumerate() {
        let label = short_label(mode);
        let width = 28.0 + 6.6 * label.chars().count() as f64;
        if x > 0.0 && x + width > right {
            x = 0.0;
            y += LINE;
        }
        svg.rect(&mode_class(i), [x, y, 11.0, 11.0]);
        svg.text("s", Anchor::Start, [x + 16.0, y + 10.0], &label);
        x += width;
    }
    y - top
}

/// The height of a legend's lines after the first.
pub(super) fn further_lines(modes: &[&str], right: f64) -> f64 {
    mode_legend(&mut Svg::new(1.0, 1.0), modes, right, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_legends_wrap() {
        assert!(further_lines(&["collision", "timeout"], 420.0) <= 0.0);
        let many = ["object_dropped"; 9];
        assert!(further_lines(&many, 420.0) >= 2.0 * LINE);
    }

    #[test]
    fn colours_repeat() {
        assert_eq!(mode_class(3), "m3");
        assert_eq!(mode_class(COLOURS + 1), "m1");
    }
}
