//! Peers in Python, where there is one: `ROBOGATE_BRIDGE_PYTHON` names an interpreter with pyzmq and msgpack.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The interpreter; says so where there is none.
pub(crate) fn python() -> Option<PathBuf> {
    let python = std::env::var_os("ROBOGATE_BRIDGE_PYTHON").map(PathBuf::from);
    if python.is_none() {
        eprintln!("skipped: ROBOGATE_BRIDGE_PYTHON names no Python with pyzmq and msgpack");
    }
    python
}

/// The repository's root.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A process that ends with the test.
pub(crate) struct Peer {
    child: Child,
    /// Its first line of output.
    pub(crate) said: String,
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
            .expect("the interpreter starts");
        let mut said = String::new();
        BufReader::new(child.stdout.take().expect("it is piped")).read_line(&mut said).expect("it says a line");
        Self { child, said: said.trim().to_owned() }
    }

    /// Ends it now.
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
