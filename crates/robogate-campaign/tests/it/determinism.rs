//! Tests that the same plan gives the same bytes for any number of threads, any order and any interruptions.

use std::fs::{self, OpenOptions};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use robogate_campaign::{Completion, Event, RunError, Stage, recorded, resume as resume_run, start as start_run};
use robogate_core::{Seed, rollout};
use robogate_dictionary::Dictionary;

use crate::world::{self, Synthetic, files, plan, provenance, resume, start, stop_after, summary, with_pool};

#[test]
fn thread_count_does_not_change_files() {
    let base = tempfile::tempdir().unwrap();
    let runs = [1, 2, 5].map(|threads| {
        let dir = base.path().join(threads.to_string());
        let done = start(&dir, &plan(400, 200), &Synthetic::default(), threads).unwrap();
        (summary(&done).dataset_hash.clone(), files(&dir))
    });
    assert_eq!(runs[0], runs[1]);
    assert_eq!(runs[0], runs[2]);
    let names: Vec<&str> = runs[0].1.keys().map(String::as_str).collect();
    assert_eq!(names, ["boundary.json", "dictionary.parquet", "plan.json", "summary.json"]);
}

#[test]
fn all_samplers_resume_identically() {
    for sampler in robogate_core::samplers::NAMES {
        let base = tempfile::tempdir().unwrap();
        let mut plan = plan(80, 40);
        plan.sampler = sampler.to_owned();
        let [whole, pieces] = ["whole", "pieces"].map(|name| base.path().join(name));
        let done = start(&whole, &plan, &Synthetic::default(), 2).unwrap();
        assert_eq!(summary(&done).sampler, sampler);
        let mut stop = stop_after(90);
        with_pool(&Synthetic::default(), 2, &mut stop, |pool, events| {
            start_run(&pieces, &plan, provenance(), pool, events)
        })
        .unwrap();
        resume(&pieces, &Synthetic::default(), 1).unwrap();
        assert_eq!(files(&pieces), files(&whole), "{sampler}");
        assert_eq!(recorded(&whole, 100).unwrap().design, sampler);
    }
}

#[test]
fn seed_changes_data() {
    let base = tempfile::tempdir().unwrap();
    let run = |name: &str, seed: u64| {
        let mut plan = plan(30, 10);
        plan.seed = seed;
        let done = start(&base.path().join(name), &plan, &Synthetic::default(), 1).unwrap();
        summary(&done).dataset_hash.clone()
    };
    assert_ne!(run("a", 1), run("b", 2));
}

#[test]
fn interruptions_do_not_change_files() {
    let base = tempfile::tempdir().unwrap();
    let plan = plan(240, 120);
    let undisturbed = base.path().join("undisturbed");
    start(&undisturbed, &plan, &Synthetic::default(), 2).unwrap();
    let expected = files(&undisturbed);
    let mut chance = Seed::campaign(99).stream("interruptions");
    for attempt in 0..20 {
        let dir = base.path().join(format!("{attempt}"));
        let factory = Synthetic::default();
        let mut stop = stop_after(1 + chance.below(330) as u64);
        let threads = 1 + chance.below(3);
        let first =
            with_pool(&factory, threads, &mut stop, |pool, events| start_run(&dir, &plan, provenance(), pool, events));
        let Completion::Interrupted { done, episodes: 360 } = first.unwrap() else { panic!() };
        tear(&dir, &mut chance);
        // Sometimes a second interruption, occasionally before the first episode.
        let mut stop = stop_after(chance.below(40) as u64);
        let second = with_pool(&factory, 1 + chance.below(3), &mut stop, |pool, events| {
            resume_run(&dir, &provenance(), pool, events)
        });
        assert!(done < 360 && matches!(second, Ok(Completion::Interrupted { .. }) | Ok(Completion::Finished { .. })));
        if let Ok(Completion::Interrupted { .. }) = second {
            tear(&dir, &mut chance);
            resume(&dir, &factory, 2).unwrap();
        }
        assert!(files(&dir) == expected, "attempt {attempt}");
    }
}

