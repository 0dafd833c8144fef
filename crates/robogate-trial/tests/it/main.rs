//! Tests of studies: records, requests, decisions, switch and page.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod attack;
mod killed;
mod study;
mod switch;
mod wire;

use robogate_core::Word;
use robogate_trial::{Arm, Command, FORMAT, Folder, Outcome, Plan, Population, Question, Secret, expected, rules};

/// A plan with these policies.
fn plan(question: Question, names: &[&str], blocks: u64, secret: &Secret) -> Plan {
    let word = |text: &&str| Word::new(text).unwrap();
    let mut plan = Plan {
        format: FORMAT,
        question,
        arms: names.iter().map(|name| Arm { name: (*name).to_owned(), sha256: None }).collect(),
        population: Population::Count(20),
        task: "task".to_owned(),
        robot: "robot".to_owned(),
        modes: ["dropped", "missed"].iter().map(word).collect(),
        stages: ["reach", "grasp"].iter().map(word).collect(),
        measure: Some(Word::new("peak_force_n").unwrap()),
        operators: Vec::new(),
        blocks,
        error: 0.05,
        time: None,
        expected: Vec::new(),
        rules: Vec::new(),
        secret_sha256: secret.sha256(),
    };
    plan.expected = expected(&plan).unwrap();
    plan.rules = rules(&plan);
    plan
}

/// A new study of two policies in a temporary folder.
fn study_of_two(blocks: u64) -> (tempfile::TempDir, Folder) {
    let dir = tempfile::tempdir().unwrap();
    let secret = Secret::draw().unwrap();
    Folder::create(dir.path(), &plan(Question::Better, &["alpha-policy", "beta-policy"], blocks, &secret), &secret)
        .unwrap();
    let folder = Folder::open(dir.path()).unwrap();
    (dir, folder)
}

fn result(success: bool) -> Outcome {
    let mode = (!success).then(|| Word::new("dropped").unwrap());
    Outcome { success, mode, ..Outcome::default() }
}

/// Runs the next trial to its end with this result.
fn trial(folder: &mut Folder, success: bool) {
    let code = folder.study().code().to_owned();
    for command in [
        Command::Start { code: code.clone(), operator: "Ada".to_owned() },
        Command::Stop { code: code.clone() },
        Command::Result { code, result: result(success) },
    ] {
        assert!(folder.command("", &command).unwrap());
    }
}
