//! Exit codes: an API that scripts and CI rely on.

use std::fmt;

/// Pass, or done.
pub(crate) const DONE: u8 = 0;
/// A requirement or claim fails.
pub(crate) const FAIL: u8 = 1;
/// Wrong usage or configuration.
pub(crate) const USAGE: u8 = 2;
/// The evidence is invalid, or nothing was evaluated.
pub(crate) const INVALID: u8 = 4;
/// Something under RoboGate broke, or the work is incomplete.
pub(crate) const INFRASTRUCTURE: u8 = 5;
/// Interrupted; `robogate resume` goes on.
pub(crate) const INTERRUPTED: u8 = 130;

/// An error on its way out, with the exit code that its cause has.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The chain of causes on one line each; a cause that the line above already holds is left out.
        let mut last = self.error.to_string();
        f.write_str(&last)?;
        for cause in self.error.chain().skip(1) {
            let text = cause.to_string();
            if !last.contains(&text) {
                write!(f, "\n  because: {text}")?;
                last = text;
            }
        }
        Ok(())
    }
}

/// Gives an error its exit code.
pub(crate) trait OrExit<T> {
    /// Wrong usage or configuration.
    fn or_usage(self) -> Result<T, Exit>;
    /// Infrastructure.
    fn or_broken(self) -> Result<T, Exit>;
}

impl<T, E: Into<anyhow::Error>> OrExit<T> for Result<T, E> {
    fn or_usage(self) -> Result<T, Exit> {
        self.map_err(|e| Exit { code: USAGE, error: e.into() })
    }

    fn or_broken(self) -> Result<T, Exit> {
        self.map_err(|e| Exit { code: INFRASTRUCTURE, error: e.into() })
    }
}
