//! Replays of the simulated episodes that alarms link to.

use std::sync::Arc;
use std::time::Duration;

use hyper::StatusCode;
use hyper::header::{self, HeaderValue};
use tokio::sync::{Semaphore, oneshot};

use super::http::{Reply, later, refusal, reply};

/// Recomputes episode `index` of run number `run` and returns it as a JSON document, or the reason why it cannot be shown.
pub type Recompute = dyn Fn(usize, u64) -> Result<Vec<u8>, String> + Send + Sync;

/// The page of a replay, and the source of its episodes.
pub struct Replays {
    page: String,
    policy: String,
    recompute: Arc<Recompute>,
    /// One episode is recomputed at a time, because that takes a processor core away from the detectors.
    free: Arc<Semaphore>,
}

impl Replays {
    /// A page with its content security policy, and the source of its episodes.
    pub fn new(page: String, policy: String, recompute: Arc<Recompute>) -> Self {
        Self { page, policy, recompute, free: Arc::new(Semaphore::new(1)) }
    }

    /// The page. It contains no data.
    pub(super) fn page(&self) -> Reply {
        let mut page = reply(StatusCode::OK, "text/html; charset=utf-8", self.page.clone());
        if let Ok(policy) = HeaderValue::from_str(&self.policy) {
            page.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
        }
        page.headers_mut().insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        page
    }

    /// An episode. The computation has a thread of its own, so cycles are received meanwhile. While it lasts, other requests
    /// are asked to come again.
    pub(super) async fn episode(&self, run: usize, index: u64, wait: Duration) -> Reply {
        let Ok(place) = Arc::clone(&self.free).try_acquire_owned() else {
            return later(StatusCode::SERVICE_UNAVAILABLE, "another episode is being recomputed");
        };
        let (sender, answer) = oneshot::channel();
        let recompute = Arc::clone(&self.recompute);
        std::thread::spawn(move || {
            let found = recompute(run, index);
            drop(place);
            // The client may have gone away.
            let _ = sender.send(found);
        });
        match tokio::time::timeout(wait, answer).await {
            Ok(Ok(Ok(document))) => reply(StatusCode::OK, "application/json", document),
            Ok(Ok(Err(because))) => refusal(StatusCode::NOT_FOUND, because),
            Ok(Err(_)) => refusal(StatusCode::INTERNAL_SERVER_ERROR, "the episode could not be recomputed"),
            Err(_) => refusal(StatusCode::GATEWAY_TIMEOUT, "the episode takes too long. Use the command to replay it"),
        }
    }
}
