//! The servers of one policy: which of them an episode uses, and how busy they are.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time for which a server that failed is used only if all others failed too.
const AVOIDED: Duration = Duration::from_secs(30);

/// One or several servers of the same policy, or its file. Clones share what they know.
#[derive(Debug, Clone)]
pub struct Servers(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    urls: Vec<String>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    servers: Vec<Server>,
    /// Requests without an answer, and since when there is one.
    waiting: usize,
    since: Option<Instant>,
    usage: Usage,
}

#[derive(Debug, Default, Clone)]
struct Server {
    /// Number of policies that are connected to it.
    policies: usize,
    failed: Option<Instant>,
}

/// How the servers of a policy were used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Number of answered requests.
    pub requests: u64,
    /// Time between request and answer, over all requests.
    pub waited: Duration,
    /// Time with at least one request in progress.
    pub busy: Duration,
}

impl Usage {
    /// What was used after `earlier`.
    #[must_use]
    pub fn since(self, earlier: Self) -> Self {
        Self {
            requests: self.requests - earlier.requests,
            waited: self.waited.saturating_sub(earlier.waited),
            busy: self.busy.saturating_sub(earlier.busy),
        }
    }
}

impl PartialEq for Servers {
    fn eq(&self, other: &Self) -> bool {
        self.0.urls == other.0.urls
    }
}

impl Servers {
    /// The servers in a list such as `ws://a:8000,ws://b:8000`, or a file.
    pub fn of(list: &str) -> Self {
        let mut urls: Vec<String> = Vec::new();
        for part in list.split(',') {
            match urls.last_mut() {
                // A comma of a path.
                Some(last) if !part.contains("://") || !last.contains("://") => *last += &format!(",{part}"),
                _ => urls.push(part.to_owned()),
            }
        }
        let state = State { servers: vec![Server::default(); urls.len()], ..State::default() };
        Self(Arc::new(Shared { urls, state: Mutex::new(state) }))
    }

    /// Their addresses.
    pub fn urls(&self) -> &[String] {
        &self.0.urls
    }

    /// How they were used so far.
    pub fn usage(&self) -> Usage {
        self.state().usage
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // No code panics between two related writes.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place at the server with the fewest policies.
    pub(crate) fn place(&self) -> Place {
        let mut state = self.state();
        let busy = |server: &Server| {
            let avoided = server.failed.is_some_and(|failed| failed.elapsed() < AVOIDED);
            (avoided, server.policies)
        };
        let at = (0..state.servers.len()).min_by_key(|&at| busy(&state.servers[at])).unwrap_or_default();
        state.servers[at].policies += 1;
        drop(state);
        Place { servers: self.clone(), at }
    }

    /// A request that is in progress until it is dropped.
    pub(crate) fn request(&self) -> Request<'_> {
        let began = Instant::now();
        let mut state = self.state();
        state.waiting += 1;
        state.since.get_or_insert(began);
        drop(state);
        Request { servers: self, began }
    }
}

/// A place at a server.
#[derive(Debug)]
pub(crate) struct Place {
    servers: Servers,
    at: usize,
}

impl Place {
    pub(crate) fn url(&self) -> &str {
        &self.servers.0.urls[self.at]
    }

    /// Leaves a server that failed.
    pub(crate) fn failed(self) {
        self.servers.state().servers[self.at].failed = Some(Instant::now());
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.servers.state().servers[self.at].policies -= 1;
    }
}

/// A request in progress.
pub(crate) struct Request<'a> {
    servers: &'a Servers,
    began: Instant,
}

impl Drop for Request<'_> {
    fn drop(&mut self) {
        let mut state = self.servers.state();
        state.usage.requests += 1;
        state.usage.waited += self.began.elapsed();
        state.waiting -= 1;
        if state.waiting == 0
            && let Some(since) = state.since.take()
        {
            state.usage.busy += since.elapsed();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read() {
        let urls = |list| Servers::of(list).urls().to_vec();
        assert_eq!(urls("ws://a:1,wss://b:2/x"), ["ws://a:1", "wss://b:2/x"]);
        assert_eq!(urls("ws://a:1/?x=1,2"), ["ws://a:1/?x=1,2"]);
        assert_eq!(urls("folder,with,commas/net.onnx"), ["folder,with,commas/net.onnx"]);
    }

    #[test]
    fn least_busy_server_is_chosen() {
        let servers = Servers::of("ws://a,ws://b");
        let [one, two] = [servers.place(), servers.place()];
        assert_eq!([one.url(), two.url()], ["ws://a", "ws://b"]);
        two.failed();
        let others = [servers.place(), servers.place()];
        assert!(others.iter().all(|place| place.url() == "ws://a"), "a failed server was chosen");
        drop((one, others));
        assert_eq!(servers.state().servers.iter().map(|server| server.policies).sum::<usize>(), 0);
    }

    #[test]
    fn overlapping_requests_are_busy_once() {
        let servers = Servers::of("ws://a");
        let [one, two] = [servers.request(), servers.request()];
        std::thread::sleep(Duration::from_millis(20));
        drop(one);
        drop(two);
        let Usage { requests, waited, busy } = servers.usage();
        assert_eq!(requests, 2);
        assert!(busy >= Duration::from_millis(20) && waited >= busy + Duration::from_millis(20), "{waited:?} {busy:?}");
    }
}
