//! Text from files and other programs, made harmless for a terminal.

use std::borrow::Cow;
use std::fmt::Display;
use std::path::Path;

use robogate_analysis::shell_word;
use robogate_stats::format::is_deceptive;

/// Formats text from a file or a file name on one line, with control characters escaped.
pub fn foreign(text: impl Display) -> String {
    escaped(&text.to_string(), |_| None).into_owned()
}

/// Formats text of several lines, with all lines after the first indented and control characters escaped.
pub fn indented(text: impl Display) -> String {
    escaped(&text.to_string(), |rest| rest.starts_with('\n').then_some(1)).replace('\n', "\n    ")
}

/// Escapes control characters (C0, DEL, C1) and controls of the text direction as JSON does, so that a JSON document keeps its
/// meaning. `kept` returns the number of bytes at the start of a text that are copied unchanged.
pub fn escaped(text: &str, kept: impl Fn(&str) -> Option<usize>) -> Cow<'_, str> {
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

/// A path as one word of a shell command.
pub fn quoted(path: &Path) -> String {
    shell_word(&path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_become_shell_words() {
        assert_eq!(quoted(Path::new("/data/run-1")), "/data/run-1");
        assert_eq!(quoted(Path::new("my run")), "'my run'");
        assert_eq!(quoted(Path::new("it's")), "'it'\\''s'");
        assert_eq!(quoted(Path::new("$HOME")), "'$HOME'");
    }
}
