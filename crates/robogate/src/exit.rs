//! Errors with the exit code of the command.

use std::error::Error;
use std::fmt;
use std::io;

use robogate_physics::RobotError;

pub(crate) use robogate::exit_codes::{FAIL, INFRASTRUCTURE, INTERRUPTED, INVALID, PASS as DONE, USAGE};

/// An error that ends the command, with its exit code.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // One line for each cause. A cause that the line above already contains is left out.
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

/// Converts an error to an [`Exit`] with the exit code of its class.
pub(crate) trait OrExit<T> {
    /// Exit code 2: wrong usage or configuration.
    fn or_usage(self) -> Result<T, Exit>;
    /// Exit code 5: infrastructure.
    fn or_broken(self) -> Result<T, Exit>;
    /// Exit code 5 if a file cannot be written, otherwise 2.
    fn or_unwritable(self) -> Result<T, Exit>;
    /// Exit code 5 if the engine's library cannot be loaded, otherwise 2.
    fn or_setup(self) -> Result<T, Exit>;
}

impl<T, E: Into<anyhow::Error>> OrExit<T> for Result<T, E> {
    fn or_usage(self) -> Result<T, Exit> {
        self.map_err(|e| Exit { code: USAGE, error: e.into() })
    }

    fn or_broken(self) -> Result<T, Exit> {
        self.map_err(|e| Exit { code: INFRASTRUCTURE, error: e.into() })
    }

    fn or_unwritable(self) -> Result<T, Exit> {
        self.map_err(|e| {
            let error = e.into();
            let code = if error.chain().any(|cause| cause.is::<io::Error>()) { INFRASTRUCTURE } else { USAGE };
            Exit { code, error }
        })
    }

    fn or_setup(self) -> Result<T, Exit> {
        self.map_err(|e| {
            let error = e.into();
            let engine = |cause: &(dyn Error + 'static)| {
                matches!(cause.downcast_ref::<RobotError>(), Some(RobotError::Engine { .. }))
            };
            let code = if error.chain().any(engine) { INFRASTRUCTURE } else { USAGE };
            Exit { code, error }
        })
    }
}