/// Cuts off the journal at a random byte, as a kill or a power failure may.
pub(crate) fn tear(dir: &Path, chance: &mut robogate_core::Stream) {
    let file = OpenOptions::new().write(true).open(dir.join("journal.rgj")).unwrap();
    let length = file.metadata().unwrap().len();
    // Mostly within the last records, sometimes far back.
    let cut = if chance.below(4) == 0 { chance.below(length as usize) } else { chance.below(600.min(length as usize)) };
    file.set_len(length - cut as u64).unwrap();
}

#[test]
fn missing_files_are_completed_without_worker() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("run");
    let kept = base.path().join("journal");
    let mut keep = |event: &Event, _: &_| {
        if let Event::StageFinished { stage: Stage::Boundary, .. } = event {
            fs::copy(dir.join("journal.rgj"), &kept).unwrap();
        }
    };
    let plan = plan(60, 30);
    with_pool(&Synthetic::default(), 1, &mut keep, |pool, events| start_run(&dir, &plan, provenance(), pool, events))
        .unwrap();
    let finished = files(&dir);
    for lost in [&["summary.json"][..], &[], &["summary.json", "dictionary.parquet"], &["boundary.json"]] {
        fs::copy(&kept, dir.join("journal.rgj")).unwrap();
        for name in lost {
            fs::remove_file(dir.join(name)).unwrap();
            fs::write(dir.join(format!(".{name}.part")), "half").unwrap();
        }
        resume(&dir, &Synthetic { most_workers: 0, ..Synthetic::default() }, 1).unwrap();
        assert_eq!(files(&dir), finished, "{lost:?}");
    }
}

#[test]
fn resuming_finished_run_changes_nothing() {
    let base = tempfile::tempdir().unwrap();
    let first = start(base.path(), &plan(40, 20), &Synthetic::default(), 2).unwrap();
    let before = files(base.path());
    let mut events = Vec::new();
    let factory = Synthetic { most_workers: 0, ..Synthetic::default() };
    let again = with_pool(&factory, 1, &mut |event, _| events.push(event.clone()), |pool, events| {
        resume_run(base.path(), &provenance(), pool, events)
    });
    assert_eq!(again.unwrap(), first);
    assert_eq!(files(base.path()), before);
    assert!(matches!(events[..], [Event::Finished { already: true, .. }]), "{events:?}");
}

#[test]
fn recorded_episode_replays_exactly() {
    let base = tempfile::tempdir().unwrap();
    start(base.path(), &plan(50, 30), &Synthetic::default(), 2).unwrap();
    for index in [0, 49, 50, 79] {
        let entry = recorded(base.path(), index).unwrap();
        let mut worker = robogate_campaign::WorkerFactory::worker(&Synthetic::default()).unwrap();
        let again = rollout(&mut *worker.environment, &mut *worker.policy, &entry.episode.scenario);
        assert_eq!(again, entry.episode);
    }
    assert!(matches!(recorded(base.path(), 80), Err(RunError::NoSuchEpisode { index: 80, episodes: 80, .. })));
}

#[test]
fn dictionary_lists_every_episode_once() {
    let base = tempfile::tempdir().unwrap();
    start(base.path(), &plan(100, 50), &Synthetic::default(), 3).unwrap();
    let dictionary = Dictionary::open(&base.path().join("dictionary.parquet")).unwrap();
    assert_eq!(
        (dictionary.provenance().seed, dictionary.provenance().plan["uniform"]["episodes"].as_u64()),
        (7, Some(100))
    );
    for (i, entry) in dictionary.entries().enumerate() {
        let entry = entry.unwrap();
        assert_eq!(entry.index(), i as u64);
        assert_eq!(entry.design, "uniform");
        assert_eq!(entry.stage, if i < 100 { "uniform" } else { "boundary" });
        let weight_is_one = entry.weight.to_bits() == 1.0_f64.to_bits();
        assert!(weight_is_one == (i < 100) && entry.weight > 0.0);
    }
}

const CHILD: &str = "ROBOGATE_CAMPAIGN_TEST_CHILD";

/// The child process of the tests below. It is not a test by itself.
#[test]
#[ignore = "child process of other tests"]
fn child() {
    let Ok(dir) = std::env::var(CHILD) else { return };
    let factory = Synthetic { tick: Duration::from_millis(2), ..Synthetic::default() };
    let dir = Path::new(&dir);
    let done = if dir.join("plan.json").exists() {
        resume(dir, &factory, 2)
    } else {
        start(dir, &plan(300, 150), &factory, 2)
    };
    if let Err(error) = done {
        println!("child: {error}");
        panic!("{error}");
    }
}

