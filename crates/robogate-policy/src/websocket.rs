//! Requests and replies in msgpack over a WebSocket (RFC 6455), with a thread that answers pings between requests.
//!
//! Upstream servers send a ping every 20 s and close the connection if no pong arrives within another 20 s. A reset of
//! a simulator may take longer than that, so a keep-alive thread polls the socket once a second between requests.

use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use rmpv::ValueRef;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::{HeaderName, HeaderValue};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Bytes, Error, HandshakeError, Message, WebSocket};

use super::access::Access;
use super::deadline::{Deadline, TimedStream};
use super::error::PolicyError;
use super::msgpack;
use super::tls::Wire;

/// Size limit of a reply, in bytes. Real ones, with a whole chunk for two arms, have tens of kilobytes.
pub(crate) const MAX_REPLY: usize = 8 << 20;
/// Time between two polls of the keep-alive thread.
const POLL: Duration = Duration::from_secs(1);
/// Timeout of the closing handshake.
const CLOSE: Duration = Duration::from_millis(200);

/// A received message.
#[derive(Debug)]
pub(crate) enum Reply {
    /// A binary message.
    Bytes(tungstenite::Bytes),
    /// A text message.
    Text(String),
}

/// A connection to a WebSocket server.
#[derive(Debug)]
pub(crate) struct Socket {
    shared: Arc<Shared>,
    keep_alive: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    stream: Mutex<Stream>,
    stopped: Mutex<bool>,
    stop: Condvar,
}

#[derive(Debug)]
struct Stream {
    web: WebSocket<Wire>,
    /// Buffer for the next message, reused because touching new memory takes time.
    buffer: Vec<u8>,
    /// The reason why the stream can no longer be used.
    broken: Option<PolicyError>,
}

/// Extract `host:port` from the address of a WebSocket server, and whether it uses TLS.
fn parse(url: &str) -> Result<(String, bool), PolicyError> {
    let wrong = |why: &str| PolicyError::Address { url: url.to_owned(), why: why.to_owned() };
    let (scheme, rest) = url.split_once("://").ok_or_else(|| wrong("expected ws://HOST:PORT"))?;
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let tls = scheme == "wss";
    let has_port = authority.rsplit_once(':').is_some_and(|(_, port)| !port.contains(']'));
    if tls && !has_port && !authority.is_empty() {
        return Ok((format!("{authority}:443"), tls));
    }
    let (host, port) =
        authority.rsplit_once(':').ok_or_else(|| wrong("the port is missing. Expected ws://HOST:PORT"))?;
    if host.is_empty() || port.parse::<u16>().is_err() {
        return Err(wrong("expected ws://HOST:PORT"));
    }
    Ok((authority.to_owned(), tls))
}

/// Connect and perform the handshakes. `key` is the name and value of the header with the key of the server.
fn open(
    url: &str,
    key: Option<(String, String)>,
    access: &Access,
    deadline: Deadline,
) -> Result<WebSocket<Wire>, PolicyError> {
    let (address, tls) = parse(url)?;
    let stream = TimedStream::connect(url, &address, deadline)?;
    let stream = match address.rsplit_once(':') {
        Some((host, _)) if tls => Wire::encrypt(url, host, stream, access)?,
        _ => Wire::Plain(stream),
    };
    let invalid = |why: String| PolicyError::Address { url: url.to_owned(), why };
    let mut request = url.into_client_request().map_err(|e| invalid(e.to_string()))?;
    if let Some((name, value)) = key {
        let name = HeaderName::try_from(name).map_err(|_| PolicyError::Key("invalid header name".to_owned()))?;
        let value = HeaderValue::try_from(value).map_err(|_| PolicyError::Key("invalid header".to_owned()))?;
        request.headers_mut().insert(name, value);
    }
    let limits = WebSocketConfig::default().max_message_size(Some(MAX_REPLY)).max_frame_size(Some(MAX_REPLY));
    let connected = tungstenite::client::client_with_config(request, stream, Some(limits)).map_err(|e| match e {
        HandshakeError::Interrupted(_) => deadline.passed(format!("the WebSocket handshake with {url}")),
        HandshakeError::Failure(Error::Io(e)) if is_timeout(&e) => {
            deadline.passed(format!("the WebSocket handshake with {url}"))
        }
        HandshakeError::Failure(Error::Http(response)) if (502..=504).contains(&response.status().as_u16()) => {
            let why = format!("HTTP {} for the WebSocket handshake", response.status());
            PolicyError::NotReady { url: url.to_owned(), why }
        }
        HandshakeError::Failure(Error::Http(response)) => {
            PolicyError::invalid_reply("WebSocket handshake", format!("HTTP {}", response.status()))
        }
        HandshakeError::Failure(Error::Url(e)) => PolicyError::Address { url: url.to_owned(), why: e.to_string() },
        HandshakeError::Failure(e) => PolicyError::invalid_reply("WebSocket handshake", e),
    });
    connected.map(|(web, _)| web)
}

