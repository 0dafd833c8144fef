//! `robogate report`: writes a run or a dictionary as one page.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use robogate_analysis::{Analysis, AnalysisOptions, DEFAULT_TARGET, Source};
use robogate_report::{analysis_json, html, markdown};

use crate::commands::analyze::{analyse, options};
use crate::exit::{DONE, Exit, INVALID, OrExit};
use crate::terminal::{line, note};

/// Write a run or a dictionary as one page: where the policy fails, what to do, and the confidence intervals.
#[derive(Debug, Args)]
pub(crate) struct Report {
    /// Folder of a run, a dictionary (Parquet) or a published JSON dictionary
    dictionary: PathBuf,
    /// Choose the format of the page
    #[arg(long, value_name = "FORMAT", default_value = "html")]
    format: Form,
    /// Write to this file, - for stdout; default: report.html, .md or .json in the run's folder, or in the current
    /// folder for a file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Map two more parameters; the first is on the vertical axis
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate that the advice aims at, between 0 and 1
    #[arg(long, value_name = "RATE", default_value_t = DEFAULT_TARGET)]
    target: f64,
}

/// The name of the page in a run's folder.
pub(crate) const PAGE: &str = "report.html";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Form {
    /// One self-contained file
    Html,
    /// The same content as Markdown
    Md,
    /// One versioned JSON document
    Json,
}

impl Report {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = Source::open(&self.dictionary).or_usage()?;
        let analysis = analyse(&source, &self.dictionary, &options(&self.pair, self.target))?;
        let (text, ending) = match self.format {
            Form::Html => (html(&analysis), "html"),
            Form::Md => (markdown(&analysis), "md"),
            Form::Json => (analysis_json(&analysis), "json"),
        };
        match &self.out {
            Some(out) if out.as_os_str() == "-" => line(text.trim_end()),
            out => {
                let default = || source.folder().unwrap_or(Path::new("")).join(format!("report.{ending}"));
                write(&out.clone().unwrap_or_else(default), &text)?;
            }
        }
        Ok(evidence(&analysis))
    }
}

/// Analyzes a finished run and writes its page into its folder, unless it exists.
pub(crate) fn page(dir: &Path) -> Result<Analysis, Exit> {
    let out = dir.join(PAGE);
    let source = Source::open(dir).or_broken()?;
    let analysis = analyse(&source, dir, &AnalysisOptions::default())?;
    if !out.exists() {
        std::fs::write(&out, html(&analysis)).with_context(|| format!("cannot write {}", out.display())).or_broken()?;
    }
    Ok(analysis)
}

fn write(out: &Path, text: &str) -> Result<(), Exit> {
    std::fs::write(out, text).with_context(|| format!("cannot write {}", out.display())).or_broken()?;
    note(format_args!("{}: {} KB", out.display(), text.len().div_ceil(1024)));
    Ok(())
}

/// Exit code 0, or 4 without a valid episode.
pub(crate) fn evidence(analysis: &Analysis) -> u8 {
    if analysis.success.rate.n > 0 { DONE } else { INVALID }
}
