//! Tests that a campaign in batches has the bytes of one with single episodes.

use std::sync::atomic::Ordering;

use robogate_campaign::{Completion, Event, resume as resume_run, start as start_run};
use robogate_core::Seed;

use crate::determinism::tear;
use crate::world::{Synthetic, Trouble, files, plan, provenance, start, stop_after, with_batches};

#[test]
fn batch_size_does_not_change_files() {
    let base = tempfile::tempdir().unwrap();
    start(&base.path().join("single"), &plan(200, 100), &Synthetic::default(), 1).unwrap();
    for [threads, slots] in [[1, 1], [1, 3], [1, 64], [3, 5], [2, 400]] {
        let dir = base.path().join(format!("{threads}x{slots}"));
        let mut indices = Vec::new();
        let mut watch = |event: &Event, _: &_| {
            if let Event::Episode { index, .. } = event {
                indices.push(*index);
            }
        };
        with_batches(&Synthetic::default(), [threads, slots], &mut watch, |pool, events| {
            assert_eq!(pool.parallelism(), threads * slots);
            start_run(&dir, &plan(200, 100), provenance(), pool, events)
        })
        .unwrap();
        assert!(files(&dir) == files(&base.path().join("single")), "{threads} x {slots}");
        // Shorter episodes finish first, also in one thread.
        assert_eq!(indices.is_sorted(), threads * slots == 1, "{threads} x {slots}");
    }
}

#[test]
fn interruptions_of_batches_do_not_change_files() {
    let base = tempfile::tempdir().unwrap();
    let plan = plan(240, 120);
    start(&base.path().join("undisturbed"), &plan, &Synthetic::default(), 2).unwrap();
    let expected = files(&base.path().join("undisturbed"));
    let mut chance = Seed::campaign(98).stream("interruptions");
    for attempt in 0..10 {
        let dir = base.path().join(format!("{attempt}"));
        let factory = Synthetic::default();
        let mut stop = stop_after(1 + chance.below(200) as u64);
        let size = [1 + chance.below(2), 1 + chance.below(40)];
        let first =
            with_batches(&factory, size, &mut stop, |pool, events| start_run(&dir, &plan, provenance(), pool, events));
        assert!(matches!(first, Ok(Completion::Interrupted { .. })), "{first:?}");
        tear(&dir, &mut chance);
        let size = [1 + chance.below(2), 1 + chance.below(40)];
        with_batches(&factory, size, &mut |_, _| {}, |pool, events| resume_run(&dir, &provenance(), pool, events))
            .unwrap();
        assert!(files(&dir) == expected, "attempt {attempt}");
    }
}

fn some_trouble(index: u64) -> Trouble {
    match index % 20 {
        3 => Trouble::Panic,
        7 => Trouble::Invalid,
        _ => Trouble::None,
    }
}

#[test]
fn trouble_in_a_slot_stays_there() {
    let base = tempfile::tempdir().unwrap();
    let factory = || Synthetic { trouble: some_trouble, ..Synthetic::default() };
    start(&base.path().join("single"), &plan(100, 50), &factory(), 1).unwrap();
    for size in [[1, 2], [1, 16], [2, 100]] {
        let dir = base.path().join(format!("{size:?}"));
        with_batches(&factory(), size, &mut |_, _| {}, |pool, events| {
            start_run(&dir, &plan(100, 50), provenance(), pool, events)
        })
        .unwrap();
        assert!(files(&dir) == files(&base.path().join("single")), "{size:?}");
    }
}

#[test]
fn each_slot_has_a_worker() {
    let base = tempfile::tempdir().unwrap();
    let factory = Synthetic::default();
    with_batches(&factory, [1, 8], &mut |_, _| {}, |pool, events| {
        start_run(base.path(), &plan(40, 0), provenance(), pool, events)
    })
    .unwrap();
    assert_eq!(factory.workers.load(Ordering::Relaxed), 8);
}
