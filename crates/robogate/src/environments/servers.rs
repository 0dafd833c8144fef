//! The processes of an environment: one server for each worker.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, BufRead, BufReader, Read};
use std::num::NonZeroUsize;
use std::process::{Child, Stdio};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use robogate_remote::Pool;
use robogate_zmtp::Address;
use serde::Deserialize;

use super::python::{Interpreter, PYTHON_USAGE, readable};
use crate::exit::{Exit, INFRASTRUCTURE, OrExit, USAGE};
use crate::terminal::{indented, note};

/// How long a server may take to start: large environments compile or load assets.
const START: Duration = Duration::from_secs(600);
/// How long a server may take to end after its standard input was closed.
const END: Duration = Duration::from_secs(2);
/// How many lines of a server's output are kept.
const LINES: usize = 60;

/// The servers of one environment. They end when this value is dropped, and when this process ends in any way: a server
/// ends with its standard input, and on Linux with the thread that started it.
pub(crate) struct Servers {
    environment: String,
    interpreter: Interpreter,
    /// Requests to the thread that starts processes. A server ends with the thread that started it, so this must not be
    /// a worker, which may end earlier.
    starter: Option<Sender<Sender<io::Result<Child>>>>,
    thread: Option<JoinHandle<()>>,
    running: Mutex<BTreeMap<usize, Running>>,
    /// The last output of a server that was shown to the user.
    shown: Mutex<String>,
}

/// A server.
struct Running {
    child: Child,
    output: Output,
    reader: Option<JoinHandle<()>>,
}

/// The last lines that a server wrote to standard error.
type Output = Arc<Mutex<VecDeque<String>>>;

/// The line that a server prints when it is ready.
#[derive(Deserialize)]
struct Ready {
    listening: String,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No code panics between two related writes.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Servers {
    /// Starts the first server.
    pub(crate) fn start(environment: String, interpreter: Interpreter) -> Result<(Arc<Self>, Address), Exit> {
        let (starter, requests) = mpsc::channel::<Sender<io::Result<Child>>>();
        let (name, python) = (environment.clone(), interpreter.clone());
        let thread = thread::spawn(move || {
            for reply in requests {
                let mut command = python.command("serve");
                command.args(["--child", &name]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
                // Without a receiver the process is dropped, which closes its standard input.
                let _ = reply.send(command.spawn());
            }
        });
        let (starter, thread) = (Some(starter), Some(thread));
        let servers =
            Self { environment, interpreter, starter, thread, running: Mutex::default(), shown: Mutex::default() };
        let address = servers.launch(0)?;
        Ok((Arc::new(servers), address))
    }

    /// Starts servers until the pool has `count` of them.
    pub(crate) fn grow(&self, pool: &Pool, count: NonZeroUsize) -> Result<(), Exit> {
        let more = pool.len()..count.get();
        let started: Vec<Result<Address, Exit>> = thread::scope(|scope| {
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
    pub(crate) fn restart(&self, position: usize) -> Result<Address, String> {
        let old = locked(&self.running).remove(&position);
        if let Some(mut old) = old {
            let ended = old.child.try_wait().ok().flatten();
            let how = match ended {
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
        self.launch(position).map_err(|exit| format!("{:#}", exit.error))
    }

    /// Starts a server and waits until it is ready.
    fn launch(&self, position: usize) -> Result<Address, Exit> {
        let broken = || anyhow!("the thread that starts servers has ended");
        let (reply, child) = mpsc::channel();
        self.starter.as_ref().ok_or_else(broken).or_broken()?.send(reply).map_err(|_| broken()).or_broken()?;
        let child = child.recv().map_err(|_| broken()).or_broken()?;
        let mut child = child.map_err(|why| self.interpreter.unusable(&why)).or_usage()?;
        let output = Output::default();
        let reader = child.stderr.take().map(|stream| {
            let output = Arc::clone(&output);
            thread::spawn(move || keep(stream, &output))
        });
        let (ready, line) = mpsc::channel();
        if let Some(stream) = child.stdout.take() {
            thread::spawn(move || {
                let mut line = String::new();
                // A server prints nothing else. An end without a line is an empty one.
                let _ = BufReader::new(stream.take(4096)).read_line(&mut line);
                let _ = ready.send(line);
            });
        }
        let line = line.recv_timeout(START);
        let address = line.ok().and_then(|line| serde_json::from_str::<Ready>(&line).ok()?.listening.parse().ok());
        let mut running = Running { child, output, reader };
        if let Some(address) = address {
            locked(&self.running).insert(position, running);
            return Ok(address);
        }
        let status = running.wait(END).map(|status| (status.code(), status.to_string()));
        let output = running.end();
        let (code, status) = status.unwrap_or((None, format!("not ready after {} s", START.as_secs())));
        let exit_code = if code == Some(PYTHON_USAGE) { USAGE } else { INFRASTRUCTURE };
        let message = readable(&output);
        let (name, python) = (&self.environment, self.interpreter.path().display());
        let error = if output.contains("error: ") && code == Some(PYTHON_USAGE) {
            anyhow!("{message}")
        } else {
            anyhow!("the environment {name} does not start in {python} ({status}):\n{message}")
        };
        Err(Exit { code: exit_code, error })
    }
}

/// Reads a stream to its end and keeps the last lines.
fn keep(stream: impl Read, output: &Mutex<VecDeque<String>>) {
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    // A line of a progress bar may have no end for a long time.
    while reader.by_ref().take(4096).read_until(b'\n', &mut line).is_ok_and(|read| read > 0) {
        let mut lines = locked(output);
        if lines.len() == LINES {
            lines.pop_front();
        }
        lines.push_back(without_colours(String::from_utf8_lossy(&line).trim_end()));
        line.clear();
    }
}

/// A line without the control sequences that colour text in a terminal.
fn without_colours(line: &str) -> String {
    let mut parts = line.split("\u{1b}[");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        // A sequence has parameters, and ends with a letter.
        let text = part.find(|c: char| c.is_ascii_alphabetic()).and_then(|end| part.get(end + 1..));
        out.push_str(text.unwrap_or_default());
    }
    out
}

impl Running {
    /// Waits for the end of the process, up to a limit.
    fn wait(&mut self, limit: Duration) -> Option<std::process::ExitStatus> {
        let began = Instant::now();
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if began.elapsed() < limit => thread::sleep(Duration::from_millis(5)),
                _ => return None,
            }
        }
    }

    /// Ends the process, and returns the last lines of its output.
    fn end(&mut self) -> String {
        drop(self.child.stdin.take());
        if self.wait(END).is_none() {
            // It hangs in a call. An error means that it has ended meanwhile.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        if let Some(reader) = self.reader.take() {
            // The stream ends with the process, unless a process that it started holds it.
            let began = Instant::now();
            while !reader.is_finished() && began.elapsed() < END {
                thread::sleep(Duration::from_millis(5));
            }
        }
        let lines = locked(&self.output);
        lines.iter().map(String::as_str).collect::<Vec<_>>().join("\n")
    }
}

impl Drop for Servers {
    fn drop(&mut self) {
        let mut running = std::mem::take(&mut *locked(&self.running));
        // All at once, then wait for each.
        running.values_mut().for_each(|server| drop(server.child.stdin.take()));
        running.values_mut().for_each(|server| drop(server.end()));
        drop(self.starter.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_removed() {
        assert_eq!(without_colours("a \u{1b}[33mWARN: low\u{1b}[0m, b"), "a WARN: low, b");
        assert_eq!(without_colours("plain"), "plain");
        assert_eq!(without_colours("cut \u{1b}[3"), "cut ");
    }
}
