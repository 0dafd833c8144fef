//! `robogate import`: converts the results of another tool to a dictionary.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};
use robogate_core::Word;
use robogate_dictionary::results::{Format, Mapping, import, policies};
use robogate_dictionary::{RowSampling, Stopping, read_text};

use crate::commands::export::require_absent;
use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::place;
use crate::terminal::{foreign, grouped, note};

/// Import the results of another tool as a dictionary (Parquet).
///
/// Reads LeRobot's eval_info.json and its datasets (a folder), the aggregate JSON of vla-eval, logs of Inspect Robots, the published JSON dictionaries, and tables with one
/// row per episode: CSV, JSON Lines or Parquet, including those of `robogate export`. The table columns success,
/// failure_mode, failure_type, cycle_time_s, error, seed, case, category, group and policy are recognised by name, in any
/// spelling. Rows of several policies become one dictionary for each, OUT-POLICY.parquet. Columns whose name says reward, return, length or time are measures, and identifiers are not used. Every
/// other column is a parameter, unless the mapping assigns it another role (`--map flag.jammed=jam_detected`). The
/// command prints the role of each column. Every word is accepted as a failure mode. Episodes that ended with an error
/// become invalid episodes, not failures.
#[derive(Debug, Args)]
pub(crate) struct Import {
    /// File with the results, or the folder of a LeRobot dataset
    results: PathBuf,
    /// Dictionary to write (Parquet)
    #[arg(value_parser = place::local())]
    out: PathBuf,
    /// Set the format of the results; default: detected from their content
    #[arg(long)]
    format: Option<Layout>,
    /// Read the roles of the columns from this TOML file: success = "ok", and the tables parameters, flags,
    /// failure_modes, about
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Set roles of columns: success=ok,cycle_time_s=duration,parameter.mass_kg=mass
    #[arg(long, value_name = "KEY=COLUMN,...")]
    map: Vec<String>,
    /// Set the name of the task
    #[arg(long)]
    task: Option<String>,
    /// Set the name of the policy; if a column names several policies, import the rows of this one
    #[arg(long)]
    policy: Option<String>,
    /// Set the name of the robot
    #[arg(long)]
    robot: Option<String>,
    /// Set the name of the simulator, or `real`
    #[arg(long)]
    simulator: Option<String>,
    /// State how the scenarios were chosen; default: unknown, and nothing is claimed about it
    #[arg(long)]
    sampling: Option<Sampled>,
    /// State how the number of episodes was chosen; default: unknown, and the gate uses a test that is valid for both
    #[arg(long)]
    stopping: Option<Stopped>,
}

/// How the scenarios were chosen.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Sampled {
    /// Each parameter independently and uniformly over its range
    Uniform,
    /// As they occurred; parameters may be correlated
    Observed,
}

/// How the number of episodes was chosen.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Stopped {
    /// Before the first episode
    Fixed,
    /// While results came in
    Monitored,
}

/// The format of the results.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum Layout {
    /// The JSON dictionary released with the paper
    Published,
    /// eval_info.json of LeRobot
    Lerobot,
    /// The aggregate JSON of vla-eval
    VlaEval,
    /// The evaluation log of Inspect Robots
    InspectRobots,
    /// The folder of a LeRobot dataset with the feature next.success
    LerobotDataset,
    /// Values separated by commas, semicolons or tabs, with a header
    Csv,
    /// One JSON object per line
    Jsonl,
    /// A flat Parquet file
    Parquet,
}

impl From<Layout> for Format {
    fn from(layout: Layout) -> Self {
        match layout {
            Layout::Published => Self::Published,
            Layout::Lerobot => Self::LeRobot,
            Layout::VlaEval => Self::VlaEval,
            Layout::InspectRobots => Self::InspectRobots,
            Layout::LerobotDataset => Self::LeRobotDataset,
            Layout::Csv => Self::Csv,
            Layout::Jsonl => Self::JsonLines,
            Layout::Parquet => Self::Parquet,
        }
    }
}

