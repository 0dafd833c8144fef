//! Tests of campaigns in shards: the merged files are those of one machine, and wrong shards are rejected.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs;
use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use robogate_campaign::shards::{
    Assignment, Commit, DirectoryStore, RoundState, ShardEnd, ShardError, ShardResult, ShardRound, ShardStore, Shards,
    Stored,
};
use robogate_campaign::{
    Completion, Event, ExecuteError, Executor, Plan, Round, RunError, built_in_suite, recorded, start_in_rounds,
};
use robogate_core::{Episode, Scenario, Seed};
use robogate_dictionary::{LostEpisode, Place, Provenance, World};
use sha2::{Digest, Sha256};

use crate::suite::{origin, suite};
use crate::world::{self, Synthetic, Trouble, plan, provenance, resume, stop_after, with_pool};

fn begin(dir: &Path, shards: u32, plan: &Plan, provenance: Provenance) -> Result<Shards, ShardError> {
    Shards::begin(Box::new(DirectoryStore::new(dir)), shards, plan, provenance)
}

fn open(dir: &Path) -> Shards {
    Shards::open(Box::new(DirectoryStore::new(dir))).unwrap()
}

/// Runs a shard of the open round without committing it.
fn result(shards: &Shards, index: u32, factory: &Synthetic) -> ShardResult {
    let Assignment::Run(task) = shards.assign(index, None).unwrap() else { panic!("shard {index} is not missing") };
    let end = with_pool(factory, 2, &mut |_, _| {}, |pool, events| task.run(pool, events));
    let ShardEnd::Complete(result) = end.unwrap() else { panic!() };
    result
}

fn run(shards: &Shards, index: u32) -> Commit {
    shards.commit(&result(shards, index, &Synthetic::default())).unwrap()
}

/// Runs all shards, in a random order within each round.
fn run_all(dir: &Path, shards: u32, plan: &Plan, provenance: &Provenance) -> Shards {
    let mut chance = Seed::campaign(5).stream("order of shards");
    let campaign = begin(dir, shards, plan, provenance.clone()).unwrap();
    while let Some(mut round) = campaign.open_round(None).unwrap() {
        chance.shuffle(&mut round.missing);
        for index in round.missing {
            // Each worker knows the folder only.
            choose(&open(dir));
            // The active stage may be over.
            if let Assignment::Complete = open(dir).assign(index, None).unwrap() {
                continue;
            }
            assert_eq!(run(&open(dir), index), Commit::First);
        }
    }
    choose(&campaign);
    campaign
}

/// Chooses the points of the next round of an active stage.
fn choose(shards: &Shards) {
    if let Some(round) = shards.unchosen().unwrap() {
        shards.choose(round, None).unwrap();
        // A second process gets the same points.
        shards.choose(round, None).unwrap();
    }
}

fn active_plan(until_rms: Option<f64>) -> Plan {
    let mut plan = plan(160, 0).with_active();
    plan.active.as_mut().unwrap().until_rms = until_rms;
    plan
}

fn merge(shards: &Shards, out: &Path) -> Result<Completion, ShardError> {
    shards.merge(out, &mut |_| {}, None)
}

/// The files of a folder, without its subfolders.
fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.file_type().unwrap().is_file())
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .collect()
}

fn one_machine(dir: &Path, plan: &Plan, provenance: &Provenance) -> BTreeMap<String, Vec<u8>> {
    with_pool(&Synthetic::default(), 2, &mut |_, _| {}, |pool, events| {
        robogate_campaign::start(dir, plan, provenance.clone(), pool, events)
    })
    .unwrap();
    files(dir)
}

fn suite_plan() -> Plan {
    Plan::of_suite(suite(), 2, 7)
}

#[test]
fn merged_files_equal_single_run() {
    let base = tempfile::tempdir().unwrap();
    let plans = [
        ("stages", plan(200, 100), provenance()),
        ("suite", suite_plan(), origin()),
        ("active", active_plan(None), provenance()),
        // The certificate ends the stage before its last round.
        ("early", active_plan(Some(0.5)), provenance()),
    ];
    for (name, plan, provenance) in plans {
        let expected = one_machine(&base.path().join(name), &plan, &provenance);
        for shards in [1, 3, 16] {
            let dir = base.path().join(format!("{name}-{shards}"));
            let campaign = run_all(&dir, shards, &plan, &provenance);
            let elsewhere = base.path().join(format!("{name}-{shards}-merged"));
            let done = merge(&campaign, &elsewhere).unwrap();
            assert_eq!(world::files(&elsewhere), expected, "{name}, {shards} shards");
            assert_eq!(merge(&campaign, &dir).unwrap(), done);
            assert_eq!(files(&dir), expected, "{name}, {shards} shards, in place");
            // A merged folder is a finished run. A second merge changes nothing.
            assert_eq!(resume(&dir, &Synthetic::default(), 1).unwrap(), done);
            assert_eq!(merge(&campaign, &dir).unwrap(), done);
            assert_eq!(files(&dir), expected);
        }
    }
}

