//! gRPC over plain HTTP/2, as far as four methods of a few bytes fields need it.

use std::time::Duration;

use h2::client::SendRequest;
use http::{HeaderMap, Method, Request, StatusCode};
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tungstenite::Bytes;

use super::error::ServerError;
use super::websocket::{Deadline, MAX_ANSWER};

/// A connection.
#[derive(Debug)]
pub(crate) struct Channel {
    runtime: Runtime,
    requests: SendRequest<Bytes>,
    address: String,
}

/// What an address of a gRPC server names: `host:port`.
fn parse(url: &str) -> Result<String, ServerError> {
    let wrong = |why: &str| ServerError::Address { url: url.to_owned(), why: why.to_owned() };
    let rest = url.strip_prefix("grpc://").ok_or_else(|| wrong("it must begin with grpc://"))?;
    let address = rest.trim_end_matches('/');
    match address.rsplit_once(':') {
        Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => Ok(address.to_owned()),
        _ => Err(wrong("it must be grpc://HOST:PORT")),
    }
}

impl Channel {
    /// Connects to `grpc://host:port`.
    pub(crate) fn connect(url: &str, deadline: Deadline) -> Result<Self, ServerError> {
        let address = parse(url)?;
        let unreachable = |why: String| ServerError::Unreachable { url: url.to_owned(), why };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| unreachable(e.to_string()))?;
        let requests = runtime.block_on(in_time(deadline, "connecting", async {
            let stream = TcpStream::connect(&address).await.map_err(|e| unreachable(e.to_string()))?;
            // Small questions go out at once. A stream without the option is slow, not wrong.
            let _ = stream.set_nodelay(true);
            let (requests, connection) = h2::client::Builder::new()
                .max_header_list_size(16 << 10)
                .initial_window_size(1 << 20)
                .initial_connection_window_size(1 << 20)
                .handshake(stream)
                .await
                .map_err(|e| ServerError::undecodable("the HTTP/2 handshake", e))?;
            // It ends with the connection; what went wrong is told to whoever asks.
            drop(tokio::spawn(connection));
            // A peer that does not speak HTTP/2 shows it here.
            requests.ready().await.map_err(|e| ServerError::undecodable("the HTTP/2 handshake", e))
        }))?;
        Ok(Self { runtime, requests, address })
    }

    /// Calls a method with messages, one or (where it takes a stream) several, and returns its answer.
    pub(crate) fn call(
        &mut self,
        method: &'static str,
        messages: &[Vec<u8>],
        deadline: Deadline,
    ) -> Result<Vec<u8>, ServerError> {
        let Self { runtime, requests, address } = self;
        runtime.block_on(in_time(deadline, method, call(requests, address, method, messages)))
    }
}

async fn in_time<T>(
    deadline: Deadline,
    what: &str,
    work: impl Future<Output = Result<T, ServerError>>,
) -> Result<T, ServerError> {
    let left = deadline.left().unwrap_or(Duration::ZERO);
    tokio::time::timeout(left, work).await.unwrap_or_else(|_| Err(deadline.passed(what)))
}

async fn call(
    requests: &SendRequest<Bytes>,
    address: &str,
    method: &'static str,
    messages: &[Vec<u8>],
) -> Result<Vec<u8>, ServerError> {
    let gone = |e: h2::Error| ServerError::Closed { when: format!("during {method}"), reason: format!(": {e}") };
    let request = Request::builder()
        .method(Method::POST)
        .uri(format!("http://{address}{method}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(())
        .map_err(|e| ServerError::undecodable("a gRPC address", e))?;
    let mut requests = requests.clone().ready().await.map_err(gone)?;
    let (answer, mut stream) = requests.send_request(request, false).map_err(gone)?;
    for message in messages {
        let mut framed = Vec::with_capacity(message.len() + 5);
        framed.push(0);
        framed.extend(u32::try_from(message.len()).unwrap_or(u32::MAX).to_be_bytes());
        framed.extend_from_slice(message);
        stream.send_data(framed.into(), false).map_err(gone)?;
    }
    stream.send_data(Bytes::new(), true).map_err(gone)?;
    let (head, mut body) = answer.await.map_err(gone)?.into_parts();
    if head.status != StatusCode::OK {
        return Err(ServerError::undecodable("a gRPC answer", format!("HTTP {}", head.status)));
    }
    status(&head.headers)?;
    let mut bytes = Vec::new();
    while let Some(part) = body.data().await {
        let part = part.map_err(gone)?;
        if bytes.len() + part.len() > MAX_ANSWER {
            return Err(ServerError::TooLarge { limit: MAX_ANSWER });
        }
        bytes.extend_from_slice(&part);
        // The window only fails to grow on a stream that is gone, which the next read tells.
        let _ = body.flow_control().release_capacity(part.len());
    }
    if let Some(trailers) = body.trailers().await.map_err(gone)? {
        status(&trailers)?;
    }
    message(&bytes).map(<[u8]>::to_vec)
}

/// The error that a status other than zero is.
fn status(headers: &HeaderMap) -> Result<(), ServerError> {
    let text = |name: &str| headers.get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).into_owned());
    match text("grpc-status") {
        Some(code) if code != "0" => {
            let words = text("grpc-message").unwrap_or_default().replace("%20", " ").replace("%0A", "\n");
            Err(ServerError::refused(&format!("gRPC status {code}: {words}")))
        }
        _ => Ok(()),
    }
}

/// The one message in a body.
pub(crate) fn message(body: &[u8]) -> Result<&[u8], ServerError> {
    let wrong = |why: &str| ServerError::undecodable("a gRPC answer", why);
    let (prefix, message) = body.split_at_checked(5).ok_or_else(|| wrong("it has no message"))?;
    if prefix[0] != 0 {
        return Err(wrong("it is compressed"));
    }
    let length = u32::from_be_bytes([prefix[1], prefix[2], prefix[3], prefix[4]]) as usize;
    if length != message.len() {
        return Err(wrong("its message has another length than it says"));
    }
    Ok(message)
}

/// A field of bytes in a protobuf message.
pub(crate) fn bytes_field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut field = vec![number << 3 | 2];
    let mut length = bytes.len();
    while length > 0x7f {
        field.push(length as u8 | 0x80);
        length >>= 7;
    }
    field.push(length as u8);
    field.extend_from_slice(bytes);
    field
}

/// The last field of bytes of this number in a protobuf message; empty where there is none, as protobuf has it.
pub(crate) fn read_bytes_field(mut message: &[u8], number: u64) -> Result<&[u8], ServerError> {
    let wrong = || ServerError::undecodable("a protobuf message", "it ends too early, or has fields that are no bytes");
    let mut found: &[u8] = &[];
    while !message.is_empty() {
        let key = varint(&mut message).ok_or_else(wrong)?;
        match key & 7 {
            0 => drop(varint(&mut message).ok_or_else(wrong)?),
            2 => {
                let length = usize::try_from(varint(&mut message).ok_or_else(wrong)?).map_err(|_| wrong())?;
                let (bytes, rest) = message.split_at_checked(length).ok_or_else(wrong)?;
                message = rest;
                if key >> 3 == number {
                    found = bytes;
                }
            }
            _ => return Err(wrong()),
        }
    }
    Ok(found)
}

fn varint(message: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = message.split_first()?;
        *message = rest;
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}
