//! The Python interpreter of an environment.

use std::ffi::{OsStr, OsString};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow};
use robogate_remote::Timeouts;
use serde::de::DeserializeOwned;

use super::package;
use super::process::{NoAnswer, Process};
use crate::failure::{Failure, OrFailure};
use crate::isolation::{Sandbox, SandboxFolders, hint_for_refused};
use crate::loaded_policy::LoadedPolicy;

/// Exit code of `python -m robogate_eval.environments` for an error that the user can correct.
const PYTHON_USAGE: i32 = 2;

/// The cache folder: `ROBOGATE_CACHE_DIR`, else `$XDG_CACHE_HOME/robogate`, else `~/.cache/robogate`.
pub(crate) fn cache() -> anyhow::Result<PathBuf> {
    let path = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    path("ROBOGATE_CACHE_DIR")
        .or_else(|| Some(path("XDG_CACHE_HOME")?.join("robogate")))
        .or_else(|| Some(path("HOME")?.join(".cache/robogate")))
        .ok_or_else(|| anyhow!("no cache folder\nHint: set ROBOGATE_CACHE_DIR or HOME to an absolute path"))
}

/// The family of a bundled environment: the part of its name before the colon.
fn family(name: &str) -> &str {
    name.split(':').next().unwrap_or(name)
}

/// The folder of the Python environment that `robogate env setup` creates for a family.
pub fn installed(family: &str) -> anyhow::Result<PathBuf> {
    Ok(cache()?.join("environments").join(family))
}

/// The file that `robogate env setup` writes last. It contains the requirements.
pub fn installed_marker(folder: &Path) -> PathBuf {
    folder.join("installed.txt")
}

/// A Python interpreter that can import the embedded package.
#[derive(Debug, Clone)]
pub struct Interpreter {
    python: PathBuf,
    python_path: OsString,
    /// The folder of the embedded package.
    package: PathBuf,
    /// The sandbox of its processes, if they run in one.
    sandbox: Option<Sandbox>,
}

impl Interpreter {
    /// The interpreter that the user named, or that of `robogate env setup` for the family of the environment, or the
    /// active one.
    pub fn choose(named: Option<&Path>, environment: &str) -> anyhow::Result<Self> {
        let family = family(environment);
        let plain = !family.is_empty() && family.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        let set_up =
            if plain { Some(installed(family)?).filter(|folder| installed_marker(folder).is_file()) } else { None };
        let python = match (named, set_up) {
            (Some(named), _) => named.to_owned(),
            (None, Some(folder)) => folder.join("bin/python"),
            (None, None) => PathBuf::from("python3"),
        };
        Self::new(python)
    }

    /// This interpreter.
    pub fn new(python: PathBuf) -> anyhow::Result<Self> {
        let package =
            cache().and_then(|cache| Ok(package::unpack(&cache)?)).context("cannot unpack the Python package")?;
        // A package that the user put there comes first: a checkout that is being edited, for example.
        let before = std::env::var_os("PYTHONPATH").unwrap_or_default();
        let folders =
            std::env::split_paths(&before).filter(|folder| !folder.as_os_str().is_empty()).chain([package.clone()]);
        Ok(Self { python, python_path: std::env::join_paths(folders).context("PYTHONPATH")?, package, sandbox: None })
    }

    /// The same interpreter, whose processes run this environment and policy in a sandbox.
    pub fn sandboxed(
        mut self,
        environment: &str,
        loads: Option<&LoadedPolicy>,
        folders: &SandboxFolders,
    ) -> anyhow::Result<Self> {
        let mut python = Command::new(&self.python);
        python.env("PYTHONPATH", &self.python_path);
        self.sandbox = Some(Sandbox::of(environment, loads, folders, &mut python)?);
        Ok(self)
    }

    /// Starts the command `python -m robogate_eval.environments VERB ARGUMENTS`, as the process with this number. Python's hashes of texts
    /// have a seed of their own in each process, so the check of repeated episodes always finds an environment that depends on them, for
    /// example by the order of a set.
    pub(crate) fn start(&self, verb: &str, arguments: &[impl AsRef<OsStr>], number: usize) -> io::Result<Process> {
        let mut command = self.command(verb);
        command.args(arguments);
        if std::env::var_os("PYTHONHASHSEED").is_none() {
            command.env("PYTHONHASHSEED", number.to_string());
        }
        let Some(sandbox) = &self.sandbox else { return Ok(Process::new(command.spawn()?, None)) };
        let (mut inside, scratch) = sandbox.around(&command)?;
        Ok(Process::new(inside.spawn()?, Some(scratch)))
    }

    /// The path of the interpreter.
    pub fn path(&self) -> &Path {
        &self.python
    }

