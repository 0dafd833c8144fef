//! How many episodes are in progress at once by default while a policy server computes.

use std::fs;
use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use robogate_campaign::{Worker, WorkerFactory};
use robogate_core::{Action, Observation};
use robogate_policy::Usage;
use robogate_stats::format::{counted, fixed, percent};

use crate::cell::nominal;
use crate::first_requests::begin_episode;
use crate::notice::note;
use crate::policy_source::PolicySource;
use crate::subject::Subject;

/// Requests that are measured, after one that may load or compile the model, and the time after which no further one is sent.
const MEASURED: u64 = 3;
const LONGEST: Duration = Duration::from_secs(5);
/// The most episodes in progress that are chosen.
const MOST: usize = 64;
/// The share of the free memory that they may take.
const SHARE_OF_MEMORY: f64 = 0.5;
/// The share of the time limit of an answer that a request may wait for others.
const SHARE_OF_LIMIT: f64 = 0.5;
/// How long the start of all processes of an environment may take.
const START_S: f64 = 30.0;

/// What a few requests show.
#[derive(Debug, Clone, Copy)]
struct Pace {
    /// Time from a request to its answer, in seconds.
    request_s: f64,
    /// Time between an answer and the next request, in seconds.
    simulation_s: f64,
    /// Time in which a process of the environment starts, in seconds.
    start_s: Option<f64>,
    /// Memory of an episode in progress, and free memory, in bytes.
    bytes: Option<[f64; 2]>,
    /// How long a request may wait for others that the servers answer before, in seconds.
    queue_s: f64,
}

impl Pace {
    /// How many episodes keep so many cores busy within the limits, and the limit that is reached.
    fn in_flight(&self, cores: usize) -> (usize, Option<&'static str>) {
        let cores = cores as f64;
        // One more for each core: episodes do not ask at equal intervals.
        let busy = (cores * (2.0 + self.request_s / self.simulation_s.max(1e-6))).ceil();
        let limits = [
            (MOST as f64, "more are not chosen without --in-flight"),
            (
                self.bytes.map_or(f64::INFINITY, |[one, free]| SHARE_OF_MEMORY * free / one.max(1.0)),
                "limited by the memory",
            ),
            (
                self.start_s.map_or(f64::INFINITY, |start_s| (cores * START_S / start_s.max(1e-3)).max(cores)),
                "limited by the time in which their processes start",
            ),
            (self.queue_s / self.request_s.max(1e-6), "limited by server.answer_s of the profile"),
        ];
        let (limit, reason) = limits.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((busy, ""));
        (busy.min(limit.floor()).max(1.0) as usize, (limit < busy).then_some(reason))
    }
}

impl Subject {
    /// How many episodes of a policy server are in progress by default on these cores, from its first requests. `None` for other
    /// policies, and if too few requests can be sent. Measured once.
    pub(crate) fn measured_in_flight(&self, cores: NonZeroUsize) -> Option<NonZeroUsize> {
        *self.in_flight.get_or_init(|| self.measure_in_flight(cores))
    }

    fn measure_in_flight(&self, cores: NonZeroUsize) -> Option<NonZeroUsize> {
        let Some(PolicySource::External(source)) = self.policy_source().filter(|_| self.waits_for_servers()) else {
            return None;
        };
        let memory_before = memory("/proc/self/status", "VmRSS:");
        let Worker { mut environment, mut policy } = self.worker().ok()?;
        let mut begun = None;
        let mut last = None;
        let enough = |_: &Observation, _: &Action| {
            let (usage, now) = (source.servers.usage(), Instant::now());
            let &mut (first, since) = begun.get_or_insert((usage, now));
            let (used, time) = (usage.since(first), now.duration_since(since));
            if used.requests > last.map_or(0, |(used, _): (Usage, Duration)| used.requests) {
                last = Some((used, time));
            }
            used.requests >= MEASURED || time > LONGEST
        };
        // An error is one of the run too, which reports it.
        begin_episode(&mut *environment, &mut *policy, &nominal(), enough).ok()?;
        let (Usage { requests, waited, .. }, time) = last?;
        let of_process = self.process_of_environment();
        let own = || Some((memory("/proc/self/status", "VmRSS:")? - memory_before?).max(32e6));
        let bytes = of_process.map_or_else(own, |(_, id)| memory(&format!("/proc/{id}/status"), "VmRSS:"));
        let pace = Pace {
            request_s: waited.as_secs_f64() / requests as f64,
            simulation_s: time.saturating_sub(waited).as_secs_f64() / requests as f64,
            start_s: of_process.map(|(start, _)| start.as_secs_f64()),
            bytes: bytes.zip(memory("/proc/meminfo", "MemAvailable:")).map(|(one, free)| [one, free]),
            queue_s: SHARE_OF_LIMIT * source.profile().server.answer_s * source.servers.urls().len() as f64,
        };
        let (episodes, limited) = pace.in_flight(cores.get());
        note(format_args!(
            "{} at once: a request takes {} ms, the simulation before it {} ms on one of {}{}",
            counted(episodes as u64, "episode"),
            fixed(1_000.0 * pace.request_s, 0),
            fixed(1_000.0 * pace.simulation_s, 0),
            counted(cores.get() as u64, "core"),
            limited.map_or_else(String::new, |limit| format!(" ({limit})"))
        ));
        NonZeroUsize::new(episodes)
    }

