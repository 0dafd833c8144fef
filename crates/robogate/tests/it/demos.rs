//! End-to-end tests of `robogate demos`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::harness::assert_exit_in;
#[cfg(target_os = "linux")]
use crate::harness::{handles_interrupts, runs_until};

/// All files below a folder, by their relative path.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut waiting = vec![folder.to_owned()];
    while let Some(next) = waiting.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                waiting.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let dir = TempDir::new().unwrap();
    // One thread records five episodes as a round of four and a rest. Two threads get three and two of them.
    let record = |threads: &str| {
        let out = dir.path().join(threads);
        let output = Command::new(env!("CARGO_BIN_EXE_robogate"))
            .args(["demos", "-n", "5", "--size", "16", "--all", "--threads", threads, "--out"])
            .arg(&out)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        files(&out)
    };
    let (one, two) = (record("1"), record("2"));
    assert!(one.keys().any(|path| path.extension().is_some_and(|e| e == "parquet")));
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    for (path, bytes) in &one {
        assert!(*bytes == two[path], "{} differs", path.display());
    }
}

#[cfg(target_os = "linux")]
#[test]
fn interrupted_demonstrations_leave_no_folder() {
    let dir = TempDir::new().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_robogate"))
        .args("demos -n 20000 --size 16 --threads 1 --out demos".split(' '))
        .current_dir(&dir)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let (id, partial) = (child.id(), dir.path().join(".demos.part"));
    assert!(runs_until(&mut child, || handles_interrupts(id) && partial.exists()), "the recording ended");
    assert!(Command::new("kill").args(["-INT", &id.to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{printed}");
    assert!(printed.contains("interrupted: no dataset was written"), "{printed}");
    assert_eq!(fs::read_dir(&dir).unwrap().count(), 0);
}

#[test]
fn folder_that_cannot_be_created_is_no_wrong_usage() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("file"), "").unwrap();
    let demos = |out: &str, code: i32, part: &str| {
        assert_exit_in(dir.path(), &["demos", "-n", "1", "--size", "16", "--out", out], code, &[part]);
    };
    demos("file/demos", 5, "cannot create");
    demos("file", 2, "the folder exists");
}
