//! One question in msgpack, one answer over a WebSocket (RFC 6455), with a keeper who answers pings while nobody asks.
//!
//! Upstream servers ping every 20 s and hang up when nobody answers within 20 more. An evaluator is silent for longer
//! than that while a simulator is reset, so a thread looks at the socket once a second between questions.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rmpv::ValueRef;
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Bytes, Error, HandshakeError, Message, WebSocket};

use super::error::ServerError;
use super::msgpack;

/// Longest answer. The longest real ones, of a whole chunk for two arms, have tens of kilobytes.
pub(crate) const MAX_ANSWER: usize = 8 << 20;
/// How often the keeper looks.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How long saying goodbye may take.
const GOODBYE: Duration = Duration::from_millis(200);

/// A moment by which something must have happened, and how long that was from the start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadline {
    at: Instant,
    limit_s: f64,
}

impl Deadline {
    /// In so many seconds from now.
    pub(crate) fn within(limit_s: f64) -> Self {
        Self { at: Instant::now() + Duration::from_secs_f64(limit_s), limit_s }
    }

    /// What is left, if anything.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.at.checked_duration_since(Instant::now()).filter(|left| !left.is_zero())
    }

    /// The error that it has passed.
    pub(crate) fn passed(&self, what: impl Into<String>) -> ServerError {
        ServerError::Timeout { what: what.into(), limit_s: self.limit_s }
    }
}

/// A TCP stream on which no read or write outlasts a deadline, however the bytes drip.
#[derive(Debug)]
pub(crate) struct Timed {
    stream: TcpStream,
    deadline: Deadline,
}

impl Timed {
    /// Connects to `host:port`.
    pub(crate) fn connect(url: &str, address: &str, deadline: Deadline) -> Result<Self, ServerError> {
        let unreachable = |why: String| ServerError::Unreachable { url: url.to_owned(), why };
        let addresses = address.to_socket_addrs().map_err(|e| unreachable(e.to_string()))?;
        let mut last = unreachable("the name has no address".to_owned());
        for address in addresses {
            let left = deadline.left().ok_or_else(|| deadline.passed(format!("connecting to {url}")))?;
            match TcpStream::connect_timeout(&address, left) {
                Ok(stream) => {
                    // Small questions go out at once. A stream without the option is slow, not wrong.
                    let _ = stream.set_nodelay(true);
                    return Ok(Self { stream, deadline });
                }
                Err(e) => last = unreachable(e.to_string()),
            }
        }
        Err(last)
    }

    fn left(&self) -> io::Result<Duration> {
        self.deadline.left().ok_or_else(|| io::ErrorKind::WouldBlock.into())
    }
}

impl Read for Timed {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        self.stream.read(into)
    }
}

impl Write for Timed {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        self.stream.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

/// An answer.
#[derive(Debug)]
pub(crate) enum Answer {
    /// A binary message.
    Bytes(tungstenite::Bytes),
    /// A text message.
    Text(String),
}

/// A connection.
#[derive(Debug)]
pub(crate) struct Socket {
    shared: Arc<Shared>,
    keeper: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    line: Mutex<Line>,
    leave: Mutex<bool>,
    left: Condvar,
}

#[derive(Debug)]
struct Line {
    web: WebSocket<Timed>,
    /// Where the next message is written: memory that has been touched before.
    spare: Vec<u8>,
    /// Why it can no longer be used.
    broken: Option<ServerError>,
}

/// What an address of a WebSocket names: `host:port`, and the path.
pub(crate) fn parse(url: &str) -> Result<String, ServerError> {
    let wrong = |why: &str| ServerError::Address { url: url.to_owned(), why: why.to_owned() };
    if url.starts_with("wss://") {
        return Err(wrong("TLS is not spoken here; put a proxy on this machine and name it as ws://127.0.0.1:PORT"));
    }
    let rest = url.strip_prefix("ws://").ok_or_else(|| wrong("it must begin with ws://"))?;
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let (host, port) = authority.rsplit_once(':').ok_or_else(|| wrong("the port is missing: ws://HOST:PORT"))?;
    if host.is_empty() || port.parse::<u16>().is_err() {
        return Err(wrong("it must be ws://HOST:PORT"));
    }
    Ok(authority.to_owned())
}

impl Socket {
    /// Connects and shakes hands.
    pub(crate) fn connect(url: &str, deadline: Deadline) -> Result<Self, ServerError> {
        let address = parse(url)?;
        let stream = Timed::connect(url, &address, deadline)?;
        let limits = WebSocketConfig::default().max_message_size(Some(MAX_ANSWER)).max_frame_size(Some(MAX_ANSWER));
        let (web, _) = tungstenite::client::client_with_config(url, stream, Some(limits)).map_err(|e| match e {
            HandshakeError::Interrupted(_) => deadline.passed(format!("the WebSocket handshake with {url}")),
            HandshakeError::Failure(Error::Io(e)) if is_late(&e) => {
                deadline.passed(format!("the WebSocket handshake with {url}"))
            }
            HandshakeError::Failure(Error::Http(response)) => {
                ServerError::undecodable("the WebSocket handshake", format!("HTTP {}", response.status()))
            }
            HandshakeError::Failure(Error::Url(e)) => ServerError::Address { url: url.to_owned(), why: e.to_string() },
            HandshakeError::Failure(e) => ServerError::undecodable("the WebSocket handshake", e),
        })?;
        let line = Mutex::new(Line { web, spare: Vec::new(), broken: None });
        let shared = Arc::new(Shared { line, leave: Mutex::new(false), left: Condvar::new() });
        let kept = Arc::clone(&shared);
        let keeper = std::thread::Builder::new()
            .name("websocket-keeper".to_owned())
            .spawn(move || kept.keep())
            .map_err(|e| ServerError::Unreachable { url: url.to_owned(), why: e.to_string() })?;
        Ok(Self { shared, keeper: Some(keeper) })
    }