    /// How the servers or the network of the policy were used so far.
    pub(crate) fn usage(&self) -> Option<Usage> {
        match self.policy_source()? {
            PolicySource::External(source) => Some(source.servers.usage()),
            _ => None,
        }
    }

    /// What limits the speed of so many workers that used the policy so much in this time. `None` for policies that this process does
    /// not ask, and for a short time.
    pub(crate) fn limit_of_speed(&self, workers: NonZeroUsize, time: Duration, usage: Usage) -> Option<String> {
        /// Requests that a statement needs.
        const FEWEST: u64 = 100;
        if usage.requests < FEWEST {
            return None;
        }
        let (seconds, workers) = (time.as_secs_f64(), workers.get() as f64);
        let (busy, waiting) = (usage.busy.as_secs_f64() / seconds, usage.waited.as_secs_f64() / seconds);
        let request_ms = fixed(1_000.0 * usage.waited.as_secs_f64() / usage.requests as f64, 1);
        Some(if self.waits_for_servers() {
            limit_of_servers(workers, busy, waiting, &request_ms)
        } else {
            let share = (waiting / workers).min(1.0);
            let limit = if share > 0.5 { "the network" } else { "the simulation" };
            format!(
                "policy: the network computes in {} of the time of {workers:.0} threads, {request_ms} ms for a request; {limit} is the limit",
                percent(share)
            )
        })
    }
}

/// What limits the speed with policy servers: the share of the time with a request, and the mean number of waiting episodes.
fn limit_of_servers(workers: f64, busy: f64, waiting: f64, request_ms: &str) -> String {
    /// The share of the time with requests from which on the servers are the limit.
    const BUSY: f64 = 0.9;
    let limit = if busy < BUSY || 2.0 * waiting < workers {
        "the simulation is the limit".to_owned()
    } else {
        format!(
            "the servers are the limit: name more with --policy A,B, or use --in-flight {:.0} if they answer in batches",
            2.0 * workers
        )
    };
    format!(
        "policy servers: a request is in progress in {} of the time, {} of {workers:.0} episodes wait for an answer on average, \
         {request_ms} ms each; {limit}",
        percent(busy.min(1.0)),
        fixed(waiting, 1),
    )
}

/// A line of a file of Linux about memory, in bytes. `None` on other systems.
fn memory(file: &str, line: &str) -> Option<f64> {
    let text = fs::read_to_string(file).ok()?;
    let rest = text.lines().find_map(|found| found.strip_prefix(line))?;
    Some(1_024.0 * rest.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_stay_busy_within_the_limits() {
        let pace = Pace { request_s: 0.06, simulation_s: 0.012, start_s: None, bytes: None, queue_s: 15.0 };
        assert_eq!(pace.in_flight(2), (14, None));
        // Beside a server that answers at once.
        assert_eq!(Pace { request_s: 0.001, ..pace }.in_flight(8), (17, None));
        let slow = Pace { request_s: 1.0, ..pace };
        assert_eq!(slow.in_flight(2), (15, Some("limited by server.answer_s of the profile")));
        assert_eq!(Pace { queue_s: 600.0, ..slow }.in_flight(2).0, MOST);
        let heavy = Pace { bytes: Some([400e6, 4e9]), ..pace };
        assert_eq!(heavy.in_flight(2), (5, Some("limited by the memory")));
        assert_eq!(Pace { bytes: Some([8e9, 4e9]), ..pace }.in_flight(2).0, 1);
        let starting = Pace { start_s: Some(12.0), ..pace };
        assert_eq!(starting.in_flight(2), (5, Some("limited by the time in which their processes start")));
        assert_eq!(Pace { start_s: Some(100.0), ..pace }.in_flight(4).0, 4);
    }
}
