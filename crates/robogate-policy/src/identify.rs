//! What listens on a port, where it can be told.

use std::io::{Read, Write};

use super::profile::Dialect;
use super::websocket::{Deadline, Timed};

/// How long a look takes at most, in seconds.
const LOOK_S: f64 = 1.0;

/// A sentence on what is there, if it is known and is not what was expected.
pub(crate) fn name(url: &str, expected: &Dialect) -> Option<String> {
    let address = url.split_once("://")?.1.split('/').next()?;
    let (found, dialects) = spoken(address)?;
    (!dialects.contains(&expected.name())).then(|| match dialects {
        [] => found.to_owned(),
        _ => format!("{found} (dialect {})", dialects.join(" or ")),
    })
}

/// What an address answers, and which dialects sound so.
fn spoken(address: &str) -> Option<(&'static str, &'static [&'static str])> {
    let unasked = hear(address, None);
    if unasked.starts_with(&[0xff, 0, 0, 0, 0, 0, 0, 0]) {
        return Some(("a ZeroMQ socket listens there", &["gr00t-n1.5", "gr00t-n1.6"]));
    }
    // A frame of HTTP/2: 24 bits of length, type SETTINGS.
    if unasked.len() >= 9 && unasked[3] == 4 {
        return Some(("an HTTP/2 server, as for gRPC, listens there", &["lerobot"]));
    }
    let get = |path: &str| {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        String::from_utf8_lossy(&hear(address, Some(request.as_bytes()))).into_owned()
    };
    let health = get("/health");
    if health.starts_with("HTTP/") && health.contains(" 426 ") {
        return Some(if get("/healthz").contains(" 200 ") {
            ("a WebSocket server with openpi's /healthz listens there", &["openpi"])
        } else {
            ("a WebSocket server without /healthz listens there", &["roboarena"])
        });
    }
    if health.contains("\"status\"") {
        return Some(if health.contains("\"GR00T\"") {
            ("a GR00T N1.5 server over HTTP listens there", &["gr00t-n1.5-http"])
        } else if health.contains("healthy") {
            ("an HTTP server with /act, /reset and /health listens there", &["rest"])
        } else {
            ("a vla-eval server listens there", &["vla-eval"])
        });
    }
    if health.contains("{\"detail\":\"Not Found\"}") {
        return Some(("an HTTP server like OpenVLA's listens there", &["openvla", "openvla-oft", "rest"]));
    }
    if health.starts_with("HTTP/") {
        return Some(("an HTTP server of no known dialect listens there", &[]));
    }
    None
}

/// The first bytes that an address sends, after a request or by itself.
fn hear(address: &str, request: Option<&[u8]>) -> Vec<u8> {
    let mut heard = vec![0; 1024];
    let mut length = 0;
    if let Ok(mut stream) = Timed::connect(address, address, Deadline::within(LOOK_S))
        && stream.write_all(request.unwrap_or_default()).is_ok()
    {
        // Until it hangs up, the time has passed or enough is heard.
        while let Ok(n @ 1..) = stream.read(&mut heard[length..]) {
            length += n;
            if request.is_none() {
                break;
            }
        }
    }
    heard.truncate(length);
    heard
}