impl Socket {
    /// Connect and perform the handshakes. `key` is the name and value of the header with the key of the server.
    pub(crate) fn connect(
        url: &str,
        key: Option<(String, String)>,
        access: &Access,
        deadline: Deadline,
    ) -> Result<Self, PolicyError> {
        let web = open(url, key, access, deadline)?;
        let stream = Mutex::new(Stream { web, buffer: Vec::new(), broken: None });
        let shared = Arc::new(Shared { stream, stopped: Mutex::new(false), stop: Condvar::new() });
        let kept = Arc::clone(&shared);
        let keep_alive = std::thread::Builder::new()
            .name("websocket-keep-alive".to_owned())
            .spawn(move || kept.keep_alive())
            .map_err(|e| PolicyError::Unreachable { url: url.to_owned(), why: e.to_string() })?;
        Ok(Self { shared, keep_alive: Some(keep_alive) })
    }

    /// Receive a message that the server sends without a request.
    pub(crate) fn receive(&self, operation: &str, deadline: Deadline) -> Result<Reply, PolicyError> {
        self.shared.lock().exchange(None, operation, deadline)
    }

    /// Send a request and wait for the reply.
    pub(crate) fn request(
        &self,
        request: &ValueRef<'_>,
        operation: &str,
        deadline: Deadline,
    ) -> Result<Reply, PolicyError> {
        self.shared.lock().exchange(Some(request), operation, deadline)
    }

    /// Check that the server has neither closed the connection nor sent anything since the last reply.
    pub(crate) fn check_idle(&self) -> Result<(), PolicyError> {
        let mut stream = self.shared.lock();
        stream.poll();
        stream.usable()
    }

