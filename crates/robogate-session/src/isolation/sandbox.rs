//! The sandbox of a Python process: what it may read, where it may write, and how it starts.
//!
//! The process that becomes Python restricts itself first ([`super::kernel`]). Python then tells which of its
//! operations were refused (`robogate_eval/serving/sandbox.py`), so that an error can name them.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, anyhow};
use serde::{Deserialize, Serialize};

use super::limits::this_program;
use super::{PYTHON, is_parent, kernel};
use crate::environment_choice::file_and_attribute;
use crate::environments::BUNDLED;
use crate::loaded_policy::LoadedPolicy;
use crate::origin;

/// Files and folders of the system that any program may need. None of them contains a secret.
const OF_THE_SYSTEM: &[&str] = &[
    "/usr",
    "/bin",
    "/sbin",
    "/lib",
    "/lib32",
    "/lib64",
    "/proc",
    "/sys",
    "/dev/null",
    "/dev/zero",
    "/dev/full",
    "/dev/random",
    "/dev/urandom",
    "/etc/alternatives",
    "/etc/fonts",
    "/etc/glvnd",
    "/etc/group",
    "/etc/hosts",
    "/etc/ld.so.cache",
    "/etc/ld.so.conf",
    "/etc/ld.so.conf.d",
    "/etc/localtime",
    "/etc/mime.types",
    "/etc/nsswitch.conf",
    "/etc/os-release",
    "/etc/passwd",
    "/etc/ssl/certs",
    "/etc/timezone",
];

/// Environment variables that the process keeps: others may contain keys. Those that the command sets are
/// added.
const KEPT: &[&str] = &["PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "MUJOCO_GL", "PYOPENGL_PLATFORM"];

/// The environment variable that tells Python what it may do, as JSON.
const TOLD: &str = "ROBOGATE_SANDBOX";

/// What a process in the sandbox may do.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Rights {
    /// Files and folders that it may read.
    pub(super) read: Vec<PathBuf>,
    /// Folders that it may also change.
    pub(super) write: Vec<PathBuf>,
}

/// Folders and files elsewhere that the user opens to processes in the sandbox.
#[derive(Debug, Clone, Default)]
pub struct SandboxFolders {
    /// Those that they may read.
    pub read: Vec<PathBuf>,
    /// Those that they may read and change.
    pub write: Vec<PathBuf>,
}

impl SandboxFolders {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.read.is_empty() && self.write.is_empty()
    }

    /// The same with whole paths, without links.
    fn resolved(&self) -> anyhow::Result<Self> {
        let resolve = |flag: &'static str, paths: &[PathBuf]| -> anyhow::Result<Vec<PathBuf>> {
            let resolve = |path: &PathBuf| {
                let found = path.canonicalize();
                found.with_context(|| {
                    format!("{flag} {}: cannot be opened\nHint: name a folder that exists", path.display())
                })
            };
            paths.iter().map(resolve).collect()
        };
        Ok(Self { read: resolve(SANDBOX_READ, &self.read)?, write: resolve(SANDBOX_WRITE, &self.write)? })
    }
}

/// The option that opens a folder to processes in the sandbox.
const SANDBOX_READ: &str = "--sandbox-read";
/// The same for changes.
const SANDBOX_WRITE: &str = "--sandbox-write";

/// What the user can do about operations that the sandbox refused, if they were of files.
pub(crate) fn hint_for_refused(text: &str) -> Option<&'static str> {
    let refused = |what: &str| text.contains(&format!("refused to {what} /"));
    (refused("read") || refused("write"))
        .then_some("Hint: --sandbox-read FOLDER opens a folder to the environment, and --sandbox-write FOLDER also lets it change files there")
}

/// The sandbox of the processes of one environment.
#[derive(Debug, Clone)]
pub(crate) struct Sandbox {
    python: PathBuf,
    read: Vec<PathBuf>,
    write: Vec<PathBuf>,
    /// Environment variables that select the libraries for graphics, if the user chose none: there is no
    /// display.
    graphics: BTreeMap<String, String>,
}

/// A temporary folder of one process. It is removed when this value is dropped.
#[derive(Debug)]
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    /// A new folder for this user alone.
    pub(crate) fn below(parent: &Path) -> io::Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        loop {
            let number = NEXT.fetch_add(1, Ordering::Relaxed);
            let folder = parent.join(format!("robogate-{}-{number}", std::process::id()));
            let mut builder = fs::DirBuilder::new();
            #[cfg(unix)]
            std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
            match builder.create(&folder) {
                Err(why) if why.kind() == io::ErrorKind::AlreadyExists => {}
                made => return made.and_then(|()| folder.canonicalize()).map(Self),
            }
        }
    }

    /// Its path.
    #[cfg(feature = "mujoco")]
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A file that is left is in the folder for temporary files.
        let _ = fs::remove_dir_all(&self.0);
    }
}

