//! Child processes of this program for work with files of other authors, with limits of the operating system.
//!
//! A child is the program itself with a first argument that [`enter`] recognises. It sets its own limits
//! before it does anything else. A program that does not call [`enter`] has no children: its process does all
//! work itself.

#[cfg(target_os = "linux")]
mod kernel;
#[cfg(not(target_os = "linux"))]
#[path = "no_kernel.rs"]
mod kernel;
mod limits;
mod model;
mod sandbox;

use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;
use std::sync::OnceLock;

use limits::Limits;
#[cfg(feature = "mujoco")]
pub(crate) use limits::this_program;
pub(crate) use model::check_model;
pub use model::in_child;
pub use sandbox::SandboxFolders;
pub(crate) use sandbox::{Sandbox, Scratch, hint_for_refused};

/// First argument of a child that compiles a robot's model: the name of the engine and the robot's folder
/// follow.
const MODEL: &str = "child-model";
/// First argument of a child that runs a command under the limits of a model: the arguments of the command
/// follow.
const COMMAND: &str = "child-command";

/// First argument of a child that becomes Python in the sandbox: its rights, the interpreter and the
/// arguments follow.
const PYTHON: &str = "child-python";

/// Whether this process may start children, or is one.
static ROLE: OnceLock<Role> = OnceLock::new();

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Parent,
    Child,
}

/// What a process is to do.
#[derive(Debug)]
pub enum Entered {
    /// Parse these arguments, and run the command.
    Command(Vec<OsString>),
    /// End with this exit code: it was a child, and its work is done.
    Done(ExitCode),
}

/// Finds out what this process is, and does the work of a child. Call it first in `main`, with all arguments
/// of the process.
pub fn enter(mut arguments: Vec<OsString>) -> Entered {
    match &*arguments {
        [_, child, engine, folder] if child == MODEL => {
            become_child();
            Entered::Done(model::compile(engine, folder))
        }
        [_, child, ..] if child == COMMAND => {
            become_child();
            if let Err(why) = Limits::MODEL.set() {
                let _ = writeln!(std::io::stderr(), "error: {why:#}");
                return Entered::Done(ExitCode::FAILURE);
            }
            arguments.remove(1);
            Entered::Command(arguments)
        }
        [_, child, rights, python, arguments @ ..] if child == PYTHON => {
            let why = sandbox::become_python(rights, python, arguments);
            let _ = writeln!(std::io::stderr(), "error: the sandbox cannot start: {why:#}");
            Entered::Done(ExitCode::FAILURE)
        }
        _ => {
            let _ = ROLE.set(Role::Parent);
            Entered::Command(arguments)
        }
    }
}

/// Makes this process a child, which ends with its parent.
fn become_child() {
    let _ = ROLE.set(Role::Child);
    #[cfg(target_os = "linux")]
    // Without it, a parent that was killed leaves a child, which its limits end.
    let _ = nix::sys::prctl::set_pdeathsig(nix::sys::signal::Signal::SIGKILL);
}

/// Whether this process may start children.
fn is_parent() -> bool {
    ROLE.get() == Some(&Role::Parent)
}
