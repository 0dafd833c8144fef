//! A service on a free port, and synthetic cycles.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;

use robogate_core::Seed;
use robogate_monitor::Monitor;
use robogate_monitor::service::{
    HttpError, HttpSettings, Intake, Replays, ServiceEngine, ServiceSettings, Store, StoreSettings, serve,
};
use serde_json::{Value, json};
use tokio::sync::oneshot;

pub(crate) fn intake(path: &Path, store: StoreSettings) -> Intake {
    let settings = ServiceSettings::default();
    let mut detectors = settings.detectors;
    detectors.learn_cycles = 100;
    detectors.history_cycles = 256;
    Intake::open(Store::open(path, store).unwrap(), Monitor::new(detectors).unwrap(), settings.late_after_s).unwrap()
}

/// A service that is stopped on drop.
pub(crate) struct Service {
    pub(crate) address: SocketAddr,
    pub(crate) engine: ServiceEngine,
    stop: oneshot::Sender<()>,
    thread: JoinHandle<Result<(), HttpError>>,
}

impl Service {
    pub(crate) fn start(path: &Path, http: HttpSettings, token: Option<&str>) -> Self {
        Self::with(intake(path, StoreSettings::default()), http, token, |_| {})
    }

    pub(crate) fn with(
        intake: Intake,
        http: HttpSettings,
        token: Option<&str>,
        say: impl Fn(&str) + Send + 'static,
    ) -> Self {
        Self::replaying(intake, http, token, None, say)
    }

    pub(crate) fn replaying(
        intake: Intake,
        http: HttpSettings,
        token: Option<&str>,
        replays: Option<Replays>,
        say: impl Fn(&str) + Send + 'static,
    ) -> Self {
        let engine = ServiceEngine::open(intake, say);
        let (stop, stopped) = oneshot::channel();
        let (bound, address) = channel();
        let (handle, token) = (engine.handle(), token.map(str::to_owned));
        let thread = std::thread::spawn(move || {
            let any = "127.0.0.1:0".parse().unwrap();
            serve(any, token, http, handle, replays, |address| bound.send(address).unwrap(), stopped)
        });
        Self { address: address.recv().unwrap(), engine, stop, thread }
    }

    pub(crate) fn end(self) {
        self.close().unwrap();
    }

    /// Stops it. Returns the error if its state could not be written.
    pub(crate) fn close(self) -> Result<(), String> {
        self.stop.send(()).unwrap();
        self.thread.join().unwrap().unwrap();
        self.engine.close()
    }
}

/// An HTTP client that returns error statuses as replies.
pub(crate) fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).build().into()
}

/// Sends a POST request. Returns status and body.
pub(crate) fn post(address: SocketAddr, path: &str, body: &str, token: Option<&str>) -> (u16, Value) {
    let mut request = agent().post(format!("http://{address}{path}"));
    if let Some(token) = token {
        request = request.header("authorization", format!("Bearer {token}"));
    }
    let mut answer = request.send(body).unwrap();
    let text = answer.body_mut().read_to_string().unwrap();
    (answer.status().as_u16(), serde_json::from_str(&text).unwrap_or(Value::String(text)))
}

/// Sends a GET request. Returns status and body.
pub(crate) fn get(address: SocketAddr, path: &str) -> (u16, String) {
    let mut answer = agent().get(format!("http://{address}{path}")).call().unwrap();
    (answer.status().as_u16(), answer.body_mut().read_to_string().unwrap())
}

/// Cycle `i` of a stream with a fixed seed and the failure rate `rate`.
pub(crate) fn cycle(i: u64, failing: f64) -> String {
    let mut stream = Seed::campaign(2).episode(i).stream("cycle");
    let success = stream.uniform() >= failing;
    json!({
        "id": format!("c{i}"), "robot": format!("cell-{}", i % 3), "recipe": format!("part-{}", i % 2),
        "time_s": 1_760_000_000.0 + 4.0 * i as f64, "success": success, "drop": false,
        "cycle_time_s": 4.0 + stream.uniform(),
    })
    .to_string()
}

pub(crate) fn cycles(range: std::ops::Range<u64>, failing: f64) -> String {
    range.map(|i| cycle(i, failing) + "\n").collect()
}
