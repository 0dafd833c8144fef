//! Deadlines of requests.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::error::PolicyError;

/// The time at which an operation must be finished.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadline {
    at: Instant,
    limit_s: f64,
}

impl Deadline {
    /// A deadline this many seconds from now.
    pub(crate) fn within(limit_s: f64) -> Self {
        Self { at: Instant::now() + Duration::from_secs_f64(limit_s), limit_s }
    }

    /// The remaining time. `None` after the deadline.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.at.checked_duration_since(Instant::now()).filter(|left| !left.is_zero())
    }

    /// The error for an operation that missed the deadline.
    pub(crate) fn passed(&self, operation: impl Into<String>) -> PolicyError {
        PolicyError::Timeout { operation: operation.into(), limit_s: self.limit_s }
    }
}

/// A TCP stream whose reads and writes end at a deadline, even if single bytes keep arriving.
#[derive(Debug)]
pub(crate) struct TimedStream {
    pub(crate) stream: TcpStream,
    pub(crate) deadline: Deadline,
}

impl TimedStream {
    /// Connect to `host:port`. Errors name the `url`.
    pub(crate) fn connect(url: &str, address: &str, deadline: Deadline) -> Result<Self, PolicyError> {
        let unreachable = |why: String| PolicyError::Unreachable { url: url.to_owned(), why };
        let addresses = address.to_socket_addrs().map_err(|e| unreachable(e.to_string()))?;
        let mut last = unreachable("the host name has no address".to_owned());
        for address in addresses {
            let left = deadline.left().ok_or_else(|| deadline.passed(format!("connecting to {url}")))?;
            match TcpStream::connect_timeout(&address, left) {
                Ok(stream) => {
                    // Send small requests immediately. Without this option the stream is only slower.
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

impl Read for TimedStream {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        self.stream.read(into)
    }
}

impl Write for TimedStream {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        self.stream.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}
