//! One server and the questions to it.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::time::Duration;

use robogate_core::{Fault, FaultKind};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::bounds::{self, Malformed, VERSION};
use super::message::{Envelope, ErrorKind, Hello, Nothing, Refusal, Request, decode, encode};
use robogate_zmtp::{Address, Requester, ZmtpError};

/// How long answers may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// To connect and to say hello.
    pub hello: Duration,
    /// To set an episode up.
    pub reset: Duration,
    /// For anything else.
    pub step: Duration,
}

impl Patience {
    /// So long for a step, and as long again for a hello; a reset may have four times that.
    pub fn of(step: Duration) -> Self {
        Self { hello: step, reset: step.saturating_mul(4), step }
    }
}

impl Default for Patience {
    fn default() -> Self {
        Self::of(Duration::from_secs(30))
    }
}

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// The connection.
    #[error(transparent)]
    Zmtp(#[from] ZmtpError),
    /// The answer's bytes.
    #[error("its answer breaks the protocol: {0}")]
    Malformed(#[from] Malformed),
    /// What the answer says.
    #[error("its answer is not to be believed: {0}")]
    Lie(String),
    /// The server said no.
    #[error("{}", .0.detail)]
    Refused(Refusal),
    /// This side found what is wrong.
    #[error("{}", .0.detail)]
    Here(Fault),
}

impl AskError {
    /// Whether the server is at fault, and not the scenario or the action.
    pub fn blames_server(&self) -> bool {
        match self {
            Self::Zmtp(_) | Self::Malformed(_) | Self::Lie(_) => true,
            Self::Refused(refusal) => refusal.kind.fault() == FaultKind::Unavailable,
            Self::Here(fault) => fault.kind == FaultKind::Unavailable,
        }
    }

    /// What it is to an episode.
    pub fn fault(&self, address: &Address) -> Fault {
        let kind = match self {
            Self::Zmtp(_) | Self::Malformed(_) | Self::Lie(_) => FaultKind::Unavailable,
            Self::Refused(refusal) => refusal.kind.fault(),
            Self::Here(fault) => fault.kind,
        };
        Fault::new(kind, format!("{address}: {self}"))
    }
}

/// A server, and the episode under way in it.
#[derive(Debug)]
pub struct Link {
    requester: Requester,
    patience: Patience,
    hello: Hello,
    /// The number of the episode under way.
    pub(super) episode: u64,
    /// Control periods run in it.
    pub(super) tick: u64,
}

impl Link {
    /// Connects and asks who is there.
    pub fn connect(address: Address, patience: Patience) -> Result<Self, AskError> {
        let mut requester = Requester::new(address, bounds::REPLY);
        let (hello, _): (Hello, _) = ask(&mut requester, "hello", 0, Nothing {}, patience.hello)?;
        hello.check().map_err(AskError::Lie)?;
        Ok(Self { requester, patience, hello, episode: 0, tick: 0 })
    }

    /// Who is there.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Where.
    pub fn address(&self) -> &Address {
        self.requester.address()
    }

    /// Asks for a new episode, under a number that nobody else uses.
    pub(super) fn begin<T: DeserializeOwned>(&mut self, body: impl Serialize) -> Result<T, AskError> {
        // The standard library's own randomness: it names an exchange and has no part in its result.
        self.episode = RandomState::new().build_hasher().finish() | 1;
        self.tick = 0;
        let (answer, frames) = ask(&mut self.requester, "reset", self.episode, body, self.patience.reset)?;
        self.alone(&frames)?;
        Ok(answer)
    }

    /// Asks something of the episode under way that is answered by a header alone.
    pub(super) fn ask<T: DeserializeOwned>(&mut self, op: &str, body: impl Serialize) -> Result<T, AskError> {
        let (answer, frames) = self.ask_frames(op, body)?;
        self.alone(&frames)?;
        Ok(answer)
    }

    /// Asks something of the episode under way.
    pub(super) fn ask_frames<T: DeserializeOwned>(
        &mut self,
        op: &str,
        body: impl Serialize,
    ) -> Result<(T, Vec<Vec<u8>>), AskError> {
        ask(&mut self.requester, op, self.episode, body, self.patience.step)
    }

    /// Sends bytes as they are, for whoever wants to know what becomes of them.
    pub(super) fn ask_raw(&mut self, frames: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, ZmtpError> {
        self.requester.ask(frames, self.patience.step)
    }

    /// Drops the connection: what comes late is never heard.
    pub(super) fn disconnect(&mut self) {
        self.requester.disconnect();
    }

    fn alone(&mut self, frames: &[Vec<u8>]) -> Result<(), AskError> {
        if frames.is_empty() {
            return Ok(());
        }
        self.requester.disconnect();
        Err(AskError::Lie(format!("{} frames follow a header that speaks of none", frames.len())))
    }
}

fn ask<T: DeserializeOwned>(
    requester: &mut Requester,
    op: &str,
    episode: u64,
    body: impl Serialize,
    within: Duration,
) -> Result<(T, Vec<Vec<u8>>), AskError> {
    let request = encode(&Request { v: VERSION, op: op.to_owned(), episode, body })?;
    let mut frames = requester.ask(&[request], within)?;
    let header = if frames.is_empty() { Vec::new() } else { frames.remove(0) };
    let answer = read(&header, episode);
    // After an answer that cannot be right there is no telling what comes next.
    if matches!(answer, Err(AskError::Malformed(_) | AskError::Lie(_))) {
        requester.disconnect();
    }
    Ok((answer?, frames))
}

/// What an answer for this episode says.
pub(super) fn read<T: DeserializeOwned>(header: &[u8], episode: u64) -> Result<T, AskError> {
    let envelope: Envelope = decode(header)?;
    if envelope.v != VERSION {
        return Err(AskError::Lie(format!("it is of version {}, {VERSION} was asked for", envelope.v)));
    }
    // Who cannot read a request cannot name its episode.
    let unread = episode != 0 && !envelope.ok && envelope.episode == 0;
    if envelope.episode != episode && !unread {
        return Err(AskError::Lie(format!("it is of episode {}, not {episode}", envelope.episode)));
    }
    match (envelope.ok, envelope.error) {
        (true, _) => Ok(decode(header)?),
        (false, Some(mut refusal)) => {
            refusal.detail = refusal.detail.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
            Err(AskError::Refused(refusal))
        }
        (false, None) => {
            Err(AskError::Refused(Refusal { kind: ErrorKind::Internal, detail: "no reason given".into() }))
        }
    }
}
