//! Decodes the bytes of a peer. It is independent of sockets, so tests can use any bytes.

use super::{Limits, ZmtpError};

/// Length of a greeting in bytes.
pub(super) const GREETING: usize = 64;
/// Largest command, in bytes. A READY with its few properties has less than a hundred.
const COMMAND_LIMIT: u64 = 4096;
/// Flags of a frame (RFC 37): more frames follow, the length has 8 bytes, the frame is a command.
const MORE: u8 = 1;
const LONG: u8 = 2;
const COMMAND: u8 = 4;

/// The greeting of this side: ZMTP 3.1, mechanism NULL.
pub(super) fn greeting() -> [u8; GREETING] {
    let mut bytes = [0; GREETING];
    bytes[0] = 0xff;
    bytes[9] = 0x7f;
    bytes[10] = 3;
    bytes[11] = 1;
    bytes[12..16].copy_from_slice(b"NULL");
    bytes
}

/// Append a frame.
pub(super) fn push_frame(out: &mut Vec<u8>, body: &[u8], more: bool, command: bool) {
    let flags = if more { MORE } else { 0 } | if command { COMMAND } else { 0 };
    match u8::try_from(body.len()) {
        Ok(length) => out.extend_from_slice(&[flags, length]),
        Err(_) => {
            out.push(flags | LONG);
            out.extend_from_slice(&(body.len() as u64).to_be_bytes());
        }
    }
    out.extend_from_slice(body);
}

/// The first bytes of a peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Greeting {
    /// Version of ZMTP of the peer: major, minor.
    pub version: (u8, u8),
}

/// A unit of the protocol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Item {
    /// The greeting; always the first item, and only once.
    Greeting(Greeting),
    /// A command: name and body.
    Command(Vec<u8>, Vec<u8>),
    /// A complete message: its frames.
    Message(Vec<Vec<u8>>),
}

/// Splits a stream of bytes into items, within limits.
#[derive(Debug)]
pub struct Decoder {
    limits: Limits,
    greeted: bool,
    bytes: Vec<u8>,
    /// Number of bytes that are already decoded.
    used: usize,
    /// Frames of the incomplete message, and the sum of their sizes.
    frames: Vec<Vec<u8>>,
    size: u64,
}

impl Decoder {
    /// Create a decoder at the start of a connection.
    pub fn new(limits: Limits) -> Self {
        Self { limits, greeted: false, bytes: Vec::new(), used: 0, frames: Vec::new(), size: 0 }
    }

    /// Add received bytes.
    pub fn feed(&mut self, bytes: &[u8]) {
        if self.used > 0 {
            self.bytes.drain(..self.used);
            self.used = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// Whether bytes of an incomplete item, or items not yet returned, are left.
    pub fn has_pending(&self) -> bool {
        self.used < self.bytes.len() || !self.frames.is_empty()
    }

    /// The next item. `None` if more bytes are needed. After an error the decoder must not be used again.
    pub fn next_item(&mut self) -> Result<Option<Item>, ZmtpError> {
        if !self.greeted {
            return self.next_greeting();
        }
        loop {
            let rest = &self.bytes[self.used..];
            let Some(&flags) = rest.first() else { return Ok(None) };
            if flags & !(MORE | LONG | COMMAND) != 0 || flags & (MORE | COMMAND) == MORE | COMMAND {
                return Err(ZmtpError::Framing(format!("a frame has the flags {flags:#04x}")));
            }
            let (length, head) = if flags & LONG == 0 {
                let Some(&length) = rest.get(1) else { return Ok(None) };
                (u64::from(length), 2)
            } else {
                let Some(length) = rest.get(1..9).and_then(|bytes| bytes.try_into().ok()) else { return Ok(None) };
                (u64::from_be_bytes(length), 9)
            };
            self.check_limits(flags, length)?;
            // A length within the limits fits into usize.
            let Some(body) = usize::try_from(length).ok().and_then(|length| rest.get(head..head + length)) else {
                return Ok(None);
            };
            let body = body.to_vec();
            self.used += head + body.len();
            if flags & COMMAND != 0 {
                if !self.frames.is_empty() {
                    return Err(ZmtpError::Framing("a command inside a message".to_owned()));
                }
                return command(body).map(Some);
            }
            self.size += length;
            self.frames.push(body);
            if flags & MORE == 0 {
                self.size = 0;
                return Ok(Some(Item::Message(std::mem::take(&mut self.frames))));
            }
        }
    }

    /// Check the length of a frame against the limits.
    fn check_limits(&self, flags: u8, length: u64) -> Result<(), ZmtpError> {
        let check = |what, unit, size, limit| {
            if size > limit { Err(ZmtpError::TooLarge { what, unit, size, limit }) } else { Ok(()) }
        };
        if flags & COMMAND != 0 {
            return check("a command", "bytes", length, COMMAND_LIMIT);
        }
        check("a frame", "bytes", length, self.limits.frame_bytes as u64)?;
        check("a message", "bytes", self.size + length, self.limits.message_bytes as u64)?;
        // The delimiter frame is not counted.
        check("a message", "frames", self.frames.len() as u64, self.limits.frames as u64)
    }

    fn next_greeting(&mut self) -> Result<Option<Item>, ZmtpError> {
        let rest = &self.bytes[self.used..];
        let wrong = |what: &str| Err(ZmtpError::Handshake(what.to_owned()));
        if rest.first().is_some_and(|byte| *byte != 0xff) || rest.get(9).is_some_and(|byte| byte & 1 == 0) {
            return wrong("the peer sent no ZMTP greeting");
        }
        if let Some(major) = rest.get(10).filter(|major| **major < 3) {
            return wrong(&format!("the peer uses version {major}"));
        }
        let Some(rest) = rest.get(..GREETING) else { return Ok(None) };
        let mechanism = &rest[12..32];
        if mechanism.strip_prefix(b"NULL").is_none_or(|padding| padding.iter().any(|byte| *byte != 0)) {
            let name = mechanism.split(|byte| *byte == 0).next().unwrap_or_default();
            return wrong(&format!("the peer requires the security mechanism {}", name.escape_ascii()));
        }
        let version = (rest[10], rest[11]);
        self.used += GREETING;
        self.greeted = true;
        Ok(Some(Item::Greeting(Greeting { version })))
    }
}

/// Split a command into name and body.
fn command(mut body: Vec<u8>) -> Result<Item, ZmtpError> {
    let length = body.first().map_or(0, |length| usize::from(*length));
    if length == 0 || body.len() < 1 + length {
        return Err(ZmtpError::Framing("a command without a name".to_owned()));
    }
    let rest = body.split_off(1 + length);
    body.remove(0);
    Ok(Item::Command(body, rest))
}

/// The value of a property in the body of READY.
pub(super) fn property<'a>(mut list: &'a [u8], wanted: &str) -> Result<Option<&'a [u8]>, ZmtpError> {
    let broken = || ZmtpError::Handshake("the READY of the peer is truncated".to_owned());
    let mut found = None;
    while let Some((&length, rest)) = list.split_first() {
        let (name, rest) = rest.split_at_checked(usize::from(length)).ok_or_else(broken)?;
        let (length, rest) = rest.split_first_chunk::<4>().ok_or_else(broken)?;
        let length = usize::try_from(u32::from_be_bytes(*length)).map_err(|_| broken())?;
        let (value, rest) = rest.split_at_checked(length).ok_or_else(broken)?;
        if name.eq_ignore_ascii_case(wanted.as_bytes()) {
            found = Some(value);
        }
        list = rest;
    }
    Ok(found)
}
