//! Servers in threads of this process, which can change their replies.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use robogate_remote::header::{decode, encode};
use robogate_remote::limits::REQUEST;
use robogate_remote::message::{Envelope, Hello, Period, Reply, Request, StepReply};
use robogate_remote::{EnvironmentHost, Host, Server, Timeouts};
use robogate_zmtp::{Address, Replier};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::toy::Toy;

/// Changes the frames of the `n`th reply of a server to this request. `None` stops the server.
pub(crate) type Tamper = fn(n: u64, request: &[u8], reply: Vec<Vec<u8>>) -> Option<Vec<Vec<u8>>>;

pub(crate) fn unchanged(_: u64, _: &[u8], reply: Vec<Vec<u8>>) -> Option<Vec<Vec<u8>>> {
    Some(reply)
}

/// A server in its own thread. It stops when this is dropped.
pub(crate) struct Running {
    pub(crate) address: Address,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    /// Start a server of the toy simulator.
    pub(crate) fn start(hello: Hello, tamper: Tamper) -> Self {
        Self::start_host(move || EnvironmentHost::new(hello, Box::new(Toy::default())), tamper)
    }

    /// Start a server of this host.
    pub(crate) fn start_host<H: Host>(host: impl FnOnce() -> H + Send + 'static, tamper: Tamper) -> Self {
        let replier = Replier::bind(&"tcp://127.0.0.1:*".parse().unwrap(), REQUEST).unwrap();
        let (address, stop) = (replier.address().clone(), Arc::new(AtomicBool::new(false)));
        let stopping = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut server = Server::new(host());
            let mut n = 0;
            replier.serve(&stopping, &mut |request| {
                let reply = server.answer(&request);
                n += 1;
                tamper(n, request.first().map_or(&[], Vec::as_slice), reply).unwrap_or_else(|| {
                    stopping.store(true, Ordering::Relaxed);
                    Vec::new()
                })
            });
        });
        Self { address, stop, thread: Some(thread) }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Timeouts that no answer of a sound server reaches, even on a busy machine.
pub(crate) fn timeouts() -> Timeouts {
    Timeouts::from_step(Duration::from_secs(30))
}

/// Name of the operation of a request.
pub(crate) fn op(request: &[u8]) -> String {
    decode::<Request<AnyBody>>(request).map_or_else(|_| String::new(), |request| request.op)
}

/// The keys of an operation, without parsing.
#[derive(serde::Serialize, serde::Deserialize)]
pub(crate) struct AnyBody {}

/// Change the steps of a reply, if it is the reply to a step. `S` is the type of the samples.
pub(crate) fn in_steps<S: Serialize + DeserializeOwned>(
    request: &[u8],
    mut reply: Vec<Vec<u8>>,
    change: impl Fn(&mut StepReply<S>),
) -> Vec<Vec<u8>> {
    if op(request) == "step" {
        let mut steps: StepReply<S> = decode(&reply[0]).unwrap();
        let envelope: Envelope = decode(&reply[0]).unwrap();
        change(&mut steps);
        reply[0] = encode(&Reply { envelope, body: steps }).unwrap();
    }
    reply
}

/// The joint positions that a control period reports.
pub(crate) fn joints<S>(period: &mut Period<S>) -> &mut Vec<f64> {
    vector(period, "joint_positions")
}

/// A vector that a control period reports.
pub(crate) fn vector<'a, S>(period: &'a mut Period<S>, name: &str) -> &'a mut Vec<f64> {
    period.observation.vectors.get_mut(name).unwrap()
}
