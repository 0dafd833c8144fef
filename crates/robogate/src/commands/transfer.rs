//! `robogate transfer`: the real success rate from a simulation and a few real trials.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_analysis::transfer::{Transfer, TransferOptions};
use robogate_dictionary::files;
use robogate_report::{transfer_html, transfer_json, transfer_text};

use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::terminal::{line, note, print_report};
use crate::transfer_view::TransferView;
use robogate_session::open_source;

/// Estimate the success rate of the real robot from a simulation and a few real trials.
///
/// The trials are rows of a CSV file with the columns `success` (true or false), optionally `failure_mode`, and the
/// parameters of the simulated space by name. Empty cells are missing values.
#[derive(Debug, Args)]
pub(crate) struct TransferTo {
    /// The simulation: a run's folder or a dictionary (Parquet)
    #[arg(long, value_name = "RUN")]
    sim: PathBuf,
    /// The trials of the real robot (CSV)
    #[arg(long, value_name = "FILE")]
    real: PathBuf,
    /// Estimate the rate over the settings in this CSV file, which the real robot meets; default: the simulated operating
    /// space. The trials must be a random sample of the same settings
    #[arg(long, value_name = "FILE")]
    population: Option<PathBuf>,
    /// Name columns of trials that may share effects, such as operator,day; default: those whose names say so
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    groups: Vec<String>,
    /// Name the simulated policy as the column `policy` of the trials does; default: its name in the simulation. Trials of another
    /// policy are refused
    #[arg(long, value_name = "NAME")]
    policy: Option<String>,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Write a self-contained HTML page to this file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write the JSON document to this file, for `robogate gate --real`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl TransferTo {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        self.check_files()?;
        let source = open_source(&self.sim)?;
        let options = TransferOptions {
            groups: self.groups.clone(),
            policy: self.policy.clone(),
            population: self.population.clone(),
        };
        let mut view = TransferView::new();
        let transfer =
            Transfer::watched(&source, &self.sim, &self.real, &options, &mut |step| view.hear(step)).or_usage()?;
        view.end();
        for (file, text) in [(&self.html, transfer_html as fn(&Transfer) -> String), (&self.out, transfer_json)] {
            if let Some(file) = file {
                files::write(file, text(&transfer))
                    .with_context(|| format!("cannot write {}", file.display()))
                    .or_broken()?;
                note(format_args!("written: {}", file.display()));
            }
        }
        if self.json {
            line(transfer_json(&transfer));
        } else {
            print_report(&transfer_text(&transfer));
        }
        Ok(DONE)
    }

    /// Rejects outputs that would replace each other or the trials.
    fn check_files(&self) -> Result<(), Exit> {
        let (real, html, out) = (Some(self.real.as_path()), self.html.as_deref(), self.out.as_deref());
        for (output, file) in [("--html", html), ("--out", out)] {
            place::check_different(("--real", real), (output, file))?;
            place::check_different(("--population", self.population.as_deref()), (output, file))?;
        }
        place::check_different(("--html", html), ("--out", out))
    }
}