/// The designs of both stages are drawn by one process and read by the others.
#[test]
fn designs_are_drawn_once() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("stages");
    let campaign = begin(&dir, 2, &plan(200, 100), provenance()).unwrap();
    let designs = || fs::read_dir(dir.join("shards")).unwrap().map(|file| file.unwrap().path());
    let designs = || designs().filter(|path| path.extension().is_some_and(|end| end == "points")).collect::<Vec<_>>();
    assert!(designs().is_empty());
    run(&campaign, 0);
    let [uniform] = &designs()[..] else { panic!("{:?}", designs()) };
    let whole = fs::read(uniform).unwrap();
    let same = result(&open(&dir), 1, &Synthetic::default());
    // Every byte is checked.
    for (i, byte) in (0..whole.len()).step_by(97).chain([whole.len() - 1]).map(|i| (i, whole[i])) {
        let mut changed = whole.clone();
        changed[i] = !byte;
        fs::write(uniform, &changed).unwrap();
        let error = open(&dir).assign(1, None).unwrap_err();
        assert!(matches!(&error, ShardError::Damaged { path, .. } if path == uniform), "{error}");
    }
    fs::write(uniform, &whole[..whole.len() - 8]).unwrap();
    assert!(matches!(open(&dir).assign(1, None).unwrap_err(), ShardError::Damaged { .. }));
    // A design with other points has a correct hash, and the wrong number of them.
    let fewer = &whole[..32];
    fs::write(uniform, [fewer, &Sha256::digest(fewer)].concat()).unwrap();
    assert!(matches!(open(&dir).assign(1, None).unwrap_err(), ShardError::Damaged { .. }));
    // Without the file, the same points are drawn again.
    fs::remove_file(uniform).unwrap();
    let again = result(&open(&dir), 1, &Synthetic::default());
    assert_eq!(fs::read(uniform).unwrap(), whole);
    assert_eq!(campaign.commit(&same).unwrap(), Commit::First);
    assert_eq!(campaign.commit(&again).unwrap(), Commit::Duplicate);
    run(&campaign, 0);
    assert!(designs().len() > 1, "{:?}", designs());
}

#[test]
fn invalid_episodes_merge_as_well() {
    let base = tempfile::tempdir().unwrap();
    let trouble = |index| match index % 7 {
        2 => Trouble::Panic,
        4 => Trouble::Invalid,
        _ => Trouble::None,
    };
    let (one, dir) = (base.path().join("one"), base.path().join("shards"));
    let factory = || Synthetic { trouble, ..Synthetic::default() };
    world::start(&one, &plan(60, 0), &factory(), 2).unwrap();
    let campaign = begin(&dir, 4, &plan(60, 0), provenance()).unwrap();
    for k in 0..4 {
        campaign.commit(&result(&campaign, k, &factory())).unwrap();
    }
    merge(&campaign, &dir).unwrap();
    assert_eq!(files(&dir), files(&one));
}

#[test]
fn early_stop_merges_fewer_rounds() {
    let base = tempfile::tempdir().unwrap();
    let (one, dir) = (base.path().join("one"), base.path().join("shards"));
    let plan = Plan::of_suite(suite(), 9, 7);
    let mut two_rounds = |round: &Round<'_>| {
        assert!(round.entries.len() == 3 && round.entries.is_sorted_by_key(|entry| entry.index()));
        if round.number == 1 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| {
        start_in_rounds(&one, &plan, origin(), &[], pool, events, &mut two_rounds)
    })
    .unwrap();
    let campaign = begin(&dir, 2, &plan, origin()).unwrap();
    while let Some(open) = campaign.open_round(Some(&mut two_rounds)).unwrap() {
        open.missing.into_iter().for_each(|index| assert_eq!(run(&campaign, index), Commit::First));
    }
    assert_eq!(campaign.status(None).unwrap().done, 6);
    campaign.merge(&dir, &mut |_| {}, Some(&mut two_rounds)).unwrap();
    assert_eq!(files(&dir), files(&one));
    let error = merge(&campaign, &base.path().join("all")).unwrap_err();
    assert!(matches!(error, ShardError::Missing { round: ShardRound::Suite(2), .. }), "{error}");
}

