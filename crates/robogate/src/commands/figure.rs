//! `robogate figure`: writes a figure of a run's page as a file.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_analysis::AnalysisOptions;
use robogate_dictionary::files;
use robogate_report::{FigureFile, figure_files};

use crate::commands::analyze::analyse;
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{foreign, line, note};
use robogate_session::open_source;

/// Write a figure of the page of a run as SVG, and its data as CSV.
///
/// Without a name, the command lists the figures. Without --svg and --csv, it writes both files with the name of the figure into the
/// current folder. The SVG has no scripts and needs no style sheet: LaTeX (with Inkscape), browsers and office programs read it.
#[derive(Debug, Args)]
pub(crate) struct FigureOf {
    /// Folder of a run, a dictionary (Parquet) or a published JSON dictionary
    #[arg(value_name = "DIR")]
    dictionary: PathBuf,
    /// Name of the figure
    name: Option<String>,
    /// Write the figure to this file
    #[arg(long, value_name = "FILE", requires = "name", value_parser = place::local())]
    svg: Option<PathBuf>,
    /// Write the data of the figure to this file
    #[arg(long, value_name = "FILE", requires = "name", value_parser = place::local())]
    csv: Option<PathBuf>,
}

impl FigureOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        place::check_different(("--svg", self.svg.as_deref()), ("--csv", self.csv.as_deref()))?;
        let source = open_source(&self.dictionary)?;
        let figures = figure_files(&analyse(&source, &self.dictionary, &AnalysisOptions::default())?);
        let Some(name) = &self.name else {
            let wide = figures.iter().map(|figure| figure.name.len()).max().unwrap_or(0);
            figures.iter().for_each(|of| line(format_args!("{:<wide$}  {}", of.name, foreign(&of.title))));
            return Ok(DONE);
        };
        let Some(FigureFile { svg, csv, .. }) = figures.iter().find(|figure| figure.name == *name) else {
            let known: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
            return Err(anyhow!("{}: no such figure. Expected one of: {}", foreign(name), known.join(", "))).or_usage();
        };
        let both = self.svg.is_none() && self.csv.is_none();
        let beside = |ending: &str| both.then(|| PathBuf::from(format!("{name}.{ending}")));
        for (file, text) in [(self.svg.clone().or(beside("svg")), svg), (self.csv.clone().or(beside("csv")), csv)] {
            if let Some(file) = file {
                write(&file, text)?;
            }
        }
        Ok(DONE)
    }
}

fn write(file: &Path, text: &str) -> Result<(), Exit> {
    files::write(file, text).with_context(|| format!("cannot write {}", file.display())).or_unwritable()?;
    note(format_args!("written: {}", foreign(file.display())));
    Ok(())
}
