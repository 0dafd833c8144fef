//! Python peers and random bytes for tests. `ROBOGATE_BRIDGE_PYTHON` is the path of a Python interpreter with pyzmq and
//! msgpack.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

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

/// The SplitMix64 generator.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }

    /// Apply up to three random changes. Half of the inserted bytes are significant to the decoders.
    pub(crate) fn mutate(&mut self, bytes: &mut Vec<u8>) {
        const SIGNIFICANT: [u8; 12] = [0, 1, 2, 4, 6, 0x80, 0x91, 0xc0, 0xca, 0xcb, 0xdd, 0xff];
        for _ in 0..self.below(4) {
            if bytes.is_empty() {
                return;
            }
            let at = self.below(bytes.len());
            match self.below(5) {
                0 => bytes[at] = self.below(256) as u8,
                1 => bytes[at] ^= 1 << self.below(8),
                2 => drop(bytes.drain(at..(at + 1 + self.below(9)).min(bytes.len()))),
                3 => bytes[at] = SIGNIFICANT[self.below(SIGNIFICANT.len())],
                _ => bytes.insert(at, SIGNIFICANT[self.below(SIGNIFICANT.len())]),
            }
        }
    }
}

/// Duration of a fuzz test: `ROBOGATE_FUZZ_SECONDS`, or one second.
pub(crate) fn fuzz_time() -> Duration {
    let seconds = std::env::var("ROBOGATE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    Duration::from_secs(seconds.unwrap_or(1))
}
