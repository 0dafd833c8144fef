//! Terminal output: stdout carries data and summaries, stderr errors and progress.

use std::borrow::Cow;
use std::fmt::{self, Display};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;

use robogate_stats::format::is_deceptive;
pub(crate) use robogate_stats::format::{count as grouped, percent};

use crate::exit::Exit;

/// Whether a stream shows colours: it is a terminal, and `NO_COLOR` is not set.
fn colour(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty())
}

/// Text in a terminal style. It is plain if the output shows no colours, so meaning must not depend on the style.
pub(crate) struct Styled<T>(&'static str, T);

impl<T: Display> Display for Styled<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if colour(&io::stdout()) { write!(f, "{}{}{}", mark(self.0), self.1, mark("0")) } else { self.1.fmt(f) }
    }
}

/// The secret of this process that marks its own styles. Text from files cannot contain it.
fn secret() -> &'static str {
    static SECRET: OnceLock<String> = OnceLock::new();
    SECRET.get_or_init(|| {
        // The standard library seeds each of these from the operating system.
        let random = || RandomState::default().build_hasher().finish();
        format!("{:016x}{:016x}", random(), random())
    })
}

/// A style that [`line`] and [`note`] turn into an escape sequence.
fn mark(style: &str) -> String {
    format!("\x1b{}[{style}m", secret())
}

/// Formats text in this style (the parameters of an SGR sequence).
pub(crate) fn styled<T: Display>(style: &'static str, text: T) -> Styled<T> {
    Styled(style, text)
}

/// Formats a heading.
pub(crate) fn bold<T: Display>(text: T) -> Styled<T> {
    Styled("1", text)
}

/// Formats secondary text.
pub(crate) fn dim<T: Display>(text: T) -> Styled<T> {
    Styled("2", text)
}

/// Formats text from a file or a file name on one line, with control characters escaped.
pub(crate) fn foreign(text: impl Display) -> String {
    escaped(&text.to_string(), |_| None).into_owned()
}

/// Formats text of several lines, with all lines after the first indented and control characters escaped.
pub(crate) fn indented(text: impl Display) -> String {
    escaped(&text.to_string(), |rest| rest.starts_with('\n').then_some(1)).replace('\n', "\n    ")
}

/// Escapes control characters (C0, DEL, C1) and controls of the text direction as JSON does, so that a JSON document keeps its
/// meaning. `kept` returns the
/// number of bytes at the start of a text that are copied unchanged.
fn escaped(text: &str, kept: impl Fn(&str) -> Option<usize>) -> Cow<'_, str> {
    if !text.contains(is_deceptive) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let taken = kept(rest);
        let (head, tail) = rest.split_at(taken.unwrap_or(c.len_utf8()));
        match c {
            _ if taken.is_some() || !is_deceptive(c) => safe.push_str(head),
            '\n' => safe.push_str("\\n"),
            '\r' => safe.push_str("\\r"),
            '\t' => safe.push_str("\\t"),
            _ => safe.push_str(&format!("\\u{:04x}", u32::from(c))),
        }
        rest = tail;
    }
    Cow::Owned(safe)
}

/// Writes a line of data or summary to stdout. A closed pipe is not an error.
pub(crate) fn line(text: impl Display) {
    // The reader of stdout has gone away, so there is nothing to report to.
    let _ = writeln!(io::stdout(), "{}", harmless(&text.to_string()));
}

/// Escapes control characters, because the text contains data from files. Line ends, tabs and the styles that this module
/// marked are kept. An escape sequence in data, also one that only sets a colour, becomes visible text.
fn harmless(text: &str) -> String {
    let marked = format!("\x1b{}", secret());
    // The text between the marks: each part after the first begins with `[STYLEm`.
    let part = |text: &str| escaped(text, |rest| rest.starts_with(['\n', '\t']).then_some(1)).into_owned();
    let mut parts = text.split(&marked);
    let mut safe = parts.next().map_or_else(String::new, part);
    for styled in parts {
        safe.push('\x1b');
        safe.push_str(&part(styled));
    }
    safe
}

/// Writes text in lines of at most 100 columns.
pub(crate) fn wrapped(text: &str) {
    let mut so_far = String::from("  ");
    for word in text.split_whitespace() {
        if so_far.chars().count() + word.chars().count() > 98 && !so_far.trim().is_empty() {
            line(so_far.trim_end());
            so_far = String::from("  ");
        }
        so_far.push_str(word);
        so_far.push(' ');
    }
    line(so_far.trim_end());
}

/// Writes a line for the user to stderr.
pub(crate) fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{}", harmless(&text.to_string()));
}

/// Writes an error.
pub(crate) fn error(exit: &Exit) {
    let label = if colour(&io::stderr()) { format!("{}error{}", mark("1;31"), mark("0")) } else { "error".to_owned() };
    note(format_args!("{label}: {exit}"));
}

/// Formats a share from 0 to 1 as a bar of `width` cells, in eighths of a cell.
pub(crate) fn bar(share: f64, width: usize) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (share.clamp(0.0, 1.0) * (8 * width) as f64).round() as usize;
    let text = format!("{}{}", "█".repeat(eighths / 8), EIGHTHS[eighths % 8]);
    let used = eighths.div_ceil(8);
    format!("{text}{}", " ".repeat(width - used))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped() {
        let own = format!("{}red{}\tµ\n", mark("1;31"), mark("0"));
        assert_eq!(harmless(&own), "\x1b[1;31mred\x1b[0m\tµ\n");
        // Colours of others could hide a word, or show a verdict in green.
        assert_eq!(harmless("\x1b[8mhidden\x1b[0m"), "\\u001b[8mhidden\\u001b[0m");
        assert_eq!(harmless(&format!("{}\x1b[2J", mark("1"))), "\x1b[1m\\u001b[2J");
        // A name that reads "fail pass" backwards.
        assert_eq!(harmless("\u{202e}ssap\u{202c} \u{2066}x"), "\\u202essap\\u202c \\u2066x");
        let hostile = "a\x1b]0;title\x07\x1b[2Jb\u{9b}c\r";
        assert_eq!(harmless(hostile), "a\\u001b]0;title\\u0007\\u001b[2Jb\\u009bc\\r");
    }

    #[test]
    fn foreign_text_is_escaped() {
        assert_eq!(
            foreign("a\x1b[2J\nverdict: pass\u{9b}1m\x7f\u{e4}"),
            "a\\u001b[2J\\nverdict: pass\\u009b1m\\u007f\u{e4}"
        );
        assert_eq!(indented("not a plan\nhint: \rleave it out"), "not a plan\n    hint: \\rleave it out");
    }

    #[test]
    fn bars_have_fixed_width() {
        for share in [0.0, 0.01, 0.5, 0.99, 1.0, 2.0] {
            assert_eq!(bar(share, 20).chars().count(), 20);
        }
        assert_eq!(bar(0.5, 4), "██  ");
        assert_eq!(bar(0.0, 2), "  ");
    }
}