#[test]
fn active_rounds_open_in_order() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &active_plan(None), provenance()).unwrap();
    assert_eq!(campaign.unchosen().unwrap(), None);
    (0..2).for_each(|index| assert_eq!(run(&campaign, index), Commit::First));
    let first = ShardRound::Active(0);
    assert_eq!(campaign.unchosen().unwrap(), Some(first));
    assert!(matches!(campaign.assign(0, None).unwrap(), Assignment::Choose { round } if round == first));
    let rounds: Vec<RoundState> = campaign.status(None).unwrap().rounds.iter().map(|round| round.state).collect();
    assert_eq!(rounds[..3], [RoundState::Complete, RoundState::Open, RoundState::Waiting]);
    let error = merge(&campaign, base.path()).unwrap_err();
    assert!(matches!(error, ShardError::Missing { round, .. } if round == first), "{error}");
    choose(&campaign);
    assert_eq!(campaign.unchosen().unwrap(), None);
    // Points that another machine chose are used, and other ones are rejected.
    let path = base.path().join("shards/active-0.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("\"episodes\": 20", "\"episodes\": 21", 1)).unwrap();
    assert!(matches!(campaign.choose(first, None).unwrap_err(), ShardError::Conflict { .. }));
    fs::write(&path, "{}").unwrap();
    assert!(matches!(campaign.assign(0, None).unwrap_err(), ShardError::Run(RunError::Unreadable { .. })));
}

#[test]
fn missing_report_is_named() {
    let base = tempfile::tempdir().unwrap();
    let campaign = run_all(base.path(), 1, &active_plan(None), &provenance());
    let last = ShardRound::all(&active_plan(None)).len() as u64 - 1;
    fs::remove_file(base.path().join(format!("shards/active-{last}.json"))).unwrap();
    assert_eq!(campaign.unchosen().unwrap(), Some(ShardRound::Active(last)));
    let error = merge(&campaign, base.path()).unwrap_err();
    assert!(matches!(error, ShardError::NotChosen { round: ShardRound::Active(at), .. } if at == last), "{error}");
    choose(&campaign);
    merge(&campaign, base.path()).unwrap();
}

#[test]
fn committed_shard_is_not_run_again() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &plan(20, 10), provenance()).unwrap();
    run(&campaign, 1);
    let before = fs::read(base.path().join("shards/uniform-1-of-2.rgs")).unwrap();
    assert!(matches!(campaign.assign(1, None).unwrap(), Assignment::Committed { round: ShardRound::Uniform }));
    run(&campaign, 0);
    // The boundary stage is open now.
    run(&campaign, 0);
    run(&campaign, 1);
    assert!(matches!(campaign.assign(1, None).unwrap(), Assignment::Complete));
    assert_eq!(fs::read(base.path().join("shards/uniform-1-of-2.rgs")).unwrap(), before);
}

#[test]
fn equal_duplicate_is_accepted_other_is_not() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &plan(40, 0), provenance()).unwrap();
    let results = [0, 0].map(|k| result(&campaign, k, &Synthetic::default()));
    let trouble = |index| if index % 5 == 0 { Trouble::Invalid } else { Trouble::None };
    let other = result(&campaign, 0, &Synthetic { trouble, ..Synthetic::default() });
    assert_eq!(results.map(|result| campaign.commit(&result).unwrap()), [Commit::First, Commit::Duplicate]);
    let path = base.path().join("shards/uniform-0-of-2.rgs");
    let before = fs::read(&path).unwrap();
    let error = campaign.commit(&other).unwrap_err();
    let hash = robogate_dictionary::hex(&Sha256::digest(&before));
    assert!(matches!(&error, ShardError::Conflict { committed, .. } if *committed == hash), "{error}");
    assert!(error.to_string().contains(&hash), "{error}");
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn contradicted_shard_is_never_merged() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &plan(40, 0), provenance()).unwrap();
    let trouble = |index| if index % 5 == 0 { Trouble::Invalid } else { Trouble::None };
    let other = result(&campaign, 0, &Synthetic { trouble, ..Synthetic::default() });
    assert_eq!(run(&campaign, 0), Commit::First);
    let conflict = campaign.commit(&other).unwrap_err();
    let ShardError::Conflict { committed, computed, .. } = &conflict else { panic!("{conflict}") };

    // The second attempt of a scheduler, which finds the committed shard.
    let again = campaign.assign(0, None).unwrap_err();
    let expected = |error: &ShardError| matches!(error, ShardError::Contradicted { .. });
    assert!(expected(&again), "{again}");
    // The other shard runs.
    assert_eq!(run(&campaign, 1), Commit::First);
    let out = base.path().join("merged");
    let errors = [
        campaign.open_round(None).unwrap_err(),
        campaign.status(None).unwrap_err(),
        merge(&campaign, &out).unwrap_err(),
    ];
    for error in errors {
        assert!(expected(&error), "{error}");
        for part in [committed.as_str(), computed.as_str(), "uniform-0-of-2.rgs.conflict"] {
            assert!(error.to_string().contains(part), "{error}");
        }
    }
    assert!(!out.exists());
    fs::remove_file(base.path().join("shards/uniform-0-of-2.rgs.conflict")).unwrap();
    merge(&campaign, &out).unwrap();
}

