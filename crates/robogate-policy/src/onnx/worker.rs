//! Calls of the ONNX library in a thread of their own, so that a deadline ends the wait for them.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread;

use super::super::deadline::Deadline;
use super::super::error::{PolicyError, shortened};

/// Most calls that may still run after their deadline, in this process. The library cannot interrupt a call.
const MAX_OVERDUE: usize = 8;

/// Stack of a thread, in bytes. The library plans a network by recursion over its nodes.
const STACK: usize = 256 << 20;

/// The threads whose calls have missed their deadline. An entry is dead once its thread has ended.
static OVERDUE: Mutex<Vec<Weak<()>>> = Mutex::new(Vec::new());

/// A thread that answers requests one after the other. It must not be used again after an error.
pub(super) struct Worker<Q, A> {
    requests: Sender<Q>,
    replies: Receiver<Result<A, String>>,
    alive: Weak<()>,
}

impl<Q: Send + 'static, A: Send + 'static> Worker<Q, A> {
    /// Start a thread that loads a model and then runs it once for each request. Returns what `load` returns beside the
    /// model.
    pub(super) fn start<M: 'static, L: Send + 'static>(
        load: impl FnOnce() -> Result<(M, L), PolicyError> + Send + 'static,
        run: fn(&M, Q) -> Result<A, String>,
        deadline: Deadline,
        operation: &str,
    ) -> Result<(Self, L), PolicyError> {
        let overdue = overdue();
        if overdue >= MAX_OVERDUE {
            return Err(PolicyError::reported(&format!(
                "{overdue} calls of networks that missed their deadline still run in this process. Hint: use a smaller \
                 network, or raise server.answer_s in the profile"
            )));
        }
        let token = Arc::new(());
        let alive = Arc::downgrade(&token);
        let (requests, incoming) = channel();
        let (outgoing, replies) = channel();
        let (loading, loaded) = channel();
        let work = move || {
            let _token = token;
            let model = match load() {
                Ok((model, description)) => loading.send(Ok(description)).map(|()| model),
                Err(error) => return drop(loading.send(Err(error))),
            };
            let Ok(model) = model else { return };
            for request in incoming {
                if outgoing.send(catch_panics(|| run(&model, request))).is_err() {
                    return;
                }
            }
        };
        let builder = thread::Builder::new().name("network".to_owned()).stack_size(STACK);
        builder.spawn(work).map_err(|e| PolicyError::reported(&format!("cannot start a thread: {e}")))?;
        let worker = Self { requests, replies, alive };
        let description = worker.wait(&loaded, deadline, operation)??;
        Ok((worker, description))
    }

    /// Send a request and wait for the reply until the deadline.
    pub(super) fn call(&self, request: Q, deadline: Deadline, operation: &str) -> Result<A, PolicyError> {
        self.requests.send(request).map_err(|_| ended(operation))?;
        self.wait(&self.replies, deadline, operation)?.map_err(|why| PolicyError::Network { text: shortened(&why) })
    }

    fn wait<T>(&self, from: &Receiver<T>, deadline: Deadline, operation: &str) -> Result<T, PolicyError> {
        from.recv_timeout(deadline.left().unwrap_or_default()).map_err(|error| match error {
            RecvTimeoutError::Timeout => {
                OVERDUE.lock().unwrap_or_else(PoisonError::into_inner).push(self.alive.clone());
                deadline.passed(operation)
            }
            RecvTimeoutError::Disconnected => ended(operation),
        })
    }
}

/// The number of threads that still run although their deadline has passed.
fn overdue() -> usize {
    let mut threads = OVERDUE.lock().unwrap_or_else(PoisonError::into_inner);
    threads.retain(|thread| thread.strong_count() > 0);
    threads.len()
}

fn ended(operation: &str) -> PolicyError {
    PolicyError::reported(&format!("{operation}: its thread has ended unexpectedly"))
}

/// Runs a third-party library and converts a panic into an error.
pub(super) fn catch_panics<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    robogate_core::guard::guarded(work).unwrap_or_else(|why| Err(format!("the ONNX library panicked: {why}")))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// A worker whose calls return when they are released.
    fn waiter() -> Result<(Worker<Receiver<()>, ()>, ()), PolicyError> {
        let wait = |(): &(), released: Receiver<()>| {
            let _ = released.recv();
            Ok(())
        };
        Worker::start(|| Ok(((), ())), wait, Deadline::within(600.0), "loading")
    }

    #[test]
    fn deadlines_end_the_wait() {
        let mut unreleased: Vec<Sender<()>> = Vec::new();
        let mut call = |worker: &Worker<Receiver<()>, ()>| {
            let (sender, released) = channel();
            unreleased.push(sender);
            worker.call(released, Deadline::within(0.2), "running x.onnx").unwrap_err()
        };
        // Such calls are limited.
        let mut most = 0;
        let error = loop {
            match waiter() {
                Ok((worker, ())) => {
                    most += 1;
                    assert!(most <= MAX_OVERDUE);
                    // The call has not returned, and does not until the end of this loop.
                    assert_eq!(call(&worker).to_string(), "timeout: running x.onnx took longer than 0.2 s");
                }
                Err(error) => break error,
            }
        };
        assert!(error.to_string().contains("missed their deadline still run"), "{error}");
        // The threads end once their calls return.
        drop(unreleased);
        while waiter().is_err() {
            thread::sleep(Duration::from_millis(50));
        }
    }
}
