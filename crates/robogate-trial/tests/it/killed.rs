//! A process that is killed at any time loses no acknowledged record and writes none twice.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command as Process, Stdio};
use std::time::Duration;

use robogate_core::Seed;
use robogate_trial::{Command, Folder, Phase, Question, Secret};

use crate::{plan, result};

/// Names the folder for the process that is killed.
const FOLDER: &str = "ROBOGATE_TEST_STUDY";

/// Runs trials and prints each acknowledged request, until it is killed.
#[test]
fn child() {
    let Ok(folder) = std::env::var(FOLDER) else { return };
    let mut folder = Folder::open(Path::new(&folder)).unwrap();
    loop {
        let (code, phase) = (folder.study().code().to_owned(), folder.study().phase());
        let good = folder.study().attempts().len() % 4 < 2;
        let (kind, command) = match phase {
            Phase::Ready => ("start", Command::Start { code: code.clone(), operator: "Ada".to_owned() }),
            Phase::Running => ("stop", Command::Stop { code: code.clone() }),
            Phase::Stopped => ("result", Command::Result { code: code.clone(), result: result(good) }),
            Phase::Paused | Phase::Finished => return,
        };
        let id = format!("{kind}-{code}");
        // Sent twice, as a phone with a bad connection does.
        folder.command(&id, &command).unwrap();
        folder.command(&id, &command).unwrap();
        println!("done {id}");
        std::io::stdout().flush().unwrap();
    }
}

#[test]
fn killed_writers_lose_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let secret = Secret::draw().unwrap();
    Folder::create(dir.path(), &plan(Question::AtLeast(0.5), &["a"], 500, &secret), &secret).unwrap();
    let stream = &mut Seed::campaign(1).stream("kills");
    let mut acknowledged = BTreeSet::new();
    for _ in 0..60 {
        let mut child = Process::new(std::env::current_exe().unwrap())
            .args(["--exact", "killed::child", "--nocapture"])
            .env(FOLDER, dir.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // The first record shows that the process writes; the kill then comes at any point of its work.
        let mut wanted = 1 + stream.below(8);
        let wait = Duration::from_micros(stream.below(3_000) as u64);
        for line in lines {
            let line = line.unwrap();
            if let Some(id) = line.split("done ").nth(1) {
                acknowledged.insert(id.to_owned());
                wanted = wanted.saturating_sub(1);
                if wanted == 0 {
                    std::thread::sleep(wait);
                    child.kill().unwrap();
                }
            }
        }
        child.wait().unwrap();
    }
    assert!(acknowledged.len() >= 60);
    let journal = std::fs::read_to_string(dir.path().join(robogate_trial::JOURNAL)).unwrap();
    let study = Folder::open(dir.path()).unwrap();
    for id in &acknowledged {
        assert_eq!(journal.matches(&format!("\"id\":\"{id}\"")).count(), 1, "{id}");
    }
    let ids: Vec<&str> = journal.lines().filter_map(|line| line.split("\"id\":\"").nth(1)?.split('"').next()).collect();
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len(), "no record twice");
    let finished = acknowledged.iter().filter(|id| id.starts_with("result")).count();
    let recorded = study.study().attempts().iter().filter(|attempt| attempt.result.is_some()).count();
    assert!(recorded >= finished);
}