/// A store in memory, as object stores will be. It counts the listings.
#[derive(Clone, Default)]
struct MemoryStore(Arc<Mutex<BTreeMap<String, Vec<u8>>>>, Arc<AtomicUsize>);

impl ShardStore for MemoryStore {
    fn put_if_absent(&self, name: &str, bytes: &[u8]) -> io::Result<Stored> {
        match self.0.lock().unwrap().entry(name.to_owned()) {
            Entry::Occupied(_) => Ok(Stored::Exists),
            Entry::Vacant(free) => {
                free.insert(bytes.to_owned());
                Ok(Stored::New)
            }
        }
    }

    fn get(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        Ok(self.0.lock().unwrap().get(name).cloned())
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let within = |name: &String| {
            let rest = if folder.is_empty() { name } else { name.strip_prefix(folder)?.strip_prefix('/')? };
            (!rest.contains('/')).then(|| rest.to_owned())
        };
        self.1.fetch_add(1, Ordering::Relaxed);
        Ok(self.0.lock().unwrap().keys().filter_map(within).collect())
    }

    fn remove_leftovers(&self) -> io::Result<()> {
        Ok(())
    }

    fn place(&self, name: &str) -> PathBuf {
        Path::new("memory:").join(name)
    }
}

/// A listing is a request to an object store.
#[test]
fn shards_are_listed_once() {
    let store = MemoryStore::default();
    let campaign = Shards::begin(Box::new(store.clone()), 3, &plan(9, 0), provenance()).unwrap();
    let base = tempfile::tempdir().unwrap();
    let listings = || store.1.swap(0, Ordering::Relaxed);
    listings();
    campaign.open_round(None).unwrap();
    assert_eq!(listings(), 1);
    campaign.status(None).unwrap();
    assert_eq!(listings(), 1);
    (0..3).for_each(|k| assert_eq!(run(&campaign, k), Commit::First));
    assert_eq!(listings(), 3);
    merge(&campaign, base.path()).unwrap();
    assert_eq!(listings(), 1);
}

#[test]
fn every_changed_byte_is_found() {
    let store = MemoryStore::default();
    let campaign = Shards::begin(Box::new(store.clone()), 3, &plan(9, 0), provenance()).unwrap();
    (0..3).for_each(|k| assert_eq!(run(&campaign, k), Commit::First));
    let name = "shards/uniform-1-of-3.rgs";
    let replace = |bytes: &[u8]| store.0.lock().unwrap().insert(name.to_owned(), bytes.to_owned()).unwrap();
    let whole = replace(b"");
    let base = tempfile::tempdir().unwrap();
    let refused = |bytes: &[u8], what: &str| {
        replace(bytes);
        let error = campaign.status(None).unwrap_err();
        assert!(matches!(error, ShardError::Damaged { .. }), "{what}: {error}");
        assert!(error.to_string().contains("uniform-1-of-3.rgs"), "{error}");
        // The merge reads shards in the same way, but it flushes files to the disk, which is slow.
        if bytes.len().is_multiple_of(50) {
            assert_eq!(merge(&campaign, base.path()).unwrap_err().to_string(), error.to_string());
        }
    };
    for at in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << (at % 8);
        refused(&flipped, &format!("byte {at}"));
        refused(&whole[..at], &format!("the first {at} bytes"));
    }
    refused(&[&whole[..], b"x"].concat(), "one more byte");
    replace(&whole);
    merge(&campaign, base.path()).unwrap();
    let expected = one_machine(&base.path().join("one"), &plan(9, 0), &provenance());
    assert_eq!(files(base.path()), expected);
}