    /// The next message, which comes unasked.
    pub(crate) fn hear(&self, what: &str, deadline: Deadline) -> Result<Answer, ServerError> {
        self.shared.lock().exchange(None, what, deadline)
    }

    /// Says something and waits for the answer.
    pub(crate) fn ask(&self, question: &ValueRef<'_>, what: &str, deadline: Deadline) -> Result<Answer, ServerError> {
        self.shared.lock().exchange(Some(question), what, deadline)
    }

    /// Says something to which no answer comes.
    pub(crate) fn tell(&self, message: &ValueRef<'_>, what: &str, deadline: Deadline) -> Result<(), ServerError> {
        self.shared.lock().tell(message, what, deadline)
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        *self.shared.leave.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.shared.left.notify_all();
        if let Some(keeper) = self.keeper.take() {
            // The keeper does not panic, and if it did there is nothing left to keep.
            let _ = keeper.join();
        }
        let mut line = self.shared.lock();
        if line.broken.is_none() {
            line.web.get_mut().deadline = Deadline::within(GOODBYE.as_secs_f64());
            // A server that is gone needs no goodbye.
            let _ = line.web.close(None).and_then(|()| line.web.flush());
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the line once a second until told to leave.
    fn keep(&self) {
        let mut leave = self.leave.lock().unwrap_or_else(PoisonError::into_inner);
        while !*leave {
            (leave, _) = self.left.wait_timeout(leave, LOOK_EVERY).unwrap_or_else(PoisonError::into_inner);
            if *leave {
                return;
            }
            drop(leave);
            // Whoever asks answers pings as well.
            if let Ok(mut line) = self.line.try_lock() {
                line.look();
            }
            leave = self.leave.lock().unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Line {
    fn exchange(
        &mut self,
        question: Option<&ValueRef<'_>>,
        what: &str,
        deadline: Deadline,
    ) -> Result<Answer, ServerError> {
        if let Some(question) = question {
            self.tell(question, what, deadline)?;
        }
        self.usable()?;
        let answer = self.read(deadline).map_err(|e| named(e, what, deadline));
        self.broken = answer.as_ref().err().cloned();
        answer
    }

    fn tell(&mut self, message: &ValueRef<'_>, what: &str, deadline: Deadline) -> Result<(), ServerError> {
        self.usable()?;
        self.web.get_mut().deadline = deadline;
        let mut bytes = std::mem::take(&mut self.spare);
        bytes.clear();
        msgpack::encode_into(&mut bytes, message);
        let bytes = Bytes::from(bytes);
        let sent = self.web.send(Message::binary(bytes.clone())).map_err(|e| named(e, what, deadline));
        // A clone is the same memory. What was sent is gone, so this is the last one, and becomes a vector again as it is.
        self.spare = bytes.into();
        self.broken = sent.as_ref().err().cloned();
        sent
    }

    fn usable(&self) -> Result<(), ServerError> {
        self.broken.clone().map_or(Ok(()), Err)
    }

    fn read(&mut self, deadline: Deadline) -> Result<Answer, Error> {
        self.web.get_mut().deadline = deadline;
        loop {
            match self.web.read()? {
                Message::Binary(bytes) => return Ok(Answer::Bytes(bytes)),
                Message::Text(text) => return Ok(Answer::Text(text.to_string())),
                Message::Close(frame) => {
                    let _ = self.web.flush();
                    let reason = frame.map(|f| f.reason.to_string()).unwrap_or_default();
                    return Err(Error::Io(io::Error::new(io::ErrorKind::ConnectionAborted, reason)));
                }
                // Reading has queued the pong already; the next read or this one sends it.
                _ => self.web.flush()?,
            }
        }
    }

    /// Answers pings that have come in. Anything else that comes unasked breaks the line.
    fn look(&mut self) {
        if self.broken.is_some() || self.web.get_ref().stream.set_nonblocking(true).is_err() {
            return;
        }
        let heard = self.read(Deadline::within(LOOK_EVERY.as_secs_f64()));
        let restored = self.web.get_ref().stream.set_nonblocking(false);
        let when = "while it was not asked";
        self.broken = match (heard, restored) {
            (Err(Error::Io(e)), Ok(())) if is_late(&e) => None,
            (Err(e), Ok(())) => Some(named(e, when, Deadline::within(0.0))),
            (Ok(Answer::Text(text)), _) => Some(ServerError::refused(&text)),
            (Ok(Answer::Bytes(_)), _) => {
                Some(ServerError::undecodable("a message", "it came without a question".to_owned()))
            }
            (_, Err(e)) => Some(ServerError::Closed { when: when.to_owned(), reason: format!(": {e}") }),
        };
    }
}

fn is_late(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

fn named(error: Error, what: &str, deadline: Deadline) -> ServerError {
    match error {
        Error::Io(e) if is_late(&e) => deadline.passed(what),
        Error::Io(e) => {
            let text = e.to_string();
            let reason = if text.is_empty() { text } else { format!(": {text}") };
            ServerError::Closed { when: during(what), reason }
        }
        Error::ConnectionClosed
        | Error::AlreadyClosed
        | Error::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake) => {
            ServerError::Closed { when: during(what), reason: String::new() }
        }
        Error::Capacity(_) => ServerError::TooLarge { limit: MAX_ANSWER },
        other => ServerError::undecodable("a WebSocket frame", other),
    }
}

fn during(what: &str) -> String {
    if what.starts_with("while ") { what.to_owned() } else { format!("during {what}") }
}
