//! Errors with their kind.

use std::error::Error;
use std::fmt;
use std::io::{self, ErrorKind};

use robogate_campaign::RunError;
use robogate_campaign::shards::ShardError;
use robogate_gate::GateError;
use robogate_gate::evidence::EvidenceError;
use robogate_physics::RobotError;

/// An error that ends what was asked for.
#[derive(Debug)]
pub struct Failure {
    /// Its kind.
    pub kind: FailureKind,
    /// The error with its causes. The message may have several lines; a line that begins with `Hint:` says what to do.
    pub error: anyhow::Error,
}

/// The kind of a [`Failure`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// The user can correct it: a wrong setting, a wrong file, two things that do not fit.
    Request,
    /// The episodes or files are not evidence: they are incomplete, changed, or contradict each other.
    Evidence,
    /// Something is broken or not available: a file that cannot be written, a server that does not answer.
    Infrastructure,
}

impl Failure {
    /// A failure that is infrastructure in this case, otherwise a request.
    pub fn broken_if(infrastructure: bool, error: impl Into<anyhow::Error>) -> Self {
        let kind = if infrastructure { FailureKind::Infrastructure } else { FailureKind::Request };
        Self { kind, error: error.into() }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&chain(&self.error))
    }
}

impl Error for Failure {}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        let request = matches!(
            error,
            RunError::NotEmpty { .. }
                | RunError::AlreadyARun { .. }
                | RunError::InShards { .. }
                | RunError::NotARun { .. }
                | RunError::OtherVersion { .. }
                | RunError::Mismatch { .. }
                | RunError::NoSuchEpisode { .. }
                | RunError::Suite(_)
                | RunError::Plan(_)
        );
        Self::broken_if(!request, error)
    }
}

impl From<GateError> for Failure {
    fn from(error: GateError) -> Self {
        let kind = match &error {
            GateError::EmptyBaseline
            | GateError::MixedLabels { .. }
            | GateError::PlannedSuite { .. }
            | GateError::Copies { .. } => FailureKind::Evidence,
            GateError::Dictionary(_) => FailureKind::Infrastructure,
            _ => FailureKind::Request,
        };
        Self { kind, error: error.into() }
    }
}

impl From<ShardError> for Failure {
    fn from(error: ShardError) -> Self {
        let infrastructure = match error {
            ShardError::Run(error) => return error.into(),
            ShardError::Name(_)
            | ShardError::SingleRun { .. }
            | ShardError::NotInShards { .. }
            | ShardError::OtherCount { .. }
            | ShardError::PlanChanged { .. }
            | ShardError::ForeignFile { .. }
            | ShardError::OtherPlan { .. }
            | ShardError::Misnamed { .. }
            | ShardError::OtherRun { .. } => false,
            // Shards are missing, damaged or contradictory.
            ShardError::Store { .. }
            | ShardError::Damaged { .. }
            | ShardError::DamagedResult { .. }
            | ShardError::Conflict { .. }
            | ShardError::Contradicted { .. }
            | ShardError::NotChosen { .. }
            | ShardError::Missing { .. } => true,
        };
        Self::broken_if(infrastructure, error)
    }
}

impl From<EvidenceError> for Failure {
    fn from(error: EvidenceError) -> Self {
        let infrastructure = match &error {
            EvidenceError::Io { source, .. } => source.kind() != ErrorKind::NotFound,
            EvidenceError::Random(_) => true,
            _ => false,
        };
        match error {
            EvidenceError::Gate(error) => error.into(),
            EvidenceError::Dictionary(error) => GateError::Dictionary(error).into(),
            EvidenceError::Contradicts(_) => Self { kind: FailureKind::Evidence, error: error.into() },
            error => Self::broken_if(infrastructure, error),
        }
    }
}

/// An error with its causes, one line each. A cause that the line above already contains is left out.
pub fn chain(error: &anyhow::Error) -> String {
    let mut last = error.to_string();
    let mut lines = last.clone();
    for cause in error.chain().skip(1) {
        let text = cause.to_string();
        if !last.contains(&text) {
            lines += &format!("\n  because: {text}");
            last = text;
        }
    }
    lines
}

/// Converts an error to a [`Failure`] of a kind.
pub trait OrFailure<T> {
    /// The user can correct it.
    fn or_request(self) -> Result<T, Failure>;
    /// Infrastructure.
    fn or_broken(self) -> Result<T, Failure>;
    /// Infrastructure if a file cannot be read or written, otherwise a request.
    fn or_unwritable(self) -> Result<T, Failure>;
    /// Infrastructure if the engine's library cannot be loaded, otherwise a request.
    fn or_setup(self) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> OrFailure<T> for Result<T, E> {
    fn or_request(self) -> Result<T, Failure> {
        self.map_err(|e| Failure { kind: FailureKind::Request, error: e.into() })
    }

    fn or_broken(self) -> Result<T, Failure> {
        self.map_err(|e| Failure { kind: FailureKind::Infrastructure, error: e.into() })
    }

    fn or_unwritable(self) -> Result<T, Failure> {
        self.map_err(|e| of_cause(e.into(), |cause| cause.is::<io::Error>()))
    }

    fn or_setup(self) -> Result<T, Failure> {
        let engine = |cause: &(dyn Error + 'static)| {
            matches!(cause.downcast_ref::<RobotError>(), Some(RobotError::Engine { .. }))
        };
        self.map_err(|e| of_cause(e.into(), engine))
    }
}

/// Infrastructure if one of the causes is, otherwise a request.
fn of_cause(error: anyhow::Error, infrastructure: impl Fn(&(dyn Error + 'static)) -> bool) -> Failure {
    Failure::broken_if(error.chain().any(infrastructure), error)
}