#[test]
fn misplaced_shards_are_rejected() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("dir");
    let campaign = run_all(&dir, 3, &plan(12, 6), &provenance());
    let file = |name: &str| dir.join("shards").join(name);
    let uniform = |k: u32| file(&format!("uniform-{k}-of-3.rgs"));
    let own = fs::read(uniform(1)).unwrap();
    let refused = || merge(&campaign, &base.path().join("out")).unwrap_err();

    // A gap names the missing shards.
    fs::remove_file(uniform(1)).unwrap();
    let error = refused();
    assert!(matches!(&error, ShardError::Missing { missing, round: ShardRound::Uniform, .. } if missing == &[1]));
    assert!(error.to_string().starts_with("1 of 3 shards of round uniform are missing: 1\n"), "{error}");

    // A copy of another shard of the round, and of another round.
    for name in ["uniform-0-of-3.rgs", "boundary-1-of-3.rgs"] {
        fs::copy(file(name), uniform(1)).unwrap();
        assert!(matches!(refused(), ShardError::Misnamed { .. }), "{name}");
    }

    // A shard of another plan, of another build, and of another number of shards.
    let mut other_plan = plan(12, 6);
    other_plan.seed = 8;
    let other_build = Provenance {
        engine: robogate_dictionary::Engine { build_sha256: Some("00".to_owned()), ..provenance().engine },
        ..provenance()
    };
    for (name, plan, provenance) in [("plan", other_plan, provenance()), ("build", plan(12, 6), other_build)] {
        let theirs = base.path().join(name);
        run_all(&theirs, 3, &plan, &provenance);
        fs::copy(theirs.join("shards/uniform-1-of-3.rgs"), uniform(1)).unwrap();
        let error = refused();
        assert!(matches!(error, ShardError::OtherPlan { .. }), "{name}: {error}");
    }
    fs::write(uniform(1), &own).unwrap();
    for name in ["uniform-1-of-4.rgs", "uniform-3-of-3.rgs", "suite-0-1-of-3.rgs", "copy of uniform-1-of-3.rgs"] {
        fs::write(file(name), &own).unwrap();
        let error = refused();
        assert!(matches!(&error, ShardError::ForeignFile { path, .. } if path.ends_with(name)), "{error}");
        fs::remove_file(file(name)).unwrap();
    }
    fs::write(file("notes.txt"), "of the user").unwrap();
    merge(&campaign, &base.path().join("out")).unwrap();
}

#[test]
fn boundary_must_follow_from_shards() {
    let base = tempfile::tempdir().unwrap();
    let campaign = run_all(base.path(), 2, &plan(60, 30), &provenance());
    let path = base.path().join("boundary.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("\"version\": 1", "\"version\":  1", 1)).unwrap();
    let error = merge(&campaign, base.path()).unwrap_err();
    assert!(matches!(&error, ShardError::Conflict { path, .. } if path.ends_with("boundary.json")), "{error}");
    // A lost boundary is computed again.
    fs::remove_file(&path).unwrap();
    merge(&campaign, base.path()).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), text);
}

type Change = fn(&mut Plan, &mut Provenance);

#[test]
fn other_settings_are_rejected_by_name() {
    let base = tempfile::tempdir().unwrap();
    begin(base.path(), 3, &plan(20, 10), provenance()).unwrap();
    begin(base.path(), 3, &plan(20, 10), provenance()).unwrap();
    let before = files(base.path());
    let changes: [(&str, Change); 11] = [
        ("plan.seed", |plan, _| plan.seed = 8),
        ("plan.uniform.episodes", |plan, _| plan.uniform.episodes = 21),
        ("plan.sampler", |plan, _| plan.sampler = "sobol".to_owned()),
        ("tool version", |_, p| p.tool.version = "9.9.9".to_owned()),
        ("engine build", |_, p| p.engine.build_sha256 = Some("00".to_owned())),
        ("robot files", |_, p| p.robot.sha256 = Some("00".to_owned())),
        ("policy", |_, p| p.policy = "acts".to_owned()),
        ("world.place.engine", |_, p| p.world = Some(World::new(Place::SelfContained))),
        ("platform", |_, p| p.platform = None),
        ("C library", |_, p| p.platform.as_mut().unwrap().libc = Some("glibc 2.31".to_owned())),
        ("source files of robogate", |_, p| p.build.as_mut().unwrap().source_sha256 = "00".to_owned()),
    ];
    for (name, change) in changes {
        let (mut plan, mut provenance) = (plan(20, 10), provenance());
        change(&mut plan, &mut provenance);
        let error = begin(base.path(), 3, &plan, provenance).unwrap_err();
        assert!(matches!(&error, ShardError::Run(RunError::Mismatch { what, .. }) if what == name), "{error}");
    }
    let error = begin(base.path(), 4, &plan(20, 10), provenance()).unwrap_err();
    assert!(matches!(error, ShardError::OtherCount { shards: 3, asked: 4, .. }), "{error}");
    assert_eq!(files(base.path()), before);
    let plan_path = base.path().join("plan.json");
    let text = fs::read_to_string(&plan_path).unwrap();
    fs::write(&plan_path, text + " ").unwrap();
    let error = Shards::open(Box::new(DirectoryStore::new(base.path()))).unwrap_err();
    assert!(matches!(error, ShardError::PlanChanged { .. }), "{error}");
}

