//! `robogate tasks`: checks and starts tasks from files.

use std::io::IsTerminal;
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
use robogate_dictionary::files;
use robogate_session::task_folder;
use robogate_tasks::file::{FILE, UNFINISHED, Wishes};
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
    /// Write a task from a MuJoCo scene, a URDF or a task file of LIBERO, and check it
    Import(Import),
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

/// Keeps the bodies as an MJCF file beside task.toml, without robot, cameras and pictures, and says what was left out. Exit code 2 if
/// the task has a problem, such as a goal that is not stated.
#[derive(Debug, Args)]
struct Import {
    /// Scene of MuJoCo (.xml, .mjcf), URDF (.urdf), or task file of LIBERO (.bddl) in LIBERO's folders
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Folder of the new task
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// State when the task is done: `joint(drawer) > 15 cm`. Without it, asks on a terminal
    #[arg(long, value_name = "CONDITION")]
    goal: Option<String>,
    /// State the task in natural language
    #[arg(long, value_name = "TEXT")]
    instruction: Option<String>,
    /// Place the origin of the file in the frame of the robot's base: `60, 0, 0 cm` [default: that of the robot in the scene, or 0]
    #[arg(long, value_name = "X, Y, Z UNIT")]
    at: Option<String>,
    /// Rotate the file by roll, pitch and yaw about the axes of the base: `0, 0, 180 deg`
    #[arg(long, value_name = "ROLL, PITCH, YAW UNIT")]
    rotation: Option<String>,
    /// Leave out bodies, by their names
    #[arg(long, value_name = "BODY", value_delimiter = ',')]
    drop: Vec<String>,
    /// Hold joints still, by their names
    #[arg(long, value_name = "JOINT", value_delimiter = ',')]
    weld: Vec<String>,
    /// Let bodies without joints move freely
    #[arg(long)]
    free: bool,
    /// Choose the robot of the check: a built-in one (see `robogate list robots`), or the folder of your own
    #[arg(long, value_name = "ROBOT", default_value = "franka")]
    robot: String,
}

impl Tasks {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Check(check) => check.execute(),
            What::Init(init) => init.execute(),
            What::Import(import) => import.execute(),
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

impl Import {
    fn execute(&self) -> Result<u8, Exit> {
        let task = self.out.join(FILE);
        if task.exists() {
            return Err(anyhow!("{} exists\nHint: name another folder", task.display())).or_usage();
        }
        let name = self.out.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut wishes = Wishes {
            name,
            goal: self.goal.clone(),
            instruction: self.instruction.clone(),
            at: self.at.clone(),
            rotation: self.rotation.clone(),
            drop: self.drop.clone(),
            weld: self.weld.clone(),
            free: self.free,
        };
        let mut imported = task_folder::import(&self.file, &wishes).or_usage()?;
        if imported.text.contains(UNFINISHED) && std::io::stdin().is_terminal() {
            imported.bodies.iter().for_each(note);
            note("when is the task done? For example: joint(drawer) > 15 cm. Empty: write it into task.toml later");
            let mut answer = String::new();
            std::io::stdin().read_line(&mut answer).context("cannot read the answer").or_broken()?;
            if !answer.trim().is_empty() {
                wishes.goal = Some(answer.trim().to_owned());
                imported = task_folder::import(&self.file, &wishes).or_usage()?;
            }
        }
        for (name, content) in imported.files.iter().chain([(&FILE.to_owned(), &imported.text.clone().into_bytes())]) {
            let file = self.out.join(name);
            files::create_folders(file.parent().unwrap_or(&self.out))
                .and_then(|()| files::write(&file, content))
                .with_context(|| format!("cannot write {}", file.display()))
                .or_broken()?;
        }
        line(format_args!("{}", bold(task.display())));
        imported.left_out.iter().for_each(|what| line(format_args!("left out of {what}")));
        Check { task: self.out.clone(), robot: self.robot.clone(), physics: false, json: false }.execute()
    }
}
