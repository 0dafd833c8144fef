//! What the tests of several crates share: fuzzing, an allocator that counts, and external tools and data that a machine may lack.
//!
//! Cargo counts a test that returns early as passed. A test without its tool therefore calls a function of this crate,
//! which writes a line `skipped: TEST: REASON` to stderr and appends it to the file named by `ROBOGATE_SKIPPED_FILE`.
//! `scripts/test.sh` prints these lines at the end. With `ROBOGATE_TESTS_STRICT=1` a missing tool fails the test.
//!
//! ```no_run
//! # fn example() {
//! let Some(python) = robogate_testing::path("ROBOGATE_TEST_PYTHON", "a Python with pyarrow") else { return };
//! # drop(python);
//! # }
//! ```

pub mod fuzz;
mod memory;

use std::env;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

pub use memory::{CountingAllocator, LARGEST, peak_memory};

/// Environment variable. With the value `1` a missing tool fails the test.
pub const STRICT: &str = "ROBOGATE_TESTS_STRICT";
/// Environment variable with the tools that may be missing even in a strict run, by the names in the tests, separated
/// by commas.
pub const OPTIONAL: &str = "ROBOGATE_TESTS_OPTIONAL";
/// Environment variable with the file to which lines about skipped tests are appended.
pub const SKIPPED_FILE: &str = "ROBOGATE_SKIPPED_FILE";

/// The path in the environment variable `variable`. `what` describes the expected content. `None` if it is not set.
///
/// # Panics
/// In a strict run, if the variable is not set.
#[must_use]
pub fn path(variable: &str, what: &str) -> Option<PathBuf> {
    let value = env::var_os(variable).filter(|value| !value.is_empty());
    if value.is_none() {
        skip(variable, &format!("{variable} is not set. Expected {what}"));
    }
    value.map(PathBuf::from)
}

/// The program `name`, from `PATH` or `/usr/sbin`. `None` if it is not installed.
///
/// # Panics
/// In a strict run, if the program is not installed.
#[must_use]
pub fn program(name: &str) -> Option<PathBuf> {
    let folders = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&folders)
        .chain([PathBuf::from("/usr/sbin")])
        .map(|folder| folder.join(name))
        .find(|path| path.is_file());
    if found.is_none() {
        skip(name, &format!("the program `{name}` is not installed"));
    }
    found
}

/// Reports that the running test is skipped because `tool` is missing.
///
/// # Panics
/// In a strict run, unless `ROBOGATE_TESTS_OPTIONAL` lists `tool`.
pub fn skip(tool: &str, reason: &str) {
    let line = format!("skipped: {}: {reason}", test_name());
    let optional = env::var(OPTIONAL).is_ok_and(|list| list.split(',').any(|name| name.trim() == tool));
    let strict = env::var(STRICT).is_ok_and(|value| value == "1");
    assert!(!strict || optional, "{line}. {STRICT}=1 forbids this. Hint: scripts/test.sh installs the required tools.");
    note(&line);
}

#[expect(clippy::print_stderr, reason = "skipped tests are reported to the user")]
fn note(line: &str) {
    eprintln!("{line}");
    let Some(path) = env::var_os(SKIPPED_FILE) else { return };
    // A single write call, because tests in other processes append to the same file.
    let written = OpenOptions::new()
        .create(true)
        .append(true)
        .open(&path)
        .and_then(|mut file| file.write_all(format!("{line}\n").as_bytes()));
    assert!(written.is_ok(), "{}: cannot append a line: {written:?}. Check {SKIPPED_FILE}.", path.display());
}

/// The crate and name of the running test.
fn test_name() -> String {
    let thread = std::thread::current();
    // cargo-nextest sets the name; otherwise the test harness names the thread of each test.
    let test = env::var("NEXTEST_TEST_NAME").ok();
    let test = test.as_deref().or(thread.name()).unwrap_or("unknown test");
    format!("{} {test}", env::var("CARGO_PKG_NAME").unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Output};

    use super::*;

    /// Runs the test below in a separate process with these variables.
    fn outer(variables: &[(&str, &str)], folder: &std::path::Path) -> Output {
        let mut command = Command::new(env::current_exe().unwrap());
        command.args(["--exact", "tests::inner", "--ignored", "--nocapture"]);
        command.env_remove(STRICT).env_remove(OPTIONAL).env_remove("NEXTEST_TEST_NAME");
        command.env(SKIPPED_FILE, folder.join("skipped.txt")).envs(variables.iter().copied()).output().unwrap()
    }

    #[test]
    #[ignore = "run by the test below"]
    fn inner() {
        assert_eq!(path("ROBOGATE_NO_SUCH_TOOL", "a tool"), None);
    }

    #[test]
    fn missing_tools_are_recorded_or_fail() {
        let folder = env::temp_dir().join(format!("robogate-testing-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let strict = (STRICT, "1");
        assert!(outer(&[], &folder).status.success());
        assert!(outer(&[strict, (OPTIONAL, "egl, ROBOGATE_NO_SUCH_TOOL")], &folder).status.success());
        let failed = outer(&[strict], &folder);
        assert!(!failed.status.success());
        assert!(String::from_utf8_lossy(&failed.stderr).contains("forbids this"));
        let line = "skipped: robogate-testing tests::inner: ROBOGATE_NO_SUCH_TOOL is not set. Expected a tool\n";
        assert_eq!(std::fs::read_to_string(folder.join("skipped.txt")).unwrap(), line.repeat(2));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn programs_are_found_on_the_path() {
        assert!(program("sh").is_some_and(|path| path.ends_with("sh")));
    }
}