#[test]
fn shards_and_single_runs_do_not_mix() {
    let base = tempfile::tempdir().unwrap();
    let (single, dir) = (base.path().join("single"), base.path().join("dir"));
    let mut stop = stop_after(10);
    with_pool(&Synthetic::default(), 1, &mut stop, |pool, events| {
        robogate_campaign::start(&single, &plan(20, 10), provenance(), pool, events)
    })
    .unwrap();
    for _ in 0..2 {
        let error = begin(&single, 2, &plan(20, 10), provenance()).unwrap_err();
        assert!(matches!(error, ShardError::SingleRun { .. }), "{error}");
        // The second time it is finished.
        resume(&single, &Synthetic::default(), 1).unwrap();
    }
    run(&begin(&dir, 2, &plan(20, 10), provenance()).unwrap(), 0);
    let attempts =
        [resume(&dir, &Synthetic::default(), 1), world::start(&dir, &plan(20, 10), &Synthetic::default(), 1)];
    for attempt in attempts {
        let error = attempt.unwrap_err();
        assert!(matches!(error, RunError::InShards { .. }) && error.to_string().contains("plan "), "{error}");
    }
    assert!(matches!(recorded(&dir, 0), Err(RunError::NoSuchEpisode { .. })));
    let error = Shards::open(Box::new(DirectoryStore::new(&base.path().join("nowhere")))).unwrap_err();
    assert!(matches!(error, ShardError::NotInShards { .. }), "{error}");
}

#[test]
fn merge_needs_same_version_and_free_folder() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("dir");
    let mut other = provenance();
    other.tool.version = "9.9.9".to_owned();
    let newer = run_all(&base.path().join("newer"), 2, &plan(10, 0), &other);
    let error = merge(&newer, &base.path().join("out")).unwrap_err();
    assert!(matches!(error, ShardError::Run(RunError::Mismatch { .. })), "{error}");
    assert!(!base.path().join("out").exists());
    let campaign = run_all(&dir, 2, &plan(10, 0), &provenance());
    let error = merge(&campaign, &base.path().join("newer")).unwrap_err();
    assert!(matches!(error, ShardError::OtherRun { .. }), "{error}");
    let foreign = base.path().join("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("thesis.tex"), "mine").unwrap();
    let error = merge(&campaign, &foreign).unwrap_err();
    assert!(matches!(error, ShardError::Run(RunError::NotEmpty { .. })), "{error}");
}

#[test]
fn damaged_result_is_not_merged_already() {
    let base = tempfile::tempdir().unwrap();
    let campaign = run_all(base.path(), 2, &plan(40, 20), &provenance());
    let out = base.path().join("out");
    merge(&campaign, &out).unwrap();
    let dictionary = out.join("dictionary.parquet");
    let whole = fs::read(&dictionary).unwrap();
    fs::write(&dictionary, &whole[..whole.len() - 100]).unwrap();
    let error = merge(&campaign, &out).unwrap_err();
    assert!(matches!(error, ShardError::DamagedResult { .. }), "{error}");
    assert!(error.to_string().contains("merge them again"), "{error}");
    fs::remove_file(&dictionary).unwrap();
    merge(&campaign, &out).unwrap();
    assert!(fs::read(&dictionary).unwrap() == whole);
}