pub(crate) fn child_command(dir: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "determinism::child", "--ignored", "--nocapture"]).env(CHILD, dir);
    command.stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

/// Starts a child and waits until it has recorded at least `bytes` bytes.
fn running_child(dir: &Path, bytes: u64) -> Child {
    let mut child = child_command(dir).spawn().unwrap();
    for _ in 0..20_000 {
        let length = fs::metadata(dir.join("journal.rgj")).map_or(0, |m| m.len());
        if length >= bytes || child.try_wait().unwrap().is_some() {
            break;
        }
        thread::sleep(Duration::from_micros(500));
    }
    child
}

#[test]
fn killed_process_resumes_identically() {
    let base = tempfile::tempdir().unwrap();
    let undisturbed = base.path().join("undisturbed");
    start(&undisturbed, &plan(300, 150), &Synthetic::default(), 2).unwrap();
    let dir = base.path().join("killed");
    let mut kills = 0;
    for bytes in [1, 3_000, 20_000, 60_000, 90_000, 120_000] {
        let mut child = running_child(&dir, bytes);
        // SIGKILL cannot be handled.
        child.kill().unwrap();
        child.wait().unwrap();
        kills += u32::from(dir.join("journal.rgj").exists());
    }
    assert!(kills >= 3, "the child finished too early: only {kills} kills took effect");
    resume(&dir, &Synthetic::default(), 2).unwrap();
    assert_eq!(files(&dir), files(&undisturbed));
}

#[cfg(unix)]
#[test]
fn second_process_is_rejected() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("run");
    let mut child = running_child(&dir, 1);
    // It does not end before the attempts.
    let signal = |name: &str| Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success();
    assert!(signal("-STOP"));
    let attempts = [
        resume(&dir, &Synthetic::default(), 1),
        start(&dir, &plan(300, 150), &Synthetic::default(), 1),
        recorded(&dir, 0).map(|_| unreachable!()),
    ];
    for attempt in attempts {
        let error = attempt.unwrap_err();
        assert!(matches!(error, RunError::Locked { .. }), "{error}");
        assert!(error.to_string().contains("in use by another process"));
    }
    assert!(signal("-CONT"));
    assert!(child.wait().unwrap().success());
    let undisturbed = base.path().join("undisturbed");
    start(&undisturbed, &plan(300, 150), &Synthetic::default(), 1).unwrap();
    assert_eq!(files(&dir), files(&undisturbed));
}

#[cfg(unix)]
#[test]
fn full_disk_loses_nothing() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path().join("run");
    // A limit on the size of files simulates a full disk: writes beyond 24 KiB fail.
    let child = child_command(&dir);
    let mut limited = Command::new("bash");
    limited
        .args(["-c", "trap '' XFSZ; ulimit -f 24; exec \"$@\"", "-"])
        .arg(child.get_program())
        .args(child.get_args());
    limited.env(CHILD, &dir).stderr(Stdio::null());
    let output = limited.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(!output.status.success() && text.contains("cannot append to") && text.contains("journal.rgj"), "{text}");
    let kept = fs::metadata(dir.join("journal.rgj")).unwrap().len();
    assert!(kept > 16_000, "{kept} bytes of the journal are left");
    resume(&dir, &Synthetic::default(), 2).unwrap();
    let undisturbed = base.path().join("undisturbed");
    start(&undisturbed, &plan(300, 150), &Synthetic::default(), 1).unwrap();
    assert_eq!(files(&dir), files(&undisturbed));
}

#[test]
fn results_arrive_out_of_order() {
    // If results arrived in order, the tests above would not test reordering.
    let base = tempfile::tempdir().unwrap();
    let mut indices = Vec::new();
    let factory = Synthetic { tick: Duration::from_millis(1), ..Synthetic::default() };
    let mut watch = |event: &Event, _: &_| {
        if let Event::Episode { index, .. } = event {
            indices.push(*index);
        }
    };
    with_pool(&factory, 3, &mut watch, |pool, events| {
        start_run(base.path(), &world::plan(200, 0), provenance(), pool, events)
    })
    .unwrap();
    assert!(!indices.is_sorted());
    indices.sort_unstable();
    assert!(indices.iter().copied().eq(0..200));
}
