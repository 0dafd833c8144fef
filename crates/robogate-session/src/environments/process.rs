//! A Python process of an environment: its output, what it does while it starts, and its end.

use std::collections::VecDeque;
use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ExitStatus};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use robogate_remote::Timeouts;
use serde::Deserialize;

use crate::isolation::Scratch;
use crate::notice::note;

/// How long a process may take to end after its standard input was closed.
const END: Duration = Duration::from_secs(2);
/// How many lines of the output of a process are kept.
const LINES: usize = 60;
/// Longest line that a process prints on standard output, in bytes.
const MAX_LINE: u64 = 64 << 20;
/// How long a process may do the same thing before the user is told.
const SILENCE: Duration = Duration::from_secs(10);
/// Importing and making an environment may take so many times the timeout of a step, and at least [`SHORTEST_START`].
const START_STEPS: u32 = 10;
/// Shortest limit for importing and making an environment: an import takes seconds on a busy machine.
const SHORTEST_START: Duration = Duration::from_secs(60);

/// What a process does before its answer. It prints this before it begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Doing {
    /// Imports the modules of the environment.
    Import,
    /// Makes the environment.
    Make,
    /// Tries the knobs.
    Knobs,
    /// Calls `reset` in the check before the first episode.
    Reset,
    /// Calls `step` in that check.
    Step,
}

/// A line about what a process does.
#[derive(Deserialize)]
struct Progress {
    doing: Doing,
}

impl Doing {
    /// How long it may take.
    fn limit(self, timeouts: &Timeouts) -> Duration {
        match self {
            Self::Import | Self::Make | Self::Knobs => timeouts.step.saturating_mul(START_STEPS).max(SHORTEST_START),
            Self::Reset => timeouts.reset,
            Self::Step => timeouts.step,
        }
    }
}

impl fmt::Display for Doing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Import => "the import of its modules",
            Self::Make => "making the environment",
            Self::Knobs => "the test of its knobs",
            Self::Reset => "`reset` in the check before the first episode",
            Self::Step => "`step` in the check before the first episode",
        })
    }
}

/// Why a process gave no answer.
pub(crate) struct NoAnswer {
    /// Exit status. `None` if the process did not end by itself.
    pub(crate) status: Option<ExitStatus>,
    /// What did not end in time, with its limit and a hint.
    pub(crate) late: Option<String>,
    /// The last lines of its standard error.
    pub(crate) output: String,
}

/// The last lines that a process wrote to standard error.
type Output = Arc<Mutex<VecDeque<String>>>;

pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No code panics between two related writes.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A process whose standard input, output and error are pipes. It ends when this value is dropped.
pub(crate) struct Process {
    child: Child,
    output: Output,
    reader: Option<JoinHandle<()>>,
    lines: Receiver<String>,
    /// Its folder for temporary files in the sandbox. It is removed after the process has ended.
    _scratch: Option<Scratch>,
}

impl Process {
    pub(crate) fn new(mut child: Child, scratch: Option<Scratch>) -> Self {
        let output = Output::default();
        let reader = child.stderr.take().map(|stream| {
            let output = Arc::clone(&output);
            thread::spawn(move || keep(stream, &output))
        });
        let (sender, lines) = mpsc::channel();
        if let Some(stream) = child.stdout.take() {
            thread::spawn(move || {
                let mut stream = BufReader::new(stream);
                let mut line = String::new();
                while stream.by_ref().take(MAX_LINE).read_line(&mut line).is_ok_and(|read| read > 0) {
                    if sender.send(std::mem::take(&mut line)).is_err() {
                        break;
                    }
                }
            });
        }
        Self { child, output, reader, lines, _scratch: scratch }
    }

