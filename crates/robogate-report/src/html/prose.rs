//! Escapes text for a page.

use std::fmt::Write;

use maud::{Escaper, Render};

/// Prepares a text for a page: a percent sign stays on the line of its number, and characters that XML does not allow
/// are replaced. The template escapes markup.
pub(crate) struct Prose<'a>(&'a str);

/// A text for a page.
pub(crate) fn prose(text: &str) -> Prose<'_> {
    Prose(text)
}

impl Render for Prose<'_> {
    fn render_to(&self, buffer: &mut String) {
        let mut escaped = Escaper::new(buffer);
        let mut letters = self.0.chars().peekable();
        while let Some(letter) = letters.next() {
            let letter = match letter {
                ' ' if letters.peek() == Some(&'%') => '\u{a0}',
                c if c.is_control() && !matches!(c, '\n' | '\t') => '\u{FFFD}',
                c => c,
            };
            // Writing to a string cannot fail.
            let _ = escaped.write_char(letter);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_cannot_become_markup() {
        assert_eq!(prose("<script>\"&").render().into_string(), "&lt;script&gt;&quot;&amp;");
    }

    #[test]
    fn control_characters_are_replaced() {
        assert_eq!(prose("a\u{0}b").render().into_string(), "a\u{FFFD}b");
    }

    #[test]
    fn percent_sign_does_not_wrap() {
        assert_eq!(prose("40.0 % of").render().into_string(), "40.0\u{a0}% of");
    }
}
