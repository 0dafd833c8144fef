//! The HTTP server: receives cycles, and returns status, metrics and the page.
//!
//! | request | answer |
//! |---|---|
//! | `POST /v1/cycles` | takes one cycle, an array of cycles, or one cycle per line; returns the result of the batch |
//! | `POST /v1/periods` | takes one control period, an array of them, or one per line; returns the warnings |
//! | `GET /v1/cycles?recipe=NAME&until=ID` | the last cycles of a recipe up to this one, and similar simulated episodes |
//! | `POST /v1/recipes/NAME/restart` | restarts the recipe's detectors, after the cause was repaired |
//! | `GET /v1/status` | the status document |
//! | `GET /v1/fleet` | all robots, and the differences between the robots of each recipe |
//! | `GET /v1/replay?run=N&index=N` | a simulated episode, recomputed, with its nearest passing episode |
//! | `GET /metrics` | metrics for Prometheus |
//! | `GET /healthz` | 200 while cycles can be written |
//! | `GET /`, `GET /page.js`, `GET /page.css` | the page, its script and its style |
//! | `GET /replay` | the page that plays the simulated episodes most similar to an alarm |
//!
//! Without a token, only this machine may connect: the address must be a loopback address, requests must name it as
//! their host, and pages of other sites may not post. With a token, all paths except those of the page (which contain no data)
//! and `/healthz` require it.
//!
//! A slow client only occupies one of many connections: request heads, bodies and whole connections have time limits, and
//! an unfinished head gives its place to a new connection. Bodies are parsed on other threads.

use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use http_body_util::{BodyExt, Full};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Serialize;
use serde_json::json;
use serde_json::value::RawValue;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{oneshot, watch};

use super::admission::{is_this_machine, same};
use super::batch::Batch;
use super::engine::{Answer, Busy, Handle, Job, NO_DETECTOR, Problem};
use super::fleet::FleetStatus;
use super::intake::Taken;
use super::peers::{Connection, Peers};
use super::replays::Replays;
use super::settings::HttpSettings;
use super::warnings::Periods;

/// Time for which a comparison of the robots is reused.
const FLEET_HOLDS: Duration = Duration::from_secs(10);

/// Number of threads that parse bodies and compare robots.
const PARSERS: usize = 2;
/// Time for which a health check waits for the engine before it reports the last known health.
const HEALTH_WAIT: Duration = Duration::from_millis(25);
/// Age up to which a known health is reported.
const HEALTH_HOLDS: Duration = Duration::from_secs(60);

/// The page. It loads no external resources.
const PAGE: &str = include_str!("page.html");
/// Its script. It is a file of its own, so that the policy of the page forbids inline scripts.
const SCRIPT: &str = include_str!("page.js");
/// Its style.
const STYLE: &str = include_str!("page.css");
/// The reply without simulated episodes.
const NO_EPISODES: &str = "this monitor replays no simulated episodes. Hint: start it with --episodes RUN";

/// The error that prevents or ends the HTTP server.
#[derive(Debug, thiserror::Error)]
pub enum HttpError {
    /// An address that other machines can reach, without a token.
    #[error("other machines can reach {0}, but no token is configured\nHint: use --token-file, or listen on 127.0.0.1")]
    NoToken(SocketAddr),
    /// An address that other machines can reach, for a server that only serves this one.
    #[error("{0} is not an address of this machine alone. Expected a loopback address such as 127.0.0.1")]
    NotLocal(SocketAddr),
    /// The operating system has no random numbers for a token.
    #[error("the operating system returned no random numbers: {0}")]
    Random(String),
    /// A token that is too short.
    #[error("the token has {0} bytes. Expected at least 16")]
    ShortToken(usize),
    /// The address cannot be used.
    #[error("cannot listen on {address}: {because}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The cause.
        because: std::io::Error,
    },
}

