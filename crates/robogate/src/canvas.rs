//! The place of live views: stderr, if it is a terminal that can move its cursor.

use std::io::{self, IsTerminal};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use console::Term;
use indicatif::{MultiProgress, ProgressDrawTarget, TermLike};

/// Redraws per second.
const HZ: u8 = 15;
/// Columns that stay free at the right edge: the terminal writes `^C` there.
const MARGIN: u16 = 4;

/// The bars of this process. They are hidden without a terminal, and if the user wants to see none.
pub(crate) fn bars(quiet: bool) -> MultiProgress {
    let able = !quiet && io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
    let target = if able {
        ProgressDrawTarget::term_like_with_hz(Box::new(Canvas::new()), HZ)
    } else {
        ProgressDrawTarget::hidden()
    };
    MultiProgress::with_draw_target(target)
}

/// A terminal whose cursor stays behind the text of the last line.
///
/// The library fills each line with spaces up to the right edge, so the next character begins a new line. The `^C` that
/// the terminal itself writes would then move the view down by a line, and its first line would stay.
///
/// A terminal may disappear while the process runs. The library panics if it cannot draw, with its lock held, so errors are not
/// passed on: the view ends, and the run goes on until the signal of the lost terminal stops it.
#[derive(Debug)]
struct Canvas {
    term: Term,
    next: Mutex<Next>,
    lost: AtomicBool,
}

/// What the library writes next. It writes each line as its text and then spaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    FirstText,
    Text,
    Spaces,
}

impl Canvas {
    fn new() -> Self {
        Self { term: Term::buffered_stderr(), next: Mutex::new(Next::FirstText), lost: AtomicBool::new(false) }
    }

    /// Writes, unless the terminal is lost.
    fn draw(&self, write: impl FnOnce(&Term) -> io::Result<()>) -> io::Result<()> {
        if !self.lost.load(Ordering::Relaxed) && write(&self.term).is_err() {
            self.lost.store(true, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Moves on, and returns what is written now.
    fn advance(&self) -> Next {
        // A panic in another thread leaves a valid value.
        let mut next = self.next.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let now = *next;
        *next = if now == Next::Spaces { Next::Text } else { Next::Spaces };
        now
    }

    fn restart(&self) {
        *self.next.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Next::FirstText;
    }
}

impl TermLike for Canvas {
    fn width(&self) -> u16 {
        self.term.size().1.saturating_sub(MARGIN).max(1)
    }

    fn height(&self) -> u16 {
        self.term.size().0
    }

    fn move_cursor_up(&self, n: usize) -> io::Result<()> {
        self.restart();
        self.draw(|term| term.move_cursor_up(n))
    }

    fn move_cursor_down(&self, n: usize) -> io::Result<()> {
        self.draw(|term| term.move_cursor_down(n))
    }

    fn move_cursor_right(&self, n: usize) -> io::Result<()> {
        self.draw(|term| term.move_cursor_right(n))
    }

    fn move_cursor_left(&self, n: usize) -> io::Result<()> {
        self.draw(|term| term.move_cursor_left(n))
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.draw(|term| term.write_line(text))
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        match self.advance() {
            Next::FirstText => self.draw(|term| term.write_str(text)),
            Next::Text => self.draw(|term| term.write_str(&format!("\n{text}"))),
            Next::Spaces => Ok(()),
        }
    }

    fn clear_line(&self) -> io::Result<()> {
        self.draw(Term::clear_line)
    }

    fn flush(&self) -> io::Result<()> {
        self.restart();
        self.draw(Term::flush)
    }
}
