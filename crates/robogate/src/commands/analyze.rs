//! `robogate analyze`: the analysis of a dictionary in the terminal or as one document.

use std::path::{Path, PathBuf};

use clap::Args;
use robogate_analysis::{Analysis, AnalysisError, AnalysisOptions, DEFAULT_TARGET, Source};
use robogate_gate::Sampling;
use robogate_report::{Additions, analysis_json_with, analysis_text};

use crate::commands::report::evidence;
use crate::exit::{Exit, INFRASTRUCTURE, USAGE};
use crate::terminal::{line, print_report};
use crate::twins::NominalArguments;
use robogate_session::open_source;

/// Analyze a dictionary: where the policy fails, the effects of the parameters, and their confidence intervals.
#[derive(Debug, Args)]
pub(crate) struct Analyze {
    /// A run's folder, a dictionary (Parquet), an exported CSV or JSON Lines file, or a published JSON dictionary
    dictionary: PathBuf,
    /// Print one versioned JSON document
    #[arg(long)]
    json: bool,
    /// Map two more parameters; the frontier is solved for the first
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    pair: Vec<String>,
    /// Set the success rate that the advice aims at, between 0 and 1
    #[arg(long, value_name = "RATE", default_value_t = DEFAULT_TARGET)]
    target: f64,
    #[command(flatten)]
    groups: Groups,
    #[command(flatten)]
    nominal: NominalArguments,
}

/// The columns that mark dependent rows.
#[derive(Debug, Args)]
pub(crate) struct Groups {
    /// Set the columns whose equal values mark rows that depend on each other, such as day,operator; default: found by name
    /// (case, scenario, seed, day, session, operator, robot, unit, ...) and by equal settings
    #[arg(long = "groups", value_name = "COLUMN,...", value_delimiter = ',')]
    pub(crate) columns: Vec<String>,
}

impl Analyze {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        let source = open_source(&self.dictionary)?;
        let analysis = analyse(&source, &self.dictionary, &options(&self.pair, self.target, &self.groups))?;
        let twins = self.nominal.twins(&source, Sampling::Fixed)?;
        if self.json {
            line(analysis_json_with(&analysis, twins.as_ref()));
        } else {
            let additions = Additions { twins: twins.as_ref(), ..Additions::default() };
            print_report(&analysis_text(&analysis, &additions));
        }
        Ok(evidence(&analysis))
    }
}

/// The options `--pair A B`, `--target RATE` and `--groups COLUMN,...`.
pub(crate) fn options(names: &[String], target_rate: f64, groups: &Groups) -> AnalysisOptions {
    let pairs = names.chunks_exact(2).map(|pair| (pair[0].clone(), pair[1].clone())).collect();
    AnalysisOptions { pairs, target_rate, groups: groups.columns.clone(), ..AnalysisOptions::default() }
}

/// Analyzes a source. Its errors get their exit codes.
pub(crate) fn analyse(source: &Source, path: &Path, options: &AnalysisOptions) -> Result<Analysis, Exit> {
    Analysis::with(source, path, options).map_err(|error| {
        let code = if matches!(error, AnalysisError::Io { .. }) { INFRASTRUCTURE } else { USAGE };
        Exit { code, error: error.into() }
    })
}
