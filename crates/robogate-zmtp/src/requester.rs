//! The REQ side.

use std::net::TcpStream;
use std::time::Duration;

use super::connection::{Connection, Deadline, Kind};
use super::{Address, Limits, ZmtpError};

/// A REQ socket with one peer. Each request gets one reply.
///
/// The first request opens the connection. After an error the connection is closed, and the next request opens a new
/// one. A late reply can therefore never be mistaken for the reply to a later request.
#[derive(Debug)]
pub struct Requester {
    address: Address,
    limits: Limits,
    connection: Option<Connection>,
}

impl Requester {
    /// Create a requester for this peer, with limits on the size of replies.
    pub fn new(address: Address, limits: Limits) -> Self {
        Self { address, limits, connection: None }
    }

    /// Address of the peer.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Send a request and wait for the reply. The timeout covers connecting, sending and waiting.
    pub fn request<F: AsRef<[u8]>>(&mut self, frames: &[F], timeout: Duration) -> Result<Vec<Vec<u8>>, ZmtpError> {
        let deadline = Deadline::new(timeout);
        let mut connection = match self.connection.take() {
            // No request is pending, so a peer that restarted can be reconnected.
            Some(mut connection) => match connection.catch_up(deadline) {
                Ok(()) => connection,
                Err(_) => self.connect(deadline)?,
            },
            None => self.connect(deadline)?,
        };
        connection.send(&[Vec::new()], frames, deadline)?;
        let mut reply = connection.receive(deadline)?;
        if reply.first().is_none_or(|delimiter| !delimiter.is_empty()) || reply.len() < 2 {
            return Err(ZmtpError::Framing("a reply without the delimiter frame".to_owned()));
        }
        reply.remove(0);
        self.connection = Some(connection);
        Ok(reply)
    }

    /// Close the connection, if there is one.
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