/// Serves until `stop` receives a message or is dropped. `listening` receives the address, whose port the system may
/// have chosen. With `replays`, the page of an alarm plays simulated episodes.
///
/// # Errors
/// If the server cannot start.
pub fn serve(
    address: SocketAddr,
    token: Option<String>,
    settings: HttpSettings,
    engine: Handle,
    replays: Option<Replays>,
    listening: impl FnOnce(SocketAddr),
    stop: oneshot::Receiver<()>,
) -> Result<(), HttpError> {
    match &token {
        None if !address.ip().is_loopback() => return Err(HttpError::NoToken(address)),
        Some(token) if token.len() < 16 => return Err(HttpError::ShortToken(token.len())),
        _ => {}
    }
    let failed = |because| HttpError::Listen { address, because };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(PARSERS)
        .build()
        .map_err(failed)?;
    runtime.block_on(async {
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        listening(listener.local_addr().map_err(failed)?);
        let server = Arc::new(Server {
            token,
            settings,
            engine,
            replays,
            peers: Mutex::new(Peers::default()),
            held: AtomicUsize::new(0),
            // The store was opened for this server.
            health: Mutex::new((Instant::now(), Ok(()))),
            fleet: tokio::sync::Mutex::new(None),
        });
        let (closing, closed) = watch::channel(false);
        tokio::select! {
            () = accept(&listener, &server, &closed) => {}
            _ = stop => {}
        }
        // Gives requests in progress time to finish.
        drop((listener, closed));
        closing.send_replace(true);
        let _ = tokio::time::timeout(Duration::from_secs(5), closing.closed()).await;
        Ok(())
    })
}

struct Server {
    token: Option<String>,
    settings: HttpSettings,
    engine: Handle,
    replays: Option<Replays>,
    peers: Mutex<Peers>,
    /// Total size of the bodies in memory, in bytes.
    held: AtomicUsize,
    /// The last known health, and its time.
    health: Mutex<(Instant, Answer<()>)>,
    /// The last comparison of the robots.
    fleet: tokio::sync::Mutex<Option<(Instant, Bytes)>>,
}

async fn accept(listener: &TcpListener, server: &Arc<Server>, closed: &watch::Receiver<bool>) {
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // Most likely no file descriptors are left. Other connections will end.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let server = Arc::clone(server);
        let mut open = closed.clone();
        tokio::spawn(async move {
            let connection = server.peers.lock().ok().and_then(|mut peers| peers.connect(peer.ip(), &server.settings));
            if let Some(connection) = connection {
                converse(&server, stream, connection, &mut open).await;
            }
            drop(open);
        });
    }
}

/// A connection and whether a request of it is in progress. Dropping it gives its place free.
struct Open {
    server: Arc<Server>,
    connection: Mutex<(Connection, bool)>,
}

impl Open {
    /// Changes the state of the connection.
    fn with<T>(&self, change: impl FnOnce(&mut Peers, &mut (Connection, bool)) -> T) -> Option<T> {
        let mut peers = self.server.peers.lock().ok()?;
        let mut state = self.connection.lock().ok()?;
        Some(change(&mut peers, &mut state))
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.with(|peers, (connection, busy)| peers.disconnect(connection, *busy));
    }
}

