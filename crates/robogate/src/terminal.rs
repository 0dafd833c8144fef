//! Terminal output: stdout carries data and summaries, stderr errors and progress.

use std::fmt::{self, Display};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use console::{Term, measure_text_width, strip_ansi_codes};
use indicatif::MultiProgress;
use robogate_report::Line;

use robogate_session::text::escaped;
pub(crate) use robogate_session::text::{foreign, indented};
pub(crate) use robogate_stats::format::{count as grouped, percent};

use crate::canvas;
use crate::exit::{Exit, USAGE};

/// The longest line of text, in columns. Also the width without a terminal, so that the output does not depend on one.
const LONGEST_LINE: usize = 100;

/// Whether stderr shows nothing but warnings and errors.
static QUIET: AtomicBool = AtomicBool::new(false);
/// Whether results have their details.
static VERBOSE: AtomicBool = AtomicBool::new(false);
/// The live view of this process, once there is one.
static SCREEN: OnceLock<MultiProgress> = OnceLock::new();
/// The first error of stdout, if there was one.
static STDOUT_ERROR: OnceLock<io::Error> = OnceLock::new();

/// Shows warnings, errors and results only.
pub(crate) fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Shows the details of results.
pub(crate) fn be_verbose() {
    VERBOSE.store(true, Ordering::Relaxed);
}

/// Whether results have their details.
pub(crate) fn is_verbose() -> bool {
    VERBOSE.load(Ordering::Relaxed)
}

/// The live view on stderr. Other lines on stderr are written above it.
#[derive(Debug, Clone)]
pub(crate) struct Screen(MultiProgress);

impl Screen {
    /// The view of this process.
    pub(crate) fn open() -> Self {
        Self(SCREEN.get_or_init(|| canvas::bars(QUIET.load(Ordering::Relaxed))).clone())
    }

    /// The bars of the view.
    pub(crate) fn bars(&self) -> &MultiProgress {
        &self.0
    }

    /// Width of stderr in columns.
    pub(crate) fn columns(&self) -> usize {
        usize::from(Term::stderr().size().1)
    }

    /// Removes the view before the process ends. The cursor moves to the start of a line.
    pub(crate) fn close() {
        // The process ends, and a terminal that cannot be written to shows nothing anyway.
        let _ = SCREEN.get().map(MultiProgress::clear);
    }
}

/// Width of stdout in columns. `None` if it is not a terminal.
fn columns() -> Option<usize> {
    io::stdout().is_terminal().then(|| Term::stdout().size_checked()).flatten().map(|(_, columns)| usize::from(columns))
}

/// Breaks lines that are longer than the terminal is wide between words, with a hanging indent. Without a terminal,
/// text stays as it is.
fn fitted(text: String, columns: Option<usize>) -> String {
    let Some(columns) = columns.filter(|columns| text.lines().any(|line| measure_text_width(line) > *columns)) else {
        return text;
    };
    let lines: Vec<String> = text.split('\n').map(|line| folded(line, columns)).collect();
    lines.join("\n")
}

/// Breaks one line.
fn folded(line: &str, columns: usize) -> String {
    let visible = strip_ansi_codes(line);
    let indent = visible.len() - visible.trim_start_matches(' ').len();
    let hanging = " ".repeat((indent + 2).min(columns / 2));
    let mut text = String::with_capacity(line.len() + hanging.len());
    let (mut used, mut spaces, mut empty) = (0, 0, true);
    // A number stays with its percent sign.
    for word in line.replace(" %", "\u{a0}%").split(' ') {
        let wide = measure_text_width(word);
        if wide == 0 && word.is_empty() {
            spaces += 1;
            continue;
        }
        if !empty && used + spaces + wide > columns {
            text.push('\n');
            text.push_str(&hanging);
            used = hanging.len();
        } else {
            text.push_str(&" ".repeat(spaces));
            used += spaces;
        }
        text.push_str(word);
        used += wide;
        (spaces, empty) = (1, false);
    }
    text.replace('\u{a0}', " ")
}

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

/// Writes a line of data or summary to stdout. The first error is kept for [`stdout_error`].
pub(crate) fn line(text: impl Display) {
    let written = writeln!(io::stdout(), "{}", fitted(harmless(&text.to_string()), columns()));
    // The reader of a closed pipe, for example `head`, has seen enough.
    if let Some(error) = written.err().filter(|error| error.kind() != io::ErrorKind::BrokenPipe) {
        // Later errors have the same cause.
        let _ = STDOUT_ERROR.set(error);
    }
}

/// The first error of stdout, for example a full disk. A closed pipe is not an error.
pub(crate) fn stdout_error() -> Option<&'static io::Error> {
    STDOUT_ERROR.get()
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

/// The longest line of text in columns: 100, or the width of the terminal if that is less.
pub(crate) fn longest_line() -> usize {
    columns().map_or(LONGEST_LINE, |columns| columns.clamp(40, LONGEST_LINE))
}

