//! `robogate tasks`: checks and starts tasks from files.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
use robogate_dictionary::files;
use robogate_session::task_folder;
use robogate_tasks::file::FILE;
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{bold, line, note};

/// Check a task of your own from a file, or start one from an example.
#[derive(Debug, Args)]
pub(crate) struct Tasks {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check a task: report every problem of its file, its start and its expert
    Check(Check),
    /// Write an example of a task, with comments: a drawer
    Init(Init),
}

/// Reads the file, looks for conditions that can never change, and runs the nominal scenario with a policy that does nothing and
/// with the expert. Exit code 2 if there is a problem.
#[derive(Debug, Args)]
struct Check {
    /// Folder of the task (task.toml)
    #[arg(value_name = "TASK")]
    task: PathBuf,
    /// Choose the robot: a built-in one (see `robogate list robots`), or the folder of your own
    #[arg(long, value_name = "ROBOT", default_value = "franka")]
    robot: String,
    /// Set every parameter to both ends of its range and read it back, run 20 episodes of the expert, and let the idle policy run
    /// to the time limit
    #[arg(long)]
    physics: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Writes task.toml into the folder. Edit it, and check it with `robogate tasks check FOLDER`.
#[derive(Debug, Args)]
struct Init {
    /// Folder of the new task
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
}

impl Tasks {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Check(check) => check.execute(),
            What::Init(init) => init.execute(),
        }
    }
}

impl Check {
    fn execute(&self) -> Result<u8, Exit> {
        let checked = task_folder::check(&self.task, &self.robot, self.physics)?;
        if self.json {
            line(json!({"version": 1, "problems": checked.problems, "figures": checked.figures}));
        } else {
            checked.figures.iter().for_each(line);
        }
        if !checked.problems.is_empty() {
            let file = self.task.join(FILE);
            return Err(anyhow!("{}\n{}", file.display(), checked.problems.join("\n"))).or_usage();
        }
        if !self.json {
            line(format_args!("{}: no problem found with {}", bold(self.task.display()), self.robot));
        }
        Ok(DONE)
    }
}

impl Init {
    fn execute(&self) -> Result<u8, Exit> {
        let file = self.folder.join(FILE);
        files::create_folders(&self.folder)
            .with_context(|| format!("cannot create {}", self.folder.display()))
            .or_usage()?;
        if file.exists() {
            return Err(anyhow!("{} exists\nHint: name another folder", file.display())).or_usage();
        }
        files::write(&file, task_folder::EXAMPLE)
            .with_context(|| format!("cannot write {}", file.display()))
            .or_broken()?;
        line(format_args!("{}", bold(file.display())));
        note(format_args!("next: robogate tasks check {}", self.folder.display()));
        Ok(DONE)
    }
}
