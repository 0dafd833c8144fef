//! A ZMTP connection after TCP connect: handshake, sending and receiving.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::decoder::{greeting, property, push_frame};
use super::{Decoder, Item, Limits, ZmtpError};

/// Bytes per read.
const CHUNK: usize = 1 << 16;

/// The time at which an operation must be finished.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deadline {
    limit: Duration,
    at: Instant,
}

impl Deadline {
    pub(super) fn new(limit: Duration) -> Self {
        let now = Instant::now();
        // A deadline that the clock cannot represent becomes one in 34 years.
        Self { limit, at: now.checked_add(limit).unwrap_or(now + Duration::from_secs(1 << 30)) }
    }

    /// Time left, or an error if the deadline has passed.
    pub(super) fn left(&self) -> Result<Duration, ZmtpError> {
        let left = self.at.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(self.passed()) } else { Ok(left) }
    }

    pub(super) fn passed(&self) -> ZmtpError {
        ZmtpError::TimedOut(self.limit)
    }
}

/// The type of a socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Req,
    Rep,
}

impl Kind {
    fn as_str(self) -> &'static str {
        match self {
            Self::Req => "REQ",
            Self::Rep => "REP",
        }
    }

    /// The types of peers that it may connect to (RFC 28).
    fn peers(self) -> [&'static str; 2] {
        match self {
            Self::Req => ["REP", "ROUTER"],
            Self::Rep => ["REQ", "DEALER"],
        }
    }
}

#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    decoder: Decoder,
    chunk: Vec<u8>,
    out: Vec<u8>,
}

impl Connection {
    /// Perform the handshake.
    pub(super) fn open(stream: TcpStream, kind: Kind, limits: Limits, deadline: Deadline) -> Result<Self, ZmtpError> {
        stream.set_nodelay(true).map_err(ZmtpError::Io)?;
        let mut connection = Self { stream, decoder: Decoder::new(limits), chunk: vec![0; CHUNK], out: Vec::new() };
        connection.out.extend_from_slice(&greeting());
        connection.flush(deadline)?;
        match connection.next(deadline)? {
            Item::Greeting(_) => {}
            _ => return Err(ZmtpError::Handshake("the peer sent no ZMTP greeting".to_owned())),
        }
        let mut ready = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03".to_vec();
        ready.extend_from_slice(kind.as_str().as_bytes());
        push_frame(&mut connection.out, &ready, false, true);
        connection.flush(deadline)?;
        match connection.next(deadline)? {
            Item::Command(name, properties) if name == b"READY" => {
                let peer = property(&properties, "Socket-Type")?.unwrap_or_default();
                if kind.peers().iter().all(|known| known.as_bytes() != peer) {
                    let (peer, kind) = (peer.escape_ascii(), kind.as_str());
                    return Err(ZmtpError::Handshake(format!(
                        "the peer is a {peer} socket, which cannot connect to a {kind} socket"
                    )));
                }
            }
            Item::Command(name, reason) if name == b"ERROR" => {
                return Err(ZmtpError::Handshake(format!("the peer reports {}", reason.escape_ascii())));
            }
            _ => return Err(ZmtpError::Handshake("the peer sent no READY".to_owned())),
        }
        Ok(connection)
    }

    /// Send an envelope and frames as one message.
    pub(super) fn send<F: AsRef<[u8]>>(
        &mut self,
        envelope: &[Vec<u8>],
        frames: &[F],
        deadline: Deadline,
    ) -> Result<(), ZmtpError> {
        for frame in envelope {
            push_frame(&mut self.out, frame, true, false);
        }
        for (i, frame) in frames.iter().enumerate() {
            push_frame(&mut self.out, frame.as_ref(), i + 1 < frames.len(), false);
        }
        self.flush(deadline)
    }

    /// Receive the next message.
    pub(super) fn receive(&mut self, deadline: Deadline) -> Result<Vec<Vec<u8>>, ZmtpError> {
        loop {
            let item = self.next(deadline)?;
            if let Some(message) = self.message(item, deadline)? {
                return Ok(message);
            }
        }
    }

