//! The connection of `robogate monitor serve` to rosbridge.

use std::time::Duration;

use robogate_monitor::service::{Bridge, Connect, Received};
use robogate_policy::{Incoming, TextSocket};

/// Time limit of a connection and of a message that is sent, in seconds.
const LIMIT_S: f64 = 10.0;

struct Socket(TextSocket);

impl Bridge for Socket {
    fn send(&mut self, text: Option<String>) -> Result<(), String> {
        self.0.send(text, LIMIT_S).map_err(|error| error.to_string())
    }

    fn receive(&mut self, within: Duration) -> Result<Option<Received>, String> {
        let received = self.0.receive(within.as_secs_f64()).map_err(|error| error.to_string())?;
        Ok(received.map(|received| match received {
            Incoming::Text(text) => Received::Text(text),
            Incoming::Pong => Received::Pong,
        }))
    }
}

/// Opens connections to the server at this address.
pub(super) fn connect(url: &str) -> Connect {
    let url = url.to_owned();
    Box::new(move || {
        let socket = TextSocket::connect(&url, LIMIT_S).map_err(|error| error.to_string())?;
        Ok(Box::new(Socket(socket)))
    })
}