async fn converse(server: &Arc<Server>, stream: TcpStream, connection: Connection, ending: &mut watch::Receiver<bool>) {
    let _ = stream.set_nodelay(true);
    let (close, address) = (Arc::clone(&connection.close), connection.address());
    let open = Arc::new(Open { server: Arc::clone(server), connection: Mutex::new((connection, false)) });
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(address);
        let open = Arc::clone(&open);
        async move {
            let allowed = open.with(|peers, (connection, busy)| {
                *busy = true;
                peers.begin(connection, &open.server.settings)
            });
            let reply = if allowed == Some(true) {
                respond(&open.server, request).await
            } else {
                later(StatusCode::TOO_MANY_REQUESTS, "too many requests from this address")
            };
            open.with(|peers, (connection, busy)| {
                *busy = false;
                peers.end(connection);
            });
            Ok::<_, Infallible>(reply)
        }
    });
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(Duration::from_secs_f64(server.settings.head_s))
        .max_buf_size(64 << 10)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = std::pin::pin!(connection);
    let life = tokio::time::sleep(Duration::from_secs_f64(server.settings.connection_s));
    // A broken connection needs no action.
    tokio::select! {
        _ = connection.as_mut() => return,
        // Another connection takes its place.
        () = close.notified() => return,
        () = life => {}
        _ = ending.wait_for(|ending| *ending) => {}
    }
    // Answers the request in progress and accepts no further one.
    connection.as_mut().graceful_shutdown();
    let last = server.settings.body_s + server.settings.answer_s;
    let _ = tokio::time::timeout(Duration::from_secs_f64(last), connection).await;
}

pub(super) type Reply = Response<Full<Bytes>>;

pub(super) fn reply(status: StatusCode, kind: &'static str, body: impl Into<Bytes>) -> Reply {
    let mut reply = Response::new(Full::new(body.into()));
    *reply.status_mut() = status;
    let headers = reply.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    reply
}

fn document(status: StatusCode, body: &impl Serialize) -> Reply {
    // Strings and finite numbers always serialise.
    reply(status, "application/json", serde_json::to_vec(body).unwrap_or_default())
}

/// A refusal that asks the sender to try again.
pub(super) fn later(status: StatusCode, because: impl std::fmt::Display) -> Reply {
    let mut reply = refusal(status, because);
    reply.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
    reply
}

pub(super) fn refusal(status: StatusCode, because: impl std::fmt::Display) -> Reply {
    document(status, &json!({ "error": because.to_string() }))
}

async fn respond(server: &Server, request: Request<Incoming>) -> Reply {
    let path = request.uri().path().to_owned();
    let open = matches!(path.as_str(), "/" | "/page.js" | "/page.css" | "/replay" | "/healthz");
    if let Some(refused) = admit(server, &request, open) {
        return refused;
    }
    match (request.method(), path.as_str()) {
        (&Method::POST, "/v1/cycles") => cycles(server, request).await,
        (&Method::POST, "/v1/periods") => periods(server, request).await,
        (&Method::POST, path) if restart_of(path).is_some() => {
            let recipe = restart_of(path).unwrap_or_default();
            match ask(server, |reply| Job::Restart { recipe, reply }).await {
                Ok(true) => document(StatusCode::OK, &json!({ "restarted": true })),
                Ok(false) => refusal(StatusCode::NOT_FOUND, "no such recipe"),
                Err(refused) => refused,
            }
        }
        (&Method::GET, "/v1/status") => match ask(server, |reply| Job::Status { reply }).await {
            Ok(status) => document(StatusCode::OK, &status),
            Err(refused) => refused,
        },
        (&Method::GET, "/v1/cycles") => match (asked(&request, "recipe"), asked(&request, "until")) {
            (Some(recipe), Some(until)) => match ask(server, |reply| Job::Around { recipe, until, reply }).await {
                Ok(around) => document(StatusCode::OK, &around),
                Err(refused) => refused,
            },
            _ => refusal(StatusCode::BAD_REQUEST, "expected `?recipe=NAME&until=ID` with the id of a cycle"),
        },
        (&Method::GET, "/v1/fleet") => fleet(server).await,
        (&Method::GET, "/v1/replay") => replay(server, &request).await,
        (&Method::GET, "/replay") => match &server.replays {
            Some(replays) => replays.page(),
            None => refusal(StatusCode::NOT_FOUND, NO_EPISODES),
        },
        (&Method::GET, "/metrics") => match ask(server, |reply| Job::Metrics { reply }).await {
            Ok(text) => reply(StatusCode::OK, "text/plain; version=0.0.4; charset=utf-8", text),
            Err(refused) => refused,
        },
        (&Method::GET, "/healthz") => healthy(server).await,
        (&Method::GET, "/") => {
            let mut page = reply(StatusCode::OK, "text/html; charset=utf-8", PAGE);
            let policy = "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; \
                          img-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
            page.headers_mut().insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy));
            page
        }
        (&Method::GET, "/page.js") => reply(StatusCode::OK, "text/javascript; charset=utf-8", SCRIPT),
        (&Method::GET, "/page.css") => reply(StatusCode::OK, "text/css; charset=utf-8", STYLE),
        (
            _,
            "/v1/cycles" | "/v1/periods" | "/v1/status" | "/v1/fleet" | "/v1/replay" | "/metrics" | "/healthz"
            | "/page.js" | "/page.css" | "/replay" | "/",
        ) => refusal(StatusCode::METHOD_NOT_ALLOWED, "this path does not support this method"),
        _ => refusal(StatusCode::NOT_FOUND, "not found; the page is at /"),
    }
}

