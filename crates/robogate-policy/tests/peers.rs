//! Tests against upstream code: openpi-client's codec and image tools, and vla-eval's model server.
//!
//! `ROBOGATE_POLICY_PYTHON` is the path of a Python interpreter with `tests/requirements.lock`, which `scripts/test.sh`
//! creates. Without it these tests are skipped.

#[path = "support/direct.rs"]
mod direct;
mod support;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use direct::direct;
use robogate_core::{Command as Motion, Policy};
use robogate_policy::{ExternalPolicy, Profile};
use support::{begin, observation};

/// A process that is stopped at the end of the test.
struct Peer {
    child: Child,
    url: String,
}

impl Peer {
    /// Start a script and wait until it prints its address.
    fn start(script: &str) -> Option<Self> {
        let python = robogate_testing::path("ROBOGATE_POLICY_PYTHON", "a Python with openpi-client and vla-eval")?;
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers").join(script);
        let mut child =
            Command::new(python).arg(script).stdout(Stdio::piped()).spawn().expect("the interpreter starts");
        let mut url = String::new();
        BufReader::new(child.stdout.take().expect("stdout is piped"))
            .read_line(&mut url)
            .expect("the script prints a line");
        Some(Self { child, url: url.trim().to_owned() })
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

fn profile(name: &str, change: impl Fn(String) -> String) -> Arc<Profile> {
    let text = Profile::built_in(name).expect("it is built in").to_owned();
    Arc::new(Profile::from_toml(&change(text)).expect("it is a profile"))
}

/// Position and rotation vector of the tool in [`observation`], as an action with the built-in scales.
const ECHOED: ([f64; 3], [f64; 3]) = ([0.5 * 0.02, 0.0, 0.3 * 0.02], [0.05, 0.0, 0.0]);

fn near(a: [f64; 3], b: [f64; 3]) {
    a.iter().zip(b).for_each(|(a, b)| assert!((a - b).abs() < 1e-6, "{a} differs from {b}"));
}

#[test]
fn openpi_code_agrees() {
    let Some(peer) = Peer::start("openpi_peer.py") else { return };
    let profile = profile("pi0-libero", |text| direct(&text).replace("length = 50", "length = 10"));
    let mut policy = ExternalPolicy::connect(&peer.url, profile).unwrap();
    assert_eq!(policy.declared()["reset_pose"][1], -1.5);
    for _ in 0..2 {
        begin(&mut policy, "pick up the box").unwrap();
        let Motion::ToolDelta { translation_m, rotation_rad } = policy.act(&observation(256)).unwrap().command else {
            panic!("expected a tool delta");
        };
        near(translation_m, ECHOED.0);
        // The rotation vector has the angle pi and is clipped to 1 before scaling.
        near(rotation_rad, ECHOED.1);
        // Waits longer than the server waits for a pong.
        std::thread::sleep(Duration::from_secs(3));
    }
}

#[test]
fn vla_eval_code_agrees() {
    let Some(peer) = Peer::start("vla_eval_peer.py") else { return };
    // The server prints its address before it listens.
    let retrying = |text: String| direct(&text) + "\n[server]\nattempts = 5\n";
    let connect = || {
        let mut last = None;
        for _ in 0..100 {
            match ExternalPolicy::connect(&peer.url, profile("smolvla-vla-eval", retrying)) {
                Ok(policy) => return policy,
                Err(error) => last = Some(error),
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("{last:?}");
    };
    let mut policy = connect();
    assert_eq!(policy.declared()["model_server"], "Echo");
    for _ in 0..2 {
        begin(&mut policy, "pick up the box").unwrap();
        for step in 0..2 {
            let Motion::ToolDelta { translation_m, .. } = policy.act(&observation(256)).unwrap().command else {
                panic!("expected a tool delta");
            };
            // The second action comes from the server's buffer. It is one more than the first, clipped to 1. A new
            // episode clears the buffer.
            near(translation_m, if step == 0 { ECHOED.0 } else { [0.02; 3] });
        }
    }
    begin(&mut policy, "boom").unwrap();
    let fault = policy.act(&observation(256)).unwrap_err();
    assert!(fault.detail.contains("no such task"), "{}", fault.detail);
}
