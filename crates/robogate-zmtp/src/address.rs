//! TCP endpoints in the notation of ZeroMQ.

use std::fmt;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::str::FromStr;

use super::ZmtpError;

/// A TCP endpoint: `tcp://host:port`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Address {
    host: String,
    port: u16,
}

impl Address {
    /// Creates the endpoint of a socket.
    pub(super) fn of(socket: SocketAddr) -> Self {
        Self { host: socket.ip().to_string(), port: socket.port() }
    }

    /// Whether only this machine can reach the endpoint: `localhost`, or a loopback address.
    pub fn is_loopback(&self) -> bool {
        self.host == "localhost" || self.host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
    }

    /// The socket addresses to which the host name resolves.
    pub(super) fn sockets(&self) -> std::io::Result<Vec<SocketAddr>> {
        (self.host.as_str(), self.port).to_socket_addrs().map(Iterator::collect)
    }
}

impl FromStr for Address {
    type Err = ZmtpError;

    fn from_str(text: &str) -> Result<Self, ZmtpError> {
        let wrong = || ZmtpError::Address(text.to_owned());
        let (host, port) = text.strip_prefix("tcp://").and_then(|rest| rest.rsplit_once(':')).ok_or_else(wrong)?;
        let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
        // Only an IPv6 address contains a colon, and it must be in brackets.
        if bare.is_none() && host.contains(':') {
            return Err(wrong());
        }
        let host = bare.unwrap_or(host);
        // Port 0 means any free port, as `*` does in ZeroMQ.
        let port = if port == "*" { 0 } else { port.parse().map_err(|_| wrong())? };
        if host.is_empty() || host.chars().any(|c| c.is_whitespace() || c.is_control() || c == '/') {
            return Err(wrong());
        }
        let host = if host == "*" { "0.0.0.0" } else { host };
        Ok(Self { host: host.to_owned(), port })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "tcp://[{}]:{}", self.host, self.port),
            false => write!(f, "tcp://{}:{}", self.host, self.port),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_round_trip() {
        for text in ["tcp://127.0.0.1:5570", "tcp://localhost:1", "tcp://[::1]:80"] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), text);
            assert!(address.is_loopback());
        }
        for remote in ["tcp://*:5570", "tcp://0.0.0.0:1", "tcp://robot.example:1", "tcp://127.0.0.1.example:1"] {
            assert!(!remote.parse::<Address>().unwrap().is_loopback(), "{remote}");
        }
    }

    #[test]
    fn invalid_endpoints_are_errors() {
        for text in ["", "127.0.0.1:1", "tcp://:1", "tcp://a", "tcp://a:b", "tcp://a:65536", "ipc:///x", "tcp://::1:80"]
        {
            assert!(matches!(text.parse::<Address>(), Err(ZmtpError::Address(_))), "{text}");
        }
    }
}
