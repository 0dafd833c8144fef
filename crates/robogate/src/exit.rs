//! Errors with the exit code of the command.

use std::fmt;

use robogate_campaign::RunError;
use robogate_campaign::shards::ShardError;
use robogate_gate::GateError;
use robogate_gate::evidence::EvidenceError;
use robogate_session::{Failure, FailureKind, OrFailure, chain};

pub(crate) use robogate::exit_codes::{FAIL, INCONCLUSIVE, INFRASTRUCTURE, INTERRUPTED, INVALID, PASS as DONE, USAGE};

/// An error that ends the command, with its exit code.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&chain(&self.error))
    }
}

impl From<Failure> for Exit {
    fn from(failure: Failure) -> Self {
        let code = match failure.kind {
            FailureKind::Request => USAGE,
            FailureKind::Evidence => INVALID,
            FailureKind::Infrastructure => INFRASTRUCTURE,
        };
        Self { code, error: failure.error }
    }
}

/// Errors of the library's parts have the kind that the library gives them.
macro_rules! by_kind {
    ($($error:ty),*) => {$(
        impl From<$error> for Exit {
            fn from(error: $error) -> Self {
                Failure::from(error).into()
            }
        }
    )*};
}

by_kind!(RunError, ShardError, GateError, EvidenceError);

/// Converts an error to an [`Exit`] with the exit code of its class.
pub(crate) trait OrExit<T> {
    /// Exit code 2: wrong usage or configuration.
    fn or_usage(self) -> Result<T, Exit>;
    /// Exit code 5: infrastructure.
    fn or_broken(self) -> Result<T, Exit>;
    /// Exit code 5 if a file cannot be written, otherwise 2.
    fn or_unwritable(self) -> Result<T, Exit>;
}

impl<T, E: Into<anyhow::Error>> OrExit<T> for Result<T, E> {
    fn or_usage(self) -> Result<T, Exit> {
        Ok(self.or_request()?)
    }

    fn or_broken(self) -> Result<T, Exit> {
        Ok(OrFailure::or_broken(self)?)
    }

    fn or_unwritable(self) -> Result<T, Exit> {
        Ok(OrFailure::or_unwritable(self)?)
    }
}
