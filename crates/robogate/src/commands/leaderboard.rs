//! `robogate leaderboard`: ranks policies.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use robogate_core::TaskSpec;
use robogate_dictionary::files;
use robogate_gate::{Asked, Baseline, Leaderboard, Record, Requirements, Sampling};
use robogate_report::{leaderboard_html, leaderboard_markdown, leaderboard_text};

use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{foreign, line, note, print_report};
use robogate_session::{built_in_baseline, open_source, record_of};

/// Rank policies that ran the same scenarios, by the paper's confidence score.
#[derive(Debug, Args)]
pub(crate) struct Rank {
    /// Folders or dictionaries of runs; NAME=PATH sets the displayed name
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<String>,
    /// Choose the requirements that define the score: a built-in set or a TOML file; default: paper for pick_place,
    /// otherwise default
    #[arg(long, value_name = "NAME|FILE")]
    requirements: Option<String>,
    /// Compare the score with this baseline; default: the built-in one of the suite and the robot
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Write a document instead of the terminal table
    #[arg(long, value_name = "FORMAT")]
    format: Option<Form>,
    /// Write it to this file; default: stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long, conflicts_with = "format")]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Form {
    /// One self-contained file
    Html,
    /// A Markdown table for a page or a pull request
    Md,
    /// One versioned JSON document
    Json,
}

impl Rank {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let mut entries: Vec<(String, Record, Sampling)> = Vec::new();
        for run in &self.runs {
            let (name, path) = named(run);
            let source = open_source(&path)?;
            let record = record_of(&source).or_broken()?;
            if let Some(at) = entries.iter().position(|(_, other, _)| other.dataset_sha256 == record.dataset_sha256) {
                let first = foreign(&self.runs[at]);
                let why = anyhow::anyhow!("{first} and {} have the same rows\nHint: remove one of them", foreign(run));
                return Err(why).or_usage();
            }
            // A gate that tests after each round may have stopped at any of them.
            let asked = source.folder().map_or(Ok(None), Asked::of)?;
            let is_gate = source.dictionary().provenance().question_sha256.is_some();
            let unknown = if is_gate { Sampling::Sequential } else { Sampling::Fixed };
            entries.push((name, record, asked.map_or(unknown, |asked| asked.sampling)));
        }
        let first =
            entries.first().ok_or_else(|| anyhow::anyhow!("a leaderboard needs at least one run")).or_usage()?;
        let requirements = self.requirements_for(&first.1.task)?;
        let baseline = match (&self.baseline, entries.first()) {
            (Some(file), _) => Some(Baseline::open(file).or_usage()?),
            (None, Some((_, first, _))) => built_in_baseline(first),
            (None, None) => None,
        };
        let board = Leaderboard::of(&entries, &requirements.score, baseline.as_ref()).or_usage()?;
        let form = if self.json { Some(Form::Json) } else { self.format };
        let text = match form {
            Some(Form::Html) => Some(leaderboard_html(&board)),
            Some(Form::Md) => Some(leaderboard_markdown(&board)),
            Some(Form::Json) => Some(board.to_json()),
            None => None,
        };
        match (text, &self.out) {
            (Some(text), Some(out)) => {
                files::write(out, text).with_context(|| format!("cannot write {}", out.display())).or_broken()?;
                note(format_args!("{}: {} policies", out.display(), board.standings.len()));
            }
            (Some(text), None) => line(text.trim_end()),
            (None, Some(_)) => {
                return Err(anyhow::anyhow!("--out needs --format: html, md or json")).or_usage();
            }
            (None, None) => print_report(&leaderboard_text(&board)),
        }
        Ok(if board.standings.iter().any(|s| s.valid > 0) { DONE } else { INVALID })
    }

    fn requirements_for(&self, task: &TaskSpec) -> Result<Requirements, Exit> {
        if let Some(name) = &self.requirements {
            return Ok(Requirements::open(name, task)?);
        }
        let paper = Requirements::open("paper", task)?;
        match paper.task.as_deref().is_none_or(|name| task.name == name) {
            true => Ok(paper),
            false => Ok(Requirements::open("default", task)?),
        }
    }
}

/// Parses NAME=PATH. A path without a name is named after its last component.
fn named(run: &str) -> (String, PathBuf) {
    if let Some((name, path)) = run.split_once('=')
        && !Path::new(run).exists()
    {
        return (name.to_owned(), PathBuf::from(path));
    }
    let path = PathBuf::from(run);
    let name = path.file_stem().map_or_else(|| run.to_owned(), |name| name.to_string_lossy().into_owned());
    (name, path)
}
