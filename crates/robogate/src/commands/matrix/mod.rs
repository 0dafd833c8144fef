//! `robogate matrix`: runs policies x tasks x robots x engines, and ranks the policies.
//!
//! ```text
//! DIR/sweep.json          the runs with their options; written first, never changed
//! DIR/RUN/                one folder for each run, as `robogate run` writes it
//! DIR/leaderboard.html    the ranking, with a section for each set of scenarios
//! ```

mod board;
mod run;
mod sweep;

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::budget::Budget;
use robogate_dictionary::{files, read_text};

use crate::commands::run::free_folder;
use crate::exit::{Exit, OrExit};
use crate::number;
use crate::place;
use crate::terminal::{grouped, line, note};
use sweep::{Sweep, SweepPlan, VERSION};

pub(crate) use board::merge;
pub(crate) use run::{CHILD, end_with_parent, next, status};

/// The plan of a sweep in its folder.
const PLAN: &str = "sweep.json";

/// Run policies x tasks x robots x engines as one resumable plan, and rank the policies on one page.
///
/// The same command continues an interrupted sweep. With --divide, any scheduler can run it: `robogate plan DIR --next`
/// prints the next shards of all runs, and `robogate merge DIR` writes the page.
#[derive(Debug, Args)]
pub(crate) struct Matrix {
    /// File of the sweep (docs/guides/sweeps.md)
    sweep: PathBuf,
    /// Write the runs to this folder; default: runs/NAME
    #[arg(long, value_name = "DIR", value_parser = place::local())]
    out: Option<PathBuf>,
    /// Set the number of threads of each run; default: one for each core
    #[arg(long, value_name = "T", value_parser = number::threads)]
    threads: Option<NonZeroUsize>,
    /// Divide each run into N shards, and run nothing
    #[arg(long, value_name = "N", requires = "out")]
    divide: Option<u32>,
    /// Print the runs and their options, and run nothing
    #[arg(long, conflicts_with = "divide")]
    list: bool,
    /// Print the result as one JSON document
    #[arg(long)]
    json: bool,
}

impl Matrix {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let plan = self.plan().with_context(|| self.sweep.display().to_string()).or_usage()?;
        if self.list {
            for run in &plan.runs {
                line(format_args!("{:<40} robogate run {}", run.name, run.arguments().join(" ")));
            }
            return Ok(crate::exit::DONE);
        }
        let dir = match &self.out {
            Some(dir) => dir.clone(),
            None => self.default_folder(&plan),
        };
        begin(&dir, &plan)?;
        note(format_args!("{}: {} runs, into {}", plan.name, grouped(plan.runs.len() as u64), dir.display()));
        if self.divide.is_some() {
            return run::divide(&dir, &plan, self.json);
        }
        let failed = match run::all(&dir, &plan, self.threads)? {
            Ok(failed) => failed,
            Err(code) => return Ok(code),
        };
        board::write(&dir, &plan, &failed, self.json)
    }

    fn plan(&self) -> anyhow::Result<SweepPlan> {
        let text = read_text(&self.sweep).context("cannot read the file of the sweep")?;
        let base = self.sweep.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Sweep::parse(&text)?.plan(base, self.divide)
    }

    /// The folder of the same sweep under `runs/`, or a new one.
    fn default_folder(&self, plan: &SweepPlan) -> PathBuf {
        let name = self.sweep.file_stem().map_or_else(|| "sweep".into(), |name| name.to_string_lossy());
        let usual = Path::new("runs").join(&*name);
        if matches!(open(&usual), Ok(Some(there)) if there == *plan) { usual } else { free_folder(&name) }
    }
}

/// Writes the plan of a sweep, or checks that it is that of the folder.
fn begin(dir: &Path, plan: &SweepPlan) -> Result<(), Exit> {
    match open(dir)? {
        Some(there) if there == *plan => Ok(()),
        Some(_) => Err(anyhow!(
            "{} contains another sweep, or the file of the sweep was changed\nHint: choose another folder with --out",
            dir.display()
        ))
        .or_usage(),
        None => {
            // A process that was killed while it wrote the plan has left it under this name.
            let entries = fs::read_dir(dir).into_iter().flatten().filter_map(Result::ok);
            if let Some(name) =
                entries.map(|entry| entry.file_name()).find(|name| !files::is_partial(&name.to_string_lossy(), PLAN))
            {
                return Err(anyhow!(
                    "{} is not empty (it contains `{}`) and is not a sweep\nHint: choose an empty or new folder",
                    dir.display(),
                    name.display()
                ))
                .or_usage();
            }
            let text = serde_json::to_string_pretty(plan).or_broken()? + "\n";
            files::create_folders(dir).with_context(|| format!("cannot create {}", dir.display())).or_broken()?;
            files::write(dir.join(PLAN), text)
                .with_context(|| format!("cannot write {}", dir.join(PLAN).display()))
                .or_broken()
        }
    }
}

/// The plan of the sweep in `dir`. `None` if it contains none.
pub(crate) fn open(dir: &Path) -> Result<Option<SweepPlan>, Exit> {
    let path = dir.join(PLAN);
    if !path.is_file() {
        return Ok(None);
    }
    let text = read_text(&path).with_context(|| format!("cannot read {}", path.display())).or_broken()?;
    let plan: SweepPlan = Budget::FILE
        .json(text.as_bytes())
        .with_context(|| format!("{}: not the plan of a sweep", path.display()))
        .or_usage()?;
    if plan.version != VERSION {
        return Err(anyhow!("{} has version {}, expected {VERSION}", path.display(), plan.version)).or_usage();
    }
    Ok(Some(plan))
}
