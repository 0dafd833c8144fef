//! The processes of an environment: one server for each worker.

use std::collections::BTreeMap;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use robogate_remote::{Pool, Timeouts};
use robogate_zmtp::Address;
use serde::Deserialize;

use super::imported::Imported;
use super::process::{Process, locked};
use super::python::{Interpreter, readable};
use crate::failure::{Failure, OrFailure};
use crate::isolation::hint_for_refused;
use crate::loaded_policy::LoadedPolicy;
use crate::notice::{note, warning};
use crate::text::{foreign, indented};

/// The servers of one environment. They end when this value is dropped, and when this process ends in any way: a server
/// ends with its standard input, and on Linux with the thread that started it.
pub struct Servers {
    environment: String,
    /// The interpreter that the user named.
    named_python: Option<PathBuf>,
    interpreter: Interpreter,
    timeouts: Timeouts,
    /// Requests to the thread that starts processes. A server ends with the thread that started it, so this must not be
    /// a worker, which may end earlier.
    starter: Option<Sender<Request>>,
    thread: Option<JoinHandle<()>>,
    running: Mutex<BTreeMap<usize, Process>>,
    /// The last output of a server that was shown to the user.
    shown: Mutex<String>,
    /// What the first server has imported.
    imported: OnceLock<Imported>,
    /// How long the first server took to start.
    start: OnceLock<Duration>,
}

/// A request to start a process.
struct Request {
    /// Whether its environment runs an episode first, which shows what it uses.
    first: bool,
    /// Its position in the pool.
    position: usize,
    reply: Sender<io::Result<Process>>,
}

/// The line that a server prints when it is ready.
#[derive(Deserialize)]
struct Ready {
    listening: String,
    /// What the sandbox refused so far.
    #[serde(default)]
    refused: Vec<String>,
    /// Warnings of its check.
    #[serde(default)]
    notes: Vec<String>,
    #[serde(flatten)]
    imported: Imported,
}

impl Servers {
    /// Starts the first server. Each server also loads this policy. `timeouts` also limit its calls of the environment before it is
    /// ready. They write the physics of their episodes to the folder `probe`.
    pub fn start(
        environment: String,
        loads: Option<&LoadedPolicy>,
        named_python: Option<PathBuf>,
        interpreter: Interpreter,
        timeouts: Timeouts,
        probe: Option<&Path>,
    ) -> Result<(Arc<Self>, Address), Failure> {
        let (starter, requests) = mpsc::channel::<Request>();
        let (name, python) = (environment.clone(), interpreter.clone());
        let loads = loads.map(|policy| format!("--policy={}", policy.argument()));
        let probe = probe.map(|folder| format!("--probe={}", folder.display()));
        let thread = thread::spawn(move || {
            for Request { first, position, reply } in requests {
                let first = first.then_some("--first");
                let arguments: Vec<&str> = ["--child", &name]
                    .into_iter()
                    .chain(first)
                    .chain(loads.as_deref())
                    .chain(probe.as_deref())
                    .collect();
                // Without a receiver the process is dropped, which ends it.
                let _ = reply.send(python.start("serve", &arguments, position));
            }
        });
        let (starter, thread) = (Some(starter), Some(thread));
        let (running, shown, imported) = (Mutex::default(), Mutex::default(), OnceLock::new());
        let start = OnceLock::new();
        let servers =
            Self { environment, named_python, interpreter, timeouts, starter, thread, running, shown, imported, start };
        let began = Instant::now();
        let address = servers.launch(0)?;
        servers.start.get_or_init(|| began.elapsed());
        Ok((Arc::new(servers), address))
    }

    /// The interpreter that the user named.
    pub fn named_python(&self) -> Option<&Path> {
        self.named_python.as_deref()
    }

    /// How long the first server took to start, and the number of its process.
    pub(crate) fn first(&self) -> Option<(Duration, u32)> {
        Some((*self.start.get()?, locked(&self.running).get(&0)?.id()))
    }

    /// What the servers have imported.
    pub(crate) fn imported(&self) -> Imported {
        self.imported.get().cloned().unwrap_or_default()
    }

