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

/// Whether a character hides or reorders text.
fn is_hidden(c: char) -> bool {
    is_deceptive(c) && !matches!(c, '\n' | '\t' | '\r')
}

/// JSON for the scripts of a page: it contains no markup, and no characters that hide or reorder text, which JSON may also write as
/// `\u001b`.
pub fn script_data(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    let mut rest = json;
    while let Some(at) = rest.find(|c| matches!(c, '\\' | '<') || is_hidden(c)) {
        let (before, found) = rest.split_at(at);
        out.push_str(before);
        let escape = found.strip_prefix("\\u").and_then(|text| text.get(..4));
        let escaped = escape.and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let used = match (found.chars().next(), escaped) {
            (Some('<'), _) => {
                out.push_str("\\u003c");
                1
            }
            (Some('\\'), Some(code)) if char::from_u32(code).is_some_and(is_hidden) => {
                out.push('\u{fffd}');
                6
            }
            (Some('\\'), _) => {
                // The second character of an escape, for example a backslash, begins no other one.
                let end = found.char_indices().nth(2).map_or(found.len(), |(end, _)| end);
                out.push_str(&found[..end]);
                end
            }
            (c, _) => {
                out.push('\u{fffd}');
                c.map_or(found.len(), char::len_utf8)
            }
        };
        rest = &found[used..];
    }
    out.push_str(rest);
    out
}

/// A page without characters that hide or reorder text. Text of the template has none; blocks of data for the scripts may,
/// because JSON keeps them.
pub(super) fn inert(page: &str) -> Cow<'_, str> {
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
    fn data_for_scripts_hides_nothing() {
        let json = serde_json::json!({ "a<b": "\u{1b}[2J\u{202e}ssap\u{9b}\u{7f}\n\t\\u001b \u{e4}" }).to_string();
        let safe = script_data(&json);
        assert!(!safe.contains(['<', '\u{202e}', '\u{9b}', '\u{7f}']) && !safe.contains("[2J\\u"), "{safe}");
        let read: serde_json::Value = serde_json::from_str(&safe).unwrap();
        assert_eq!(read, serde_json::json!({ "a<b": "\u{fffd}[2J\u{fffd}ssap\u{fffd}\u{fffd}\n\t\\u001b \u{e4}" }));
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
