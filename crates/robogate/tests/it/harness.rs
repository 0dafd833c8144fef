//! Runs the command and checks its answer.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

/// The longest wait for a condition. It is far above any expected time, and only ends a test that would wait for ever.
const PATIENCE: Duration = Duration::from_secs(120);

/// A suite with two scenarios.
pub(crate) const TWO_SCENARIOS: &str = r#"
    schema = 1
    name = "two"
    version = "1.0.0"
    description = "Two scenarios."
    defaults = { mass_kg = { low = 0.2, high = 0.4 }, position_jitter_m = 0.003, lighting_lux = 500.0 }
    [[group]]
    name = "plain"
    category = "nominal"
    scenarios = [{ id = "plain-1" }, { id = "plain-2", mass_kg = 0.5 }]
"#;

/// Runs the command.
pub(crate) fn robogate(arguments: &[&str]) -> Output {
    robogate_in(Path::new("."), arguments)
}

/// Runs the command in `dir`.
pub(crate) fn robogate_in(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_robogate")).args(arguments).current_dir(dir).output().unwrap()
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Everything that the command printed: stdout, then stderr.
pub(crate) fn text(output: &Output) -> String {
    stdout(output) + &stderr(output)
}

#[track_caller]
pub(crate) fn assert_done(output: &Output) {
    assert_eq!(output.status.code(), Some(0), "{}", text(output));
}

/// Runs the command and checks its exit code and each of `parts` in what it prints. Returns all of that.
#[track_caller]
pub(crate) fn assert_exit(arguments: &[&str], code: i32, parts: &[&str]) -> String {
    assert_exit_in(Path::new("."), arguments, code, parts)
}

/// [`assert_exit`] in `dir`.
#[track_caller]
pub(crate) fn assert_exit_in(dir: &Path, arguments: &[&str], code: i32, parts: &[&str]) -> String {
    let output = robogate_in(dir, arguments);
    let printed = text(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {printed}");
    for part in parts {
        assert!(printed.contains(part), "{arguments:?}: expected {part:?} in {printed}");
    }
    printed
}

/// Checks that the command refuses its arguments: exit code 2, nothing on stdout, and each of `parts` on stderr.
#[track_caller]
pub(crate) fn assert_refused(arguments: &[&str], parts: &[&str]) {
    let output = robogate(arguments);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output));
    assert_eq!(stdout(&output), "", "{arguments:?}");
    for part in parts {
        assert!(stderr(&output).contains(part), "{arguments:?}: expected {part:?} in {}", stderr(&output));
    }
}

/// Runs a line of arguments, separated by spaces, in `dir`. Checks exit code and parts of the output, and returns stdout.
#[track_caller]
pub(crate) fn verb(dir: &Path, line: &str, code: i32, parts: &[&str]) -> String {
    let arguments: Vec<&str> = line.split(' ').collect();
    let output = robogate_in(dir, &arguments);
    let printed = text(&output);
    assert_eq!(output.status.code(), Some(code), "{line}: {printed}");
    for part in parts {
        assert!(printed.contains(part), "{line} does not say {part:?}: {printed}");
    }
    stdout(&output)
}

/// Writes the file of a transfer from the simulation `run` in `dir`, with the trials in `trials.csv`. Its strata are replaced by
/// two with 25 trials each, of which `successes` succeeded.
#[track_caller]
pub(crate) fn real_trials(dir: &Path, run: &str, file: &str, successes: u64) {
    verb(dir, &format!("transfer --sim {run} --real trials.csv --out {file}"), 0, &[]);
    let mut document: Value = serde_json::from_slice(&fs::read(dir.join(file)).unwrap()).unwrap();
    let stratum = json!({ "share": 0.5, "trials": 25, "successes": successes });
    document["exact"] = json!({ "estimated": { "interval_95": [0.0, 1.0], "cut": 0.5, "strata": [stratum, stratum] } });
    fs::write(dir.join(file), document.to_string()).unwrap();
}

/// Waits until a process fulfils a condition. Returns `false` if it ends before that.
#[track_caller]
pub(crate) fn runs_until(child: &mut Child, mut condition: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !condition() {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        assert!(begun.elapsed() < PATIENCE, "the condition was not fulfilled in {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
    true
}

/// Starts a line of arguments, separated by spaces, in `dir`, and kills it when it fulfils a condition. It must not have written
/// the file `end` of its folder `out` by then: if a busy machine lets it, the folder is removed and the line is started again.
#[track_caller]
fn kill_when(dir: &Path, line: &str, [out, end]: [&str; 2], mut condition: impl FnMut(&mut Child) -> bool) {
    for _ in 0..10 {
        let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(line.split(' '))
            .current_dir(dir)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let fulfilled = condition(&mut child);
        child.kill().unwrap();
        let status = child.wait().unwrap();
        if fulfilled && status.code().is_none() && !dir.join(out).join(end).exists() {
            return;
        }
        fs::remove_dir_all(dir.join(out)).unwrap();
    }
    panic!("{line} ended each time before it was killed");
}

/// Kills a line of arguments after the first line on stderr that is `awaited`, and before it writes the file `end` of its folder
/// `out`.
#[track_caller]
pub(crate) fn kill_after(dir: &Path, line: &str, [out, end]: [&str; 2], awaited: impl Fn(&str) -> bool) {
    kill_when(dir, line, [out, end], |child| {
        BufReader::new(child.stderr.as_mut().unwrap()).lines().any(|line| awaited(&line.unwrap()))
    });
}

/// Kills a line of arguments when `file` in its folder `out` has more than `bytes` bytes, and before it writes the file `end`.
#[track_caller]
pub(crate) fn kill_at_size(dir: &Path, line: &str, [out, end]: [&str; 2], file: &str, bytes: u64) {
    let file = dir.join(out).join(file);
    let grown = || fs::metadata(&file).is_ok_and(|file| file.len() > bytes);
    kill_when(dir, line, [out, end], |child| runs_until(child, &grown));
}

/// Runs the commands that `robogate plan` prints for a campaign in shards until it prints none. Returns how many there were.
#[track_caller]
pub(crate) fn run_all_shards(dir: &Path, folder: &str) -> usize {
    let mut commands = 0;
    loop {
        let next = verb(dir, &format!("plan {folder} --next"), 0, &[]);
        if next.is_empty() {
            return commands;
        }
        for command in next.lines() {
            verb(dir, command.strip_prefix("robogate ").unwrap(), 0, &[]);
            commands += 1;
        }
    }
}

/// Whether the process `id` has a handler for SIGINT, which has the number 2.
#[cfg(target_os = "linux")]
pub(crate) fn handles_interrupts(id: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    mask.is_some_and(|mask| u64::from_str_radix(mask.trim(), 16).unwrap() & 0b10 != 0)
}

/// The path of a file in a temporary folder, as an argument.
pub(crate) fn path(dir: &TempDir, name: &str) -> String {
    dir.path().join(name).to_str().unwrap().to_owned()
}
