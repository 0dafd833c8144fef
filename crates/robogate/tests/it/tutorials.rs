//! The tutorials: every command of a page runs, and every line of output that the page shows is what the command prints.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// A command of a page, the exit code that its comment names, and the lines that the page shows below it.
struct Shown {
    command: String,
    code: i32,
    lines: Vec<String>,
}

/// The commands of the blocks `console`, in order.
fn shown(page: &str) -> Vec<Shown> {
    let mut found: Vec<Shown> = Vec::new();
    for block in page.split("```console\n").skip(1) {
        for line in block.split("```").next().unwrap().lines() {
            if let Some(text) = line.strip_prefix("$ ") {
                let (command, comment) = text.split_once("  # ").unwrap_or((text, ""));
                let code = comment.strip_prefix("exit code ").map_or(0, |code| code[..1].parse().unwrap());
                found.push(Shown { command: command.trim().to_owned(), code, lines: Vec::new() });
            } else {
                found.last_mut().unwrap().lines.push(line.to_owned());
            }
        }
    }
    found
}

/// Runs a page in an empty folder beside a checkout, as a reader does. `...` stands for any lines.
#[track_caller]
fn follow(name: &str, path: &str) {
    let dir = TempDir::new().unwrap();
    let at = dir.path().join("work");
    fs::create_dir(&at).unwrap();
    std::os::unix::fs::symlink(repository(), dir.path().join("robogate")).unwrap();
    let page = fs::read_to_string(repository().join("docs/tutorials").join(name)).unwrap();
    let commands = shown(&page);
    assert!(commands.len() > 3, "{name}: {} commands", commands.len());
    for Shown { command, code, lines } in commands {
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("{{ {command}\n}} 2>&1")]).current_dir(&at).env("PATH", path);
        shell.env("ROBOGATE_STATE_DIR", dir.path().join("state"));
        let output = shell.output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(code), "{name}: {command}\n{printed}");
        let mut rest = printed.lines().map(str::trim_end);
        let mut anywhere = false;
        for line in lines {
            let line = line.trim_end();
            if line == "..." {
                anywhere = true;
                continue;
            }
            let found = if anywhere { rest.find(|other| *other == line) } else { rest.next() };
            assert_eq!(found, Some(line), "{name}: {command}\n{printed}");
            anywhere = false;
        }
        assert!(anywhere || rest.next().is_none(), "{name}: {command} prints more\n{printed}");
    }
}

/// The folders of programs, with the command that is tested first.
fn path(python: Option<PathBuf>) -> String {
    let command = Path::new(env!("CARGO_BIN_EXE_robogate")).parent().unwrap().to_path_buf();
    let python = python.and_then(|python| Some(python.parent()?.to_path_buf()));
    let others = std::env::var_os("PATH").unwrap();
    let all = std::iter::once(command).chain(python).chain(std::env::split_paths(&others));
    std::env::join_paths(all).unwrap().into_string().unwrap()
}

#[test]
fn tutorial_of_environment_and_policy_is_true() {
    let python = robogate_testing::path("ROBOGATE_METAWORLD_PYTHON", "a Python with gymnasium, pyzmq and msgpack");
    let Some(python) = python else { return };
    follow("policy.md", &path(Some(python)));
}

#[test]
fn tutorial_of_robot_and_cell_is_true() {
    follow("robot.md", &path(None));
}

#[test]
fn tutorial_of_evidence_and_monitor_is_true() {
    follow("evidence.md", &path(None));
}
