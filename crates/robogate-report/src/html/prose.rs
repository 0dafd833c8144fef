//! Escapes text for a page.

use std::borrow::Cow;
use std::fmt::Write;

use maud::{Escaper, Markup, Render, html};
use robogate_stats::format::is_deceptive;

/// Prepares a text for a page: a percent sign stays on the line of its number, and characters that XML does not allow
/// or that reorder the text are replaced. The template escapes markup.
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
                c if is_deceptive(c) && !matches!(c, '\n' | '\t') => '\u{FFFD}',
                c => c,
            };
            // Writing to a string cannot fail.
            let _ = escaped.write_char(letter);
        }
    }
}

/// A sentence for a page. What it has between backticks is code.
pub(crate) fn rich(text: &str) -> Markup {
    let parts: Vec<&str> = text.split('`').collect();
    html! {
        @for (at, part) in parts.iter().enumerate() {
            @if at % 2 == 0 {
                (prose(part))
            } @else if at + 1 < parts.len() {
                code { (prose(part)) }
            } @else {
                "`" (prose(part))
            }
        }
    }
}

/// A page without characters that hide or reorder text. Text of the template has none; blocks of data for the scripts may,
/// because JSON keeps them.
pub(super) fn inert(page: &str) -> Cow<'_, str> {
    let is_hidden = |c: char| is_deceptive(c) && !matches!(c, '\n' | '\t' | '\r');
    if page.contains(is_hidden) { page.replace(is_hidden, "\u{fffd}").into() } else { page.into() }
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
        assert_eq!(prose("fail\u{202e}ssap").render().into_string(), "fail\u{FFFD}ssap");
    }

    #[test]
    fn data_for_scripts_is_inert() {
        assert_eq!(inert("{\"name\":\"\u{202e}ssap\u{9b}\"}\n"), "{\"name\":\"\u{fffd}ssap\u{fffd}\"}\n");
    }

    #[test]
    fn backticks_become_code() {
        assert_eq!(rich("run `a<b` 5 % now").into_string(), "run <code>a&lt;b</code> 5\u{a0}% now");
        assert_eq!(rich("one ` alone").into_string(), "one ` alone");
        assert_eq!(rich("`a` and ` b").into_string(), "<code>a</code> and ` b");
    }

    #[test]
    fn percent_sign_does_not_wrap() {
        assert_eq!(prose("40.0 % of").render().into_string(), "40.0\u{a0}% of");
    }
}
