//! Identifies the kind of server at an address.

use std::io::{Read, Write};

use super::deadline::{Deadline, TimedStream};
use super::profile::Dialect;

/// Timeout of a probe, in seconds.
const PROBE_S: f64 = 1.0;

/// Describes the server at an address, if it can be identified and does not have the expected dialect.
pub(crate) fn describe(url: &str, expected: &Dialect) -> Option<String> {
    let (scheme, rest) = url.split_once("://")?;
    if matches!(scheme, "wss" | "https") {
        return None;
    }
    let address = rest.split('/').next()?;
    let (found, dialects) = probe(address)?;
    // An HTTP server of the user: the error itself says what it lacks.
    if dialects.is_empty() && expected.scheme() == "http://" {
        return None;
    }
    (!dialects.contains(&expected.name())).then(|| match dialects {
        [] => found.to_owned(),
        _ => format!("{found} (dialect {})", dialects.join(" or ")),
    })
}

/// The dialects that the server at an address may have. Empty if it is not identified.
pub fn dialects_at(url: &str) -> &'static [&'static str] {
    let address = url.split_once("://").and_then(|(_, rest)| rest.split('/').next());
    address.and_then(probe).map_or(&[], |(_, dialects)| dialects)
}

/// A description of the server, and the dialects that it may have.
fn probe(address: &str) -> Option<(&'static str, &'static [&'static str])> {
    let greeting = receive(address, None);
    if greeting.starts_with(&[0xff, 0, 0, 0, 0, 0, 0, 0]) {
        return Some(("a ZeroMQ socket listens there", &["gr00t-n1.5", "gr00t-n1.6"]));
    }
    // A frame of HTTP/2: 24 bits of length, type SETTINGS.
    if greeting.len() >= 9 && greeting[3] == 4 {
        return Some(("an HTTP/2 server (probably gRPC) listens there", &["lerobot"]));
    }
    let get = |path: &str| {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        String::from_utf8_lossy(&receive(address, Some(request.as_bytes()))).into_owned()
    };
    let health = get("/health");
    if health.starts_with("HTTP/") && health.contains(" 426 ") {
        return Some(if get("/healthz").contains(" 200 ") {
            ("a WebSocket server with openpi's /healthz listens there", &["openpi"])
        } else {
            // A server of the user with openpi's dialect has no /healthz either.
            ("a WebSocket server without /healthz listens there", &["roboarena", "openpi"])
        });
    }
    if health.contains("\"status\"") {
        if health.contains("\"GR00T\"") {
            return Some(("a GR00T N1.5 server over HTTP listens there", &["gr00t-n1.5-http"]));
        }
        if health.contains("healthy") {
            return Some(("an HTTP server with /act, /reset and /health listens there", &["rest"]));
        }
        // Other HTTP servers have a /health with a status too.
        if get("/").contains(" 426 ") {
            return Some(("a vla-eval server listens there", &["vla-eval"]));
        }
    }
    if health.contains("{\"detail\":\"Not Found\"}") {
        return Some(("an HTTP server such as OpenVLA's listens there", &["openvla", "openvla-oft", "rest"]));
    }
    if health.starts_with("HTTP/") {
        return Some(("an HTTP server of an unknown dialect listens there", &[]));
    }
    None
}

/// The first bytes that a server sends, after this request or on connection.
fn receive(address: &str, request: Option<&[u8]>) -> Vec<u8> {
    let mut received = vec![0; 1024];
    let mut length = 0;
    if let Ok(mut stream) = TimedStream::connect(address, address, Deadline::within(PROBE_S))
        && stream.write_all(request.unwrap_or_default()).is_ok()
    {
        // Until the server closes the connection, the time is up or the buffer is full.
        while let Ok(n @ 1..) = stream.read(&mut received[length..]) {
            length += n;
            if request.is_none() {
                break;
            }
        }
    }
    received.truncate(length);
    received
}
