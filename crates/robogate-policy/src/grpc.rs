//! A minimal gRPC client over HTTP/2 without TLS, for messages whose fields are bytes.

use std::time::Duration;

use h2::client::SendRequest;
use http::{HeaderMap, Method, Request, StatusCode};
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tungstenite::Bytes;

use super::deadline::Deadline;
use super::error::PolicyError;
use super::websocket::MAX_REPLY;

/// A connection to a gRPC server.
#[derive(Debug)]
pub(crate) struct Channel {
    runtime: Runtime,
    requests: SendRequest<Bytes>,
    address: String,
}

/// Extract `host:port` from the address of a gRPC server.
fn parse(url: &str) -> Result<String, PolicyError> {
    let wrong = |why: &str| PolicyError::Address { url: url.to_owned(), why: why.to_owned() };
    let rest = url.strip_prefix("grpc://").ok_or_else(|| wrong("expected grpc://HOST:PORT"))?;
    let address = rest.trim_end_matches('/');
    match address.rsplit_once(':') {
        Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => Ok(address.to_owned()),
        _ => Err(wrong("expected grpc://HOST:PORT")),
    }
}

impl Channel {
    /// Connect to `grpc://host:port`.
    pub(crate) fn connect(url: &str, deadline: Deadline) -> Result<Self, PolicyError> {
        let address = parse(url)?;
        let unreachable = |why: String| PolicyError::Unreachable { url: url.to_owned(), why };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| unreachable(e.to_string()))?;
        let requests = runtime.block_on(with_deadline(deadline, "connecting", async {
            let stream = TcpStream::connect(&address).await.map_err(|e| unreachable(e.to_string()))?;
            // Send small requests immediately. Without this option the stream is only slower.
            let _ = stream.set_nodelay(true);
            let (requests, connection) = h2::client::Builder::new()
                .max_header_list_size(16 << 10)
                .initial_window_size(1 << 20)
                .initial_connection_window_size(1 << 20)
                .handshake(stream)
                .await
                .map_err(|e| PolicyError::invalid_reply("the HTTP/2 handshake", e))?;
            // The task ends with the connection. Requests report its errors.
            drop(tokio::spawn(connection));
            // Fails here if the peer does not use HTTP/2.
            requests.ready().await.map_err(|e| PolicyError::invalid_reply("the HTTP/2 handshake", e))
        }))?;
        Ok(Self { runtime, requests, address })
    }

    /// Call a method with one message, or with several if the method takes a stream. Returns the reply.
    pub(crate) fn call(
        &mut self,
        method: &'static str,
        messages: &[Vec<u8>],
        deadline: Deadline,
    ) -> Result<Vec<u8>, PolicyError> {
        let Self { runtime, requests, address } = self;
        runtime.block_on(with_deadline(deadline, method, call(requests, address, method, messages)))
    }
}

async fn with_deadline<T>(
    deadline: Deadline,
    operation: &str,
    work: impl Future<Output = Result<T, PolicyError>>,
) -> Result<T, PolicyError> {
    let left = deadline.left().unwrap_or(Duration::ZERO);
    tokio::time::timeout(left, work).await.unwrap_or_else(|_| Err(deadline.passed(operation)))
}

async fn call(
    requests: &SendRequest<Bytes>,
    address: &str,
    method: &'static str,
    messages: &[Vec<u8>],
) -> Result<Vec<u8>, PolicyError> {
    let gone = |e: h2::Error| PolicyError::Closed { when: format!("during {method}"), reason: format!(": {e}") };
    let request = Request::builder()
        .method(Method::POST)
        .uri(format!("http://{address}{method}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(())
        .map_err(|e| PolicyError::invalid_reply("gRPC address", e))?;
    let mut requests = requests.clone().ready().await.map_err(gone)?;
    let (reply, mut stream) = requests.send_request(request, false).map_err(gone)?;
    for message in messages {
        let mut framed = Vec::with_capacity(message.len() + 5);
        framed.push(0);
        framed.extend(u32::try_from(message.len()).unwrap_or(u32::MAX).to_be_bytes());
        framed.extend_from_slice(message);
        stream.send_data(framed.into(), false).map_err(gone)?;
    }
    stream.send_data(Bytes::new(), true).map_err(gone)?;
    let (head, mut body) = reply.await.map_err(gone)?.into_parts();
    if head.status != StatusCode::OK {
        return Err(PolicyError::invalid_reply("gRPC reply", format!("HTTP {}", head.status)));
    }
    status(&head.headers, method)?;
    let mut bytes = Vec::new();
    while let Some(part) = body.data().await {
        let part = part.map_err(gone)?;
        if bytes.len() + part.len() > MAX_REPLY {
            return Err(PolicyError::TooLarge { limit: MAX_REPLY });
        }
        bytes.extend_from_slice(&part);
        // This fails only if the stream is closed, which the next read reports.
        let _ = body.flow_control().release_capacity(part.len());
    }
    if let Some(trailers) = body.trailers().await.map_err(gone)? {
        status(&trailers, method)?;
    }
    message(&bytes).map(<[u8]>::to_vec)
}

/// Check that the gRPC status is zero.
fn status(headers: &HeaderMap, method: &str) -> Result<(), PolicyError> {
    let text = |name: &str| headers.get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).into_owned());
    match text("grpc-status") {
        // Unimplemented.
        Some(code) if code == "12" => {
            let found = format!("the gRPC server has no method {method}");
            Err(PolicyError::WrongDialect { expected: "lerobot", found })
        }
        Some(code) if code != "0" => {
            let message = text("grpc-message").unwrap_or_default().replace("%20", " ").replace("%0A", "\n");
            Err(PolicyError::reported(&format!("gRPC status {code}: {message}")))
        }
        _ => Ok(()),
    }
}