/// Writes text in lines of at most [`longest_line`] columns.
pub(crate) fn wrapped(text: &str) {
    let longest = longest_line() - 2;
    let mut so_far = String::from("  ");
    // A number stays with its percent sign.
    for word in text.replace(" %", "\u{a0}%").split([' ', '\n', '\t']).filter(|word| !word.is_empty()) {
        if so_far.chars().count() + word.chars().count() > longest && !so_far.trim().is_empty() {
            line(so_far.trim_end().replace('\u{a0}', " "));
            so_far = String::from("  ");
        }
        so_far.push_str(word);
        so_far.push(' ');
    }
    line(so_far.trim_end().replace('\u{a0}', " "));
}

/// Writes a report.
pub(crate) fn print_report(lines: &[Line]) {
    for (at, text) in lines.iter().enumerate() {
        match text {
            Line::Heading(title) => {
                if at > 0 {
                    line("");
                }
                line(bold(title));
            }
            Line::Subheading(title) => {
                if !matches!(lines.get(at.wrapping_sub(1)), Some(Line::Heading(_) | Line::Subheading(_))) {
                    line("");
                }
                line(bold(format_args!("  {title}")));
            }
            Line::Text(text) => wrapped(text),
            Line::Row(row) => line(format_args!("    {row}")),
        }
    }
}

/// Writes the first sentence of an answer, in bold, in lines of at most [`longest_line`] columns.
pub(crate) fn headline(text: &str) {
    line(bold(folded(text, longest_line())));
}

/// Writes a line for the user to stderr, unless the user wants none.
pub(crate) fn note(text: impl Display) {
    if !QUIET.load(Ordering::Relaxed) {
        tell(&text.to_string());
    }
}

/// Writes a line to stderr, above the live view.
fn tell(text: &str) {
    let write = || {
        // Without stderr there is no place to report to.
        let columns = io::stderr().is_terminal().then(|| Term::stderr().size_checked()).flatten();
        let columns = columns.map(|(_, columns)| usize::from(columns));
        let _ = writeln!(io::stderr(), "{}", fitted(harmless(text), columns));
    };
    match SCREEN.get() {
        Some(screen) => screen.suspend(write),
        None => write(),
    }
}

/// Writes a warning.
pub(crate) fn warning(text: impl Display) {
    tell(&format!("{}: {text}", label("1;33", "warning")));
}

/// Writes what the libraries tell.
struct Notices;

impl log::Log for Notices {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.target() == robogate_session::NOTICES
    }

    fn log(&self, record: &log::Record<'_>) {
        match record.level() {
            _ if !self.enabled(record.metadata()) => {}
            log::Level::Error | log::Level::Warn => warning(record.args()),
            _ => note(record.args()),
        }
    }

    fn flush(&self) {}
}

/// Shows what the libraries tell from now on.
pub(crate) fn show_notices() {
    // Only fails if it was called before.
    let _ = log::set_logger(&Notices).map(|()| log::set_max_level(log::LevelFilter::Info));
}

/// Writes an error.
pub(crate) fn error(exit: &Exit) {
    tell(&format!("{}: {exit}{}", label("1;31", "error"), hint(exit)));
}

/// The hint for a file that the user named and that cannot be opened, unless the error has one.
fn hint(exit: &Exit) -> &'static str {
    if exit.code != USAGE || exit.to_string().contains("Hint:") {
        return "";
    }
    let kind = exit.error.chain().find_map(|cause| Some(cause.downcast_ref::<io::Error>()?.kind()));
    match kind {
        Some(ErrorKind::NotFound | ErrorKind::NotADirectory) => "\nHint: check the path",
        Some(ErrorKind::PermissionDenied) => "\nHint: check the permissions of the file",
        Some(ErrorKind::IsADirectory) => "\nHint: name a file in this folder",
        _ => "",
    }
}

/// A word in a style, if stderr shows colours.
fn label(style: &str, word: &str) -> String {
    if colour(&io::stderr()) { format!("{}{word}{}", mark(style), mark("0")) } else { word.to_owned() }
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
        assert_eq!(indented("not a plan\nHint: \rleave it out"), "not a plan\n    Hint: \\rleave it out");
    }

    #[test]
    fn lines_fit_the_terminal() {
        let text = "  \x1b[1mcollision\x1b[0m   12 of 40  in the weakest group of scenarios";
        assert_eq!(
            fitted(text.to_owned(), Some(30)),
            "  \x1b[1mcollision\x1b[0m   12 of 40  in the\n    weakest group of scenarios"
        );
        assert_eq!(fitted(text.to_owned(), Some(80)), text);
        assert_eq!(fitted(text.to_owned(), None), text);
        assert_eq!(folded("\x1b[2m    one two\x1b[0m", 9), "\x1b[2m    one\n    two\x1b[0m");
        assert_eq!(folded("elsewhere 46.8 %", 15), "elsewhere\n  46.8 %");
        // A path is not broken.
        assert_eq!(folded("a/long/path/without/spaces", 10), "a/long/path/without/spaces");
    }
}
