//! What people see: stdout carries data and summaries, stderr errors and progress.

use std::borrow::Cow;
use std::fmt::{self, Display};
use std::io::{self, IsTerminal, Write};

pub(crate) use robogate_stats::format::{count as grouped, percent};

use crate::exit::Exit;

/// Whether stdout takes colour: a terminal that did not ask for none (`NO_COLOR`).
fn colour(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty())
}

/// Text in a terminal style, plain where colour is not wanted. Meaning never hangs on it.
pub(crate) struct Styled<T>(&'static str, T);

impl<T: Display> Display for Styled<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if colour(&io::stdout()) { write!(f, "\x1b[{}m{}\x1b[0m", self.0, self.1) } else { self.1.fmt(f) }
    }
}

/// Text in this style (the parameters of an SGR sequence).
pub(crate) fn styled<T: Display>(style: &'static str, text: T) -> Styled<T> {
    Styled(style, text)
}

/// A heading.
pub(crate) fn bold<T: Display>(text: T) -> Styled<T> {
    Styled("1", text)
}

/// What is beside the point.
pub(crate) fn dim<T: Display>(text: T) -> Styled<T> {
    Styled("2", text)
}

/// Text from elsewhere (a name in a file, a file's name) on one line: what would steer the terminal stands escaped.
pub(crate) fn foreign(text: impl Display) -> String {
    escaped(&text.to_string(), |_| None).into_owned()
}

/// Text of several lines, those after the first indented, without what would steer the terminal.
pub(crate) fn indented(text: impl Display) -> String {
    escaped(&text.to_string(), |rest| rest.starts_with('\n').then_some(1)).replace('\n', "\n    ")
}

/// The text with control characters (C0, DEL, C1) written out, as JSON writes them: a JSON document stays the same one.
/// `kept` says how many bytes at the head of a text may pass.
fn escaped(text: &str, kept: impl Fn(&str) -> Option<usize>) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let taken = kept(rest);
        let (head, tail) = rest.split_at(taken.unwrap_or(c.len_utf8()));
        match c {
            _ if taken.is_some() || !c.is_control() => safe.push_str(head),
            '\n' => safe.push_str("\\n"),
            '\r' => safe.push_str("\\r"),
            '\t' => safe.push_str("\\t"),
            _ => safe.push_str(&format!("\\u{:04x}", u32::from(c))),
        }
        rest = tail;
    }
    Cow::Owned(safe)
}

/// Writes a line of data or summary to stdout. A reader that went away (a closed pipe) ends nothing.
pub(crate) fn line(text: impl Display) {
    // There is nobody left to tell.
    let _ = writeln!(io::stdout(), "{}", harmless(&text.to_string()));
}

/// The text without what would steer the terminal: data from files are in it. Line ends, tabs and the styles written
/// here (`ESC [ digits ; m`) alone stay.
fn harmless(text: &str) -> Cow<'_, str> {
    escaped(text, |rest| if rest.starts_with(['\n', '\t']) { Some(1) } else { style_at(rest) })
}

/// The length of a style at the beginning of the text.
fn style_at(text: &str) -> Option<usize> {
    let inside = text.strip_prefix("\x1b[")?;
    let end = inside.find(|c: char| !c.is_ascii_digit() && c != ';')?;
    inside[end..].starts_with('m').then_some(end + 3)
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

/// Writes a line for people to stderr.
pub(crate) fn note(text: impl Display) {
    let _ = writeln!(io::stderr(), "{}", harmless(&text.to_string()));
}

/// Writes an error.
pub(crate) fn error(exit: &Exit) {
    let label = if colour(&io::stderr()) { "\x1b[1;31merror\x1b[0m" } else { "error" };
    note(format_args!("{label}: {exit}"));
}

/// A bar of `width` cells for a share from 0 to 1, in eighths of a cell.
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
    fn control_characters_of_data_are_written_out_and_styles_stay() {
        assert_eq!(harmless("\x1b[1;31mred\x1b[0m\tµ\n"), "\x1b[1;31mred\x1b[0m\tµ\n");
        let hostile = "a\x1b]0;title\x07\x1b[2Jb\u{9b}c\r";
        assert_eq!(harmless(hostile), "a\\u001b]0;title\\u0007\\u001b[2Jb\\u009bc\\r");
    }

    #[test]
    fn what_would_steer_the_terminal_stands_escaped() {
        assert_eq!(
            foreign("a\x1b[2J\nverdict: pass\u{9b}1m\x7f\u{e4}"),
            "a\\u001b[2J\\nverdict: pass\\u009b1m\\u007f\u{e4}"
        );
        assert_eq!(indented("it is no plan\nhint: \rleave it out"), "it is no plan\n    hint: \\rleave it out");
    }

    #[test]
    fn a_bar_is_as_wide_as_it_is_asked_to_be() {
        for share in [0.0, 0.01, 0.5, 0.99, 1.0, 2.0] {
            assert_eq!(bar(share, 20).chars().count(), 20);
        }
        assert_eq!(bar(0.5, 4), "██  ");
        assert_eq!(bar(0.0, 2), "  ");
    }
}