impl Sandbox {
    /// The sandbox of an environment by its name, with the policy that its processes load. `python` runs a
    /// program in its interpreter outside of the sandbox.
    ///
    /// # Errors
    /// The kernel has no sandbox, or a folder that the environment needs contains the user's keys.
    pub(crate) fn of(
        environment: &str,
        loads: Option<&LoadedPolicy>,
        folders: &SandboxFolders,
        python: &mut Command,
    ) -> anyhow::Result<Self> {
        /// Prints the interpreter, the folders from which it imports, and the libraries for graphics: their
        /// search starts processes.
        const ABOUT: &str = r"
import sys
# The first entry is the current folder, whose json.py would run here.
sys.path[:] = [path for path in sys.path if path]
import importlib.util, json, os
from ctypes.util import find_library
graphics = {'MUJOCO_GL': 'egl' if find_library('EGL') else 'osmesa' if find_library('OSMesa') else 'disable'}
glfw = importlib.util.find_spec('glfw')
windows = os.path.join(os.path.dirname(glfw.origin), 'x11', 'libglfw.so') if glfw and glfw.origin else ''
if os.path.isfile(windows):
    graphics['PYGLFW_LIBRARY'] = windows
print(json.dumps([sys.executable, [sys.prefix, sys.base_prefix, sys.exec_prefix, *sys.path], graphics]))
";
        if !is_parent() {
            return Err(anyhow!("only the command `robogate` starts a sandbox"));
        }
        kernel::available()?;
        let SandboxFolders { read: named, write } = folders.resolved()?;
        let output = python.args(["-c", ABOUT]).stdin(Stdio::null()).output();
        let output = output.with_context(|| format!("cannot start {}", python.get_program().display()))?;
        let (executable, imports, graphics): (PathBuf, Vec<PathBuf>, BTreeMap<String, String>) =
            serde_json::from_slice(&output.stdout)
                .with_context(|| format!("{} does not tell its folders", python.get_program().display()))?;
        let mut own = Vec::new();
        if let Some((file, _)) = file_and_attribute(environment) {
            own.push(Path::new(file).parent().unwrap_or(Path::new("")).join("."));
        } else if environment.matches(':').count() > usize::from(environment.starts_with("gymnasium:"))
            && !BUNDLED.iter().any(|family| environment.split(':').next() == Some(family))
        {
            // A module of this name may be in the current folder.
            own.push(PathBuf::from("."));
        }
        own.extend(loads.map(LoadedPolicy::folders).unwrap_or_default());
        let folders = imports.into_iter().chain(own).filter_map(|folder| folder.canonicalize().ok());
        let mut read: Vec<PathBuf> = OF_THE_SYSTEM.iter().map(PathBuf::from).chain(folders).chain(named).collect();
        read.sort();
        read.dedup();
        let private = [std::env::var_os("HOME").map(PathBuf::from), origin::state_folder()];
        let private: Vec<PathBuf> = private.into_iter().flatten().filter_map(|path| path.canonicalize().ok()).collect();
        let closed = |folder: &&PathBuf| private.iter().any(|private| private.starts_with(folder));
        if let Some(folder) = read.iter().chain(&write).find(closed) {
            return Err(anyhow!(
                "--sandbox: the environment would have to read {}, which contains your home folder or your keys\n\
                 Hint: put the files of the environment into a folder of their own",
                folder.display()
            ));
        }
        Ok(Self { python: executable, read, write, graphics })
    }

    /// The command that runs in the sandbox, with its folder for temporary files.
    pub(crate) fn around(&self, command: &Command) -> io::Result<(Command, Scratch)> {
        let scratch = Scratch::below(&std::env::temp_dir())?;
        let rights = Rights {
            read: self.read.clone(),
            write: std::iter::once(&scratch.0).chain(&self.write).cloned().collect(),
        };
        let told = serde_json::to_string(&rights)?;
        let mut inside = this_program().map_err(io::Error::other)?;
        inside.arg(PYTHON).arg(&told).arg(&self.python).args(command.get_args());
        inside.env_clear().envs(&self.graphics);
        inside.envs(KEPT.iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
        inside.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
        inside.env(TOLD, told).env("PYTHONDONTWRITEBYTECODE", "1");
        inside.envs(["HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"].map(|name| (name, scratch.0.as_os_str())));
        inside.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Ok((inside, scratch))
    }
}

/// Restricts this process and turns it into Python. Returns only what went wrong.
pub(super) fn become_python(told: &OsStr, python: &OsString, arguments: &[OsString]) -> anyhow::Error {
    let rights = told.to_str().context("its rights are not UTF-8").and_then(|text| Ok(serde_json::from_str(text)?));
    let rights: Rights = match rights {
        Ok(rights) => rights,
        Err(why) => return why,
    };
    let mut command = Command::new(python);
    command.args(arguments);
    kernel::become_restricted(&rights, command)
}