/// A simulated episode.
async fn replay(server: &Server, request: &Request<Incoming>) -> Reply {
    let number = |name| asked(request, name).and_then(|text| text.parse::<u64>().ok());
    let run = number("run").and_then(|run| usize::try_from(run).ok());
    match (&server.replays, run.zip(number("index"))) {
        (None, _) => refusal(StatusCode::NOT_FOUND, NO_EPISODES),
        (Some(_), None) => refusal(StatusCode::BAD_REQUEST, "expected `?run=N&index=N`"),
        (Some(replays), Some((run, index))) => {
            replays.episode(run, index, Duration::from_secs_f64(server.settings.answer_s)).await
        }
    }
}

/// Refuses unauthorised requests.
fn admit(server: &Server, request: &Request<Incoming>, open: bool) -> Option<Reply> {
    let text = |name| request.headers().get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    match &server.token {
        Some(_) if open => None,
        Some(token) => {
            let sent = text(header::AUTHORIZATION).and_then(|value| value.split_once(' ')).unwrap_or_default();
            if sent.0.eq_ignore_ascii_case("bearer") && same(sent.1.as_bytes(), token.as_bytes()) {
                return None;
            }
            let mut refused = refusal(StatusCode::UNAUTHORIZED, "a bearer token is required");
            refused.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            Some(refused)
        }
        None => {
            // A foreign DNS name that resolves to this machine is rejected (DNS rebinding).
            let host = text(header::HOST).unwrap_or_default();
            if !is_this_machine(host) {
                return Some(refusal(
                    StatusCode::FORBIDDEN,
                    "without a token the host must be localhost or a loopback address",
                ));
            }
            let origin = text(header::ORIGIN).map(|origin| origin.trim_start_matches("http://"));
            let foreign = origin.is_some_and(|origin| origin != host);
            foreign.then(|| refusal(StatusCode::FORBIDDEN, "pages of other sites may not send requests"))
        }
    }
}

/// Sends a request to the engine and converts a problem into a reply.
async fn ask<T>(server: &Server, job: impl FnOnce(oneshot::Sender<Answer<T>>) -> Job) -> Result<T, Reply> {
    let busy = |busy: Busy| later(StatusCode::SERVICE_UNAVAILABLE, busy);
    let answer = server.engine.ask(job).map_err(busy)?;
    match tokio::time::timeout(Duration::from_secs_f64(server.settings.answer_s), answer).await {
        Ok(Ok(Ok(value))) => Ok(value),
        Ok(Ok(Err(problem))) => Err(refusal(status_of(&problem), problem.because)),
        Ok(Err(_)) => Err(busy(Busy)),
        Err(_) => Err(refusal(
            StatusCode::GATEWAY_TIMEOUT,
            "no answer in time. Send again: known cycles are not counted twice",
        )),
    }
}

