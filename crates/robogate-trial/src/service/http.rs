//! The HTTP server of a study.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde_json::json;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, oneshot};

use super::Service;
use crate::Problem;

/// The page. It loads nothing from elsewhere.
const PAGE: &str = include_str!("page.html");
/// Its script. It is a file of its own, so that the policy of the page forbids inline scripts.
const SCRIPT: &str = include_str!("page.js");
/// Its style.
const STYLE: &str = include_str!("page.css");
/// The policy of the page.
const POLICY: &str = "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; img-src data:; \
                      frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

/// Most connections at a time.
const CONNECTIONS: usize = 64;
/// Largest body of a request, in bytes.
const MOST_BYTES: usize = 64 << 10;
/// Limit for the head of a request, and for its body.
const SLOWEST: Duration = Duration::from_secs(10);
/// Threads that write the journal.
const THREADS: usize = 2;

type Reply = Response<Full<Bytes>>;

/// Serves a study until `stop` receives a message or is dropped. `listening` receives the address.
///
/// # Errors
/// If the address cannot be used.
pub fn serve(
    address: SocketAddr,
    service: Arc<Service>,
    listening: impl FnOnce(SocketAddr),
    stop: oneshot::Receiver<()>,
) -> Result<(), Problem> {
    let failed = |error: std::io::Error| Problem::Listen { address: address.to_string(), reason: error.to_string() };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(THREADS)
        .build()
        .map_err(failed)?;
    runtime.block_on(async {
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        listening(listener.local_addr().map_err(failed)?);
        tokio::select! {
            () = accept(&listener, &service) => {}
            _ = stop => {}
        }
        Ok(())
    })
}

async fn accept(listener: &TcpListener, service: &Arc<Service>) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let service = Arc::clone(service);
        tokio::spawn(async move {
            let respond = service_fn(|request| {
                let service = Arc::clone(&service);
                async move { Ok::<_, Infallible>(respond(service, request).await) }
            });
            // A broken connection needs no action: the page sends again.
            let _ = hyper::server::conn::http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(SLOWEST)
                .max_buf_size(64 << 10)
                .serve_connection(TokioIo::new(stream), respond)
                .await;
            drop(place);
        });
    }
}

async fn respond(service: Arc<Service>, request: Request<Incoming>) -> Reply {
    let path = request.uri().path().to_owned();
    let data = path.starts_with("/v1/");
    let wanted = if path == "/v1/policy" { &service.script_token } else { &service.token };
    if data && !is_admitted(&request, wanted) {
        let mut refused =
            refusal(StatusCode::UNAUTHORIZED, "a bearer token is required: open the address that robogate printed");
        refused.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        return refused;
    }
    match (request.method(), path.as_str()) {
        (&Method::GET, "/") => {
            let mut page = reply(StatusCode::OK, "text/html; charset=utf-8", PAGE);
            page.headers_mut().insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
            page.headers_mut().insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
            page
        }
        (&Method::GET, "/page.js") => reply(StatusCode::OK, "text/javascript; charset=utf-8", SCRIPT),
        (&Method::GET, "/page.css") => reply(StatusCode::OK, "text/css; charset=utf-8", STYLE),
        (&Method::GET, "/v1/state") => answer(move || Ok(service.state())).await,
        (&Method::GET, "/v1/policy") => answer(move || Ok(json!({ "policy": service.policy()? }).to_string())).await,
        (&Method::POST, "/v1/do") => {
            let body = Limited::new(request.into_body(), MOST_BYTES).collect();
            match tokio::time::timeout(SLOWEST, body).await {
                Ok(Ok(body)) => {
                    let body = body.to_bytes();
                    answer(move || Ok(json!({ "new": service.execute(&body)? }).to_string())).await
                }
                Ok(Err(_)) => refusal(StatusCode::PAYLOAD_TOO_LARGE, "the request is too large"),
                Err(_) => refusal(StatusCode::REQUEST_TIMEOUT, "the request took too long"),
            }
        }
        (_, "/" | "/page.js" | "/page.css" | "/v1/state" | "/v1/policy" | "/v1/do") => {
            refusal(StatusCode::METHOD_NOT_ALLOWED, "this path does not support this method")
        }
        _ => refusal(StatusCode::NOT_FOUND, "not found; the page is at /"),
    }
}

/// Whether a request carries this token. The comparison takes the same time for all tokens of its length.
fn is_admitted(request: &Request<Incoming>, token: &str) -> bool {
    let sent = request.headers().get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
    let sent = sent.and_then(|value| value.split_once(' ')).filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
    sent.is_some_and(|(_, sent)| {
        let differ = sent.bytes().zip(token.bytes()).fold(0, |sum, (a, b)| sum | (a ^ b));
        sent.len() == token.len() && differ == 0
    })
}

/// Runs work that may write to the disk, and sends its document.
async fn answer(work: impl FnOnce() -> Result<String, Problem> + Send + 'static) -> Reply {
    match tokio::task::spawn_blocking(work).await {
        Ok(Ok(document)) => reply(StatusCode::OK, "application/json", document),
        Ok(Err(problem)) => {
            let status = match problem {
                Problem::Refused(_) => StatusCode::BAD_REQUEST,
                Problem::Conflict(_) => StatusCode::CONFLICT,
                _ => StatusCode::INTERNAL_SERVER_ERROR,
            };
            refusal(status, problem)
        }
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

fn reply(status: StatusCode, kind: &'static str, body: impl Into<Bytes>) -> Reply {
    let mut reply = Response::new(Full::new(body.into()));
    *reply.status_mut() = status;
    let headers = reply.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    reply
}

fn refusal(status: StatusCode, because: impl std::fmt::Display) -> Reply {
    reply(status, "application/json", json!({ "error": because.to_string() }).to_string())
}