    /// Starts servers until the pool has `count` of them.
    pub fn grow(&self, pool: &Pool, count: NonZeroUsize) -> Result<(), Failure> {
        let more = pool.len()..count.get();
        let started: Vec<Result<Address, Failure>> = thread::scope(|scope| {
            let threads: Vec<_> = more.map(|position| scope.spawn(move || self.launch(position))).collect();
            let panicked = |_| Err(anyhow!("a thread that starts a server panicked")).or_broken();
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(panicked)).collect()
        });
        for address in started {
            pool.add(address?).or_broken()?;
        }
        Ok(())
    }

    /// Starts the server at this position of the pool again, and tells the user what the old one printed.
    pub fn restart(&self, position: usize) -> Result<Address, String> {
        let old = locked(&self.running).remove(&position);
        if let Some(mut old) = old {
            let how = match old.ended() {
                Some(status) => format!("has ended ({status}) and is started again"),
                None => "is started again after this failure".to_owned(),
            };
            let output = old.end();
            let same = std::mem::replace(&mut *locked(&self.shown), output.clone()) == output;
            let output = match &*output {
                "" => "It printed nothing.".to_owned(),
                _ if same => "Its output is the same as the last one above.".to_owned(),
                output => format!("Its last output:\n{output}"),
            };
            note(indented(format_args!("server {} of {} {how}. {output}", position + 1, self.environment)));
        }
        self.launch(position).map_err(|failure| format!("{:#}", failure.error))
    }

    /// Starts a server and waits until it is ready.
    fn launch(&self, position: usize) -> Result<Address, Failure> {
        let broken = || anyhow!("the thread that starts servers has ended");
        let (reply, started) = mpsc::channel();
        let request = Request { first: position == 0, position, reply };
        self.starter.as_ref().ok_or_else(broken).or_broken()?.send(request).map_err(|_| broken()).or_broken()?;
        let started = started.recv().map_err(|_| broken()).or_broken()?;
        let mut process = started.map_err(|why| self.interpreter.unusable(&why)).or_request()?;
        match process.answer(&self.environment, &self.timeouts) {
            Ok(line) => {
                let ready = serde_json::from_str::<Ready>(&line).ok();
                for refused in ready.iter().flat_map(|ready| &ready.refused).filter(|_| position == 0) {
                    let told = format!("the sandbox refused {} to {}", self.environment, foreign(refused));
                    let hint = hint_for_refused(&format!("refused to {refused}"));
                    note(std::iter::once(&*told).chain(hint).collect::<Vec<_>>().join("\n"));
                }
                for found in ready.iter().flat_map(|ready| &ready.notes).filter(|_| position == 0) {
                    warning(format_args!("{}: {}", self.environment, foreign(found)));
                }
                let imported = ready.as_ref().map(|ready| ready.imported.clone()).unwrap_or_default();
                let address = ready.and_then(|ready| ready.listening.parse().ok());
                let wrong =
                    || anyhow!("{}: its server printed `{}` instead of an address", self.environment, line.trim_end());
                let address = address.ok_or_else(wrong).or_broken()?;
                if !imported.agrees_with(self.imported.get_or_init(|| imported.clone())) {
                    let why = "its files have changed during the run, so its servers do not run the same code";
                    return Err(anyhow!(
                        "{}: {why}\nHint: restore the files and resume, or start a new run",
                        self.environment
                    ))
                    .or_request();
                }
                locked(&self.running).insert(position, process);
                Ok(address)
            }
            Err(why) => {
                let (name, python) = (&self.environment, self.interpreter.path().display());
                let how = match (&why.late, why.status) {
                    (Some(late), _) => format!(": {late}"),
                    (None, Some(status)) => format!(" ({status})"),
                    (None, None) => String::new(),
                };
                let message = readable(&why.output);
                let output = match (&why.late, &*message) {
                    (Some(_), "") => "\nIt printed nothing.".to_owned(),
                    (Some(_), output) => format!("\nIts last output:\n{output}"),
                    (None, output) => format!(":\n{output}"),
                };
                Err(why.failure(format!("the environment {name} does not start in {python}{how}{output}")))
            }
        }
    }
}

impl Drop for Servers {
    fn drop(&mut self) {
        let mut running = std::mem::take(&mut *locked(&self.running));
        // All at once, then wait for each.
        running.values_mut().for_each(Process::close);
        drop(running);
        drop(self.starter.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
