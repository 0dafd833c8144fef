//! `robogate import`: what another tool measured, as a dictionary.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};
use robogate_core::Word;
use robogate_dictionary::results::{Format, Mapping, import};

use crate::commands::export::not_there;
use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{foreign, grouped, note};

/// Read what another tool measured into Parquet.
///
/// LeRobot's eval_info.json, the aggregate JSON of vla-eval, the published JSON dictionaries, and tables of one row for
/// each episode: CSV, JSON Lines, Parquet, also those that `robogate export` wrote. In a table the columns success,
/// failure_mode, failure_type, cycle_time_s, error, seed, case, category and group are known by name; each other one is a
/// parameter, unless the mapping says more (`--map flag.jammed=jam_detected`). Any word can be a failure mode. Episodes
/// that ended in an error become invalid, not failures.
#[derive(Debug, Args)]
pub(crate) struct Import {
    /// The results
    results: PathBuf,
    /// The dictionary to write (Parquet)
    out: PathBuf,
    /// Their format; recognised by content where it is not given
    #[arg(long)]
    format: Option<Layout>,
    /// Which column is what, as TOML: success = "ok", and the tables parameters, flags, failure_modes, about
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Which column is what: success=ok,cycle_time_s=duration,parameter.mass_kg=mass
    #[arg(long, value_name = "KEY=COLUMN,...")]
    map: Vec<String>,
    /// The task's name
    #[arg(long)]
    task: Option<String>,
    /// The policy that was judged
    #[arg(long)]
    policy: Option<String>,
    /// The robot
    #[arg(long)]
    robot: Option<String>,
    /// The simulator, or `real`
    #[arg(long)]
    simulator: Option<String>,
}

/// A format of results.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Layout {
    /// The JSON released with the paper
    Published,
    /// eval_info.json
    Lerobot,
    /// The aggregate JSON
    VlaEval,
    /// Comma, semicolon or tab separated values with a header
    Csv,
    /// One JSON object on each line
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
            Layout::Csv => Self::Csv,
            Layout::Jsonl => Self::JsonLines,
            Layout::Parquet => Self::Parquet,
        }
    }
}

impl Import {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        not_there(&self.out)?;
        let mapping = self.mapping()?;
        let imported = import(&self.results, &self.out, self.format.map(Format::from), &mapping).or_usage()?;
        let source = imported.provenance.source.iter();
        let format = source.clone().map(|source| source.format.as_str()).next().unwrap_or_default();
        note(format_args!("{}: {} rows from {format}", foreign(self.out.display()), grouped(imported.written.rows)));
        source.clone().flat_map(|source| &source.notes).for_each(|remark| note(format_args!("  {}", foreign(remark))));
        for what in source.flat_map(|source| &source.not_recorded) {
            note(format_args!("  no rate can be claimed of {what}: the source does not record it"));
        }
        Ok(DONE)
    }

    fn mapping(&self) -> Result<Mapping, Exit> {
        let mut mapping = match &self.mapping {
            None => Mapping::default(),
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("cannot read the mapping {}", path.display()))
                    .or_usage()?;
                Mapping::from_toml(&text, &path.display().to_string()).or_usage()?
            }
        };
        for pairs in &self.map {
            mapping.add(pairs, "--map").or_usage()?;
        }
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
        Ok(mapping)
    }
}