/// Whether cycles can be written. A large batch that is being written, or a busy machine, does not delay the reply: it then reports the
/// last known health, which each written batch renews.
async fn healthy(server: &Server) -> Reply {
    let answer = async { server.engine.ask(|reply| Job::Healthy { reply }).ok()?.await.ok() };
    let now = tokio::time::timeout(HEALTH_WAIT, answer).await.ok().flatten();
    let Ok(mut last) = server.health.lock() else {
        return refusal(StatusCode::INTERNAL_SERVER_ERROR, "the last health is not readable");
    };
    if let Some(answer) = now {
        *last = (Instant::now(), answer);
    }
    match &*last {
        (since, _) if since.elapsed() >= HEALTH_HOLDS => later(StatusCode::SERVICE_UNAVAILABLE, Busy),
        (_, Ok(())) => document(StatusCode::OK, &json!({ "healthy": true })),
        (_, Err(problem)) => refusal(status_of(problem), &problem.because),
    }
}

/// The status of a failed request.
fn status_of(problem: &Problem) -> StatusCode {
    if problem.full { StatusCode::INSUFFICIENT_STORAGE } else { StatusCode::INTERNAL_SERVER_ERROR }
}

async fn cycles(server: &Server, request: Request<Incoming>) -> Reply {
    let sender = request.extensions().get::<IpAddr>().map_or_else(|| "http".to_owned(), IpAddr::to_string);
    let mut held = Held { bytes: 0, of: server };
    let body = match body_of(request, &mut held).await {
        Ok(body) => body,
        Err(refused) => return refused,
    };
    // Not on this thread, which answers all other clients.
    let batch = match tokio::task::spawn_blocking(move || Batch::parse(&lines(body))).await {
        Ok(Ok(batch)) => batch,
        Ok(Err(error)) => return refusal(StatusCode::PAYLOAD_TOO_LARGE, error),
        Err(error) => return refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
    };
    match ask(server, |reply| Job::Cycles { batch: batch.sent_by(&sender), reply }).await {
        Ok(taken) => {
            if let Ok(mut last) = server.health.lock() {
                *last = (Instant::now(), Ok(()));
            }
            answer_of(&taken)
        }
        Err(refused) => refused,
    }
}

/// Control periods, and the warnings that follow.
async fn periods(server: &Server, request: Request<Incoming>) -> Reply {
    let mut held = Held { bytes: 0, of: server };
    let body = match body_of(request, &mut held).await {
        Ok(body) => body,
        Err(refused) => return refused,
    };
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let periods = match tokio::task::spawn_blocking(move || Periods::parse(&lines(body), now)).await {
        Ok(Ok(periods)) => periods,
        Ok(Err(error)) => return refusal(StatusCode::PAYLOAD_TOO_LARGE, error),
        Err(error) => return refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
    };
    match ask(server, |reply| Job::Periods { periods, reply }).await {
        Ok(Some(heard)) if heard.accepted == 0 && heard.rejected > 0 => document(StatusCode::BAD_REQUEST, &heard),
        Ok(Some(heard)) => document(StatusCode::OK, &heard),
        Ok(None) => refusal(StatusCode::NOT_FOUND, NO_DETECTOR),
        Err(refused) => refused,
    }
}

/// The body of a request, within the limits of size and time.
async fn body_of(request: Request<Incoming>, held: &mut Held<'_>) -> Result<Vec<u8>, Reply> {
    let limit = Duration::from_secs_f64(held.of.settings.body_s);
    let late = || refusal(StatusCode::REQUEST_TIMEOUT, "the body took too long");
    tokio::time::timeout(limit, read(request.into_body(), held)).await.map_err(|_| late())?
}

/// Size of the bodies that one request holds in memory until it is answered.
struct Held<'a> {
    bytes: usize,
    of: &'a Server,
}

