//! Limits of the operating system on a process, and the wait for one.

use std::process::{Child, Command, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;

/// Limits on a process.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Address space, in bytes.
    pub(crate) memory_bytes: u64,
    /// Time of the processor, in seconds.
    pub(crate) processor_s: u64,
    /// Time until its parent ends it.
    pub(crate) wall: Duration,
    /// Largest file that it may write, in bytes.
    pub(crate) file_bytes: u64,
}

impl Limits {
    /// For the compilation and the check of a robot's model.
    pub(crate) const MODEL: Self =
        Self { memory_bytes: 4 << 30, processor_s: 120, wall: Duration::from_secs(300), file_bytes: 1 << 30 };

    /// For the Python process of an environment in the sandbox. Its calls have their own limits on time.
    #[cfg(target_os = "linux")]
    pub(crate) const PYTHON: Self =
        Self { memory_bytes: 16 << 30, processor_s: 12 * 3_600, wall: Duration::MAX, file_bytes: 1 << 30 };

    /// Applies the limits to this process and its later children. They cannot be raised again.
    #[cfg(unix)]
    pub(crate) fn set(self) -> anyhow::Result<()> {
        use nix::sys::resource::{Resource, getrlimit, setrlimit};
        let limits = [
            (Resource::RLIMIT_AS, self.memory_bytes),
            (Resource::RLIMIT_CPU, self.processor_s),
            (Resource::RLIMIT_FSIZE, self.file_bytes),
            (Resource::RLIMIT_CORE, 0),
        ];
        for (resource, limit) in limits {
            let (_, most) = getrlimit(resource).with_context(|| format!("cannot read {resource:?}"))?;
            let limit = limit.min(most);
            setrlimit(resource, limit, limit).with_context(|| format!("cannot set {resource:?}"))?;
        }
        Ok(())
    }

    /// Applies the limits: this system has none.
    #[cfg(not(unix))]
    pub(crate) fn set(self) -> anyhow::Result<()> {
        Ok(())
    }
}

/// The program of this process, also if its file has been replaced since.
pub(crate) fn this_program() -> anyhow::Result<Command> {
    #[cfg(target_os = "linux")]
    let program = std::path::PathBuf::from("/proc/self/exe");
    #[cfg(not(target_os = "linux"))]
    let program = std::env::current_exe().context("cannot find this program")?;
    Ok(Command::new(program))
}

/// Waits for the end of a process. `None` if it did not end in time, and was killed.
pub(crate) fn wait(child: &mut Child, limit: Duration) -> std::io::Result<Option<ExitStatus>> {
    let began = Instant::now();
    // Most children end after some hundredths of a second.
    let mut pause = Duration::from_millis(1);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if began.elapsed() >= limit {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        thread::sleep(pause);
        pause = (2 * pause).min(Duration::from_millis(20));
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn processes_that_hang_are_ended() {
        let began = Instant::now();
        let mut child = Command::new("sleep").arg("600").spawn().unwrap();
        assert_eq!(wait(&mut child, Duration::from_millis(50)).unwrap(), None);
        assert!(began.elapsed() < Duration::from_secs(60));
        // It is gone: its status was read.
        assert!(child.try_wait().unwrap().is_some());
    }
}