    /// The command `python -m robogate_eval.environments VERB` with pipes for its input and output.
    pub fn command(&self, verb: &str) -> Command {
        let mut command = self.module("robogate_eval.environments");
        command.arg(verb);
        command
    }

    /// The command `python -m MODULE` with pipes for its input and output. Modules in the current folder are not imported: another
    /// user's folder may contain a `numpy.py`.
    pub(crate) fn module(&self, module: &str) -> Command {
        /// Python's option -P, which versions before 3.11 do not have.
        const RUN: &str = "import sys; sys.path[:] = [path for path in sys.path if path]; import runpy; \
                           runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)";
        let mut command = Command::new(&self.python);
        command.args(["-u", "-c", RUN, module]).env("PYTHONPATH", &self.python_path);
        command.env("ROBOGATE_EMBEDDED_PACKAGE", &self.package);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // There is a server for each worker. Threads of NumPy's libraries would only compete with the other servers.
        for name in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"] {
            if std::env::var_os(name).is_none() {
                command.env(name, "1");
            }
        }
        command
    }

    /// Runs a verb that prints one JSON document.
    pub fn ask<T: DeserializeOwned>(&self, verb: &str, arguments: &[&str]) -> Result<T, Failure> {
        self.ask_within(verb, arguments, &Timeouts::default())
    }

    /// The same with these timeouts. An environment that hangs is ended.
    pub fn ask_within<T: DeserializeOwned>(
        &self,
        verb: &str,
        arguments: &[&str],
        timeouts: &Timeouts,
    ) -> Result<T, Failure> {
        let mut process = self.start(verb, arguments, 0).map_err(|why| self.unusable(&why)).or_request()?;
        let what = arguments.first().unwrap_or(&verb);
        let line = process.answer(what, timeouts).map_err(|why| {
            let how = match (&why.late, why.status) {
                (Some(late), _) => late.clone(),
                (None, Some(status)) => status.to_string(),
                (None, None) => "no answer".to_owned(),
            };
            let output = readable(&why.output);
            let output = if output.is_empty() { "It printed nothing.".to_owned() } else { output };
            why.failure(format!("{what} fails in {}: {how}\n{output}", self.python.display()))
        })?;
        let parsed = serde_json::from_str(&line);
        parsed.with_context(|| format!("{}: cannot read the answer to `{verb}`", self.python.display())).or_broken()
    }

    /// The error for an interpreter that cannot be started.
    pub fn unusable(&self, why: &std::io::Error) -> anyhow::Error {
        anyhow!("--python {}: cannot be started: {why}\nHint: name a Python 3.10 or newer", self.python.display())
    }
}

impl NoAnswer {
    /// The error with this message, unless the process reported an error that the user can correct.
    pub(crate) fn failure(&self, message: String) -> Failure {
        let own = self.output.contains("error: ");
        match self.status.and_then(|status| status.code()) {
            Some(PYTHON_USAGE) if own => Failure::broken_if(false, anyhow!(readable(&self.output))),
            code => Failure::broken_if(code != Some(PYTHON_USAGE), anyhow!(message)),
        }
    }
}

/// The message of a Python process for the user: its own error if it reported one, with what the sandbox refused,
/// otherwise all of its output.
pub(crate) fn readable(output: &str) -> String {
    match output.rfind("error: ").filter(|at| *at == 0 || output.as_bytes().get(at - 1) == Some(&b'\n')) {
        Some(at) => {
            let (before, own) = output.split_at(at);
            let refused = before.lines().filter(|line| line.starts_with("sandbox: "));
            let own = own.trim_start_matches("error: ").trim_end();
            let hint = hint_for_refused(before);
            std::iter::once(own).chain(refused).chain(hint).collect::<Vec<_>>().join("\n")
        }
        None => std::iter::once(output.trim_end()).chain(hint_for_refused(output)).collect::<Vec<_>>().join("\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn family_is_before_the_colon() {
        assert_eq!(family("metaworld:push-v3"), "metaworld");
        assert_eq!(family("mine.py:make"), "mine.py");
    }

    #[test]
    fn own_error_is_shown_alone() {
        assert_eq!(readable("warning: old\nerror: no such task\nHint: another\n"), "no such task\nHint: another");
        assert_eq!(readable("sandbox: refused to x\nlow\nerror: no"), "no\nsandbox: refused to x");
        let refused = readable("sandbox: refused to read /data/x\nTraceback");
        assert!(refused.starts_with("sandbox: ") && refused.contains("\nHint: --sandbox-read FOLDER"), "{refused}");
        assert_eq!(readable("Traceback:\nValueError: error: x\n"), "Traceback:\nValueError: error: x");
    }
}
