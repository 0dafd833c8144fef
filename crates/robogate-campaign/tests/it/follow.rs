//! Tests of campaigns that are followed while they run.

use std::fs::OpenOptions;
use std::path::Path;

use robogate_campaign::folder::JOURNAL;
use robogate_campaign::{Follower, Progress};

use crate::world::{Synthetic, files, plan, provenance, resume, stop_after, with_pool};

fn look(follower: &mut Follower) -> (Progress, Vec<u64>) {
    let mut indices = Vec::new();
    let progress = follower.look(&mut |entry| indices.push(entry.index())).unwrap();
    indices.sort_unstable();
    (progress, indices)
}

fn interrupted(dir: &Path) {
    with_pool(&Synthetic::default(), 1, &mut stop_after(10), |pool, events| {
        robogate_campaign::start(dir, &plan(20, 10), provenance(), pool, events)
    })
    .unwrap();
}

#[test]
fn follower_passes_each_episode_once() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let before = files(base.path());
    let mut follower = Follower::open(base.path()).unwrap();
    let (progress, first) = look(&mut follower);
    assert_eq!((progress, look(&mut follower)), (Progress::Running, (Progress::Running, Vec::new())));
    assert!(!first.is_empty() && first.len() < 30, "{first:?}");
    assert_eq!(follower.recorded(first[0]).unwrap().unwrap().index(), first[0]);
    assert_eq!(files(base.path()), before, "nothing is changed");
    resume(base.path(), &Synthetic::default(), 1).unwrap();
    let (progress, rest) = look(&mut follower);
    assert_eq!(progress, Progress::Finished);
    let mut all = [first, rest].concat();
    all.sort_unstable();
    assert_eq!(all, (0..30).collect::<Vec<_>>());
    assert_eq!(look(&mut follower), (Progress::Finished, Vec::new()));
    assert_eq!(follower.recorded(29).unwrap().unwrap().index(), 29);
    assert!(follower.recorded(30).unwrap().is_none());
}

#[test]
fn shorter_journal_starts_again() {
    let base = tempfile::tempdir().unwrap();
    interrupted(base.path());
    let mut follower = Follower::open(base.path()).unwrap();
    let (_, first) = look(&mut follower);
    let journal = OpenOptions::new().write(true).open(base.path().join(JOURNAL)).unwrap();
    journal.set_len(journal.metadata().unwrap().len() / 2).unwrap();
    assert_eq!(look(&mut follower), (Progress::Restarted, Vec::new()));
    let (progress, again) = look(&mut follower);
    assert_eq!(progress, Progress::Running);
    assert!(!again.is_empty() && again.len() < first.len(), "{again:?} {first:?}");
}
