//! From a peer's bytes to what it said. Sees no socket, so that anything can be fed to it.

use super::{Limits, ZmtpError};

/// Bytes of a greeting.
pub(super) const GREETING: usize = 64;
/// Bytes of a command that are taken: a READY with its few properties has under a hundred.
const COMMAND_LIMIT: u64 = 4096;
/// Flags of a frame (RFC 37): more frames follow, the length has 8 bytes, it is a command.
const MORE: u8 = 1;
const LONG: u8 = 2;
const COMMAND: u8 = 4;

/// The greeting that this side sends: ZMTP 3.1, mechanism NULL.
pub(super) fn greeting() -> [u8; GREETING] {
    let mut bytes = [0; GREETING];
    bytes[0] = 0xff;
    bytes[9] = 0x7f;
    bytes[10] = 3;
    bytes[11] = 1;
    bytes[12..16].copy_from_slice(b"NULL");
    bytes
}

/// Appends a frame.
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

/// What a peer says first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Greeting {
    /// Its version of ZMTP: major, minor.
    pub version: (u8, u8),
}

/// Something that a peer said.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Item {
    /// The greeting, once and first.
    Greeting(Greeting),
    /// A command: its name, and what follows it.
    Command(Vec<u8>, Vec<u8>),
    /// A whole message, all of its frames.
    Message(Vec<Vec<u8>>),
}

/// Cuts a stream of bytes into what it says, within limits.
#[derive(Debug)]
pub struct Decoder {
    limits: Limits,
    greeted: bool,
    bytes: Vec<u8>,
    /// What of the bytes has been used.
    used: usize,
    /// The frames of the message under way, and their bytes together.
    frames: Vec<Vec<u8>>,
    size: u64,
}

impl Decoder {
    /// A decoder at the start of a connection.
    pub fn new(limits: Limits) -> Self {
        Self { limits, greeted: false, bytes: Vec::new(), used: 0, frames: Vec::new(), size: 0 }
    }

    /// Takes bytes as they came.
    pub fn feed(&mut self, bytes: &[u8]) {
        if self.used > 0 {
            self.bytes.drain(..self.used);
            self.used = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// Whether something has begun and is not whole yet, or is whole and was not asked for.
    pub fn is_amid(&self) -> bool {
        self.used < self.bytes.len() || !self.frames.is_empty()
    }

    /// The next thing said; `None` until more bytes come. After an error there is no sense in what follows.
    pub fn next_item(&mut self) -> Result<Option<Item>, ZmtpError> {
        if !self.greeted {
            return self.next_greeting();
        }
        loop {
            let rest = &self.bytes[self.used..];
            let Some(&flags) = rest.first() else { return Ok(None) };
            if flags & !(MORE | LONG | COMMAND) != 0 || flags & (MORE | COMMAND) == MORE | COMMAND {
                return Err(ZmtpError::Framing(format!("a frame with flags {flags:#04x}")));
            }
            let (length, head) = if flags & LONG == 0 {
                let Some(&length) = rest.get(1) else { return Ok(None) };
                (u64::from(length), 2)
            } else {
                let Some(length) = rest.get(1..9).and_then(|bytes| bytes.try_into().ok()) else { return Ok(None) };
                (u64::from_be_bytes(length), 9)
            };
            self.hold(flags, length)?;
            // Within the limits it fits an address.
            let Some(body) = usize::try_from(length).ok().and_then(|length| rest.get(head..head + length)) else {
                return Ok(None);
            };
            let body = body.to_vec();
            self.used += head + body.len();
            if flags & COMMAND != 0 {
                if !self.frames.is_empty() {
                    return Err(ZmtpError::Framing("a command within a message".to_owned()));
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

    /// Holds what a frame's head promises to the limits.
    fn hold(&self, flags: u8, length: u64) -> Result<(), ZmtpError> {
        let hold = |what, size, limit| {
            if size > limit { Err(ZmtpError::TooLarge { what, size, limit }) } else { Ok(()) }
        };
        if flags & COMMAND != 0 {
            return hold("a command", length, COMMAND_LIMIT);
        }
        hold("a frame", length, self.limits.frame_bytes as u64)?;
        hold("a message", self.size + length, self.limits.message_bytes as u64)?;
        // One more: the empty frame between envelope and message.
        hold("frames of a message, one", self.frames.len() as u64, self.limits.frames as u64)
    }

    fn next_greeting(&mut self) -> Result<Option<Item>, ZmtpError> {
        let rest = &self.bytes[self.used..];
        let wrong = |what: &str| Err(ZmtpError::Handshake(what.to_owned()));
        if rest.first().is_some_and(|byte| *byte != 0xff) || rest.get(9).is_some_and(|byte| byte & 1 == 0) {
            return wrong("it does not greet");
        }
        if let Some(major) = rest.get(10).filter(|major| **major < 3) {
            return wrong(&format!("it speaks version {major}"));
        }
        let Some(rest) = rest.get(..GREETING) else { return Ok(None) };
        let mechanism = &rest[12..32];
        if mechanism.strip_prefix(b"NULL").is_none_or(|padding| padding.iter().any(|byte| *byte != 0)) {
            let name = mechanism.split(|byte| *byte == 0).next().unwrap_or_default();
            return wrong(&format!("it wants {}", name.escape_ascii()));
        }
        let version = (rest[10], rest[11]);
        self.used += GREETING;
        self.greeted = true;
        Ok(Some(Item::Greeting(Greeting { version })))
    }
}

/// A command's name, and the rest of it.
fn command(mut body: Vec<u8>) -> Result<Item, ZmtpError> {
    let length = body.first().map_or(0, |length| usize::from(*length));
    if length == 0 || body.len() < 1 + length {
        return Err(ZmtpError::Framing("a command without a name".to_owned()));
    }
    let rest = body.split_off(1 + length);
    body.remove(0);
    Ok(Item::Command(body, rest))
}

/// The value of a property in the list that a READY carries.
pub(super) fn property<'a>(mut list: &'a [u8], wanted: &str) -> Result<Option<&'a [u8]>, ZmtpError> {
    let broken = || ZmtpError::Handshake("its READY is cut off".to_owned());
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
