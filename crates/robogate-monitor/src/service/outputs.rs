//! Alarms out: each output has its own place in the list of alarms on disk, so that none is lost when it is away, and none
//! but the last is told twice when the monitor is killed.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::desk::{Handle, Job};

/// Alarms asked for at once.
const AT_ONCE: u32 = 100;
/// Time between looks at the list.
const EVERY: Duration = Duration::from_millis(200);
/// Longest wait after a delivery that failed.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// Why an alarm was not delivered.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct OutputError(pub String);

/// Takes one alarm, as a JSON object on one line.
pub type Deliver = Box<dyn FnMut(&str) -> Result<(), OutputError> + Send>;

/// An output on its own thread.
#[derive(Debug)]
pub struct Output {
    thread: JoinHandle<()>,
    ending: Arc<AtomicBool>,
}

impl Output {
    /// Starts an output. `name` is its place in the store; `trouble` is told of deliveries that fail, which are tried again.
    ///
    /// An output that the store does not know begins with the next alarm: start it before cycles come in.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn start(
        name: String,
        desk: Handle,
        mut deliver: Deliver,
        trouble: impl Fn(&str) + Send + 'static,
    ) -> Result<Self, OutputError> {
        let output = name.clone();
        desk.wait(|reply| Job::Enrol { output, reply })
            .map_err(|e| OutputError(e.to_string()))?
            .map_err(|e| OutputError(e.because))?;
        let ending = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&ending);
        let thread = std::thread::spawn(move || {
            let mut wait = EVERY;
            loop {
                let last = end.load(Ordering::Acquire);
                match deliver_waiting(&name, &desk, &mut deliver) {
                    Ok(0) if last => return,
                    Ok(0) => wait = EVERY,
                    Ok(_) => continue,
                    Err(error) => {
                        trouble(&format!("{name}: {error}"));
                        wait = (2 * wait).min(LONGEST_WAIT);
                        if last {
                            // What is left is delivered after the next start.
                            return;
                        }
                    }
                }
                let mut waited = Duration::ZERO;
                while waited < wait && !end.load(Ordering::Acquire) {
                    std::thread::sleep(EVERY);
                    waited += EVERY;
                }
            }
        });
        Ok(Self { thread, ending })
    }

    /// Delivers what waits, once, and ends.
    pub fn end(self) {
        self.ending.store(true, Ordering::Release);
        let _ = self.thread.join();
    }
}

/// Delivers what waits; how many there were.
fn deliver_waiting(name: &str, desk: &Handle, deliver: &mut Deliver) -> Result<usize, OutputError> {
    let words = |e: super::desk::Trouble| OutputError(e.because);
    let output = name.to_owned();
    let waiting = desk
        .wait(|reply| Job::Undelivered { output, most: AT_ONCE, reply })
        .map_err(|e| OutputError(e.to_string()))?
        .map_err(words)?;
    for (n, alarm) in &waiting {
        deliver(alarm)?;
        let (output, n) = (name.to_owned(), *n);
        desk.wait(|reply| Job::Delivered { output, n, reply })
            .map_err(|e| OutputError(e.to_string()))?
            .map_err(words)?;
    }
    Ok(waiting.len())
}

/// Alarms as JSON Lines.
pub fn json_lines(mut to: impl Write + Send + 'static) -> Deliver {
    Box::new(move |alarm| {
        writeln!(to, "{alarm}").and_then(|()| to.flush()).map_err(|error| OutputError(error.to_string()))
    })
}

/// Alarms by POST to a URL; anything but a 2xx is tried again.
pub fn webhook(url: String) -> Deliver {
    let agent: ureq::Agent =
        ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(10))).max_redirects(0).build().into();
    Box::new(move |alarm| {
        let sent = agent.post(&url).header("content-type", "application/json").send(alarm.as_bytes());
        match sent {
            Ok(answer) if answer.status().is_success() => Ok(()),
            Ok(answer) => Err(OutputError(format!("{url} answered {}", answer.status()))),
            Err(error) => Err(OutputError(format!("{url}: {error}"))),
        }
    })
}
