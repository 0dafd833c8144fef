//! Independent computations on several threads.

use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// One thread for each processor that this process may use.
pub fn all_processors() -> NonZeroUsize {
    thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

/// Computes `task(0)` to `task(count - 1)` on at most `threads` threads, and returns the results in this order. They do not depend on
/// the number of threads if each task depends on its number alone.
pub fn in_parallel<T: Send>(threads: NonZeroUsize, count: usize, task: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let numbers = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)).filter(|at| *at < count));
        numbers.map(|at| (at, task(at))).collect::<Vec<_>>()
    };
    let mut all = thread::scope(|scope| {
        let others: Vec<_> = (1..threads.get().min(count))
            // Without a further thread the present ones do its work.
            .filter_map(|_| thread::Builder::new().spawn_scoped(scope, work).ok())
            .collect();
        let mut all = work();
        for other in others {
            all.extend(other.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        all
    });
    all.sort_unstable_by_key(|(at, _)| *at);
    all.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order() {
        for threads in [1, 2, 7, 40] {
            let threads = NonZeroUsize::new(threads).unwrap();
            assert_eq!(in_parallel(threads, 20, |at| at * at), (0..20).map(|at| at * at).collect::<Vec<_>>());
            assert!(in_parallel(threads, 0, |at| at).is_empty());
        }
    }

    #[test]
    #[should_panic(expected = "the fifth")]
    fn panic_of_a_task_is_passed_on() {
        in_parallel(NonZeroUsize::new(3).unwrap(), 20, |at| assert!(at != 4, "the fifth"));
    }
}
