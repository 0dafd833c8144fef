//! Python peers for tests. `ROBOGATE_BRIDGE_PYTHON` is the path of a Python interpreter with pyzmq and
//! msgpack.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The interpreter. If there is none, the test is reported as skipped.
pub(crate) fn python() -> Option<PathBuf> {
    robogate_testing::path("ROBOGATE_BRIDGE_PYTHON", "a Python with pyzmq and msgpack")
}

/// Root folder of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A process that is stopped at the end of the test.
pub(crate) struct Peer {
    child: Child,
    /// First line of its output.
    pub(crate) first_line: String,
}

impl Peer {
    /// Starts a script and waits for its first line.
    pub(crate) fn start(python: &Path, script: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(python)
            .arg(script)
            .args(arguments)
            .env("PYTHONPATH", root().join("bridges/common"))
            .stdout(Stdio::piped())
            .spawn()
            .expect("cannot start the interpreter");
        let mut first_line = String::new();
        BufReader::new(child.stdout.take().expect("stdout is piped"))
            .read_line(&mut first_line)
            .expect("the script must print a line");
        Self { child, first_line: first_line.trim().to_owned() }
    }

    /// End the process.
    pub(crate) fn kill(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.kill();
    }
}
