//! Alarm outputs. Each output stores its own position in the list of alarms on disk, so no alarm is lost during an
//! outage. If the monitor is killed, at most the last alarm is delivered twice.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::engine::{Handle, Job};

/// Maximum number of alarms per request.
const AT_ONCE: u32 = 100;
/// Interval between two polls of the list.
const EVERY: Duration = Duration::from_millis(200);
/// First wait after a failed delivery. It doubles with each failure in a row.
const FIRST_WAIT: Duration = Duration::from_millis(20);
/// Maximum wait after a failed delivery.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// The error of a failed delivery.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct OutputError(pub String);

/// Delivers one alarm, a JSON object on one line.
pub type Deliver = Box<dyn FnMut(&str) -> Result<(), OutputError> + Send>;

/// An output on its own thread.
#[derive(Debug)]
pub struct Output {
    thread: JoinHandle<()>,
    ending: Arc<AtomicBool>,
}

impl Output {
    /// Starts an output. `name` identifies it in the store. `problem` receives a message about each failed delivery,
    /// which is retried.
    ///
    /// A new output begins with the next alarm, so start it before cycles arrive.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn start(
        name: String,
        engine: Handle,
        mut deliver: Deliver,
        problem: impl Fn(&str) + Send + 'static,
    ) -> Result<Self, OutputError> {
        let output = name.clone();
        engine
            .wait(|reply| Job::Register { output, reply })
            .map_err(|e| OutputError(e.to_string()))?
            .map_err(|e| OutputError(e.because))?;
        let ending = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&ending);
        let thread = std::thread::spawn(move || {
            let mut retry = FIRST_WAIT;
            loop {
                let last = end.load(Ordering::Acquire);
                let mut delivered = 0;
                let wait = match deliver_waiting(&name, &engine, &mut deliver, &mut delivered) {
                    Ok(()) if delivered > 0 => {
                        retry = FIRST_WAIT;
                        continue;
                    }
                    Ok(()) if last => return,
                    Ok(()) => EVERY,
                    Err(error) => {
                        problem(&format!("{name}: {error}"));
                        if last {
                            // The rest is delivered after the next start.
                            return;
                        }
                        // A receiver that takes some alarms is not down, and must not fall behind.
                        retry = if delivered > 0 { FIRST_WAIT } else { (2 * retry).min(LONGEST_WAIT) };
                        retry
                    }
                };
                let mut waited = Duration::ZERO;
                while waited < wait && !end.load(Ordering::Acquire) {
                    let pause = EVERY.min(wait - waited);
                    std::thread::sleep(pause);
                    waited += pause;
                }
            }
        });
        Ok(Self { thread, ending })
    }

    /// Delivers the waiting alarms once, then ends.
    pub fn end(self) {
        self.ending.store(true, Ordering::Release);
        let _ = self.thread.join();
    }
}

/// Delivers the waiting alarms and counts them in `delivered`.
fn deliver_waiting(
    name: &str,
    engine: &Handle,
    deliver: &mut Deliver,
    delivered: &mut usize,
) -> Result<(), OutputError> {
    let failed = |e: super::engine::Problem| OutputError(e.because);
    let output = name.to_owned();
    let waiting = engine
        .wait(|reply| Job::Undelivered { output, most: AT_ONCE, reply })
        .map_err(|e| OutputError(e.to_string()))?
        .map_err(failed)?;
    for (n, alarm) in &waiting {
        deliver(alarm)?;
        let (output, n) = (name.to_owned(), *n);
        engine
            .wait(|reply| Job::Delivered { output, n, reply })
            .map_err(|e| OutputError(e.to_string()))?
            .map_err(failed)?;
        *delivered += 1;
    }
    Ok(())
}

/// Creates an output that writes alarms as JSON Lines.
pub fn json_lines(mut to: impl Write + Send + 'static) -> Deliver {
    Box::new(move |alarm| {
        writeln!(to, "{alarm}").and_then(|()| to.flush()).map_err(|error| OutputError(error.to_string()))
    })
}

/// Creates an output that sends alarms by POST to a URL. Any status other than 2xx is retried.
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