    /// Receive the next message. Returns `None` if no byte arrives within `idle`. After its first byte, a message must
    /// be complete within `limit`.
    pub(super) fn receive_if_any(
        &mut self,
        idle: Duration,
        limit: Duration,
    ) -> Result<Option<Vec<Vec<u8>>>, ZmtpError> {
        if !self.decoder.has_pending() {
            match self.read(idle) {
                Ok(()) => {}
                Err(why) if is_timeout(&why) => return Ok(None),
                Err(why) => return Err(classify(why)),
            }
        }
        let deadline = Deadline::new(limit);
        let item = self.next(deadline)?;
        self.message(item, deadline)
    }

    /// Process the bytes that have arrived since the last call, without waiting. Fails if the peer closed the
    /// connection or sent a message without a request.
    pub(super) fn catch_up(&mut self, deadline: Deadline) -> Result<(), ZmtpError> {
        loop {
            self.stream.set_nonblocking(true).map_err(ZmtpError::Io)?;
            let read = self.stream.read(&mut self.chunk);
            self.stream.set_nonblocking(false).map_err(ZmtpError::Io)?;
            match read {
                Ok(0) => return Err(ZmtpError::Closed),
                Ok(read) => self.decoder.feed(&self.chunk[..read]),
                Err(why) if is_timeout(&why) => break,
                Err(why) if why.kind() == ErrorKind::Interrupted => {}
                Err(why) => return Err(classify(why)),
            }
            while let Some(item) = self.decoder.next_item()? {
                if self.message(item, deadline)?.is_some() {
                    return Err(ZmtpError::Framing("a message without a request".to_owned()));
                }
            }
        }
        if self.decoder.has_pending() {
            return Err(ZmtpError::Framing("a message without a request".to_owned()));
        }
        Ok(())
    }

    /// Handle an item. Returns the frames of a message; answers or ignores a command.
    fn message(&mut self, item: Item, deadline: Deadline) -> Result<Option<Vec<Vec<u8>>>, ZmtpError> {
        match item {
            Item::Message(frames) => return Ok(Some(frames)),
            // Two bytes of time to live, then the context, which must be returned.
            Item::Command(name, body) if name == b"PING" => {
                let mut pong = b"\x04PONG".to_vec();
                pong.extend_from_slice(body.get(2..).unwrap_or_default());
                push_frame(&mut self.out, &pong, false, true);
                self.flush(deadline)?;
            }
            Item::Command(name, reason) if name == b"ERROR" => {
                return Err(ZmtpError::Framing(format!("the peer reports {}", reason.escape_ascii())));
            }
            Item::Command(..) | Item::Greeting(_) => {}
        }
        Ok(None)
    }

    fn next(&mut self, deadline: Deadline) -> Result<Item, ZmtpError> {
        loop {
            if let Some(item) = self.decoder.next_item()? {
                return Ok(item);
            }
            match self.read(deadline.left()?) {
                Ok(()) => {}
                Err(why) if is_timeout(&why) => return Err(deadline.passed()),
                Err(why) => return Err(classify(why)),
            }
        }
    }

    fn read(&mut self, timeout: Duration) -> std::io::Result<()> {
        self.stream.set_read_timeout(Some(timeout.max(Duration::from_millis(1))))?;
        loop {
            match self.stream.read(&mut self.chunk) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(read) => {
                    self.decoder.feed(&self.chunk[..read]);
                    return Ok(());
                }
                Err(why) if why.kind() == ErrorKind::Interrupted => {}
                Err(why) => return Err(why),
            }
        }
    }

    fn flush(&mut self, deadline: Deadline) -> Result<(), ZmtpError> {
        let mut sent = 0;
        while sent < self.out.len() {
            self.stream.set_write_timeout(Some(deadline.left()?)).map_err(ZmtpError::Io)?;
            match self.stream.write(&self.out[sent..]) {
                Ok(0) => return Err(ZmtpError::Closed),
                Ok(written) => sent += written,
                Err(why) if why.kind() == ErrorKind::Interrupted => {}
                Err(why) if is_timeout(&why) => return Err(deadline.passed()),
                Err(why) => return Err(classify(why)),
            }
        }
        self.out.clear();
        Ok(())
    }
}

fn is_timeout(why: &std::io::Error) -> bool {
    matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn classify(why: std::io::Error) -> ZmtpError {
    match why.kind() {
        ErrorKind::UnexpectedEof | ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => ZmtpError::Closed,
        _ => ZmtpError::Io(why),
    }
}
