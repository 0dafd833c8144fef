//! Policy servers behind TLS, with keys.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "support/openpi.rs"]
mod openpi;
mod support;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread;

use robogate_core::{Command, Policy};
use robogate_policy::{Access, ExternalPolicy, PolicyError, Profile};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use support::{begin, observation};
use tungstenite::Message;
use tungstenite::handshake::server::{Callback, ErrorResponse, Request, Response};

type Tls = StreamOwned<ServerConnection, TcpStream>;

fn file(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tls").join(name)).unwrap()
}

/// Starts a server that runs this conversation on each connection. Returns its port.
fn server(converse: impl Fn(Tls) + Send + 'static) -> u16 {
    let certificate = CertificateDer::from_pem_slice(&file("server.pem")).unwrap();
    let key = PrivateKeyDer::from_pem_slice(&file("server.key")).unwrap();
    let config = ServerConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(vec![certificate], key)
        .unwrap();
    let config = Arc::new(config);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let connection = ServerConnection::new(Arc::clone(&config)).unwrap();
            converse(StreamOwned::new(connection, stream.unwrap()));
        }
    });
    port
}

/// Stores the header with the key.
struct ReadKey(Arc<Mutex<String>>);

impl Callback for ReadKey {
    fn on_request(self, request: &Request, response: Response) -> Result<Response, ErrorResponse> {
        let value = request.headers().get("Authorization").map(|value| value.to_str().unwrap().to_owned());
        *self.0.lock().unwrap() = value.unwrap_or_default();
        Ok(response)
    }
}

fn trusted() -> Access {
    Access::default().with_certificates(&file("ca.pem")).unwrap()
}

fn connect(url: &str, profile: &str, access: Access) -> Result<ExternalPolicy, PolicyError> {
    let text = Profile::built_in(profile).unwrap().replace("length = 50", "length = 10");
    ExternalPolicy::connect_with(url, Arc::new(Profile::from_toml(&text).unwrap()), access, &mut |_| {})
}

#[test]
fn websocket_server_with_tls_and_key() {
    let seen = Arc::new(Mutex::new(String::new()));
    let header = Arc::clone(&seen);
    let port = server(move |tls| {
        // The handshake fails if the client does not trust the certificate.
        let Ok(mut socket) = tungstenite::accept_hdr(tls, ReadKey(Arc::clone(&header))) else { return };
        socket.send(Message::binary(vec![0x80])).unwrap();
        while let Ok(message) = socket.read() {
            if message.is_binary() {
                socket.send(Message::binary(openpi::actions(10, 7, |_, _| 0.5))).unwrap();
            }
        }
    });
    let url = format!("wss://localhost:{port}");
    let access = trusted().with_key("hunter2").unwrap();
    let mut policy = connect(&url, "pi0-libero", access).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    for _ in 0..7 {
        let action = policy.act(&observation(256)).unwrap();
        // The arm lags behind actions of 0.5 x 0.05 m.
        let Command::ToolDelta { translation_m: [x, ..], .. } = action.command else { panic!("{action:?}") };
        assert!(x > 0.0 && x < 0.025, "{x}");
    }
    assert_eq!(*seen.lock().unwrap(), "Api-Key hunter2");
    drop(policy);
    // The authority is not one of the system.
    let error = connect(&url, "pi0-libero", Access::default()).unwrap_err();
    assert!(matches!(error, PolicyError::Tls { .. } | PolicyError::Certificates(_)), "{error}");
}

/// Answers HTTP requests with plain JSON. Returns the header lines that it saw.
fn http(mut tls: Tls, seen: &Mutex<Vec<String>>) {
    loop {
        let mut reader = BufReader::new(&mut tls);
        let (mut first, mut length) = (String::new(), 0);
        if reader.read_line(&mut first).is_err() || first.is_empty() {
            return;
        }
        loop {
            let mut line = String::new();
            reader.read_line(&mut line).unwrap();
            let line = line.trim();
            if line.is_empty() {
                break;
            }
            if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
                length = value.parse().unwrap();
            }
            seen.lock().unwrap().push(line.to_owned());
        }
        let mut body = vec![0; length];
        reader.read_exact(&mut body).unwrap();
        drop(reader);
        let reply = if first.starts_with("GET") { r#"{"paths": {"/act": {}}}"# } else { "[0.01, 0, 0, 0, 0, 0, 1]" };
        write!(tls, "HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{reply}", reply.len()).unwrap();
        tls.flush().unwrap();
    }
}

#[test]
fn http_server_with_tls_and_named_header() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let lines = Arc::clone(&seen);
    let port = server(move |tls| http(tls, &lines));
    let url = format!("https://127.0.0.1:{port}");
    let access = trusted().with_key("X-Key: hunter2").unwrap();
    let mut policy = connect(&url, "openvla", access).unwrap();
    begin(&mut policy, "pick up the box").unwrap();
    let action = policy.act(&observation(256)).unwrap();
    // An action of 0.2 s takes four control periods.
    assert!(matches!(action.command, Command::ToolDelta { translation_m: [0.0025, ..], .. }), "{action:?}");
    let keys = seen.lock().unwrap().iter().filter(|line| line.eq_ignore_ascii_case("x-key: hunter2")).count();
    assert_eq!(keys, 2);
    // The server handles one connection after the other.
    drop(policy);
    let error = connect(&url, "openvla", Access::default()).unwrap_err();
    assert!(matches!(error, PolicyError::Tls { .. } | PolicyError::Certificates(_)), "{error}");
}

#[test]
fn waiting_reaches_a_server_that_starts_late() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut waited = 0;
    let mut waiting = |_: &PolicyError| {
        waited += 1;
        if waited == 1 {
            let listener = TcpListener::bind(free).unwrap();
            openpi::serve(listener, |_, _| std::ops::ControlFlow::Continue(()));
        }
    };
    let profile = Arc::new(Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap());
    let access = Access::default().with_wait(std::time::Duration::from_secs(60));
    ExternalPolicy::connect_with(&format!("ws://{free}"), profile, access, &mut waiting).unwrap();
    assert_eq!(waited, 1);
}