#[test]
fn interrupted_merge_can_be_repeated() {
    let base = tempfile::tempdir().unwrap();
    let plan = plan(60, 30);
    let expected = one_machine(&base.path().join("one"), &plan, &provenance());
    let dir = base.path().join("dir");
    let campaign = run_all(&dir, 4, &plan, &provenance());
    // The journal at the end of a merge, before it is deleted.
    let mut journal = Vec::new();
    let keep = &mut |event: &Event| {
        if let Event::StageFinished { .. } = event {
            journal = fs::read(dir.join("journal.rgj")).unwrap();
        }
    };
    campaign.merge(&dir, keep, None).unwrap();
    let half = journal.len() / 2 + 1;
    for (length, lost) in [
        (10, &["summary.json", "dictionary.parquet"][..]),
        (half, &["summary.json", "dictionary.parquet"]),
        (journal.len(), &["summary.json", "dictionary.parquet"]),
        (journal.len(), &["summary.json"]),
        (journal.len(), &[]),
    ] {
        fs::write(dir.join("journal.rgj"), &journal[..length]).unwrap();
        lost.iter().for_each(|name| fs::remove_file(dir.join(name)).unwrap());
        for leftover in [".dictionary.parquet.part", ".boundary.json.9-0.part", "shards/.uniform-0-of-4.rgs.9-0.part"] {
            fs::write(dir.join(leftover), "half").unwrap();
        }
        merge(&campaign, &dir).unwrap();
        assert_eq!(files(&dir), expected, "{length} bytes, without {lost:?}");
        assert!(!dir.join("shards/.uniform-0-of-4.rgs.9-0.part").exists());
    }
}

#[test]
fn interrupted_shard_leaves_no_episodes() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &plan(60, 0), provenance()).unwrap();
    let Assignment::Run(task) = campaign.assign(0, None).unwrap() else { panic!() };
    let mut stop = stop_after(5);
    let end = with_pool(&Synthetic::default(), 1, &mut stop, |pool, events| task.run(pool, events)).unwrap();
    assert!(matches!(end, ShardEnd::Interrupted { done: 5..30, episodes: 30 }), "{end:?}");
    let broken = Synthetic { most_workers: 0, ..Synthetic::default() };
    let error = with_pool(&broken, 1, &mut |_, _| {}, |pool, events| task.run(pool, events)).unwrap_err();
    assert!(matches!(error, RunError::Execute(ExecuteError::Worker(_))), "{error}");
    assert_eq!(files(&base.path().join("shards")).keys().collect::<Vec<_>>(), ["design-uniform.points", "layout.json"]);
    assert_eq!(campaign.open_round(None).unwrap().unwrap().missing, [0, 1]);
}

/// An executor that lost an attempt of episode 3.
struct Losing<'a>(&'a dyn Executor);

impl Executor for Losing<'_> {
    fn parallelism(&self) -> usize {
        self.0.parallelism()
    }

    fn execute(
        &self,
        scenario: &(dyn Fn(usize) -> Option<Scenario> + Sync),
        receive: &mut dyn FnMut(Episode) -> ControlFlow<()>,
    ) -> Result<(), ExecuteError> {
        self.0.execute(scenario, receive)
    }

    fn take_lost(&self) -> Vec<LostEpisode> {
        vec![LostEpisode { index: 3, fault: "closed".to_owned(), began: true }]
    }
}

#[test]
fn lost_attempts_of_shards_are_merged() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 2, &plan(60, 0), provenance()).unwrap();
    for index in 0..2 {
        let Assignment::Run(task) = campaign.assign(index, None).unwrap() else { panic!() };
        let end = with_pool(&Synthetic::default(), 1, &mut |_, _| {}, |pool, events| {
            if index == 0 { task.run(&Losing(pool), events) } else { task.run(pool, events) }
        });
        let ShardEnd::Complete(result) = end.unwrap() else { panic!() };
        campaign.commit(&result).unwrap();
    }
    let out = base.path().join("merged");
    merge(&campaign, &out).unwrap();
    let lost = LostEpisode::all(&out).unwrap();
    assert_eq!(lost.iter().map(|of| (of.index, of.began)).collect::<Vec<_>>(), [(3, true)]);
    assert!(fs::read_to_string(out.join("summary.json")).unwrap().contains("\"lost_attempts\": 1"));
}

#[test]
fn status_counts_committed_shards() {
    let base = tempfile::tempdir().unwrap();
    let campaign = begin(base.path(), 4, &plan(20, 10), provenance()).unwrap();
    run(&campaign, 2);
    let status = campaign.status(None).unwrap();
    assert_eq!((status.shards, status.episodes, status.done, status.complete), (4, 30, 5, false));
    let [uniform, boundary] = &status.rounds[..] else { panic!() };
    assert_eq!((uniform.state, uniform.committed, &uniform.missing[..]), (RoundState::Open, 1, &[0, 1, 3][..]));
    assert_eq!((uniform.done, uniform.outcomes.total(), uniform.episodes), (5, 5, 20));
    assert_eq!((boundary.state, boundary.committed, boundary.done), (RoundState::Waiting, 0, 0));
    let text = serde_json::to_value(&status).unwrap();
    assert_eq!(
        (text["rounds"][0]["round"].as_str(), text["rounds"][0]["state"].as_str()),
        (Some("uniform"), Some("open"))
    );
    drop(run_all(base.path(), 4, &plan(20, 10), &provenance()));
    let status = campaign.status(None).unwrap();
    assert!(status.complete && status.done == 30 && status.rounds.iter().all(|r| r.state == RoundState::Complete));
}

