//! One connection, after both sides have greeted.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::decoder::{greeting, property, push_frame};
use super::{Decoder, Item, Limits, ZmtpError};

/// Bytes read at once.
const CHUNK: usize = 1 << 16;

/// A time by which something has to be done.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deadline {
    within: Duration,
    at: Instant,
}

impl Deadline {
    pub(super) fn new(within: Duration) -> Self {
        let now = Instant::now();
        // A deadline beyond the clock's end is a long one.
        Self { within, at: now.checked_add(within).unwrap_or(now + Duration::from_secs(1 << 30)) }
    }

    /// What is left of it.
    pub(super) fn left(&self) -> Result<Duration, ZmtpError> {
        let left = self.at.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(self.passed()) } else { Ok(left) }
    }

    pub(super) fn passed(&self) -> ZmtpError {
        ZmtpError::TimedOut(self.within)
    }
}

/// A socket's kind, as READY says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Req,
    Rep,
}

impl Kind {
    fn word(self) -> &'static str {
        match self {
            Self::Req => "REQ",
            Self::Rep => "REP",
        }
    }

    /// The kinds that it may talk to (RFC 28).
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
    /// Greets and is greeted.
    pub(super) fn open(stream: TcpStream, kind: Kind, limits: Limits, deadline: Deadline) -> Result<Self, ZmtpError> {
        stream.set_nodelay(true).map_err(ZmtpError::Io)?;
        let mut connection = Self { stream, decoder: Decoder::new(limits), chunk: vec![0; CHUNK], out: Vec::new() };
        connection.out.extend_from_slice(&greeting());
        connection.flush(deadline)?;
        match connection.next(deadline)? {
            Item::Greeting(_) => {}
            _ => return Err(ZmtpError::Handshake("it does not greet".to_owned())),
        }
        let mut ready = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03".to_vec();
        ready.extend_from_slice(kind.word().as_bytes());
        push_frame(&mut connection.out, &ready, false, true);
        connection.flush(deadline)?;
        match connection.next(deadline)? {
            Item::Command(name, properties) if name == b"READY" => {
                let peer = property(&properties, "Socket-Type")?.unwrap_or_default();
                if kind.peers().iter().all(|known| known.as_bytes() != peer) {
                    let (peer, kind) = (peer.escape_ascii(), kind.word());
                    return Err(ZmtpError::Handshake(format!("it is a {peer} socket, which does not talk to {kind}")));
                }
            }
            Item::Command(name, reason) if name == b"ERROR" => {
                return Err(ZmtpError::Handshake(format!("it says {}", reason.escape_ascii())));
            }
            _ => return Err(ZmtpError::Handshake("READY was due".to_owned())),
        }
        Ok(connection)
    }

    /// Sends the frames as one message.
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

    /// The next message, by the deadline.
    pub(super) fn receive(&mut self, deadline: Deadline) -> Result<Vec<Vec<u8>>, ZmtpError> {
        loop {
            let item = self.next(deadline)?;
            if let Some(message) = self.message(item, deadline)? {
                return Ok(message);
            }
        }
    }

    /// The next message; `None` where nothing began within `patience`. What has begun is whole within `within`.
    pub(super) fn receive_if_any(
        &mut self,
        patience: Duration,
        within: Duration,
    ) -> Result<Option<Vec<Vec<u8>>>, ZmtpError> {
        if !self.decoder.is_amid() {
            match self.read(patience) {
                Ok(()) => {}
                Err(why) if is_timeout(&why) => return Ok(None),
                Err(why) => return Err(broken(why)),
            }
        }
        let deadline = Deadline::new(within);
        let item = self.next(deadline)?;
        self.message(item, deadline)
    }

    /// Hears what the peer said while nobody listened, without waiting. Fails where it is gone, or said something that
    /// was not asked for.
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
                Err(why) => return Err(broken(why)),
            }
            while let Some(item) = self.decoder.next_item()? {
                if self.message(item, deadline)?.is_some() {
                    return Err(ZmtpError::Framing("a message that nobody asked for".to_owned()));
                }
            }
        }
        if self.decoder.is_amid() {
            return Err(ZmtpError::Framing("a message that nobody asked for".to_owned()));
        }
        Ok(())
    }

    /// The message in an item; commands are answered or passed over.
    fn message(&mut self, item: Item, deadline: Deadline) -> Result<Option<Vec<Vec<u8>>>, ZmtpError> {
        match item {
            Item::Message(frames) => return Ok(Some(frames)),
            // Two bytes of time to live, then what has to come back.
            Item::Command(name, body) if name == b"PING" => {
                let mut pong = b"\x04PONG".to_vec();
                pong.extend_from_slice(body.get(2..).unwrap_or_default());
                push_frame(&mut self.out, &pong, false, true);
                self.flush(deadline)?;
            }
            Item::Command(name, reason) if name == b"ERROR" => {
                return Err(ZmtpError::Framing(format!("it reports {}", reason.escape_ascii())));
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
                Err(why) => return Err(broken(why)),
            }
        }
    }

    fn read(&mut self, patience: Duration) -> std::io::Result<()> {
        self.stream.set_read_timeout(Some(patience.max(Duration::from_millis(1))))?;
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
                Err(why) => return Err(broken(why)),
            }
        }
        self.out.clear();
        Ok(())
    }
}

fn is_timeout(why: &std::io::Error) -> bool {
    matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn broken(why: std::io::Error) -> ZmtpError {
    match why.kind() {
        ErrorKind::UnexpectedEof | ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => ZmtpError::Closed,
        _ => ZmtpError::Io(why),
    }
}