impl Held<'_> {
    /// Reserves more bytes. Returns whether there is space.
    fn hold(&mut self, bytes: usize) -> bool {
        self.bytes += bytes;
        self.of.held.fetch_add(bytes, Ordering::Relaxed) + bytes <= self.of.settings.most_held_bytes
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.of.held.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

async fn read(mut body: Incoming, held: &mut Held<'_>) -> Result<Vec<u8>, Reply> {
    let most = held.of.settings.most_body_bytes;
    let mut whole = Vec::new();
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| refusal(StatusCode::BAD_REQUEST, error))?;
        let Ok(data) = frame.into_data() else { continue };
        if whole.len() + data.len() > most {
            let because = format!("the body has more than {most} bytes");
            return Err(refusal(StatusCode::PAYLOAD_TOO_LARGE, because));
        }
        if !held.hold(data.len()) {
            return Err(later(StatusCode::SERVICE_UNAVAILABLE, "too many bytes wait to be written. Send again later"));
        }
        whole.extend_from_slice(&data);
    }
    Ok(whole)
}

/// Converts one document, an array of documents, or lines to one cycle per line. Other input is not changed.
fn lines(body: Vec<u8>) -> Vec<u8> {
    // A line break inside a document can only be white space.
    let one_line = |value: &RawValue| value.get().replace(['\n', '\r'], " ");
    match body.iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'[') => match serde_json::from_slice::<Vec<&RawValue>>(&body) {
            Ok(all) => all.into_iter().map(one_line).collect::<Vec<_>>().join("\n").into_bytes(),
            Err(_) => body,
        },
        // For several lines, the parser ends after the first one.
        _ => match serde_json::from_slice::<&RawValue>(&body) {
            Ok(value) => one_line(value).into_bytes(),
            Err(_) => body,
        },
    }
}

/// Compares the robots. Because this is expensive, it is done at most once per [`FLEET_HOLDS`].
async fn fleet(server: &Server) -> Reply {
    let mut kept = server.fleet.lock().await;
    if let Some((since, bytes)) = &*kept
        && since.elapsed() < FLEET_HOLDS
    {
        return reply(StatusCode::OK, "application/json", bytes.clone());
    }
    let tallies = match ask(server, |reply| Job::Fleet { reply }).await {
        Ok(tallies) => tallies,
        Err(refused) => return refused,
    };
    let made = tokio::task::spawn_blocking(move || serde_json::to_vec(&FleetStatus::of(&tallies))).await;
    match made {
        Ok(Ok(bytes)) => {
            let bytes = Bytes::from(bytes);
            *kept = Some((Instant::now(), bytes.clone()));
            reply(StatusCode::OK, "application/json", bytes)
        }
        Ok(Err(error)) => refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

/// Status 200 if all cycles were accepted, 422 if some were refused. Accepted cycles are on disk in both cases.
fn answer_of(taken: &Taken) -> Reply {
    let nothing = taken.accepted + taken.duplicates + taken.refused == 0;
    if nothing {
        return refusal(StatusCode::BAD_REQUEST, "the body contains no cycle");
    }
    let status = if taken.refused == 0 { StatusCode::OK } else { StatusCode::UNPROCESSABLE_ENTITY };
    document(status, taken)
}

/// The decoded recipe name of `/v1/recipes/NAME/restart`.
fn restart_of(path: &str) -> Option<String> {
    decoded(path.strip_prefix("/v1/recipes/")?.strip_suffix("/restart")?)
}

/// The value of a name in the query of a request.
fn asked(request: &Request<Incoming>, name: &str) -> Option<String> {
    let pairs = request.uri().query()?.split('&').filter_map(|pair| pair.split_once('='));
    decoded(pairs.into_iter().find(|(known, _)| *known == name)?.1)
}

/// Percent-decodes a text. `None` if it is empty or not UTF-8.
fn decoded(name: &str) -> Option<String> {
    let mut bytes = Vec::new();
    let mut rest = name.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(if byte == b'%' {
            let digit = |byte: Option<u8>| char::from(byte?).to_digit(16);
            (digit(rest.next())? * 16 + digit(rest.next())?) as u8
        } else {
            byte
        });
    }
    String::from_utf8(bytes).ok().filter(|name| !name.is_empty())
}