/// Extract the only message of a body.
pub(crate) fn message(body: &[u8]) -> Result<&[u8], PolicyError> {
    let wrong = |why: &str| PolicyError::invalid_reply("gRPC reply", why);
    let (prefix, message) = body.split_at_checked(5).ok_or_else(|| wrong("no message"))?;
    if prefix[0] != 0 {
        return Err(wrong("the message is compressed, which is not supported"));
    }
    let length = u32::from_be_bytes([prefix[1], prefix[2], prefix[3], prefix[4]]) as usize;
    if length != message.len() {
        return Err(wrong("the length of the message does not match its prefix"));
    }
    Ok(message)
}

/// Encode a bytes field of a protobuf message.
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

/// The last bytes field with this number in a protobuf message. Empty if there is none, as protobuf defines.
pub(crate) fn read_bytes_field(mut message: &[u8], number: u64) -> Result<&[u8], PolicyError> {
    let wrong =
        || PolicyError::invalid_reply("protobuf message", "it is truncated, or has fields of an unsupported type");
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

#[cfg(test)]
mod tests {
    use robogate_testing::fuzz::{self, Draw, Target};

    use super::*;
    use crate::tests::MESSAGES;

    #[test]
    fn servers_without_the_method_have_another_dialect() {
        let headers =
            |code: &'static str| HeaderMap::from_iter([("grpc-status".parse().unwrap(), code.parse().unwrap())]);
        let error = status(&headers("12"), "/transport.AsyncInference/Ready").unwrap_err().to_string();
        assert!(error.ends_with("the gRPC server has no method /transport.AsyncInference/Ready"), "{error}");
        assert!(matches!(status(&headers("13"), "/"), Err(PolicyError::Reported { .. })));
        assert_eq!(status(&headers("0"), "/"), Ok(()));
    }

    fn number(mut number: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while number > 0x7f {
            bytes.push(number as u8 | 0x80);
            number >>= 7;
        }
        bytes.push(number as u8);
        bytes
    }

    /// A message whose fields fit together mostly: fields of all kinds, nested ones, and sometimes a false length.
    fn generated(draw: &mut Draw, depth: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        for _ in 0..draw.below(6) {
            let field = 1 + draw.below(4) as u64;
            match draw.below(8) {
                0 => bytes.extend([number(field << 3), number(u64::MAX >> draw.below(64))].concat()),
                1 => bytes
                    .extend([number(field << 3 | [1, 3, 4, 5, 6, 7][draw.below(6)]), vec![0; draw.below(9)]].concat()),
                2 => bytes.extend([number(field << 3 | 2), number(u64::MAX >> draw.below(64))].concat()),
                _ => {
                    let content = if depth < 4 { generated(draw, depth + 1) } else { vec![7; draw.below(40)] };
                    bytes.extend([number(field << 3 | 2), number(content.len() as u64), content].concat());
                }
            }
        }
        bytes
    }

    #[test]
    fn fuzzed_messages_are_read_or_refused() {
        let corpus = crate::tests::corpus("protobuf");
        assert!(corpus.len() >= 5);
        for bytes in &corpus {
            let (_, peak) = robogate_testing::peak_memory(|| drop(read_bytes_field(bytes, 1)));
            assert!(peak < 10_000, "{peak}");
        }
        let counts = fuzz::run(
            "protobuf parts",
            MESSAGES,
            |draw| generated(draw, 0),
            |message| {
                let (found, peak) = robogate_testing::peak_memory(|| read_bytes_field(message, 1).is_ok());
                assert!(peak < 10_000, "{peak}");
                let body = [&[0][..], &(message.len() as u32).to_be_bytes(), message].concat();
                assert_eq!(super::message(&body).unwrap(), message);
                found
            },
        );
        assert!(counts.read > 0 && counts.refused > 0, "{counts:?}");
        let valid = [super::bytes_field(1, &[7; 300])];
        Target { name: "protobuf", valid: &valid, kept: &corpus, words: &[], inputs: MESSAGES }
            .run(|bytes| read_bytes_field(bytes, 1).is_ok());
    }
}
