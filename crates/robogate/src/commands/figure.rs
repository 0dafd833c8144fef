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

/// Write a figure of the page of a run as SVG, PDF or PNG, and its data as CSV.
///
/// Without a name, the command lists the figures. Without an option, it writes SVG and CSV with the name of the figure into the
/// current folder. The SVG has no scripts and needs no style sheet: LaTeX (with Inkscape), browsers and office programs read it.
/// PDF and PNG use a font of the system.
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
    /// Write the figure to this file as a page of its size
    #[arg(long, value_name = "FILE", requires = "name", value_parser = place::local())]
    pdf: Option<PathBuf>,
    /// Write the figure to this file, 2008 pixels wide
    #[arg(long, value_name = "FILE", requires = "name", value_parser = place::local())]
    png: Option<PathBuf>,
    /// Write the data of the figure to this file
    #[arg(long, value_name = "FILE", requires = "name", value_parser = place::local())]
    csv: Option<PathBuf>,
}

impl FigureOf {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let named = [("--svg", &self.svg), ("--pdf", &self.pdf), ("--png", &self.png), ("--csv", &self.csv)];
        for (i, (option, file)) in named.iter().enumerate() {
            for (other, second) in named.iter().skip(i + 1) {
                place::check_different((option, file.as_deref()), (other, second.as_deref()))?;
            }
        }
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
        if named.iter().all(|(_, file)| file.is_none()) {
            write(Path::new(&format!("{name}.svg")), svg.as_bytes())?;
            write(Path::new(&format!("{name}.csv")), csv.as_bytes())?;
            return Ok(DONE);
        }
        for (option, file) in named {
            let Some(file) = file else { continue };
            match option {
                "--pdf" => write(file, &print::pdf(svg)?)?,
                "--png" => write(file, &print::png(svg)?)?,
                "--svg" => write(file, svg.as_bytes())?,
                _ => write(file, csv.as_bytes())?,
            }
        }
        Ok(DONE)
    }
}

/// Figures as PDF and PNG, in builds that have them.
mod print {
    use super::{Exit, OrExit};

    #[cfg(feature = "print")]
    pub(super) fn pdf(svg: &str) -> Result<Vec<u8>, Exit> {
        robogate_report::pdf(svg).or_usage()
    }

    #[cfg(feature = "print")]
    pub(super) fn png(svg: &str) -> Result<Vec<u8>, Exit> {
        robogate_report::png(svg).or_usage()
    }

    #[cfg(not(feature = "print"))]
    pub(super) fn pdf(_: &str) -> Result<Vec<u8>, Exit> {
        Err(anyhow::anyhow!(
            "this build writes figures as SVG only\nHint: build with --features print, or use the Python package"
        ))
        .or_usage()
    }

    #[cfg(not(feature = "print"))]
    pub(super) use pdf as png;
}

fn write(file: &Path, bytes: &[u8]) -> Result<(), Exit> {
    files::write(file, bytes).with_context(|| format!("cannot write {}", file.display())).or_unwritable()?;
    note(format_args!("written: {}", foreign(file.display())));
    Ok(())
}
