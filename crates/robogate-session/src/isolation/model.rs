//! Compiles models of robots of other authors in a child first.
//!
//! MuJoCo parses a model in C++: a damaged or hostile one can end the process, or use all of its memory and
//! time. The child does the same work on the same files before this process does, so what would happen here
//! happens there.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread;

use anyhow::{Context, anyhow};
use robogate_physics::{Problem, Robot, RobotError, RobotSource};
use robogate_tasks::pick_place::PickPlace;
use robogate_tasks::{ArmTask, Rig};
use serde::{Deserialize, Serialize};

use super::limits::{Limits, this_program, wait};
use super::{COMMAND, MODEL, is_parent};
use crate::cell::{identity, nominal};
use crate::failure::{Failure, OrFailure};
use crate::registry::EngineEntry;
use crate::text::foreign;

/// Longest report of a child, in bytes.
const LONGEST_ANSWER: u64 = 1 << 20;

/// Compiles the robot's model with this engine in a child, once for the same files. A built-in robot needs
/// none.
///
/// # Errors
/// The model cannot be compiled, or the child crashed or reached a limit.
pub(crate) fn check_model(robot: &Robot, engine: &EngineEntry) -> anyhow::Result<()> {
    /// The robots that passed.
    static PASSED: Mutex<BTreeSet<(String, &str)>> = Mutex::new(BTreeSet::new());
    let RobotSource::Folder(folder) = &robot.source else { return Ok(()) };
    if !is_parent() {
        return Ok(());
    }
    let files = (identity(&robot.files()?), engine.name);
    if PASSED.lock().unwrap_or_else(PoisonError::into_inner).contains(&files) {
        return Ok(());
    }
    let mut command = this_program()?;
    command.arg(MODEL).arg(engine.name).arg(folder).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn().context("cannot start a process that compiles the robot's model")?;
    let answer = child.stdout.take().map(|stream| {
        thread::spawn(move || {
            let mut answer = Vec::new();
            stream.take(LONGEST_ANSWER).read_to_end(&mut answer).map(|_| answer)
        })
    });
    let status = wait(&mut child, Limits::MODEL.wall).context("cannot wait for the process that compiles the model")?;
    let answer = answer.and_then(|thread| thread.join().ok()?.ok()).unwrap_or_default();
    if !status.is_some_and(|status| status.success()) {
        return Err(unusable(&folder.join(&robot.settings.model), status));
    }
    let answer =
        serde_json::from_slice(&answer).context("cannot read what the process that compiles the model reports")?;
    match answer {
        Answer::Compiles => {}
        Answer::Problems { path, problems } => return Err(RobotError::Invalid { path, problems }.into()),
        Answer::Engine(why) => return Err(RobotError::Engine { why }.into()),
    }
    PASSED.lock().unwrap_or_else(PoisonError::into_inner).insert(files);
    Ok(())
}

/// What a child reports.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Answer {
    Compiles,
    Problems { path: PathBuf, problems: Vec<Problem> },
    Engine(String),
}

/// The child: compiles the model with the engine of this name, alone and in a scene.
pub(super) fn compile(engine: &OsString, folder: &OsString) -> ExitCode {
    let Some(entry) = engine.to_str().and_then(|name| EngineEntry::find(name).ok()) else { return ExitCode::FAILURE };
    if Limits::MODEL.set().is_err() {
        return ExitCode::FAILURE;
    }
    let made = Robot::from_folder(Path::new(folder)).and_then(|robot| (entry.engine)(robot, entry.time_step_s));
    let answer = match made {
        Ok(engine) => {
            if let Ok(mut environment) = PickPlace::DEFAULT.environment(engine, Rig::default()) {
                // A robot that does not fit into this scene may fit into that of another task.
                let _ = environment.reset(&nominal());
            }
            Answer::Compiles
        }
        Err(RobotError::Invalid { path, problems }) => Answer::Problems { path, problems },
        Err(other) => Answer::Engine(other.to_string()),
    };
    match serde_json::to_writer(std::io::stdout(), &answer) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}

/// Runs the command of this process again in a child under the limits, because it compiles this model, and
/// returns its exit code. `None` in the child itself, which does the work.
///
/// # Errors
/// The child crashed, or reached a limit.
pub fn in_child(model: &Path) -> Result<Option<u8>, Failure> {
    if !is_parent() {
        return Ok(None);
    }
    let mut command = this_program().or_broken()?;
    command.arg(COMMAND).args(std::env::args_os().skip(1));
    let mut child = command.spawn().context("cannot start a process that reads the robot's model").or_broken()?;
    let status = wait(&mut child, Limits::MODEL.wall).or_broken()?;
    // MuJoCo ends a process with 1 after an error that it cannot report. The command does not, when it reads
    // a model.
    let code = status.and_then(|status| status.code()).filter(|code| *code != 1);
    match code.and_then(|code| u8::try_from(code).ok()) {
        Some(code) => Ok(Some(code)),
        None => Err(unusable(model, status)).or_request(),
    }
}

/// The error of a model that ended the child.
fn unusable(model: &Path, status: Option<ExitStatus>) -> anyhow::Error {
    let Limits { memory_bytes, processor_s, wall, .. } = Limits::MODEL;
    let how = match status {
        None => format!("did not end within {} s", wall.as_secs()),
        Some(status) => format!("ended with {status}"),
    };
    anyhow!(
        "{}: the process that compiled this model {how}. It may use {} GiB of memory and {processor_s} s of a processor\n\
         Hint: the model is damaged, or too large to be simulated. Reduce its meshes, textures and sizes",
        foreign(model.display()),
        memory_bytes >> 30
    )
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn crashes_name_the_model() {
        let crashed = std::process::Command::new("sh").args(["-c", "kill -SEGV $$"]).status().unwrap();
        let model = Path::new("arm/model.xml");
        let text = unusable(model, Some(crashed)).to_string();
        assert!(
            text.starts_with("arm/model.xml: the process that compiled this model ended with signal: 11"),
            "{text}"
        );
        assert!(unusable(model, None).to_string().contains("did not end within 300 s"));
    }
}
