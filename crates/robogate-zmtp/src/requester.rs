//! The side that asks.

use std::net::TcpStream;
use std::time::Duration;

use super::connection::{Connection, Deadline, Kind};
use super::{Address, Limits, ZmtpError};

/// A REQ socket with one peer: one question, one answer.
///
/// It connects when it is first asked. After any error the connection is dropped and the next question opens a fresh
/// one: an answer that comes late is never taken for that to a later question.
#[derive(Debug)]
pub struct Requester {
    address: Address,
    limits: Limits,
    connection: Option<Connection>,
}

impl Requester {
    /// A requester of this peer, whose answers are held to these limits.
    pub fn new(address: Address, limits: Limits) -> Self {
        Self { address, limits, connection: None }
    }

    /// The peer's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Sends one message and waits for the answer to it. Connecting, sending and waiting have `within` together.
    pub fn ask<F: AsRef<[u8]>>(&mut self, frames: &[F], within: Duration) -> Result<Vec<Vec<u8>>, ZmtpError> {
        let deadline = Deadline::new(within);
        let mut connection = match self.connection.take() {
            // Nothing has been asked yet: a peer that went away meanwhile may be back.
            Some(mut connection) => match connection.catch_up(deadline) {
                Ok(()) => connection,
                Err(_) => self.connect(deadline)?,
            },
            None => self.connect(deadline)?,
        };
        connection.send(&[Vec::new()], frames, deadline)?;
        let mut answer = connection.receive(deadline)?;
        if answer.first().is_none_or(|delimiter| !delimiter.is_empty()) || answer.len() < 2 {
            return Err(ZmtpError::Framing("an answer without the empty frame before it".to_owned()));
        }
        answer.remove(0);
        self.connection = Some(connection);
        Ok(answer)
    }

    /// Closes the connection, if there is one.
    pub fn disconnect(&mut self) {
        self.connection = None;
    }

    fn connect(&self, deadline: Deadline) -> Result<Connection, ZmtpError> {
        let unreachable = |why| ZmtpError::Unreachable { address: self.address.to_string(), why };
        let mut last = std::io::ErrorKind::NotFound.into();
        for socket in self.address.sockets().map_err(unreachable)? {
            match TcpStream::connect_timeout(&socket, deadline.left()?) {
                Ok(stream) => return Connection::open(stream, Kind::Req, self.limits, deadline),
                Err(why) => last = why,
            }
        }
        Err(unreachable(last))
    }
}