impl Import {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mapping = self.mapping()?;
        let format = self.format.map(Format::from);
        let found = policies(&self.results, format, &mapping).or_usage()?;
        if self.policy.is_some() || found.len() < 2 {
            return self.import_one(&self.out, &mapping);
        }
        note(format_args!("{} policies, one dictionary for each", found.len()));
        let of_each: Vec<(PathBuf, String)> = found.into_iter().map(|name| (beside(&self.out, &name), name)).collect();
        if let Some(at) = (1..of_each.len()).find(|at| of_each[..*at].iter().any(|(path, _)| *path == of_each[*at].0)) {
            let error = anyhow!(
                "the policies give the same file name {}\nHint: import them one by one with --policy NAME",
                of_each[at].0.display()
            );
            return Err(Exit { code: USAGE, error });
        }
        of_each.iter().try_for_each(|(path, _)| require_absent(path))?;
        for (path, name) in of_each {
            let mut mapping = mapping.clone();
            mapping.about.policy = Some(name);
            self.import_one(&path, &mapping)?;
        }
        Ok(DONE)
    }

    fn import_one(&self, out: &Path, mapping: &Mapping) -> Result<u8, Exit> {
        require_absent(out)?;
        let imported = import(&self.results, out, self.format.map(Format::from), mapping).or_usage()?;
        let source = imported.provenance.source.iter();
        let format = source.clone().map(|source| source.format.as_str()).next().unwrap_or_default();
        note(format_args!("{}: {} rows from {format}", foreign(out.display()), grouped(imported.written.rows)));
        source.clone().flat_map(|source| &source.notes).for_each(|remark| note(format_args!("  {}", foreign(remark))));
        for column in source.clone().flat_map(|source| &source.columns) {
            let values = if column.values < imported.written.rows {
                format!(" ({} of {} rows)", grouped(column.values), grouped(imported.written.rows))
            } else {
                String::new()
            };
            note(format_args!("  column {}: {}{values}", foreign(&column.column), foreign(&column.role)));
        }
        for what in source.flat_map(|source| &source.not_recorded) {
            note(format_args!("  {what}: not recorded by the source, so it has no rate"));
        }
        Ok(DONE)
    }

    fn mapping(&self) -> Result<Mapping, Exit> {
        let mut mapping = open_mapping(self.mapping.as_deref(), &self.map)?;
        if let Some(task) = &self.task {
            mapping.about.task = Some(Word::new(task).context("--task").or_usage()?);
        }
        for (given, place) in [
            (&self.policy, &mut mapping.about.policy),
            (&self.robot, &mut mapping.about.robot),
            (&self.simulator, &mut mapping.about.simulator),
        ] {
            if given.is_some() {
                place.clone_from(given);
            }
        }
        if let Some(sampling) = self.sampling {
            mapping.about.sampling = Some(match sampling {
                Sampled::Uniform => RowSampling::Uniform,
                Sampled::Observed => RowSampling::Observed,
            });
        }
        if let Some(stopping) = self.stopping {
            mapping.about.stopping = Some(match stopping {
                Stopped::Fixed => Stopping::Fixed,
                Stopped::Monitored => Stopping::Monitored,
            });
        }
        Ok(mapping)
    }
}

/// The dictionary of one of several policies, beside `out`.
fn beside(out: &Path, policy: &str) -> PathBuf {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let policy: String = policy.chars().map(plain).collect();
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let ending = out.extension().map_or_else(String::new, |ending| format!(".{}", ending.to_string_lossy()));
    out.with_file_name(format!("{stem}-{policy}{ending}"))
}

/// The mapping of a file, completed with pairs of the command line.
pub(crate) fn open_mapping(file: Option<&Path>, pairs: &[String]) -> Result<Mapping, Exit> {
    let mut mapping = match file {
        None => Mapping::default(),
        Some(path) => {
            let text =
                read_text(path).with_context(|| format!("cannot read the mapping {}", path.display())).or_usage()?;
            Mapping::from_toml(&text, &path.display().to_string()).or_usage()?
        }
    };
    for pairs in pairs {
        mapping.add(pairs, "--map").or_usage()?;
    }
    Ok(mapping)
}
