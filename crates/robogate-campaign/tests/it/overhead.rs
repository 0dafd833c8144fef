//! Measures the overhead of the campaign code.

use std::time::Instant;

use crate::world::{Synthetic, plan, start};

/// Prints the cost of one episode without its simulation (design, threads, channel, journal, events, final files) and
/// the peak memory.
#[test]
#[ignore = "a measurement; run it in release"]
fn overhead_per_episode() {
    for (n, threads) in [(3_000, 1), (30_000, 1), (30_000, 2), (300_000, 2)] {
        let base = tempfile::tempdir().unwrap();
        let factory = Synthetic::default();
        let begin = Instant::now();
        start(&base.path().join("run"), &plan(n - n / 3, n / 3), &factory, threads).unwrap();
        let whole = begin.elapsed().as_secs_f64();
        // The same number of episodes in a bare loop.
        let space = std::sync::Arc::new(crate::world::space());
        let points = robogate_campaign::Points::uniform(&plan(n, 0), &space).unwrap();
        let mut worker = robogate_campaign::WorkerFactory::worker(&factory).unwrap();
        let begin = Instant::now();
        for index in points.indices() {
            let scenario = points.scenario(index).unwrap();
            let episode = robogate_core::rollout(&mut *worker.environment, &mut *worker.policy, &scenario);
            std::hint::black_box(&episode);
        }
        let bare = begin.elapsed().as_secs_f64();
        let each = |seconds: f64| 1e6 * seconds / n as f64;
        println!(
            "{n} episodes, {threads} threads: {:.1} us each, in a bare loop {:.1} us; peak memory of the process {} kB",
            each(whole),
            each(bare),
            peak_memory_kb().unwrap_or_default()
        );
    }
}

pub(crate) fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}
