//! A server for one page on this machine.
//!
//! It listens on a loopback address only. Each request must name this machine as its host, so a foreign DNS name that
//! resolves to it is rejected (DNS rebinding). All paths but the page itself, which contains no data, require the bearer
//! token, so other users and other pages on this machine read nothing.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use hyper::body::Incoming;
use hyper::header::{self, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, oneshot};

use super::HttpError;
use super::admission::{is_this_machine, same};
use super::http::{Reply, refusal, reply};

/// Maximum number of connections.
const CONNECTIONS: usize = 64;
/// Number of threads that answer requests. One may be busy with a long answer.
const THREADS: usize = 3;
/// Timeout for the head of a request.
const HEAD: Duration = Duration::from_secs(10);

/// A GET request that was admitted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LocalRequest {
    /// The path, from `/` on.
    pub path: String,
    /// The query, without `?`. Empty without one.
    pub query: String,
}

impl LocalRequest {
    /// The value of `name` in the query, as written.
    pub fn value(&self, name: &str) -> Option<&str> {
        self.query
            .split('&')
            .find_map(|pair| pair.split_once('=').filter(|(key, _)| *key == name).map(|(_, value)| value))
    }
}

/// The reply to a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LocalReply {
    /// A page with its content security policy.
    Page {
        /// The page.
        html: String,
        /// The policy.
        policy: String,
    },
    /// A JSON document.
    Json(Vec<u8>),
    /// Bytes.
    Bytes(Vec<u8>),
    /// The address does not exist.
    NotFound(String),
    /// The request is wrong.
    Wrong(String),
    /// The request is right, but cannot be answered.
    Failed(String),
}

/// A new token, which nobody can guess: 128 random bits as hexadecimal digits.
///
/// # Errors
/// If the operating system has no random numbers.
#[expect(clippy::disallowed_methods, reason = "a token must not be predictable")]
pub fn random_token() -> Result<String, HttpError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| HttpError::Random(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Serves `answer` at a loopback address until `stop` receives a message or is dropped. `listening` receives the address,
/// whose port the system may have chosen.
///
/// # Errors
/// If the address is not a loopback address, or cannot be used.
pub fn serve_local(
    address: SocketAddr,
    token: &str,
    answer: Arc<dyn Fn(&LocalRequest) -> LocalReply + Send + Sync>,
    listening: impl FnOnce(SocketAddr),
    stop: oneshot::Receiver<()>,
) -> Result<(), HttpError> {
    if !address.ip().is_loopback() {
        return Err(HttpError::NotLocal(address));
    }
    if token.len() < 16 {
        return Err(HttpError::ShortToken(token.len()));
    }
    let failed = |because| HttpError::Listen { address, because };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(THREADS)
        .build()
        .map_err(failed)?;
    let server = Arc::new(Server { token: token.to_owned(), answer });
    let ended = runtime.block_on(async {
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        listening(listener.local_addr().map_err(failed)?);
        tokio::select! {
            () = accept(&listener, &server) => {}
            _ = stop => {}
        }
        Ok(())
    });
    // An answer in progress may take long, and nobody waits for it any more.
    runtime.shutdown_background();
    ended
}

struct Server {
    token: String,
    answer: Arc<dyn Fn(&LocalRequest) -> LocalReply + Send + Sync>,
}

async fn accept(listener: &TcpListener, server: &Arc<Server>) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let server = Arc::clone(server);
        tokio::spawn(async move {
            let service = service_fn(|request| {
                let server = Arc::clone(&server);
                async move { Ok::<_, Infallible>(respond(server, request).await) }
            });
            // A broken connection needs no action.
            let _ = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD)
                .max_buf_size(64 << 10)
                .serve_connection(TokioIo::new(stream), service)
                .await;
            drop(place);
        });
    }
}

async fn respond(server: Arc<Server>, request: Request<Incoming>) -> Reply {
    if let Some(refused) = admit(&server, &request) {
        return refused;
    }
    let request = LocalRequest {
        path: request.uri().path().to_owned(),
        query: request.uri().query().unwrap_or_default().to_owned(),
    };
    match tokio::task::spawn_blocking(move || (server.answer)(&request)).await {
        Ok(answer) => sent(answer),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

fn sent(answer: LocalReply) -> Reply {
    match answer {
        LocalReply::Page { html, policy } => {
            let mut page = reply(StatusCode::OK, "text/html; charset=utf-8", html);
            if let Ok(policy) = HeaderValue::from_str(&policy) {
                page.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
            }
            page.headers_mut().insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
            page
        }
        LocalReply::Json(text) => reply(StatusCode::OK, "application/json", text),
        LocalReply::Bytes(bytes) => reply(StatusCode::OK, "application/octet-stream", bytes),
        LocalReply::NotFound(because) => refusal(StatusCode::NOT_FOUND, because),
        LocalReply::Wrong(because) => refusal(StatusCode::BAD_REQUEST, because),
        LocalReply::Failed(because) => refusal(StatusCode::INTERNAL_SERVER_ERROR, because),
    }
}

/// Refuses unauthorised requests.
fn admit(server: &Server, request: &Request<Incoming>) -> Option<Reply> {
    let text = |name| request.headers().get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    if !text(header::HOST).is_some_and(is_this_machine) {
        return Some(refusal(StatusCode::FORBIDDEN, "the host must be localhost or a loopback address"));
    }
    if *request.method() != Method::GET {
        return Some(refusal(StatusCode::METHOD_NOT_ALLOWED, "this server only answers GET"));
    }
    if request.uri().path() == "/" {
        return None;
    }
    let (scheme, sent) = text(header::AUTHORIZATION).and_then(|value| value.split_once(' ')).unwrap_or_default();
    if scheme.eq_ignore_ascii_case("bearer") && same(sent.as_bytes(), server.token.as_bytes()) {
        return None;
    }
    let mut refused =
        refusal(StatusCode::UNAUTHORIZED, "a bearer token is required: open the address that robogate printed");
    refused.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    Some(refused)
}