    /// Waits for the first line that is not about what the process does. An environment that hangs is ended.
    pub(crate) fn answer(&mut self, name: &str, timeouts: &Timeouts) -> Result<String, Box<NoAnswer>> {
        let (mut doing, mut began, mut told) = (Doing::Import, Instant::now(), false);
        loop {
            let limit = doing.limit(timeouts);
            let until = if told { limit } else { limit.min(SILENCE) };
            match self.lines.recv_timeout(until.saturating_sub(began.elapsed())) {
                Ok(line) => match serde_json::from_str::<Progress>(&line) {
                    Ok(next) => (doing, began, told) = (next.doing, Instant::now(), false),
                    Err(_) => return Ok(line),
                },
                Err(RecvTimeoutError::Disconnected) => {
                    let status = self.wait(END);
                    return Err(Box::new(NoAnswer { status, late: None, output: self.end() }));
                }
                Err(RecvTimeoutError::Timeout) if began.elapsed() < limit => {
                    told = true;
                    let (so_far, limit) = (began.elapsed().as_secs(), limit.as_secs_f64());
                    note(format_args!("waiting for {name}: {doing} ({so_far} s so far, {limit} s at most)"));
                }
                Err(RecvTimeoutError::Timeout) => {
                    let (limit, step) = (limit.as_secs_f64(), timeouts.step.as_secs_f64());
                    let late = format!(
                        "{doing} did not end within {limit} s\nHint: --simulator-timeout SECONDS allows more time for a step (now {step} s). A \
                         reset may take four times as long, and import, construction and knobs {START_STEPS} times (at least {} s)",
                        SHORTEST_START.as_secs()
                    );
                    return Err(Box::new(NoAnswer { status: None, late: Some(late), output: self.end() }));
                }
            }
        }
    }

    /// Its number.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// The exit status, if the process has ended.
    pub(crate) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Closes the standard input, which ends the process.
    pub(crate) fn close(&mut self) {
        drop(self.child.stdin.take());
    }

    /// Ends the process, and returns the last lines of its output.
    pub(crate) fn end(&mut self) -> String {
        self.close();
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

    /// Waits for the end of the process, up to a limit.
    fn wait(&mut self, limit: Duration) -> Option<ExitStatus> {
        let began = Instant::now();
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if began.elapsed() < limit => thread::sleep(Duration::from_millis(5)),
                _ => return None,
            }
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.end();
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

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;

    fn shell(script: &str) -> Process {
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Process::new(command.spawn().unwrap(), None)
    }

    fn timeouts() -> Timeouts {
        Timeouts::from_step(Duration::from_millis(200))
    }

    #[test]
    fn colours_are_removed() {
        assert_eq!(without_colours("a \u{1b}[33mWARN: low\u{1b}[0m, b"), "a WARN: low, b");
        assert_eq!(without_colours("plain"), "plain");
        assert_eq!(without_colours("cut \u{1b}[3"), "cut ");
    }

    #[test]
    fn each_call_has_its_own_limit() {
        // Ten steps of 0.05 s take longer than the limit of one.
        let steps =
            "for i in 1 2 3 4 5 6 7 8 9 10; do echo '{\"doing\": \"step\"}'; sleep 0.05; done; echo '{\"a\": 1}'";
        assert_eq!(shell(steps).answer("x", &timeouts()).ok().as_deref(), Some("{\"a\": 1}\n"));
    }

    #[test]
    fn hanging_calls_are_named() {
        let began = Instant::now();
        let why =
            shell("echo '{\"doing\": \"step\"}'; echo here >&2; read line").answer("x", &timeouts()).err().unwrap();
        assert!(why.late.is_some_and(|late| {
            late.starts_with("`step` in the check before the first episode did not end within 0.2 s")
        }));
        assert_eq!((why.status, &*why.output), (None, "here"));
        assert!(began.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn ended_processes_have_a_status() {
        let why = shell("echo gone >&2; exit 3").answer("x", &timeouts()).err().unwrap();
        assert_eq!((why.status.and_then(|status| status.code()), &*why.output), (Some(3), "gone"));
        assert!(why.late.is_none());
    }
}
