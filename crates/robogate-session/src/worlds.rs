//! The simulator of many worlds, as a process of this program.

use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::process::Child;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use robogate_physics::worlds::{Identity, Member, Server, Simulator};

use crate::environments::Interpreter;
use crate::isolation::Scratch;

/// The Python environment of `robogate env setup` that has MuJoCo Warp.
const FAMILY: &str = "warp";
/// A folder in memory, where the arrays that both processes use are fastest.
const MEMORY: &str = "/dev/shm";

/// The simulator of many worlds. Its process ends with this value.
#[derive(Debug)]
pub(crate) struct Worlds {
    /// `None` at the end, because the process ends with its input.
    simulator: Option<Arc<Simulator>>,
    child: Child,
    _folder: Scratch,
}

impl Worlds {
    /// Starts the simulator. With `deterministic`, a rerun on the same card gives the same bytes.
    pub(crate) fn start(deterministic: bool) -> anyhow::Result<Self> {
        let memory = Path::new(MEMORY);
        let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let folder = Scratch::below(&parent).context("cannot create a folder for the worlds")?;
        let output = folder.path().join("output");
        let interpreter = Interpreter::choose(None, FAMILY)?;
        let mut command = interpreter.module("robogate_worlds");
        if deterministic {
            command.arg("--deterministic");
        }
        let mut child = command.stderr(File::create(&output)?).spawn().map_err(|why| interpreter.unusable(&why))?;
        let (requests, replies) = child.stdin.take().zip(child.stdout.take()).context("a process without pipes")?;
        match Server::new(Box::new(requests), Box::new(BufReader::new(replies)), folder.path().to_owned()) {
            Ok(server) => Ok(Self { simulator: Some(Arc::new(Simulator::new(server))), child, _folder: folder }),
            Err(why) => {
                // It has ended, or it ends with its input.
                let _ = child.wait();
                let text = fs::read_to_string(&output).unwrap_or_default();
                let last = text.lines().last().unwrap_or_default();
                Err(anyhow!("{}: {last}\nHint: `robogate env setup {FAMILY}` installs MuJoCo Warp", why.detail))
            }
        }
    }

    /// How many episodes are in progress by default with so many threads.
    pub(crate) fn in_flight(&self, threads: usize) -> usize {
        /// Worlds on a GPU, and of each thread on the slow device of a processor.
        const WORLDS_ON_GPU: usize = 2048;
        const WORLDS_OF_THREAD: usize = 4;
        let on_gpu = self.identity().is_some_and(|identity| identity.alias != "cpu");
        if on_gpu { WORLDS_ON_GPU } else { threads * WORLDS_OF_THREAD }
    }

    /// A member of the simulator.
    pub(crate) fn join(&self) -> anyhow::Result<Member> {
        Ok(Member::join(Arc::clone(self.simulator.as_ref().context("the simulator has ended")?)))
    }

    /// The versions and the device, as a run records them.
    pub(crate) fn version(&self) -> Option<String> {
        let Identity { device, warp, mujoco, mujoco_warp, deterministic, .. } = self.identity()?;
        let mode = if *deterministic { ", deterministic" } else { "" };
        Some(format!("{mujoco_warp} (MuJoCo {mujoco}, Warp {warp}) on {device}{mode}"))
    }

    fn identity(&self) -> Option<&Identity> {
        self.simulator.as_ref().map(|simulator| simulator.identity())
    }
}

impl Drop for Worlds {
    fn drop(&mut self) {
        // All members are gone, so this closes the input of the process, which ends it.
        self.simulator = None;
        let _ = self.child.wait();
    }
}