#[test]
fn more_shards_than_episodes_work() {
    let base = tempfile::tempdir().unwrap();
    let expected = one_machine(&base.path().join("one"), &suite_plan(), &origin());
    let campaign = run_all(&base.path().join("dir"), 5, &suite_plan(), &origin());
    merge(&campaign, &base.path().join("out")).unwrap();
    assert_eq!(files(&base.path().join("out")), expected);
}

#[test]
fn shards_mix_categories_of_suite() {
    let base = tempfile::tempdir().unwrap();
    let suite = built_in_suite("industrial-68").unwrap().unwrap();
    let provenance = Provenance { space: suite.space().clone(), ..provenance() };
    let plan = Plan::of_suite(suite.clone(), 1, 2026);
    let campaign = begin(base.path(), 4, &plan, provenance).unwrap();
    for k in 0..4 {
        let Assignment::Run(task) = campaign.assign(k, None).unwrap() else { panic!() };
        let mut categories: Vec<&str> = task.indices().iter().map(|i| suite.case(*i).category.as_str()).collect();
        categories.sort_unstable();
        categories.dedup();
        assert!(task.episodes() == 17 && categories.len() >= 3, "shard {k}: {categories:?}");
    }
}

const CHILD: &str = "ROBOGATE_SHARDS_TEST_CHILD";
/// The file in the campaign's folder that tells the child processes to commit.
const GO: &str = "shards/go";

/// The child process of the tests below: runs shard 0 of 2, and commits it once it is told so. It is not a test by
/// itself.
#[test]
#[ignore = "child process of other tests"]
fn child() {
    let Ok(dir) = std::env::var(CHILD) else { return };
    let campaign = begin(Path::new(&dir), 2, &plan(200, 0), provenance()).unwrap();
    let slow = Synthetic { tick: Duration::from_micros(200), ..Synthetic::default() };
    let result = result(&campaign, 0, &slow);
    fs::write(Path::new(&dir).join(format!("shards/ready-{}", std::process::id())), "").unwrap();
    while !Path::new(&dir).join(GO).exists() {
        thread::sleep(Duration::from_millis(1));
    }
    println!("{:?}", campaign.commit(&result).unwrap());
}

fn child_process(dir: &Path) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "shards::child", "--ignored", "--nocapture"]).env(CHILD, dir);
    command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

#[test]
fn killed_worker_leaves_nothing() {
    let base = tempfile::tempdir().unwrap();
    let mut child = child_process(base.path());
    while !base.path().join("shards/layout.json").exists() {
        thread::sleep(Duration::from_millis(1));
    }
    // SIGKILL cannot be handled.
    child.kill().unwrap();
    child.wait().unwrap();
    let campaign = begin(base.path(), 2, &plan(200, 0), provenance()).unwrap();
    assert_eq!(campaign.open_round(None).unwrap().unwrap().missing, [0, 1]);
    run(&campaign, 0);
    run(&campaign, 1);
    merge(&campaign, base.path()).unwrap();
    let expected = one_machine(&base.path().join("one"), &plan(200, 0), &provenance());
    assert_eq!(files(base.path()), expected);
}

#[test]
fn concurrent_processes_have_one_winner() {
    let base = tempfile::tempdir().unwrap();
    let children = [0, 1, 2].map(|_| child_process(base.path()));
    let ready = || fs::read_dir(base.path().join("shards")).map_or(0, |names| names.count());
    // The layout and one file for each child.
    while ready() < 4 {
        thread::sleep(Duration::from_millis(1));
    }
    fs::write(base.path().join(GO), "").unwrap();
    let mut said: Vec<String> = children
        .into_iter()
        .map(|child| {
            let output = child.wait_with_output().unwrap();
            assert!(output.status.success());
            let text = String::from_utf8(output.stdout).unwrap();
            text.lines().find(|line| ["First", "Duplicate"].contains(line)).unwrap().to_owned()
        })
        .collect();
    said.sort();
    assert_eq!(said, ["Duplicate", "Duplicate", "First"]);
    let left = files(&base.path().join("shards"));
    assert!(left.contains_key("uniform-0-of-2.rgs") && !left.keys().any(|name| name.ends_with(".part")));
}