    /// Send a message that gets no reply.
    pub(crate) fn send(&self, message: &ValueRef<'_>, operation: &str, deadline: Deadline) -> Result<(), PolicyError> {
        self.shared.lock().send(message, operation, deadline)
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        *self.shared.stopped.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.shared.stop.notify_all();
        if let Some(thread) = self.keep_alive.take() {
            // The thread does not panic. If it did, the connection would be closed in the same way.
            let _ = thread.join();
        }
        let mut stream = self.shared.lock();
        if stream.broken.is_none() {
            stream.web.get_mut().stream_mut().deadline = Deadline::within(CLOSE.as_secs_f64());
            // Errors are ignored, because the connection is dropped next.
            let _ = stream.web.close(None).and_then(|()| stream.web.flush());
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Stream> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Poll the stream once a second until the connection is dropped.
    fn keep_alive(&self) {
        let mut stopped = self.stopped.lock().unwrap_or_else(PoisonError::into_inner);
        while !*stopped {
            (stopped, _) = self.stop.wait_timeout(stopped, POLL).unwrap_or_else(PoisonError::into_inner);
            if *stopped {
                return;
            }
            drop(stopped);
            // A running request holds the lock and answers pings itself.
            if let Ok(mut stream) = self.stream.try_lock() {
                stream.poll();
            }
            stopped = self.stopped.lock().unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Stream {
    fn exchange(
        &mut self,
        request: Option<&ValueRef<'_>>,
        operation: &str,
        deadline: Deadline,
    ) -> Result<Reply, PolicyError> {
        if let Some(request) = request {
            self.send(request, operation, deadline)?;
        }
        self.usable()?;
        let reply = self.read(deadline).map_err(|e| classify(e, operation, deadline));
        self.broken = reply.as_ref().err().cloned();
        reply
    }

    fn send(&mut self, message: &ValueRef<'_>, operation: &str, deadline: Deadline) -> Result<(), PolicyError> {
        self.usable()?;
        self.web.get_mut().stream_mut().deadline = deadline;
        let mut bytes = std::mem::take(&mut self.buffer);
        bytes.clear();
        msgpack::encode_into(&mut bytes, message);
        let bytes = Bytes::from(bytes);
        let sent = self.web.send(Message::binary(bytes.clone())).map_err(|e| classify(e, operation, deadline));
        // Clones share memory. The sent one is dropped by now, so this one becomes a vector without a copy.
        self.buffer = bytes.into();
        self.broken = sent.as_ref().err().cloned();
        sent
    }

    fn usable(&self) -> Result<(), PolicyError> {
        self.broken.clone().map_or(Ok(()), Err)
    }

    fn read(&mut self, deadline: Deadline) -> Result<Reply, Error> {
        self.web.get_mut().stream_mut().deadline = deadline;
        loop {
            match self.web.read()? {
                Message::Binary(bytes) => return Ok(Reply::Bytes(bytes)),
                Message::Text(text) => return Ok(Reply::Text(text.to_string())),
                Message::Close(frame) => {
                    let _ = self.web.flush();
                    let reason = frame.map(|f| f.reason.to_string()).unwrap_or_default();
                    return Err(Error::Io(io::Error::new(io::ErrorKind::ConnectionAborted, reason)));
                }
                // Reading has already queued the pong.
                _ => self.web.flush()?,
            }
        }
    }

    /// Answer pings that have arrived. Any other message is an error.
    fn poll(&mut self) {
        if self.broken.is_some() || self.web.get_ref().stream().stream.set_nonblocking(true).is_err() {
            return;
        }
        let received = self.read(Deadline::within(POLL.as_secs_f64()));
        let restored = self.web.get_ref().stream().stream.set_nonblocking(false);
        let when = "between requests";
        self.broken = match (received, restored) {
            (Err(Error::Io(e)), Ok(())) if is_timeout(&e) => None,
            (Err(e), Ok(())) => Some(classify(e, when, Deadline::within(0.0))),
            (Ok(Reply::Text(text)), _) => Some(PolicyError::reported(&text)),
            (Ok(Reply::Bytes(_)), _) => {
                Some(PolicyError::invalid_reply("WebSocket message", "the server sent it without a request".to_owned()))
            }
            (_, Err(e)) => Some(PolicyError::Closed { when: when.to_owned(), reason: format!(": {e}") }),
        };
    }
}

/// What a server of text messages sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Incoming {
    /// A message.
    Text(String),
    /// The answer to a ping. The server received everything that was sent before it.
    Pong,
}

/// A connection to a server that sends text messages at any time. Its owner calls [`TextSocket::receive`] regularly,
/// which also answers pings.
#[derive(Debug)]
pub struct TextSocket(WebSocket<Wire>);

impl TextSocket {
    /// Check the form of an address.
    pub fn check(url: &str) -> Result<(), PolicyError> {
        if !url.starts_with("ws://") && !url.starts_with("wss://") {
            return Err(PolicyError::Address { url: url.to_owned(), why: "expected ws://HOST:PORT".to_owned() });
        }
        parse(url).map(drop)
    }

    /// Connect within a number of seconds. The certificates of `wss://` are those of the system, and no key is sent.
    pub fn connect(url: &str, within_s: f64) -> Result<Self, PolicyError> {
        open(url, None, &Access::default(), Deadline::within(within_s)).map(Self)
    }

    /// Send a text, or a ping.
    pub fn send(&mut self, text: Option<String>, within_s: f64) -> Result<(), PolicyError> {
        let deadline = Deadline::within(within_s);
        self.0.get_mut().stream_mut().deadline = deadline;
        let message = text.map_or_else(|| Message::Ping(Bytes::new()), Message::text);
        self.0.send(message).map_err(|e| classify(e, "sending a message", deadline))
    }

    /// Wait for the next message. `None` if no message arrives within this number of seconds.
    pub fn receive(&mut self, within_s: f64) -> Result<Option<Incoming>, PolicyError> {
        let deadline = Deadline::within(within_s);
        self.0.get_mut().stream_mut().deadline = deadline;
        loop {
            match self.0.read() {
                Ok(Message::Text(text)) => return Ok(Some(Incoming::Text(text.to_string()))),
                Ok(Message::Pong(_)) => return Ok(Some(Incoming::Pong)),
                Ok(Message::Binary(_)) => {
                    let why = "a binary message. Expected text".to_owned();
                    return Err(PolicyError::invalid_reply("WebSocket message", why));
                }
                // Reading has already queued the answer, and the next read reports that the connection is closed.
                Ok(_) => self.0.flush().map_err(|e| classify(e, "receiving a message", deadline))?,
                Err(Error::Io(e)) if is_timeout(&e) => return Ok(None),
                Err(e) => return Err(classify(e, "receiving a message", deadline)),
            }
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

fn classify(error: Error, operation: &str, deadline: Deadline) -> PolicyError {
    match error {
        Error::Io(e) if is_timeout(&e) => deadline.passed(operation),
        Error::Io(e) => {
            let text = e.to_string();
            let reason = if text.is_empty() { text } else { format!(": {text}") };
            PolicyError::Closed { when: during(operation), reason }
        }
        Error::ConnectionClosed
        | Error::AlreadyClosed
        | Error::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake) => {
            PolicyError::Closed { when: during(operation), reason: String::new() }
        }
        Error::Capacity(_) => PolicyError::TooLarge { limit: MAX_REPLY },
        other => PolicyError::invalid_reply("WebSocket frame", other),
    }
}

fn during(operation: &str) -> String {
    if operation.starts_with("between ") { operation.to_owned() } else { format!("during {operation}") }
}
