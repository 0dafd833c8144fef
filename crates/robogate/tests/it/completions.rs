//! Completions of shells, and man pages.

use std::fs;
use std::process::Command;

use tempfile::TempDir;

use crate::harness::{assert_done, robogate_in, stdout};

#[test]
fn bash_completes_verbs_and_options() {
    let dir = TempDir::new().unwrap();
    let output = robogate_in(dir.path(), &["completions", "bash"]);
    assert_done(&output);
    let script = dir.path().join("robogate.bash");
    fs::write(&script, stdout(&output)).unwrap();
    let complete = |words: &str, position: usize| {
        let program = format!(
            "source '{}'; COMP_WORDS=({words}); COMP_CWORD={position}; _robogate robogate '{}' ''; echo \"${{COMPREPLY[*]}}\"",
            script.display(),
            words.rsplit(' ').next().unwrap_or_default()
        );
        let done = Command::new("bash").args(["-c", &program]).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    assert!(complete("robogate ga", 1).contains("gate"));
    assert!(complete("robogate gate --requi", 2).contains("--requirements"));
}

#[test]
fn every_verb_has_a_man_page() {
    let dir = TempDir::new().unwrap();
    assert_done(&robogate_in(dir.path(), &["completions", "man", "--out", "man"]));
    let page = |name: &str| fs::read_to_string(dir.path().join("man").join(name)).unwrap();
    assert!(page("robogate.1").contains("robogate\\-gate(1)"));
    assert!(page("robogate-gate.1").contains("requirements"));
    for file in ["_robogate", "robogate.fish"] {
        let shell = if file.starts_with('_') { "zsh" } else { "fish" };
        assert_done(&robogate_in(dir.path(), &["completions", shell, "--out", "shells"]));
        assert!(fs::read_to_string(dir.path().join("shells").join(file)).unwrap().contains("requirements"));
    }
}

/// A full disk is an error that names the file.
#[cfg(target_os = "linux")]
#[test]
fn full_disks_are_errors() {
    let dir = TempDir::new().unwrap();
    std::os::unix::fs::symlink("/dev/full", dir.path().join("robogate.bash")).unwrap();
    let output = robogate_in(dir.path(), &["completions", "bash", "--out", "."]);
    let said = crate::harness::text(&output);
    assert!(output.status.code() == Some(5) && said.contains("cannot write ./robogate.bash"), "{said}");
}
