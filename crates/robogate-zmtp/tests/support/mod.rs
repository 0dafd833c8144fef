//! Peers in Python, where there is one: `ROBOGATE_BRIDGE_PYTHON` names an interpreter with pyzmq and msgpack.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The interpreter. Where there is none, the test is reported as skipped.
pub(crate) fn python() -> Option<PathBuf> {
    robogate_testing::path("ROBOGATE_BRIDGE_PYTHON", "a Python with pyzmq and msgpack")
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

/// The generator of SplitMix64: tests need no more.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }

    /// Up to three small changes of bytes: some that mean something to a decoder, some that mean nothing.
    pub(crate) fn mutate(&mut self, bytes: &mut Vec<u8>) {
        const TELLING: [u8; 12] = [0, 1, 2, 4, 6, 0x80, 0x91, 0xc0, 0xca, 0xcb, 0xdd, 0xff];
        for _ in 0..self.below(4) {
            if bytes.is_empty() {
                return;
            }
            let at = self.below(bytes.len());
            match self.below(5) {
                0 => bytes[at] = self.below(256) as u8,
                1 => bytes[at] ^= 1 << self.below(8),
                2 => drop(bytes.drain(at..(at + 1 + self.below(9)).min(bytes.len()))),
                3 => bytes[at] = TELLING[self.below(TELLING.len())],
                _ => bytes.insert(at, TELLING[self.below(TELLING.len())]),
            }
        }
    }
}

/// How long a fuzz test goes on: seconds in `ROBOGATE_FUZZ_SECONDS`, or one.
pub(crate) fn fuzz_time() -> Duration {
    let seconds = std::env::var("ROBOGATE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    Duration::from_secs(seconds.unwrap_or(1))
}
