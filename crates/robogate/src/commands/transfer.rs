//! `robogate transfer`: the real success rate from a simulation and a few real trials.

use std::fs;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use robogate_analysis::labels::parameter_or_level;
use robogate_analysis::transfer::{Transfer, TransferOptions};
use robogate_report::{TransferHeadline, next_trials, transfer_html, transfer_json};
use robogate_stats::format::{counted, fixed, percent_range, range};

use crate::commands::analyze::{heading, interval};
use crate::exit::{DONE, Exit, OrExit};
use crate::place;
use crate::summary::influential;
use crate::terminal::{bold, dim, line, note, percent, wrapped};
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
    /// Name columns of trials that may share effects, such as operator,day; default: operator and day if they exist
    #[arg(long, value_name = "A,B,...", value_delimiter = ',')]
    groups: Vec<String>,
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
        let options = TransferOptions { groups: self.groups.clone(), population: self.population.clone() };
        let mut view = TransferView::new();
        let transfer =
            Transfer::watched(&source, &self.sim, &self.real, &options, &mut |step| view.hear(step)).or_usage()?;
        view.end();
        for (file, text) in [(&self.html, transfer_html as fn(&Transfer) -> String), (&self.out, transfer_json)] {
            if let Some(file) = file {
                fs::write(file, text(&transfer))
                    .with_context(|| format!("cannot write {}", file.display()))
                    .or_broken()?;
                note(format_args!("written: {}", file.display()));
            }
        }
        if self.json {
            line(transfer_json(&transfer));
        } else {
            print(&transfer);
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

fn print(of: &Transfer) {
    let headline = TransferHeadline::of(of);
    line(format_args!(
        "{} {}, {} policy: {}, {} in {}",
        bold("RoboGate"),
        of.simulation.robot,
        of.simulation.policy,
        counted(of.real.trials, "real trial"),
        counted(of.simulation.episodes, "episode"),
        of.simulation.engine
    ));
    line("");
    wrapped(&headline.answer);
    for (title, lines) in [
        ("What the simulation adds", &headline.what_the_simulation_adds),
        ("Where simulation and reality differ (p < 0.05, adjusted)", &headline.what_differs),
    ] {
        if lines.is_empty() {
            continue;
        }
        heading(title);
        lines.iter().for_each(|text| wrapped(text));
    }
    influential(&of.effects, "Most influential parameters in the simulation");
    heading("Corrected simulation");
    let correction = &of.correction;
    line(format_args!(
        "  log-odds of real success = shift {} ({}) + slope {} ({}) x simulated",
        fixed(correction.shift.mean, 2),
        range(correction.shift.interval_95),
        fixed(correction.slope.mean, 2),
        range(correction.slope.interval_95)
    ));
    for of in &correction.parameters {
        line(format_args!(
            "    + {} ({}) for each standard deviation of {}",
            fixed(of.effect.mean, 2),
            range(of.effect.interval_95),
            parameter_or_level(&of.parameter, of.level.as_deref())
        ));
    }
    if let Some(boundary) = &correction.boundary {
        line(format_args!(
            "  settings with 50 % real success have {} simulated success ({})",
            percent(boundary.mean),
            percent_range(boundary.interval_95)
        ));
    }
    for at in &correction.curve {
        line(format_args!(
            "  simulated {:>7}: real {:>7}  {}",
            percent(at.simulated),
            percent(at.real.mean),
            dim(interval(at.real.interval_95))
        ));
    }
    if let Some(next) = &of.next {
        heading("Trials to run next");
        for trial in &next.settings {
            wrapped(&format!(
                "{} (simulated {}, expected {})",
                trial.setting,
                percent(trial.simulated),
                percent(trial.expected)
            ));
        }
        wrapped(&next_trials(next));
    }
    heading("Assumptions");
    headline.limits.iter().for_each(|text| wrapped(text));
}
