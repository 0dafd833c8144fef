//! `robogate compare`: comparison of robots, policies or simulators.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::{AnalysisError, Comparison, ComparisonError, ComparisonOptions, Source};
use robogate_dictionary::files;
use robogate_report::{comparison_html_with, comparison_json, comparison_markdown, comparison_text};

use crate::arguments::ReopeningArguments;
use crate::commands::analyze::Groups;
use crate::exit::{DONE, Exit, INFRASTRUCTURE, INVALID, OrExit, USAGE};
use crate::place;
use crate::terminal::{line, note, print_report};
use crate::watch;
use robogate_session::open_source;

/// Compare dictionaries of different robots, policies or simulators, and find where all of them fail.
#[derive(Debug, Args)]
pub(crate) struct Compare {
    /// Two or more folders of runs, dictionaries (Parquet) or published JSON dictionaries
    #[arg(required = true, value_name = "RUN_OR_FILE")]
    dictionaries: Vec<PathBuf>,
    /// Compare scenario by scenario; all of them must have the same design
    #[arg(long)]
    paired: bool,
    /// Compare dictionaries with different parameter spaces: only their rows in the shared ranges
    #[arg(long, conflicts_with = "paired")]
    common: bool,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Write a self-contained HTML page to this file
    #[arg(long = "out", alias = "html", value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write a Markdown page to this file
    #[arg(long, value_name = "FILE")]
    md: Option<PathBuf>,
    /// Set the names of the dictionaries, in their order; default: chosen from their provenance
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    names: Vec<String>,
    /// Map two shared parameters
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate below which a cell is a danger zone, in (0, 1)
    #[arg(long, value_name = "RATE", default_value_t = 0.4)]
    danger: f64,
    /// Set the reach of a robot in metres, if its dictionary does not record it
    #[arg(long, value_name = "NAME=METRES", value_parser = named_length)]
    reach: Vec<(String, f64)>,
    /// Set the distance from base to workspace in metres, for dictionaries that do not record it
    #[arg(long, value_name = "METRES")]
    workspace: Option<f64>,
    /// Set the number of scenarios with different outcomes to list for each direction
    #[arg(long, value_name = "N", default_value_t = 10, requires = "paired")]
    flips: usize,
    #[command(flatten)]
    groups: Groups,
    /// Leave out the recorded episodes
    #[arg(long)]
    no_replay: bool,
    #[command(flatten)]
    opening: ReopeningArguments,
}

fn named_length(text: &str) -> Result<(String, f64), String> {
    let (name, metres) = text.rsplit_once('=').ok_or("expected NAME=METRES, for example ur3e=0.5")?;
    let metres = metres.trim().parse().map_err(|_| format!("`{metres}` is not a valid length in metres"))?;
    Ok((name.trim().to_owned(), metres))
}

impl Compare {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_twice()?;
        place::check_different(("--out", self.html.as_deref()), ("--md", self.md.as_deref()))?;
        let open = |path: &PathBuf| open_source(path).map(|source| (source, path.clone()));
        let sources: Vec<(Source, PathBuf)> = self.dictionaries.iter().map(open).collect::<Result<_, _>>()?;
        let options = ComparisonOptions {
            names: self.names.clone(),
            danger_limit: self.danger,
            pair: self.pair.first().cloned().zip(self.pair.get(1).cloned()),
            reach_m: self.reach.clone(),
            workspace_m: self.workspace,
            paired: self.paired,
            common: self.common,
            max_flips: self.flips,
            groups: self.groups.columns.clone(),
        };
        let comparison = Comparison::of(&sources, &options).map_err(exit)?;
        if let Some(file) = &self.html {
            let watch = if self.no_replay {
                None
            } else {
                Some(watch::compared(&comparison, &sources, &self.opening.choice()).or_usage()?)
            };
            let watch = watch.as_ref().filter(|watch| !watch.items.is_empty());
            write(file, &comparison_html_with(&comparison, watch))?;
        }
        if let Some(file) = &self.md {
            write(file, &comparison_markdown(&comparison))?;
        }
        if self.json {
            line(comparison_json(&comparison));
        } else {
            print_report(&comparison_text(&comparison));
        }
        Ok(if comparison.has_evidence() { DONE } else { INVALID })
    }

    /// Returns an error if a path is given twice, in any spelling, or if a page would overwrite a dictionary.
    fn check_twice(&self) -> Result<(), Exit> {
        let full = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        for (i, path) in self.dictionaries.iter().enumerate() {
            if self.dictionaries[..i].iter().any(|before| full(before) == full(path)) {
                let error = anyhow!("{} is given twice\nHint: remove one of them", path.display());
                return Err(Exit { code: USAGE, error });
            }
            if let Some(page) = [&self.html, &self.md].into_iter().flatten().find(|page| full(page) == full(path)) {
                let error = anyhow!("{} is a dictionary, which the page would overwrite", page.display());
                return Err(Exit { code: USAGE, error });
            }
        }
        Ok(())
    }
}

pub(super) fn exit(error: ComparisonError) -> Exit {
    let broken = matches!(error, ComparisonError::Analysis(AnalysisError::Io { .. }));
    Exit { code: if broken { INFRASTRUCTURE } else { USAGE }, error: error.into() }
}

pub(super) fn write(file: &Path, text: &str) -> Result<(), Exit> {
    files::write(file, text).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
    note(format_args!("{}: {} KB", file.display(), text.len().div_ceil(1024)));
    Ok(())
}
