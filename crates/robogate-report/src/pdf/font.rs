//! The two standard fonts: widths and encoding.
//!
//! Source of the widths: Adobe's font metrics of the 14 standard fonts (Core14 AFM), in thousandths of the size.

use robogate_stats::format::is_deceptive;

/// A standard font.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Font {
    /// Helvetica.
    Plain,
    /// Helvetica-Bold.
    Bold,
}

/// Widths of the characters from space to tilde.
const PLAIN: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556,
    556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334,
    260, 334, 584,
];
const BOLD: [u16; 95] = [
    278, 333, 474, 556, 556, 889, 722, 238, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 333, 333, 584, 584, 584, 611, 975, 722, 722, 722, 722, 667, 611, 778, 722, 278, 556, 722, 611, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 333, 278, 333, 584, 556, 333, 556, 611, 556, 611,
    556, 333, 611, 611, 278, 278, 556, 278, 889, 611, 611, 611, 611, 389, 556, 333, 611, 556, 778, 556, 556, 500, 389,
    280, 389, 584,
];
/// Width of every other character: at least that of any lower-case letter but `æ`.
const OTHER: u16 = 611;
/// Characters of WinAnsiEncoding outside Latin-1 that texts of RoboGate contain.
const SPECIAL: [(char, u8); 9] = [
    ('\u{20ac}', 0x80),
    ('\u{2026}', 0x85),
    ('\u{2018}', 0x91),
    ('\u{2019}', 0x92),
    ('\u{201c}', 0x93),
    ('\u{201d}', 0x94),
    ('\u{2022}', 0x95),
    ('\u{2013}', 0x96),
    ('\u{2014}', 0x97),
];

impl Font {
    /// Its name in the resources of a page.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Plain => "F1",
            Self::Bold => "F2",
        }
    }

    /// Its standard name.
    pub(super) fn base(self) -> &'static str {
        match self {
            Self::Plain => "Helvetica",
            Self::Bold => "Helvetica-Bold",
        }
    }

    /// The width of a line in points.
    pub(super) fn width(self, text: &str, size: f64) -> f64 {
        let widths = match self {
            Self::Plain => &PLAIN,
            Self::Bold => &BOLD,
        };
        let of = |byte: &u8| {
            let at = usize::from(*byte).checked_sub(32);
            f64::from(at.and_then(|at| widths.get(at)).copied().unwrap_or(OTHER))
        };
        encoded(text).iter().map(of).sum::<f64>() * size / 1000.0
    }
}

/// The text in WinAnsiEncoding.
pub(super) fn encoded(text: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    for c in text.chars() {
        match c {
            ' '..='~' => bytes.push(c as u8),
            '\t' | '\n' | '\r' => bytes.push(b' '),
            '\u{2212}' => bytes.push(b'-'),
            '\u{2265}' => bytes.extend(b">="),
            '\u{2264}' => bytes.extend(b"<="),
            '\u{a0}'..='\u{ff}' if !is_deceptive(c) => bytes.push(c as u8),
            c => bytes.push(SPECIAL.iter().find(|(special, _)| *special == c).map_or(b'?', |(_, byte)| *byte)),
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_characters_are_replaced() {
        assert_eq!(encoded("a\u{e9}\u{2265}\u{2013}\u{4e2d}\u{202e}"), b"a\xe9>=\x96??");
    }

    #[test]
    fn widths_are_those_of_the_font() {
        // "Hello" in Helvetica: 722 + 556 + 222 + 222 + 556.
        assert!((Font::Plain.width("Hello", 10.0) - 22.78).abs() < 1e-9);
        assert!(Font::Bold.width("Hello", 10.0) > Font::Plain.width("Hello", 10.0));
    }
}
